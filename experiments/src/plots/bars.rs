//! [`GroupedBars`] and [`StackedBars`]: quantities of named things.

use anyhow::{Context as _, Result, bail};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::{Axis, Span, short};
use super::draw::{
    Area, GREY, GRID, INK, LARGE, Pixel, WIDTH, bold, colour, dashed, fill, ink_on, lines_height, page, px, width,
    words, wrap, write_lines,
};
use super::legend::{Key, Legend};
use super::plot::{spread_path, x_tick_count};

/// A named value.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Stands at its left.
    pub name: String,
    /// Its length from zero; a row without a bar where it is not finite.
    pub value: f64,
    /// Lower and upper end of the error bar; none where one is not finite.
    pub spread: Option<[f64; 2]>,
}

/// Horizontal bars, one in a row, in named groups: one quantity for many options. The first bar is what the others are compared with: a
/// thin line through all of them stands at its end.
#[derive(Debug, Clone)]
pub struct GroupedBars {
    title: String,
    y: String,
    bars: Vec<(String, Bar)>,
}

/// Vertical bars of parts that add up: time by stage.
#[derive(Debug, Clone)]
pub struct StackedBars {
    /// What they show.
    pub title: String,
    /// Name of each bar.
    pub labels: Vec<String>,
    /// What the bars are.
    pub x: String,
    /// What the bars measure, with its unit.
    pub y: String,
    /// Name of each part, and its size in each bar, not negative. One that is not finite is left out, and with it the bar's sum.
    pub parts: Vec<(String, Vec<f64>)>,
}

/// Draws the title; returns where it ends.
fn draw_title(page: &Area, lines: &[String]) -> Result<()> {
    let style = bold(LARGE.title, HPos::Center, VPos::Center);
    write_lines(page, lines, &style, LARGE.title, (WIDTH / 2, px(6.0)))
}

fn title_lines(title: &str) -> (Vec<String>, i32) {
    let lines = wrap(title, LARGE.title, WIDTH - px(24.0));
    let end = px(14.0) + lines_height(lines.len(), LARGE.title);
    (lines, end)
}

/// A row with its lines of words at the left, from its upper edge.
enum Row<'a> {
    Group(&'a str),
    Bar(&'a Bar, Vec<String>),
}

impl Row<'_> {
    fn height(&self) -> i32 {
        match self {
            Self::Group(name) if name.is_empty() => px(10.0),
            Self::Group(_) => px(30.0),
            Self::Bar(_, lines) => px(8.0) + lines_height(lines.len().max(1), LARGE.tick),
        }
    }
}

impl GroupedBars {
    /// `y` is the quantity with its unit; `bars` each have the name of their group, those of a group one after another.
    #[must_use]
    pub fn new(title: &str, y: &str, bars: Vec<(String, Bar)>) -> Self {
        Self { title: title.to_owned(), y: y.to_owned(), bars }
    }

    /// The bars as SVG, as high as they need.
    ///
    /// # Errors
    /// Without a finite value.
    pub fn svg(&self) -> Result<String> {
        let finite = self.bars.iter().map(|b| &b.1).filter(|b| b.value.is_finite());
        let ends = finite.flat_map(|b| b.spread.into_iter().flatten().chain([b.value]));
        let span = Span::new(&Axis::linear(&self.y).from_zero(), ends, None)
            .with_context(|| format!("bars {:?}", self.title))?;

        let names = px(400.0);
        let mut rows = Vec::new();
        for (k, (group, bar)) in self.bars.iter().enumerate() {
            if k == 0 || self.bars[k - 1].0 != *group {
                rows.push(Row::Group(group));
            }
            rows.push(Row::Bar(bar, wrap(&bar.name, LARGE.tick, names)));
        }
        let lines = |row: &Row| match row {
            Row::Bar(_, lines) => lines.iter().map(|l| width(l, LARGE.tick)).max().unwrap_or(0),
            Row::Group(_) => 0,
        };
        let left = px(24.0) + rows.iter().map(lines).max().unwrap_or(0);
        let value = self.bars.iter().map(|b| width(&short(b.1.value), LARGE.tick)).max().unwrap_or(0);
        let right = WIDTH - px(16.0) - value;
        let (title, top) = title_lines(&self.title);
        let bottom = top + rows.iter().map(Row::height).sum::<i32>() + px(6.0);
        let below = lines_height(1, LARGE.tick) + lines_height(1, LARGE.label) + px(10.0);
        page(bottom + below + px(6.0), |page| {
            draw_title(page, &title)?;
            let frame = [(left, top), (right, bottom)];
            value_axis(page, frame, below, &span)?;
            self.draw_rows(page, frame, &span, &rows)
        })
    }

