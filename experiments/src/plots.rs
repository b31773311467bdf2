//! Plots with logarithmic axes, and the power laws that are straight lines in them.

use std::io::Write as _;
use std::ops::Range;
use std::path::Path;

use anyhow::{Result, anyhow};
use nonrigid::cli::Failure;
use nonrigid::mesh::io::write_atomically;
use plotters::prelude::*;
use serde::Serialize;

/// `y = factor x^exponent`, by least squares of the logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PowerLaw {
    /// The slope in a plot with logarithmic axes.
    pub exponent: f64,
    /// y at x = 1.
    pub factor: f64,
    /// Least x that it was fitted to.
    pub from: f64,
    /// Greatest x that it was fitted to.
    pub to: f64,
}

impl PowerLaw {
    /// Fits points (x, y). `None` without two different x, or where a number is not positive and finite.
    #[must_use]
    pub fn fit(points: &[[f64; 2]]) -> Option<Self> {
        if points.iter().flatten().any(|v| !(v.is_finite() && *v > 0.0)) {
            return None;
        }
        let logarithms: Vec<[f64; 2]> = points.iter().map(|p| p.map(f64::ln)).collect();
        let mean = |k: usize| logarithms.iter().map(|p| p[k]).sum::<f64>() / logarithms.len() as f64;
        let (x, y) = (mean(0), mean(1));
        let square: f64 = logarithms.iter().map(|p| (p[0] - x).powi(2)).sum();
        let product: f64 = logarithms.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
        let range = range_of(points.iter().map(|p| p[0]))?;
        let exponent = (range.end > range.start).then_some(product / square)?;
        Some(Self { exponent, factor: (y - exponent * x).exp(), from: range.start, to: range.end })
    }
}

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
    /// The lines; the legend adds each one's [`PowerLaw`].
    pub lines: &'a [Line],
}

/// Distinguishable with all common kinds of colour blindness (M. Okabe, K. Ito, "Color Universal Design", 2008).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

const SIZE: (u32, u32) = (960, 640);
const FONT: &str = "sans-serif";

/// Draws lines with their points, a dashed line of slope one for comparison, and in the legend each line's exponent with the range
/// of x that it was fitted to, as SVG.
///
/// # Errors
/// When there is no point that logarithmic axes can show, or the file cannot be written.
pub fn write_log_log(path: &Path, plot: &LogLog<'_>) -> Result<()> {
    let mut svg = String::new();
    draw(&mut svg, plot).map_err(|e| anyhow!("{}: {e}", path.display()))?;
    Ok(write_atomically(path, |file| file.write_all(svg.as_bytes())).map_err(Failure::writing)?)
}

