//! Figs. 1 to 3: the template, the scans, the blendshapes.

use anyhow::Result;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::render::{Camera, Frame, Panel, RgbImage, Scene, Sheet, Style, View, render};

use crate::report::data::upright;
use crate::report::study::{Block, Section, Setting, Study};
use crate::report::table::{Table, counted};
use crate::report::view3d::{View3d, ViewMesh};
use crate::scan_bench::BenchCase;
use crate::{add_shape, families};

pub const STUDY: Study = Study {
    name: "inputs",
    title: "Figs. 1, 2 and 3: template, scans, blendshapes",
    about: "What everything below works with.",
    tables: &["inputs"],
    seconds: |effort| 1.0 + 0.6 * effort.cases.len() as f64,
    run,
};

/// Width and height of a panel, pixels.
const PANEL: [u32; 2] = [300, 340];
/// Panels side by side.
const ACROSS: usize = 4;
/// Expressions in the picture, spread over all; and identity modes, the first.
const EXPRESSIONS: usize = 12;
const MODES: usize = 4;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let data = setting.data;
    let rig = data.rig.rig();
    let template = data.rig.template();
    let mut blocks = Vec::new();

    let panels = [View::Front, View::ThreeQuarter, View::Side]
        .map(|view| wired(template, &Frame::of(&template.positions), view));
    let title = format!("{} vertices, {} polygons", template.positions.len(), template.polygon_count());
    let sheet = Sheet::new(&title).row("", panels.to_vec());
    blocks.push(setting.picture(
        "template",
        &sheet.render(),
        "Fig. 1: the template, a mesh of polygons whose order every result keeps.",
    )?);

    let mut sheet = Sheet::new("");
    for cases in data.cases.chunks(ACROSS) {
        let panel = |case: &BenchCase| {
            let pose = upright(case);
            let stand = |points: &[Vec3]| points.iter().map(|p| pose.apply_inverse(*p)).collect::<Vec<_>>();
            let mesh = TriangleMesh { positions: stand(&case.scan.mesh.positions), ..case.scan.mesh.clone() };
            let camera =
                Camera::framing(&Frame::of(&stand(&case.truth)), View::Angles { yaw: 25.0, pitch: 4.0 }, PANEL);
            Panel::new(render(&Scene::new().mesh(&mesh, Style::Clay), &camera, PANEL), &case.name)
        };
        sheet = sheet.row("", cases.iter().map(panel));
    }
    blocks.push(setting.picture("scans", &sheet.render(), "Fig. 2: the scans that the template is registered to: irregular triangles, holes, noise, spikes, loose parts. Their true correspondences are known to the last digit.")?);

    let shapes = rig.shapes();
    let (expressions, modes) = families(rig);
    let spread = (0..EXPRESSIONS.min(expressions.len()))
        .map(|k| expressions[k * expressions.len() / EXPRESSIONS.min(expressions.len())]);
    let chosen: Vec<(usize, f64)> =
        spread.map(|k| (k, 1.0)).chain(modes.iter().take(MODES).map(|k| (*k, 2.0))).collect();
    let camera = Camera::framing(&Frame::of(&template.positions), View::Angles { yaw: 15.0, pitch: 2.0 }, PANEL);
    let shape = |&(k, weight): &(usize, f64)| {
        let mut mesh = template.triangulate();
        add_shape(&mut mesh.positions, rig, k, weight);
        mesh
    };
    let panel = |chosen: &(usize, f64)| {
        let mesh = shape(chosen);
        Panel::new(render(&Scene::new().mesh(&mesh, Style::Clay), &camera, PANEL), &shapes[chosen.0].name)
    };
    let mut sheet = Sheet::new("");
    for row in chosen.chunks(ACROSS) {
        sheet = sheet.row("", row.iter().map(panel));
    }
    let caption = "Fig. 3: some of the rig's blendshapes: expressions at weight 1, then identity modes at two standard deviations.";
    blocks.push(setting.picture("blendshapes", &sheet.render(), caption)?);

    let mut meshes =
        vec![ViewMesh::of_polygons("template", format!("{} vertices", template.positions.len()), template)];
    for case in &data.cases {
        let (pose, scan) = (upright(case), &case.scan.mesh);
        let positions = scan.positions.iter().map(|p| pose.apply_inverse(*p)).collect();
        let said = counted(scan.triangles.len(), "triangle");
        meshes.push(ViewMesh::new(&case.name, said, TriangleMesh { positions, ..scan.clone() }));
    }
    for of in &chosen {
        meshes.push(ViewMesh::new(&shapes[of.0].name, format!("blendshape at weight {}", of.1), shape(of)));
    }
    let caption = "Template, scans and blendshapes of Figs. 1 to 3.".to_owned();
    blocks.push(Block::View(View3d::of_shapes(meshes, caption)));

    let mut table = Table::new(&[
        "case",
        "scan_vertices",
        "scan_triangles",
        "landmarks",
        "shapes_offered",
        "neutral_known",
        "observed_vertices",
    ]);
    for case in &data.cases {
        let observed = case.observed.iter().filter(|o| **o).count();
        let counts =
            [case.scan.mesh.positions.len(), case.scan.mesh.triangles.len(), case.landmarks.len(), case.shapes.len()];
        let mut row = vec![case.name.clone()];
        row.extend(counts.map(|n| n.to_string()));
        row.extend([if case.neutral.is_some() { "yes" } else { "no" }.to_owned(), observed.to_string()]);
        table.push(row);
    }
    table.write(setting.out, "inputs")?;
    blocks.push(Block::Table { table, caption: "The cases.".into(), file: "inputs.csv".into() });
    let finding = format!(
        "{} of a template of {} vertices, with {} in the rig.",
        counted(data.cases.len(), "scan"),
        template.positions.len(),
        counted(shapes.len(), "blendshape")
    );
    Ok(Section { finding, blocks })
}

fn wired(mesh: &PolygonMesh, frame: &Frame, view: View) -> RgbImage {
    let scene = Scene::new().mesh(&mesh.triangulate(), Style::Clay).wireframe(mesh);
    render(&scene, &Camera::framing(frame, view, PANEL), PANEL)
}
