//! What is scanned, by which cameras, and how badly.

use nonrigid::mesh::{Pose, Vec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::arguments::{bend, camera, in_range, name_and_weight, two_numbers, wrinkles};
use super::deformation::{self, Bend};
use super::{ScanError, weights_by_name};
use crate::FaceRig;

/// How a surface becomes a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Scanner {
    /// Irregular points on the generated face's formulas, each with noise of its own, of which cameras see some.
    #[default]
    Net,
    /// The pixels of one depth camera, cut where depth jumps.
    Frame,
    /// Seven depth images made one surface.
    Fused,
}

impl Scanner {
    /// The cameras of a scan: those given; without any, of a frame one somewhere before the subject, of a fused scan seven round its
    /// front, at 700 mm from a face and farther from what is `scale` times as large.
    pub(super) fn cameras(self, given: &[Camera], scale: f64, rng: &mut ChaCha8Rng) -> Vec<Camera> {
        let at =
            |azimuth: f64, elevation: f64| Camera::Orbit { azimuth, elevation, distance: DISTANCE * scale.max(1.0) };
        match self {
            _ if !given.is_empty() => given.to_vec(),
            Self::Net => Vec::new(),
            Self::Frame => vec![at(rng.random_range(-35.0..35.0), rng.random_range(-10.0..15.0))],
            Self::Fused => {
                let level = [-60.0, -30.0, 0.0, 30.0, 60.0].map(|azimuth| at(azimuth, 0.0));
                level.into_iter().chain([at(0.0, 25.0), at(0.0, -25.0)]).collect()
            }
        }
    }
}

/// How far a camera is from a face, millimetres.
const DISTANCE: f64 = 700.0;

