//! Landmarks of a template or a scan, in the files of the tools that people place them with.
//!
//! [`read_landmark_set`] reads any of them, by extension and content, into a [`LandmarkSet`]; [`write_landmark_set`] writes
//! one. [`read_landmarks`] pairs the landmarks of a scan with those of a template, [`read_template_landmarks`] fixes them to
//! a template. Each format is described, with its source, in the file of its name.

mod check;
mod json;
mod lines;
mod menpo;
mod meshlab;
mod native;
mod pairs;
mod places;
mod plain;
mod scalismo;
mod slicer;
mod text;

use std::fmt;
use std::io::Write as _;
use std::path::Path;
use std::str::FromStr;

pub use check::{LandmarkCheck, OnSurface, swapped_sides};
pub use pairs::{
    Landmark, OffTemplate, Source, TemplatePoint, pair_landmarks, parse_landmarks, read_landmarks,
    read_template_landmarks,
};
pub use places::{LandmarkError, PlaceKind};

use crate::io::{
    LengthUnit, Place, ReadError, WriteError, check_coordinates, excerpt, extension, read_file, without_mark,
    write_atomically,
};
use crate::mesh::Vec3;
use crate::text::{LONGEST_NAME, is_hidden};
use json::Json;

/// Where a landmark is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LandmarkPlace {
    /// A vertex of a mesh, as the file counts it, from 0.
    Vertex(i64),
    /// A point of a triangle of the fan triangulation of a mesh.
    Face {
        /// Index of the triangle.
        triangle: u64,
        /// Weights of its corners, not negative, with sum 1.
        barycentric: [f64; 3],
    },
    /// A point in space: millimetres if the set has a unit, and otherwise as in the file.
    Position(Vec3),
}

/// A landmark of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedLandmark {
    /// Its name, or number.
    pub name: String,
    /// Where it is.
    pub place: LandmarkPlace,
    /// Standard deviation of where it is, if known, in the unit of positions.
    pub sigma: Option<f64>,
}

/// What a landmark file holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LandmarkSet {
    /// The format of the file.
    pub format: LandmarkFormat,
    /// Its landmarks, in its order; every name once.
    pub landmarks: Vec<PlacedLandmark>,
    /// Whether the file names them; otherwise they are "0", "1", ....
    pub named: bool,
    /// Names of landmarks that the file says are not placed.
    pub missing: Vec<String>,
    /// The unit that the file or its format states; positions are brought to millimetres then.
    pub unit: Option<LengthUnit>,
    /// The space that the file states; positions are brought to LPS then.
    pub space: Option<PatientSpace>,
}

impl LandmarkSet {
    /// The landmarks that are points in space.
    pub(crate) fn positions(&self) -> impl Iterator<Item = (&PlacedLandmark, Vec3)> {
        self.landmarks.iter().filter_map(|l| match l.place {
            LandmarkPlace::Position(p) => Some((l, p)),
            _ => None,
        })
    }

    /// Whether one of them is a point in space.
    #[must_use]
    pub fn has_positions(&self) -> bool {
        self.positions().next().is_some()
    }

    /// Moves the points in space.
    pub fn map_positions(&mut self, to: impl Fn(Vec3) -> Vec3) {
        for landmark in &mut self.landmarks {
            if let LandmarkPlace::Position(p) = &mut landmark.place {
                *p = to(*p);
            }
        }
    }

    /// Brings positions and deviations to millimetres, where the file states no unit.
    pub fn assume(&mut self, unit: LengthUnit) {
        if self.unit.is_none() {
            self.scale(unit.millimetres());
            self.unit = Some(unit);
        }
    }

    /// Multiplies positions and deviations, to bring them to millimetres.
    pub fn scale(&mut self, factor: f64) {
        self.map_positions(|p| p * factor);
        for landmark in &mut self.landmarks {
            landmark.sigma = landmark.sigma.map(|s| s * factor);
        }
    }
}

