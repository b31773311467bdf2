//! This project's own landmark file: everything that [`LandmarkSet`] holds.
//!
//! ```json
//! {
//!   "unit": "mm",
//!   "landmarks": [
//!     {"name": "nasion", "vertex": 978, "sigma": 0.5},
//!     {"name": "menton", "face": 12, "barycentric": [0.2, 0.3, 0.5]},
//!     {"name": "gonion_left", "position": [61.5, -40.25, 12.0]}
//!   ]
//! }
//! ```
//!
//! `face` is a triangle of the fan triangulation, `barycentric` the weights of its corners. `unit` is mm, cm or m, may be
//! absent, and goes for `position` and `sigma`, the standard deviation of where the landmark is.

use std::fmt::Write as _;
use std::path::Path;

use super::json::{Json, wrong_entry};
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, LengthUnit, Place, PlacedLandmark, ReadError};

pub(super) fn is(json: &Json) -> bool {
    json.get("landmarks").and_then(Json::array).is_some_and(|l| l.iter().all(|l| matches!(l, Json::Object(_))))
}

pub(super) fn parse(json: &Json, path: &Path) -> Result<LandmarkSet, ReadError> {
    let unit = match json.get("unit") {
        None => None,
        Some(stated) => match stated.text().and_then(|t| t.parse::<LengthUnit>().ok()) {
            Some(unit) => Some(unit),
            None => {
                let found = stated.text().map_or_else(|| stated.kind(), |t| format!("{t:?}"));
                return Err(ReadError::malformed(path, Place::File, "a unit mm, cm or m", found));
            }
        },
    };
    let scale = unit.map_or(1.0, LengthUnit::millimetres);
    let mut landmarks = Vec::new();
    for (i, entry) in json.get("landmarks").and_then(Json::array).unwrap_or_default().iter().enumerate() {
        let Some(name) = entry.get("name").and_then(Json::text) else {
            return Err(wrong_entry(path, &i.to_string(), "a \"name\"", entry.kind()));
        };
        let wrong = |expected: &str, found: &Json| wrong_entry(path, name, expected, found.kind());
        let place = match (entry.get("vertex"), entry.get("face"), entry.get("position")) {
            (Some(vertex), None, None) => {
                LandmarkPlace::Vertex(vertex.whole().ok_or_else(|| wrong("a vertex index", vertex))? as i64)
            }
            (None, Some(face), None) => {
                let triangle = face.whole().filter(|t| *t >= 0.0).ok_or_else(|| wrong("a triangle index", face))?;
                let weights = entry.get("barycentric").unwrap_or(&Json::Null);
                let fits = |w: &[f64; 3]| w.iter().all(|x| *x >= 0.0) && (w.iter().sum::<f64>() - 1.0).abs() <= 1e-6;
                let expected = "three weights \"barycentric\", not negative, with sum 1,";
                let barycentric = weights.triple().filter(fits).ok_or_else(|| wrong(expected, weights))?;
                LandmarkPlace::Face { triangle: triangle as u64, barycentric }
            }
            (None, None, Some(position)) => {
                let p = position.point(path, name, "a position [x, y, z]")? * scale;
                if !p.iter().all(|c| c.is_finite()) {
                    return Err(wrong("a position that is finite in millimetres", position));
                }
                LandmarkPlace::Position(p)
            }
            _ => return Err(wrong("one of \"vertex\", \"face\" and \"position\"", entry)),
        };
        let sigma = match entry.get("sigma") {
            None => None,
            Some(sigma) => {
                let value = sigma.number().map(|s| scale * s).filter(|s| *s > 0.0 && s.is_finite());
                Some(value.ok_or_else(|| wrong("a positive \"sigma\"", sigma))?)
            }
        };
        landmarks.push(PlacedLandmark { name: name.to_owned(), place, sigma });
    }
    Ok(LandmarkSet { format: LandmarkFormat::Native, landmarks, named: true, unit, ..LandmarkSet::default() })
}

pub(super) fn render(set: &LandmarkSet) -> String {
    let mut out = String::from("{\n");
    if set.unit.is_some() {
        out.push_str("  \"unit\": \"mm\",\n");
    }
    out.push_str("  \"landmarks\": [");
    for (i, landmark) in set.landmarks.iter().enumerate() {
        let comma = if i == 0 { "" } else { "," };
        let _ = write!(out, "{comma}\n    {{\"name\": {}, ", super::quoted(&landmark.name));
        let _ = match landmark.place {
            LandmarkPlace::Vertex(v) => write!(out, "\"vertex\": {v}"),
            LandmarkPlace::Face { triangle, barycentric } => {
                write!(out, "\"face\": {triangle}, \"barycentric\": {barycentric:?}")
            }
            LandmarkPlace::Position(p) => write!(out, "\"position\": {:?}", p.as_slice()),
        };
        if let Some(sigma) = landmark.sigma {
            let _ = write!(out, ", \"sigma\": {sigma:?}");
        }
        out.push('}');
    }
    out.push_str("\n  ]\n}\n");
    out
}
