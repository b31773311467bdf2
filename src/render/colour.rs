//! Colour maps for values on vertices, and the scale between values and colours.

/// A colour as a PNG stores it: red, green, blue, sRGB.
pub type Rgb8 = [u8; 3];

/// Named colour maps, all readable with the common colour vision deficiencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColourMap {
    /// Dark violet to yellow: for magnitudes.
    #[default]
    Viridis,
    /// Blue through white to red: for signed values about zero.
    BlueRed,
}

impl ColourMap {
    /// Colour at `t` in 0 to 1, clamped; mid-grey for NaN.
    #[must_use]
    pub fn at(self, t: f64) -> Rgb8 {
        if t.is_nan() {
            return NO_VALUE;
        }
        let t = t.clamp(0.0, 1.0);
        let colour = match self {
            Self::Viridis => colorous::VIRIDIS.eval_continuous(t),
            Self::BlueRed => colorous::RED_BLUE.eval_continuous(1.0 - t),
        };
        [colour.r, colour.g, colour.b]
    }
}

/// Colour of a vertex that has no value.
pub(super) const NO_VALUE: Rgb8 = [150, 150, 150];

/// Which value gets which colour, and what the colour bar says about it.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourScale {
    /// The colours.
    pub map: ColourMap,
    /// Value at the low end of the map.
    pub low: f64,
    /// Value at the high end; everything above has its colour.
    pub high: f64,
    /// What is shown, for the bar.
    pub label: String,
    /// Unit, for the bar.
    pub unit: String,
    /// Whether values lie below `low`, above `high`: the bar then marks its end.
    pub clipped: [bool; 2],
}

impl ColourScale {
    /// A scale from `low` to `high`.
    #[must_use]
    pub fn new(map: ColourMap, low: f64, high: f64, label: &str, unit: &str) -> Self {
        Self { map, low, high, label: label.into(), unit: unit.into(), clipped: [false; 2] }
    }

    /// From zero to the 99th percentile of all finite `values`, rounded up to a readable number.
    #[must_use]
    pub fn for_magnitudes(values: &[f64], label: &str, unit: &str) -> Self {
        let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        finite.sort_unstable_by(f64::total_cmp);
        let last = finite.len().saturating_sub(1);
        let high = readable_above(finite.get(last - last / 100).copied().unwrap_or(1.0));
        let clipped = [false, finite.last().is_some_and(|v| *v > high)];
        Self { clipped, ..Self::new(ColourMap::Viridis, 0.0, high, label, unit) }
    }

    /// Symmetric about zero, to the 99th percentile of the finite |`values`|, rounded up to a readable number.
    #[must_use]
    pub fn for_signed(values: &[f64], label: &str, unit: &str) -> Self {
        let magnitudes: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        let high = Self::for_magnitudes(&magnitudes, label, unit).high;
        let clipped = [values.iter().any(|v| *v < -high), values.iter().any(|v| *v > high)];
        Self { clipped, ..Self::new(ColourMap::BlueRed, -high, high, label, unit) }
    }

    /// Position of `value` on the map: 0 at `low`, 1 at `high`, not clamped; NaN for NaN.
    #[must_use]
    pub fn position(&self, value: f64) -> f64 {
        let range = self.high - self.low;
        if range.is_finite() && range != 0.0 {
            (value - self.low) / range
        } else {
            (value - self.low).signum() * 0.5 + 0.5
        }
    }

    /// Colour of `value`.
    #[must_use]
    pub fn colour(&self, value: f64) -> Rgb8 {
        self.map.at(self.position(value))
    }

    /// Round values for the bar, four to eight of them, with as many decimals as they need.
    #[must_use]
    pub fn ticks(&self) -> Vec<(f64, String)> {
        let (low, high) = (self.low.min(self.high), self.low.max(self.high));
        let range = (self.high - self.low).abs();
        if !range.is_finite() || range <= 0.0 {
            return if range == 0.0 { vec![(low, format!("{low}"))] } else { Vec::new() };
        }
        let magnitude = 10f64.powf((range / 6.0).log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0].map(|m| m * magnitude).into_iter().find(|s| range / s <= 7.0);
        let step = step.unwrap_or(range);
        let exponent = step.log10().floor();
        let half_steps = (step / 10f64.powf(exponent) - 2.5).abs() < 1e-6;
        let decimals = ((-exponent).max(0.0) as usize + usize::from(half_steps && exponent <= 0.0)).min(12);
        let (first, last) = ((low / step - 1e-6).ceil(), (high / step + 1e-6).floor());
        let count = ((last - first).max(0.0) as usize).min(16);
        (0..=count)
            .map(|i| {
                let value = (first + i as f64) * step;
                let value = if value == 0.0 { 0.0 } else { value };
                (value, format!("{value:.decimals$}"))
            })
            .collect()
    }
}

/// The smallest of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten that is not below `value`; 1 for zero.
fn readable_above(value: f64) -> f64 {
    if !value.is_finite() || value <= 1e-300 {
        return 1.0;
    }
    let magnitude = 10f64.powf(value.log10().floor());
    let step = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0].map(|m| m * magnitude);
    step.into_iter().find(|s| *s >= value * (1.0 - 1e-9)).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let text = |low, high| -> Vec<String> {
            ColourScale::new(ColourMap::Viridis, low, high, "", "").ticks().into_iter().map(|t| t.1).collect()
        };
        assert_eq!(text(0.0, 3.0), ["0.0", "0.5", "1.0", "1.5", "2.0", "2.5", "3.0"]);
        assert_eq!(text(0.0, 0.6), ["0.0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6"]);
        assert_eq!(text(-3.0, 3.0), ["-3", "-2", "-1", "0", "1", "2", "3"]);
        assert_eq!(text(5.0, 5.0), ["5"]);
        assert!(text(f64::NAN, 1.0).is_empty());
    }

    #[test]
    fn scale_covers_the_values_and_says_when_it_clips() {
        let mut values = vec![0.5; 1000];
        values.push(40.0);
        values.push(f64::NAN);
        let scale = ColourScale::for_magnitudes(&values, "error", "mm");
        assert_eq!((scale.low, scale.high, scale.clipped), (0.0, 0.5, [false, true]));
        assert_eq!(scale.colour(f64::NAN), NO_VALUE);
        assert_eq!(scale.colour(1e9), scale.colour(0.5));
        assert_eq!(ColourScale::for_magnitudes(&[], "", "").high, 1.0);
        let signed = ColourScale::for_signed(&[-3.0, 1.0], "off", "mm");
        assert_eq!((signed.low, signed.high), (-3.0, 3.0));
    }
}
