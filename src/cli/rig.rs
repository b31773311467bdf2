//! `nonrigid rig`.

use std::path::{Path, PathBuf};

use clap::Subcommand;

use super::inputs::{ShapeKindArgument, read_rig};
use super::units::UnitArguments;
use super::{Failure, rig_convert, rig_fit, rig_pca, rig_subdivide, rig_transfer, say};

/// `nonrigid rig` and its subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// List a rig's shapes: family, how many vertices each moves, and how far
    #[command(
        after_help = "Examples, on what `data-gen --seed 7 --out out/data` makes:\n  nonrigid rig info out/data/rig\n  \
        nonrigid rig info out/data/rig --json"
    )]
    Info {
        /// The rig: a folder of .npy deltas with names, a folder of .obj/.ply shapes, .npz, .glb or .gltf
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
        #[arg(long, value_enum)]
        shape_kind: Option<ShapeKindArgument>,
        #[command(flatten)]
        units: UnitArguments,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Make a rig of identity modes from meshes of one topology: the principal components of how they differ
    Pca(rig_pca::Arguments),
    /// Write a rig in another form: a folder of .npy deltas, a folder of .obj shapes, .npz or .glb
    Convert(rig_convert::Arguments),
    /// Give a rig's shapes to a subject: a personal rig from one registered neutral scan
    Transfer(rig_transfer::Arguments),
    /// Divide a rig's mesh and all its shapes by Catmull and Clark's rules
    Subdivide(rig_subdivide::Arguments),
    /// Find the weights of a sequence of registered meshes
    Fit(rig_fit::Arguments),
}

/// Examples of the whole family.
pub const EXAMPLES: &str = "\
Examples, on what `data-gen --seed 7 --out out/data` makes:
  nonrigid rig info out/data/rig
  nonrigid rig convert --rig out/data/rig --out rig.npz";

/// Runs the command.
pub fn run(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Info { folder, shape_kind, units, json } => info(folder, *shape_kind, units, *json),
        Command::Pca(arguments) => rig_pca::run(arguments),
        Command::Convert(arguments) => rig_convert::run(arguments),
        Command::Transfer(arguments) => rig_transfer::run(arguments),
        Command::Subdivide(arguments) => rig_subdivide::run(arguments),
        Command::Fit(arguments) => rig_fit::run(arguments),
    }
}

fn info(folder: &Path, kind: Option<ShapeKindArgument>, units: &UnitArguments, json: bool) -> Result<(), Failure> {
    let mut units = units.of(&["rig"])?;
    let rig = read_rig(folder, usize::MAX, kind, &mut units)?;
    units.say();
    let info = rig.info();
    if json {
        let text = serde_json::to_string_pretty(&info).map_err(Failure::computation)?;
        return say(text);
    }
    say(format_args!("{} vertices, {} shapes", rig.neutral().len(), info.len()))?;
    let width = info.iter().map(|s| s.name.len()).max().unwrap_or(0).max(4);
    say(format_args!("{:width$}  {:10}  {:>8}  {:>8}", "name", "family", "vertices", "max mm"))?;
    for shape in info {
        let family = format!("{:?}", shape.family).to_lowercase();
        say(format_args!(
            "{:width$}  {family:10}  {:8}  {:8.2}",
            shape.name, shape.moved_vertices, shape.max_displacement
        ))?;
    }
    Ok(())
}
