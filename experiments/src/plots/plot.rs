//! [`Plot`]: points, lines and laws over two axes.

use anyhow::{Context as _, Result, bail};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

use super::axis::{Axis, Span, short};
use super::draw::{
    self, Area, FAINT, GREY, GRID, INK, LARGE, Pixel, Sizes, WIDTH, bold, colour, dashed, lines_height, marker, page,
    px, width, words, wrap, write_lines,
};
use super::fit::{LinearFit, PowerLaw};
use super::legend::{Key, Legend};

/// A measured value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// In units of the horizontal axis.
    pub x: f64,
    /// In units of the vertical axis.
    pub y: f64,
    /// Lower and upper end of the error bar, in units of the vertical axis. One end that the axis cannot show, as zero on a
    /// logarithmic one, leaves the bar open there.
    pub spread: Option<[f64; 2]>,
}

/// Points that belong together, joined in their order. One with a number that its axis cannot show leaves a gap.
#[derive(Debug, Clone)]
pub struct Series {
    pub(super) name: String,
    pub(super) points: Vec<Point>,
    law: bool,
}

impl Series {
    /// A line with a marker at each point, or at as many as have room. Without a name it is not in the legend.
    #[must_use]
    pub fn line(name: &str, points: Vec<Point>) -> Self {
        Self { name: name.to_owned(), points, law: false }
    }

    /// Adds to the legend the exponent of the points' [`PowerLaw`] and the range of x that it was fitted to, if there is one.
    #[must_use]
    pub fn with_power_law(mut self) -> Self {
        self.law = true;
        self
    }

    fn legend(&self) -> String {
        let finite = self.points.iter().map(|p| [p.x, p.y]).filter(|p| p.iter().all(|v| v.is_finite()));
        match PowerLaw::fit(&finite.collect::<Vec<_>>()).filter(|_| self.law) {
            Some(law) => {
                format!("{}: exponent {:.2} on {} to {}", self.name, law.exponent, short(law.from), short(law.to))
            }
            None => self.name.clone(),
        }
    }
}

/// A vertical line with a small label above the plot: a level of a schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Where, in units of the horizontal axis.
    pub x: f64,
    /// A few letters.
    pub label: String,
}

/// `y = intercept + slope x`, dashed.
#[derive(Debug, Clone)]
pub(super) struct Straight {
    pub name: String,
    pub legend: String,
    pub intercept: f64,
    pub slope: f64,
    pub from: f64,
    pub to: f64,
}

/// Points over two axes, with a legend outside them. Up to ten series are told apart by colour and marker.
#[derive(Debug, Clone)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    pub(super) series: Vec<Series>,
    top: Option<f64>,
    marks: Vec<Mark>,
    lines: Vec<Straight>,
}

impl Plot {
    /// Without anything in it yet.
    #[must_use]
    pub fn new(title: &str, x: Axis, y: Axis) -> Self {
        Self { title: title.to_owned(), x, y, series: Vec::new(), top: None, marks: Vec::new(), lines: Vec::new() }
    }

    /// Adds series.
    #[must_use]
    pub fn series(mut self, series: Vec<Series>) -> Self {
        self.series.extend(series);
        self
    }

    /// Sets the greatest y shown. A point above it is a small upward triangle at the upper edge, in a row for
    /// each series.
    #[must_use]
    pub fn top(mut self, limit: f64) -> Self {
        self.top = Some(limit);
        self
    }

    /// Adds vertical lines.
    #[must_use]
    pub fn marks(mut self, marks: Vec<Mark>) -> Self {
        self.marks.extend(marks);
        self
    }

