//! Pairs of a template vertex, or a name, and a point: lines `vertex x y z`, with spaces or commas, `#` for comments. No unit
//! is stated.

use std::fmt::Write as _;
use std::path::Path;

use super::lines::Lines;
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, PlacedLandmark, ReadError};

pub(super) fn parse(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut set = LandmarkSet { format: LandmarkFormat::Text, named: true, ..LandmarkSet::default() };
    for line in Lines::new(text, path).filter(|l| !l.text.starts_with('#')) {
        let separator = |c: char| c.is_whitespace() || c == ',';
        let fields: Vec<&str> = line.text.split(separator).filter(|f| !f.is_empty()).collect();
        if fields.len() != 4 {
            return Err(line.error("a vertex or name and three coordinates", format!("{} fields", fields.len())));
        }
        let place = LandmarkPlace::Position(line.point(&fields[1..])?);
        set.landmarks.push(PlacedLandmark { name: fields[0].to_owned(), place, sigma: None });
    }
    Ok(set)
}

pub(super) fn render(set: &LandmarkSet) -> String {
    let mut out = String::new();
    for (landmark, p) in set.positions() {
        let _ = writeln!(out, "{} {} {} {}", landmark.name, p.x, p.y, p.z);
    }
    out
}
