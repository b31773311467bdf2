//! `nonrigid rig transfer`.

use std::path::PathBuf;

use clap::Args;

use super::inputs::RigInput;
use super::rig_convert::RigOutput;
use super::units::UnitArguments;
use super::{Failure, Stage, meshes, on_threads, warn};
use crate::rig::{IDENTITY_MODES, TransferError, TransferOptions};

/// Arguments of `nonrigid rig transfer`.
#[derive(Debug, Args)]
#[command(
    after_help = "Deformation transfer (Sumner & Popovic 2004): triangles of the subject deform as those of the rig do. Identity modes\n\
    are left out. The subject is a registered neutral scan: the rig's template after `nonrigid register`.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    nonrigid register --template out/data/rig/template.obj --rig out/data/rig \\\n      \
    --target out/data/cases/new_neutral/scan.ply --landmarks out/data/cases/new_neutral/landmarks.json --out me.obj\n  \
    nonrigid rig transfer --rig out/data/rig --subject me.obj --out me.glb"
)]
pub struct Arguments {
    #[command(flatten)]
    rig: RigInput,
    /// The subject's neutral, with the vertices of the rig: .obj, .ply, .glb, .gltf or .npy N x 3
    #[arg(long, value_name = "FILE")]
    subject: PathBuf,
    /// How much vertices keep to their own displacement instead of their triangles' deformation, above 0
    #[arg(long, value_name = "A", default_value_t = TransferOptions::default().anchor)]
    anchor: f64,
    /// Threads [default: all cores]; the result does not depend on them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[command(flatten)]
    units: UnitArguments,
    #[command(flatten)]
    output: RigOutput,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    on_threads(arguments.threads, || run_here(arguments))?
}

fn run_here(a: &Arguments) -> Result<(), Failure> {
    let others = meshes([("subject", Some(&a.subject))]);
    a.output.check(&a.rig.path, &others)?;
    let mut units = a.units.of(&["rig", "subject"])?;
    let rig = a.rig.read(IDENTITY_MODES, &mut units)?;
    a.output.check_shapes(&a.rig.path, &others, &rig)?;
    let subject = units.read_positions("subject", &a.subject)?;
    units.say();
    let transferred = rig.transfer(&subject, &TransferOptions { anchor: a.anchor });
    let (personal, warnings) = transferred.map_err(|e| {
        let (stage, at) = match &e {
            TransferError::Anchor(_) => (Stage::Arguments, "--anchor".to_owned()),
            TransferError::NoPolygons | TransferError::NoShapes => (Stage::Loading, a.rig.path.display().to_string()),
            TransferError::Rig(_) => (Stage::Loading, a.subject.display().to_string()),
            TransferError::Pose(_) => (Stage::Loading, a.subject.display().to_string()),
            TransferError::Linear(_) => (Stage::Computation, a.subject.display().to_string()),
        };
        Failure::new(stage, format!("{at}: {e}"))
    })?;
    warnings.iter().for_each(warn);
    a.output.write(&personal, &a.rig.path)
}
