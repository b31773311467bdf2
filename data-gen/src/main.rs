//! Makes a synthetic face and a scan of it, says what is in them and draws them.

use std::path::PathBuf;

use anyhow::Context;
use clap::Parser;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::render::{Camera, Frame, Scene, Sheet, Style, View, draw_text, registration_sheet, render, save_png};
use nonrigid_data_gen::{FaceOptions, FaceRig, ScanOptions, simulate_scan};

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
    /// Writes a picture of template, scan and truth (PNG).
    #[arg(long)]
    picture: Option<PathBuf>,
    /// Writes a picture of all expressions (PNG).
    #[arg(long)]
    expressions: Option<PathBuf>,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let rig = FaceRig::generate(&FaceOptions { vertices: arguments.vertices });
    let case = simulate_scan(&rig, &ScanOptions::default(), arguments.seed);
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
        let truth = at(&rig, case.truth.clone());
        let title = format!("seed {}", arguments.seed);
        save_png(&registration_sheet(&title, &rig.mesh, &case.scan, &truth, 440), path).context("picture")?;
    }
    if let Some(path) = &arguments.expressions {
        save_png(&expression_sheet(&rig).render(), path).context("picture of the expressions")?;
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