    /// Adds a fitted straight line where it was fitted, dashed, in the colour of the series of the same name. The legend has its
    /// equation and its share of the variance.
    #[must_use]
    pub fn line(self, name: &str, fit: LinearFit) -> Self {
        let sign = if fit.intercept < 0.0 { '−' } else { '+' };
        let equation = format!("y = {} x {sign} {}", short(fit.slope), short(fit.intercept.abs()));
        self.straight(Straight {
            name: name.to_owned(),
            legend: format!("{name}: {equation}, R² = {:.4}", fit.r_squared),
            intercept: fit.intercept,
            slope: fit.slope,
            from: fit.from,
            to: fit.to,
        })
    }

    pub(super) fn straight(mut self, line: Straight) -> Self {
        self.lines.push(line);
        self
    }

    /// The plot as SVG, the legend at the right or below.
    ///
    /// # Errors
    /// When an axis has no value to show, or the top or a mark cannot be on its axis.
    pub fn svg(&self) -> Result<String> {
        let panel = Panel::new(self, (0..self.series.len()).collect(), LARGE)?;
        let legend = panel.legend();
        let beside = legend.beside(panel.high());
        let wide = WIDTH - beside.unwrap_or(0);
        let layout = panel.layout(wide);
        let end = layout.header + panel.high();
        let below = if beside.is_some() { 0 } else { legend.height(WIDTH - px(60.0)) + px(8.0) };
        page(end + below, |page| {
            panel.draw(page, &layout, (0, 0), layout.header)?;
            match beside {
                Some(beside) => legend.draw(page, (wide + px(4.0), layout.header), beside),
                None => legend.draw(page, (px(40.0), end + px(4.0)), WIDTH - px(60.0)),
            }
        })
    }
}

/// A plot on its way onto a page.
pub(super) struct Panel<'a> {
    plot: &'a Plot,
    looks: Vec<usize>,
    x: Span,
    y: Span,
    sizes: Sizes,
}

/// Height of a row of what is above the axis.
const ABOVE: i32 = px(11.0);

/// Where everything stands in a panel.
pub(super) struct Layout<'a> {
    title: Vec<String>,
    /// Ticks of the vertical axis at most.
    most: usize,
    y_width: i32,
    /// Of the frame.
    left: i32,
    across: i32,
    /// Width of the frame.
    wide: i32,
    /// With the rows of their labels.
    marks: Vec<(&'a Mark, usize)>,
    /// Height of what is above the axis.
    above: i32,
    /// Height of all above the frame.
    pub header: i32,
}

/// Upper left and lower right corner.
pub(super) type Frame = [Pixel; 2];

impl<'a> Panel<'a> {
    /// Finds the ranges; `looks` gives each series its colour and marker.
    pub fn new(plot: &'a Plot, looks: Vec<usize>, sizes: Sizes) -> Result<Self> {
        Self::build(plot, looks, sizes).with_context(|| format!("plot {:?}", plot.title))
    }

    fn build(plot: &'a Plot, looks: Vec<usize>, sizes: Sizes) -> Result<Self> {
        if let Some(mark) = plot.marks.iter().find(|m| !plot.x.shows(m.x)) {
            bail!("mark {:?} at {} cannot be on axis {:?}", mark.label, mark.x, plot.x.label);
        }
        let shown = || plot.series.iter().flat_map(|s| &s.points).filter(|p| plot.x.shows(p.x) && plot.y.shows(p.y));
        if shown().next().is_none() {
            bail!("no point to show");
        }
        let y = Span::new(&plot.y, shown().flat_map(|p| p.spread.into_iter().flatten().chain([p.y])), plot.top)?;
        let ends = plot.lines.iter().flat_map(|l| [l.from, l.to]);
        let xs = shown().map(|p| p.x).chain(plot.marks.iter().map(|m| m.x)).chain(ends);
        let x = Span::new(&plot.x, xs, None)?;
        Ok(Self { plot, looks, x, y, sizes })
    }

    /// Series with a name.
    pub fn series_legend(&self) -> Legend {
        let named = self.plot.series.iter().zip(&self.looks).filter(|(s, _)| !s.name.is_empty());
        Legend(named.map(|(s, look)| (Key::Series(*look), s.legend())).collect())
    }

