//! MeshLab's picked points, `.pp`: XML with elements `<point x="" y="" z="" name="" active=""/>`, their attributes in any
//! order, inside `<PickedPoints>`; written and read by MeshLab's edit_pickpoints
//! (<https://github.com/cnr-isti-vclab/meshlab>). Points with `active="0"` are missing. No unit is stated.

use std::fmt::Write as _;
use std::path::Path;

use super::{LandmarkFormat, LandmarkPlace, LandmarkSet, Place, PlacedLandmark, ReadError};
use crate::io::excerpt;
use crate::mesh::Vec3;

const ENTITIES: [(&str, &str); 5] = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];

pub(super) fn parse(text: &str, path: &Path) -> Result<LandmarkSet, ReadError> {
    let mut set = LandmarkSet { format: LandmarkFormat::MeshLab, named: true, ..LandmarkSet::default() };
    let mut inside = false;
    let (mut at, mut line, mut counted) = (0, 1, 0);
    while let Some(found) = text[at..].find('<') {
        let start = at + found;
        let rest = &text[start..];
        line += text[counted..start].matches('\n').count();
        counted = start;
        let error = |expected: &str, found: &str| ReadError::malformed(path, Place::Line(line), expected, found);
        let (end, comment) = if rest.starts_with("<!--") { (rest.find("-->"), true) } else { (tag_end(rest), false) };
        let Some(end) = end else { return Err(error("the end of an element", "the end of the file")) };
        at = start + end + 1;
        let tag = rest[1..end].trim_end_matches('/').trim();
        let (element, attributes) = tag.split_once(char::is_whitespace).unwrap_or((tag, ""));
        inside |= element == "PickedPoints";
        if comment || element != "point" {
            continue;
        }
        let attributes = parse_attributes(attributes).ok_or_else(|| error("attributes key=\"value\"", tag))?;
        let get = |key: &str| attributes.iter().find(|(k, _)| *k == key).map(|(_, value)| value.as_str());
        let Some(name) = get("name") else { return Err(error("a point with a name", &excerpt(tag.as_bytes()))) };
        if get("active") == Some("0") {
            set.missing.push(name.to_owned());
            continue;
        }
        let mut position = Vec3::zeros();
        for (coordinate, key) in position.iter_mut().zip(["x", "y", "z"]) {
            let value = get(key).and_then(|v| v.trim().parse::<f64>().ok()).filter(|v| v.is_finite());
            *coordinate = value.ok_or_else(|| {
                let found = get(key).map_or_else(|| "none".to_owned(), |v| excerpt(v.as_bytes()));
                error(&format!("a finite coordinate {key} of landmark {name:?}"), &found)
            })?;
        }
        let place = LandmarkPlace::Position(position);
        set.landmarks.push(PlacedLandmark { name: name.to_owned(), place, sigma: None });
    }
    if !inside {
        return Err(ReadError::malformed(path, Place::File, "<PickedPoints>", excerpt(text.trim().as_bytes())));
    }
    Ok(set)
}

/// Where the `>` of a tag is: one between quotation marks is text.
fn tag_end(text: &str) -> Option<usize> {
    let mut mark = None;
    text.char_indices().find_map(|(i, c)| {
        match (mark, c) {
            (None, '>') => return Some(i),
            (None, '"' | '\'') => mark = Some(c),
            (Some(m), c) if m == c => mark = None,
            _ => {}
        }
        None
    })
}

fn parse_attributes(mut text: &str) -> Option<Vec<(&str, String)>> {
    let mut attributes = Vec::new();
    loop {
        text = text.trim_start();
        if text.is_empty() {
            return Some(attributes);
        }
        let (key, rest) = text.split_once('=')?;
        let rest = rest.trim_start();
        let mark = rest.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        let (value, rest) = rest[1..].split_once(mark)?;
        let plain = ENTITIES.iter().fold(value.to_owned(), |v, (entity, c)| v.replace(entity, c));
        attributes.push((key.trim(), plain));
        text = rest;
    }
}

pub(super) fn render(set: &LandmarkSet) -> String {
    let mut out = String::from("<!DOCTYPE PickedPoints>\n<PickedPoints>\n");
    for (landmark, p) in set.positions() {
        let escaped = ENTITIES.iter().rev().fold(landmark.name.clone(), |v, (entity, c)| v.replace(c, entity));
        let _ = writeln!(out, " <point x=\"{}\" y=\"{}\" z=\"{}\" active=\"1\" name=\"{escaped}\"/>", p.x, p.y, p.z);
    }
    out.push_str("</PickedPoints>\n");
    out
}
