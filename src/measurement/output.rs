//! Measurements as JSON, CSV and tables of text.

use std::fmt;
use std::fmt::Write as _;

use serde::{Serialize, Serializer};

use super::{DEFINITIONS, FaceState, Measurement, Measurements, RegionMeasurement, RegionState, TypicalRange};
use crate::mesh::Vec3;
use crate::page::csv_text;

impl Measurement {
    /// By how much the value changes.
    #[must_use]
    pub fn difference(&self) -> Option<f64> {
        Some(self.after? - self.before?)
    }
}

impl Serialize for Measurement {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Row<'a> {
            name: &'a str,
            group: &'a str,
            unit: &'a str,
            formula: String,
            before: Option<f64>,
            after: Option<f64>,
            difference: Option<f64>,
            missing: Option<String>,
            typical: Option<TypicalRange>,
        }
        let definition = &self.definition;
        Row {
            name: definition.name,
            group: definition.group,
            unit: definition.formula.unit(),
            formula: definition.formula.to_string(),
            before: self.before,
            after: self.after,
            difference: self.difference(),
            missing: self.missing.as_ref().map(ToString::to_string),
            typical: definition.typical,
        }
        .serialize(serializer)
    }
}

impl Serialize for FaceState {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Axes {
            lateral: [f64; 3],
            vertical: Option<[f64; 3]>,
        }
        #[derive(Serialize)]
        struct Point {
            name: &'static str,
            position_mm: [f64; 3],
        }
        #[derive(Serialize)]
        struct State {
            mirror_plane: crate::mesh::MirrorPlane,
            mirror_plane_converged: bool,
            axes: Option<Axes>,
            landmarks: Vec<Point>,
        }
        let axes =
            |f: super::FacialFrame| Axes { lateral: f.plane.normal.into(), vertical: f.vertical.map(Vec3::into) };
        State {
            mirror_plane: self.symmetry.plane,
            mirror_plane_converged: self.symmetry.converged,
            axes: self.frame.map(axes),
            landmarks: self.landmarks.iter().map(|(name, p)| Point { name, position_mm: (*p).into() }).collect(),
        }
        .serialize(serializer)
    }
}

impl Serialize for Measurements {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Units {
            length: &'static str,
            area: &'static str,
            volume: &'static str,
            angle: &'static str,
            ratio: &'static str,
        }
        #[derive(Serialize)]
        struct All<'a> {
            version: &'a str,
            units: Units,
            measurements: &'a [Measurement],
            regions: &'a [RegionMeasurement],
            before: &'a FaceState,
            after: &'a Option<FaceState>,
        }
        let units = Units { length: "mm", area: "mm^2", volume: "mm^3", angle: "deg", ratio: "%" };
        let Self { values: measurements, regions, before, after, .. } = self;
        All { version: self.version, units, measurements, regions, before, after }.serialize(serializer)
    }
}

/// Rows of text under named columns.
pub(super) struct Table {
    pub title: String,
    pub header: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
    /// What the columns mean.
    pub note: String,
}

/// So many decimals, never a negative zero; a dash where there is no number.
fn fixed(value: Option<f64>, decimals: usize) -> String {
    let Some(value) = value else { return "-".to_owned() };
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').to_owned() } else { text }
}

impl Measurements {
    /// As tables for people.
    pub(super) fn tables(&self) -> Vec<Table> {
        let mut tables: Vec<Table> = Vec::new();
        let mut sources: Vec<&str> = Vec::new();
        for m in &self.values {
            if tables.last().is_none_or(|t| t.title != m.definition.group) {
                let mut header =
                    vec![m.definition.group, "unit", if self.after.is_some() { "before" } else { "value" }];
                header.extend(self.after.iter().flat_map(|_| ["after", "difference"]));
                header.push("remark");
                tables.push(Table {
                    title: m.definition.group.to_owned(),
                    header,
                    rows: Vec::new(),
                    note: String::new(),
                });
            }
            let mut row = vec![m.definition.name.replace('_', " "), m.definition.formula.unit().to_owned()];
            row.push(fixed(m.before, 2));
            row.extend(self.after.iter().flat_map(|_| [fixed(m.after, 2), fixed(m.difference(), 2)]));
            row.push(match (&m.missing, m.definition.typical) {
                (Some(missing), _) => missing.to_string(),
                (None, Some(TypicalRange { low, high, source })) => {
                    let k = sources.iter().position(|s| *s == source).unwrap_or_else(|| {
                        sources.push(source);
                        sources.len() - 1
                    });
                    format!("typical {low} to {high} [{}]", k + 1)
                }
                (None, None) => String::new(),
            });
            if let Some(table) = tables.last_mut() {
                table.rows.push(row);
                table.note = sources.iter().enumerate().map(|(k, s)| format!("[{}] {s}. ", k + 1)).collect();
            }
        }
        // Sources stand below the last table that has one.
        for k in 1..tables.len() {
            let (before, rest) = tables.split_at_mut(k);
            let before = &mut before[k - 1].note;
            if rest[0].note.starts_with(&**before) && !before.is_empty() {
                before.clear();
            }
        }
        tables.push(self.symmetry_table());
        tables.extend(self.after.as_ref().map(|_| self.change_table()));
        tables
    }

