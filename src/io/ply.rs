//! PLY, the Stanford polygon format: ascii, binary little and big endian. Source: Greg Turk, "The PLY Polygon File
//! Format", 1994.
//!
//! Our own reader rather than `ply-rs-bw`: the header's counts are weighed against the size of the file before anything
//! is allocated, errors say which row of which element is missing at which byte or line, and one pass over the bytes
//! goes straight into positions and corners, where the crate hands over every property of every row by its name.
//!
//! Read are `vertex` (x, y, z; nx, ny, nz; red, green, blue; s, t or u, v) and `face` (vertex_indices or vertex_index, any number
//! of corners; texcoord, u and v of each corner or nothing, as MeshLab has them); other elements and properties are stepped over.

use std::collections::HashMap;
use std::io::Write;
use std::ops::Range;
use std::path::Path;

use super::error::{excerpt, without_mark};
use super::{MeshFile, Place, ReadError, WriteError, color_bytes, write_atomically};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Value of the first `size()` bytes, which the caller has made sure are there; every type fits in f64 exactly.
    #[inline]
    fn decode(self, b: &[u8], big: bool) -> f64 {
        macro_rules! number {
            ($type:ty, $($i:literal),*) => {{
                let bytes = [$(b[$i]),*];
                f64::from(if big { <$type>::from_be_bytes(bytes) } else { <$type>::from_le_bytes(bytes) })
            }};
        }
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => number!(i16, 0, 1),
            Self::U16 => number!(u16, 0, 1),
            Self::I32 => number!(i32, 0, 1, 2, 3),
            Self::U32 => number!(u32, 0, 1, 2, 3),
            Self::F32 => number!(f32, 0, 1, 2, 3),
            Self::F64 => number!(f64, 0, 1, 2, 3, 4, 5, 6, 7),
        }
    }
}

#[derive(Debug, Clone)]
struct Property {
    name: String,
    /// Type of the length, for a list.
    count: Option<Scalar>,
    scalar: Scalar,
}

