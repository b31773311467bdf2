//! Captions in DejaVu Sans, a font with an outline for every letter that a name is likely to have.

use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, GlyphId, PxScale, ScaleFont, point};
use image::RgbImage;

use super::Rgb8;

static FONT: LazyLock<FontRef<'static>> =
    LazyLock::new(|| FontRef::try_from_slice(dejavu::sans::regular()).expect("proven: a font that the program holds"));

/// Letters with the place where each begins, and the width of all, for a line of this height.
fn laid_out(text: &str, height: f32) -> (Vec<(GlyphId, f32)>, f32) {
    let font = FONT.as_scaled(PxScale::from(height));
    let mut letters: Vec<(GlyphId, f32)> = Vec::new();
    let mut x = 0.0;
    for character in text.chars() {
        let glyph = match FONT.glyph_id(character) {
            GlyphId(0) => FONT.glyph_id('?'),
            known => known,
        };
        x += letters.last().map_or(0.0, |(before, _)| font.kern(*before, glyph));
        letters.push((glyph, x));
        x += font.h_advance(glyph);
    }
    (letters, x)
}

/// Width and height in pixels of one line of `text` that is `height` pixels high from the top of its highest letters to the bottom of
/// its lowest.
#[must_use]
pub fn text_size(text: &str, height: u32) -> [u32; 2] {
    [laid_out(text, height as f32).1.ceil() as u32, height]
}

/// The height, `height` or less, at which one line of `text` is at most `width` pixels wide; at least 8, which is as small as letters
/// can be read.
#[must_use]
pub fn text_height(text: &str, height: u32, width: u32) -> u32 {
    (8..=height).rev().find(|h| text_size(text, *h)[0] <= width).unwrap_or(8)
}

/// Draws one line of text, `height` pixels high, with its upper left corner at (`x`, `y`), clipped to the image. A character that the
/// font has not shows as `?`.
pub fn draw_text(image: &mut RgbImage, x: i64, y: i64, text: &str, height: u32, colour: Rgb8) {
    let scale = PxScale::from(height as f32);
    let ascent = FONT.as_scaled(scale).ascent();
    let (width, rows) = (i64::from(image.width()), i64::from(image.height()));
    for (glyph, at) in laid_out(text, height as f32).0 {
        // Near the origin, where 32 bits place a letter to a fraction of a pixel; the corner itself is whole.
        let Some(outline) = FONT.outline_glyph(glyph.with_scale_and_position(scale, point(at, ascent))) else {
            continue;
        };
        let bounds = outline.px_bounds();
        let corner = (x.saturating_add(bounds.min.x as i64), y.saturating_add(bounds.min.y as i64));
        outline.draw(|column, row, coverage| {
            let (px, py) = (corner.0.saturating_add(i64::from(column)), corner.1.saturating_add(i64::from(row)));
            if !((0..width).contains(&px) && (0..rows).contains(&py)) {
                return;
            }
            let pixel = image.get_pixel_mut(px as u32, py as u32);
            let share = coverage.clamp(0.0, 1.0);
            for (channel, ink) in pixel.0.iter_mut().zip(colour) {
                *channel = (f32::from(*channel) + share * (f32::from(ink) - f32::from(*channel))).round() as u8;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// The pixels that a text inks, from first to last: columns, then rows.
    fn inked(text: &str, height: u32) -> [[u32; 2]; 2] {
        let mut image = RgbImage::from_pixel(400, 60, Rgb([255; 3]));
        draw_text(&mut image, 0, 0, text, height, [0, 0, 0]);
        let dark: Vec<_> = image.enumerate_pixels().filter(|p| p.2.0[0] < 128).collect();
        let ends = |of: fn(&(u32, u32, &Rgb<u8>)) -> u32| [dark.iter().map(of).min(), dark.iter().map(of).max()];
        [ends(|p| p.0), ends(|p| p.1)].map(|ends| ends.map(Option::unwrap_or_default))
    }

    #[test]
    fn text_fills_what_it_says_it_does() {
        for (text, height) in [("Wjg|", 16), ("thin-face 2.5 mm", 40), ("λ = 1 ± ½ é", 20)] {
            let ([width, said], [columns, rows]) = (text_size(text, height), inked(text, height));
            assert_eq!(said, height);
            assert!(columns[1] <= width && columns[1] + 4 >= width, "{text}: {columns:?} of {width}");
            assert!(rows[1] < height && rows[1] - rows[0] > height / 2, "{text}: {rows:?}");
        }
        assert!(text_size("iiii", 20)[0] < text_size("WWWW", 20)[0] / 2);
    }

    #[test]
    fn text_is_clipped_and_shrinks_to_fit() {
        let mut image = RgbImage::new(20, 10);
        draw_text(&mut image, -5, -3, "W\u{e000}", 16, [255, 0, 0]);
        draw_text(&mut image, i64::MAX, i64::MIN, "far", 16, [255, 0, 0]);
        assert!(image.pixels().any(|p| p.0[0] > 128 && p.0[1] == 0));
        let name = "nasolabial-fold-depth";
        let height = text_height(name, 16, 120);
        assert!((8..16).contains(&height) && text_size(name, height)[0] <= 120 && text_size(name, height + 1)[0] > 120);
        assert_eq!([text_height("a", 16, 120), text_height(name, 16, 1)], [16, 8]);
    }

    #[test]
    fn every_letter_that_captions_use_is_in_the_font() {
        let used = ('!'..='~').chain("äöüéèλωσ·×±²³°µ≤≥−–…".chars()).chain('А'..='я');
        assert_eq!(used.filter(|c| FONT.glyph_id(*c) == GlyphId(0)).collect::<String>(), "");
    }
}
