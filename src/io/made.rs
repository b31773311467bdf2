//! Files beside a mesh that this program baked, told from those of others when the mesh itself was deleted: pictures by a mark that
//! holds for every byte of them, so that one that was painted over is not taken for ours; the material library by its text.

use std::path::Path;

use super::material::image_materials;
use super::{read_side_file, sha256};

/// The chunk that ends a PNG file.
const END: [u8; 12] = *b"\0\0\0\0IEND\xae\x42\x60\x82";

/// A PNG file, marked as ours: a last text chunk (tEXt) has the SHA-256 of all before it.
#[must_use]
pub fn marked_png(mut png: Vec<u8>) -> Vec<u8> {
    let Some(body) = png.strip_suffix(&END) else { return png };
    let (end, chunk) = (body.len(), format!("tEXtnonrigid\0{}", sha256(body)));
    let mut sum = flate2::Crc::new();
    sum.update(chunk.as_bytes());
    png.truncate(end);
    png.extend((chunk.len() as u32 - 4).to_be_bytes());
    png.extend(chunk.as_bytes());
    png.extend(sum.sum().to_be_bytes());
    png.extend(END);
    png
}

/// Whether a file beside a mesh is as it was baked.
#[must_use]
pub fn is_made(mesh: &Path, file: &Path) -> bool {
    let Ok(found) = read_side_file(file) else { return false };
    if file != mesh.with_extension("mtl") {
        // length, sum and all that is marked
        let mark = marked_png(END.to_vec()).len() - END.len();
        let body = found.len().checked_sub(mark + END.len()).and_then(|end| found.get(..end));
        return body.is_some_and(|body| marked_png([body, &END[..]].concat()) == found);
    }
    let Ok(text) = String::from_utf8(found) else { return false };
    let materials: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("newmtl ")).collect();
    let image = text.lines().find_map(|line| line.strip_prefix("map_Kd ")).unwrap_or_default();
    let stem = mesh.file_stem().unwrap_or_default().to_string_lossy();
    image == format!("{stem}_color.png") && image_materials(&materials, image) == text
}