    /// Lines.
    pub fn line_legend(&self) -> Legend {
        let entry = |(k, line): (usize, &Straight)| (Key::Dashed(self.line_colour(k)), line.legend.clone());
        Legend(self.plot.lines.iter().enumerate().map(entry).collect())
    }

    pub fn above_legend(&self) -> Legend {
        let entry = (!self.rows_above().is_empty()).then(|| (Key::Above, "above the axis".to_owned()));
        Legend(entry.into_iter().collect())
    }

    pub fn legend(&self) -> Legend {
        Legend([self.series_legend().0, self.line_legend().0, self.above_legend().0].concat())
    }

    fn line_colour(&self, k: usize) -> RGBColor {
        match self.plot.series.iter().position(|s| s.name == self.plot.lines[k].name) {
            Some(series) => colour(self.looks[series]),
            None if k == 0 => GREY,
            None => colour(self.plot.series.len() + k),
        }
    }

    fn is_above(&self, p: &Point) -> bool {
        self.plot.x.shows(p.x) && self.plot.y.shows(p.y) && p.y > self.y.to()
    }

    /// Series with points above the axis, each of which has its row of triangles.
    fn rows_above(&self) -> Vec<usize> {
        let series = &self.plot.series;
        (0..series.len()).filter(|k| series[*k].points.iter().any(|p| self.is_above(p))).collect()
    }

    /// Marks from left to right with the row of each one's label, counted upwards. A label begins at its line;
    /// one that would reach over another's line stands above that one's label, so that no line crosses a word.
    fn mark_rows(&self, wide: i32) -> Vec<(&'a Mark, usize)> {
        let mut marks: Vec<&Mark> = self.plot.marks.iter().collect();
        marks.sort_by(|a, b| a.x.total_cmp(&b.x));
        let left = |m: &Mark| (self.x.fraction(m.x) * f64::from(wide)) as i32;
        let mut rows = vec![0; marks.len()];
        for j in (0..marks.len()).rev() {
            let end = left(marks[j]) + self.mark_width(marks[j]) + px(8.0);
            let reached = (j + 1..marks.len()).filter(|k| left(marks[*k]) < end);
            rows[j] = reached.map(|k| rows[k] + 1).max().unwrap_or(0);
        }
        marks.into_iter().zip(rows).collect()
    }

    fn mark_width(&self, mark: &Mark) -> i32 {
        px(4.0) + width(&mark.label, self.sizes.tick)
    }

