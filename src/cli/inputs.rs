//! Reading what commands are given.

use std::path::{Path, PathBuf};

use clap::Args;

use super::{Failure, warn};
use crate::mesh::Vec3;
use crate::mesh::io;
use crate::rig::{Rig, RigReadOptions, ShapeBasis, ShapeKind, ShapeSelection};

/// The rig and which of its shapes to use.
#[derive(Debug, Args)]
pub struct RigArguments {
    /// Blendshape rig: a folder of .npy deltas with names, or a folder of .obj/.ply shapes
    #[arg(long, value_name = "DIR")]
    pub rig: Option<PathBuf>,
    /// Expression shapes to use, by name [default: all]
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', requires = "rig")]
    pub shapes: Option<Vec<String>>,
    /// Identity modes to use, from the first
    #[arg(long, value_name = "K", default_value_t = 0, requires = "rig")]
    pub identity_modes: usize,
    /// What a folder of .obj/.ply shapes holds [default: what its rig.json says, or else full shapes]
    #[arg(long, value_enum, requires = "rig")]
    pub shape_kind: Option<ShapeKindArgument>,
}

/// What a file of a rig folder holds.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum ShapeKindArgument {
    /// Whole shapes
    Full,
    /// Differences to the neutral
    Delta,
}

impl RigArguments {
    /// Reads the rig and takes out the shapes that are asked for.
    pub fn read(&self) -> Result<ShapeBasis, Failure> {
        let Some(folder) = &self.rig else { return Ok(ShapeBasis::none()) };
        let rig = read_rig(folder, self.identity_modes, self.shape_kind)?;
        let selection = ShapeSelection { names: self.shapes.as_deref(), identity_modes: self.identity_modes };
        rig.select(selection).map_err(|e| Failure::loading(format!("{}: {e}", folder.display())))
    }
}

/// Reads a rig and prints its warnings.
pub fn read_rig(folder: &Path, modes: usize, kind: Option<ShapeKindArgument>) -> Result<Rig, Failure> {
    let kind = kind.map(|k| match k {
        ShapeKindArgument::Full => ShapeKind::Full,
        ShapeKindArgument::Delta => ShapeKind::Delta,
    });
    let (rig, warnings) =
        Rig::read(folder, &RigReadOptions { identity_modes: modes, kind }).map_err(Failure::loading)?;
    warnings.iter().for_each(warn);
    Ok(rig)
}

/// Vertex positions from a mesh or an N x 3 array.
pub fn read_positions(path: &Path) -> Result<Vec<Vec3>, Failure> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
        return io::read_npy_points(path).map_err(Failure::loading);
    }
    Ok(io::read_polygon_mesh(path).map_err(Failure::loading)?.positions)
}
