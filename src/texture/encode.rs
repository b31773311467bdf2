//! What was baked, as PNG files.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;

use super::Baked;
use crate::io::marked_png;
use crate::mesh::Vec3;
use crate::mesh::srgb::from_light;

/// The colours, in sRGB: 8 bits, or 16 if an image of the scan has as many. `None` without colours.
#[must_use]
pub fn encode_color(baked: &Baked) -> Option<Vec<u8>> {
    let light = baked.light.as_ref()?;
    if baked.sixteen_bits {
        let encoded = |c: f32| {
            let c = f64::from(c);
            let c = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
            ((c * 65535.0).round() as u16).to_ne_bytes() // `as` saturates
        };
        let bytes: Vec<u8> = light.par_iter().flat_map_iter(|c| c.map(encoded).into_iter().flatten()).collect();
        return png(baked.side, &bytes, ExtendedColorType::Rgb16);
    }
    // the least light of each colour but black: a search is faster than a power
    let half = |c: u8| {
        let c = (f64::from(c) - 0.5) / 255.0;
        (if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
    };
    let least: Vec<f32> = (1..=255u8).map(half).collect();
    let start: Vec<u8> = (0..=1024).map(|i| from_light(Vec3::repeat(f64::from(i) / 1024.0))[0]).collect();
    let encoded = |c: f32| {
        let c = c.clamp(0.0, 1.0);
        let mut code = start[(c * 1024.0) as usize];
        while code < 255 && c >= least[usize::from(code)] {
            code += 1;
        }
        while code > 0 && c < least[usize::from(code) - 1] {
            code -= 1;
        }
        code
    };
    let mut bytes = vec![0; 3 * light.len()];
    bytes.par_chunks_mut(3 << 12).zip(light.par_chunks(1 << 12)).for_each(|(bytes, light)| {
        bytes.iter_mut().zip(light.as_flattened()).for_each(|(b, c)| *b = encoded(*c));
    });
    png(baked.side, &bytes, ExtendedColorType::Rgb8)
}

/// Where the colours come from, in grey: 255 seen on the scan, 128 on the template but not seen and filled from round it, 0 off the
/// template.
#[must_use]
pub fn encode_seen(baked: &Baked) -> Option<Vec<u8>> {
    let grey = baked.seen.iter().zip(&baked.covered).map(|(seen, covered)| match (seen, covered) {
        (true, _) => 255,
        (false, true) => 128,
        (false, false) => 0,
    });
    png(baked.side, &grey.collect::<Vec<u8>>(), ExtendedColorType::L8)
}

/// Normals in tangent space, 8 bits: red along u, green along v upwards (as OpenGL, glTF and Blender have it), blue outwards, each from
/// -1 to 1. `None` if the shape was not baked.
#[must_use]
pub fn encode_normals(baked: &Baked) -> Option<Vec<u8>> {
    let shape = baked.shape.as_ref()?;
    let encoded = |s: &[f32; 4]| {
        let n = Vec3::new(f64::from(s[0]), f64::from(s[1]), f64::from(s[2]));
        let n = n.try_normalize(1e-6).unwrap_or_else(Vec3::z);
        <[f64; 3]>::from(n).map(|x| (127.5 + 127.5 * x).round() as u8)
    };
    let bytes: Vec<u8> = shape.par_iter().flat_map_iter(encoded).collect();
    png(baked.side, &bytes, ExtendedColorType::Rgb8)
}

/// How far along the template's normal the scan is, in grey of 16 bits: 0 is -`reach`, 1 is `reach`, the middle is on the template.
/// `None` if the shape was not baked.
#[must_use]
pub fn encode_displacement(baked: &Baked) -> Option<Vec<u8>> {
    let shape = baked.shape.as_ref()?;
    let encoded = |s: &[f32; 4]| {
        let share = 0.5 + 0.5 * f64::from(s[3]) / baked.reach;
        ((share * 65535.0).round() as u16).to_ne_bytes()
    };
    let bytes: Vec<u8> = shape.par_iter().flat_map_iter(encoded).collect();
    png(baked.side, &bytes, ExtendedColorType::L16)
}

/// Marked as ours. Memory always takes what the encoder writes, and the numbers of bytes are those of the size.
fn png(side: usize, bytes: &[u8], color: ExtendedColorType) -> Option<Vec<u8>> {
    let mut file = Vec::new();
    PngEncoder::new(&mut file).write_image(bytes, side as u32, side as u32, color).ok()?;
    Some(marked_png(file))
}
