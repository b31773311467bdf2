//! Measurements in a folder: numbers, pictures, and one page with both.

use std::io::Write as _;
use std::path::Path;

use image::RgbImage;

use super::output::Table;
use super::{AFTER, Comparison, FaceState, FacialFrame, MeasurementError, Plan, Subject};
use crate::io::{WriteError, write_atomically, write_folder, write_json};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::render::{Camera, ColourMap, ColourScale, Frame, Rgb8, Scene, Sheet, Style, View, encode_png, render};
use crate::{page, text};

/// What a report is made of.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// Head of the page.
    pub title: &'a str,
    /// Lines below it: name and text.
    pub about: &'a [(String, String)],
    /// What is measured.
    pub subject: Subject<'a>,
    /// Shapes after, beside each other; where there is none, the subject's own.
    pub plans: &'a [Plan<'a>],
    /// Weight `G` of each vertex, 0 to 1, for the overlay of equation (4) of Li et al. 2018.
    pub mask: Option<&'a [f64]>,
    /// Its colour `C_s`; the paper's is red.
    pub mask_colour: Rgb8,
    /// What was protected, of each vertex from 0 to 1: drawn as blue lines in every picture.
    pub protected: Option<&'a [f64]>,
    /// Side of each picture, pixels.
    pub panel: u32,
}

impl<'a> Report<'a> {
    /// A report without a mask, its pictures 360 pixels wide.
    #[must_use]
    pub fn new(title: &'a str, subject: Subject<'a>) -> Self {
        let (mask_colour, panel) = ([255, 0, 0], 360);
        Self { title, about: &[], subject, plans: &[], mask: None, mask_colour, protected: None, panel }
    }

