//! XYZ, point clouds as text, as MeshLab and CloudCompare write them: lines `x y z`, `x y z nx ny nz` or `x y z r g b`, with
//! spaces, commas or semicolons, `#` or `//` for comments. All lines have as many columns as the first.
//!
//! Three further columns are colours when all of them are whole numbers from 0 to 255 and one is above 1, or numbers from 0 to 1 that
//! are not of unit length, else normals. No unit is stated.

use std::path::Path;

use super::error::{excerpt, without_mark};
use super::{MeshFile, Place, ReadError};
use crate::mesh::Vec3;

/// Parses the bytes of an XYZ file; `path` is only named in errors.
///
/// # Errors
/// When a line has other than three or six columns, or a number is not one or not finite, or there are no points; the message
/// names the line.
pub fn parse_xyz(bytes: &[u8], path: &Path) -> Result<MeshFile, ReadError> {
    let mut file = MeshFile::default();
    let mut others: Vec<Vec3> = Vec::new();
    let mut columns = 0;
    for (i, line) in without_mark(bytes).split(|&b| b == b'\n').enumerate() {
        let error = |expected: String, found: String| ReadError::malformed(path, Place::Line(i + 1), expected, found);
        let line = line.trim_ascii();
        if line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//") {
            continue;
        }
        let mut numbers = [0.0; 6];
        let mut found = 0;
        for word in line.split(|b| b.is_ascii_whitespace() || b",;".contains(b)).filter(|w| !w.is_empty()) {
            let parsed = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f64>().ok()).filter(|x| x.is_finite());
            let number = parsed.ok_or_else(|| error("a finite number".into(), excerpt(word)))?;
            if let Some(slot) = numbers.get_mut(found) {
                *slot = number;
            }
            found += 1;
        }
        if file.mesh.positions.is_empty() {
            columns = found;
        }
        if found != columns || !(columns == 3 || columns == 6) {
            let expected = match columns {
                3 | 6 => format!("{columns} columns, as in the first line"),
                _ => "3 columns x y z, or 6 with normals or colours".to_owned(),
            };
            return Err(error(expected, format!("{found} columns")));
        }
        file.mesh.positions.push(Vec3::new(numbers[0], numbers[1], numbers[2]));
        if columns == 6 {
            others.push(Vec3::new(numbers[3], numbers[4], numbers[5]));
        }
    }
    if file.mesh.positions.is_empty() {
        return Err(ReadError::malformed(path, Place::File, "points (lines `x y z`)", "none"));
    }
    file.mesh.starts.push(0);
    let all = |channel: fn(&f64) -> bool| columns == 6 && others.iter().all(|o| o.iter().all(channel));
    let bytes = all(|c| (0.0..=255.0).contains(c) && c.fract() == 0.0) && others.iter().any(|o| o.max() > 1.0);
    let is_direction = |o: &Vec3| o.norm() == 0.0 || (o.norm() - 1.0).abs() < 0.05;
    let shares = all(|c| (0.0..=1.0).contains(c)) && !others.iter().all(is_direction);
    if bytes || shares {
        let full = if bytes { 1.0 } else { 255.0 };
        file.colors = Some(others.iter().map(|o| o.map(|c| (full * c).round() as u8).into()).collect());
    } else if columns == 6 {
        file.normals = Some(others);
    }
    Ok(file)
}
