//! [`Plot`]: points, lines and laws over two axes; [`Grid`]: plots side by side.

use anyhow::{Context as _, Result, bail};

use super::axis::{Axis, Span, short};
use super::canvas::{Anchor, Canvas, GREY, GRID, Key, WIDTH, WORDS, colour, width};
use super::fit::{LinearFit, PowerLaw};

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
    name: String,
    points: Vec<Point>,
    law: bool,
    look: Option<usize>,
}

impl Series {
    /// A line with a marker at each point. Without a name it is not in the legend.
    #[must_use]
    pub fn line(name: &str, points: Vec<Point>) -> Self {
        Self { name: name.to_owned(), points, law: false, look: None }
    }

    /// Sets colour and marker by number, so that they are the same in plots that are not on one page; unless set, a name has the place in
    /// which it first comes.
    #[must_use]
    pub fn with_look(mut self, look: usize) -> Self {
        self.look = Some(look);
        self
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

/// A dashed line between two points that are straight on the axes.
#[derive(Debug, Clone)]
struct Straight {
    name: String,
    legend: String,
    ends: [[f64; 2]; 2],
}

/// Points over two axes, with a legend below them.
#[derive(Debug, Clone)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
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

    /// Sets the greatest y shown. A point above it is a small upward triangle at the upper edge, in a row for each series.
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
    pub fn line(mut self, name: &str, fit: LinearFit) -> Self {
        let sign = if fit.intercept < 0.0 { '−' } else { '+' };
        let equation = format!("y = {} x {sign} {}", short(fit.slope), short(fit.intercept.abs()));
        let legend = format!("{name}: {equation}, R² = {:.4}", fit.r_squared);
        let ends = [fit.from, fit.to].map(|x| [x, fit.intercept + fit.slope * x]);
        self.lines.push(Straight { name: name.to_owned(), legend, ends });
        self
    }

    /// Adds a dashed line of slope one from the lowest left of all points: what is proportional.
    #[must_use]
    pub fn with_proportional(mut self) -> Self {
        let points = || self.series.iter().flat_map(|s| &s.points).filter(|p| self.x.shows(p.x) && self.y.shows(p.y));
        let least = |of: fn(&Point) -> f64| points().map(of).fold(f64::INFINITY, f64::min);
        let (x, y, to) = (least(|p| p.x), least(|p| p.y), points().map(|p| p.x).fold(0.0, f64::max));
        let ends = [[x, y], [to, y / x * to]];
        self.lines.push(Straight { name: String::new(), legend: "proportional".to_owned(), ends });
        self
    }

    /// The plot as SVG.
    ///
    /// # Errors
    /// When an axis has no value to show, or the top or a mark cannot be on its axis.
    pub fn svg(&self) -> Result<String> {
        Grid { columns: 1, plots: vec![self.clone()] }.svg()
    }
}

/// Plots in rows. A name of a series has the same colour and marker in all of them.
#[derive(Debug, Clone)]
pub struct Grid {
    /// Plots in a row.
    pub columns: usize,
    /// In the order of reading.
    pub plots: Vec<Plot>,
}

impl Grid {
    /// The plots as SVG, with one legend below all when all have the same series, otherwise one below each.
    ///
    /// # Errors
    /// Without a plot or column, or as [`Plot::svg`].
    pub fn svg(&self) -> Result<String> {
        if self.columns == 0 || self.plots.is_empty() {
            bail!("a grid of {} plots in {} columns", self.plots.len(), self.columns);
        }
        let columns = self.columns.min(self.plots.len());
        let mut names: Vec<&str> = Vec::new();
        for series in self.plots.iter().flat_map(|p| &p.series) {
            if !series.name.is_empty() && !names.contains(&series.name.as_str()) {
                names.push(&series.name);
            }
        }
        let wide = WIDTH / columns as f64;
        let panels = self.plots.iter().map(|plot| Panel::new(plot, &names, wide)).collect::<Result<Vec<_>>>()?;
        let alike = panels.len() > 1 && panels.iter().all(|p| p.series_legend() == panels[0].series_legend());
        let mut canvas = Canvas::default();
        let mut top = 0.0;
        for row in panels.chunks(columns) {
            // The same above all frames of a row, so that they are level.
            let header = row.iter().map(Panel::header).fold(0.0, f64::max);
            let mut bottom: f64 = 0.0;
            for (k, panel) in row.iter().enumerate() {
                let left = wide * k as f64;
                let end = panel.draw(&mut canvas, [left, top + header], header);
                let legend = if alike { panel.line_legend() } else { panel.legend() };
                bottom = bottom.max(canvas.legend([left + 40.0, end], wide - 60.0, &legend));
            }
            top = bottom + 10.0;
        }
        if alike {
            let above = panels.iter().map(Panel::above_legend).find(|l| !l.is_empty()).unwrap_or_default();
            top = canvas.legend([40.0, top], WIDTH - 60.0, &[panels[0].series_legend(), above].concat());
        }
        Ok(canvas.page(top + 8.0))
    }
}

/// A plot on its way onto a page.
struct Panel<'a> {
    plot: &'a Plot,
    looks: Vec<usize>,
    x: Span,
    y: Span,
    /// From the left edge to the frame.
    left: f64,
    /// Width and height of the frame.
    size: [f64; 2],
}