    fn shapes_after(&self) -> Vec<Plan<'a>> {
        if self.plans.is_empty() {
            return self.subject.after.iter().map(|positions| Plan { name: AFTER, positions }).collect();
        }
        self.plans.to_vec()
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
pub fn write(folder: &Path, report: &Report<'_>) -> Result<Comparison, MeasurementError> {
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
) -> Result<Comparison, MeasurementError> {
    check_weights("the mask", report, report.mask)?;
    check_weights("the weights of what is protected", report, report.protected)?;
    let measured = report.subject.compare(report.plans)?;
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

fn check_weights(what: &'static str, report: &Report<'_>, weights: Option<&[f64]>) -> Result<(), MeasurementError> {
    let Some(mask) = weights else { return Ok(()) };
    let expected = report.subject.mesh.positions.len();
    if mask.len() != expected {
        return Err(MeasurementError::VertexCount { what, found: mask.len(), expected });
    }
    match mask.iter().position(|g| !(0.0..=1.0).contains(g)) {
        Some(vertex) => Err(MeasurementError::Weight { what, vertex, value: mask[vertex] }),
        None => Ok(()),
    }
}

/// The shapes upright and facing the viewer, as far as landmarks say how: before, then those after. All in the frame of before.
fn upright(report: &Report<'_>, measured: &Comparison) -> Vec<PolygonMesh> {
    let frame: Option<FacialFrame> = measured.before().before.frame;
    let mesh = report.subject.mesh;
    let turned = |positions: &[Vec3]| {
        let positions = positions.iter().map(|p| frame.map_or(*p, |f| f.coordinates(*p))).collect();
        mesh.with_positions(positions)
    };
    let after = report.shapes_after();
    std::iter::once(&mesh.positions[..]).chain(after.iter().map(|plan| plan.positions)).map(turned).collect()
}

/// The polygons all of whose corners are protected.
fn protected_part(mesh: &PolygonMesh, protected: &[f64]) -> PolygonMesh {
    let mut part = PolygonMesh { positions: mesh.positions.clone(), starts: vec![0], ..PolygonMesh::default() };
    for range in mesh.starts.windows(2) {
        let polygon = mesh.corners.get(range[0] as usize..range[1] as usize).unwrap_or_default();
        if polygon.iter().all(|v| protected.get(*v as usize).is_some_and(|p| *p >= 0.5)) {
            part.corners.extend(polygon);
            part.starts.push(part.corners.len() as u32);
        }
    }
    part
}

const PROTECTED: Rgb8 = [24, 64, 170];

/// A heading, which shape is seen, and what the camera of a view sees below it.
type Column<'a> = (String, usize, Box<dyn Fn(&Camera) -> Scene + 'a>);

/// A row for each view: before, its landmarks, the shapes after, the mask over before, the displacements on the shapes after.
fn pictures(report: &Report<'_>, measured: &Comparison) -> RgbImage {
    let shapes = upright(report, measured);
    let surfaces: Vec<TriangleMesh> = shapes.iter().map(PolygonMesh::triangulate).collect();
    let clay = |k: usize| Scene::new().mesh(&surfaces[k], Style::Clay);
    let frame = frame_of(&shapes);

    let after = report.shapes_after();
    let before = if after.is_empty() { "face" } else { "before" };
    let mut columns: Vec<Column<'_>> = vec![(before.to_owned(), 0, Box::new(|_: &Camera| clay(0)))];
    let state = &measured.before().before;
    if !state.landmarks.is_empty() {
        let place = |p: &Vec3| state.frame.map_or(*p, |f| f.coordinates(*p));
        let points: Vec<Vec3> = state.landmarks.iter().map(|l| place(&l.1)).collect();
        let reach = 0.02 * frame.half.norm();
        columns.push((
            "landmarks".to_owned(),
            0,
            Box::new(move |camera: &Camera| {
                // Off the surface, towards the viewer: whole discs.
                let shown = points.iter().map(|p| p + (camera.eye() - p).normalize() * reach).collect::<Vec<_>>();
                clay(0).points(&shown, [24, 64, 150], f64::from(report.panel) / 120.0)
            }),
        ));
    }
    for (k, plan) in after.iter().enumerate() {
        columns.push((plan.name.to_owned(), k + 1, Box::new(move |_: &Camera| clay(k + 1))));
    }
    if let Some(mask) = report.mask {
        let style = Style::Overlay(mask.to_vec(), report.mask_colour);
        let surface = &surfaces[0];
        columns.push(("mask".to_owned(), 0, Box::new(move |_: &Camera| Scene::new().mesh(surface, style.clone()))));
    }
    let mut sheet = Sheet::new("");
    let moved = |plan: &Plan<'_>| -> Vec<f64> {
        report.subject.mesh.positions.iter().zip(plan.positions).map(|(b, a)| (a - b).norm()).collect()
    };
    let moved: Vec<Vec<f64>> = after.iter().map(moved).collect();
    // Most of a face may not move at all: the scale is that of what does.
    let some: Vec<f64> = moved.iter().flatten().copied().filter(|d| *d > 0.0).collect();
    let scale = ColourScale::for_magnitudes(&some, "displacement", "mm");
    if !after.is_empty() {
        sheet = sheet.colour_bar(&scale);
    }
    for (k, (plan, moved)) in after.iter().zip(moved).enumerate() {
        let heading = if after.len() == 1 { "displacement".to_owned() } else { format!("displacement, {}", plan.name) };
        let style = Style::Values(moved, scale.clone());
        let surface = &surfaces[k + 1];
        columns.push((heading, k + 1, Box::new(move |_: &Camera| Scene::new().mesh(surface, style.clone()))));
    }
    draw(report, &shapes, &columns, sheet, VIEWS)
}

/// A row for each view: what the columns show, with what is protected over it.
fn draw(
    report: &Report<'_>,
    shapes: &[PolygonMesh],
    columns: &[Column<'_>],
    sheet: Sheet,
    views: impl IntoIterator<Item = View>,
) -> RgbImage {
    let size = [report.panel; 2];
    let frame = frame_of(shapes);
    let kept: Vec<PolygonMesh> =
        report.protected.iter().flat_map(|weights| shapes.iter().map(|s| protected_part(s, weights))).collect();
    let mut sheet = sheet.columns(&columns.iter().map(|c| c.0.as_str()).collect::<Vec<_>>());
    for view in views {
        let camera = Camera::framing(&frame, view, size);
        let picture = |(_, shape, see): &Column<'_>| {
            let scene = see(&camera);
            let scene = match kept.get(*shape) {
                Some(part) => scene.wireframe_with(part, PROTECTED, 0.8),
                None => scene,
            };
            render(&scene, &camera, size)
        };
        sheet = sheet.row(&view.name(), columns.iter().map(picture));
    }
    sheet.render()
}