/// What is scanned and how badly: the options of `data-gen` of groups Cases, Scanner and Faults. Lengths in millimetres, angles in
/// degrees.
#[derive(Debug, Clone, PartialEq, Serialize, clap::Args)]
pub struct ScanOptions {
    /// Expression weights by name; a name without `_L` or `_R` stands for both sides, and of two equal names the later
    /// counts. `None` draws three of 0.4 to 1.
    #[arg(long = "expression", value_name = "NAME=WEIGHT", value_parser = name_and_weight, help_heading = "Cases",
          help = "Weight of an expression, repeatable, for every case or as the peak of a sequence; without _L or _R: both sides")]
    pub expressions: Option<Vec<(String, f64)>>,
    /// Identity weights, missing ones are 0; `None` draws them from N(0, `identity_sigma`).
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "W,W,...",
        allow_hyphen_values = true,
        help_heading = "Cases",
        help = "Identity weights, for every case; missing ones are 0. Default: drawn"
    )]
    pub identity: Option<Vec<f64>>,
    /// Standard deviation of drawn identity weights.
    #[arg(long, default_value_t = ScanOptions::default().identity_sigma, conflicts_with = "identity", help_heading = "Cases")]
    pub identity_sigma: f64,
    /// Largest angle of the random rotation, degrees.
    #[arg(long, default_value_t = ScanOptions::default().rotation, help_heading = "Cases")]
    pub rotation: f64,
    /// Largest translation along each axis, mm.
    #[arg(long, default_value_t = ScanOptions::default().translation, help_heading = "Cases")]
    pub translation: f64,
    /// The pose, in place of a random one.
    #[arg(skip)]
    pub pose: Option<Pose>,
    /// How differently a person makes an expression from how the rig does: largest relative change.
    #[arg(long, default_value_t = ScanOptions::default().manner, help_heading = "Cases")]
    pub manner: f64,
    /// Where comes from what frames of a sequence share: a person's manner and wrinkles, a camera drawn at random, the end that is cut
    /// off. `None`: from the scan's seed.
    #[arg(skip)]
    pub shared_seed: Option<u64>,
    /// A smooth displacement that no shape says, of this root mean square length, mm. Of a --rig only.
    #[arg(long, value_name = "MM", default_value_t = ScanOptions::default().field, help_heading = "Cases")]
    pub field: f64,
    /// Bends what is nearer to the landmark TIP, along the surface, than JOINT is by at most so many degrees about JOINT, such as
    /// wrist_l,elbow_l=60; repeatable. Of a --rig only.
    #[arg(long = "bend", value_name = "TIP,JOINT=DEGREES", value_parser = bend, help_heading = "Cases")]
    pub bends: Vec<Bend>,
    /// How the surface becomes a scan: irregular points on the generated face itself; one depth image, cut at jumps; or seven depth
    /// images made one surface. Depth images have noise that neighbours share, and lose what they see steeply.
    #[arg(long, value_enum, default_value_t, help_heading = "Scanner")]
    pub scanner: Scanner,
    /// Triangles of the finished scan, after visibility and holes, 500 to 10,000,000; met within about 3 %.
    #[arg(long, default_value_t = ScanOptions::default().triangles, value_parser = in_range(5000, 5_000_000), help_heading = "Scanner",
          help = "Triangles of each finished scan: 5,000 to 5,000,000, met within about 3 %")]
    pub triangles: usize,
    /// What is measured is what at least one of them sees. None: the net sees everything, the other scanners choose their own.
    #[arg(long = "camera", value_name = "AZ,EL[,MM]", value_parser = camera, allow_hyphen_values = true, help_heading = "Scanner",
          help = "Azimuth from +Z towards +X, elevation and, if not 700 mm, distance of a camera; repeatable. Default: -30,0 0,0 30,0; \
                  for `frame` one at random, for `fused` -60,0 to 60,0 in steps of 30 and 0,-25 0,25")]
    pub cameras: Vec<Camera>,
    /// Steepest angle between normal and view ray, degrees.
    #[arg(long, default_value_t = ScanOptions::default().grazing, help_heading = "Scanner")]
    pub grazing: f64,
    /// Whether the visible part of the eyeballs belongs to the scan.
    #[arg(long = "no-eyeballs", action = clap::ArgAction::SetFalse, help_heading = "Scanner", help = "Leaves the eyeballs out")]
    pub eyeballs: bool,
    /// Largest height of wrinkles that no shape expresses, mm.
    #[arg(long, default_value_t = ScanOptions::default().detail, help_heading = "Scanner")]
    pub detail: f64,
    /// Strengths of forehead lines, crow's feet, folds and skin structure; 1 is usual.
    #[arg(long, value_name = "F,C,F,S", value_parser = wrinkles, default_value = "1,1,1,1", help_heading = "Scanner")]
    pub wrinkles: WrinkleMix,
    /// Standard deviation of the noise along the view ray, mm.
    #[arg(long, default_value_t = ScanOptions::default().noise, help_heading = "Faults")]
    pub noise: f64,
    /// Growth of the noise with the angle a to the ray: x (1 + G (1 / cos a - 1)).
    #[arg(long, value_name = "G", default_value_t = ScanOptions::default().grazing_noise, help_heading = "Faults")]
    pub grazing_noise: f64,
    /// Number of holes.
    #[arg(long, default_value_t = ScanOptions::default().holes, help_heading = "Faults")]
    pub holes: usize,
    /// Smallest and largest radius of a hole, mm.
    #[arg(long, value_name = "MM,MM", value_parser = two_numbers, default_value = "4,9", help_heading = "Faults")]
    pub hole_radius: [f64; 2],
    /// Share of the scan that is left when one end, either, is cut off across its longest direction.
    #[arg(long, value_name = "SHARE", default_value_t = ScanOptions::default().keep, help_heading = "Faults")]
    pub keep: f64,
    /// Share of the points that are spikes.
    #[arg(long, default_value_t = ScanOptions::default().spikes, help_heading = "Faults")]
    pub spikes: f64,
    /// Smallest and largest height of a spike, mm.
    #[arg(long, value_name = "MM,MM", value_parser = two_numbers, default_value = "3,15", help_heading = "Faults")]
    pub spike_height: [f64; 2],
    /// Share of the triangles that float alone near the surface.
    #[arg(long, default_value_t = ScanOptions::default().outliers, help_heading = "Faults")]
    pub outliers: f64,
    /// Number of loose parts beside the face.
    #[arg(long, default_value_t = ScanOptions::default().loose_parts, help_heading = "Faults")]
    pub loose_parts: usize,
    /// Standard deviation of the landmarks along each axis, mm.
    #[arg(long, default_value_t = ScanOptions::default().landmark_noise, help_heading = "Faults")]
    pub landmark_noise: f64,
}

