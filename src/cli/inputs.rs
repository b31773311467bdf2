//! Reading what commands are given, with the checks that concern more than one file.

use std::path::{Path, PathBuf};

use clap::Args;

use super::{Failure, warn};
use crate::mesh::io::{self, Landmark, Scan, TemplatePoint};
use crate::mesh::{PolygonMesh, Vec3};
use crate::model::ShapeBasis;
use crate::registration::{LandmarkPair, SigmaOptions};
use crate::rig::{Rig, RigOptions};

/// The rig and which of its shapes to use.
#[derive(Debug, Args)]
pub struct RigArguments {
    /// Blendshape rig: a folder of .npy deltas with names, or a folder of .obj/.ply shapes.
    #[arg(long, value_name = "DIR")]
    pub rig: Option<PathBuf>,
    /// Expression shapes to use, by name [default: all].
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "rig")]
    pub shapes: Option<Vec<String>>,
    /// Identity modes to use, from the first [default: none].
    #[arg(long, value_name = "K", default_value_t = 0, requires = "rig")]
    pub identity_modes: usize,
}
