//! What all plots share: the page, words, colours and markers.

use anyhow::Result;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// A part of the page.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Units of the page from its upper left corner.
pub(super) type Pixel = (i32, i32);

/// plotters places everything at whole units: two of them make a pixel of a page that is read 1100 pixels wide.
pub(super) const UNIT: f64 = 2.0;
pub(super) const WIDTH: i32 = px(1100.0);

/// Units of a length in pixels.
pub(super) const fn px(pixels: f64) -> i32 {
    (UNIT * pixels) as i32
}

pub(super) const INK: RGBColor = RGBColor(34, 34, 34);
pub(super) const GREY: RGBColor = RGBColor(110, 110, 110);
pub(super) const GRID: RGBColor = RGBColor(216, 216, 216);
pub(super) const FAINT: RGBColor = RGBColor(240, 240, 240);

/// Distinguishable with all common kinds of colour blindness (M. Okabe, K. Ito, "Color Universal Design", 2008), without the yellow,
/// which white swallows.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

pub(super) fn colour(look: usize) -> RGBColor {
    COLOURS[look % COLOURS.len()]
}

/// A colour for an area: beyond the colours, half way to white.
pub(super) fn fill(look: usize) -> RGBColor {
    let RGBColor(r, g, b) = colour(look);
    if look / COLOURS.len() % 2 == 1 { RGBColor(r / 2 + 128, g / 2 + 128, b / 2 + 128) } else { colour(look) }
}

/// Black or white, whichever can be read on `ground`.
pub(super) fn ink_on(ground: RGBColor) -> RGBColor {
    let RGBColor(r, g, b) = ground;
    if 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b) > 140.0 { INK } else { WHITE }
}

/// Sizes in pixels of what is written and drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    pub title: f64,
    pub label: f64,
    pub tick: f64,
    pub marker: f64,
    /// Of the frame with the labels below it.
    pub high: f64,
}

/// One plot a page.
pub(super) const LARGE: Sizes = Sizes { title: 18.0, label: 15.0, tick: 14.0, marker: 5.0, high: 450.0 };
/// Several in a row.
pub(super) const fn side_by_side(columns: usize) -> Sizes {
    let high = match columns {
        1 => 370.0,
        2 => 310.0,
        _ => 250.0,
    };
    Sizes { title: 15.0, label: 13.0, tick: 12.5, marker: 4.0, high }
}

/// Words of `size` pixels.
pub(super) fn words(size: f64, colour: RGBColor, h: HPos, v: VPos) -> TextStyle<'static> {
    // plotters writes a size as an SVG `font-size` 1.24 times smaller.
    ("sans-serif", 1.24 * UNIT * size).into_font().color(&colour).pos(Pos::new(h, v))
}

pub(super) fn bold(size: f64, h: HPos, v: VPos) -> TextStyle<'static> {
    let font = ("sans-serif", 1.24 * UNIT * size, FontStyle::Bold).into_font();
    TextStyle::from(font).color(&INK).pos(Pos::new(h, v))
}

/// Units of a text in most sans-serif fonts, rather too many.
pub(super) fn width(text: &str, size: f64) -> i32 {
    (text.chars().count() as f64 * 0.6 * UNIT * size).ceil() as i32
}

/// Lines of at most `room` units, broken between words; a longer word has its own.
pub(super) fn wrap(text: &str, size: f64, room: i32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), size) <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Height of `n` lines.
pub(super) fn lines_height(n: usize, size: f64) -> i32 {
    (n as f64 * 1.25 * UNIT * size).round() as i32
}

/// Writes lines below `y`, each anchored at `x`.
pub(super) fn write_lines(page: &Area, lines: &[String], style: &TextStyle, size: f64, (x, y): Pixel) -> Result<()> {
    for (k, line) in lines.iter().enumerate() {
        let style = style.pos(Pos::new(style.pos.h_pos, VPos::Center));
        page.draw_text(line, &style, (x, y + (lines_height(2 * k + 1, size)) / 2))?;
    }
    Ok(())
}

/// Draws a page of a height in units.
pub(super) fn page(height: i32, draw: impl FnOnce(&Area) -> Result<()>) -> Result<String> {
    let mut svg = String::new();
    {
        let page = SVGBackend::with_string(&mut svg, (WIDTH as u32, height as u32)).into_drawing_area();
        page.fill(&WHITE)?;
        draw(&page)?;
        page.present()?;
    }
    // As wide as the page it stands in.
    Ok(svg.replacen(&format!("width=\"{WIDTH}\" height=\"{height}\" viewBox"), "viewBox", 1))
}

/// The marker of a look: ten shapes, the last four hollow. `r` is half its size in units.
pub(super) fn marker(page: &Area, (x, y): Pixel, look: usize, r: i32) -> Result<()> {
    let colour = colour(look);
    let at = |p: &[f64; 2]| (x + (p[0] * f64::from(r)).round() as i32, y + (p[1] * f64::from(r)).round() as i32);
    const SQUARE: &[[f64; 2]] = &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]];
    const TRIANGLE: &[[f64; 2]] = &[[0.0, -1.2], [1.2, 0.9], [-1.2, 0.9]];
    const DIAMOND: &[[f64; 2]] = &[[0.0, -1.3], [1.3, 0.0], [0.0, 1.3], [-1.3, 0.0]];
    let shape = match look % 10 {
        1 | 7 => SQUARE,
        2 | 8 => TRIANGLE,
        3 | 9 => DIAMOND,
        4 => return Ok(page.draw(&Cross::new((x, y), r, colour.stroke_width(px(2.0) as u32)))?),
        5 => {
            for end in [(r * 5 / 4, 0), (0, r * 5 / 4)] {
                let ends = [(x - end.0, y - end.1), (x + end.0, y + end.1)];
                page.draw(&PathElement::new(ends, colour.stroke_width(px(2.0) as u32)))?;
            }
            return Ok(());
        }
        0 => return Ok(page.draw(&Circle::new((x, y), r, colour.filled()))?),
        _ => {
            page.draw(&Circle::new((x, y), r, WHITE.filled()))?;
            return Ok(page.draw(&Circle::new((x, y), r, colour.stroke_width(px(1.5) as u32)))?);
        }
    };
    let corners: Vec<Pixel> = shape.iter().map(at).collect();
    if look % 10 < 4 {
        return Ok(page.draw(&Polygon::new(corners, colour.filled()))?);
    }
    page.draw(&Polygon::new(corners.clone(), WHITE.filled()))?;
    let outline = corners.iter().chain(&corners[..2]).copied();
    Ok(page.draw(&PathElement::new(outline.collect::<Vec<_>>(), colour.stroke_width(px(1.5) as u32)))?)
}

/// A small triangle that stands on `y`: a value above the axis.
pub(super) fn above(page: &Area, (x, y): Pixel, colour: RGBColor) -> Result<()> {
    let (half, high) = (px(4.5), px(8.0));
    Ok(page.draw(&Polygon::new([(x - half, y), (x + half, y), (x, y - high)], colour.filled()))?)
}

pub(super) fn dashed(page: &Area, points: &[Pixel], dash: i32, gap: i32, style: ShapeStyle) -> Result<()> {
    Ok(page.draw(&plotters::element::DashedPathElement::new(points.iter().copied(), dash, gap, style))?)
}
