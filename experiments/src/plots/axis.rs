//! [`Axis`] as the caller states it, its range, and numbers as labels.

use anyhow::{Result, bail};

/// What an axis shows.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) label: String,
    log: bool,
    from_zero: bool,
}

impl Axis {
    /// A linear axis over the range of the values; `label` is the quantity with its unit.
    #[must_use]
    pub fn linear(label: &str) -> Self {
        Self { label: label.to_owned(), log: false, from_zero: false }
    }

    /// A logarithmic axis over the range of the positive values.
    #[must_use]
    pub fn log(label: &str) -> Self {
        Self { log: true, ..Self::linear(label) }
    }

    /// Lets a linear axis hold zero.
    #[must_use]
    pub fn from_zero(mut self) -> Self {
        self.from_zero = true;
        self
    }

    /// Whether it can show `v`.
    pub(super) fn shows(&self, v: f64) -> bool {
        v.is_finite() && (!self.log || v > 0.0)
    }
}

/// The range of an axis.
#[derive(Debug, Clone)]
pub(super) struct Span {
    axis: Axis,
    from: f64,
    to: f64,
}

impl Span {
    /// Over those of `values` that the axis can show and that are at most `top`, with a little room; up to `top` exactly when some are
    /// greater.
    pub fn new(axis: &Axis, values: impl Iterator<Item = f64>, top: Option<f64>) -> Result<Self> {
        if axis.log && axis.from_zero {
            bail!("axis {:?} cannot be logarithmic and begin at zero", axis.label);
        }
        if let Some(top) = top.filter(|top| !axis.shows(*top) || axis.from_zero && *top <= 0.0) {
            bail!("axis {:?} cannot end at {top}", axis.label);
        }
        let most = top.unwrap_or(f64::INFINITY);
        let (above, mut shown): (Vec<f64>, Vec<f64>) = values.filter(|v| axis.shows(*v)).partition(|v| *v > most);
        if shown.is_empty() && above.is_empty() {
            bail!("axis {:?} has no value to show", axis.label);
        }
        if !above.is_empty() {
            shown.push(most);
        }
        if axis.from_zero {
            shown.push(0.0);
        }
        let (mut from, mut to) =
            shown.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |r, v| (r.0.min(*v), r.1.max(*v)));
        if axis.log {
            let length = to.ln() - from.ln();
            let room = if length < 0.1 { 1.3 } else { (0.04 * length).exp().clamp(1.02, 4.0) };
            (from, to) = ((from / room).max(f64::MIN_POSITIVE), (to * room).min(f64::MAX));
        } else {
            let size = from.abs().max(to.abs());
            let tiny = to - from <= 1e-9 * size || size == 0.0;
            let room = if size == 0.0 {
                1.0
            } else if tiny {
                0.1 * size
            } else {
                0.04 * (to - from)
            };
            let (low, high) = (from - room, to + room);
            // Not beyond zero, which is where a bar or an axis from zero begins.
            from = if from >= 0.0 && (axis.from_zero || low < 0.0) { 0.0 } else { low };
            to = if to <= 0.0 && axis.from_zero && size > 0.0 { 0.0 } else { high };
        }
        to = to.min(most);
        if !(from.is_finite() && to.is_finite() && (to - from).is_finite() && from < to) {
            bail!("axis {:?} cannot reach from {from:e} to {to:e}", axis.label);
        }
        Ok(Self { axis: axis.clone(), from, to })
    }

    /// 0 at the beginning, 1 at the end; not finite for what cannot be shown.
    pub fn fraction(&self, v: f64) -> f64 {
        if self.axis.log {
            (v.ln() - self.from.ln()) / (self.to.ln() - self.from.ln())
        } else {
            (v - self.from) / (self.to - self.from)
        }
    }

    pub fn label(&self) -> &str {
        &self.axis.label
    }

    pub fn to(&self) -> f64 {
        self.to
    }

    /// At most `most` round values with their labels.
    pub fn ticks(&self, most: usize) -> Vec<(f64, String)> {
        let values = if self.axis.log { self.log_ticks(most) } else { self.linear_ticks(most) };
        let labels = |digits| values.iter().map(|v| number(*v, digits)).collect::<Vec<_>>();
        let differ = |labels: &Vec<String>| labels.windows(2).all(|l| l[0] != l[1]);
        let labels = (3..15).map(labels).find(differ).unwrap_or_else(|| labels(15));
        values.into_iter().zip(labels).collect()
    }

    /// Multiples of 1, 2 or 5 times a power of ten.
    fn linear_ticks(&self, most: usize) -> Vec<f64> {
        let decade = 10f64.powf(((self.to - self.from) / most as f64).log10().floor());
        let multiples = |step: f64| {
            let (first, last) = ((self.from / step - 1e-9).ceil(), (self.to / step + 1e-9).floor());
            (0..(last - first + 1.0) as usize).map(|k| (first + k as f64) * step).collect::<Vec<_>>()
        };
        let steps = [1.0, 2.0, 5.0, 10.0, 20.0].map(|m| m * decade);
        steps.map(multiples).into_iter().find(|ticks| ticks.len() <= most).unwrap_or_default()
    }

    /// 1, 2, 5; 1, 3; powers of ten; every second of them, ...: the most that are few enough. Linear where even the first are too few.
    fn log_ticks(&self, most: usize) -> Vec<f64> {
        let all: [&[f64]; 3] = [&[1.0, 2.0, 5.0], &[1.0, 3.0], &[1.0]];
        let dense = self.multiples(1, all[0]);
        if dense.len() < 3 {
            return self.linear_ticks(most);
        }
        let few = |ticks: &Vec<f64>| ticks.len() <= most;
        let wide = (2..700).map(|stride| self.multiples(stride, all[2]));
        all.iter().map(|of| self.multiples(1, of)).chain(wide).find(few).unwrap_or_default()
    }

    fn multiples(&self, stride: i32, of: &[f64]) -> Vec<f64> {
        let decades = (self.from.log10().floor() as i32..=self.to.log10().floor() as i32).filter(|d| d % stride == 0);
        let values = decades.flat_map(|d| of.iter().map(move |m| m * 10f64.powi(d)));
        values.filter(|v| (-1e-9..=1.0 + 1e-9).contains(&self.fraction(*v))).collect()
    }
}

