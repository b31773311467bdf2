//! Landmarks: pairs of a point on the template and a point in the scan's space, from JSON files.
//!
//! The **target** file holds the scan's side, one of
//! - `{ "name": [x, y, z], ... }`,
//! - `[[x, y, z], ...]` or `{ "points_mm": [[x, y, z], ...], ... }`, whose names are then "0", "1", ...,
//! - `{ "name": [triangle, u, v], ... }` on the scan's surface, P = A u + B v + C (1 - u - v), as FaceForm's Wrap writes
//!   them: taken as such when every entry starts with a whole number and 0 <= u, 0 <= v, u + v <= 1.
//!
//! The **template** file says what the names mean, one of
//! - `{ "name": vertex | [triangle, u, v] | [x, y, z], ... }` (a point in space is snapped to the nearest vertex),
//! - `[vertex, ...]`, whose names are then "0", "1", ....
//!
//! Without a template file the names have to be vertex indices of the template. Triangle indices refer to the fan
//! triangulation of the polygons, [`PolygonMesh::triangulate`]. Landmarks come in the order of the target file.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};

use super::error::read_file;
use super::{Place, ReadError};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};

/// A point fixed to the template.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TemplatePoint {
    /// A vertex.
    Vertex(u32),
    /// A point inside a triangle: the sum of `weights` times the corners' positions.
    Face {
        /// Vertex indices.
        corners: [u32; 3],
        /// Not negative, sum 1.
        weights: [f64; 3],
    },
}

impl TemplatePoint {
    /// Where the point is when the template's vertices are at `positions`.
    ///
    /// # Panics
    /// When `positions` has fewer vertices than the template.
    #[must_use]
    pub fn position(&self, positions: &[Vec3]) -> Vec3 {
        match self {
            Self::Vertex(v) => positions[*v as usize],
            Self::Face { corners, weights } => {
                let [a, b, c] = corners.map(|v| positions[v as usize]);
                a * weights[0] + b * weights[1] + c * weights[2]
            }
        }
    }
}

/// One pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Its name in the files.
    pub name: String,
    /// On the template.
    pub template: TemplatePoint,
    /// In the scan's space, millimetres.
    pub target: Vec3,
}

