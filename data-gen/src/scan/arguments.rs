//! Values of options as a command line gives them.

use super::{Bend, Camera, WrinkleMix};

pub(crate) fn in_range(low: usize, high: usize) -> impl Fn(&str) -> Result<usize, String> + Clone {
    move |text| match text.parse() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(format!("a whole number from {low} to {high}")),
    }
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|t| t.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| format!("{N} numbers, separated by commas"))
}

pub(crate) fn two_numbers(text: &str) -> Result<[f64; 2], String> {
    numbers(text)
}

pub(crate) fn camera(text: &str) -> Result<Camera, String> {
    if let Ok([azimuth, elevation]) = numbers(text) {
        return Ok(Camera::orbit(azimuth, elevation));
    }
    let [azimuth, elevation, distance] =
        numbers(text).map_err(|_| "azimuth,elevation or azimuth,elevation,distance")?;
    Ok(Camera::Orbit { azimuth, elevation, distance })
}

pub(crate) fn camera_at(text: &str) -> Result<Camera, String> {
    Ok(Camera::Position(numbers(text)?))
}

pub(crate) fn wrinkles(text: &str) -> Result<WrinkleMix, String> {
    let [forehead, crows_feet, folds, skin] = numbers(text)?;
    Ok(WrinkleMix { forehead, crows_feet, folds, skin })
}

pub(crate) fn name_and_weight(text: &str) -> Result<(String, f64), String> {
    let parts = text.split_once('=').and_then(|(name, weight)| Some((name, weight.parse::<f64>().ok()?)));
    parts.map(|(name, weight)| (name.to_owned(), weight)).ok_or_else(|| "NAME=WEIGHT".into())
}

pub(crate) fn bend(text: &str) -> Result<Bend, String> {
    let parts = text.split_once('=').and_then(|(names, degrees)| {
        let (tip, joint) = names.split_once(',')?;
        Some(Bend { tip: tip.trim().into(), joint: joint.trim().into(), degrees: degrees.parse().ok()? })
    });
    parts.ok_or_else(|| "TIP,JOINT=DEGREES".into())
}
