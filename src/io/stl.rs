//! STL, binary and ascii: triangles without shared vertices. Source: 3D Systems, "StereoLithography Interface
//! Specification", 1989, as in <https://www.loc.gov/preservation/digital/formats/fdd/fdd000504.shtml>.
//!
//! Corners at exactly the same position become one vertex, numbered by first occurrence. A file is binary when its length is
//! that of the triangles it counts, whatever its header says; normals and attributes are skipped. No unit is stated.

use std::collections::HashMap;
use std::path::Path;

use super::error::{excerpt, without_mark};
use super::{Place, ReadError};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3, place};

const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// Parses the bytes of an STL file; `path` is only named in errors.
///
/// # Errors
/// When the file is malformed, a coordinate is not finite, or there are no triangles; the message names the line or byte.
pub fn parse_stl(bytes: &[u8], path: &Path) -> Result<PolygonMesh, ReadError> {
    let count = bytes.get(80..HEADER).and_then(|c| c.try_into().ok()).map(u32::from_le_bytes);
    let length = count.map(|n| HEADER as u64 + TRIANGLE as u64 * u64::from(n));
    let text = without_mark(bytes);
    let mut merged = Merged::default();
    if length == Some(bytes.len() as u64) {
        binary(bytes, path, &mut merged)?;
    } else if text.trim_ascii_start().get(..5).is_some_and(|w| w.eq_ignore_ascii_case(b"solid")) {
        ascii(text, path, &mut merged)?;
    } else {
        let expected = match (count, length) {
            (Some(count), Some(length)) => format!("{length} bytes for {count} triangles"),
            _ => format!("`solid`, or at least {HEADER} bytes"),
        };
        return Err(ReadError::malformed(path, Place::File, expected, format!("{} bytes", bytes.len())));
    }
    if merged.mesh.triangles.is_empty() {
        return Err(ReadError::malformed(path, Place::File, "triangles", "none"));
    }
    Ok(merged.mesh.into())
}

#[derive(Default)]
struct Merged {
    mesh: TriangleMesh,
    vertices: HashMap<[u64; 3], u32>,
}

impl Merged {
    fn vertex(&mut self, p: Vec3) -> u32 {
        let next = self.mesh.positions.len() as u32;
        *self.vertices.entry(place(&p)).or_insert_with(|| {
            self.mesh.positions.push(p);
            next
        })
    }
}

fn binary(bytes: &[u8], path: &Path, merged: &mut Merged) -> Result<(), ReadError> {
    for (t, record) in bytes[HEADER..].chunks_exact(TRIANGLE).enumerate() {
        let mut corners = [0; 3];
        for (c, corner) in corners.iter_mut().enumerate() {
            let at = 12 + 12 * c;
            let number = |axis: usize| {
                let bytes = &record[at + 4 * axis..at + 4 * axis + 4];
                f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            };
            let p = Vec3::new(number(0), number(1), number(2));
            if !p.iter().all(|x| x.is_finite()) {
                let place = Place::Byte(HEADER + TRIANGLE * t + at);
                let found = format!("{:?} in triangle {t}", p.as_slice());
                return Err(ReadError::malformed(path, place, "finite coordinates", found));
            }
            *corner = merged.vertex(p);
        }
        merged.mesh.triangles.push(corners);
    }
    Ok(())
}

fn ascii(bytes: &[u8], path: &Path, merged: &mut Merged) -> Result<(), ReadError> {
    let mut corners: Vec<u32> = Vec::new();
    let mut last = 0;
    for (i, line) in bytes.split(|&b| b == b'\n').enumerate() {
        last = i + 1;
        let error =
            |expected: &str, found: &[u8]| ReadError::malformed(path, Place::Line(last), expected, excerpt(found));
        let mut words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        let Some(keyword) = words.next() else { continue };
        match keyword.to_ascii_lowercase().as_slice() {
            b"solid" | b"endsolid" | b"facet" | b"outer" | b"endloop" => {}
            b"vertex" => {
                let mut p = Vec3::zeros();
                for coordinate in &mut p {
                    let word = words.next().unwrap_or_default();
                    let parsed = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f64>().ok());
                    *coordinate = parsed.filter(|x| x.is_finite()).ok_or_else(|| error("a finite coordinate", word))?;
                }
                corners.push(merged.vertex(p));
            }
            b"endfacet" => {
                let triangle = <[u32; 3]>::try_from(corners.as_slice());
                let triangle = triangle.map_err(|_| {
                    let found = format!("{}", corners.len());
                    ReadError::malformed(path, Place::Line(last), "a facet with 3 vertices", found)
                })?;
                merged.mesh.triangles.push(triangle);
                corners.clear();
            }
            _ => return Err(error("solid, facet, outer loop, vertex, endloop, endfacet or endsolid", keyword)),
        }
    }
    if !corners.is_empty() {
        return Err(ReadError::malformed(path, Place::Line(last), "endfacet", "the end of the file"));
    }
    Ok(())
}