    /// Where everything stands in a panel so wide.
    pub fn layout(&self, across: i32) -> Layout<'a> {
        let Sizes { title, label, tick, .. } = self.sizes;
        let most = ((self.high() - self.below()) / px(3.0 * tick)).max(2) as usize;
        let y_width = self.y.ticks(most).iter().map(|t| width(&t.1, tick)).max().unwrap_or(0);
        let left = px(24.0) + lines_height(1, label) + y_width;
        // Less where a mark's label would reach beyond the edge.
        let needed = |m: &Mark| f64::from(across - left - self.mark_width(m)) / self.x.fraction(m.x).max(0.3);
        let needed = self.plot.marks.iter().map(|m| needed(m) as i32);
        let wide = needed.fold(across - px(20.0) - left, i32::min).max(px(60.0));
        let marks = self.mark_rows(wide);
        let title_lines = wrap(&self.plot.title, title, across - px(24.0));
        let mark_rows = marks.iter().map(|r| r.1 as i32 + 1).max().unwrap_or(0);
        let above = ABOVE * self.rows_above().len() as i32;
        let header = px(14.0) + lines_height(title_lines.len(), title) + above + lines_height(1, tick) * mark_rows;
        Layout { title: title_lines, most, y_width, left, across, wide, marks, above, header }
    }

    /// Height of the frame with the labels below it.
    pub fn high(&self) -> i32 {
        px(self.sizes.high)
    }

    fn below(&self) -> i32 {
        lines_height(1, self.sizes.tick) + lines_height(1, self.sizes.label) + px(12.0)
    }

    /// Draws title, axes and data below and right of a corner, with at least the layout's header above the frame.
    pub fn draw(&self, page: &Area, layout: &Layout, (left, top): Pixel, header: i32) -> Result<()> {
        let Sizes { title, tick, .. } = self.sizes;
        let style = bold(title, HPos::Center, VPos::Center);
        write_lines(
            page,
            &layout.title,
            &style,
            title,
            (left + layout.across / 2, top + header - layout.header + px(6.0)),
        )?;
        let corner = (left + layout.left, top + header);
        let frame = [corner, (corner.0 + layout.wide, corner.1 + self.high() - self.below())];
        self.draw_axes(page, frame, layout)?;
        let row = lines_height(1, tick);
        for (mark, height) in &layout.marks {
            let x = self.at(frame, mark.x, self.y.from()).0;
            let y = frame[0].1 - layout.above - row * *height as i32;
            dashed(page, &[(x, frame[1].1), (x, y - row)], px(2.0), px(3.0), GREY.stroke_width(px(1.0) as u32))?;
            let style = words(tick, GREY, HPos::Left, VPos::Center);
            page.draw_text(&mark.label, &style, (x + px(4.0), y - row / 2))?;
        }
        for (k, line) in self.plot.lines.iter().enumerate() {
            self.draw_straight(page, frame, line, self.line_colour(k))?;
        }
        for (series, look) in self.plot.series.iter().zip(&self.looks) {
            self.draw_series(page, frame, series, *look)?;
        }
        for (row, k) in self.rows_above().into_iter().enumerate() {
            let above: Vec<&Point> = self.plot.series[k].points.iter().filter(|p| self.is_above(p)).collect();
            let y = frame[0].1 - px(2.0) - ABOVE * row as i32;
            let mut last = i32::MIN / 2;
            for x in above.iter().map(|p| self.at(frame, p.x, self.y.to()).0) {
                if (x - last).abs() >= px(9.0) {
                    draw::above(page, (x, y), colour(self.looks[k]))?;
                    last = x;
                }
            }
        }
        Ok(())
    }

    fn draw_axes(&self, page: &Area, frame: Frame, layout: &Layout) -> Result<()> {
        let Sizes { label, tick, .. } = self.sizes;
        let (wide, high) = (frame[1].0 - frame[0].0, frame[1].1 - frame[0].1);
        let x_ticks = x_tick_count(&self.x, wide, tick);
        let (left, below) = (
            px(16.0) + lines_height(1, label) + layout.y_width,
            lines_height(1, tick) + lines_height(1, label) + px(8.0),
        );
        let around = page.clone().shrink((frame[0].0 - left, frame[0].1), (wide + left, high + below));
        let mut chart = ChartBuilder::on(&around)
            .x_label_area_size(below)
            .y_label_area_size(left)
            .build_cartesian_2d(self.x.clone(), self.y.clone())?;
        let labels = |span: &Span, most| {
            let ticks = span.ticks(most);
            move |v: &f64| ticks.iter().find(|t| t.0 == *v).map_or_else(String::new, |t| t.1.clone())
        };
        let room = |text: &str, room: i32| label * (f64::from(room) / f64::from(width(text, label))).min(1.0);
        let size = room(&self.plot.x.label, wide + px(40.0)).min(room(&self.plot.y.label, high + px(30.0)));
        chart
            .configure_mesh()
            .x_desc(&self.plot.x.label)
            .y_desc(&self.plot.y.label)
            .axis_desc_style(words(size, INK, HPos::Center, VPos::Center))
            .label_style(words(tick, INK, HPos::Center, VPos::Center))
            .x_labels(x_ticks)
            .y_labels(layout.most)
            .x_label_formatter(&labels(&self.x, x_ticks))
            .y_label_formatter(&labels(&self.y, layout.most))
            .set_all_tick_mark_size(px(4.0))
            .axis_style(GREY.stroke_width(px(1.0) as u32))
            .bold_line_style(GRID.stroke_width(px(1.0) as u32))
            .light_line_style(FAINT.stroke_width(px(1.0) as u32))
            .draw()?;
        Ok(())
    }

    fn at(&self, [(left, top), (right, bottom)]: Frame, x: f64, y: f64) -> Pixel {
        use plotters::coord::ranged1d::Ranged as _;
        (self.x.map(&x, (left, right)), self.y.map(&y, (bottom, top)))
    }

    fn shown_at(&self, frame: Frame, x: f64, y: f64) -> Option<Pixel> {
        (self.plot.x.shows(x) && self.plot.y.shows(y)).then(|| self.at(frame, x, y))
    }

    fn draw_straight(&self, page: &Area, frame: Frame, line: &Straight, colour: RGBColor) -> Result<()> {
        let ends = [line.from, line.to].map(|x| if self.plot.x.shows(x) { self.x.fraction(x) } else { 0.0 });
        let [from, to] = ends;
        if from >= to {
            return Ok(());
        }
        // Not straight on a logarithmic axis.
        let places = (0..=64).map(|k| {
            let x = self.x.value(from + (to - from) * f64::from(k) / 64.0);
            self.shown_at(frame, x, line.intercept + line.slope * x)
        });
        for run in runs(&places.collect::<Vec<_>>(), frame) {
            dashed(page, &run, px(7.0), px(4.0), colour.stroke_width(px(1.5) as u32))?;
        }
        Ok(())
    }

    fn draw_series(&self, page: &Area, frame: Frame, series: &Series, look: usize) -> Result<()> {
        let places: Vec<_> = series.points.iter().map(|p| self.shown_at(frame, p.x, p.y)).collect();
        let colour = colour(look);
        for run in runs(&places, frame) {
            page.draw(&PathElement::new(run, colour.stroke_width(px(2.0) as u32)))?;
        }
        // No more markers than have room side by side.
        let every =
            (places.len() * px(3.0 * self.sizes.marker) as usize).div_ceil((frame[1].0 - frame[0].0) as usize).max(1);
        for (k, (point, place)) in series.points.iter().zip(&places).enumerate() {
            let Some((x, _)) = *place else { continue };
            if let Some(ends) = point.spread {
                self.draw_spread(page, frame, x, ends, colour)?;
            }
            let alone = |k: Option<usize>| k.and_then(|k| places.get(k)).is_none_or(Option::is_none);
            if !self.is_above(point) && (k % every == 0 || alone(k.checked_sub(1)) && alone(Some(k + 1))) {
                marker(page, place.unwrap_or_default(), look, px(self.sizes.marker))?;
            }
        }
        Ok(())
    }

    /// An error bar; an end that is not on the axis has no cap.
    fn draw_spread(&self, page: &Area, frame: Frame, x: i32, [low, high]: [f64; 2], colour: RGBColor) -> Result<()> {
        let end = |v: f64, beyond: i32| match self.plot.y.shows(v).then(|| self.y.fraction(v)) {
            Some(at) if (0.0..=1.0).contains(&at) => (self.at(frame, self.x.from(), v).1, true),
            Some(at) => (if at < 0.0 { frame[1].1 } else { frame[0].1 }, false),
            None => (beyond, false),
        };
        if low.is_nan() || high.is_nan() {
            return Ok(());
        }
        let cap = px(self.sizes.marker);
        let path = spread_path([end(low, frame[1].1), end(high, frame[0].1)], cap);
        let path: Vec<Pixel> = path.into_iter().map(|(across, along)| (x + across, along)).collect();
        Ok(page.draw(&PathElement::new(path, colour.stroke_width(px(1.5) as u32)))?)
    }
}

