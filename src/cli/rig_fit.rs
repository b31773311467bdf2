//! `nonrigid rig fit`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;

use super::inputs::{Align, RigInput, bounds, frames, rig_files, trimmed};
use super::units::UnitArguments;
use super::{Failure, Stage, check_output, check_plan, has_extension, meshes, say, warn};
use crate::io::{FilePlan, write_atomically, write_json};
use crate::rig::{FittedFrame, RigError, ShapeSelection, WeightFitOptions, WeightFitter};
use crate::text::csv_field;

/// Arguments of `nonrigid rig fit`.
#[derive(Debug, Args)]
#[command(
    after_help = "Frames are meshes of the rig's topology, such as registered scans. .csv: frame, rms_mm, max_mm and a column for each\n\
    shape; .json has the poses too.\n\n\
    Example, on a rig such as `nonrigid rig transfer` makes and a folder of registered scans:\n  \
    nonrigid rig fit --rig me.glb --meshes registered --out weights.csv"
)]
pub struct Arguments {
    #[command(flatten)]
    rig: RigInput,
    /// Shapes to use, by name [default: all but identity modes]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', value_parser = trimmed)]
    shapes: Option<Vec<String>>,
    /// The frames: every .obj and .ply in this folder, or where there are none every .glb, by name
    #[arg(long, value_name = "DIR")]
    meshes: PathBuf,
    /// The subject's own neutral (.npy N x 3 or a mesh) [default: the rig's]
    #[arg(long, value_name = "FILE")]
    neutral: Option<PathBuf>,
    /// What else moves: the head, usually
    #[arg(long, value_enum, default_value_t = Align::Rigid)]
    align: Align,
    /// Smallest and largest weight
    #[arg(long, value_name = "MIN,MAX", value_parser = bounds, default_value = "0,1", allow_hyphen_values = true)]
    bounds: [f64; 2],
    #[command(flatten)]
    units: UnitArguments,
    /// Weights of the frames: .csv or .json
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(serde::Serialize)]
struct Sequence {
    shapes: Vec<String>,
    frames: Vec<Frame>,
}

#[derive(serde::Serialize)]
struct Frame {
    name: String,
    #[serde(flatten)]
    fitted: FittedFrame,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    check_output(&a.out, &["csv", "json"])?;
    if !a.bounds.iter().all(|b| b.is_finite()) {
        return Err(Failure::new(Stage::Arguments, "--bounds: give two finite numbers"));
    }
    let files = frames(&a.meshes)?;
    let plan = FilePlan::new()
        .reads_all(rig_files(&a.rig.path))
        .reads_all(files.iter().map(|(_, path)| ("meshes", path.clone())))
        .reads_all(meshes([("neutral", a.neutral.as_ref())]))
        .writes("--out", &a.out);
    check_plan(&plan)?;
    let mut units = a.units.of_given(&[("rig", true), ("meshes", true), ("neutral", a.neutral.is_some())])?;
    let rig = a.rig.read(usize::MAX, &mut units)?;
    let at_rig = |e| Failure::loading(format!("{}: {e}", a.rig.path.display()));
    let basis = rig.select(ShapeSelection { names: a.shapes.as_deref(), identity_modes: 0 }).map_err(at_rig)?;
    if basis.is_empty() {
        return Err(Failure::loading(format!(
            "{}: no shapes to fit; identity modes are left out unless --shapes names them",
            a.rig.path.display()
        )));
    }
    let neutral = match &a.neutral {
        Some(path) => units.read_positions("neutral", path)?,
        None => rig.neutral().to_vec(),
    };
    let shapes: Vec<String> = basis.shapes().iter().map(|s| s.name.clone()).collect();
    let options = WeightFitOptions { bounds: a.bounds, pose: a.align.pose(), ..WeightFitOptions::default() };
    let mut fitter = WeightFitter::new(&neutral, rig.mesh(), basis, &options)
        .map_err(|e| Failure::loading(format!("{}: {e}", a.neutral.as_ref().unwrap_or(&a.rig.path).display())))?;
    let mut frames = Vec::with_capacity(files.len());
    for (name, path) in files {
        let positions = units.read_mesh("meshes", &path)?.positions;
        if positions.len() != neutral.len() {
            let (found, expected) = (positions.len(), neutral.len());
            return Err(Failure::loading(format!("{}: found {found} vertices, expected {expected}", path.display())));
        }
        let fitted = fitter.fit(&positions).map_err(|e| {
            let stage = if matches!(e, RigError::Unlike { .. }) { Stage::Loading } else { Stage::Computation };
            Failure::new(stage, format!("{}: {e}", path.display()))
        })?;
        if !fitted.converged {
            warn(format_args!("{}: the weights have not settled", path.display()));
        }
        fitted.doubts.iter().for_each(|doubt| warn(format_args!("{}: {doubt}", path.display())));
        frames.push(Frame { name, fitted });
    }
    units.say();
    let sequence = Sequence { shapes, frames };
    if has_extension(&a.out, "json") {
        write_json(&a.out, &sequence).map_err(Failure::writing)?;
    } else {
        let text = csv(&sequence);
        write_atomically(&a.out, |w| w.write_all(text.as_bytes())).map_err(Failure::writing)?;
    }
    let frames = sequence.frames.iter();
    let rms = (frames.clone().map(|f| f.fitted.rms.powi(2)).sum::<f64>() / frames.len() as f64).sqrt();
    let max = frames.clone().map(|f| f.fitted.max).fold(0.0, f64::max);
    let (count, shapes) = (frames.len(), sequence.shapes.len());
    say(format_args!("{count} frames, {shapes} shapes: {rms:.4} mm rms, {max:.4} mm at most"))?;
    say(format_args!("wrote {}", a.out.display()))
}

fn csv(sequence: &Sequence) -> String {
    let mut text = "frame,rms_mm,max_mm".to_owned();
    sequence.shapes.iter().for_each(|name| text.extend([",", &csv_field(name)]));
    text.push('\n');
    for Frame { name, fitted } in &sequence.frames {
        // writing to a string cannot fail
        let _ = write!(text, "{},{},{}", csv_field(name), fitted.rms, fitted.max);
        for weight in &fitted.weights {
            let _ = write!(text, ",{weight}");
        }
        text.push('\n');
    }
    text
}