    fn symmetry_table(&self) -> Table {
        let mut header = vec!["symmetry", "area", "rms", "median", "p95", "max"];
        let state = |s: &RegionState| {
            let a = s.asymmetry;
            let mut cells = vec![fixed(Some(s.area), 1)];
            cells.extend([a.rms, a.median, a.p95, a.max].map(|x| fixed((a.vertices > 0).then_some(x), 3)));
            cells
        };
        header.extend(self.after.iter().flat_map(|_| ["area after", "rms", "median", "p95", "max after"]));
        let row = |r: &RegionMeasurement| {
            [vec![r.name.clone()], state(&r.before), r.after.as_ref().map(state).unwrap_or_default()].concat()
        };
        let note = "Area in square millimetres. Distance to the mirror image of the other side in the best mirror plane, \
                    millimetres: root mean square over the area; median, 95th percentile and largest over the vertices.";
        let rows = self.regions.iter().map(row).collect();
        Table { title: "symmetry".to_owned(), header, rows, note: note.to_owned() }
    }

    fn change_table(&self) -> Table {
        let header = vec!["change", "area", "area / %", "volume", "mean displacement", "max displacement"];
        let row = |r: &RegionMeasurement| {
            let area = r.after.map(|after| after.area - r.before.area);
            let share = area.filter(|_| r.before.area > 0.0).map(|d| 100.0 * d / r.before.area);
            let [volume, mean, max] = [
                r.change.map(|c| c.volume),
                r.change.map(|c| c.displacement_mean),
                r.change.map(|c| c.displacement_max),
            ];
            vec![r.name.clone(), fixed(area, 1), fixed(share, 2), fixed(volume, 1), fixed(mean, 3), fixed(max, 3)]
        };
        let note = "Square and cubic millimetres, millimetres. The volume is what the surface sweeps from before to after, positive \
                    outwards; the mean displacement is weighted by area.";
        let rows = self.regions.iter().map(row).collect();
        Table { title: "change".to_owned(), header, rows, note: note.to_owned() }
    }

    /// Everything as CSV, all digits: `group,name,unit,before,after,difference,remark`.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut out = String::from("group,name,unit,before,after,difference,remark\n");
        let mut line =
            |group: &str, name: &str, unit: &str, [before, after, difference]: [Option<f64>; 3], remark: &str| {
                let [before, after, difference] =
                    [before, after, difference].map(|v| v.map_or(String::new(), |v| v.to_string()));
                let [group, name, remark] = [group, name, remark].map(csv_text);
                // Writing to text does not fail.
                let _ = writeln!(out, "{group},{name},{unit},{before},{after},{difference},{remark}");
            };
        for m in &self.values {
            let remark = m.missing.as_ref().map(ToString::to_string).unwrap_or_default();
            let definition = &m.definition;
            let values = [m.before, m.after, m.difference()];
            line(definition.group, definition.name, definition.formula.unit(), values, &remark);
        }
        for r in &self.regions {
            let mut both = |group: &str, unit: &str, of: &dyn Fn(&RegionState) -> f64| {
                let (before, after) = (of(&r.before), r.after.as_ref().map(of));
                line(group, &r.name, unit, [Some(before), after, after.map(|a| a - before)], "");
            };
            both("area", "mm^2", &|s| s.area);
            both("asymmetry_rms", "mm", &|s| s.asymmetry.rms);
            both("asymmetry_median", "mm", &|s| s.asymmetry.median);
            both("asymmetry_p95", "mm", &|s| s.asymmetry.p95);
            both("asymmetry_max", "mm", &|s| s.asymmetry.max);
            if let Some(c) = r.change {
                for (group, unit, value) in [
                    ("volume", "mm^3", c.volume),
                    ("displacement_mean", "mm", c.displacement_mean),
                    ("displacement_max", "mm", c.displacement_max),
                ] {
                    line(group, &r.name, unit, [None, None, Some(value)], "");
                }
            }
        }
        out
    }
}

/// The tables, aligned.
impl fmt::Display for Measurements {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, table) in self.tables().iter().enumerate() {
            let header: Vec<String> = table.header.iter().map(ToString::to_string).collect();
            let lines = || std::iter::once(&header).chain(&table.rows);
            let text = |column: usize| column == 0 || matches!(table.header[column], "unit" | "remark");
            let width = |column: usize| lines().map(|line| line[column].chars().count()).max().unwrap_or(0);
            let widths: Vec<usize> = (0..header.len()).map(width).collect();
            if k > 0 {
                writeln!(f)?;
            }
            for cells in lines() {
                let mut line = String::new();
                for (column, (cell, &width)) in cells.iter().zip(&widths).enumerate() {
                    line += &if text(column) { format!("{cell:<width$}  ") } else { format!("{cell:>width$}  ") };
                }
                writeln!(f, "{}", line.trim_end())?;
            }
            if !table.note.is_empty() {
                writeln!(f, "{}", table.note.trim_end())?;
            }
        }
        Ok(())
    }
}

/// What can be measured: every measurement with its formula, and every landmark with its place.
#[must_use]
pub fn glossary() -> String {
    let mut out = String::from("measurements\n");
    for d in DEFINITIONS {
        let _ = writeln!(out, "  {:<24} {:<4} {}", d.name, d.formula.unit(), d.formula);
    }
    out.push_str("\nlandmarks, and which of the 68 numbered ones they are\n");
    for l in super::LANDMARKS {
        let numbers = l.numbered.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
        let _ = writeln!(
            out,
            "  {:<18} {:<9} {}",
            l.name,
            if numbers.is_empty() { "-".to_owned() } else { numbers },
            l.place
        );
    }
    out
}
