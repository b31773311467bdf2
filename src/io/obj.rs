//! Wavefront OBJ. Reads polygons, texture coordinates with seams, groups, materials, negative indices, continued lines;
//! writes them back with the same vertex order. Source: "Object Files (.obj)", Wavefront Advanced Visualizer manual,
//! appendix B1.
//!
//! Of normals (`vn`) it is kept which corners share one, not their values, which describe the shape before the deformation: what is
//! written has those of its own shape. Points, lines and free-form statements are skipped.
//!
//! Red, green and blue after the coordinates are no part of the manual, but MeshLab, Blender, ZBrush and others write and read
//! them. They are kept where every vertex has six numbers: from 0 to 1, or from 0 to 255 where most are above 1; sRGB.

use std::io::Write;
use std::path::Path;

use super::error::{excerpt, without_mark};
use super::{MeshFile, Place, ReadError, WriteError, color_bytes, write_atomically};
use crate::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3};
use crate::text::obj_line;

/// Parses the bytes of an OBJ file; `path` is only named in errors. Vertex indices are those of the file, counted from 0.
///
/// # Errors
/// When a number is malformed or not finite, an index is out of range, a face has fewer than three corners, or there are no vertices;
/// the message names the line.
pub fn parse_obj(bytes: &[u8], path: &Path) -> Result<PolygonMesh, ReadError> {
    parse_obj_file(bytes, path).map(|file| file.mesh)
}

/// [`parse_obj`] with colours, if the file has any.
pub(super) fn parse_obj_file(bytes: &[u8], path: &Path) -> Result<MeshFile, ReadError> {
    let mut parser =
        Parser { path, line: 0, mesh: PolygonMesh::default(), colors: Vec::new(), normals: 0, face_lines: Vec::new() };
    parser.mesh.starts.push(0);
    let mut number = 0;
    let mut joined: Vec<u8> = Vec::new(); // a logical line that spans several
    for line in without_mark(bytes).split(|&b| b == b'\n') {
        number += 1;
        let line = line.trim_ascii_end();
        let fresh = joined.is_empty();
        if fresh {
            parser.line = number;
        }
        if let Some(start) = line.strip_suffix(b"\\") {
            joined.extend_from_slice(start);
            joined.push(b' ');
        } else if fresh {
            parser.statement(line)?;
        } else {
            joined.extend_from_slice(line);
            let whole = std::mem::take(&mut joined);
            parser.statement(&whole)?;
        }
    }
    parser.statement(&joined)?;
    parser.finish()
}

struct Parser<'a> {
    path: &'a Path,
    line: usize,
    mesh: PolygonMesh,
    /// As in the file; fewer than vertices from the first on that has none.
    colors: Vec<[f64; 3]>,
    normals: usize,
    /// Line of every face: indices past the end may be explained by later lines, so they are checked last.
    face_lines: Vec<u32>,
}

