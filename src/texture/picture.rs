//! Images of scans, decoded: PNG and JPEG.

use std::io::Cursor;

use image::{ColorType, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::PaintError;
use crate::io::{ImageFile, Wrap};
use crate::mesh::Vec3;
use crate::mesh::srgb::to_light;

/// Pixels of an image at most, 16384 x 16384.
const MOST_PIXELS: u64 = 1 << 28;
/// Bytes that one byte of a file may become: zlib's most is 1032.
const MOST_PER_BYTE: u64 = 2048;

/// What is worth a word about an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PictureKind {
    /// Its numbers have 16 bits; so has then what is baked.
    pub sixteen_bits: bool,
    /// It is made for print; the colours are converted without its profile.
    pub cmyk: bool,
    /// Some of it is transparent, which is no colour.
    pub holes: bool,
}

/// An image, as light, and reduced to half the size again and again.
#[derive(Debug)]
pub struct Picture {
    kind: PictureKind,
    size: [usize; 2],
    pixels: Pixels,
    /// Levels from half the size on.
    reduced: Vec<Level>,
}

/// Numbers as in the file, sRGB; with alpha where something is transparent.
#[derive(Debug)]
enum Pixels {
    Eight(Vec<[u8; 4]>),
    Sixteen(Vec<[u16; 4]>),
}

#[derive(Debug)]
struct Level {
    size: [usize; 2],
    /// Light, and the share of it that is there.
    light: Vec<[f32; 4]>,
}

/// Light of the numbers of 8 and 16 bits.
pub(super) struct Decoding {
    eight: Vec<f32>,
    sixteen: Vec<f32>,
}

impl Decoding {
    pub fn new(sixteen_bits: bool) -> Self {
        let eight = (0..=255u8).map(|c| to_light([c; 3]).x as f32).collect();
        let light = |c: u16| {
            let c = f64::from(c) / 65535.0;
            (if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
        };
        let sixteen = if sixteen_bits { (0..=u16::MAX).map(light).collect() } else { Vec::new() };
        Self { eight, sixteen }
    }
}

impl Picture {
    /// Decodes an image.
    ///
    /// # Errors
    /// When it is no PNG or JPEG, is damaged, or is larger than memory should have to hold.
    pub fn decode(file: &ImageFile) -> Result<Self, PaintError> {
        let refused = |found: String| PaintError::Image {
            path: file.path.clone(),
            named_by: file.named_by.clone(),
            found: found.trim_end().to_owned(),
        };
        let reader =
            ImageReader::new(Cursor::new(&file.bytes)).with_guessed_format().map_err(|e| refused(e.to_string()))?;
        let format = match reader.format() {
            Some(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            Some(other) => return Err(refused(format!("{other:?}, which is not read"))),
            None => return Err(refused("an unknown format".to_owned())),
        };
        let mut reader = ImageReader::with_format(Cursor::new(&file.bytes), format);
        reader.limits(Limits::no_limits());
        let decoder = reader.into_decoder().map_err(|e| refused(e.to_string()))?;
        let (width, height) = decoder.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if pixels == 0 || pixels > MOST_PIXELS || decoder.total_bytes() / MOST_PER_BYTE > file.bytes.len() as u64 {
            let of = format!("{width} x {height} pixels in {} bytes", file.bytes.len());
            return Err(refused(format!(
                "{of}; at most {MOST_PIXELS} pixels and {MOST_PER_BYTE} bytes of them a byte are read"
            )));
        }
        let sixteen_bits =
            matches!(decoder.color_type(), ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16);
        let cmyk = format == ImageFormat::Jpeg && jpeg_components(&file.bytes) == Some(4);
        let image = image::DynamicImage::from_decoder(decoder).map_err(|e| refused(e.to_string()))?;
        let holes;
        let pixels = if sixteen_bits {
            let pixels: Vec<[u16; 4]> = image.into_rgba16().pixels().map(|p| p.0).collect();
            holes = pixels.iter().any(|p| p[3] == 0) && pixels.iter().any(|p| p[3] != 0);
            Pixels::Sixteen(pixels)
        } else {
            let pixels: Vec<[u8; 4]> = image.into_rgba8().pixels().map(|p| p.0).collect();
            holes = pixels.iter().any(|p| p[3] == 0) && pixels.iter().any(|p| p[3] != 0);
            Pixels::Eight(pixels)
        };
        let size = [width as usize, height as usize];
        let kind = PictureKind { sixteen_bits, cmyk, holes };
        Ok(Self { kind, size, pixels, reduced: Vec::new() })
    }

    /// What is worth a word about it.
    #[must_use]
    pub fn kind(&self) -> PictureKind {
        self.kind
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Makes the reduced levels, each the mean of four pixels of the one before.
    pub(super) fn reduce(&mut self, decoding: &Decoding) {
        let mut size = self.size;
        while size != [1, 1] && self.reduced.len() < 12 {
            let half = size.map(|n| n.div_ceil(2));
            let mut light = vec![[0.0f32; 4]; half[0] * half[1]];
            let before = self.reduced.last();
            light.par_chunks_mut(half[0]).enumerate().for_each(|(y, row)| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let at = (2 * y + dy).min(size[1] - 1) * size[0] + (2 * x + dx).min(size[0] - 1);
                        let part = before.map_or_else(|| self.pixel(at, decoding), |level| level.light[at]);
                        (0..4).for_each(|k| pixel[k] += 0.25 * part[k]);
                    }
                }
            });
            self.reduced.push(Level { size: half, light });
            size = half;
        }
    }

