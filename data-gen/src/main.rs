//! Makes a synthetic face and scans of it: writes them as folders, or says what is in one of them and draws it.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Parser;
use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::render::{Camera, Frame, Scene, Sheet, Style, View, draw_text, registration_sheet, render, save_png};

/// Synthetic face rigs and scans with exact truth, from one seed.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Everything random comes from this number.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Vertices of the template, approximately.
    #[arg(long, default_value_t = 1200)]
    vertices: usize,
    /// Writes a rig to OUT/rig and cases below OUT/cases, as scan-bench reads them.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Number of cases; every other one is of a person whose own neutral is known.
    #[arg(long, default_value_t = 4, requires = "out")]
    cases: u64,
    /// Writes a picture of template, scan and truth (PNG).
    #[arg(long, conflicts_with = "out")]
    picture: Option<PathBuf>,
    /// Writes a picture of all expressions (PNG).
    #[arg(long)]
    expressions: Option<PathBuf>,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let rig = FaceRig::generate(&FaceOptions { vertices: arguments.vertices });
    if let Some(out) = &arguments.out {
        write_all(out, &rig, arguments.seed, arguments.cases)?;
    } else {
        describe(&rig, &arguments)?;
    }
    if let Some(path) = &arguments.expressions {
        save_png(&expression_sheet(&rig).render(), path).context("picture of the expressions")?;
    }
    Ok(())
}

/// The rig and `cases` cases; the k-th is simulated from `seed + k`.
fn write_all(out: &Path, rig: &FaceRig, seed: u64, cases: u64) -> anyhow::Result<()> {
    println!("seed {seed}");
    let folder = out.join("rig");
    write_rig(&folder, rig)?;
    let (vertices, expressions, modes) = (rig.neutral.len(), rig.expressions.len(), rig.identities.len());
    println!("{}: {vertices} vertices, {expressions} expressions, {modes} identity modes", folder.display());
    for k in 0..cases {
        let case = simulate_scan(rig, &ScanOptions::default(), seed.wrapping_add(k));
        let (name, subject) = if k % 2 == 0 { ("same", Subject::same(rig, &case)) } else { ("new", Subject::new(rig)) };
        let folder = out.join("cases").join(format!("{name}_{k:02}"));
        write_case(&folder, rig, &case, &subject, seed.wrapping_add(k))?;
        let seen = case.observed.iter().filter(|o| **o).count();
        let (points, triangles) = (case.scan.positions.len(), case.scan.triangles.len());
        println!("{}: {points} points, {triangles} triangles, {seen} vertices observed", folder.display());
    }
    Ok(())
}

fn describe(rig: &FaceRig, arguments: &Arguments) -> anyhow::Result<()> {
    let case = simulate_scan(rig, &ScanOptions::default(), arguments.seed);
    let weights: serde_json::Map<String, serde_json::Value> =
        rig.expressions.iter().zip(&case.expression_weights).map(|(e, w)| (e.0.clone(), (*w).into())).collect();
    let summary = serde_json::json!({
        "seed": arguments.seed,
        "template": { "vertices": rig.neutral.len(), "polygons": rig.mesh.polygon_count() },
        "scan": { "vertices": case.scan.positions.len(), "triangles": case.scan.triangles.len() },
        "observed": case.observed.iter().filter(|o| **o).count(),
        "expression_weights": weights,
        "identity_weights": case.identity_weights,
        "pose": case.pose,
    });
    println!("{}", serde_json::to_string_pretty(&summary)?);
    if let Some(path) = &arguments.picture {
        let truth = at(rig, case.truth.clone());
        let title = format!("seed {}", arguments.seed);
        save_png(&registration_sheet(&title, &rig.mesh, &case.scan, &truth, 440), path).context("picture")?;
    }
    Ok(())
}

fn at(rig: &FaceRig, positions: Vec<Vec3>) -> PolygonMesh {
    PolygonMesh { positions, ..rig.mesh.clone() }
}

fn expression_sheet(rig: &FaceRig) -> Sheet {
    const ACROSS: usize = 5;
    let mut faces = vec![("neutral".to_string(), rig.neutral.clone())];
    for (k, (name, _)) in rig.expressions.iter().enumerate() {
        let mut weights = vec![0.0; rig.expressions.len()];
        weights[k] = 1.0;
        faces.push((name.clone(), rig.pose(&weights, &[])));
    }
    let frame = Frame::of(&rig.neutral);
    let size = [320, 360];
    let mut sheet = Sheet::new("expressions at weight 1");
    for row in faces.chunks(ACROSS) {
        for view in [View::Front, View::ThreeQuarter] {
            let camera = Camera::framing(&frame, view, size);
            let panels = row.iter().map(|(name, positions)| {
                let mesh = at(rig, positions.clone());
                let scene = Scene::new().mesh(&mesh.triangulate(), Style::Clay).wireframe(&mesh);
                let mut panel = render(&scene, &camera, size);
                draw_text(&mut panel, 8, 8, name, 2, [32, 36, 44]);
                panel
            });
            sheet = sheet.row("", panels.collect());
        }
    }
    sheet
}