    fn draw_rows(
        &self,
        page: &Area,
        [(left, top), (right, bottom)]: [Pixel; 2],
        span: &Span,
        rows: &[Row],
    ) -> Result<()> {
        let at = |v: f64| left + (span.fraction(v) * f64::from(right - left)).round() as i32;
        let mut y = top;
        for (k, row) in rows.iter().enumerate() {
            let next = y + row.height();
            match row {
                Row::Group(name) => {
                    if k > 0 {
                        page.draw(&PathElement::new(
                            [(px(8.0), y + px(4.0)), (right, y + px(4.0))],
                            GREY.stroke_width(1),
                        ))?;
                    }
                    // On white, so that no line of the axis crosses it.
                    let end = px(10.0) + width(name, LARGE.tick) * 11 / 10;
                    let ground = [(px(9.0), y + px(8.0)), (end, next - px(1.0))];
                    page.draw(&Rectangle::new(ground, WHITE.filled()))?;
                    let style = bold(LARGE.tick, HPos::Left, VPos::Center);
                    page.draw_text(name, &style, (px(10.0), next - px(11.0)))?;
                }
                Row::Bar(bar, lines) => {
                    let style = words(LARGE.tick, INK, HPos::Right, VPos::Center);
                    write_lines(page, lines, &style, LARGE.tick, (left - px(8.0), y + px(4.0)))?;
                    if bar.value.is_finite() {
                        self.draw_bar(page, bar, [y, next], at)?;
                    }
                }
            }
            y = next;
        }
        if let Some((_, first)) = self.bars.first().filter(|b| b.1.value.is_finite()) {
            let x = at(first.value);
            let ends = [(x, top + rows.first().map_or(0, Row::height)), (x, bottom)];
            dashed(page, &ends, px(4.0), px(3.0), INK.stroke_width(px(1.0) as u32))?;
        }
        page.draw(&PathElement::new([(at(0.0), top), (at(0.0), bottom)], GREY.stroke_width(px(1.0) as u32)))?;
        Ok(())
    }

    fn draw_bar(&self, page: &Area, bar: &Bar, [from, to]: [i32; 2], at: impl Fn(f64) -> i32) -> Result<()> {
        let is_first = self.bars.first().is_some_and(|b| std::ptr::eq(&b.1, bar));
        let ground = if is_first { GREY } else { colour(5) };
        let (zero, end) = (at(0.0), at(bar.value));
        let corners = [(zero.min(end), from + px(3.0)), (zero.max(end), to - px(3.0))];
        page.draw(&Rectangle::new(corners, ground.filled()))?;
        let middle = (from + to) / 2;
        let mut last = end.max(zero);
        if let Some([low, high]) = bar.spread.filter(|s| s.iter().all(|v| v.is_finite())) {
            let path = spread_path([(at(low), true), (at(high), true)], px(4.0));
            let path: Vec<Pixel> = path.into_iter().map(|(across, along)| (along, middle + across)).collect();
            page.draw(&PathElement::new(path, INK.stroke_width(px(1.5) as u32)))?;
            last = last.max(at(high));
        }
        // On white, because the first bar's line may pass here.
        let label = short(bar.value);
        let ground =
            [(last + px(3.0), middle - px(8.0)), (last + px(7.0) + width(&label, LARGE.tick), middle + px(8.0))];
        page.draw(&Rectangle::new(ground, WHITE.filled()))?;
        let style = words(LARGE.tick, INK, HPos::Left, VPos::Center);
        Ok(page.draw_text(&label, &style, (last + px(5.0), middle))?)
    }
}