    /// Light of a pixel times the share that is there, and that share.
    #[inline(always)]
    fn pixel(&self, at: usize, decoding: &Decoding) -> [f32; 4] {
        match &self.pixels {
            Pixels::Eight(pixels) => {
                let [r, g, b, a] = pixels[at];
                let light = [r, g, b].map(|c| decoding.eight[usize::from(c)]);
                self.there(light, a == 0)
            }
            Pixels::Sixteen(pixels) => {
                let [r, g, b, a] = pixels[at];
                let light = [r, g, b].map(|c| decoding.sixteen[usize::from(c)]);
                self.there(light, a == 0)
            }
        }
    }

    #[inline(always)]
    fn there(&self, [r, g, b]: [f32; 3], transparent: bool) -> [f32; 4] {
        if self.kind.holes && transparent { [0.0; 4] } else { [r, g, b, 1.0] }
    }

    /// The light at texture coordinates, linear between pixels of a level: 0 is the image itself, each further one half the size.
    /// `None` where it is transparent.
    pub(super) fn light(&self, uv: [f64; 2], wrap: [Wrap; 2], level: usize, decoding: &Decoding) -> Option<Vec3> {
        let level = level.min(self.reduced.len()).checked_sub(1).map(|l| &self.reduced[l]);
        let size = level.map_or(self.size, |l| l.size);
        let place = [uv[0] * size[0] as f64 - 0.5, (1.0 - uv[1]) * size[1] as f64 - 0.5];
        if !place.iter().all(|x| x.abs() < 1e9) {
            return None;
        }
        let low = place.map(f64::floor);
        let [s, t] = [0, 1].map(|k| (place[k] - low[k]) as f32);
        let [columns, rows] = [0, 1].map(|k| [0, 1].map(|step| wrapped(low[k] as i64 + step, size[k] as i64, wrap[k])));
        let mut sum = [0.0f32; 4];
        for (row, of_row) in rows.into_iter().zip([1.0 - t, t]) {
            for (column, of_column) in columns.into_iter().zip([1.0 - s, s]) {
                let at = row * size[0] + column;
                let part = level.map_or_else(|| self.pixel(at, decoding), |l| l.light[at]);
                (0..4).for_each(|k| sum[k] += of_row * of_column * part[k]);
            }
        }
        let [r, g, b, there] = sum.map(f64::from);
        (there > 0.25).then(|| Vec3::new(r, g, b) / there)
    }
}

/// The pixel that is shown in a place that may lie outside.
#[inline(always)]
fn wrapped(at: i64, size: i64, wrap: Wrap) -> usize {
    if (0..size).contains(&at) {
        return at as usize;
    }
    let inside = match wrap {
        Wrap::Repeat => at.rem_euclid(size),
        Wrap::Clamp => at.clamp(0, size - 1),
        Wrap::Mirror => {
            let twice = at.rem_euclid(2 * size);
            twice.min(2 * size - 1 - twice)
        }
    };
    inside as usize
}

/// Colour components of a JPEG file, by its frame header.
fn jpeg_components(bytes: &[u8]) -> Option<u8> {
    let mut at = 2;
    while *bytes.get(at)? == 0xff {
        let marker = *bytes.get(at + 1)?;
        match marker {
            0xff => at += 1,
            0x01 | 0xd0..=0xd8 => at += 2,
            0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return bytes.get(at + 9).copied(),
            _ => at += 2 + usize::from(u16::from_be_bytes([*bytes.get(at + 2)?, *bytes.get(at + 3)?])),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_outside_repeats_stops_or_turns_back() {
        let shown = |wrap| (-5..9).map(|at| wrapped(at, 3, wrap)).collect::<Vec<_>>();
        assert_eq!(shown(Wrap::Repeat), [1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2]);
        assert_eq!(shown(Wrap::Clamp), [0, 0, 0, 0, 0, 0, 1, 2, 2, 2, 2, 2, 2, 2]);
        assert_eq!(shown(Wrap::Mirror), [1, 2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1, 2]);
    }
}
