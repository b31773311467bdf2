//! Measurements as JSON, CSV and tables of text.

use std::fmt;
use std::fmt::Write as _;

use serde::{Serialize, Serializer};

use super::{
    AFTER, Change, Comparison, DEFINITIONS, FaceState, Measurement, Measurements, RegionMeasurement, RegionState,
    TypicalRange,
};
use crate::mesh::Vec3;
use crate::text::csv_field;

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
    pub header: Vec<String>,
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

fn owned(header: &[&str]) -> Vec<String> {
    header.iter().map(ToString::to_string).collect()
}

/// One face, and the shapes after beside it. `all` has at least one member, and all have the same face before.
#[derive(Clone, Copy)]
struct Columns<'a> {
    /// Of the shapes after; none if there is only the face.
    names: &'a [String],
    all: &'a [Measurements],
}

impl Columns<'_> {
    /// As tables for people.
    fn tables(self) -> Vec<Table> {
        let mut tables: Vec<Table> = Vec::new();
        let mut sources: Vec<&str> = Vec::new();
        for (k, m) in self.all[0].values.iter().enumerate() {
            if tables.last().is_none_or(|t| t.title != m.definition.group) {
                let mut header =
                    owned(&[m.definition.group, "unit", if self.names.is_empty() { "value" } else { "before" }]);
                header.extend(self.names.iter().flat_map(|name| [name.clone(), "difference".to_owned()]));
                header.push("remark".to_owned());
                tables.push(Table {
                    title: m.definition.group.to_owned(),
                    header,
                    rows: Vec::new(),
                    note: String::new(),
                });
            }
            let mut row = vec![m.definition.title(), m.definition.formula.unit().to_owned()];
            row.push(fixed(m.before, 2));
            let after = self.all.iter().take(self.names.len()).map(|one| &one.values[k]);
            row.extend(after.flat_map(|m| [fixed(m.after, 2), fixed(m.difference(), 2)]));
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
        tables.extend(self.names.iter().zip(self.all).map(|(name, one)| {
            let title = if self.names.len() == 1 { "change".to_owned() } else { format!("change: {name}") };
            change_table(title, one)
        }));
        tables
    }

    fn symmetry_table(self) -> Table {
        let mut header = owned(&["symmetry", "area", "rms", "median", "p95", "max"]);
        let state = |s: &RegionState| {
            let a = s.asymmetry;
            let mut cells = vec![fixed(Some(s.area), 1)];
            cells.extend([a.rms, a.median, a.p95, a.max].map(|x| fixed((a.vertices > 0).then_some(x), 3)));
            cells
        };
        for name in self.names {
            header.extend([format!("area {name}"), "rms".to_owned(), "median".to_owned(), "p95".to_owned()]);
            header.push(format!("max {name}"));
        }
        let row = |(k, r): (usize, &RegionMeasurement)| {
            let after = self.all.iter().filter_map(|one| one.regions[k].after.as_ref());
            [vec![r.name.clone()], state(&r.before)].into_iter().chain(after.map(state)).flatten().collect()
        };
        let note = "Area in square millimetres. Distance to the mirror image of the other side in the best mirror plane, \
                    millimetres: root mean square over the area; median, 95th percentile and largest over the vertices.";
        let rows = self.all[0].regions.iter().enumerate().map(row).collect();
        Table { title: "symmetry".to_owned(), header, rows, note: note.to_owned() }
    }

    fn to_csv(self) -> String {
        let mut out = String::from("group,name,unit,before");
        match self.names {
            [] => out += ",after,difference",
            [name] => out += &format!(",{},difference", csv_field(name)),
            names => {
                for name in names {
                    out += &format!(",{},{}", csv_field(name), csv_field(&format!("{name} difference")));
                }
            }
        }
        out += ",remark\n";
        // Each shape after has a value and a difference.
        let mut line = |group: &str, name: &str, unit: &str, before, after: &[[Option<f64>; 2]], remark: &str| {
            let values = std::iter::once(before).chain(after.iter().copied().flatten());
            let values: Vec<String> = values.map(|v| v.map_or(String::new(), |v: f64| v.to_string())).collect();
            let [group, name, remark] = [group, name, remark].map(csv_field);
            // Writing to text does not fail.
            let _ = writeln!(out, "{group},{name},{unit},{},{remark}", values.join(","));
        };
        for (k, m) in self.all[0].values.iter().enumerate() {
            let remark = m.missing.as_ref().map(ToString::to_string).unwrap_or_default();
            let definition = &m.definition;
            let after: Vec<_> = self.all.iter().map(|one| [one.values[k].after, one.values[k].difference()]).collect();
            line(definition.group, definition.name, definition.formula.unit(), m.before, &after, &remark);
        }
        for (k, r) in self.all[0].regions.iter().enumerate() {
            let mut both = |group: &str, unit: &str, of: &dyn Fn(&RegionState) -> f64| {
                let before = of(&r.before);
                let after = self.all.iter().map(|one| one.regions[k].after.as_ref().map(of));
                let after: Vec<_> = after.map(|a| [a, a.map(|a| a - before)]).collect();
                line(group, &r.name, unit, Some(before), &after, "");
            };
            both("area", "mm^2", &|s| s.area);
            both("asymmetry_rms", "mm", &|s| s.asymmetry.rms);
            both("asymmetry_median", "mm", &|s| s.asymmetry.median);
            both("asymmetry_p95", "mm", &|s| s.asymmetry.p95);
            both("asymmetry_max", "mm", &|s| s.asymmetry.max);
            let mut change = |group: &str, unit: &str, of: &dyn Fn(&Change) -> f64| {
                let after: Vec<_> = self.all.iter().map(|one| [None, one.regions[k].change.as_ref().map(of)]).collect();
                if after.iter().any(|a| a[1].is_some()) {
                    line(group, &r.name, unit, None, &after, "");
                }
            };
            change("volume", "mm^3", &|c| c.volume);
            change("displacement_mean", "mm", &|c| c.displacement_mean);
            change("displacement_max", "mm", &|c| c.displacement_max);
        }
        out
    }
}

