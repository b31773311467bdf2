//! The studies, one file each, in the order of the page.

mod ablations;
mod comparison;
mod convergence;
mod extreme;
mod inputs;
mod mask_models;
mod masks;
mod peers;
mod presets;
mod real;
mod resolution;
mod shapes;
mod silence;
mod solver;
mod sweeps;

use super::study::Study;

/// All of them.
pub const STUDIES: &[Study] = &[
    inputs::STUDY,
    extreme::STUDY,
    shapes::STUDY,
    convergence::STUDY,
    comparison::STUDY,
    sweeps::STUDY,
    resolution::STUDY,
    ablations::STUDY,
    silence::STUDY,
    real::STUDY,
    peers::STUDY,
    solver::STUDY,
    masks::STUDY,
    presets::STUDY,
    mask_models::STUDY,
];

/// The study that needs scans of the user's.
pub const REAL: &str = real::STUDY.name;
/// The studies of scans of the user's without truth, where there are any.
pub const OF_SCANS: [&str; 2] = [REAL, presets::STUDY.name];
/// The study that needs other programs.
pub const PEERS: &str = peers::STUDY.name;
/// The studies that leave files in a folder of their name.
pub const WITH_FOLDER: [&str; 4] = [extreme::STUDY.name, PEERS, presets::STUDY.name, REAL];
