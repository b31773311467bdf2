//! `scan-bench`: every model on every case with exact dense ground truth, in one table.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use nonrigid::evaluation::TruthErrors;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3, io};
use nonrigid::registration::{
    LandmarkPair, ModelFactory, Pose, RegistrationInput, RegistrationResult, Schedule, TermFactory, register_with,
};
use nonrigid::model::ShapeBasis;
use nonrigid::rig::Rig;
use serde::{Deserialize, Serialize};

/// One case: a scan with the true position of every template vertex.
pub struct BenchCase {
    /// Name of its folder.
    pub name: String,
    /// Template polygons and positions.
    pub template: PolygonMesh,
    /// The subject's own neutral, where it is known.
    pub neutral: Option<Vec<Vec3>>,
    /// The shapes that a fit may use.
    pub shapes: ShapeBasis,
    /// The scan.
    pub scan: TriangleMesh,
    /// True vertex positions, scan frame.
    pub truth: Vec<Vec3>,
    /// Which vertices the scan shows.
    pub observed: Vec<bool>,
    /// Landmarks.
    pub landmarks: Vec<LandmarkPair>,
}

/// What of `case.json` a fit needs.
#[derive(Deserialize)]
struct CaseFile {
    rig_expressions: Vec<String>,
    rig_identity_modes: usize,
}

/// How landmarks take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LandmarkUse {
    /// All, in the start and in the energy.
    All,
    /// All in the start, none in the energy.
    Align,
    /// This many, spread over the face, in the start and in the energy.
    Some(usize),
}

impl std::str::FromStr for LandmarkUse {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "all" => Ok(Self::All),
            "align" => Ok(Self::Align),
            _ => match s.parse() {
                Ok(n) if n >= 3 => Ok(Self::Some(n)),
                _ => Err(format!("'{s}' is not 'all', 'align' or a number of at least 3")),
            },
        }
    }
}
