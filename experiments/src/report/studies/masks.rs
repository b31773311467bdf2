//! Table 1, Figs. 1 and 3 of Li et al. 2018: regions, grey textures, their blurs, and what each blur makes of a morph.

use anyhow::{Context, Result};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::morph::{
    Blur, BlurKind, Coordinates, MaskedDisplacement, MorphChange, MorphStep, Projector, Region, Sampling, Shape,
    Texture, Visibility, Weights,
};
use nonrigid::render::{Camera, Frame, Panel, RgbImage, Scene, Sheet, Style, View, render};

use crate::report::study::{Block, Section, Setting, Study, least_and_most, ranked};
use crate::report::table::{Table, number};
use crate::surgery::landmarks68;

pub const STUDY: Study = Study {
    name: "masks",
    title: "Li 2018, Figs. 1 and 3, Table 1: regions, grey textures, blurs",
    about: "J. Li et al., Mesh morphing process for facial plastic surgery simulation, 2018. Varied: the region (Fig. 1), the blur and \
            how often (Table 1), the blur of one morph (Fig. 3). Held: textures of 400 x 400, kernel 13 x 13, the displacement. Measured: the \
            highest grey and the steepest rim; the longest displacement reached of what was asked, the largest jump across an edge. \
            The Gaussian comes twice: with the width that OpenCV takes for 13 x 13, and with the mean's own variance. Figs. 2 and 4 \
            of the paper are flow charts, Fig. 5 is the interface of its program.",
    tables: &["blurs", "blurred-morphs"],
    seconds: |_| 3.0,
    run,
};

/// Side of textures and pictures, pixels.
const SIDE: u32 = 400;
/// Side of the kernel, and how often it is applied: the paper's.
const KERNEL: usize = 13;
const ITERATIONS: [usize; 3] = [0, 20, 40];
/// The paper's `C_s`.
const RED: [u8; 3] = [255, 0, 0];
/// Radius of the disc of Table 1 and Fig. 3, pixels.
const RADIUS: f64 = 50.0;
/// What Fig. 3 asks for, millimetres.
const ASKED: f64 = 8.0;

/// The paper's three blurs, and the Gaussian of the mean's variance: `(k^2 - 1) / 12`.
fn blurs() -> [(&'static str, Blur); 4] {
    let of = |kind| Blur { kind, kernel: KERNEL, ..Blur::default() };
    let sigma = ((KERNEL * KERNEL - 1) as f64 / 12.0).sqrt();
    // Four deviations wide, so that the kernel cuts nothing off.
    let wide = Blur { kernel: 2 * (4.0 * sigma).ceil() as usize + 1, ..of(BlurKind::Gaussian { sigma: Some(sigma) }) };
    [
        ("mean", of(BlurKind::Mean)),
        ("gaussian", of(BlurKind::Gaussian { sigma: None })),
        ("wide gaussian", wide),
        ("median", of(BlurKind::Median)),
    ]
}

fn run(setting: &Setting<'_>) -> Result<Section> {
    let template = setting.data.rig.template();
    let landmarks = landmarks68(&setting.data.rig)?;
    let picture = Picture::new(template);
    let mut blocks = Vec::new();
    blocks.push(selections(setting, &picture, &landmarks)?);
    blocks.extend(table_1(setting)?);
    blocks.extend(figure_3(setting, &picture, &landmarks)?);
    let jumps = Table::read(&setting.out.join("blurred-morphs.csv"))?;
    let finding =
        least_and_most("jump across an edge under a blur", &ranked(&jumps, &[], "blur", "largest_jump")?, " mm");
    Ok(Section { finding, blocks })
}

/// The front view in which masks are drawn.
struct Picture<'a> {
    template: &'a PolygonMesh,
    mesh: TriangleMesh,
    camera: Camera,
}