/// A number as a label of three digits: 0.02, 5, 20k, 1M, 1e-5.
pub(super) fn short(v: f64) -> String {
    number(v, 3)
}

fn number(v: f64, digits: i32) -> String {
    let trimmed = |text: String| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    };
    let rounded = |v: f64| {
        let after = (digits - 1 - v.abs().log10().floor() as i32).clamp(0, 17) as usize;
        trimmed(format!("{v:.after$}"))
    };
    // Half a unit of the last digit below a thousand is a thousand.
    let thousand = 1e3 - 0.5 * 10f64.powi((3 - digits).min(0));
    match v.abs() {
        0.0 => "0".to_owned(),
        size if size < 1e-3 || size >= 1e6 * thousand => {
            let text = format!("{v:.*e}", (digits - 1) as usize);
            let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
            format!("{}e{exponent}", trimmed(mantissa.to_owned()))
        }
        size if size >= 1e3 * thousand => format!("{}M", rounded(v / 1e6)),
        size if size >= thousand => format!("{}k", rounded(v / 1e3)),
        _ => rounded(v),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        let values = [0.0, 0.00123, 0.5, 12.0, 999.0, 999.7, 5000.0, 123_456.0, 1e6, 2.5e7, 3e9, -1.25e-5, -0.02];
        let labels = ["0", "0.00123", "0.5", "12", "999", "1k", "5k", "123k", "1M", "25M", "3e9", "-1.25e-5", "-0.02"];
        assert_eq!(values.map(short), labels);
        assert_eq!(number(999.7, 4), "999.7");
    }

    fn ticks(axis: Axis, values: [f64; 2], most: usize) -> Vec<String> {
        Span::new(&axis, values.into_iter(), None).unwrap().ticks(most).into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(Axis::linear(""), [0.0, 9.0], 6), ["0", "2", "4", "6", "8"]);
        assert_eq!(ticks(Axis::linear(""), [7.0, 9.0], 6), ["7", "7.5", "8", "8.5", "9"]);
        assert_eq!(ticks(Axis::linear("").from_zero(), [7.0, 9.0], 6), ["0", "2", "4", "6", "8"]);
        assert_eq!(ticks(Axis::linear(""), [100_001.0, 100_003.0], 3), ["100.001k", "100.002k", "100.003k"]);
        assert_eq!(ticks(Axis::linear(""), [-2e-20, 3e-20], 6), ["-2e-20", "-1e-20", "0", "1e-20", "2e-20", "3e-20"]);
        assert_eq!(ticks(Axis::log(""), [1.0, 100.0], 8), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(ticks(Axis::log(""), [1.0, 100.0], 5), ["1", "3", "10", "30", "100"]);
        assert_eq!(ticks(Axis::log(""), [1e-12, 1.0], 5), ["1e-12", "1e-9", "1e-6", "0.001", "1"]);
        assert_eq!(ticks(Axis::log(""), [3.0, 4.0], 6), ["3", "3.2", "3.4", "3.6", "3.8", "4"]);
        assert!(ticks(Axis::log(""), [5.0, 5.0], 6).len() >= 3);
    }

    #[test]
    fn a_range_holds_its_values_up_to_its_top() {
        let span = |axis: &Axis, values: &[f64], top| {
            let span = Span::new(axis, values.iter().copied(), top).unwrap();
            span.from..span.to
        };
        let (linear, log) = (Axis::linear(""), Axis::log(""));
        assert_eq!(span(&linear, &[1.0, 50.0, f64::NAN], Some(20.0)).end, 20.0);
        assert!((2.0..2.2).contains(&span(&linear, &[1.0, 2.0], Some(20.0)).end));
        assert_eq!(span(&linear.clone().from_zero(), &[4.0], None).start, 0.0);
        let range = span(&log, &[-1.0, 0.0, 0.1, 10.0], None);
        assert!((0.05..0.1).contains(&range.start) && (10.0..20.0).contains(&range.end), "{range:?}");
        let widest = Span::new(&log, [1e-300, 1e300].into_iter(), None).unwrap();
        assert!((widest.fraction(1.0) - 0.5).abs() < 1e-12 && widest.ticks(8).len() > 3);
        for (axis, values, top) in [
            (&linear, &[][..], None),
            (&linear, &[f64::NAN, f64::INFINITY], None),
            (&log, &[0.0, -1.0], None),
            (&log, &[1.0], Some(0.0)),
            (&linear, &[1.0], Some(f64::NAN)),
            (&linear, &[-1e308, 1e308], None),
            (&log.clone().from_zero(), &[1.0], None),
        ] {
            assert!(Span::new(axis, values.iter().copied(), top).is_err(), "{values:?} {top:?}");
        }
    }
}