/// Axes of a patient: towards left or right, posterior or anterior, and superior.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PatientSpace {
    /// Left, posterior, superior: DICOM's, and that of meshes which 3D Slicer writes.
    Lps,
    /// Right, anterior, superior: the one 3D Slicer shows.
    Ras,
}

impl PatientSpace {
    /// A point of this space in LPS, or the other way round: each is the other turned by half a turn about z.
    #[must_use]
    pub fn to_lps(self, p: Vec3) -> Vec3 {
        if self == Self::Ras { Vec3::new(-p.x, -p.y, p.z) } else { p }
    }
}

impl fmt::Display for PatientSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if *self == Self::Lps { "LPS" } else { "RAS" })
    }
}

/// Formats of landmark files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum LandmarkFormat {
    /// `.json` of this project.
    #[default]
    Native,
    /// Plain JSON: names, or numbers, and points or vertices.
    Points,
    /// Plain JSON of FaceForm's Wrap: names and points on triangles.
    Wrap,
    /// Scalismo's JSON.
    ScalismoJson,
    /// Scalismo's `.csv`.
    Csv,
    /// 3D Slicer's `.mrk.json`.
    SlicerJson,
    /// 3D Slicer's `.fcsv`.
    SlicerFcsv,
    /// MeshLab's `.pp`.
    MeshLab,
    /// `.pts` of Menpo or IDAV Landmark.
    Pts,
    /// `.lm3` of the Bosphorus data.
    Lm3,
    /// Menpo's `.ljson`.
    Ljson,
    /// `.txt`: pairs of a vertex or name and a point.
    Text,
}

const FORMATS: [(LandmarkFormat, &str); 12] = [
    (LandmarkFormat::Native, "native"),
    (LandmarkFormat::Points, "points"),
    (LandmarkFormat::Wrap, "wrap"),
    (LandmarkFormat::ScalismoJson, "scalismo"),
    (LandmarkFormat::Csv, "csv"),
    (LandmarkFormat::SlicerJson, "mrk.json"),
    (LandmarkFormat::SlicerFcsv, "fcsv"),
    (LandmarkFormat::MeshLab, "pp"),
    (LandmarkFormat::Pts, "pts"),
    (LandmarkFormat::Lm3, "lm3"),
    (LandmarkFormat::Ljson, "ljson"),
    (LandmarkFormat::Text, "txt"),
];

impl LandmarkFormat {
    /// The format that a file is written in by its name: `.json` is [`Self::Native`].
    #[must_use]
    pub fn of_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        if name.ends_with(".mrk.json") {
            return Some(Self::SlicerJson);
        }
        match extension(path).as_str() {
            "json" => Some(Self::Native),
            extension => FORMATS[4..].iter().find(|(_, name)| *name == extension).map(|(format, _)| *format),
        }
    }

    /// Whether it holds vertices or points of triangles besides points in space.
    #[must_use]
    pub fn holds(self, place: &LandmarkPlace) -> bool {
        match place {
            LandmarkPlace::Position(_) => self != Self::Wrap,
            LandmarkPlace::Face { .. } => matches!(self, Self::Native | Self::Wrap),
            LandmarkPlace::Vertex(_) => matches!(self, Self::Native | Self::Points),
        }
    }

    /// Whether it holds names.
    #[must_use]
    pub fn holds_names(self) -> bool {
        self != Self::Pts
    }

    /// Whether it holds deviations.
    #[must_use]
    pub fn holds_sigma(self) -> bool {
        matches!(self, Self::Native | Self::ScalismoJson)
    }
}

impl fmt::Display for LandmarkFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(FORMATS.iter().find(|(format, _)| format == self).map_or("", |(_, name)| name))
    }
}

impl FromStr for LandmarkFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        FORMATS
            .iter()
            .find(|(_, name)| *name == text)
            .map(|(format, _)| *format)
            .ok_or_else(|| format!("unknown format; known are {}", FORMATS.map(|(_, name)| name).join(", ")))
    }
}

/// Whose landmarks a plain JSON file holds, for its error messages.
#[derive(Clone, Copy)]
enum Side {
    Template,
    Target,
}

