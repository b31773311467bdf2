//! [`GroupedBars`] and [`StackedBars`]: quantities of named things.

use anyhow::{Context as _, Result, bail};

use super::axis::{Axis, Span, short};
use super::canvas::{Anchor, Canvas, GREY, GRID, INK, Key, WIDTH, WORDS, colour, width};
use crate::report::table::shown;

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

const NO_VALUE: &str = "no value";
/// Height of a row.
const ROW: f64 = 24.0;

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

    /// The bars as SVG, each with its number.
    ///
    /// # Errors
    /// Without a finite value.
    pub fn svg(&self) -> Result<String> {
        let values = self.bars.iter().flat_map(|(_, b)| spread(b).into_iter().flatten().chain([b.value]));
        let axis = Axis::linear(&self.y).from_zero();
        let within = values.filter(|v| v.is_finite()).map(|v| v.min(self.top));
        let span = Span::new(&axis, within, None).with_context(|| format!("bars {:?}", self.title))?;
        let names = self.bars.iter().map(|(_, b)| width(&b.name, WORDS)).fold(60.0, f64::max);
        let (left, right) = (names + 24.0, WIDTH - 150.0);
        let at = |v: f64| left + span.fraction(v.min(self.top)) * (right - left);
        let mut canvas = Canvas::default();
        let mut y = 10.0;
        if !self.title.is_empty() {
            canvas.title([WIDTH / 2.0, 18.0], &self.title);
            y = 36.0;
        }
        let top = y;
        let mut rows = Vec::new();
        for (k, (group, bar)) in self.bars.iter().enumerate() {
            if k == 0 || self.bars[k - 1].0 != *group {
                if !group.is_empty() {
                    canvas.words([10.0, y + ROW / 2.0], group, Anchor::Start, "font-weight=\"bold\"");
                }
                y += ROW;
            }
            rows.push((bar, y + ROW / 2.0));
            y += ROW;
        }
        for (value, label) in span.ticks(9) {
            canvas.line([[at(value), top], [at(value), y]], GRID, 1.0, false);
            canvas.words([at(value), y + 13.0], &label, Anchor::Middle, "");
        }
        canvas.words([(left + right) / 2.0, y + 33.0], &self.y, Anchor::Middle, "");
        for &(bar, y) in rows.iter().filter(|r| r.0.value.is_finite()) {
            let [from, to] = [at(bar.value.min(0.0)), at(bar.value.max(0.0))];
            canvas.rectangle([from, y - 8.0], [to - from, 16.0], colour(5));
        }
        if let Some((first, from)) = rows.first().filter(|r| r.0.value.is_finite()) {
            canvas.line([[at(first.value), *from], [at(first.value), y]], INK, 1.0, true);
        }
        for (bar, y) in rows {
            canvas.words([left - 8.0, y], &bar.name, Anchor::End, "");
            if !bar.value.is_finite() {
                canvas.words([at(0.0) + 5.0, y], NO_VALUE, Anchor::Start, &format!("fill=\"{GREY}\""));
                continue;
            }
            let mut end = at(bar.value.max(0.0));
            if let Some(ends) = spread(bar) {
                canvas.line(ends.map(|v| [at(v), y]), INK, 1.5, false);
                end = end.max(at(ends[1]));
            }
            let beyond = if bar.value > self.top { ", off the scale" } else { "" };
            let words = format!("{}{beyond}", shown(bar.value));
            // On white: no line crosses it.
            canvas.rectangle([end + 3.0, y - 8.0], [width(&words, WORDS) + 4.0, 16.0], "#FFFFFF");
            canvas.words([end + 5.0, y], &words, Anchor::Start, "");
        }
        Ok(canvas.page(y + 46.0))
    }
}

/// The ends of a bar's error bar, if it has one.
fn spread(bar: &Bar) -> Option<[f64; 2]> {
    bar.spread.filter(|s| bar.value.is_finite() && s.iter().all(|v| v.is_finite()))
}

impl StackedBars {
    /// The bars as SVG; each part's size where it has room, and each bar's sum.
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
        let sums = (0..self.labels.len()).map(|k| finite(k).sum());
        let span = Span::new(&Axis::linear(&self.y).from_zero(), sums, None)?;
        let (left, right, top, bottom) = (100.0, WIDTH - 20.0, 44.0, 404.0);
        let at = |v: f64| bottom - span.fraction(v) * (bottom - top);
        let mut canvas = Canvas::default();
        canvas.title([WIDTH / 2.0, 18.0], &self.title);
        for (value, label) in span.ticks(9) {
            canvas.line([[left, at(value)], [right, at(value)]], GRID, 1.0, false);
            canvas.words([left - 6.0, at(value)], &label, Anchor::End, "");
        }
        canvas.upwards([16.0, (top + bottom) / 2.0], &self.y, Anchor::Middle);
        canvas.words([(left + right) / 2.0, bottom + 33.0], &self.x, Anchor::Middle, "");
        let slot = (right - left) / self.labels.len() as f64;
        let half = (0.36 * slot).min(48.0);
        for (k, label) in self.labels.iter().enumerate() {
            let x = left + slot * (k as f64 + 0.5);
            canvas.words([x, bottom + 13.0], label, Anchor::Middle, "");
            let mut sum = 0.0;
            for (part, (_, values)) in self.parts.iter().enumerate().filter(|(_, p)| p.1[k].is_finite()) {
                let (from, to, words) = (at(sum), at(sum + values[k]), short(values[k]));
                sum += values[k];
                canvas.rectangle([x - half, to], [2.0 * half, from - to], colour(part));
                if from - to >= 15.0 && width(&words, 12.0) + 4.0 <= 2.0 * half {
                    let style = if matches!(part % 7, 4 | 5) {
                        "font-size=\"12\""
                    } else {
                        "font-size=\"12\" fill=\"#FFFFFF\""
                    };
                    canvas.words([x, (from + to) / 2.0], &words, Anchor::Middle, style);
                }
            }
            if finite(k).count() == self.parts.len() {
                canvas.words([x, at(sum) - 9.0], &short(sum), Anchor::Middle, "font-weight=\"bold\"");
            }
        }
        let legend: Vec<_> = self.parts.iter().enumerate().map(|(k, p)| (Key::Swatch(k), p.0.clone())).collect();
        let end = canvas.legend([40.0, bottom + 48.0], WIDTH - 60.0, &legend);
        Ok(canvas.page(end + 8.0))
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
        svg.split("</text>").filter_map(|part| part.rsplit_once('>').map(|p| p.1)).filter(|t| *t != "\n").collect()
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
            ["Errors", "distance [mm]", "default", "smooth = 2", "distance = 4", "weights", "nodes", "1.25", NO_VALUE]
        {
            assert!(texts.contains(&text), "{text}: {texts:?}");
        }
        assert_eq!(svg.matches("stroke-width=\"1.5\"").count(), 2);
        assert_eq!(svg.matches("fill=\"#56B4E9\"").count(), 3);
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
        assert!(texts.contains(&"1.50") && texts.contains(&"8.75, off the scale"), "{texts:?}");
        assert!(!texts.contains(&"4") && !texts.contains(&"10"), "the axis ends at the top: {texts:?}");
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
