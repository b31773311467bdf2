//! `nonrigid rig convert`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::inputs::{ShapeKindArgument, read_rig};
use super::{Failure, Stage, check_output, check_output_folder, same_place, say};
use crate::mesh::io::WriteError;
use crate::rig::Rig;

/// Arguments of `nonrigid rig convert`.
#[derive(Debug, Args)]
#[command(
    after_help = "A folder of shapes has one .obj a shape, by name, and neutral.obj; it keeps neither families nor landmarks. .npz has\n\
    the arrays of the .npy folder under the same names; it keeps neither groups nor materials. .glb has metres in 32 bits:\n\
    positions move by less than 1e-4 mm.\n\n\
    Examples, on what `data-gen --seed 7 --out out/data` makes:\n  \
    nonrigid rig convert --rig out/data/rig --out rig.glb\n  nonrigid rig convert --rig rig.glb --format shapes --out shapes"
)]
pub struct Arguments {
    /// The rig: a folder of .npy deltas with names, a folder of .obj/.ply shapes, .npz, .glb or .gltf
    #[arg(long, value_name = "DIR|FILE")]
    rig: PathBuf,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum)]
    shape_kind: Option<ShapeKindArgument>,
    #[command(flatten)]
    output: RigOutput,
}

/// Where a rig goes.
#[derive(Debug, Args)]
pub struct RigOutput {
    /// The new rig: .npz, .glb, or a folder, made if it is not there
    #[arg(long, value_name = "DIR|FILE")]
    out: PathBuf,
    /// What a folder is to hold
    #[arg(long, value_enum, default_value_t = Format::Npy)]
    format: Format,
}

/// Layout of a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// .npy deltas with names, and the template as .obj
    Npy,
    /// One .obj a shape
    Shapes,
}

impl RigOutput {
    /// Refuses what could not be written in the end, or would be mixed with the rig that was read.
    pub fn check(&self, input: &Path) -> Result<(), Failure> {
        if same_place(input, &self.out) {
            let message = format!("--out: {} is the rig that is read", self.out.display());
            return Err(Failure::new(Stage::Arguments, message));
        }
        if !self.is_file() {
            return check_output_folder(&self.out);
        }
        if self.format == Format::Shapes {
            let message = format!("--format shapes: {} is a file, not a folder", self.out.display());
            return Err(Failure::new(Stage::Arguments, message));
        }
        check_output(&self.out, &["npz", "glb"])
    }

    /// Anything with an extension, unless it is a folder that is there.
    fn is_file(&self) -> bool {
        self.out.extension().is_some() && !self.out.is_dir()
    }

    /// Writes the rig and says so.
    pub fn write(&self, rig: &Rig) -> Result<(), Failure> {
        if !self.is_file() && !self.out.is_dir() {
            let failed = |e| Failure::writing(format!("{}: cannot be made: {e}", self.out.display()));
            std::fs::create_dir(&self.out).map_err(failed)?;
        }
        let write: fn(&Rig, &Path) -> Result<(), WriteError> = match (self.is_file(), self.format) {
            (false, Format::Npy) => Rig::write,
            (false, Format::Shapes) => Rig::write_meshes,
            (true, _) if self.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz")) => Rig::write_npz,
            (true, _) => Rig::write_gltf,
        };
        write(rig, &self.out).map_err(Failure::writing)?;
        let (vertices, shapes) = (rig.neutral().len(), rig.shapes().len());
        say(format_args!("wrote {}: {vertices} vertices, {shapes} shapes", self.out.display()))
    }
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    a.output.check(&a.rig)?;
    a.output.write(&read_rig(&a.rig, usize::MAX, a.shape_kind)?)
}
