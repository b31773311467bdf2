//! What a scan is painted with: materials and images, from the libraries (MTL) of OBJ files, from glTF and from PLY. Sources: "Material
//! Library File (.mtl)", Wavefront Advanced Visualizer manual, appendix B2; Khronos Group, "glTF 2.0 Specification", 3.9, and
//! `KHR_texture_transform`.
//!
//! Images are read but not decoded: that takes the feature `pictures`. Of an OBJ material with an image (`map_Kd`) the image alone
//! counts, as in most programs, for many write a black or grey `Kd` beside it; in glTF the factor multiplies the image.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::error::{excerpt, read_side_file, without_mark};
use super::{Place, ReadError, WriteError, ply, write_atomically};
use crate::mesh::srgb::to_light;
use crate::mesh::{ObjStatement, PolygonMesh, Vec3};
use crate::text::obj_line;

/// How the triangles of a surface are painted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Paint {
    /// Texture coordinates of the corners of each triangle, in the polygons' fans: u to the right, v upwards, (0, 0) the lower left
    /// corner of the image; NaN where a corner has none.
    pub uvs: Vec<[[f32; 2]; 3]>,
    /// Material of each triangle, `u32::MAX` for none.
    pub material_of: Vec<u32>,
    /// What there is to paint with.
    pub materials: Vec<Material>,
    /// Files of the images, each once.
    pub images: Vec<ImageFile>,
}

/// One material.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Its name, which may be empty in glTF.
    pub name: String,
    /// Its light, red, green, blue, from 0 to 1, by which that of the image is multiplied.
    pub light: Vec3,
    /// Index of its image.
    pub image: Option<usize>,
    /// What the image shows outside of its tile, along u and v.
    pub wrap: [Wrap; 2],
}

/// What an image shows outside of its tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Itself, again and again.
    #[default]
    Repeat,
    /// Its border.
    Clamp,
    /// Itself, every other time in the mirror.
    Mirror,
}

/// The bytes of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageFile {
    /// Where it was, for messages; the glTF file itself for images inside.
    pub path: PathBuf,
    /// What names it: file and line, or the number in glTF.
    pub named_by: String,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// The map of a material library that paints.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Map {
    pub name: String,
    /// What names it, and in which line.
    named_by: (&'static str, usize),
    offset: [f64; 2],
    scale: [f64; 2],
    clamp: bool,
}

