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
use super::plot::{Frame, spread_path, x_tick_count};

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
    top: f64,
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
            Self::Group("") => px(10.0),
            Self::Group(_) => px(30.0),
            Self::Bar(_, lines) => px(8.0) + lines_height(lines.len().max(1), LARGE.tick),
        }
    }
}

impl GroupedBars {
    /// `y` is the quantity with its unit; `bars` each have the name of their group, those of a group one after another.
    #[must_use]
    pub fn new(title: &str, y: &str, bars: Vec<(String, Bar)>) -> Self {
        Self { title: title.to_owned(), y: y.to_owned(), bars, top: f64::INFINITY }
    }

    /// Greatest value on the axis: what is longer ends there, and its number says that it does.
    #[must_use]
    pub fn top(mut self, limit: f64) -> Self {
        self.top = limit;
        self
    }

    /// The bars as SVG, as high as they need.
    ///
    /// # Errors
    /// Without a finite value.
    pub fn svg(&self) -> Result<String> {
        let finite = self.bars.iter().map(|b| &b.1).filter(|b| b.value.is_finite());
        let ends = finite.flat_map(|b| b.spread.into_iter().flatten().chain([b.value])).map(|v| v.min(self.top));
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
        let value = self
            .bars
            .iter()
            .filter(|b| b.1.value.is_finite())
            .map(|b| width(&self.label(&b.1), LARGE.tick))
            .max()
            .unwrap_or(0);
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

    /// What stands at a bar's end.
    fn label(&self, bar: &Bar) -> String {
        match bar.value {
            v if !v.is_finite() => NO_VALUE.to_owned(),
            v if v > self.top => format!("{}, off the scale", short(v)),
            v => short(v),
        }
    }

    fn draw_rows(&self, page: &Area, [(left, top), (right, bottom)]: Frame, span: &Span, rows: &[Row]) -> Result<()> {
        let at = |v: f64| left + (span.fraction(v.min(self.top)) * f64::from(right - left)).round() as i32;
        let tops = rows.iter().scan(top, |y, row| Some(std::mem::replace(y, *y + row.height())));
        let rows: Vec<(&Row, i32)> = rows.iter().zip(tops).collect();
        let bars = || {
            rows.iter().filter_map(|(row, y)| {
                if let Row::Bar(bar, lines) = row { Some((bar, lines, [*y, y + row.height()])) } else { None }
            })
        };
        for (k, (bar, _, [from, to])) in bars().enumerate().filter(|(_, b)| b.0.value.is_finite()) {
            let ground = if k == 0 { GREY } else { colour(5) };
            let (zero, end) = (at(0.0), at(bar.value));
            let corners = [(zero.min(end), from + px(3.0)), (zero.max(end), to - px(3.0))];
            page.draw(&Rectangle::new(corners, ground.filled()))?;
            if let Some(ends) = spread(bar) {
                let path = spread_path(ends.map(|v| (at(v), true)), px(4.0));
                let path: Vec<Pixel> =
                    path.into_iter().map(|(across, along)| (along, (from + to) / 2 + across)).collect();
                page.draw(&PathElement::new(path, INK.stroke_width(px(1.5) as u32)))?;
            }
        }
        page.draw(&PathElement::new([(at(0.0), top), (at(0.0), bottom)], GREY.stroke_width(px(1.0) as u32)))?;
        if let Some((first, _, [y, _])) = bars().next().filter(|b| b.0.value.is_finite()) {
            let ends = [(at(first.value), y), (at(first.value), bottom)];
            dashed(page, &ends, px(4.0), px(3.0), INK.stroke_width(px(1.0) as u32))?;
        }
        // Words last, on white: no line crosses them.
        for (bar, lines, [from, to]) in bars() {
            let style = words(LARGE.tick, INK, HPos::Right, VPos::Center);
            write_lines(page, lines, &style, LARGE.tick, (left - px(8.0), from + px(4.0)))?;
            let ends = [0.0, bar.value].into_iter().chain(spread(bar).into_iter().flatten()).filter(|v| v.is_finite());
            let end = ends.map(&at).max().unwrap_or(left) + px(5.0);
            let ink = if bar.value.is_finite() { INK } else { GREY };
            let label = self.label(bar);
            write_on_white(page, &label, &words(LARGE.tick, ink, HPos::Left, VPos::Center), (end, (from + to) / 2))?;
        }
        for (k, (row, y)) in rows.iter().enumerate() {
            let Row::Group(name) = row else { continue };
            if k > 0 {
                page.draw(&PathElement::new([(px(8.0), y + px(4.0)), (right, y + px(4.0))], GREY.stroke_width(1)))?;
            }
            let style = bold(LARGE.tick, HPos::Left, VPos::Center);
            write_on_white(page, name, &style, (px(10.0), y + row.height() - px(11.0)))?;
        }
        Ok(())
    }
}

const NO_VALUE: &str = "no value";

/// The ends of a bar's error bar, if it has one.
fn spread(bar: &Bar) -> Option<[f64; 2]> {
    bar.spread.filter(|s| bar.value.is_finite() && s.iter().all(|v| v.is_finite()))
}

/// Writes one line from its left end.
fn write_on_white(page: &Area, text: &str, style: &TextStyle, (x, y): Pixel) -> Result<()> {
    if !text.is_empty() {
        let ground = [(x - px(2.0), y - px(8.0)), (x + px(2.0) + width(text, LARGE.tick), y + px(8.0))];
        page.draw(&Rectangle::new(ground, WHITE.filled()))?;
        page.draw_text(text, style, (x, y))?;
    }
    Ok(())
}

/// The axis below horizontal bars.
fn value_axis(page: &Area, [(left, top), (right, bottom)]: Frame, below: i32, span: &Span) -> Result<()> {
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
        .set_all_tick_mark_size(px(4.0))
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
                write_lines(
                    page,
                    std::slice::from_ref(&self.x),
                    &style,
                    LARGE.label,
                    ((left + right) / 2, names_end + px(4.0)),
                )?;
            }
            match beside {
                Some(wide) => legend.draw(page, (right + px(12.0), top), wide),
                None => legend.draw(page, (px(40.0), x_end + px(8.0)), WIDTH - px(60.0)),
            }
        })
    }

    fn draw_axis(&self, page: &Area, [(left, top), (right, bottom)]: Frame, span: &Span, most: usize) -> Result<()> {
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
            .set_all_tick_mark_size(px(4.0))
            .axis_style(GREY.stroke_width(px(1.0) as u32))
            .bold_line_style(GRID.stroke_width(px(1.0) as u32))
            .light_line_style(TRANSPARENT)
            .draw()?;
        page.draw(&PathElement::new([(left, bottom), (right, bottom)], GREY.stroke_width(px(1.0) as u32)))?;
        Ok(())
    }

    fn draw_bars(&self, page: &Area, [(left, top), (right, bottom)]: Frame, span: &Span) -> Result<()> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(group: &str, name: &str, value: f64, spread: Option<[f64; 2]>) -> (String, Bar) {
        (group.to_owned(), Bar { name: name.to_owned(), value, spread })
    }

    /// Texts in the order in which they were written.
    fn texts(svg: &str) -> Vec<&str> {
        svg.lines().filter(|l| !l.starts_with('<')).collect()
    }

    #[test]
    fn grouped_bars_hold_names_values_and_error_bars() {
        let bars = vec![
            bar("", "default", 1.5, Some([1.25, 2.0])),
            bar("weights", "smooth = 2", 1.25, Some([1.0, 1.5])),
            bar("weights", "smooth = 3", f64::NAN, Some([1.0, 1.5])),
            bar("nodes", "distance = 4", 3.0, Some([f64::NAN, 4.0])),
        ];
        let plot = GroupedBars::new("Errors", "distance [mm]", bars);
        let svg = plot.svg().unwrap();
        let texts = texts(&svg);
        for text in
            ["Errors", "distance [mm]", "default", "smooth = 2", "distance = 4", "weights", "nodes", "1.5", "1.25"]
        {
            assert!(texts.contains(&text), "{text}: {texts:?}");
        }
        assert_eq!(texts.iter().filter(|t| **t == NO_VALUE).count(), 1);
        assert_eq!(svg.matches("stroke-width=\"3\" points").count(), 2);
        assert_eq!(svg.matches("fill=\"#56B4E9\"").count(), 2);
        assert!(!svg.contains("NaN"));
        assert_eq!(svg, plot.svg().unwrap());
        assert!(GroupedBars::new("Errors", "", vec![]).svg().is_err());
        assert!(GroupedBars::new("Errors", "", vec![bar("", "a", f64::NAN, None)]).svg().is_err());
    }

    #[test]
    fn a_bar_beyond_the_top_ends_there_and_says_so() {
        let bars = vec![bar("all", "short", 1.5, None), bar("all", "long", 8.75, Some([7.0, 11.0]))];
        let svg = GroupedBars::new("", "mm", bars).top(2.0).svg().unwrap();
        let texts = texts(&svg);
        assert!(texts.contains(&"1.5") && texts.contains(&"8.75, off the scale"), "{texts:?}");
        assert!(!texts.contains(&"4") && !texts.contains(&"10"), "the axis ends at the top: {texts:?}");
    }

    #[test]
    fn sixty_bars_have_sixty_rows() {
        let bars = |n: usize| (0..n).map(|k| bar("all", &format!("option {k}"), k as f64, None)).collect::<Vec<_>>();
        let svg = GroupedBars::new("Many", "bytes", bars(60)).svg().unwrap();
        let names: Vec<&str> = texts(&svg).into_iter().filter(|t| t.starts_with("option")).collect();
        assert_eq!((names.len(), names[59]), (60, "option 59"));
        let height = |svg: &str| svg.split('"').nth(1).unwrap().split(' ').nth(3).unwrap().parse::<i32>().unwrap();
        let ten = height(&GroupedBars::new("Many", "bytes", bars(10)).svg().unwrap());
        assert!(height(&svg) > ten + 50 * px(20.0), "{ten}");
    }

    fn stacked(values: [[f64; 2]; 2]) -> StackedBars {
        StackedBars {
            title: "Time".into(),
            labels: vec!["head".into(), "hand".into()],
            x: "scan".into(),
            y: "seconds".into(),
            parts: vec![("solve".into(), values[0].to_vec()), ("search".into(), values[1].to_vec())],
        }
    }

    #[test]
    fn stacked_bars_hold_parts_and_sums() {
        let svg = stacked([[1.25, 2.0], [0.5, f64::NAN]]).svg().unwrap();
        let said = texts(&svg);
        for text in ["Time", "head", "hand", "scan", "seconds", "solve", "search", "1.25", "0.5", "1.75"] {
            assert!(said.contains(&text), "{text}: {said:?}");
        }
        assert!(!svg.contains("NaN"));
        // The second bar is not complete: 2 is its part and a tick, not its sum.
        assert_eq!(said.iter().filter(|t| **t == "2").count(), 2);

        assert!(stacked([[1.0, -2.0], [0.5, 1.0]]).svg().is_err());
        assert!(stacked([[f64::NAN; 2]; 2]).svg().is_err());
        assert!(StackedBars { labels: vec![], ..stacked([[1.0; 2]; 2]) }.svg().is_err());
        let error = StackedBars { labels: vec!["head".into()], ..stacked([[1.0; 2]; 2]) }.svg().unwrap_err();
        assert_eq!(format!("{error:#}"), "bars \"Time\": part \"solve\": 2 values for 1 labels");
    }
}