/// Height of a row of what is above the axis.
const ABOVE: f64 = 11.0;
/// Height of a row of marks' labels.
const ROW: f64 = 16.0;

impl<'a> Panel<'a> {
    fn new(plot: &'a Plot, names: &[&str], wide: f64) -> Result<Self> {
        Self::build(plot, names, wide).with_context(|| format!("plot {:?}", plot.title))
    }

    fn build(plot: &'a Plot, names: &[&str], wide: f64) -> Result<Self> {
        if let Some(mark) = plot.marks.iter().find(|m| !plot.x.shows(m.x)) {
            bail!("mark {:?} at {} cannot be on axis {:?}", mark.label, mark.x, plot.x.label);
        }
        let shown = || plot.series.iter().flat_map(|s| &s.points).filter(|p| plot.x.shows(p.x) && plot.y.shows(p.y));
        if shown().next().is_none() {
            bail!("no point to show");
        }
        let y = Span::new(&plot.y, shown().flat_map(|p| p.spread.into_iter().flatten().chain([p.y])), plot.top)?;
        let ends = plot.lines.iter().flat_map(|l| l.ends.map(|end| end[0]));
        let xs = shown().map(|p| p.x).chain(plot.marks.iter().map(|m| m.x)).chain(ends);
        let x = Span::new(&plot.x, xs, None)?;
        let look = |(k, s): (usize, &Series)| s.look.or_else(|| names.iter().position(|n| *n == s.name)).unwrap_or(k);
        let looks = plot.series.iter().enumerate().map(look).collect();
        let high = if wide < WIDTH { 270.0 } else { 380.0 };
        let ticks = y.ticks(high as usize / 40).iter().map(|t| width(&t.1, WORDS)).fold(0.0, f64::max);
        let left = 40.0 + ticks;
        // Less where a mark's label would reach beyond the edge.
        let needed = |m: &Mark| (wide - left - mark_width(m)) / x.fraction(m.x).max(0.3);
        let across = plot.marks.iter().map(needed).fold(wide - 20.0 - left, f64::min).max(60.0);
        Ok(Self { plot, looks, x, y, left, size: [across, high] })
    }

    fn series_legend(&self) -> Vec<(Key, String)> {
        let named = self.plot.series.iter().zip(&self.looks).filter(|(s, _)| !s.name.is_empty());
        named.map(|(s, look)| (Key::Series(*look), s.legend())).collect()
    }

    fn line_legend(&self) -> Vec<(Key, String)> {
        self.plot.lines.iter().map(|line| (Key::Dashed(self.line_colour(line)), line.legend.clone())).collect()
    }

    fn above_legend(&self) -> Vec<(Key, String)> {
        let entry = (!self.rows_above().is_empty()).then(|| (Key::Above, "above the axis".to_owned()));
        entry.into_iter().collect()
    }

    fn legend(&self) -> Vec<(Key, String)> {
        [self.series_legend(), self.line_legend(), self.above_legend()].concat()
    }