impl Side {
    fn whole(self) -> &'static str {
        match self {
            Self::Template => "an object of named template points or an array of vertex indices",
            Self::Target => "an object of named points or an array of points",
        }
    }

    fn entry(self) -> &'static str {
        match self {
            Self::Template => "a vertex index, [triangle, u, v] or [x, y, z]",
            Self::Target => "[x, y, z] or [triangle, u, v]",
        }
    }
}

/// Reads a landmark file.
///
/// # Errors
/// When the file cannot be read or is malformed, a number is not finite, or a name comes twice; the message names line or
/// landmark.
pub fn read_landmark_set(path: &Path) -> Result<LandmarkSet, ReadError> {
    read_side(path, Side::Template)
}

/// [`read_landmark_set`] of a scan's landmarks: errors say what those may be.
///
/// # Errors
/// As [`read_landmark_set`].
pub fn read_scan_landmark_set(path: &Path) -> Result<LandmarkSet, ReadError> {
    read_side(path, Side::Target)
}

fn read_side(path: &Path, side: Side) -> Result<LandmarkSet, ReadError> {
    parse(&read_file(path)?, path, side)
}

/// Parses the bytes of a landmark file; `path` says by its extension which format to expect, and is named in errors.
///
/// # Errors
/// As [`read_landmark_set`].
pub fn parse_landmark_set(bytes: &[u8], path: &Path) -> Result<LandmarkSet, ReadError> {
    parse(bytes, path, Side::Template)
}

fn parse(bytes: &[u8], path: &Path, side: Side) -> Result<LandmarkSet, ReadError> {
    let bytes = without_mark(bytes);
    let start = bytes.trim_ascii_start();
    let is_json = start.starts_with(b"{") || start.starts_with(b"[");
    let set = match (extension(path).as_str(), is_json) {
        ("txt", false) => text::parse(utf8(bytes, path)?, path)?,
        ("csv", _) => scalismo::parse_csv(utf8(bytes, path)?, path)?,
        ("fcsv", _) => slicer::parse_fcsv(utf8(bytes, path)?, path)?,
        ("pp", _) => meshlab::parse(utf8(bytes, path)?, path)?,
        ("pts", _) => menpo::parse_pts(utf8(bytes, path)?, path)?,
        ("lm3", _) => menpo::parse_lm3(utf8(bytes, path)?, path)?,
        ("json" | "ljson", _) | (_, true) => parse_json(Json::parse(bytes, path)?, path, side)?,
        _ if start.starts_with(b"# Markups fiducial file") => slicer::parse_fcsv(utf8(bytes, path)?, path)?,
        _ if start.starts_with(b"<") => meshlab::parse(utf8(bytes, path)?, path)?,
        _ if start.to_ascii_lowercase().starts_with(b"version") => menpo::parse_pts(utf8(bytes, path)?, path)?,
        _ => parse_json(Json::parse(bytes, path)?, path, side)?,
    };
    let mut names: Vec<&str> = set.landmarks.iter().map(|l| l.name.as_str()).collect();
    names.extend(set.missing.iter().map(String::as_str));
    if let Some(name) = names.iter().find(|name| name.chars().nth(LONGEST_NAME).is_some()) {
        let expected = format!("names of at most {LONGEST_NAME} letters");
        return Err(ReadError::malformed(path, Place::File, expected, excerpt(name.as_bytes())));
    }
    check_coordinates(path, &set.positions().map(|(_, p)| p).collect::<Vec<Vec3>>())?;
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(ReadError::malformed(path, Place::File, "every name once", format!("{:?} twice", pair[0])));
    }
    Ok(set)
}

fn parse_json(json: Json, path: &Path, side: Side) -> Result<LandmarkSet, ReadError> {
    if slicer::is(&json) {
        slicer::parse_json(&json, path)
    } else if menpo::is_ljson(&json) {
        menpo::parse_ljson(&json, path)
    } else if native::is(&json) {
        native::parse(&json, path)
    } else if scalismo::is(&json) {
        scalismo::parse_json(&json, path)
    } else {
        plain::parse(json, path, side)
    }
}

