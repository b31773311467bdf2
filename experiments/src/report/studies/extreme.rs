//! Fig. 5: the most extreme expression, registered by every model, side by side.

use anyhow::Result;
use nonrigid::evaluation::{TruthErrors, VertexErrors};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::ModelKind;
use nonrigid::render::{Camera, ColourScale, Frame, Panel, RgbImage, Scene, Sheet, Style, View, render};

use crate::output::{make_folder, write_result};
use crate::report::data::upright;
use crate::report::study::{
    Block, ERROR_COLUMNS, Section, Setting, Study, error_cells, error_text, least_and_most, ranked,
};
use crate::report::table::{Table, number, shown};
use crate::report::view3d::{View3d, ViewMesh};
use crate::scan_bench::{BenchCase, LandmarkUse, Score};

pub const STUDY: Study = Study {
    name: "extreme",
    title: "Fig. 5: an extreme expression, every model",
    about: "Varied: the deformation model. Held: the scan of a mouth wide open, the shapes, the landmarks, each model's default \
            schedule. Measured: the distance of every vertex from where it truly is, along the surface's normal and \
            tangentially; over all observed vertices, and over those of mouth and eyes alone.",
    tables: &["extreme"],
    seconds: |effort| {
        let affine = if effort.models.contains(&ModelKind::Affine) { 12.0 } else { 0.0 };
        effort.vertices as f64 / 5000.0 * (0.9 * effort.models.len() as f64 + affine)
    },
    run,
};

/// Width and height of a panel, pixels.
const PANEL: [u32; 2] = [292, 320];
/// A region is what lies within this distance of its landmarks on the template, millimetres.
const NEAR: f64 = 12.0;
/// Landmarks of the 68 that mark the eyes, and those that mark the mouth.
const EYES: std::ops::Range<usize> = 36..48;
const MOUTH: std::ops::Range<usize> = 48..68;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let case = setting.data.extreme();
    let folder = setting.out.join("extreme");
    make_folder(&folder)?;
    let regions = [MOUTH, EYES].map(|of| region(setting, case, of));
    let entrants = setting.entrants(&setting.effort.models)?;
    let outcomes = setting.run_all(&entrants, |entrant| entrant.register(case, LandmarkUse::All));

    let columns = [&["model"][..], &ERROR_COLUMNS, &["mouth_rmse", "eyes_rmse", "error"]].concat();
    let mut table = Table::new(&columns);
    let triangles = case.template.triangulate().triangles;
    let pose = upright(case);
    let stand = |points: &[Vec3]| points.iter().map(|p| pose.apply_inverse(*p)).collect::<Vec<_>>();
    let mut results = Vec::new();
    for (entrant, outcome) in entrants.iter().zip(outcomes) {
        let mut cells = vec![entrant.name().to_owned()];
        cells.extend(error_cells(outcome.as_ref().ok().map(|(score, ..)| score)));
        let error = error_text(&outcome);
        if let Ok((score, result, _)) = outcome {
            let (_, errors) = TruthErrors::new(&result.positions, &case.truth, &case.observed, &triangles)?;
            cells.extend(regions.each_ref().map(|r| number(rmse_of(&errors.distance, r))));
            let path = folder.join(format!("{}.obj", entrant.name()));
            let mesh = write_result(&path, &case.template, result.positions)?;
            results.push((entrant.name(), score, mesh.with_positions(stand(&mesh.positions)), errors));
        } else {
            cells.extend(regions.each_ref().map(|_| String::new()));
        }
        cells.push(error);
        table.push(cells);
    }
    let given = Given {
        template: case.template.with_positions(case.rest().to_vec()),
        truth: case.template.with_positions(stand(&case.truth)),
        scan: TriangleMesh { positions: stand(&case.scan.mesh.positions), ..case.scan.mesh.clone() },
    };
    table.write(setting.out, "extreme")?;
    let caption = format!(
        "Fig. 5: {}, one scan (n = 1). First row: the template and the scan, each with its mouth. Then a row for each model, with its \
         rmse: the result, its polygons at the mouth, and by colour each vertex's error off the true surface (normal) and along it \
         (tangential), in millimetres on the scale at the right. Grey: vertices that the scan does not show. The results are in the \
         folder extreme, as OBJ.",
        case.name
    );
    let picture = setting.picture("extreme", &draw(setting, case, &given, &results), caption)?;
    let turned = Block::View(turnable(case, &given, &results));
    let finding = least_and_most("rmse", &ranked(&table, &[], "model", "rmse")?, " mm");
    let numbers =
        Block::Table { table, caption: "The same in numbers, millimetres.".into(), file: "extreme.csv".into() };
    Ok(Section { finding, blocks: vec![picture, turned, numbers] })
}

/// Observed vertices of the template near some of its 68 landmarks; none for a rig without these.
fn region(setting: &Setting<'_>, case: &BenchCase, of: std::ops::Range<usize>) -> Vec<usize> {
    let template = &case.template.positions;
    let marks: Vec<Vec3> = landmarks(setting, of).iter().map(|v| template[*v]).collect();
    let near = |i: &usize| case.observed[*i] && marks.iter().any(|m| (m - template[*i]).norm() <= NEAR);
    (0..template.len()).filter(near).collect()
}

