//! The formats of Menpo (<https://github.com/menpo/menpo>, `menpo/io/input/landmark.py`, and menpo3d's
//! `landmark_mesh.py`). None states a unit.
//!
//! - `.pts`: `version: 1`, `n_points: N`, and between braces a line `x y z` for each point, whose names are then "0", "1",
//!   ...; or that of IDAV Landmark, `Version 1.0`, N, and lines `name x y z`, where 9999 stands for a missing coordinate
//!   (read by Morpho's `read.pts`). Coordinates are taken as they are: Menpo's shift by one is for pixels.
//! - `.lm3` of the Bosphorus data: `N Landmarks:`, then by turns a label and a line `x y z`. As in Menpo labels become
//!   lower case with underscores for spaces; what is after `#` is a comment.
//! - `.ljson`, versions 1 to 3: points with labels that mask them. A point whose label masks nothing else has that label's
//!   name, if every point has one; otherwise names are "0", "1", .... Points with null are missing.

use std::fmt::Write as _;
use std::path::Path;

use super::json::{Json, wrong_entry};
use super::lines::{Line, Lines};
use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, Place, PlacedLandmark, ReadError};

const MISSING: &str = "9999";

pub(super) fn parse_pts(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut lines = Lines::new(text, path);
    let first = lines.expect("a line `version: 1`")?;
    match first.text.to_lowercase().split_whitespace().collect::<Vec<_>>().as_slice() {
        ["version:", "1"] | ["version:1"] => parse_braces(lines),
        ["version", "1.0"] => parse_idav(lines),
        _ => Err(first.wrong("a line `version: 1`, or `Version 1.0` of IDAV Landmark")),
    }
}

fn point_lines(format: LandmarkFormat, named: bool) -> LandmarkSet {
    LandmarkSet { format, named, ..LandmarkSet::default() }
}

fn parse_braces(mut lines: Lines) -> Result<LandmarkSet, ReadError> {
    let mut set = point_lines(LandmarkFormat::Pts, false);
    let line = lines.expect("a line `n_points: N`")?;
    let count = line.text.strip_prefix("n_points:").and_then(|n| n.trim().parse::<usize>().ok());
    let count = count.ok_or_else(|| line.wrong("a line `n_points: N`"))?;
    let brace = lines.expect("a line `{`")?;
    if brace.text != "{" {
        return Err(brace.wrong("a line `{`"));
    }
    loop {
        let line = lines.expect("a line `}`")?;
        if line.text == "}" {
            if set.landmarks.len() != count {
                return Err(line.error(format!("{count} points"), set.landmarks.len().to_string()));
            }
            return Ok(set);
        }
        let fields: Vec<&str> = line.text.split_whitespace().collect();
        if fields.len() == 2 {
            return Err(line.error("three coordinates of a point in space", "two, of a point in a picture"));
        }
        let place = LandmarkPlace::Position(line.point(&fields)?);
        set.landmarks.push(PlacedLandmark { name: set.landmarks.len().to_string(), place, sigma: None });
    }
}

fn parse_idav(mut lines: Lines) -> Result<LandmarkSet, ReadError> {
    let mut set = point_lines(LandmarkFormat::Pts, true);
    let line = lines.expect("the number of points")?;
    let count = line.text.parse::<usize>().map_err(|_| line.wrong("the number of points"))?;
    let mut last = line;
    for line in lines {
        last = line;
        let mut fields = line.text.split_whitespace();
        let name = fields.next().unwrap_or_default().to_owned();
        let fields: Vec<&str> = fields.collect();
        if fields.contains(&MISSING) {
            set.missing.push(name);
            continue;
        }
        let place = LandmarkPlace::Position(line.point(&fields)?);
        set.landmarks.push(PlacedLandmark { name, place, sigma: None });
    }
    let found = set.landmarks.len() + set.missing.len();
    if found != count {
        return Err(last.error(format!("{count} points"), found.to_string()));
    }
    Ok(set)
}

pub(super) fn parse_lm3(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut set = point_lines(LandmarkFormat::Lm3, true);
    let mut lines = Lines::new(text, path).filter(|l| !l.text.contains('#'));
    let mut next = |what: &str| -> Result<Line, ReadError> {
        lines.next().ok_or_else(|| ReadError::malformed(path, Place::File, what, "the end of the file"))
    };
    let first = next("a line `N Landmarks:`")?;
    let count = first.text.split_whitespace().next().and_then(|n| n.parse::<usize>().ok());
    let count = count.ok_or_else(|| first.wrong("a line `N Landmarks:`"))?;
    for i in 0..count {
        let label = next(&format!("the label of point {} of {count}", i + 1))?;
        let words: Vec<String> = label.text.split_whitespace().map(str::to_lowercase).collect();
        let line = next(&format!("coordinates of {:?}", label.text))?;
        let place = LandmarkPlace::Position(line.point(&line.text.split_whitespace().collect::<Vec<_>>())?);
        set.landmarks.push(PlacedLandmark { name: words.join("_"), place, sigma: None });
    }
    match lines.next() {
        Some(line) => Err(line.wrong(format!("the end of the file after {count} points"))),
        None => Ok(set),
    }
}