impl<'a> Picture<'a> {
    fn new(template: &'a PolygonMesh) -> Self {
        let frame = Frame::of(&template.positions);
        let camera = Camera::framing_orthographic(&frame, View::Front, [SIDE; 2]);
        Self { template, mesh: template.triangulate(), camera }
    }

    /// Pixel of a point, from the top left.
    fn pixel(&self, p: Vec3) -> Result<[f64; 2]> {
        let [x, y, _] = self.camera.project(p, [SIDE; 2]).context("a landmark is behind the camera")?;
        Ok([x, y])
    }

    fn weights(&self, texture: &Texture) -> Result<Weights> {
        let projector = Projector::of_camera(&self.camera, [SIDE; 2])?;
        Ok(projector.weights(&self.mesh, texture, Sampling::Bilinear, Visibility::default())?)
    }

    fn side(&self, mesh: &TriangleMesh, style: Style) -> RgbImage {
        let frame = Frame::of(&self.template.positions);
        let camera = Camera::framing(&frame, View::Angles { yaw: 35.0, pitch: 4.0 }, [SIDE; 2]);
        render(&Scene::new().mesh(mesh, style), &camera, [SIDE; 2])
    }
}

fn disc(centre: [f64; 2], radius: f64) -> Region {
    Shape::Circle { centre, radius }.into()
}

fn drawn(region: &Region) -> Result<Texture> {
    Ok(region.rasterize(SIDE as usize, SIDE as usize, Coordinates::Pixels)?)
}

