//! Lines on logarithmic axes, and the power laws that are straight lines there.

use std::path::Path;

use anyhow::{Context as _, Result};

use super::axis::Axis;
use super::plot::{Plot, Point, Series, Straight};
use super::write_svg;

/// Points that belong together.
#[derive(Debug, Clone)]
pub struct Line {
    /// Its name in the legend.
    pub name: String,
    /// (x, y), x ascending.
    pub points: Vec<[f64; 2]>,
}

/// What is in a plot.
#[derive(Debug, Clone, Copy)]
pub struct LogLog<'a> {
    /// What it shows.
    pub title: &'a str,
    /// The horizontal quantity with its unit.
    pub x: &'a str,
    /// The vertical quantity with its unit.
    pub y: &'a str,
    /// The lines; the legend adds each one's [`PowerLaw`](super::PowerLaw).
    pub lines: &'a [Line],
}

impl LogLog<'_> {
    /// Lines with their points, a dashed line of slope one from the lower left for comparison, and in the legend each line's exponent
    /// with the range of x that it was fitted to, as SVG.
    ///
    /// # Errors
    /// When there is no point that logarithmic axes can show.
    pub fn svg(&self) -> Result<String> {
        let point = |p: &[f64; 2]| Point { x: p[0], y: p[1], spread: None };
        let series = |l: &Line| Series::line(&l.name, l.points.iter().map(point).collect()).with_power_law();
        let shown =
            || self.lines.iter().flat_map(|l| &l.points).filter(|p| p.iter().all(|v| v.is_finite() && *v > 0.0));
        let least = |k: usize| shown().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let proportional = Straight {
            name: String::new(),
            legend: "proportional".to_owned(),
            intercept: 0.0,
            slope: least(1) / least(0),
            from: least(0),
            to: shown().map(|p| p[0]).fold(0.0, f64::max),
        };
        let plot = Plot::new(self.title, Axis::log(self.x), Axis::log(self.y));
        plot.series(self.lines.iter().map(series).collect()).straight(proportional).svg()
    }
}

/// Writes [`LogLog::svg`].
///
/// # Errors
/// When there is no point that logarithmic axes can show, or the file cannot be written.
pub fn write_log_log(path: &Path, plot: &LogLog<'_>) -> Result<()> {
    let svg = plot.svg().with_context(|| path.display().to_string())?;
    write_svg(path, &svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_holds_its_words_and_needs_a_point() {
        let lines = [Line { name: "solve".into(), points: vec![[10.0, 1.0], [100.0, 10.0]] }];
        let plot = LogLog { title: "A title", x: "vertices", y: "seconds", lines: &lines };
        let svg = plot.svg().unwrap();
        for word in ["A title", "vertices", "seconds", "solve: exponent 1.00 on 10 to 100", "proportional"] {
            assert!(svg.contains(word), "{word}");
        }
        assert!(LogLog { lines: &[], ..plot }.svg().is_err());
        let zero = [Line { name: "solve".into(), points: vec![[10.0, 0.0]] }];
        assert!(LogLog { lines: &zero, ..plot }.svg().is_err());
    }
}