#[derive(Debug, Clone)]
struct Element {
    name: String,
    rows: usize,
    properties: Vec<Property>,
    line: usize,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

struct Header {
    format: Format,
    elements: Vec<Element>,
    /// First byte of the body.
    body: usize,
    /// Lines of the header.
    lines: usize,
}

/// Parses the bytes of a PLY file; `path` is only named in errors. Colours stored as floats are taken as 0-1, or as 0-255 where most are
/// above 1; as 16 bits as 0-65535.
///
/// # Errors
/// When the file is malformed: the message names the line (header, ascii) or byte (binary), what was expected and what was found. Counts
/// that the file is too short for are refused before anything is allocated.
pub fn parse_ply(bytes: &[u8], path: &Path) -> Result<MeshFile, ReadError> {
    let bytes = without_mark(bytes);
    let header = parse_header(bytes, path)?;
    let mut body = Body { bytes, path, at: header.body, line: header.lines, format: header.format };
    let mut ply = MeshFile::default();
    ply.mesh.starts.push(0);
    let mut seen_vertices = false;
    let mut seen_faces = false;
    for element in &header.elements {
        body.weigh(element)?;
        let header_error =
            |expected: &str, found: String| ReadError::malformed(path, Place::Line(element.line), expected, found);
        match element.name.as_str() {
            "vertex" if seen_vertices => return Err(header_error("one element vertex", "a second one".into())),
            "vertex" => {
                seen_vertices = true;
                body.vertices(element, &mut ply)?;
            }
            "face" if seen_faces => return Err(header_error("one element face", "a second one".into())),
            "face" => {
                seen_faces = true;
                body.faces(element, &mut ply.mesh)?;
            }
            "tristrips" if element.rows > 0 => {
                return Err(header_error("faces as element face", "triangle strips (element tristrips)".into()));
            }
            _ => body.skip(element)?,
        }
    }
    let vertices = ply.mesh.positions.len();
    if vertices == 0 {
        return Err(ReadError::malformed(path, Place::File, "vertices (element vertex)", "none"));
    }
    let metadata = &mut ply.mesh.metadata;
    if metadata.corner_uvs.is_empty() && metadata.uvs.len() == vertices {
        metadata.corner_uvs.clone_from(&ply.mesh.corners); // of vertices
    }
    for f in 0..ply.mesh.polygon_count() {
        if let Some(v) = ply.mesh.polygon(f).iter().find(|&&v| v as usize >= vertices) {
            let expected = format!("vertex indices from 0 to {} in face {f}", vertices - 1);
            return Err(ReadError::malformed(path, Place::File, expected, v.to_string()));
        }
    }
    Ok(ply)
}

/// The comment by which MeshLab and others name the image of a PLY file.
pub(super) const TEXTURE_FILE: &str = "TextureFile";

/// The images that the header names, with their lines.
pub(super) fn texture_files(bytes: &[u8]) -> Vec<(usize, String)> {
    let lines = without_mark(bytes).split(|b| *b == b'\n').map(<[u8]>::trim_ascii);
    let named = (1..).zip(lines).take_while(|(_, line)| *line != b"end_header").filter_map(|(number, line)| {
        let comment = line.strip_prefix(b"comment")?.trim_ascii();
        let name = comment.strip_prefix(TEXTURE_FILE.as_bytes()).filter(|name| name.starts_with(b" "))?;
        Some((number, String::from_utf8_lossy(name.trim_ascii()).into_owned()))
    });
    named.collect()
}

fn parse_header(bytes: &[u8], path: &Path) -> Result<Header, ReadError> {
    let mut at = 0;
    let mut lines = 0;
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let rest = &bytes[at..];
        let error = |line: usize, expected: &str, found: String| {
            Err(ReadError::malformed(path, Place::Line(line), expected, found))
        };
        let Some(length) = rest.iter().position(|&b| b == b'\n') else {
            let expected = if lines == 0 { "a PLY file, which starts with the line `ply`" } else { "`end_header`" };
            let found = if rest.is_empty() { "the end of the file".into() } else { excerpt(rest) };
            return error(lines + 1, expected, found);
        };
        at += length + 1;
        lines += 1;
        let line = rest[..length].trim_ascii();
        let mut words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        let keyword = words.next().unwrap_or_default();
        let words: Vec<&[u8]> = words.collect();
        match (keyword, words.as_slice()) {
            (b"ply", []) if lines == 1 => {}
            _ if lines == 1 => {
                return error(1, "a PLY file, which starts with the line `ply`", excerpt(line));
            }
            (b"comment" | b"obj_info" | b"", _) => {}
            (b"format", [name, b"1.0"]) => {
                format = Some(match *name {
                    b"ascii" => Format::Ascii,
                    b"binary_little_endian" => Format::Little,
                    b"binary_big_endian" => Format::Big,
                    _ => return error(lines, "ascii, binary_little_endian or binary_big_endian", excerpt(name)),
                });
            }
            (b"element", [name, count]) => {
                let rows = std::str::from_utf8(count).ok().and_then(|c| c.parse().ok());
                let Some(rows) = rows else { return error(lines, "the number of rows of an element", excerpt(count)) };
                let name = String::from_utf8_lossy(name).into_owned();
                elements.push(Element { name, rows, properties: Vec::new(), line: lines });
            }
            (b"property", types) => {
                let Some(element) = elements.last_mut() else {
                    return error(lines, "an element before its properties", excerpt(line));
                };
                let (count, scalar, name) = match types {
                    [b"list", count, scalar, name] => (Some(*count), *scalar, *name),
                    [scalar, name] => (None, *scalar, *name),
                    _ => return error(lines, "`property type name` or `property list type type name`", excerpt(line)),
                };
                let known = "one of char, uchar, short, ushort, int, uint, float, double";
                let Some(scalar) = Scalar::parse(scalar) else { return error(lines, known, excerpt(scalar)) };
                let count = match count.map(|c| (c, Scalar::parse(c))) {
                    None => None,
                    Some((_, Some(count))) => Some(count),
                    Some((c, None)) => return error(lines, known, excerpt(c)),
                };
                element.properties.push(Property { name: String::from_utf8_lossy(name).into_owned(), count, scalar });
            }
            (b"end_header", []) => {
                let Some(format) = format else { return error(lines, "a line `format ... 1.0`", "none".into()) };
                return Ok(Header { format, elements, body: at, lines });
            }
            _ => return error(lines, "format, element, property, comment or end_header", excerpt(line)),
        }
    }
}