fn utf8<'a>(bytes: &'a [u8], path: &Path) -> Result<&'a str, ReadError> {
    std::str::from_utf8(bytes)
        .map_err(|e| ReadError::malformed(path, Place::Byte(e.valid_up_to()), "text in UTF-8", "something else"))
}

/// Text as JSON has it.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Writes a landmark file. Positions are written in millimetres if the set has a unit, and in the set's space.
///
/// # Errors
/// When the file cannot be written, or the format cannot hold the landmarks so that they are read back the same: places
/// that it has no form for, or names that would change. Deviations, and in `.pts` names, are left out where the format has
/// none.
pub fn write_landmark_set(path: &Path, set: &LandmarkSet, format: LandmarkFormat) -> Result<(), WriteError> {
    let fail = |expected: String, found: String| Err(WriteError::data(path, expected, found));
    if let Some(landmark) = set.landmarks.iter().find(|l| !format.holds(&l.place)) {
        let found = format!("{:?} at {:?}", landmark.name, landmark.place);
        return fail(format!("landmarks whose places {format} can hold (give the mesh that they are on)"), found);
    }
    let escapes = ["json", "ljson"].contains(&extension(path).as_str());
    if let Some(landmark) = set.landmarks.iter().find(|l| !escapes && l.name.contains(is_hidden)) {
        return fail(
            format!("names that {format} can hold, without control characters"),
            format!("{:?}", landmark.name),
        );
    }
    let text = render(set, format);
    let again = match parse_landmark_set(text.as_bytes(), path) {
        Ok(again) => again,
        Err(error) => {
            let mut one = set.clone();
            let unreadable = set.landmarks.iter().find(|landmark| {
                one.landmarks = vec![(*landmark).clone()];
                parse_landmark_set(render(&one, format).as_bytes(), path).is_err()
            });
            let found = unreadable.map_or_else(|| error.to_string(), |l| format!("{:?} at {:?}", l.name, l.place));
            return fail(format!("landmarks that {format} can hold"), found);
        }
    };
    let changed = (0..set.landmarks.len()).find(|&i| {
        let (ours, theirs) = (&set.landmarks[i], again.landmarks.get(i));
        !theirs.is_some_and(|t| same_place(&t.place, &ours.place) && (t.name == ours.name || !format.holds_names()))
    });
    if let Some(i) = changed {
        let read =
            again.landmarks.get(i).map_or_else(|| "nothing".to_owned(), |l| format!("{:?} at {:?}", l.name, l.place));
        let found = format!("{:?}, which would be read back as {read}", set.landmarks[i].name);
        return fail(format!("names and places that {format}, with this file extension, can hold"), found);
    }
    write_atomically(path, |out| out.write_all(text.as_bytes()))
}

fn render(set: &LandmarkSet, format: LandmarkFormat) -> String {
    match format {
        LandmarkFormat::Native => native::render(set),
        LandmarkFormat::Points | LandmarkFormat::Wrap => plain::render(set),
        LandmarkFormat::ScalismoJson => scalismo::render_json(set),
        LandmarkFormat::Csv => scalismo::render_csv(set),
        LandmarkFormat::SlicerJson => slicer::render_json(set),
        LandmarkFormat::SlicerFcsv => slicer::render_fcsv(set),
        LandmarkFormat::MeshLab => meshlab::render(set),
        LandmarkFormat::Pts => menpo::render_pts(set),
        LandmarkFormat::Lm3 => menpo::render_lm3(set),
        LandmarkFormat::Ljson => menpo::render_ljson(set),
        LandmarkFormat::Text => text::render(set),
    }
}

/// Whether places are equal; a third weight that a file leaves out is rounded.
fn same_place(a: &LandmarkPlace, b: &LandmarkPlace) -> bool {
    match (a, b) {
        (
            LandmarkPlace::Face { triangle: s, barycentric: [u, v, w] },
            LandmarkPlace::Face { triangle: t, barycentric: [x, y, z] },
        ) => s == t && u == x && v == y && (w - z).abs() < 1e-6,
        _ => a == b,
    }
}
