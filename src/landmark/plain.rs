//! Plain JSON, one of
//! - `{ "name": entry, ... }`,
//! - `[entry, ...]` or `{ "points_mm": [[x, y, z], ...], ... }`, whose names are then "0", "1", ...,
//!
//! where an entry is a vertex index, `[x, y, z]`, or `[triangle, u, v]`: the point `P = A u + B v + C (1 - u - v)` of a
//! triangle of the fan triangulation, as FaceForm's Wrap writes named and nameless points on triangles
//! (<https://docs.faceform.com/Wrap/Nodes/SavePoints/SavePoints.html>). Arrays are taken as that when every one starts with
//! a whole number and 0 <= u, 0 <= v, u + v <= 1, and not all are on one triangle: then they are points in metres, with a whole x.

use std::fmt::Write as _;
use std::path::Path;

use super::json::{Json, wrong_entry};
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, LengthUnit, Place, PlacedLandmark, ReadError, Side};

pub(super) fn parse(json: Json, path: &Path, side: Side) -> Result<LandmarkSet, ReadError> {
    let mut only_points = false;
    let mut named = false;
    let mut unit = None;
    let entries = match json {
        Json::Array(items) => numbered(items),
        Json::Object(mut entries) => match entries.iter().position(|(name, _)| name == "points_mm") {
            Some(i) => {
                let Json::Array(items) = entries.swap_remove(i).1 else {
                    return Err(ReadError::malformed(path, Place::File, "an array \"points_mm\"", "something else"));
                };
                only_points = true;
                unit = Some(LengthUnit::Millimetre);
                numbered(items)
            }
            None => {
                named = true;
                entries
            }
        },
        other => return Err(ReadError::malformed(path, Place::File, side.whole(), other.kind())),
    };
    let on_triangles: Vec<Option<[f64; 3]>> =
        entries.iter().filter(|(_, e)| e.array().is_some()).map(|(_, e)| e.surface_point()).collect();
    let triangle = |at: &Option<[f64; 3]>| at.map(|[triangle, ..]| triangle);
    let on_one = on_triangles.len() > 1 && on_triangles.iter().all(|at| triangle(at) == triangle(&on_triangles[0]));
    let on_surface = !only_points && on_triangles.iter().all(Option::is_some) && !on_one;
    let mut format = LandmarkFormat::Points;
    let mut landmarks = Vec::with_capacity(entries.len());
    for (name, entry) in entries {
        let place = match &entry {
            Json::Number { value, integer: true } if !only_points => LandmarkPlace::Vertex(*value as i64),
            Json::Array(_) => match entry.surface_point().filter(|_| on_surface) {
                Some([triangle, u, v]) => {
                    format = LandmarkFormat::Wrap;
                    let barycentric = [u, v, (1.0 - u - v).max(0.0)];
                    LandmarkPlace::Face { triangle: triangle as u64, barycentric }
                }
                None => LandmarkPlace::Position(entry.point(path, &name, side.entry())?),
            },
            _ => return Err(wrong_entry(path, &name, side.entry(), entry.kind())),
        };
        landmarks.push(PlacedLandmark { name, place, sigma: None });
    }
    Ok(LandmarkSet { format, landmarks, named, unit, ..LandmarkSet::default() })
}

fn numbered(items: Vec<Json>) -> Vec<(String, Json)> {
    items.into_iter().enumerate().map(|(i, item)| (i.to_string(), item)).collect()
}

/// Names with positions, vertices or points on triangles.
pub(super) fn render(set: &LandmarkSet) -> String {
    let mut out = String::from("{");
    for (i, landmark) in set.landmarks.iter().enumerate() {
        let name = super::quoted(&landmark.name);
        let _ = write!(out, "{}\n  {name}: ", if i == 0 { "" } else { "," });
        let _ = match landmark.place {
            LandmarkPlace::Vertex(v) => write!(out, "{v}"),
            LandmarkPlace::Face { triangle, barycentric: [u, v, _] } => write!(out, "[{triangle}, {u:?}, {v:?}]"),
            LandmarkPlace::Position(p) => write!(out, "[{:?}, {:?}, {:?}]", p.x, p.y, p.z),
        };
    }
    out.push_str("\n}\n");
    out
}