/// A list that is read: its property, and its values in a row.
struct List {
    property: usize,
    values: Vec<f64>,
}

impl List {
    fn of(lists: &mut [Self], property: usize) -> Option<&mut Vec<f64>> {
        lists.iter_mut().find(|list| list.property == property).map(|list| &mut list.values)
    }
}

/// The bytes after the header, and where reading them has come to.
struct Body<'a> {
    bytes: &'a [u8],
    path: &'a Path,
    at: usize,
    line: usize,
    format: Format,
}

impl<'a> Body<'a> {
    fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        let place = if self.format == Format::Ascii { Place::Line(self.line) } else { Place::Byte(self.at) };
        ReadError::malformed(self.path, place, expected, found)
    }

    /// Refuses an element that the rest of the file is too short for.
    fn weigh(&self, element: &Element) -> Result<(), ReadError> {
        let ascii = self.format == Format::Ascii;
        let row: usize = element
            .properties
            .iter()
            .map(|p| if ascii { 2 } else { p.count.map_or(p.scalar.size(), Scalar::size) })
            .sum();
        let left = self.bytes.len() - self.at;
        // the last line of an ascii file may lack its line feed
        if element.rows.checked_mul(row).is_none_or(|needed| needed > left + usize::from(ascii)) {
            let at_least = if ascii || element.properties.iter().any(|p| p.count.is_some()) { "at least " } else { "" };
            let found = format!("{left} bytes, enough for at most {}", (left + usize::from(ascii)) / row.max(1));
            let expected = format!("{} rows of element {} of {at_least}{row} bytes", element.rows, element.name);
            return Err(self.error(expected, found));
        }
        if element.properties.is_empty() && element.rows > 0 && ascii {
            return Err(self.error(format!("properties of element {}", element.name), "none"));
        }
        Ok(())
    }

    /// Reads one row: `values` gets the scalars in order of property.
    fn row(
        &mut self,
        element: &Element,
        index: usize,
        values: &mut [f64],
        lists: &mut [List],
    ) -> Result<(), ReadError> {
        lists.iter_mut().for_each(|list| list.values.clear());
        if self.format == Format::Ascii {
            self.ascii_row(element, index, values, lists)
        } else {
            self.binary_row(element, index, values, lists)
        }
    }

    fn binary_row(
        &mut self,
        element: &Element,
        index: usize,
        values: &mut [f64],
        lists: &mut [List],
    ) -> Result<(), ReadError> {
        let big = self.format == Format::Big;
        for (p, property) in element.properties.iter().enumerate() {
            let size = property.scalar.size();
            let Some(count_type) = property.count else {
                let bytes = self.take(size, element, index, &property.name)?;
                values[p] = property.scalar.decode(bytes, big);
                continue;
            };
            let bytes = self.take(count_type.size(), element, index, &property.name)?;
            let count = count_type.decode(bytes, big);
            let count = self.list_length(count, element, index, property)?;
            let bytes = self.take(count.saturating_mul(size), element, index, &property.name)?;
            if let Some(list) = List::of(lists, p) {
                list.extend(bytes.chunks_exact(size).map(|b| property.scalar.decode(b, big)));
            }
        }
        Ok(())
    }

    fn list_length(&self, count: f64, e: &Element, index: usize, p: &Property) -> Result<usize, ReadError> {
        if count >= 0.0 && count.fract() == 0.0 && count <= 9e15 {
            return Ok(count as usize);
        }
        Err(self
            .error(format!("the length of list {} in row {index} of element {}", p.name, e.name), count.to_string()))
    }

    fn take(&mut self, size: usize, element: &Element, index: usize, name: &str) -> Result<&'a [u8], ReadError> {
        let left = &self.bytes[self.at..];
        if size > left.len() {
            let (of, rows) = (&element.name, element.rows);
            let expected = format!("{size} bytes of property {name} in row {index} of {rows} of element {of}");
            return Err(self.error(expected, format!("the end of the file after {} bytes", left.len())));
        }
        self.at += size;
        Ok(&left[..size])
    }

    fn ascii_row(
        &mut self,
        element: &Element,
        index: usize,
        values: &mut [f64],
        lists: &mut [List],
    ) -> Result<(), ReadError> {
        let (of, rows) = (&element.name, element.rows);
        let line = loop {
            let rest = &self.bytes[self.at..];
            self.line += 1;
            if rest.is_empty() {
                return Err(self.error(format!("row {index} of {rows} of element {of}"), "the end of the file"));
            }
            let length = rest.iter().position(|&b| b == b'\n');
            self.at += length.map_or(rest.len(), |l| l + 1);
            let line = rest[..length.unwrap_or(rest.len())].trim_ascii();
            if !line.is_empty() {
                break line;
            }
        };
        let mut words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        for (p, property) in element.properties.iter().enumerate() {
            let mut number = || -> Result<f64, ReadError> {
                let expected = || format!("property {} in row {index} of element {of}", property.name);
                let word = words.next().ok_or_else(|| self.error(expected(), format!("only {}", excerpt(line))))?;
                let value = std::str::from_utf8(word).ok().and_then(|w| w.parse().ok());
                value.ok_or_else(|| self.error(expected(), excerpt(word)))
            };
            let first = number()?;
            if property.count.is_none() {
                values[p] = first;
                continue;
            }
            for _ in 0..self.list_length(first, element, index, property)? {
                let value = number()?;
                if let Some(list) = List::of(lists, p) {
                    list.push(value);
                }
            }
        }
        if let Some(word) = words.next() {
            return Err(self.error(format!("the end of row {index} of element {of}"), excerpt(word)));
        }
        Ok(())
    }

    fn vertices(&mut self, element: &Element, ply: &mut MeshFile) -> Result<(), ReadError> {
        let find = |name: &str| element.properties.iter().position(|p| p.name == name && p.count.is_none());
        let find3 = |a, b, c| Some([find(a)?, find(b)?, find(c)?]);
        let Some(xyz) = find3("x", "y", "z") else {
            let names: Vec<_> = element.properties.iter().map(|p| p.name.as_str()).collect();
            let place = Place::Line(element.line);
            return Err(ReadError::malformed(self.path, place, "vertex properties x, y, z", names.join(", ")));
        };
        let normal = find3("nx", "ny", "nz").or_else(|| find3("normal_x", "normal_y", "normal_z"));
        let color = find3("red", "green", "blue").or_else(|| find3("diffuse_red", "diffuse_green", "diffuse_blue"));
        let color = color.or_else(|| find3("r", "g", "b"));
        let is_float = |i: usize| matches!(element.properties[i].scalar, Scalar::F32 | Scalar::F64);
        let mut floats = Vec::new();
        let find2 = |a, b| Some([find(a)?, find(b)?]);
        let uv = [("s", "t"), ("u", "v"), ("texture_u", "texture_v")].into_iter().find_map(|(a, b)| find2(a, b));
        if u32::try_from(element.rows).is_err() {
            return Err(self.error("fewer than 2^32 vertices", element.rows.to_string()));
        }
        // rows are at least a byte long, so these cannot exceed a small multiple of the file
        ply.mesh.positions.reserve(element.rows);
        let mut normals = Vec::with_capacity(if normal.is_some() { element.rows } else { 0 });
        let mut colors = Vec::with_capacity(if color.is_some() { element.rows } else { 0 });
        let mut values = vec![0.0; element.properties.len()];
        for index in 0..element.rows {
            let start = self.at;
            self.row(element, index, &mut values, &mut [])?;
            let [x, y, z] = xyz.map(|i| values[i]);
            if !(x.is_finite() && y.is_finite() && z.is_finite()) {
                self.at = start;
                return Err(self.error(format!("finite coordinates of vertex {index}"), format!("{x}, {y}, {z}")));
            }
            ply.mesh.positions.push(Vec3::new(x, y, z));
            if let Some(normal) = normal {
                let n = Vec3::from(normal.map(|i| values[i]));
                normals.push(if n.iter().all(|x| x.is_finite()) { n } else { Vec3::zeros() });
            }
            if let Some(uv) = uv {
                ply.mesh.metadata.uvs.push(self.uv(uv.map(|i| values[i]), start, || format!("vertex {index}"))?);
            }
            if let Some(color) = color {
                if color.into_iter().any(is_float) {
                    floats.push(color.map(|i| values[i] as f32));
                    continue;
                }
                colors.push(color.map(|i| match element.properties[i].scalar {
                    Scalar::I16 | Scalar::U16 => (values[i] / 257.0).round() as u8,
                    _ => values[i] as u8,
                }));
            }
        }
        colors.extend(color_bytes(&floats));
        ply.normals = normal.map(|_| normals);
        ply.colors = color.map(|_| colors);
        Ok(())
    }

    /// Texture coordinates of something in the row that starts at a byte.
    fn uv(&mut self, uv: [f64; 2], start: usize, what: impl Fn() -> String) -> Result<[f64; 2], ReadError> {
        if uv.iter().all(|x| x.is_finite()) {
            return Ok(uv);
        }
        self.at = start;
        Err(self.error(format!("finite texture coordinates of {}", what()), format!("{}, {}", uv[0], uv[1])))
    }

    fn faces(&mut self, element: &Element, mesh: &mut PolygonMesh) -> Result<(), ReadError> {
        if element.rows == 0 {
            return Ok(());
        }
        let find = |names: &[&str]| {
            element.properties.iter().position(|p| p.count.is_some() && names.contains(&p.name.as_str()))
        };
        let list = |property: usize| List { property, values: Vec::new() };
        let Some(corners) = find(&["vertex_indices", "vertex_index"]).map(list) else {
            let place = Place::Line(element.line);
            return Err(ReadError::malformed(self.path, place, "a list vertex_indices in element face", "none"));
        };
        mesh.starts.reserve(element.rows);
        let count = mesh.positions.len();
        // faces before vertices are checked at the end
        let limit = if count == 0 { f64::from(u32::MAX) } else { count as f64 };
        let texcoords = find(&["texcoord"]).map(list);
        let mut texture = texcoords.is_some().then(CornerUvs::default);
        let mut lists: Vec<List> = std::iter::once(corners).chain(texcoords).collect();
        let mut values = vec![0.0; element.properties.len()];
        for index in 0..element.rows {
            let start = self.at;
            self.row(element, index, &mut values, &mut lists)?;
            let corners = &lists[0].values;
            if corners.len() < 3 {
                self.at = start;
                return Err(self.error(format!("at least 3 corners in face {index}"), corners.len().to_string()));
            }
            for &corner in corners {
                if !(corner >= 0.0 && corner < limit && corner.fract() == 0.0) {
                    self.at = start;
                    let expected = format!("vertex indices from 0 to {} in face {index}", limit - 1.0);
                    return Err(self.error(expected, corner.to_string()));
                }
                mesh.corners.push(corner as u32);
            }
            let Ok(end) = u32::try_from(mesh.corners.len()) else {
                return Err(self.error("fewer than 2^32 corners", "more"));
            };
            mesh.starts.push(end);
            if let Some(texture) = &mut texture {
                let (flat, corners) = (&lists[1].values, &lists[0].values);
                if !flat.is_empty() && flat.len() != 2 * corners.len() {
                    self.at = start;
                    let expected = format!("{} texture coordinates of face {index}, or none", 2 * corners.len());
                    return Err(self.error(expected, flat.len().to_string()));
                }
                for (c, &vertex) in corners.iter().enumerate() {
                    let uv =
                        flat.get(2 * c..2 * c + 2).map(|uv| self.uv([uv[0], uv[1]], start, || format!("face {index}")));
                    texture.push(vertex as u32, uv.transpose()?);
                }
            }
        }
        if let Some(CornerUvs { uvs, of_corner, .. }) = texture {
            (mesh.metadata.uvs, mesh.metadata.corner_uvs) = (uvs, of_corner);
        }
        Ok(())
    }

    fn skip(&mut self, element: &Element) -> Result<(), ReadError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        if self.format != Format::Ascii && element.properties.iter().all(|p| p.count.is_none()) {
            // weighed before
            self.at += element.rows * element.properties.iter().map(|p| p.scalar.size()).sum::<usize>();
            return Ok(());
        }
        let mut values = vec![0.0; element.properties.len()];
        for index in 0..element.rows {
            self.row(element, index, &mut values, &mut [])?;
        }
        Ok(())
    }
}

