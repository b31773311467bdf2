//! Captions from an 8 x 8 bitmap font.

use font8x8::{BASIC_FONTS, GREEK_FONTS, LATIN_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage};

use super::Rgb8;

/// Width and height of `text` at integer `scale`, pixels. One line; the font is 8 x 8 per character.
#[must_use]
pub fn text_size(text: &str, scale: u32) -> [u32; 2] {
    [
        u32::try_from(text.chars().count()).unwrap_or(u32::MAX).saturating_mul(8).saturating_mul(scale),
        scale.saturating_mul(8),
    ]
}

/// Draws one line with its upper left corner at (`x`, `y`), clipped to the image. Characters outside Latin and Greek show
/// as `?`.
pub fn draw_text(image: &mut RgbImage, x: i64, y: i64, text: &str, scale: u32, colour: Rgb8) {
    let scale = i64::from(scale);
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    for (i, character) in text.chars().enumerate() {
        let left = x + 8 * scale * i as i64;
        if left >= width {
            break;
        }
        for (row, bits) in glyph(character).iter().enumerate() {
            for column in (0..8).filter(|c| bits >> c & 1 == 1) {
                let (x0, y0) = (left + column * scale, y + row as i64 * scale);
                for py in y0.max(0)..(y0 + scale).min(height) {
                    for px in x0.max(0)..(x0 + scale).min(width) {
                        image.put_pixel(px as u32, py as u32, Rgb(colour));
                    }
                }
            }
        }
    }
}

fn glyph(character: char) -> [u8; 8] {
    BASIC_FONTS
        .get(character)
        .or_else(|| LATIN_FONTS.get(character))
        .or_else(|| GREEK_FONTS.get(character))
        .or_else(|| BASIC_FONTS.get('?'))
        .unwrap_or([0xff; 8])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_clipped_and_scaled() {
        let mut image = RgbImage::new(20, 10);
        draw_text(&mut image, -5, -3, "W\u{4e16}", 2, [255, 0, 0]);
        draw_text(&mut image, 1000, 1000, "far", 2, [255, 0, 0]);
        assert!(image.pixels().any(|p| p.0 == [255, 0, 0]));
        assert_eq!(text_size("abc", 2), [48, 16]);
    }
}