impl Parser<'_> {
    fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError::malformed(self.path, Place::Line(self.line), expected, found)
    }

    fn statement(&mut self, line: &[u8]) -> Result<(), ReadError> {
        let line = line.trim_ascii();
        if line.first().is_none_or(|&b| b == b'#') {
            return Ok(());
        }
        let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (keyword, rest) = line.split_at(end);
        match keyword {
            b"v" => {
                let [x, y, z] = self.numbers::<3>(rest, 3, "vertex")?;
                if self.colors.len() == self.mesh.positions.len() {
                    self.colors.extend(color(rest));
                }
                self.mesh.positions.push(Vec3::new(x, y, z));
            }
            b"vt" => {
                let uv = self.numbers::<2>(rest, 1, "texture coordinate")?;
                self.mesh.metadata.uvs.push(uv);
            }
            b"vn" => {
                self.numbers::<3>(rest, 3, "normal")?;
                self.normals += 1;
            }
            b"f" | b"fo" => self.face(rest)?,
            b"mtllib" => self.mesh.metadata.material_libraries.push(text(rest)),
            b"o" => self.keep(ObjStatement::Object(text(rest))),
            b"g" => self.keep(ObjStatement::Group(text(rest))),
            b"usemtl" => self.keep(ObjStatement::Material(text(rest))),
            b"s" => self.keep(ObjStatement::Smoothing(text(rest))),
            _ => {}
        }
        Ok(())
    }

    fn keep(&mut self, statement: ObjStatement) {
        let polygon = self.mesh.polygon_count() as u32;
        self.mesh.metadata.statements.push((polygon, statement));
    }

    /// The first `N` numbers of a line; those past `required` may be missing and are then 0, further ones are ignored.
    fn numbers<const N: usize>(&self, rest: &[u8], required: usize, what: &str) -> Result<[f64; N], ReadError> {
        let mut values = [0.0; N];
        let mut tokens = tokens(rest);
        for (i, value) in values.iter_mut().enumerate() {
            let Some(token) = tokens.next() else {
                if i >= required {
                    break;
                }
                return Err(self.error(format!("{required} numbers for a {what}"), format!("{i}")));
            };
            let parsed: Option<f64> = std::str::from_utf8(token).ok().and_then(|t| t.parse().ok());
            *value = match parsed {
                Some(v) if v.is_finite() => v,
                Some(_) => return Err(self.error(format!("a finite number in a {what}"), excerpt(token))),
                None => return Err(self.error(format!("a number in a {what}"), excerpt(token))),
            };
        }
        Ok(values)
    }

    fn face(&mut self, rest: &[u8]) -> Result<(), ReadError> {
        let first = self.mesh.corners.len();
        for token in tokens(rest) {
            let mut parts = token.split(|&b| b == b'/');
            let vertex = self.index(parts.next().unwrap_or_default(), self.mesh.positions.len(), "vertex")?;
            self.mesh.corners.push(vertex);
            let uv = match parts.next() {
                None | Some(b"") => u32::MAX,
                Some(uv) => self.index(uv, self.mesh.metadata.uvs.len(), "texture")?,
            };
            keep_index(&mut self.mesh.metadata.corner_uvs, self.mesh.corners.len(), uv);
            let normal = match parts.next() {
                None | Some(b"") => u32::MAX,
                Some(normal) => self.index(normal, self.normals, "normal")?,
            };
            keep_index(&mut self.mesh.metadata.corner_normals, self.mesh.corners.len(), normal);
            if parts.next().is_some() {
                return Err(self.error("a corner as vertex/texture/normal", excerpt(token)));
            }
        }
        let count = self.mesh.corners.len() - first;
        if count < 3 {
            return Err(self.error("a face with at least 3 corners", format!("{count}")));
        }
        let Ok(end) = u32::try_from(self.mesh.corners.len()) else {
            return Err(self.error("fewer than 2^32 corners", "more"));
        };
        self.mesh.starts.push(end);
        self.face_lines.push(self.line as u32);
        Ok(())
    }

    /// An index counted from 1, or from the end if negative, as one counted from 0.
    fn index(&self, token: &[u8], count: usize, what: &str) -> Result<u32, ReadError> {
        let parsed: Option<i64> = std::str::from_utf8(token).ok().and_then(|t| t.parse().ok());
        let Some(value) = parsed else {
            return Err(self.error(format!("a {what} index"), excerpt(token)));
        };
        let index = if value < 0 { value.saturating_add(count as i64) } else { value - 1 };
        match u32::try_from(index) {
            Ok(index) if index != u32::MAX => Ok(index),
            _ => Err(self.error(format!("a {what} index from 1 to {count}"), format!("{value}"))),
        }
    }

    fn finish(mut self) -> Result<MeshFile, ReadError> {
        if self.mesh.positions.is_empty() {
            return Err(ReadError::malformed(self.path, Place::File, "vertices (lines `v x y z`)", "none"));
        }
        let ObjMetadata { corner_uvs, corner_normals, .. } = &mut self.mesh.metadata;
        for of_corners in [corner_uvs, corner_normals].into_iter().filter(|all| !all.is_empty()) {
            of_corners.resize(self.mesh.corners.len(), u32::MAX);
        }
        let (vertices, uvs) = (self.mesh.positions.len(), self.mesh.metadata.uvs.len());
        let range = |what: &str, count: usize| {
            if count == 0 {
                format!("no {what} index, as there is none")
            } else {
                format!("a {what} index from 1 to {count}")
            }
        };
        for f in 0..self.mesh.polygon_count() {
            self.line = self.face_lines[f] as usize;
            if let Some(v) = self.mesh.polygon(f).iter().find(|&&v| v as usize >= vertices) {
                return Err(self.error(range("vertex", vertices), format!("{}", u64::from(*v) + 1)));
            }
            if let Some(corners) =
                self.mesh.metadata.corner_uvs.get(self.mesh.starts[f] as usize..self.mesh.starts[f + 1] as usize)
                && let Some(uv) = corners.iter().find(|&&uv| uv != u32::MAX && uv as usize >= uvs)
            {
                return Err(self.error(range("texture", uvs), format!("{}", u64::from(*uv) + 1)));
            }
        }
        let colors = (self.colors.len() == vertices).then(|| color_bytes(&self.colors));
        Ok(MeshFile { colors, ..self.mesh.into() })
    }
}

/// Appends the index of the last of so many corners to those of all; none are kept while no corner has one.
fn keep_index(of_corners: &mut Vec<u32>, corners: usize, index: u32) {
    if index != u32::MAX || !of_corners.is_empty() {
        of_corners.resize(corners - 1, u32::MAX);
        of_corners.push(index);
    }
}

/// The last three of exactly six finite numbers.
fn color(rest: &[u8]) -> Option<[f64; 3]> {
    let mut numbers = tokens(rest).skip(3).map(|t| std::str::from_utf8(t).ok()?.parse().ok());
    let color: [f64; 3] = [numbers.next()??, numbers.next()??, numbers.next()??];
    (numbers.next().is_none() && color.iter().all(|c| c.is_finite())).then_some(color)
}

fn tokens(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|t| !t.is_empty())
}