fn frame_of(shapes: &[PolygonMesh]) -> Frame {
    let frame = shapes.iter().map(|s| Frame::of(&s.positions)).reduce(Frame::union);
    frame.unwrap_or_else(|| Frame::of(&[])).scaled(0.95)
}

/// By how much each vertex stands out over the mirror image of the other side, before and after on one scale.
fn symmetry_pictures(report: &Report<'_>, measured: &Comparison) -> RgbImage {
    let shapes = upright(report, measured);
    let surfaces: Vec<TriangleMesh> = shapes.iter().map(PolygonMesh::triangulate).collect();
    let after = measured.plans().filter_map(|(name, plan)| Some((name, plan.after.as_ref()?)));
    let first = if shapes.len() > 1 { "before" } else { "face" };
    let states: Vec<_> = std::iter::once((first, &measured.before().before)).chain(after).collect();
    let all: Vec<f64> = states.iter().flat_map(|s| s.1.symmetry.offsets.iter().copied()).collect();
    let mut scale = ColourScale::for_signed(&all, "over the mirror image", "mm");
    // Rounding is not worth a colour.
    if scale.high < LEAST_ASYMMETRY {
        scale = ColourScale::new(ColourMap::BlueRed, -LEAST_ASYMMETRY, LEAST_ASYMMETRY, &scale.label, &scale.unit);
    }
    let column = |(k, ((name, state), surface)): (usize, (&(&str, &FaceState), _))| -> Column<'_> {
        let style = Style::Values(state.symmetry.offsets.clone(), scale.clone());
        ((*name).to_owned(), k, Box::new(move |_: &Camera| Scene::new().mesh(surface, style.clone())))
    };
    let columns: Vec<Column<'_>> = states.iter().zip(&surfaces).enumerate().map(column).collect();
    let views = [View::Front, View::ThreeQuarter, View::Angles { yaw: -40.0, pitch: 5.0 }];
    draw(report, &shapes, &columns, Sheet::new("").colour_bar(&scale), views)
}

/// Half the width of the narrowest scale of asymmetries, millimetres.
const LEAST_ASYMMETRY: f64 = 0.01;

fn html(report: &Report<'_>, measured: &Comparison, pictures: &[u8], symmetry: &[u8]) -> String {
    let mut body = format!("<h1>{}</h1>\n", text::html(report.title));
    for (name, text) in report.about {
        body += &format!("<p class=\"about\"><b>{}</b> {}</p>\n", text::html(name), text::html(text));
    }
    let kept = if report.protected.is_some_and(|p| p.iter().any(|p| *p >= 0.5)) { " Blue: protected." } else { "" };
    let caption = format!("Upright by the landmarks: the vertical runs from menton to nasion.{kept}");
    body += &page::picture(pictures, &caption);
    for Table { title, header, rows, note } in measured.tables() {
        body += &format!("<h2>{}</h2>\n", text::html(&title));
        if title == "symmetry" {
            let caption = "By how much the surface stands out over the mirror image of the other side in the best mirror plane; \
                           grey: it has no counterpart.";
            body += &page::picture(symmetry, &format!("{caption}{kept}"));
        }
        body += &page::table(&text::html(&note), &header, rows);
    }
    let formulas = measured.before().values.iter().map(|m| {
        let definition = &m.definition;
        vec![definition.title(), definition.formula.to_string().replace('_', " ")]
    });
    body += "<h2>definitions</h2>\n";
    let landmarks = super::LANDMARKS.iter().map(|l| vec![l.name.replace('_', " "), l.place.to_owned()]);
    body += &page::table("", &["", "formula, or where the landmark is"], formulas.chain(landmarks))
        .replace("<table>", "<table class=\"text\">");
    page::document(report.title, "", &body)
}