/// How strong the kinds of detail are among each other; 1 is usual, 0 none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WrinkleMix {
    /// Lines across the forehead.
    pub forehead: f64,
    /// Crow's feet, from the outer corners of the eyes.
    pub crows_feet: f64,
    /// Folds from nose to mouth and under the eyes.
    pub folds: f64,
    /// Isotropic structure of the skin.
    pub skin: f64,
}

impl Default for WrinkleMix {
    fn default() -> Self {
        Self { forehead: 1.0, crows_feet: 1.0, folds: 1.0, skin: 1.0 }
    }
}

/// Where a camera stands. All of them look at the face's centre.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Camera {
    /// Round the face's centre, in the scan's axes.
    Orbit {
        /// From +Z towards +X, degrees.
        azimuth: f64,
        /// Upwards, degrees.
        elevation: f64,
        /// From the centre, millimetres.
        distance: f64,
    },
    /// A point in the scan's coordinates.
    Position([f64; 3]),
}

impl Camera {
    /// At the usual distance, 700 mm.
    #[must_use]
    pub fn orbit(azimuth: f64, elevation: f64) -> Self {
        Self::Orbit { azimuth, elevation, distance: DISTANCE }
    }

    /// Its position when the face's centre is at `centre`.
    pub(super) fn position(&self, centre: Vec3) -> Vec3 {
        match *self {
            Self::Position(p) => p.into(),
            Self::Orbit { azimuth, elevation, distance } => {
                let ((sin, cos), (up, level)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
                centre + Vec3::new(sin * level, up, cos * level) * distance
            }
        }
    }
}

impl Default for ScanOptions {
    fn default() -> Self {
        Self {
            expressions: None,
            identity: None,
            identity_sigma: 0.8,
            manner: 0.2,
            field: 0.0,
            bends: Vec::new(),
            detail: 0.8,
            wrinkles: WrinkleMix::default(),
            shared_seed: None,
            rotation: 12.0,
            translation: 20.0,
            pose: None,
            triangles: 60_000,
            eyeballs: true,
            scanner: Scanner::Net,
            cameras: [-30.0, 0.0, 30.0].map(|azimuth| Camera::orbit(azimuth, 0.0)).to_vec(),
            grazing: 70.0,
            noise: 0.1,
            grazing_noise: 0.5,
            holes: 4,
            hole_radius: [4.0, 9.0],
            keep: 1.0,
            spikes: 0.001,
            spike_height: [3.0, 15.0],
            outliers: 0.001,
            loose_parts: 2,
            landmark_noise: 1.0,
        }
    }
}

impl ScanOptions {
    /// The face as it is: no noise, holes, spikes, outliers, loose parts, detail, pose, hidden regions or eyeballs, exact
    /// landmarks.
    #[must_use]
    pub fn clean() -> Self {
        Self {
            manner: 0.0,
            detail: 0.0,
            rotation: 0.0,
            translation: 0.0,
            eyeballs: false,
            cameras: Vec::new(),
            noise: 0.0,
            holes: 0,
            spikes: 0.0,
            outliers: 0.0,
            loose_parts: 0,
            landmark_noise: 0.0,
            ..Self::default()
        }
    }

