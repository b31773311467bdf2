//! Legends, which stand beside or below what they explain.

use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::draw::{
    Area, GREY, INK, Pixel, above, colour, dashed, fill, lines_height, marker, px, width, words, wrap, write_lines,
};

/// What an entry shows before its words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Key {
    Series(usize),
    Dashed(RGBColor),
    Above,
    Swatch(usize),
}

/// Entries of a legend.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Legend(pub Vec<(Key, String)>);

const SIZE: f64 = 13.5;
/// Units of a key with the room after it.
const KEY: i32 = px(44.0);
const GAP: i32 = px(18.0);
/// Greatest width beside a plot.
const BESIDE: i32 = px(300.0);

impl Legend {
    fn widest(&self) -> i32 {
        KEY + self.0.iter().map(|e| width(&e.1, SIZE)).max().unwrap_or(0) + GAP
    }

    /// Its width in one column beside something so high, if that is small.
    pub fn beside(&self, height: i32) -> Option<i32> {
        let wide = self.widest();
        (!self.0.is_empty() && wide <= BESIDE && self.height(wide) <= height).then_some(wide)
    }

    /// Rows of columns of entries, each with its lines.
    fn rows(&self, room: i32) -> Vec<Vec<(Key, Vec<String>)>> {
        let columns = self.columns(room);
        let rows = self.0.len().div_ceil(columns);
        let entry = |e: &(Key, String)| (e.0, wrap(&e.1, SIZE, room / columns as i32 - KEY - GAP));
        (0..rows).map(|row| self.0.iter().skip(row).step_by(rows).map(entry).collect()).collect()
    }

    fn columns(&self, room: i32) -> usize {
        ((room / self.widest()).max(1) as usize).min(self.0.len().max(1))
    }

    pub fn height(&self, room: i32) -> i32 {
        let high = |row: &Vec<(Key, Vec<String>)>| row_height(row);
        self.rows(room).iter().map(high).sum()
    }

    /// Draws it in as many columns as `room` units hold.
    pub fn draw(&self, page: &Area, (left, top): Pixel, room: i32) -> Result<()> {
        let column = self.widest().min(room);
        let mut y = top;
        for row in self.rows(room) {
            for (k, (key, lines)) in row.iter().enumerate() {
                let x = left + column * k as i32;
                draw_key(page, (x, y + lines_height(1, SIZE) / 2), *key)?;
                write_lines(page, lines, &words(SIZE, INK, HPos::Left, VPos::Center), SIZE, (x + KEY, y))?;
            }
            y += row_height(&row);
        }
        Ok(())
    }
}

fn row_height(row: &[(Key, Vec<String>)]) -> i32 {
    lines_height(row.iter().map(|e| e.1.len()).max().unwrap_or(0), SIZE) + px(4.0)
}

fn draw_key(page: &Area, (x, y): Pixel, key: Key) -> Result<()> {
    let ends = [(x, y), (x + px(34.0), y)];
    match key {
        Key::Series(look) => {
            page.draw(&PathElement::new(ends, colour(look).stroke_width(px(2.0) as u32)))?;
            marker(page, (x + px(17.0), y), look, px(5.0))
        }
        Key::Dashed(colour) => dashed(page, &ends, px(7.0), px(4.0), colour.stroke_width(px(1.5) as u32)),
        Key::Above => above(page, (x + px(17.0), y + px(4.0)), GREY),
        Key::Swatch(look) => {
            let corners = [(x + px(10.0), y - px(7.0)), (x + px(34.0), y + px(7.0))];
            Ok(page.draw(&Rectangle::new(corners, fill(look).filled()))?)
        }
    }
}