impl Map {
    const fn new(name: String, named_by: (&'static str, usize)) -> Self {
        Self { name, named_by, offset: [0.0; 2], scale: [1.0; 2], clamp: false }
    }
}

/// A material as its library states it.
#[derive(Debug, Clone, PartialEq)]
struct Stated {
    name: String,
    color: [f64; 3],
    map: Option<Map>,
}

/// Materials of a library; what does not paint is skipped.
fn parse_mtl(bytes: &[u8], path: &Path) -> Result<Vec<Stated>, ReadError> {
    let mut found: Vec<Stated> = Vec::new();
    for (number, line) in (1..).zip(without_mark(bytes).split(|b| *b == b'\n')) {
        let text = String::from_utf8_lossy(line.trim_ascii()).into_owned();
        let (keyword, rest) = text.split_once([' ', '\t']).unwrap_or((&text, ""));
        let rest = rest.trim();
        let malformed =
            |expected: &str| Err(ReadError::malformed(path, Place::Line(number), expected, excerpt(line.trim_ascii())));
        match (keyword, found.last_mut()) {
            ("newmtl", _) => found.push(Stated { name: rest.to_owned(), color: [1.0; 3], map: None }),
            ("Kd" | "map_Kd", None) => return malformed("newmtl before it"),
            ("Kd", Some(material)) => {
                let numbers: Option<Vec<f64>> = rest.split_whitespace().map(|t| t.parse().ok()).collect();
                match numbers.unwrap_or_default()[..] {
                    [grey] if (0.0..=1.0).contains(&grey) => material.color = [grey; 3],
                    [r, g, b] if [r, g, b].iter().all(|c| (0.0..=1.0).contains(c)) => material.color = [r, g, b],
                    _ if rest.starts_with("spectral") || rest.starts_with("xyz") => {}
                    _ => return malformed("Kd with numbers from 0 to 1"),
                }
            }
            ("map_Kd", Some(material)) => match parse_map(rest, number) {
                Some(map) => material.map = Some(map),
                None => return malformed("map_Kd [options] file"),
            },
            _ => {}
        }
    }
    Ok(found)
}

/// What follows `map_Kd`.
pub(super) fn parse_map(rest: &str, line: usize) -> Option<Map> {
    let mut map = Map::new(String::new(), ("map_Kd", line));
    let mut left = rest;
    let next = |left: &mut &str| -> Option<String> {
        let (token, rest) = left.split_once(char::is_whitespace).unwrap_or((left, ""));
        let token = token.to_owned();
        *left = rest.trim_start();
        (!token.is_empty()).then_some(token)
    };
    while left.starts_with('-') {
        let before = left;
        let option = next(&mut left)?;
        // one to three numbers
        let mut numbers = |most: usize| {
            let mut values = Vec::new();
            while values.len() < most {
                let first = left.split_whitespace().next().and_then(|t| t.parse::<f64>().ok());
                let Some(value) = first.filter(|v| v.is_finite()) else { break };
                values.push(value);
                let _ = next(&mut left);
            }
            values
        };
        let pair = |values: &[f64], default: f64| [0, 1].map(|k| values.get(k).copied().unwrap_or(default));
        match option.as_str() {
            "-o" => map.offset = pair(&numbers(3), 0.0),
            "-s" => map.scale = pair(&numbers(3), 1.0),
            "-t" => drop(numbers(3)),
            "-mm" => drop(numbers(2)),
            "-bm" | "-boost" | "-texres" => drop(numbers(1)),
            "-clamp" => map.clamp = next(&mut left)? == "on",
            "-blendu" | "-blendv" | "-cc" | "-imfchan" | "-type" => drop(next(&mut left)?),
            _ => {
                left = before; // a name that starts so
                break;
            }
        }
    }
    map.name = left.trim().trim_matches('"').to_owned();
    (!map.name.is_empty()).then_some(map)
}

/// The file that another one names: where it says; or, as files move from computer to computer, of that name in the same folder.
/// What is not there stays what it was called.
pub(super) fn named_beside(path: &Path, name: &str) -> PathBuf {
    let folder = path.parent().unwrap_or(Path::new(""));
    let slashes = name.replace('\\', "/");
    let last = slashes.rsplit('/').next().unwrap_or_default();
    let places = [folder.join(name), folder.join(&slashes), folder.join(last)];
    let there = places.iter().find(|p| p.is_file());
    there.unwrap_or(&places[0]).clone()
}

/// The libraries that an OBJ file names. A statement may name several with spaces between them, and a name may have spaces.
pub(super) fn libraries(path: &Path, statements: &[String]) -> Vec<PathBuf> {
    let files = statements.iter().flat_map(|statement| {
        let whole = named_beside(path, statement);
        let parts: Vec<PathBuf> = statement.split_whitespace().map(|name| named_beside(path, name)).collect();
        if whole.is_file() || !parts.iter().any(|p| p.is_file()) { vec![whole] } else { parts }
    });
    let mut files: Vec<PathBuf> = files.collect();
    let mut seen = std::collections::HashSet::new();
    files.retain(|file| seen.insert(file.clone()));
    files
}

/// Every file that painting an OBJ file opens besides itself: libraries and images. What cannot be read names nothing.
pub(super) fn files_of_paint(path: &Path, statements: &[String]) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for library in libraries(path, statements) {
        let bytes = if library.is_file() { std::fs::read(&library).unwrap_or_default() } else { Vec::new() };
        let stated = parse_mtl(&bytes, &library).unwrap_or_default();
        files.extend(stated.into_iter().filter_map(|s| s.map).map(|map| named_beside(&library, &map.name)));
        files.push(library);
    }
    files.sort();
    files.dedup();
    files
}