/// Fig. 1: what is selected on the picture, its blurred texture, and the texture on the surface, equation (4).
fn selections(setting: &Setting<'_>, picture: &Picture<'_>, landmarks: &[Vec3]) -> Result<Block> {
    let at = |k: usize| picture.pixel(landmarks[k]);
    let between = |a: [f64; 2], b: [f64; 2]| [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let (corner, other) = (at(36)?, at(39)?);
    let width = apart(corner, other);
    let mouth = (48..60).map(at).collect::<Result<Vec<_>>>()?;
    let inner = (60..68).map(at).collect::<Result<Vec<_>>>()?;
    let chin = at(57)?;
    let reach = apart(chin, at(8)?);
    let regions: [(&str, Region); 4] = [
        ("circle", disc(at(30)?, 0.45 * width)),
        (
            "ellipse",
            Shape::Ellipse { centre: between(corner, other), radii: [0.75 * width, 0.45 * width], angle: 0.0 }.into(),
        ),
        (
            "sector of a ring",
            Shape::Sector { centre: chin, inner: 0.35 * reach, outer: 1.1 * reach, start: 30.0, sweep: 120.0 }.into(),
        ),
        ("free, with a hole", Shape::Polygon { rings: vec![mouth, inner] }.into()),
    ];
    let front = render(&Scene::new().mesh(&picture.mesh, Style::Clay), &picture.camera, [SIDE; 2]);
    let mut sheet = Sheet::new("").columns(&["selected", "grey texture", "on the surface"]);
    for (name, region) in &regions {
        let hard = drawn(region)?;
        let soft = Blur { kernel: 5, iterations: 6, ..Blur::default() }.apply(&hard)?;
        let weights = picture.weights(&soft)?.into_values();
        let panels = vec![
            Panel::new(hard.overlay(&front, RED)?, name),
            soft.picture().into(),
            picture.side(&picture.mesh, Style::Overlay(weights, RED)).into(),
        ];
        sheet = sheet.row("", panels);
    }
    let caption = "Fig. 1: selections on the picture, their grey textures, blurred, and their projection on the surface, \
                   C_r = C_d (1 - G) + C_s G with C_s red, equation (4).";
    setting.picture("masks", &sheet.render(), caption)
}

/// Table 1: the blurs of a disc.
fn table_1(setting: &Setting<'_>) -> Result<Vec<Block>> {
    let hard = drawn(&disc([f64::from(SIDE) / 2.0; 2], RADIUS))?;
    let mut sheet = Sheet::new("").columns(&blurs().map(|b| b.0));
    let mut table = Table::new(&["blur", "iterations", "highest", "mean", "steepest"]);
    for iterations in ITERATIONS {
        let mut panels = Vec::new();
        for (name, blur) in blurs() {
            let soft = Blur { iterations, ..blur }.apply(&hard)?;
            let mean = soft.grey().iter().sum::<f64>() / soft.grey().len() as f64;
            let highest = soft.grey().iter().copied().fold(0.0, f64::max);
            let numbers = [iterations as f64, highest, mean, steepest(&soft)].map(number);
            table.push(std::iter::once(name.to_owned()).chain(numbers).collect());
            panels.push(soft.picture());
        }
        sheet = sheet.row("", panels);
    }
    table.write(setting.out, "blurs")?;
    let caption = format!(
        "Table 1 as pictures: a disc of {RADIUS} pixels on {SIDE} x {SIDE}, kernel {KERNEL} x {KERNEL}, blurred 0, 20 and 40 times \
         (from top to bottom)."
    );
    let picture = setting.picture("blurs", &sheet.render(), caption)?;
    let caption = "Table 1 in numbers: the highest grey (1 before), the mean (kept by mean and Gaussian), the largest difference of \
                   neighbouring pixels.";
    Ok(vec![picture, Block::Table { table, caption: caption.into(), file: "blurs.csv".into() }])
}

/// The largest difference of neighbouring pixels.
fn steepest(texture: &Texture) -> f64 {
    let (width, grey) = (texture.width(), texture.grey());
    let along = grey.chunks(width).flat_map(|row| row.windows(2).map(|w| (w[0] - w[1]).abs()));
    let across = grey.iter().zip(&grey[width..]).map(|(a, b)| (a - b).abs());
    along.chain(across).fold(0.0, f64::max)
}

/// Fig. 3: one morph under no blur and under each of the three.
fn figure_3(setting: &Setting<'_>, picture: &Picture<'_>, landmarks: &[Vec3]) -> Result<Vec<Block>> {
    // The cheek: between the corner of the mouth and the outer corner of the eye.
    let [x, y] = picture.pixel((landmarks[54] + landmarks[45]) * 0.5)?;
    let hard = drawn(&disc([x, y], RADIUS))?;
    let mut table = Table::new(&["blur", "asked", "reached", "reached_over_asked", "largest_jump", "folded"]);
    let mut panels = Vec::new();
    let none = ("none", Blur { iterations: 0, ..Blur::default() });
    let twenty = blurs().map(|(name, blur)| (name, Blur { iterations: 20, ..blur }));
    for (name, blur) in std::iter::once(none).chain(twenty) {
        let weights = picture.weights(&blur.apply(&hard)?)?;
        let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0.0, 0.0, ASKED) }];
        let moved = MorphStep { pairs, ..MorphStep::default() }.apply(&picture.template.positions)?;
        let change = MorphChange::of(picture.template, &moved)?;
        let numbers = [ASKED, change.reached, change.reached / ASKED, change.largest_jump, change.folded as f64];
        table.push(std::iter::once(name.to_owned()).chain(numbers.map(number)).collect());
        let mesh = TriangleMesh { positions: moved, ..picture.mesh.clone() };
        panels.push(Panel::new(picture.side(&mesh, Style::Clay), name));
    }
    table.write(setting.out, "blurred-morphs")?;
    let sheet = Sheet::new("").row("", panels[..3].to_vec()).row("", panels[3..].to_vec());
    let caption = format!(
        "Fig. 3: {ASKED} mm out of the cheek under a disc of {RADIUS} pixels, 20 blurs of {KERNEL} x {KERNEL}."
    );
    let picture = setting.picture("blurred-morphs", &sheet.render(), caption)?;
    let caption =
        "Fig. 3 in numbers, millimetres: the longest displacement, and the largest difference across an edge.";
    Ok(vec![picture, Block::Table { table, caption: caption.into(), file: "blurred-morphs.csv".into() }])
}
