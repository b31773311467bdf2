//! Grey textures (Li et al. 2018, sections 1 and 1.2): what a mask is before it meets a mesh.

use std::io::{Cursor, Write};
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageFormat, Rgb, RgbImage};
use serde::{Deserialize, Serialize};

use super::MorphError;
use crate::io::{Place, ReadError, WriteError, read_file, write_atomically};

/// Longest side of a texture, pixels.
pub const MAX_TEXTURE_SIDE: usize = 1 << 15;

/// Most pixels of a texture: half a gigabyte of them.
pub const MAX_TEXTURE_PIXELS: usize = 1 << 26;

/// Grey values from 0 to 1, row by row from the **top** row, as image files have them.
///
/// Values are `f64`: forty blurs then keep sums to 1e-10, and the speed of a blur is that of arithmetic on 8 columns at a time
/// rather than of memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    width: usize,
    height: usize,
    grey: Vec<f64>,
}

/// `V_gray` of equation (3): what red, green and blue count for in a grey value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GreyWeights {
    /// (0.299, 0.587, 0.114), ITU-R BT.601: white is 1.
    #[default]
    Rec601,
    /// (0.229, 0.587, 0.114) as the paper prints it: white is 0.930.
    AsPrinted,
}

impl GreyWeights {
    /// The three weights.
    #[must_use]
    pub fn vector(self) -> [f64; 3] {
        match self {
            Self::Rec601 => [0.299, 0.587, 0.114],
            Self::AsPrinted => [0.229, 0.587, 0.114],
        }
    }
}

/// How a texture is read between its pixels' centres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// The pixel that the point lies in.
    Nearest,
    /// Linear between the four nearest centres; up to half a pixel from the border, the border's pixels.
    #[default]
    Bilinear,
}

impl Texture {
    /// A texture of `width` x `height` values, row by row from the top.
    ///
    /// # Errors
    /// When there are no or too many pixels, the number of values is another, or one is not from 0 to 1.
    pub fn new(width: usize, height: usize, mut grey: Vec<f64>) -> Result<Self, MorphError> {
        Self::check_size(width, height)?;
        if grey.len() != width * height {
            return Err(MorphError::TextureLength { found: grey.len(), width, height });
        }
        if let Some(i) = grey.iter().position(|g| !(0.0..=1.0).contains(g)) {
            return Err(MorphError::GreyValue { x: i % width, y: i / width, value: grey[i] });
        }
        grey.iter_mut().for_each(|g| *g += 0.0); // no -0
        Ok(Self { width, height, grey })
    }

    /// A texture of zeros.
    ///
    /// # Errors
    /// When there are no or too many pixels.
    pub fn blank(width: usize, height: usize) -> Result<Self, MorphError> {
        Self::check_size(width, height)?;
        Self::new(width, height, vec![0.0; width * height])
    }

    fn check_size(width: usize, height: usize) -> Result<(), MorphError> {
        let side = 1..=MAX_TEXTURE_SIDE;
        if side.contains(&width) && side.contains(&height) && width * height <= MAX_TEXTURE_PIXELS {
            return Ok(());
        }
        Err(MorphError::TextureSize { width, height })
    }

    /// Reads a PNG. Grey is taken as it is, colour through `weights` (3), and what is transparent counts as painted over black.
    ///
    /// # Errors
    /// When the file cannot be read, is not a PNG, or is too large.
    pub fn read_png(path: &Path, weights: GreyWeights) -> Result<Self, ReadError> {
        let bytes = read_file(path)?;
        let malformed = |expected: &str, found: String| ReadError::malformed(path, Place::File, expected, found);
        let reader = image::ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
        let image = reader.decode().map_err(|e| malformed("a PNG picture", e.to_string()))?;
        let (width, height) = (image.width() as usize, image.height() as usize);
        const WHITE: f64 = u16::MAX as f64;
        let value = |grey: f64, alpha: u16| (grey / WHITE).min(1.0) * (f64::from(alpha) / WHITE);
        let grey = if image.color().has_color() {
            let [r, g, b] = weights.vector();
            let dot = |p: &[u16; 4]| r * f64::from(p[0]) + g * f64::from(p[1]) + b * f64::from(p[2]);
            image.to_rgba16().pixels().map(|p| value(dot(&p.0), p.0[3])).collect()
        } else {
            image.to_luma_alpha16().pixels().map(|p| value(f64::from(p.0[0]), p.0[1])).collect()
        };
        Self::new(width, height, grey).map_err(|e| malformed("a texture", e.to_string()))
    }