/// Texture coordinates of corners, those of one vertex that are the same kept once.
#[derive(Default)]
struct CornerUvs {
    uvs: Vec<[f64; 2]>,
    of_corner: Vec<u32>,
    known: HashMap<(u32, [u64; 2]), u32>,
}

impl CornerUvs {
    fn push(&mut self, vertex: u32, uv: Option<[f64; 2]>) {
        let index = uv.map(|uv| {
            *self.known.entry((vertex, uv.map(f64::to_bits))).or_insert_with(|| {
                self.uvs.push(uv);
                self.uvs.len() as u32 - 1
            })
        });
        self.of_corner.push(index.unwrap_or(u32::MAX));
    }
}

/// How coordinates are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlyPrecision {
    /// 32 bits: what scanners and viewers use, 8 micrometres at a distance of 100 metres.
    #[default]
    Float,
    /// 64 bits: reads back as the same bits.
    Double,
}

/// What to write besides positions and faces.
#[derive(Debug, Clone, Copy, Default)]
pub struct PlyOptions<'a> {
    /// A normal per vertex.
    pub normals: Option<&'a [Vec3]>,
    /// Red, green, blue per vertex.
    pub colors: Option<&'a [[u8; 3]]>,
    /// Storage of coordinates and normals.
    pub precision: PlyPrecision,
}