    fn line_colour(&self, line: &Straight) -> &'static str {
        let of = self.plot.series.iter().position(|s| s.name == line.name);
        of.map_or(GREY, |series| colour(self.looks[series]))
    }

    fn shows(&self, p: &Point) -> bool {
        self.plot.x.shows(p.x) && self.plot.y.shows(p.y)
    }

    fn is_above(&self, p: &Point) -> bool {
        self.shows(p) && p.y > self.y.to()
    }

    /// Series with points above the axis, each of which has its row of triangles.
    fn rows_above(&self) -> Vec<usize> {
        let series = &self.plot.series;
        (0..series.len()).filter(|k| series[*k].points.iter().any(|p| self.is_above(p))).collect()
    }

    /// Marks from left to right with the row of each one's label, counted upwards. A label begins at its line; one that would
    /// reach over another's line stands above that one's label, so that no line crosses a word.
    fn mark_rows(&self) -> Vec<(&'a Mark, usize)> {
        let mut marks: Vec<&Mark> = self.plot.marks.iter().collect();
        marks.sort_by(|a, b| a.x.total_cmp(&b.x));
        let left = |m: &Mark| self.x.fraction(m.x) * self.size[0];
        let mut rows = vec![0; marks.len()];
        for j in (0..marks.len()).rev() {
            let end = left(marks[j]) + mark_width(marks[j]);
            let reached = (j + 1..marks.len()).filter(|k| left(marks[*k]) < end);
            rows[j] = reached.map(|k| rows[k] + 1).max().unwrap_or(0);
        }
        marks.into_iter().zip(rows).collect()
    }

    /// Height of all above the frame.
    fn header(&self) -> f64 {
        let title = if self.plot.title.is_empty() { 14.0 } else { 36.0 };
        let rows = self.mark_rows().iter().map(|r| r.1 + 1).max().unwrap_or(0);
        title + ABOVE * self.rows_above().len() as f64 + ROW * rows as f64
    }

    /// Draws title, axes and data about a frame whose top is at `y` below a header of the row, in a panel whose left edge is at `x`;
    /// returns where they end.
    fn draw(&self, canvas: &mut Canvas, [x, y]: [f64; 2], header: f64) -> f64 {
        let [wide, high] = self.size;
        let corner = [x + self.left, y];
        let bottom = y + high;
        if !self.plot.title.is_empty() {
            canvas.title([corner[0] + wide / 2.0, y - header + 18.0], &self.plot.title);
        }
        for (value, label) in self.x.ticks((wide / 75.0) as usize) {
            let at = corner[0] + self.x.fraction(value) * wide;
            canvas.line([[at, y], [at, bottom]], GRID, 1.0, false);
            canvas.words([at, bottom + 13.0], &label, Anchor::Middle, "");
        }
        for (value, label) in self.y.ticks(high as usize / 40) {
            let at = bottom - self.y.fraction(value) * high;
            canvas.line([[corner[0], at], [corner[0] + wide, at]], GRID, 1.0, false);
            canvas.words([corner[0] - 6.0, at], &label, Anchor::End, "");
        }
        canvas.line([[corner[0], bottom], [corner[0] + wide, bottom]], GREY, 1.0, false);
        canvas.line([corner, [corner[0], bottom]], GREY, 1.0, false);
        canvas.words([corner[0] + wide / 2.0, bottom + 33.0], self.x.label(), Anchor::Middle, "");
        canvas.upwards([x + 16.0, y + high / 2.0], self.y.label(), Anchor::Middle);
        let above = self.rows_above();
        for (mark, row) in self.mark_rows() {
            let at = corner[0] + self.x.fraction(mark.x) * wide;
            let label = y - ABOVE * above.len() as f64 - ROW * (row as f64 + 0.5);
            canvas.line([[at, bottom], [at, label - ROW / 2.0]], GREY, 1.0, true);
            canvas.words([at + 4.0, label], &mark.label, Anchor::Start, "");
        }
        canvas.clipped(corner, self.size, |canvas| {
            for line in &self.plot.lines {
                canvas.line(line.ends.map(|[x, y]| self.at(x, y)), self.line_colour(line), 1.5, true);
            }
            for (k, (series, look)) in self.plot.series.iter().zip(&self.looks).enumerate() {
                self.draw_lines(canvas, series, *look, self.aside(k));
            }
        });
        for (k, (series, look)) in self.plot.series.iter().zip(&self.looks).enumerate() {
            for p in series.points.iter().filter(|p| self.shows(p) && !self.is_above(p)) {
                let [across, down] = self.at(p.x, p.y);
                canvas.marker([corner[0] + across + self.aside(k), y + down], *look);
            }
        }
        for (row, k) in above.into_iter().enumerate() {
            let y = y - 2.0 - ABOVE * row as f64;
            for p in self.plot.series[k].points.iter().filter(|p| self.is_above(p)) {
                canvas.above([corner[0] + self.x.fraction(p.x) * wide, y], colour(self.looks[k]));
            }
        }
        bottom + 48.0
    }

    /// From the frame's upper left corner; far outside the frame for what is far beyond the axis.
    fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let [across, up] = [self.x.fraction(x), self.y.fraction(y)].map(|f| f.clamp(-20.0, 20.0));
        [across * self.size[0], (1.0 - up) * self.size[1]]
    }

    /// Pixels by which a series stands beside where it is: error bars at one x would cover each other.
    fn aside(&self, series: usize) -> f64 {
        let has_bars = |s: &Series| s.points.iter().any(|p| p.spread.is_some_and(|[low, high]| low < high));
        let barred: Vec<usize> = (0..self.plot.series.len()).filter(|k| has_bars(&self.plot.series[*k])).collect();
        let Some(place) = barred.iter().position(|k| *k == series) else { return 0.0 };
        let mut xs: Vec<f64> = self
            .plot
            .series
            .iter()
            .flat_map(|s| &s.points)
            .filter(|p| self.shows(p))
            .map(|p| self.at(p.x, p.y)[0])
            .collect();
        xs.sort_by(f64::total_cmp);
        let gap = xs.windows(2).map(|w| w[1] - w[0]).filter(|gap| *gap > 1e-6).fold(f64::INFINITY, f64::min);
        let step = (0.5 * gap / barred.len() as f64).min(5.0);
        step * (place as f64 - (barred.len() - 1) as f64 / 2.0)
    }

    fn draw_lines(&self, canvas: &mut Canvas, series: &Series, look: usize, aside: f64) {
        let at = |x: f64, y: f64| [self.at(x, y)[0] + aside, self.at(x, y)[1]];
        for run in series.points.split(|p| !self.shows(p)).filter(|run| run.len() > 1) {
            canvas.polyline(&run.iter().map(|p| at(p.x, p.y)).collect::<Vec<_>>(), colour(look));
        }
        for p in series.points.iter().filter(|p| self.shows(p) && !self.is_above(p)) {
            if let Some([low, high]) = p.spread.filter(|s| s.iter().all(|v| !v.is_nan())) {
                let open = |v: f64, edge: f64| {
                    if self.plot.y.shows(v) { at(p.x, v) } else { [at(p.x, p.y)[0], edge] }
                };
                canvas.line([open(low, self.size[1]), open(high, 0.0)], colour(look), 1.5, false);
            }
        }
    }
}