fn text(rest: &[u8]) -> String {
    String::from_utf8_lossy(rest.trim_ascii()).into_owned()
}

/// Writes an OBJ file: vertices in their order, polygons, texture coordinates, normals, groups and materials. Numbers are the
/// shortest that read back as the same bits.
///
/// # Errors
/// When the file cannot be written, or indices of texture or normals do not belong to the corners.
pub fn write_obj(path: &Path, mesh: &PolygonMesh) -> Result<(), WriteError> {
    write_colored_obj(path, mesh, None)
}

/// [`write_obj`] with colours, to four decimals, which is more than their 8 bits.
pub(super) fn write_colored_obj(path: &Path, mesh: &PolygonMesh, colors: Option<&[[u8; 3]]>) -> Result<(), WriteError> {
    let metadata = &mesh.metadata;
    WriteError::check_count(path, "colours", colors.map(<[_]>::len), mesh.positions.len())?;
    for (what, indices) in
        [("a texture index", &metadata.corner_uvs), ("an index of a normal", &metadata.corner_normals)]
    {
        if !indices.is_empty() && indices.len() != mesh.corners.len() {
            let expected = format!("{what} for each of {} corners", mesh.corners.len());
            return Err(WriteError::data(path, expected, indices.len().to_string()));
        }
    }
    if let Some(v) = mesh.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        let found = format!("{:?} at vertex {v}", mesh.positions[v].as_slice());
        return Err(WriteError::data(path, "finite coordinates", found));
    }
    let (normals, corner_normals) = mesh.corner_normals();
    write_atomically(path, |w| {
        for library in &metadata.material_libraries {
            writeln!(w, "mtllib {}", obj_line(library))?;
        }
        for (i, p) in mesh.positions.iter().enumerate() {
            write!(w, "v {} {} {}", p.x, p.y, p.z)?;
            match colors.map(|c| c[i].map(|c| f64::from(c) / 255.0)) {
                Some([red, green, blue]) => writeln!(w, " {red:.4} {green:.4} {blue:.4}")?,
                None => w.write_all(b"\n")?,
            }
        }
        for [u, v] in &metadata.uvs {
            writeln!(w, "vt {u} {v}")?;
        }
        for n in &normals {
            writeln!(w, "vn {:.6} {:.6} {:.6}", n.x, n.y, n.z)?;
        }
        let mut statements = metadata.statements.iter().peekable();
        for f in 0..mesh.polygon_count() {
            while let Some((_, statement)) = statements.next_if(|(before, _)| *before as usize <= f) {
                write_statement(w, statement)?;
            }
            w.write_all(b"f")?;
            for c in mesh.starts[f] as usize..mesh.starts[f + 1] as usize {
                let v = u64::from(mesh.corners[c]) + 1;
                let of = |indices: &[u32]| indices.get(c).filter(|&&k| k != u32::MAX).map(|&k| u64::from(k) + 1);
                match (of(&metadata.corner_uvs), of(&corner_normals)) {
                    (Some(uv), Some(normal)) => write!(w, " {v}/{uv}/{normal}")?,
                    (None, Some(normal)) => write!(w, " {v}//{normal}")?,
                    (Some(uv), None) => write!(w, " {v}/{uv}")?,
                    (None, None) => write!(w, " {v}")?,
                }
            }
            w.write_all(b"\n")?;
        }
        statements.try_for_each(|(_, statement)| write_statement(w, statement))
    })
}

fn write_statement(w: &mut impl Write, statement: &ObjStatement) -> std::io::Result<()> {
    let (keyword, rest) = statement.parts();
    if rest.is_empty() { writeln!(w, "{keyword}") } else { writeln!(w, "{keyword} {}", obj_line(rest)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<PolygonMesh, ReadError> {
        parse_obj(text.as_bytes(), Path::new("a.obj"))
    }

    #[test]
    fn continuations_crlf_comments_and_negative_indices() {
        let text =
            "# c\r\nv 0 0 0\r\nv 1 0 0 # right\r\nv 1 1 \\\r\n 0\r\nv 0 1 0 0.5 0.5 0.5\r\n  f -4 -3 \\\r\n-2 4\r\n";
        let text = text.replace(" # right", "");
        let mesh = parse(&text).unwrap();
        assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        assert_eq!(mesh.corners, [0, 1, 2, 3]);
        assert_eq!(mesh.starts, [0, 4]);
    }

    #[test]
    fn the_line_of_a_continued_statement_is_its_first() {
        let message = parse("v 0 0 0\nv 1 \\\n 2 \\\n x\n").unwrap_err().to_string();
        assert!(message.starts_with("a.obj: line 2: "), "{message}");
    }

    #[test]
    fn textures_that_start_late_or_stop_early_leave_gaps() {
        let mesh = parse("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1 2 3\nf 1/1 2/1 3//\nf 1 2 3\n");
        assert!(mesh.is_ok());
        let none = u32::MAX;
        assert_eq!(mesh.unwrap().metadata.corner_uvs, [none, none, none, 0, 0, none, none, none, none]);
    }
}