/// An error bar as (across, along): between two ends, each with a cap or none.
pub(super) fn spread_path(ends: [(i32, bool); 2], cap: i32) -> Vec<Pixel> {
    let side = |(along, capped): (i32, bool)| {
        if capped { vec![(-cap, along), (cap, along), (0, along)] } else { vec![(0, along)] }
    };
    side(ends[0]).into_iter().chain(side(ends[1]).into_iter().rev()).collect()
}

/// The greatest number of ticks whose labels keep apart.
pub(super) fn x_tick_count(x: &Span, wide: i32, size: f64) -> usize {
    let apart = |most: &usize| {
        let ticks = x.ticks(*most);
        ticks.windows(2).all(|t| {
            let gap = (x.fraction(t[1].0) - x.fraction(t[0].0)) * f64::from(wide);
            gap >= f64::from((width(&t[0].1, size) + width(&t[1].1, size)) / 2 + px(0.8 * size))
        })
    };
    (3..=14).rev().find(apart).unwrap_or(2)
}

/// Lines through points, broken where one is missing, and cut off at the upper and lower edge.
fn runs(points: &[Option<Pixel>], frame: Frame) -> Vec<Vec<Pixel>> {
    let (top, bottom) = (frame[0].1, frame[1].1);
    let clipped = |a: Pixel, b: Pixel| {
        let inside = |p: Pixel, q: Pixel| {
            let y = p.1.clamp(top, bottom);
            if y == p.1 {
                return p;
            }
            let part = f64::from(y - p.1) / f64::from(q.1 - p.1);
            ((f64::from(p.0) + f64::from(q.0 - p.0) * part).round() as i32, y)
        };
        let outside = a.1.max(b.1) < top || a.1.min(b.1) > bottom;
        (!outside).then(|| [inside(a, b), inside(b, a)])
    };
    let mut runs: Vec<Vec<Pixel>> = Vec::new();
    let mut goes_on = false;
    for pair in points.windows(2) {
        let segment = pair[0].zip(pair[1]).and_then(|(a, b)| clipped(a, b));
        if let Some([a, b]) = segment {
            match runs.last_mut().filter(|run| goes_on && run.last() == Some(&a)) {
                Some(run) => run.push(b),
                None => runs.push(vec![a, b]),
            }
        }
        goes_on = segment.is_some();
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(ys: &[f64], spread: f64) -> Vec<Point> {
        let point = |(k, y): (usize, &f64)| Point { x: 1.0 + k as f64, y: *y, spread: Some([y - spread, y + spread]) };
        ys.iter().enumerate().map(point).collect()
    }

    fn plot(series: Vec<Series>) -> Plot {
        Plot::new("A title", Axis::linear("iteration"), Axis::linear("energy [J]")).series(series)
    }

    fn count(svg: &str, what: &str) -> usize {
        svg.matches(what).count()
    }

    /// Polylines of the first series with the width of error bars.
    fn error_bars(svg: &str) -> usize {
        count(svg, "stroke=\"#0072B2\" stroke-width=\"3\" points")
    }

    #[test]
    fn a_plot_holds_its_words_error_bars_and_fits() {
        let line = Series::line("square <law>", points(&[1.0, 4.0, 9.0, 16.0], 0.5)).with_power_law();
        let fit = LinearFit::fit(&[[1.0, 1.0], [2.0, 3.0], [4.0, 7.0]]).unwrap();
        let marks = vec![Mark { x: 2.5, label: "level 2".into() }];
        let plot = plot(vec![line]).line("fit", fit).marks(marks);
        let svg = plot.svg().unwrap();
        for word in [
            "A title",
            "iteration",
            "energy [J]",
            "square &lt;law&gt;: exponent 2.00 on 1 to 4",
            "level 2",
            "fit: y = 2 x − 1, R² = 1.0000",
        ] {
            assert!(svg.contains(word), "{word}");
        }
        assert_eq!(error_bars(&svg), 4);
        assert!(svg.starts_with("<svg viewBox=\"0 0 2200 ") && svg.ends_with("</svg>\n"), "{svg}");
        assert_eq!(svg, plot.svg().unwrap());
    }

    #[test]
    fn what_cannot_be_shown_leaves_a_gap() {
        let ys = [3.0, f64::NAN, 2.0, f64::INFINITY, 1.0, 1.5];
        let mut gaps = points(&ys, 0.1);
        gaps[0].spread = Some([f64::NAN, 4.0]);
        let svg = plot(vec![Series::line("", gaps)]).svg().unwrap();
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        // Four markers and three error bars; the line is left between the last two.
        assert_eq!((count(&svg, "<circle"), error_bars(&svg)), (4, 3));
        let lines = svg.lines().filter(|l| l.contains("#0072B2\" stroke-width=\"4\""));
        assert_eq!(lines.map(|l| count(l, ",")).collect::<Vec<_>>(), [2]);

        for nothing in [vec![], vec![Series::line("", vec![])], vec![Series::line("", points(&[f64::NAN], 0.0))]] {
            let error = format!("{:#}", plot(nothing).svg().unwrap_err());
            assert_eq!(error, "plot \"A title\": no point to show");
        }
        let beyond = vec![Mark { x: f64::NAN, label: "never".into() }];
        assert!(plot(vec![Series::line("", points(&[1.0], 0.0))]).marks(beyond).svg().is_err());
    }

    #[test]
    fn values_above_the_top_are_triangles_at_the_edge() {
        let ys = [90.0, 8.0, 1e300, 5.0];
        let points = points(&ys, 0.0).into_iter().map(|p| Point { spread: None, ..p }).collect();
        let all = plot(vec![Series::line("a", points)]);
        let svg = all.clone().top(10.0).svg().unwrap();
        assert!(svg.contains("above the axis"));
        // Two, and the legend's.
        assert_eq!(count(&svg, "<polygon"), 3);
        // Two in the plot, one in the legend.
        assert_eq!(count(&svg, "<circle"), 3);
        assert!(!all.svg().unwrap().contains("above the axis"));
        let error = format!("{:#}", all.top(f64::NAN).svg().unwrap_err());
        assert!(error.contains("axis \"energy [J]\" cannot end at NaN"), "{error}");
    }

    #[test]
    fn lines_are_cut_at_the_edges() {
        let frame = [(0, 0), (100, 100)];
        let cut =
            runs(&[Some((0, 50)), Some((10, -50)), Some((20, 50)), None, Some((30, 150)), Some((40, 250))], frame);
        assert_eq!(cut, [vec![(0, 50), (5, 0)], vec![(15, 0), (20, 50)]]);
        let whole = runs(&[Some((0, 0)), Some((10, 50)), Some((20, 100)), None, Some((30, 1))], frame);
        assert_eq!(whole, [[(0, 0), (10, 50), (20, 100)]]);
    }

    #[test]
    fn no_label_of_a_mark_is_crossed() {
        let mark = |x: f64| Mark { x, label: format!("level {x}") };
        let plot = plot(vec![Series::line("", points(&[1.0; 9], 0.0))]).marks([1.0, 1.1, 1.2, 8.0].map(mark).to_vec());
        let panel = Panel::new(&plot, vec![0], LARGE).unwrap();
        let rows: Vec<usize> = panel.layout(WIDTH).marks.iter().map(|m| m.1).collect();
        assert_eq!(rows, [2, 1, 0, 0]);
    }

    #[test]
    fn markers_differ() {
        let draw = |look| page(100, |page| marker(page, (50, 50), look, 10)).unwrap();
        let shapes: Vec<String> = (0..10).map(draw).collect();
        for (k, shape) in shapes.iter().enumerate() {
            assert!(!shapes[..k].contains(shape), "{k}");
        }
    }
}
