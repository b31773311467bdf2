//! `nonrigid animate`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::{Align, ShapeKindArgument, read_rig, rig_files};
use super::units::{UnitArguments, Units};
use super::{Failure, Stage, check_output, check_plan, say, warn};
use crate::io::{FilePlan, Motion, write_animated_glb, write_pc2, write_usda};
use crate::mesh::{PolygonMesh, Pose, Vec3};
use crate::rig::{FittedFrame, ShapeSelection, WeightFitOptions, WeightFitter, mesh_files};

/// Arguments of `nonrigid animate`.
#[derive(Debug, Args)]
#[command(
    after_help = "Frames are meshes of one topology, such as `nonrigid batch` leaves for a sequence, in the order of their names.\n\
    .usda: a mesh with points over time, millimetres, y up. .pc2: a point cache; load the first frame beside it.\n\
    .glb: morph targets. Without --rig one for each frame but the first; with it the rig's shapes and a pose, and one for each frame\n\
    that holds what they do not explain.\n\n\
    Examples:\n  nonrigid animate --meshes wrapped --out ann.usda\n  \
    nonrigid animate --meshes wrapped --fps 30 --out ann.glb"
)]
pub struct Arguments {
    /// The frames: every .obj and .ply in this folder, by name
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// The rig that explains the frames: a folder, .npz, .glb or .gltf
    #[arg(long, value_name = "DIR|FILE")]
    rig: Option<PathBuf>,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum, requires = "rig")]
    shape_kind: Option<ShapeKindArgument>,
    /// How many of the first identity modes explain frames as well
    #[arg(long, value_name = "N", default_value_t = 0, requires = "rig")]
    identity_modes: usize,
    /// Frames a second, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=1000))]
    fps: u16,
    #[command(flatten)]
    units: UnitArguments,
    /// The animation: .usda, .pc2 or .glb
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    check_output(&a.out, &["usda", "pc2", "glb"])?;
    let extension = a.out.extension().unwrap_or_default().to_ascii_lowercase();
    if a.rig.is_some() && extension != "glb" {
        return Err(Failure::new(Stage::Arguments, "--rig: only .glb has weights; leave it out, or write .glb"));
    }
    let files = mesh_files(&a.meshes).map_err(Failure::loading)?;
    if files.is_empty() {
        return Err(Failure::loading(format!("{}: found no .obj or .ply", a.meshes.display())));
    }
    let plan = FilePlan::new()
        .reads_all(files.iter().map(|(_, path)| ("meshes", path.clone())))
        .reads_all(a.rig.iter().flat_map(|rig| rig_files(rig)))
        .writes("--out", &a.out);
    check_plan(&plan)?;
    let mut units = a.units.of(&["meshes", "rig"])?;
    let (mesh, frames) = read_frames(&files, &mut units)?;
    let fps = f64::from(a.fps);
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    match extension.to_str() {
        Some("usda") => write_usda(&a.out, &mesh, None, &frames, fps).map_err(Failure::writing)?,
        Some("pc2") => write_pc2(&a.out, &frames).map_err(Failure::writing)?,
        _ => write_glb(a, &mut units, &mesh, &frames, &names)?,
    }
    units.say();
    say(format_args!("{} frames of {} vertices, {} a second", frames.len(), mesh.positions.len(), a.fps))?;
    say(format_args!("wrote {}", a.out.display()))
}

/// The first frame, and the positions of all.
fn read_frames(files: &[(String, PathBuf)], units: &mut Units<'_>) -> Result<(PolygonMesh, Vec<Vec<Vec3>>), Failure> {
    let mut first: Option<PolygonMesh> = None;
    let mut frames = Vec::with_capacity(files.len());
    for (_, path) in files {
        let mesh = units.read_mesh("meshes", path)?;
        let of = first.get_or_insert_with(|| mesh.clone());
        if (mesh.positions.len(), &mesh.starts, &mesh.corners) != (of.positions.len(), &of.starts, &of.corners) {
            let other = files[0].1.display();
            return Err(Failure::loading(format!("{}: has other vertices or polygons than {other}", path.display())));
        }
        frames.push(mesh.positions);
    }
    let first = first.ok_or_else(|| Failure::loading("no frames"))?;
    Ok((first, frames))
}

