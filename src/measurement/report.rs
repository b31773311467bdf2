//! Measurements in a folder: numbers, pictures, and one page with both.

use std::io::Write as _;
use std::path::Path;

use image::RgbImage;

use super::output::Table;
use super::{FacialFrame, MeasurementError, Measurements, Subject};
use crate::mesh::io::{WriteError, write_atomically, write_folder};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::page;
use crate::render::{
    Camera, ColourMap, ColourScale, Frame, Rgb8, Scene, Sheet, Style, View, encode_png, error_sheet, render,
};
use crate::text;

/// What a report is made of.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// Head of the page.
    pub title: &'a str,
    /// Lines below it: name and text.
    pub about: &'a [(String, String)],
    /// What is measured.
    pub subject: Subject<'a>,
    /// Weight `G` of each vertex, 0 to 1, for the overlay of equation (4) of Li et al. 2018.
    pub mask: Option<&'a [f64]>,
    /// Its colour `C_s`; the paper's is red.
    pub mask_colour: Rgb8,
    /// Side of each picture, pixels.
    pub panel: u32,
}

impl<'a> Report<'a> {
    /// A report without a mask, its pictures 360 pixels wide.
    #[must_use]
    pub fn new(title: &'a str, subject: Subject<'a>) -> Self {
        Self { title, about: &[], subject, mask: None, mask_colour: [255, 0, 0], panel: 360 }
    }
}

/// What [`write()`] writes.
pub const FILES: [&str; 5] = ["measurements.json", "measurements.csv", "pictures.png", "symmetry.png", "index.html"];

const VIEWS: [View; 3] = [View::Front, View::Side, View::ThreeQuarter];

/// Measures and writes `measurements.json`, `measurements.csv`, `pictures.png`, `symmetry.png` and `index.html`, which holds them all,
/// into a folder ([`FILES`]); makes the folder if it is not there. Everything is computed before the first file is written, and all files
/// are written or none.
///
/// # Errors
/// As [`Subject::measure`], when the mask does not fit the mesh, or when a file cannot be written ([`MeasurementError::is_writing`]).
pub fn write(folder: &Path, report: &Report<'_>) -> Result<Measurements, MeasurementError> {
    write_with(folder, report, |_| Ok(()))
}

/// [`write()`], with further files in the same folder: `besides` writes them into the one that it is given.
///
/// # Errors
/// As [`write()`], or the one of `besides`.
pub fn write_with(
    folder: &Path,
    report: &Report<'_>,
    besides: impl FnOnce(&Path) -> Result<(), WriteError>,
) -> Result<Measurements, MeasurementError> {
    check_mask(report)?;
    let measured = report.subject.measure()?;
    let [pictures, symmetry] = [pictures(report, &measured), symmetry_pictures(report, &measured)];
    let [pictures, symmetry] = [encode_png(&pictures)?, encode_png(&symmetry)?];
    let html = html(report, &measured, &pictures, &symmetry);
    write_folder(folder, |aside| {
        let [json, csv, pictures_file, symmetry_file, page] = FILES.map(|name| aside.join(name));
        write_json(&json, &measured)?;
        for (path, bytes) in [
            (csv, measured.to_csv().as_bytes()),
            (pictures_file, &pictures),
            (symmetry_file, &symmetry),
            (page, html.as_bytes()),
        ] {
            write_atomically(&path, |file| file.write_all(bytes))?;
        }
        besides(aside)
    })?;
    Ok(measured)
}

/// Writes measurements as JSON.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json(path: &Path, measured: &Measurements) -> Result<(), WriteError> {
    write_atomically(path, |file| writeln!(file, "{}", text::json(serde_json::to_string_pretty(measured)?)))
}

fn check_mask(report: &Report<'_>) -> Result<(), MeasurementError> {
    let Some(mask) = report.mask else { return Ok(()) };
    let expected = report.subject.mesh.positions.len();
    if mask.len() != expected {
        return Err(MeasurementError::VertexCount { what: "the mask", found: mask.len(), expected });
    }
    match mask.iter().position(|g| !(0.0..=1.0).contains(g)) {
        Some(vertex) => Err(MeasurementError::Mask { vertex, value: mask[vertex] }),
        None => Ok(()),
    }
}

/// The shapes upright and facing the viewer, as far as landmarks say how: before, then after. Both in the frame of before.
fn upright(subject: &Subject<'_>, measured: &Measurements) -> Vec<PolygonMesh> {
    let frame: Option<FacialFrame> = measured.before.frame;
    let turned = |positions: &[Vec3]| {
        let positions = positions.iter().map(|p| frame.map_or(*p, |f| f.coordinates(*p))).collect();
        subject.mesh.with_positions(positions)
    };
    std::iter::once(&subject.mesh.positions[..]).chain(subject.after).map(turned).collect()
}

/// A heading, and what the camera of a view sees below it.
type Column<'a> = (&'static str, Box<dyn Fn(&Camera) -> Scene + 'a>);