fn landmarks(setting: &Setting<'_>, of: std::ops::Range<usize>) -> Vec<usize> {
    let all = setting.data.rig.rig().landmarks().unwrap_or_default();
    all.get(of).unwrap_or_default().iter().map(|v| *v as usize).collect()
}

fn rmse_of(distance: &[f64], vertices: &[usize]) -> f64 {
    (vertices.iter().map(|v| distance[*v].powi(2)).sum::<f64>() / vertices.len() as f64).sqrt()
}

/// What is given, upright.
struct Given {
    template: PolygonMesh,
    truth: PolygonMesh,
    scan: TriangleMesh,
}

/// A model's name, score, mesh, upright, and errors.
type Outcome<'a> = (&'a str, Score, PolygonMesh, VertexErrors);

/// Values of the vertices that the scan shows, of the others none.
fn seen(case: &BenchCase, values: &[f64]) -> Vec<f64> {
    values.iter().zip(&case.observed).map(|(v, o)| if *o { *v } else { f64::NAN }).collect()
}

/// One for all models, but for those that cannot deform: they would leave no colour for the others.
fn scale(case: &BenchCase, results: &[Outcome<'_>]) -> ColourScale {
    let nonrigid = results.iter().filter(|r| r.0 != "rigid" && r.0 != "similarity");
    let all: Vec<f64> = nonrigid.flat_map(|r| seen(case, &r.3.distance)).collect();
    ColourScale::for_magnitudes(&all, "normal or tangential error", "mm")
}

/// Every result with its errors, then template, truth and scan.
fn turnable(case: &BenchCase, given: &Given, results: &[Outcome<'_>]) -> View3d {
    let of_model = |(model, score, mesh, errors): &Outcome<'_>| {
        let said = format!("rmse {} mm", shown(score.errors.rmse));
        ViewMesh::of_polygons(model, said, mesh)
            .with_values([&errors.normal, &errors.tangential].map(|e| seen(case, e)).to_vec())
    };
    let mut meshes: Vec<ViewMesh> = results.iter().map(of_model).collect();
    meshes.push(ViewMesh::of_polygons("template", "before the registration".into(), &given.template));
    meshes.push(ViewMesh::of_polygons("truth", "what every model should find".into(), &given.truth));
    meshes.push(ViewMesh::new("scan", "what every model is given".into(), given.scan.clone()));
    let caption =
        format!("The results of Fig. 5 on {}, coloured by their errors off the true surface or along it.", case.name);
    let quantities = vec!["off the surface", "along the surface"];
    View3d { meshes, quantities, scale: scale(case, results), caption }
}

/// First template, truth and scan; then a row for each model.
fn draw(setting: &Setting<'_>, case: &BenchCase, given: &Given, results: &[Outcome<'_>]) -> RgbImage {
    let Given { template: rest, truth, scan } = given;
    let panel = |scene: &Scene, frame: &Frame, view: View| render(scene, &Camera::framing(frame, view, PANEL), PANEL);
    let clay = |mesh: &TriangleMesh| Scene::new().mesh(mesh, Style::Clay);
    let wired = |mesh: &PolygonMesh| clay(&mesh.triangulate()).wireframe(mesh);

    let face = Frame::of(&truth.positions).union(Frame::of(&rest.positions)).scaled(0.9);
    let angle = View::Angles { yaw: 32.0, pitch: 4.0 };
    let mouth = landmarks(setting, MOUTH);
    let lips = |mesh: &PolygonMesh| {
        let marks: Vec<Vec3> = mouth.iter().map(|v| mesh.positions[*v]).collect();
        if marks.is_empty() { Frame::of(&mesh.positions) } else { Frame::of(&marks).scaled(1.35) }
    };
    let open = lips(truth);
    let seen = |values: &[f64]| seen(case, values);
    let scale = scale(case, results);

    let first = vec![
        Panel::new(panel(&wired(rest), &face, angle), "template"),
        Panel::new(panel(&wired(rest), &lips(rest).at_scale_of(open), View::Front), "its mouth"),
        Panel::new(panel(&clay(scan), &face, angle), "scan"),
        Panel::new(panel(&clay(scan), &open, View::Front), "its mouth"),
    ];
    let mut sheet = Sheet::new("").colour_bar(&scale).row("", first);
    for (model, row, mesh, errors) in results {
        let heat = |values: &[f64]| {
            panel(
                &Scene::new().mesh(&mesh.triangulate(), Style::Values(seen(values), scale.clone())),
                &face,
                View::Front,
            )
        };
        let panels = vec![
            Panel::new(
                panel(&clay(&mesh.triangulate()), &face, angle),
                &format!("{model} {} mm", shown(row.errors.rmse)),
            ),
            Panel::new(panel(&wired(mesh), &open, View::Front), "mouth"),
            Panel::new(heat(&errors.normal), "normal"),
            Panel::new(heat(&errors.tangential), "tangential"),
        ];
        sheet = sheet.row("", panels);
    }
    sheet.render()
}
