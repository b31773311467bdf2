//! sRGB (IEC 61966-2-1): colours as PLY, OBJ and screens have them, and the light that they stand for, as glTF has it.
//!
//! Mixing colours is mixing light, so whatever interpolates or averages them does so on the light: the mean of black and white
//! is then what a checkerboard looks like from afar, and not darker.

use super::Vec3;

/// Red, green and blue light of a colour, each from 0 to 1.
#[must_use]
pub fn to_light(color: [u8; 3]) -> Vec3 {
    let linear = |c: u8| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    color.map(linear).into()
}

/// The nearest colour of a light, [`to_light`] undone; what is below 0 or above 1 is cut off.
#[must_use]
pub fn from_light(light: Vec3) -> [u8; 3] {
    let encoded = |c: f64| {
        let c = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (c * 255.0).round() as u8 // `as` saturates
    };
    light.map(encoded).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_comes_back_also_from_32_bits_and_middle_grey_is_a_fifth_of_white() {
        for c in 0..=255u8 {
            let light = to_light([c, 255 - c, 128]);
            assert_eq!(from_light(light), [c, 255 - c, 128]);
            assert_eq!(from_light(light.map(|x| f64::from(x as f32))), [c, 255 - c, 128]);
        }
        assert!((to_light([118; 3]).x - 0.18).abs() < 0.002);
        assert_eq!(from_light(Vec3::new(-0.1, 0.5, 7.0)), [0, 188, 255]);
    }
}