/// A row for each view: before, its landmarks, after, the mask over before, the displacement on after.
fn pictures(report: &Report<'_>, measured: &Measurements) -> RgbImage {
    let shapes = upright(&report.subject, measured);
    let surfaces: Vec<TriangleMesh> = shapes.iter().map(PolygonMesh::triangulate).collect();
    let clay = |k: usize| Scene::new().mesh(&surfaces[k], Style::Clay);
    let frame = shapes.iter().map(|s| Frame::of(&s.positions)).reduce(Frame::union);
    let frame = frame.unwrap_or_else(|| Frame::of(&[])).scaled(0.95);

    let is_pair = surfaces.len() > 1;
    let mut columns: Vec<Column<'_>> = vec![(if is_pair { "before" } else { "face" }, Box::new(|_: &Camera| clay(0)))];
    if !measured.before.landmarks.is_empty() {
        let place = |p: &Vec3| measured.before.frame.map_or(*p, |f| f.coordinates(*p));
        let points: Vec<Vec3> = measured.before.landmarks.iter().map(|l| place(&l.1)).collect();
        let reach = 0.02 * frame.half.norm();
        columns.push((
            "landmarks",
            Box::new(move |camera: &Camera| {
                // Off the surface, towards the viewer: whole discs.
                let shown = points.iter().map(|p| p + (camera.eye() - p).normalize() * reach).collect::<Vec<_>>();
                clay(0).points(&shown, [24, 64, 150], f64::from(report.panel) / 120.0)
            }),
        ));
    }
    if is_pair {
        columns.push(("after", Box::new(|_: &Camera| clay(1))));
    }
    if let Some(mask) = report.mask {
        let style = Style::Overlay(mask.to_vec(), report.mask_colour);
        let surface = &surfaces[0];
        columns.push(("mask", Box::new(move |_: &Camera| Scene::new().mesh(surface, style.clone()))));
    }
    let mut sheet = Sheet::new("");
    if let Some(after) = report.subject.after {
        let moved: Vec<f64> = report.subject.mesh.positions.iter().zip(after).map(|(b, a)| (a - b).norm()).collect();
        // Most of a face may not move at all: the scale is that of what does.
        let some: Vec<f64> = moved.iter().copied().filter(|d| *d > 0.0).collect();
        let scale = ColourScale::for_magnitudes(&some, "displacement", "mm");
        sheet = sheet.colour_bar(&scale);
        let style = Style::Values(moved, scale);
        let surface = &surfaces[1];
        columns.push(("displacement", Box::new(move |_: &Camera| Scene::new().mesh(surface, style.clone()))));
    }
    let size = [report.panel; 2];
    sheet = sheet.columns(&columns.iter().map(|c| c.0).collect::<Vec<_>>());
    for view in VIEWS {
        let camera = Camera::framing(&frame, view, size);
        sheet = sheet.row(&view.name(), columns.iter().map(|(_, see)| render(&see(&camera), &camera, size)).collect());
    }
    sheet.render()
}

/// By how much each vertex stands out over the mirror image of the other side, before and after on one scale.
fn symmetry_pictures(report: &Report<'_>, measured: &Measurements) -> RgbImage {
    let shapes = upright(&report.subject, measured);
    let offsets: Vec<&[f64]> =
        std::iter::once(&measured.before).chain(&measured.after).map(|s| &s.symmetry.offsets[..]).collect();
    let all: Vec<f64> = offsets.concat();
    let mut scale = ColourScale::for_signed(&all, "over the mirror image", "mm");
    // Rounding is not worth a colour.
    if scale.high < LEAST_ASYMMETRY {
        scale = ColourScale::new(ColourMap::BlueRed, -LEAST_ASYMMETRY, LEAST_ASYMMETRY, &scale.label, &scale.unit);
    }
    let headings = if shapes.len() > 1 { ["before", "after"] } else { ["face", ""] };
    let results: Vec<(&str, &PolygonMesh, &[f64])> =
        headings.iter().zip(&shapes).zip(&offsets).map(|((h, s), o)| (*h, s, *o)).collect();
    let views = [View::Front, View::ThreeQuarter, View::Angles { yaw: -40.0, pitch: 5.0 }];
    error_sheet("", &results, &scale, &views, report.panel)
}

/// Half the width of the narrowest scale of asymmetries, millimetres.
const LEAST_ASYMMETRY: f64 = 0.01;

fn html(report: &Report<'_>, measured: &Measurements, pictures: &[u8], symmetry: &[u8]) -> String {
    let mut body = format!("<h1>{}</h1>\n", page::escaped(report.title));
    for (name, text) in report.about {
        body += &format!("<p class=\"about\"><b>{}</b> {}</p>\n", page::escaped(name), page::escaped(text));
    }
    body += &page::picture(pictures, "Upright by the landmarks: the vertical runs from menton to nasion.");
    for Table { title, header, rows, note } in measured.tables() {
        body += &format!("<h2>{}</h2>\n", page::escaped(&title));
        if title == "symmetry" {
            let caption = "By how much the surface stands out over the mirror image of the other side in the best mirror plane; \
                           grey: it has no counterpart.";
            body += &page::picture(symmetry, caption);
        }
        body += &page::table(&page::escaped(&note), &header, rows);
    }
    let formulas = measured.values.iter().map(|m| {
        let definition = &m.definition;
        vec![definition.name.replace('_', " "), definition.formula.to_string().replace('_', " ")]
    });
    body += "<h2>definitions</h2>\n";
    let landmarks = super::LANDMARKS.iter().map(|l| vec![l.name.replace('_', " "), l.place.to_owned()]);
    body += &page::table("", &["", "formula, or where the landmark is"], formulas.chain(landmarks))
        .replace("<table>", "<table class=\"text\">");
    page::document(report.title, "", &body)
}