fn change_table(title: String, measured: &Measurements) -> Table {
    let header = owned(&[&title, "area", "area / %", "volume", "mean displacement", "max displacement"]);
    let row = |r: &RegionMeasurement| {
        let area = r.after.map(|after| after.area - r.before.area);
        let share = area.filter(|_| r.before.area > 0.0).map(|d| 100.0 * d / r.before.area);
        let [volume, mean, max] =
            [r.change.map(|c| c.volume), r.change.map(|c| c.displacement_mean), r.change.map(|c| c.displacement_max)];
        vec![r.name.clone(), fixed(area, 1), fixed(share, 2), fixed(volume, 1), fixed(mean, 3), fixed(max, 3)]
    };
    let note = "Square and cubic millimetres, millimetres. The volume is what the surface sweeps from before to after, positive \
                outwards; the mean displacement is weighted by area.";
    let rows = measured.regions.iter().map(row).collect();
    Table { title, header, rows, note: note.to_owned() }
}

impl Measurements {
    fn columns<T>(&self, what: impl FnOnce(Columns<'_>) -> T) -> T {
        let names: Vec<String> = self.after.iter().map(|_| AFTER.to_owned()).collect();
        what(Columns { names: &names, all: std::slice::from_ref(self) })
    }

    /// Everything as CSV, all digits: `group,name,unit,before,after,difference,remark`.
    #[must_use]
    pub fn to_csv(&self) -> String {
        self.columns(|columns| columns.to_csv())
    }
}

/// The tables, aligned.
impl fmt::Display for Measurements {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.columns(|columns| show(f, &columns.tables()))
    }
}

impl Comparison {
    fn columns(&self) -> Columns<'_> {
        Columns { names: &self.names, all: &self.all }
    }

    pub(super) fn tables(&self) -> Vec<Table> {
        self.columns().tables()
    }

    /// Everything as CSV, all digits: `group,name,unit,before`, then each shape's value and difference, then `remark`.
    #[must_use]
    pub fn to_csv(&self) -> String {
        self.columns().to_csv()
    }
}

/// As [`Measurements`], unless there are several shapes after: then a list of them with their names.
impl Serialize for Comparison {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Named<'a> {
            name: &'a str,
            #[serde(flatten)]
            measured: &'a Measurements,
        }
        match &self.all[..] {
            [one] => one.serialize(serializer),
            all => {
                let named = self.names.iter().zip(all).map(|(name, measured)| Named { name, measured });
                serializer.collect_seq(named)
            }
        }
    }
}

/// The tables, aligned.
impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        show(f, &self.tables())
    }
}

fn show(f: &mut fmt::Formatter<'_>, tables: &[Table]) -> fmt::Result {
    for (k, table) in tables.iter().enumerate() {
        let lines = || std::iter::once(&table.header).chain(&table.rows);
        let text = |column: usize| column == 0 || matches!(&*table.header[column], "unit" | "remark");
        let width = |column: usize| lines().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..table.header.len()).map(width).collect();
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