/// Writes triangles (or a point cloud) as binary little-endian PLY.
///
/// # Errors
/// When the file cannot be written, or coordinates are not finite, or normals or colours not one per vertex.
pub fn write_ply(path: &Path, mesh: &TriangleMesh, options: PlyOptions<'_>) -> Result<(), WriteError> {
    let faces = mesh.triangles.iter().map(<[u32; 3]>::as_slice);
    write_faces(path, &mesh.positions, mesh.triangles.len(), 3, faces, None, options)
}

/// Writes polygons as binary little-endian PLY, texture coordinates of corners as MeshLab does: none of a polygon that has none,
/// 0, 0 of a corner that alone has none. Groups and materials have no place in it.
///
/// # Errors
/// As [`write_ply`]; and when texture indices do not belong to the corners.
pub fn write_ply_polygons(path: &Path, mesh: &PolygonMesh, options: PlyOptions<'_>) -> Result<(), WriteError> {
    let faces = (0..mesh.polygon_count()).map(|f| mesh.polygon(f));
    let largest = faces.clone().map(<[u32]>::len).max().unwrap_or(0);
    let metadata = &mesh.metadata;
    let textured = !metadata.corner_uvs.is_empty();
    WriteError::check_count(
        path,
        "texture indices",
        textured.then_some(metadata.corner_uvs.len()),
        mesh.corners.len(),
    )?;
    let uv = |c: u32| metadata.uvs.get(c as usize).copied().unwrap_or_default();
    let uvs_of = |corners: Range<usize>| -> Vec<[f64; 2]> {
        let of = &metadata.corner_uvs[corners];
        if of.iter().all(|&c| c == u32::MAX) { Vec::new() } else { of.iter().map(|&c| uv(c)).collect() }
    };
    let uvs_of: Option<&dyn Fn(Range<usize>) -> Vec<[f64; 2]>> = if textured { Some(&uvs_of) } else { None };
    write_faces(path, &mesh.positions, mesh.polygon_count(), largest, faces, uvs_of, options)
}