fn write_glb(
    a: &Arguments,
    units: &mut Units<'_>,
    mesh: &PolygonMesh,
    frames: &[Vec<Vec3>],
    frame_names: &[&str],
) -> Result<(), Failure> {
    let (rest, mut targets, mut deltas, fitted) = match &a.rig {
        None => (frames[0].clone(), Vec::new(), Vec::new(), Vec::new()),
        Some(path) => explained(a, path, units, frames, frame_names)?,
    };
    let shapes = targets.len();
    let vertices = rest.len();
    // What shapes explain of a frame, in the rest's frame.
    let residual = |k: usize| -> Vec<f32> {
        let Some(FittedFrame { weights, pose, .. }) = fitted.get(k) else {
            return frames[k].iter().zip(&rest).flat_map(|(p, r)| <[f64; 3]>::from(p - r)).map(|x| x as f32).collect();
        };
        let mut left: Vec<f64> =
            frames[k].iter().zip(&rest).flat_map(|(p, r)| <[f64; 3]>::from(pose.apply_inverse(*p) - r)).collect();
        for (w, shape) in weights.iter().zip(deltas.chunks_exact(3 * vertices)) {
            left.iter_mut().zip(shape).for_each(|(x, d): (&mut f64, &f32)| *x -= w * f64::from(*d));
        }
        left.into_iter().map(|x| x as f32).collect()
    };
    // The first frame of an animation without a rig is its rest.
    let first = usize::from(fitted.is_empty());
    let residuals: Vec<f32> = (first..frames.len()).flat_map(residual).collect();
    let mut weights = Vec::with_capacity(frames.len());
    for k in 0..frames.len() {
        let mut of_frame = fitted.get(k).map_or_else(Vec::new, |f| f.weights.clone());
        of_frame.extend((first..frames.len()).map(|other| f64::from(u8::from(other == k))));
        weights.push(of_frame);
    }
    targets.extend(frame_names[first..].iter().map(|name| format!("frame {name}")));
    deltas.extend(residuals);
    let poses: Vec<Pose> = (0..frames.len()).map(|k| fitted.get(k).map_or_else(Pose::identity, |f| f.pose)).collect();
    let motion = Motion { frames_per_second: f64::from(a.fps), poses: &poses, weights: &weights };
    let names: Vec<&str> = targets.iter().map(String::as_str).collect();
    write_animated_glb(&a.out, &mesh.with_positions(rest), None, &names, &deltas, &motion).map_err(Failure::writing)?;
    if shapes > 0 {
        let squares = fitted.iter().map(|f| f.rms * f.rms).sum::<f64>() / fitted.len() as f64;
        say(format_args!(
            "{shapes} shapes explain the frames to {:.3} mm rms; the rest is in targets of their own",
            squares.sqrt()
        ))?;
    }
    Ok(())
}

/// The rig's neutral, its shapes' names and displacements, and how it explains the frames.
type Explained = (Vec<Vec3>, Vec<String>, Vec<f32>, Vec<FittedFrame>);

fn explained(
    a: &Arguments,
    path: &Path,
    units: &mut Units<'_>,
    frames: &[Vec<Vec3>],
    frame_names: &[&str],
) -> Result<Explained, Failure> {
    let at_rig = |e: &dyn std::fmt::Display| Failure::loading(format!("{}: {e}", path.display()));
    let rig = read_rig(path, usize::MAX, a.shape_kind, units)?;
    let selection = ShapeSelection { names: None, identity_modes: a.identity_modes };
    let basis = rig.select(selection).map_err(|e| at_rig(&e))?;
    let names: Vec<String> = basis.shapes().iter().map(|s| s.name.clone()).collect();
    let index = |name: &String| rig.find(name).map(|k| rig.deltas(k));
    let deltas = names.iter().map(index).collect::<Result<Vec<_>, _>>().map_err(|e| at_rig(&e))?.concat();
    // modes of how faces differ go below zero
    let bounds = if a.identity_modes > 0 { [-5.0, 5.0] } else { [0.0, 1.0] };
    let options = WeightFitOptions { bounds, pose: Align::Rigid.pose(), ..WeightFitOptions::default() };
    let mut fitter = WeightFitter::new(rig.neutral(), basis, &options).map_err(|e| at_rig(&e))?;
    let mut fitted = Vec::with_capacity(frames.len());
    for (frame, name) in frames.iter().zip(frame_names) {
        let found = fitter.fit(frame).map_err(|e| Failure::loading(format!("frame {name:?}: {e}")))?;
        found.doubts.iter().for_each(|doubt| warn(format_args!("frame {name:?}: {doubt}")));
        fitted.push(found);
    }
    Ok((rig.neutral().to_vec(), names, deltas, fitted))
}