/// The paint of an OBJ file's polygons, whose libraries and images are beside it; `None` if it names no library.
///
/// # Errors
/// When a library or an image is not there, a material of the polygons is in no library, or a library is malformed.
pub(super) fn paint_of_obj(path: &Path, mesh: &PolygonMesh) -> Result<Option<Paint>, ReadError> {
    let metadata = &mesh.metadata;
    if metadata.material_libraries.is_empty() {
        return Ok(None);
    }
    let mut stated: Vec<(PathBuf, Stated)> = Vec::new();
    for library in libraries(path, &metadata.material_libraries) {
        let bytes = read_side_file(&library);
        let bytes = bytes.map_err(|e| e.named_by(&format!("mtllib of {}", path.display())))?;
        let materials = parse_mtl(&bytes, &library)?;
        stated.extend(materials.into_iter().map(|m| (library.clone(), m)));
    }
    paint_of(path, mesh, &stated).map(Some)
}

/// The paint of a PLY file's polygons by the image that its header names, if it names one.
///
/// # Errors
/// When the image is not there, or the header names several.
pub(super) fn paint_of_ply(
    path: &Path,
    files: &[(usize, String)],
    mesh: &PolygonMesh,
) -> Result<Option<Paint>, ReadError> {
    match files {
        [] => Ok(None),
        [(line, name)] => {
            let map = Some(Map::new(name.clone(), (ply::TEXTURE_FILE, *line)));
            let stated = Stated { name: String::new(), color: [1.0; 3], map };
            paint_of(path, mesh, &[(path.to_owned(), stated)]).map(Some)
        }
        [_, (line, name), ..] => {
            let expected = "one TextureFile (save a scan with several as .obj or .glb)";
            Err(ReadError::malformed(path, Place::Line(*line), expected, name.clone()))
        }
    }
}

/// What a mesh from `path` is painted with, of materials with the files that state them.
fn paint_of(path: &Path, mesh: &PolygonMesh, stated: &[(PathBuf, Stated)]) -> Result<Paint, ReadError> {
    let metadata = &mesh.metadata;
    let mut paint = Paint::default();
    let mut maps: Vec<Option<Map>> = Vec::new();
    // the polygons' materials; images of others need not be there
    let material = |paint: &mut Paint, maps: &mut Vec<Option<Map>>, wanted: usize| -> Result<u32, ReadError> {
        let (library, stated) = &stated[wanted];
        if let Some(known) = paint.materials.iter().position(|m| m.name == stated.name) {
            return Ok(known as u32);
        }
        let image = stated.map.as_ref().map(|map| image_of(paint, library, map)).transpose()?;
        let wrap = if stated.map.as_ref().is_some_and(|m| m.clamp) { Wrap::Clamp } else { Wrap::Repeat };
        let light = match image {
            Some(_) => Vec3::repeat(1.0),
            None => to_light(stated.color.map(|c| (255.0 * c).round() as u8)),
        };
        paint.materials.push(Material { name: stated.name.clone(), light, image, wrap: [wrap; 2] });
        maps.push(stated.map.clone());
        Ok(paint.materials.len() as u32 - 1)
    };
    // without a statement: the only one that there is
    let mut current = if stated.len() == 1 { material(&mut paint, &mut maps, 0)? } else { u32::MAX };
    let mut statements = metadata.statements.iter().peekable();
    for f in 0..mesh.polygon_count() {
        while let Some((_, statement)) = statements.next_if(|(before, _)| *before as usize <= f) {
            let ObjStatement::Material(name) = statement else { continue };
            let Some(wanted) = stated.iter().position(|(_, s)| s.name == *name) else {
                let libraries: Vec<String> = metadata.material_libraries.clone();
                let expected = format!("material {name:?}, which polygons use, in mtllib {}", libraries.join(", "));
                let known: Vec<&str> = stated.iter().map(|(_, s)| s.name.as_str()).collect();
                return Err(ReadError::malformed(path, Place::File, expected, format!("{known:?}")));
            };
            current = material(&mut paint, &mut maps, wanted)?;
        }
        let map = maps.get(current as usize).and_then(Option::as_ref);
        let corners = mesh.starts[f] as usize..mesh.starts[f + 1] as usize;
        let uv = |c: usize| match metadata.corner_uvs.get(c) {
            Some(&uv) if uv != u32::MAX => {
                let uv = metadata.uvs[uv as usize];
                let moved = |map: &Map| [0, 1].map(|k| uv[k] * map.scale[k] + map.offset[k]);
                map.map_or(uv, moved).map(|x| x as f32)
            }
            _ => [f32::NAN; 2],
        };
        for c in corners.start + 1..corners.end - 1 {
            paint.uvs.push([uv(corners.start), uv(c), uv(c + 1)]);
            paint.material_of.push(current);
        }
    }
    Ok(paint)
}