/// Whether an object is LJSON.
pub(super) fn is_ljson(json: &Json) -> bool {
    json.get("version").is_some_and(|v| v.whole().is_some())
        && (json.get("groups").is_some() || json.get("landmarks").is_some())
}

pub(super) fn parse_ljson(json: &Json, path: &Path) -> Result<LandmarkSet, ReadError> {
    let fail = |expected: &str, found: String| ReadError::malformed(path, Place::File, expected, found);
    let version = json.get("version").and_then(Json::whole).unwrap_or_default();
    let mut points: Vec<&Json> = Vec::new();
    let mut labels: Vec<(&str, Vec<f64>)> = Vec::new();
    if version == 1.0 {
        for group in json.get("groups").and_then(Json::array).unwrap_or_default() {
            let first = points.len();
            let own = group.get("landmarks").and_then(Json::array).unwrap_or_default();
            points.extend(own.iter().map(|p| p.get("point").unwrap_or(p)));
            let label = group.get("label").and_then(Json::text).unwrap_or_default();
            labels.push((label, (first..points.len()).map(|i| i as f64).collect()));
        }
    } else {
        let group = match (version, json.get("groups")) {
            (2.0, _) => json,
            (3.0, Some(Json::Object(groups))) => match groups.as_slice() {
                [(_, group)] => group,
                _ => {
                    let names: Vec<&str> = groups.iter().map(|(name, _)| name.as_str()).collect();
                    return Err(fail("one group of landmarks", format!("{}: {}", names.len(), names.join(", "))));
                }
            },
            (3.0, other) => return Err(fail("an object \"groups\"", other.map_or("nothing".to_owned(), Json::kind))),
            _ => return Err(fail("LJSON of version 1, 2 or 3", version.to_string())),
        };
        let list = group.get("landmarks").and_then(|l| l.get("points")).and_then(Json::array);
        points.extend(list.ok_or_else(|| fail("\"landmarks\" with \"points\"", group.kind()))?);
        for label in group.get("labels").and_then(Json::array).unwrap_or_default() {
            let mask = label.get("mask").and_then(Json::array).unwrap_or_default();
            let name = label.get("label").and_then(Json::text).unwrap_or_default();
            labels.push((name, mask.iter().filter_map(Json::whole).collect()));
        }
    }
    let mut own: Vec<Option<&str>> = vec![None; points.len()];
    for (name, mask) in &labels {
        if let [i] = mask.as_slice()
            && let Some(slot) = own.get_mut(*i as usize).filter(|_| *i >= 0.0)
        {
            slot.get_or_insert(name);
        }
    }
    let named = !own.is_empty() && own.iter().all(Option::is_some);
    let mut set = point_lines(LandmarkFormat::Ljson, named);
    for (i, point) in points.into_iter().enumerate() {
        let name = own[i].filter(|_| named).map_or_else(|| i.to_string(), str::to_owned);
        if point.array().is_some_and(|p| p.iter().any(|c| matches!(c, Json::Null))) {
            set.missing.push(name);
            continue;
        }
        if point.array().is_some_and(|p| p.len() == 2) {
            return Err(wrong_entry(path, &name, "a point in space", "two coordinates"));
        }
        let place = LandmarkPlace::Position(point.point(path, &name, "[x, y, z]")?);
        set.landmarks.push(PlacedLandmark { name, place, sigma: None });
    }
    Ok(set)
}

pub(super) fn render_pts(set: &LandmarkSet) -> String {
    let mut out = format!("version: 1\nn_points: {}\n{{\n", set.landmarks.len());
    for (_, p) in set.positions() {
        let _ = writeln!(out, "{} {} {}", p.x, p.y, p.z);
    }
    out.push_str("}\n");
    out
}

pub(super) fn render_lm3(set: &LandmarkSet) -> String {
    let mut out = format!("{} Landmarks:\n", set.landmarks.len());
    for (landmark, p) in set.positions() {
        let _ = writeln!(out, "{}\n{} {} {}", landmark.name, p.x, p.y, p.z);
    }
    out
}

pub(super) fn render_ljson(set: &LandmarkSet) -> String {
    let list = |items: Vec<String>| items.join(",\n          ");
    let labels = set.landmarks.iter().enumerate();
    let labels = labels.map(|(i, l)| format!("{{\"label\": {}, \"mask\": [{i}]}}", super::quoted(&l.name)));
    let points = set.positions().map(|(_, p)| format!("{:?}", p.as_slice()));
    format!(
        "{{\n  \"version\": 3,\n  \"groups\": {{\n    \"LJSON\": {{\n      \"labels\": [\n          {}\n      ],\n      \
         \"landmarks\": {{\n        \"points\": [\n          {}\n        ]\n      }}\n    }}\n  }}\n}}\n",
        list(labels.collect()),
        list(points.collect())
    )
}