fn mark_width(mark: &Mark) -> f64 {
    12.0 + width(&mark.label, WORDS)
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

    /// Error bars of the first series.
    fn error_bars(svg: &str) -> usize {
        count(svg, "stroke=\"#0072B2\" stroke-width=\"1.5\"/>")
    }

    #[test]
    fn a_plot_holds_its_words_error_bars_and_fits() {
        let line = Series::line("square <law>", points(&[1.0, 4.0, 9.0, 16.0], 0.5)).with_power_law();
        let fit = LinearFit::fit(&[[1.0, 1.0], [2.0, 3.0], [4.0, 7.0]]).unwrap();
        let marks = vec![Mark { x: 2.5, label: "level 2".into() }];
        let plot = plot(vec![line]).line("fit", fit).marks(marks).with_proportional();
        let svg = plot.svg().unwrap();
        for word in [
            "A title",
            "iteration",
            "energy [J]",
            "square &lt;law&gt;: exponent 2.00 on 1 to 4",
            "level 2",
            "fit: y = 2 x − 1, R² = 1.0000",
            "proportional",
        ] {
            assert!(svg.contains(word), "{word}");
        }
        assert_eq!(error_bars(&svg), 4);
        assert!(svg.starts_with("<svg viewBox=\"0 0 1100 ") && svg.ends_with("</svg>\n"), "{svg}");
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
        assert_eq!((count(&svg, "<circle"), error_bars(&svg), count(&svg, "<polyline")), (4, 3, 1));
        for nothing in [vec![], vec![Series::line("", vec![])], vec![Series::line("", points(&[f64::NAN], 0.0))]] {
            let error = format!("{:#}", plot(nothing).svg().unwrap_err());
            assert_eq!(error, "plot \"A title\": no point to show");
        }
        let beyond = vec![Mark { x: f64::NAN, label: "never".into() }];
        assert!(plot(vec![Series::line("", points(&[1.0], 0.0))]).marks(beyond).svg().is_err());
    }

    #[test]
    fn values_above_the_top_are_triangles_at_the_edge() {
        let points = points(&[90.0, 8.0, 1e300, 5.0], 0.0).into_iter().map(|p| Point { spread: None, ..p }).collect();
        let all = plot(vec![Series::line("a", points)]);
        let svg = all.clone().top(10.0).svg().unwrap();
        assert!(svg.contains("above the axis"));
        // Two triangles and two markers in the plot, one of each in the legend.
        assert_eq!((count(&svg, "<polygon"), count(&svg, "<circle")), (3, 3));
        assert!(!all.svg().unwrap().contains("above the axis"));
        let error = format!("{:#}", all.top(f64::NAN).svg().unwrap_err());
        assert!(error.contains("axis \"energy [J]\" cannot end at NaN"), "{error}");
    }

    #[test]
    fn no_label_of_a_mark_is_crossed() {
        let mark = |x: f64| Mark { x, label: format!("level {x}") };
        let plot = plot(vec![Series::line("", points(&[1.0; 9], 0.0))]).marks([1.0, 1.1, 1.2, 8.0].map(mark).to_vec());
        let panel = Panel::new(&plot, &[], WIDTH).unwrap();
        assert_eq!(panel.mark_rows().iter().map(|m| m.1).collect::<Vec<_>>(), [2, 1, 0, 0]);
    }

    fn named(title: &str, names: &[&str]) -> Plot {
        let points = || [1.0, 2.0].map(|x| Point { x, y: x, spread: None }).to_vec();
        Plot { title: title.into(), ..plot(names.iter().map(|n| Series::line(n, points())).collect()) }
    }

    #[test]
    fn one_legend_for_all_when_they_are_alike() {
        let legends = |plots: Vec<Plot>| count(&Grid { columns: 2, plots }.svg().unwrap(), ">blue line<");
        let names = ["blue line", "red line"];
        assert_eq!(legends(vec![named("one", &names), named("two", &names), named("three", &names)]), 1);
        assert_eq!(legends(vec![named("one", &names), named("two", &names), named("three", &names[..1])]), 3);
        assert!(Grid { columns: 2, plots: vec![] }.svg().is_err());
        assert!(Grid { columns: 0, plots: vec![named("one", &["a"])] }.svg().is_err());
    }

    #[test]
    fn error_bars_at_one_place_stand_side_by_side() {
        let series = |name: &str| Series::line(name, points(&[1.0, 2.0, 3.0], 0.5));
        let plot = plot(vec![series("a"), series("b"), series("c"), Series::line("bare", points(&[1.0], 0.0))]);
        let panel = Panel::new(&plot, &[], WIDTH).unwrap();
        assert_eq!([0, 1, 2, 3].map(|k| panel.aside(k)), [-5.0, 0.0, 5.0, 0.0]);
    }

    #[test]
    fn a_look_can_be_set() {
        let svg = plot(vec![Series::line("a", points(&[1.0], 0.0)).with_look(2)]).svg().unwrap();
        // Marker and error bar, line and marker of the legend.
        assert_eq!((count(&svg, "<circle"), count(&svg, "#009E73")), (0, 4));
    }

    #[test]
    fn a_name_looks_the_same_everywhere() {
        let svg = Grid { columns: 2, plots: vec![named("one", &["a", "b"]), named("two", &["b"])] }.svg().unwrap();
        // Markers of "b" are the only squares: two in each plot and one in each legend.
        assert_eq!(count(&svg, "<polygon"), 6);
        assert!(svg.contains("one") && svg.contains("two"));
    }
}