/// Index of an image, read if it is a new one.
fn image_of(paint: &mut Paint, library: &Path, map: &Map) -> Result<usize, ReadError> {
    let (keyword, line) = map.named_by;
    let by = format!("{keyword} in line {line} of {}", library.display());
    if map.name.to_uppercase().contains("<UDIM>") {
        let expected =
            "an image for each material (tiles by <UDIM> are not read; give each tile a material of its own)";
        return Err(ReadError::malformed(library, Place::Line(line), expected, map.name.clone()));
    }
    let path = named_beside(library, &map.name);
    if let Some(known) = paint.images.iter().position(|image| image.path == path) {
        return Ok(known);
    }
    let bytes = read_side_file(&path).map_err(|e| e.named_by(&by))?;
    paint.images.push(ImageFile { path, named_by: by, bytes });
    Ok(paint.images.len() - 1)
}

/// Writes a material library in which each of the materials shows the same image, of that file name in the same folder.
///
/// # Errors
/// When the file cannot be written.
pub fn write_image_materials(path: &Path, materials: &[&str], image: &str) -> Result<(), WriteError> {
    write_atomically(path, |w| w.write_all(image_materials(materials, image).as_bytes()))
}

/// What [`write_image_materials`] writes.
pub(super) fn image_materials(materials: &[&str], image: &str) -> String {
    let of = |name: &&str| {
        let [name, image] = [*name, image].map(obj_line);
        format!("newmtl {name}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {image}\n\n")
    };
    materials.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Vec<Stated> {
        parse_mtl(text.as_bytes(), Path::new("a.mtl")).unwrap()
    }

    #[test]
    fn options_of_maps_names_with_spaces_and_what_does_not_paint() {
        let text = "# c\r\nnewmtl skin of me\r\nNs 10\r\nKd 0.5 0 1\r\nmap_Kd -o 0.25 0.5 -s 2 -clamp on -bm 1 my skin.png\r\n\
                    map_Ks other.png\nnewmtl plain\nKd 1 1 1\nnewmtl dash\n\tmap_Kd -mine.png";
        let found = parsed(text);
        let names: Vec<&str> = found.iter().map(|m| m.name.as_str()).collect();
        assert_eq!(names, ["skin of me", "plain", "dash"]);
        let map = found[0].map.as_ref().unwrap();
        assert_eq!((map.name.as_str(), map.named_by, map.clamp), ("my skin.png", ("map_Kd", 5), true));
        assert_eq!((map.offset, map.scale), ([0.25, 0.5], [2.0, 1.0]));
        assert_eq!(found[0].color, [0.5, 0.0, 1.0]);
        assert!(found[1].map.is_none());
        assert_eq!(found[2].map.as_ref().unwrap().name, "-mine.png");
        assert_eq!(parsed(&format!("\u{feff}newmtl a\n{text}")).len(), 4);
    }

    #[test]
    fn what_is_malformed_is_named_by_its_line() {
        for (text, line) in [("Kd 1 1 1", 1), ("newmtl a\nKd 1 x", 2), ("newmtl a\n\nmap_Kd -s 1 1 1", 3)] {
            let error = parse_mtl(text.as_bytes(), Path::new("a.mtl")).unwrap_err().to_string();
            assert!(error.starts_with(&format!("a.mtl: line {line}: ")), "{error}");
        }
    }
}
