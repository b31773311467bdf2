//! Scalismo's landmarks, as `LandmarkIO` of <https://github.com/unibas-gravis/scalismo> reads and writes them: JSON,
//! an array of `{"id", "coordinates", "description"?, "uncertainty"?: {"stddevs", "pcvectors"}}`, and CSV, lines `id,x,y,z`
//! with `#` for comments. Neither states a unit.
//!
//! Of an uncertainty the root mean square of the three deviations is kept as the landmark's sigma. A first CSV line
//! `label,x,y,z`, or with `l,p,s` or `r,a,s` as 3D Slicer exports tables, is a header, and may have further columns. A line of more
//! fields is refused: numbers with decimal commas have them.

use std::fmt::Write as _;
use std::path::Path;

use super::json::{Json, wrong_entry};
use super::lines::{Lines, split_quoted};
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, PatientSpace, PlacedLandmark, ReadError};
use crate::text::{csv_field, from_csv_field};

pub(super) fn is(json: &Json) -> bool {
    json.array().is_some_and(|items| {
        !items.is_empty() && items.iter().all(|i| i.get("id").is_some() || i.get("coordinates").is_some())
    })
}

pub(super) fn parse_json(json: &Json, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut landmarks = Vec::new();
    for (i, entry) in json.array().unwrap_or_default().iter().enumerate() {
        let Some(name) = entry.get("id").and_then(Json::text) else {
            return Err(wrong_entry(path, &i.to_string(), "an \"id\"", entry.kind()));
        };
        let expected = "\"coordinates\" [x, y, z]";
        let place =
            LandmarkPlace::Position(entry.get("coordinates").unwrap_or(&Json::Null).point(path, name, expected)?);
        let sigma = match entry.get("uncertainty") {
            None | Some(Json::Null) => None,
            Some(uncertainty) => {
                let deviations = uncertainty.get("stddevs").and_then(Json::triple);
                let positive = deviations.filter(|d| d.iter().all(|s| *s > 0.0));
                let sigma = positive.map(|d| (d.iter().map(|s| s * s).sum::<f64>() / 3.0).sqrt());
                let Some(sigma) = sigma.filter(|s| s.is_finite()) else {
                    return Err(wrong_entry(path, name, "three positive \"stddevs\"", uncertainty.kind()));
                };
                Some(sigma)
            }
        };
        landmarks.push(PlacedLandmark { name: name.to_owned(), place, sigma });
    }
    Ok(LandmarkSet { format: LandmarkFormat::ScalismoJson, landmarks, named: true, ..LandmarkSet::default() })
}

pub(super) fn parse_csv(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut set = LandmarkSet { format: LandmarkFormat::Csv, named: true, ..LandmarkSet::default() };
    let mut columns = 4;
    for (i, line) in Lines::new(text, path).filter(|l| !l.text.starts_with('#')).enumerate() {
        let fields = split_quoted(line.text);
        let axes = fields.get(1..4).map(|f| f.iter().map(|f| f.to_lowercase()).collect::<String>());
        let space = match axes.as_deref() {
            Some("xyz") => Some(None),
            Some("lps") => Some(Some(PatientSpace::Lps)),
            Some("ras") => Some(Some(PatientSpace::Ras)),
            _ => None,
        };
        if let Some(space) = space.filter(|_| i == 0) {
            (set.space, columns) = (space, fields.len());
            continue;
        }
        if axes.is_none() {
            return Err(line.error("a line `name,x,y,z`", format!("{} fields", fields.len())));
        }
        line.check_width(&fields, columns)?;
        let position = line.point(&fields[1..4])?;
        let place = LandmarkPlace::Position(set.space.map_or(position, |space| space.to_lps(position)));
        set.landmarks.push(PlacedLandmark { name: from_csv_field(&fields[0]).to_owned(), place, sigma: None });
    }
    Ok(set)
}

pub(super) fn render_json(set: &LandmarkSet) -> String {
    let mut out = String::from("[");
    for (i, (landmark, p)) in set.positions().enumerate() {
        let _ = write!(
            out,
            "{}\n  {{\"id\": {}, \"coordinates\": {:?}",
            if i == 0 { "" } else { "," },
            super::quoted(&landmark.name),
            p.as_slice()
        );
        if let Some(s) = landmark.sigma {
            let axes = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]";
            let _ = write!(out, ", \"uncertainty\": {{\"stddevs\": [{s:?}, {s:?}, {s:?}], \"pcvectors\": {axes}}}");
        }
        out.push('}');
    }
    out.push_str("\n]\n");
    out
}

pub(super) fn render_csv(set: &LandmarkSet) -> String {
    let mut out = String::new();
    for (landmark, p) in set.positions() {
        let _ = writeln!(out, "{},{},{},{}", csv_field(&landmark.name), p.x, p.y, p.z);
    }
    out
}