fn write_faces<'a>(
    path: &Path,
    positions: &[Vec3],
    face_count: usize,
    largest: usize,
    faces: impl Iterator<Item = &'a [u32]>,
    uvs_of: Option<&dyn Fn(Range<usize>) -> Vec<[f64; 2]>>,
    options: PlyOptions<'_>,
) -> Result<(), WriteError> {
    for (what, length) in
        [("normals", options.normals.map(<[Vec3]>::len)), ("colours", options.colors.map(<[[u8; 3]]>::len))]
    {
        WriteError::check_count(path, what, length, positions.len())?;
    }
    for (what, vectors) in [("coordinates", Some(positions)), ("normals", options.normals)] {
        let vectors = vectors.unwrap_or_default();
        if let Some(v) = vectors.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            let found = format!("{:?} at vertex {v}", vectors[v].as_slice());
            return Err(WriteError::data(path, format!("finite {what}"), found));
        }
    }
    let double = options.precision == PlyPrecision::Double;
    let scalar = if double { "double" } else { "float" };
    let wide = largest > if uvs_of.is_some() { 127 } else { 255 };
    write_atomically(path, |w| {
        write!(w, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", positions.len())?;
        let names = ["x", "y", "z", "nx", "ny", "nz"];
        for name in &names[..if options.normals.is_some() { 6 } else { 3 }] {
            writeln!(w, "property {scalar} {name}")?;
        }
        if options.colors.is_some() {
            w.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
        }
        if face_count > 0 {
            let count = if wide { "uint" } else { "uchar" };
            write!(w, "element face {face_count}\nproperty list {count} int vertex_indices\n")?;
            if uvs_of.is_some() {
                writeln!(w, "property list {count} float texcoord")?;
            }
        }
        w.write_all(b"end_header\n")?;
        let vector = |w: &mut std::io::BufWriter<std::fs::File>, v: &Vec3| {
            v.iter().try_for_each(|&x| {
                if double { w.write_all(&x.to_le_bytes()) } else { w.write_all(&(x as f32).to_le_bytes()) }
            })
        };
        for (i, p) in positions.iter().enumerate() {
            vector(w, p)?;
            if let Some(normals) = options.normals {
                vector(w, &normals[i])?;
            }
            if let Some(colors) = options.colors {
                w.write_all(&colors[i])?;
            }
        }
        let length = |w: &mut std::io::BufWriter<std::fs::File>, length: usize| {
            if wide { w.write_all(&(length as u32).to_le_bytes()) } else { w.write_all(&[length as u8]) }
        };
        let mut first = 0;
        for face in faces {
            length(w, face.len())?;
            for corner in face {
                w.write_all(&corner.to_le_bytes())?;
            }
            if let Some(uvs_of) = uvs_of {
                let uvs = uvs_of(first..first + face.len());
                length(w, 2 * uvs.len())?;
                for x in uvs.as_flattened() {
                    w.write_all(&(*x as f32).to_le_bytes())?;
                }
            }
            first += face.len();
        }
        Ok(())
    })
}