    /// Whether these options make sense for a rig.
    ///
    /// # Errors
    /// When a number is out of its range, or the rig does not have an expression or so many identity modes.
    pub fn validate(&self, rig: &FaceRig) -> Result<(), ScanError> {
        weights_by_name(rig, self.expressions.as_deref().unwrap_or_default())?;
        let (given, modes) = (self.identity.as_ref().map_or(0, Vec::len), rig.identities.len());
        if given > modes {
            return Err(ScanError::Option(format!("identity: {given} weights for a rig of {modes} modes")));
        }
        if rig.model.is_none() && self.scanner == Scanner::Net {
            let what = "scanner: net knows the generated face only; frame and fused scan any rig";
            return Err(ScanError::Option(what.into()));
        }
        if self.scanner == Scanner::Frame && self.cameras.len() > 1 {
            let what = format!("scanner: frame has one camera, not {}; fused joins several", self.cameras.len());
            return Err(ScanError::Option(what));
        }
        self.check()?;
        deformation::validate(rig, self)
    }

    fn check(&self) -> Result<(), ScanError> {
        let bad = |what: &str, range: &str, found: f64| Err(ScanError::Option(format!("{what}: {range}, not {found}")));
        let mix = &self.wrinkles;
        for (what, value, most) in [
            ("identity sigma", self.identity_sigma, 10.0),
            ("manner", self.manner, 1.0),
            ("field", self.field, 1000.0),
            ("detail", self.detail, 5.0),
            ("forehead lines", mix.forehead, 10.0),
            ("crow's feet", mix.crows_feet, 10.0),
            ("folds", mix.folds, 10.0),
            ("skin structure", mix.skin, 10.0),
            ("rotation", self.rotation, 180.0),
            ("translation", self.translation, 1e6),
            ("grazing angle", self.grazing, 90.0),
            ("noise", self.noise, 100.0),
            ("growth of the noise", self.grazing_noise, 100.0),
            ("smallest hole radius", self.hole_radius[0], self.hole_radius[1]),
            ("largest hole radius", self.hole_radius[1], 1000.0),
            ("share of spikes", self.spikes, 1.0),
            ("smallest spike", self.spike_height[0], self.spike_height[1]),
            ("largest spike", self.spike_height[1], 1e6),
            ("share of outliers", self.outliers, 0.5),
            ("landmark noise", self.landmark_noise, 1000.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return bad(what, &format!("0 to {most}"), value);
            }
        }
        if !(500..=10_000_000).contains(&self.triangles) {
            return bad("triangles", "500 to 10,000,000", self.triangles as f64);
        }
        if !(0.05..=1.0).contains(&self.keep) {
            return bad("share to keep", "0.05 to 1", self.keep);
        }
        if let Some(bend) = self.bends.iter().find(|b| !(0.0..=180.0).contains(&b.degrees)) {
            return bad("angle of a bend", "0 to 180 degrees", bend.degrees);
        }
        for (what, count) in [("holes", self.holes), ("loose parts", self.loose_parts)] {
            if count > 1000 {
                return bad(what, "at most 1000", count as f64);
            }
        }
        for camera in &self.cameras {
            match *camera {
                Camera::Orbit { azimuth, elevation, distance } => {
                    if !(azimuth.abs() <= 360.0 && elevation.abs() < 90.0) {
                        let range = "azimuth within 360 and elevation within 90 degrees".to_owned();
                        return Err(ScanError::Option(format!("camera: {range}, not {azimuth}, {elevation}")));
                    }
                    if !(250.0..=1e5).contains(&distance) {
                        return bad("distance of a camera", "250 to 100,000 mm", distance);
                    }
                }
                Camera::Position(p) => {
                    if p.iter().any(|x| x.is_nan() || x.abs() > 1e5) {
                        return Err(ScanError::Option(format!("camera: a position within 100,000 mm, not {p:?}")));
                    }
                }
            }
        }
        let finite = |w: &f64| w.is_finite() && w.abs() <= 100.0;
        let weights = self.expressions.iter().flatten().map(|e| &e.1).chain(self.identity.iter().flatten());
        match weights.copied().find(|w| !finite(w)) {
            Some(weight) => bad("weight", "-100 to 100", weight),
            None => Ok(()),
        }
    }
}