/// The axis below horizontal bars.
fn value_axis(page: &Area, [(left, top), (right, bottom)]: [Pixel; 2], below: i32, span: &Span) -> Result<()> {
    let around = page.clone().shrink((left, top), (right - left, bottom + below - top));
    let mut chart = ChartBuilder::on(&around).x_label_area_size(below).build_cartesian_2d(span.clone(), 0.0..1.0)?;
    let most = x_tick_count(span, right - left, LARGE.tick);
    let ticks = span.ticks(most);
    chart
        .configure_mesh()
        .disable_y_mesh()
        .x_desc(span.label())
        .axis_desc_style(words(LARGE.label, INK, HPos::Center, VPos::Center))
        .label_style(words(LARGE.tick, INK, HPos::Center, VPos::Center))
        .x_labels(most)
        .x_label_formatter(&|v| ticks.iter().find(|t| t.0 == *v).map_or_else(String::new, |t| t.1.clone()))
        .axis_style(GREY.stroke_width(px(1.0) as u32))
        .bold_line_style(GRID.stroke_width(px(1.0) as u32))
        .light_line_style(TRANSPARENT)
        .draw()?;
    Ok(())
}

impl StackedBars {
    /// The bars as SVG, the legend at the right or below; each part's size where it has room, and each bar's sum.
    ///
    /// # Errors
    /// Without a label, part or finite value, when a part has another number of values than there are labels, or a value is negative.
    pub fn svg(&self) -> Result<String> {
        self.build().with_context(|| format!("bars {:?}", self.title))
    }

    fn build(&self) -> Result<String> {
        if self.labels.is_empty() || self.parts.is_empty() {
            bail!("{} labels and {} parts, expected at least one of each", self.labels.len(), self.parts.len());
        }
        for (name, values) in &self.parts {
            if values.len() != self.labels.len() {
                bail!("part {name:?}: {} values for {} labels", values.len(), self.labels.len());
            }
            if let Some(v) = values.iter().find(|v| **v < 0.0) {
                bail!("part {name:?}: {v}, expected a number that is not negative");
            }
        }
        if !self.parts.iter().flat_map(|p| &p.1).any(|v| v.is_finite()) {
            bail!("no value to show");
        }
        let finite = |k: usize| self.parts.iter().map(move |p| p.1[k]).filter(|v| v.is_finite());
        let shown = (0..self.labels.len()).map(|k| finite(k).sum());
        let span = Span::new(&Axis::linear(&self.y).from_zero(), shown, None)?;

        let legend = Legend(self.parts.iter().enumerate().map(|(k, p)| (Key::Swatch(k), p.0.clone())).collect());
        let high = px(380.0);
        let beside = legend.beside(high);
        let (title, top) = title_lines(&self.title);
        let top = top + lines_height(1, LARGE.tick);
        let most = (high / px(3.0 * LARGE.tick)) as usize;
        let tick_width = span.ticks(most).iter().map(|t| width(&t.1, LARGE.tick)).max().unwrap_or(0);
        let left = px(24.0) + lines_height(1, LARGE.label) + tick_width;
        let right = WIDTH - beside.unwrap_or(px(20.0)) - px(8.0);
        let names = Names::new(&self.labels, (right - left) / self.labels.len() as i32);
        let names_end = top + high + px(8.0) + names.height;
        let x_end = names_end + if self.x.is_empty() { 0 } else { px(6.0) + lines_height(1, LARGE.label) };
        let below = if beside.is_some() { 0 } else { px(10.0) + legend.height(WIDTH - px(60.0)) };
        page(x_end + below + px(6.0), |page| {
            draw_title(page, &title)?;
            let frame = [(left, top), (right, top + high)];
            self.draw_axis(page, frame, &span, most)?;
            self.draw_bars(page, frame, &span)?;
            names.draw(page, (left, top + high + px(8.0)))?;
            if !self.x.is_empty() {
                let style = words(LARGE.label, INK, HPos::Center, VPos::Center);
                write_lines(page, &[self.x.clone()], &style, LARGE.label, ((left + right) / 2, names_end + px(4.0)))?;
            }
            match beside {
                Some(wide) => legend.draw(page, (right + px(12.0), top), wide),
                None => legend.draw(page, (px(40.0), x_end + px(8.0)), WIDTH - px(60.0)),
            }
        })
    }