fn draw(svg: &mut String, plot: &LogLog<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let shown = || plot.lines.iter().flat_map(|l| &l.points).filter(|p| p.iter().all(|v| v.is_finite() && *v > 0.0));
    let axis = |k: usize| range_of(shown().map(|p| p[k])).ok_or("no positive values to plot");
    let (x, y) = (axis(0)?, axis(1)?);
    // Room for the legend above the lines.
    let (wide, high) =
        (x.start / 1.25..x.end * 1.25, y.start / 2.0..y.end * 2.0 * (y.end / y.start).powf(0.4).max(3.0));

    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(plot.title, (FONT, 22))
        .margin(16)
        .x_label_area_size(52)
        .y_label_area_size(84)
        .build_cartesian_2d(wide.clone().log_scale(), high.clone().log_scale())?;
    chart
        .configure_mesh()
        .x_desc(plot.x)
        .y_desc(plot.y)
        .axis_desc_style((FONT, 17))
        .label_style((FONT, 15))
        .x_labels(8)
        .y_labels(8)
        .x_label_formatter(&|v| short(*v))
        .y_label_formatter(&|v| short(*v))
        .bold_line_style(BLACK.mix(0.15))
        .light_line_style(BLACK.mix(0.05))
        .draw()?;

    // From the lower left, as far as the plot goes.
    let end = x.end.min(x.start * high.end / y.start);
    let linear = [(x.start, y.start), (end, y.start * end / x.start)];
    chart
        .draw_series(DashedLineSeries::new(linear, 6, 5, BLACK.mix(0.5).stroke_width(1)))?
        .label("proportional")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 24, y)], BLACK.mix(0.5)));
    for (k, line) in plot.lines.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        // Beyond the colours, and without any: another mark.
        let size = [4, 6, 3][k / COLOURS.len() % 3];
        let points = || line.points.iter().map(|p| (p[0], p[1]));
        let name = match PowerLaw::fit(&line.points) {
            Some(law) => {
                format!("{}: exponent {:.2} on {} to {}", line.name, law.exponent, short(law.from), short(law.to))
            }
            None => line.name.clone(),
        };
        chart.draw_series(LineSeries::new(points(), colour.stroke_width(2)))?.label(name).legend(move |(x, y)| {
            EmptyElement::at((x, y))
                + PathElement::new([(0, 0), (24, 0)], colour.stroke_width(2))
                + Circle::new((12, 0), size, colour.filled())
        });
        chart.draw_series(points().map(|p| Circle::new(p, size, colour.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .margin(10)
        .legend_area_size(34)
        .label_font((FONT, 15))
        .background_style(WHITE.mix(0.9))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    root.present()?;
    Ok(())
}

fn range_of(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    values.fold(None, |range, v| {
        let range: Range<f64> = range.unwrap_or(v..v);
        Some(range.start.min(v)..range.end.max(v))
    })
}

/// A number as a label: 0.02, 5, 20k, 1M.
fn short(v: f64) -> String {
    let three = |v: f64| {
        let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 9) as usize;
        let text = format!("{v:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    };
    match v {
        0.0 => "0".to_owned(),
        v if v.abs() >= 999_500.0 => format!("{}M", three(v / 1e6)),
        v if v.abs() >= 999.5 => format!("{}k", three(v / 1e3)),
        v => three(v),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_exactly() {
        let points: Vec<[f64; 2]> = [3.0f64, 10.0, 47.0, 1000.0].iter().map(|x| [*x, 0.25 * x.powf(1.5)]).collect();
        let law = PowerLaw::fit(&points).unwrap();
        assert!((law.exponent - 1.5).abs() < 1e-13 && (law.factor - 0.25).abs() < 1e-13, "{law:?}");
        assert_eq!((law.from, law.to), (3.0, 1000.0));
        for none in [&points[..1], &[[2.0, 1.0], [2.0, 3.0]], &[[1.0, 0.0], [2.0, 3.0]], &[[1.0, f64::NAN], [2.0, 3.0]]]
        {
            assert_eq!(PowerLaw::fit(none), None);
        }
    }

    #[test]
    fn labels_are_short() {
        let labels = [0.0, 0.00123, 0.5, 12.0, 999.0, 999.7, 5000.0, 123_456.0, 1e6, 2.5e7].map(short);
        assert_eq!(labels, ["0", "0.00123", "0.5", "12", "999", "1k", "5k", "123k", "1M", "25M"]);
    }

    #[test]
    fn a_plot_holds_its_words_and_needs_a_point() {
        let lines = [Line { name: "solve".into(), points: vec![[10.0, 1.0], [100.0, 10.0]] }];
        let plot = LogLog { title: "A title", x: "vertices", y: "seconds", lines: &lines };
        let mut svg = String::new();
        draw(&mut svg, &plot).unwrap();
        for word in ["A title", "vertices", "seconds", "solve: exponent 1.00 on 10 to 100", "proportional"] {
            assert!(svg.contains(word), "{word}");
        }
        assert!(draw(&mut String::new(), &LogLog { lines: &[], ..plot }).is_err());
    }
}