/// Reads the landmarks of `target`, resolved through the file `names` if there is one.
///
/// `scan` is needed for targets given as points on its triangles.
///
/// # Errors
/// When a file cannot be read or is not one of the forms above; on indices out of range, numbers that are not finite,
/// duplicate names, and names that the template file (or, without one, the template) does not have. The message names
/// the landmark. Too few landmarks are not an error here.
pub fn read_landmarks(
    target: &Path,
    names: Option<&Path>,
    template: &PolygonMesh,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<Landmark>, ReadError> {
    let bytes = read_file(target)?;
    let names = names.map(|path| Ok::<_, ReadError>((read_file(path)?, path))).transpose()?;
    parse_landmarks((&bytes, target), names.as_ref().map(|(bytes, path)| (&bytes[..], *path)), template, scan)
}

/// The bytes of a file, and its path, which is only named in errors.
pub type Source<'a> = (&'a [u8], &'a Path);

/// Parses the landmarks of `target`, resolved through `names` if there are any.
///
/// # Errors
/// As [`read_landmarks`].
pub fn parse_landmarks(
    target: Source<'_>,
    names: Option<Source<'_>>,
    template: &PolygonMesh,
    scan: Option<&TriangleMesh>,
) -> Result<Vec<Landmark>, ReadError> {
    let targets = parse_targets(target, scan)?;
    let target = target.1;
    let Some(names) = names else {
        if !targets.named {
            let expected = "named points, or a template landmark file that says which vertices the points belong to";
            return Err(ReadError::malformed(target, Place::File, expected, "an array of points"));
        }
        let vertices = template.positions.len();
        return targets
            .points
            .into_iter()
            .map(|(name, target_point)| {
                let plain = name == "0" || !(name.starts_with('0') || name.starts_with('+'));
                let index = if plain { name.parse::<u32>().ok() } else { None };
                match index {
                    Some(v) if (v as usize) < vertices => {
                        Ok(Landmark { name, template: TemplatePoint::Vertex(v), target: target_point })
                    }
                    Some(_) => Err(out_of_range(target, &name, "template vertex", name.clone(), vertices)),
                    None => {
                        let expected = "names that are template vertex indices (or a template landmark file)";
                        Err(ReadError::malformed(target, Place::File, expected, format!("{name:?}")))
                    }
                }
            })
            .collect();
    };
    let known = parse_template_landmarks(names, template)?;
    let names = names.1;
    if !targets.named && targets.points.len() != known.len() {
        let expected = format!("{} points, as many as {} has", known.len(), names.display());
        return Err(ReadError::malformed(target, Place::File, expected, targets.points.len().to_string()));
    }
    let by_name: HashMap<&str, TemplatePoint> = known.iter().map(|(name, point)| (name.as_str(), *point)).collect();
    targets
        .points
        .into_iter()
        .map(|(name, point)| match by_name.get(name.as_str()) {
            Some(template) => Ok(Landmark { name, template: *template, target: point }),
            None => {
                let list: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
                let expected = format!("landmarks that {} names: {}", names.display(), list.join(", "));
                Err(ReadError::malformed(target, Place::File, expected, format!("{name:?}")))
            }
        })
        .collect()
}

/// Reads a template landmark file: names and points in the order of the file.
///
/// # Errors
/// As [`read_landmarks`].
pub fn read_template_landmarks(path: &Path, template: &PolygonMesh) -> Result<Vec<(String, TemplatePoint)>, ReadError> {
    parse_template_landmarks((&read_file(path)?, path), template)
}

fn parse_template_landmarks(
    source: Source<'_>,
    template: &PolygonMesh,
) -> Result<Vec<(String, TemplatePoint)>, ReadError> {
    let path = source.1;
    let entries = match parse_json(source)? {
        Json::Object(entries) => unique(entries, path)?,
        Json::Array(items) => items.into_iter().enumerate().map(|(i, item)| (i.to_string(), item)).collect(),
        other => {
            let expected = "an object of named template points or an array of vertex indices";
            return Err(ReadError::malformed(path, Place::File, expected, other.kind()));
        }
    };
    let on_surface = entries.iter().all(|(_, e)| !matches!(e, Json::Array(_)) || e.surface_point().is_some());
    let triangles = if on_surface { template.triangulate().triangles } else { Vec::new() };
    let vertices = template.positions.len();
    let mut points = Vec::with_capacity(entries.len());
    for (name, entry) in entries {
        let point = match &entry {
            Json::Number { value, integer: true } => {
                if !(*value >= 0.0 && *value < vertices as f64) {
                    return Err(out_of_range(path, &name, "template vertex", value.to_string(), vertices));
                }
                TemplatePoint::Vertex(*value as u32)
            }
            Json::Array(_) if on_surface => {
                let Some((corners, weights)) = on_triangle(&entry, &name, &triangles, "template triangle", path)?
                else {
                    return Err(wrong_entry(path, &name, TEMPLATE_ENTRY, &entry));
                };
                TemplatePoint::Face { corners, weights }
            }
            Json::Array(_) => {
                let point = entry.point(path, &name, TEMPLATE_ENTRY)?;
                let nearest = template
                    .positions
                    .iter()
                    .enumerate()
                    .min_by(|(_, a), (_, b)| (*a - point).norm_squared().total_cmp(&(*b - point).norm_squared()));
                let Some((nearest, _)) = nearest else {
                    return Err(ReadError::malformed(path, Place::File, "a template with vertices", "none"));
                };
                TemplatePoint::Vertex(nearest as u32)
            }
            _ => return Err(wrong_entry(path, &name, TEMPLATE_ENTRY, &entry)),
        };
        points.push((name, point));
    }
    Ok(points)
}

const TEMPLATE_ENTRY: &str = "a vertex index, [triangle, u, v] or [x, y, z]";
const TARGET_ENTRY: &str = "[x, y, z] or [triangle, u, v]";

struct Targets {
    points: Vec<(String, Vec3)>,
    named: bool,
}

fn parse_targets(source: Source<'_>, scan: Option<&TriangleMesh>) -> Result<Targets, ReadError> {
    let path = source.1;
    let list = |items: Vec<Json>| -> Result<Targets, ReadError> {
        let mut points = Vec::with_capacity(items.len());
        for (i, item) in items.iter().enumerate() {
            let name = i.to_string();
            points.push((name.clone(), item.point(path, &name, "[x, y, z]")?));
        }
        Ok(Targets { points, named: false })
    };
    let mut entries = match parse_json(source)? {
        Json::Array(items) => return list(items),
        Json::Object(entries) => unique(entries, path)?,
        other => {
            let expected = "an object of named points or an array of points";
            return Err(ReadError::malformed(path, Place::File, expected, other.kind()));
        }
    };
    if let Some(i) = entries.iter().position(|(name, _)| name == "points_mm") {
        return match entries.swap_remove(i).1 {
            Json::Array(items) => list(items),
            other => Err(ReadError::malformed(path, Place::File, "an array \"points_mm\"", other.kind())),
        };
    }
    let on_surface = !entries.is_empty() && entries.iter().all(|(_, e)| e.surface_point().is_some());
    let mut points = Vec::with_capacity(entries.len());
    for (name, entry) in entries {
        let point = if on_surface {
            let Some(scan) = scan.filter(|s| !s.triangles.is_empty()) else {
                let expected = "points [x, y, z], or a scan with triangles for [triangle, u, v]";
                return Err(ReadError::malformed(path, Place::File, expected, format!("{name:?} as [triangle, u, v]")));
            };
            let Some((corners, weights)) = on_triangle(&entry, &name, &scan.triangles, "scan triangle", path)? else {
                return Err(wrong_entry(path, &name, TARGET_ENTRY, &entry));
            };
            if let Some(v) = corners.iter().find(|&&v| v as usize >= scan.positions.len()) {
                return Err(out_of_range(path, &name, "scan vertex", v.to_string(), scan.positions.len()));
            }
            TemplatePoint::Face { corners, weights }.position(&scan.positions)
        } else {
            entry.point(path, &name, TARGET_ENTRY)?
        };
        points.push((name, point));
    }
    Ok(Targets { points, named: true })
}

type OnTriangle = ([u32; 3], [f64; 3]);

fn on_triangle(
    entry: &Json,
    name: &str,
    triangles: &[[u32; 3]],
    what: &str,
    path: &Path,
) -> Result<Option<OnTriangle>, ReadError> {
    let Some((triangle, u, v)) = entry.surface_point() else { return Ok(None) };
    if triangle >= triangles.len() as f64 {
        return Err(out_of_range(path, name, what, triangle.to_string(), triangles.len()));
    }
    Ok(Some((triangles[triangle as usize], [u, v, (1.0 - u - v).max(0.0)])))
}

fn out_of_range(path: &Path, name: &str, what: &str, index: String, count: usize) -> ReadError {
    let expected = format!("a {what} index below {count} for landmark {name:?}");
    ReadError::malformed(path, Place::File, expected, index)
}

fn wrong_entry(path: &Path, name: &str, expected: &str, entry: &Json) -> ReadError {
    ReadError::malformed(path, Place::File, format!("{expected} for landmark {name:?}"), entry.kind())
}

fn unique(entries: Vec<(String, Json)>, path: &Path) -> Result<Vec<(String, Json)>, ReadError> {
    let mut names: Vec<&str> = entries.iter().map(|(name, _)| name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(ReadError::malformed(path, Place::File, "every name once", format!("{:?} twice", pair[0])));
    }
    Ok(entries)
}

fn parse_json((bytes, path): Source<'_>) -> Result<Json, ReadError> {
    serde_json::from_slice(bytes).map_err(|error| {
        let place = if error.line() == 0 { Place::File } else { Place::Line(error.line()) };
        ReadError::malformed(path, place, "JSON", error.to_string())
    })
}

/// A JSON value that keeps the order of names, duplicates, and whether a number was written as a whole one.
enum Json {
    Number { value: f64, integer: bool },
    Array(Vec<Json>),
    Object(Vec<(String, Json)>),
    Other(&'static str),
}

impl Json {
    fn kind(&self) -> String {
        match self {
            Self::Number { value, .. } => value.to_string(),
            Self::Array(items) => {
                let shown: Vec<String> = items.iter().take(4).map(Self::kind).collect();
                format!("[{}{}]", shown.join(", "), if items.len() > 4 { ", ..." } else { "" })
            }
            Self::Object(_) => "an object".to_owned(),
            Self::Other(kind) => (*kind).to_owned(),
        }
    }

    /// `[triangle, u, v]`.
    fn surface_point(&self) -> Option<(f64, f64, f64)> {
        let Self::Array(items) = self else { return None };
        let [
            Self::Number { value: triangle, integer: true },
            Self::Number { value: u, .. },
            Self::Number { value: v, .. },
        ] = items.as_slice()
        else {
            return None;
        };
        (*triangle >= 0.0 && *u >= 0.0 && *v >= 0.0 && u + v <= 1.0 + 1e-6).then_some((*triangle, *u, *v))
    }

    /// `[x, y, z]`.
    fn point(&self, path: &Path, name: &str, expected: &str) -> Result<Vec3, ReadError> {
        if let Self::Array(items) = self
            && let [Self::Number { value: x, .. }, Self::Number { value: y, .. }, Self::Number { value: z, .. }] =
                items.as_slice()
        {
            let point = Vec3::new(*x, *y, *z);
            if point.iter().all(|c| c.is_finite()) {
                return Ok(point);
            }
            return Err(wrong_entry(path, name, "finite coordinates", self));
        }
        Err(wrong_entry(path, name, expected, self))
    }
}

impl<'de> Deserialize<'de> for Json {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct JsonVisitor;
        impl<'de> Visitor<'de> for JsonVisitor {
            type Value = Json;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a JSON value")
            }
            fn visit_u64<E>(self, value: u64) -> Result<Json, E> {
                Ok(Json::Number { value: value as f64, integer: true })
            }
            fn visit_i64<E>(self, value: i64) -> Result<Json, E> {
                Ok(Json::Number { value: value as f64, integer: true })
            }
            fn visit_f64<E>(self, value: f64) -> Result<Json, E> {
                Ok(Json::Number { value, integer: false })
            }
            fn visit_bool<E>(self, _: bool) -> Result<Json, E> {
                Ok(Json::Other("true or false"))
            }
            fn visit_unit<E>(self) -> Result<Json, E> {
                Ok(Json::Other("null"))
            }
            fn visit_str<E>(self, _: &str) -> Result<Json, E> {
                Ok(Json::Other("a string"))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Json, A::Error> {
                let mut items = Vec::new();
                while let Some(item) = seq.next_element()? {
                    items.push(item);
                }
                Ok(Json::Array(items))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Json, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Json::Object(entries))
            }
        }
        deserializer.deserialize_any(JsonVisitor)
    }
}