    /// Writes the texture as a grey PNG of 16 bits.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), WriteError> {
        let samples = self.grey.iter().flat_map(|g| ((g * f64::from(u16::MAX)).round() as u16).to_ne_bytes());
        let mut bytes = Vec::new();
        let encoded = PngEncoder::new(&mut bytes).write_image(
            &samples.collect::<Vec<u8>>(),
            self.width as u32,
            self.height as u32,
            ExtendedColorType::L16,
        );
        write_atomically(path, |file| {
            encoded.map_err(std::io::Error::other)?;
            file.write_all(&bytes)
        })
    }

    /// Pixels in a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The values, row by row from the top.
    #[must_use]
    pub fn grey(&self) -> &[f64] {
        &self.grey
    }

    /// As [`Self::grey`], to keep.
    #[must_use]
    pub fn into_grey(self) -> Vec<f64> {
        self.grey
    }

    /// A texture of the same size with values that may lie outside 0..=1 by rounding.
    pub(super) fn with_grey(&self, mut grey: Vec<f64>) -> Self {
        debug_assert_eq!(grey.len(), self.grey.len());
        grey.iter_mut().for_each(|g| *g = g.clamp(0.0, 1.0));
        Self { width: self.width, height: self.height, grey }
    }

    /// The grey value at texture coordinates, equation (6): (0, 0) is the lower left corner of the **bottom** row's first pixel,
    /// (1, 1) the upper right corner of the image. 0 outside, and at NaN.
    #[must_use]
    #[inline]
    pub fn sample(&self, [u, v]: [f64; 2], sampling: Sampling) -> f64 {
        if !((0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v)) {
            return 0.0;
        }
        let (x, y) = (u * self.width as f64, (1.0 - v) * self.height as f64);
        let (right, bottom) = (self.width - 1, self.height - 1);
        match sampling {
            Sampling::Nearest => self.grey[(y as usize).min(bottom) * self.width + (x as usize).min(right)],
            Sampling::Bilinear => {
                let (x, y) = ((x - 0.5).clamp(0.0, right as f64), (y - 0.5).clamp(0.0, bottom as f64));
                let (column, row) = (x as usize, y as usize);
                let (s, t) = (x - column as f64, y - row as f64);
                let (top, next) = (row * self.width, (row + 1).min(bottom) * self.width);
                let mix = |first: usize| {
                    let (a, b) = (self.grey[first + column], self.grey[first + (column + 1).min(right)]);
                    a + s * (b - a)
                };
                let (a, b) = (mix(top), mix(next));
                (a + t * (b - a)).clamp(0.0, 1.0)
            }
        }
    }

    /// The texture as a picture, rounded to 8 bits.
    #[must_use]
    pub fn picture(&self) -> RgbImage {
        RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            Rgb([(255.0 * self.grey[y as usize * self.width + x as usize]).round() as u8; 3])
        })
    }

    /// The mask laid over a picture in a colour, equation (4): `C_r = C_d (1 - G) + C_s G` on the picture's stored values, as the
    /// paper's shader does, rounded to 8 bits.
    ///
    /// # Errors
    /// When picture and mask differ in size.
    pub fn overlay(&self, picture: &RgbImage, colour: [u8; 3]) -> Result<RgbImage, MorphError> {
        let size = [picture.width() as usize, picture.height() as usize];
        if size != [self.width, self.height] {
            return Err(MorphError::OverlaySize { picture: size, mask: [self.width, self.height] });
        }
        let mut result = picture.clone();
        for (pixel, g) in result.pixels_mut().zip(&self.grey) {
            for c in 0..3 {
                pixel.0[c] = (f64::from(pixel.0[c]) * (1.0 - g) + f64::from(colour[c]) * g).round() as u8;
            }
        }
        Ok(result)
    }
}