    fn draw_axis(
        &self,
        page: &Area,
        [(left, top), (right, bottom)]: [Pixel; 2],
        span: &Span,
        most: usize,
    ) -> Result<()> {
        let label_area = left - px(8.0);
        let around = page.clone().shrink((px(8.0), top), (right - px(8.0), bottom - top));
        let mut chart =
            ChartBuilder::on(&around).y_label_area_size(label_area).build_cartesian_2d(0.0..1.0, span.clone())?;
        let ticks = span.ticks(most);
        chart
            .configure_mesh()
            .disable_x_mesh()
            .y_desc(&self.y)
            .axis_desc_style(words(LARGE.label, INK, HPos::Center, VPos::Center))
            .label_style(words(LARGE.tick, INK, HPos::Center, VPos::Center))
            .y_labels(most)
            .y_label_formatter(&|v| ticks.iter().find(|t| t.0 == *v).map_or_else(String::new, |t| t.1.clone()))
            .axis_style(GREY.stroke_width(px(1.0) as u32))
            .bold_line_style(GRID.stroke_width(px(1.0) as u32))
            .light_line_style(TRANSPARENT)
            .draw()?;
        page.draw(&PathElement::new([(left, bottom), (right, bottom)], GREY.stroke_width(px(1.0) as u32)))?;
        Ok(())
    }

    fn draw_bars(&self, page: &Area, [(left, top), (right, bottom)]: [Pixel; 2], span: &Span) -> Result<()> {
        let at = |v: f64| bottom - (span.fraction(v) * f64::from(bottom - top)).round() as i32;
        let slot = f64::from(right - left) / self.labels.len() as f64;
        let half = ((0.36 * slot) as i32).min(px(48.0));
        for k in 0..self.labels.len() {
            let x = left + (slot * (k as f64 + 0.5)).round() as i32;
            let mut sum = 0.0;
            let mut complete = true;
            for (part, (_, values)) in self.parts.iter().enumerate() {
                let value = values[k];
                complete &= value.is_finite();
                if !(value.is_finite() && value > 0.0) {
                    continue;
                }
                let (from, to) = (at(sum), at(sum + value));
                sum += value;
                let ground = fill(part);
                page.draw(&Rectangle::new([(x - half, to), (x + half, from)], ground.filled()))?;
                page.draw(&PathElement::new([(x - half, to), (x + half, to)], WHITE.stroke_width(1)))?;
                let label = short(value);
                if from - to >= px(15.0) && width(&label, 12.0) + px(4.0) <= 2 * half {
                    let style = words(12.0, ink_on(ground), HPos::Center, VPos::Center);
                    page.draw_text(&label, &style, (x, (from + to) / 2))?;
                }
            }
            if complete {
                let size = LARGE.tick.min(LARGE.tick * slot / f64::from(width(&short(sum), LARGE.tick)));
                page.draw_text(&short(sum), &bold(size, HPos::Center, VPos::Center), (x, at(sum) - px(9.0)))?;
            }
        }
        Ok(())
    }
}

/// Names below vertical bars: in lines where the words have room, otherwise upright.
struct Names {
    slot: i32,
    lines: Vec<Vec<String>>,
    upright: bool,
    height: i32,
}

impl Names {
    fn new(labels: &[String], slot: i32) -> Self {
        let room = slot - px(8.0);
        let lines: Vec<Vec<String>> = labels.iter().map(|l| wrap(l, LARGE.tick, room)).collect();
        let most = lines.iter().map(Vec::len).max().unwrap_or(0);
        let upright = most > 3 || lines.iter().flatten().any(|l| width(l, LARGE.tick) > room);
        let longest = labels.iter().map(|l| width(l, LARGE.tick)).max().unwrap_or(0);
        let height = if upright { longest } else { lines_height(most, LARGE.tick) };
        let lines = if upright { labels.iter().map(|l| vec![l.clone()]).collect() } else { lines };
        Self { slot, lines, upright, height }
    }

    fn draw(&self, page: &Area, (left, top): Pixel) -> Result<()> {
        for (k, lines) in self.lines.iter().enumerate() {
            let x = left + self.slot * k as i32 + self.slot / 2;
            if self.upright {
                let style = words(LARGE.tick, INK, HPos::Right, VPos::Center).transform(FontTransform::Rotate270);
                page.draw_text(&lines[0], &style, (x, top))?;
            } else {
                write_lines(page, lines, &words(LARGE.tick, INK, HPos::Center, VPos::Center), LARGE.tick, (x, top))?;
            }
        }
        Ok(())
    }
}
