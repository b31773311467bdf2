//! Where a registration starts: by landmarks in closed form, and without them by a search over poses.
//!
//! [`landmarks`] has the closed form, [`search`] the search, [`icp`] how a pose is refined and judged, [`expressions`] what is done for an
//! open mouth.

mod expressions;
mod icp;
mod landmarks;
mod search;

use std::sync::atomic::{AtomicBool, Ordering};

use serde::{Deserialize, Serialize};

use self::landmarks::{LandmarkPose, deviation, landmark_pose};
use self::search::search_start;
use super::{RegistrationError, ScanFlip};
use crate::landmark::Landmark;
use crate::mesh::{Pose, PoseError, PoseKind, TriangleMesh, Vec3};
use crate::rig::ShapeBasis;

/// How a start is searched where fewer than three landmarks give it. Lengths as in [`Schedule`](super::Schedule).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartOptions {
    /// Rotations tried.
    pub rotations: usize,
    /// Distance between the places tried, millimetres.
    pub spacing: f64,
    /// Poses refined coarsely.
    pub coarse: usize,
    /// Poses refined to the end.
    pub fine: usize,
    /// Longest match in the end, millimetres.
    pub reach: f64,
    /// Share of the template's surface that has to be matched.
    pub least_share: f64,
    /// Loss, from 0 to 1, above which a pose is no start.
    pub greatest_loss: f64,
    /// [`StartSearch::rival`] above which a pose is no start, except the given one, which then wins.
    pub greatest_rival: f64,
    /// Prior standard deviation of the logarithm of the size. A rigid start keeps its own size unless the scan's is evidently
    /// another, as a child's, or landmarks say so of an unknown subject and there are no shapes of identity; 0 keeps it always.
    pub scale_sigma: f64,
    /// Weight of the expression that moves most, as an open mouth does, in a second start where fewer than 16 landmarks pull; the start is
    /// taken whose shape covers the scan better after two levels, at no more energy unless it leaves less than half of what rest
    /// leaves uncovered. Of expressions with a name of ARKit's; 0 for no second start.
    pub expression: f64,
}

impl Default for StartOptions {
    fn default() -> Self {
        Self {
            rotations: 600,
            spacing: 20.0,
            coarse: 300,
            fine: 12,
            reach: 8.0,
            least_share: 0.3,
            greatest_loss: 0.7,
            greatest_rival: 0.95,
            scale_sigma: 0.15,
            expression: 0.8,
        }
    }
}

/// How well a pose fits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StartFit {
    /// Mean loss over the template, from 0 to 1.
    pub loss: f64,
    /// Share of the template's surface with a match.
    pub share: f64,
    /// Root mean square distance of the matched part along the scan's normals, in the schedule's millimetres.
    pub residual: f64,
}

impl StartFit {
    /// What the pose is better than none by.
    fn gain(&self) -> f64 {
        1.0 - self.loss
    }
}

/// What the search of a start found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StartSearch {
    /// Poses tried.
    pub tried: usize,
    /// Poses refined.
    pub refined: usize,
    /// Whether the given pose won.
    pub given: bool,
    /// The fit of the start.
    pub fit: StartFit,
    /// The best fit in another place, if there was any.
    pub runner_up: Option<StartFit>,
    /// Expressions that made the start fit better, and their weights.
    pub expression: Vec<(String, f64)>,
    /// Whether the scan fits better turned over: its normals face inwards.
    pub flipped: bool,
}

/// A landmark that does not go with the others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SuspectLandmark {
    /// Its name.
    pub name: String,
    /// How far it is from where the others say, millimetres.
    pub distance: f64,
}

/// What a start by three or more landmarks is worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LandmarkStart {
    /// Root mean square distance of the landmarks that took part, each with its weight, millimetres.
    pub rms: f64,
    /// Predicted root mean square error at the template's vertices, millimetres: from the covariance of the pose, where each
    /// landmark is off by its own deviation and by what people differ.
    pub std_dev: f64,
    /// Landmarks that took no part, as they contradict all their neighbours; the farthest off first.
    pub suspects: Vec<SuspectLandmark>,
    /// How many times as much as they say the others are off, each otherwise than its neighbours: as many times as
    /// [`SigmaOptions::landmark`](super::SigmaOptions::landmark) where they say nothing. 1 for few landmarks and for what bends.
    pub scatter: f64,
    /// Whether a search found a better pose than the landmarks alone, which it tries where they say little.
    pub searched: bool,
    /// Share of the landmarks that lie off the scan, by more than 15 mm on a face.
    pub off_scan: f64,
    /// How many times as much as they say the landmarks lie off the scan's surface, in the median of those that it does not end before.
    pub above_scan: f64,
}

impl LandmarkStart {
    /// What landmarks count of what they would, `(2 / s)^2` and at most 1, with `s` the scatter or how far they are above the scan: as much
    /// as if they had said what they show. A scatter of up to 2 may as well be a shape that no pose explains.
    #[must_use]
    pub fn trust(&self) -> f64 {
        (PLAUSIBLE / self.scatter.max(self.above_scan).max(PLAUSIBLE)).powi(2)
    }

    /// What the user should know of the landmarks, a sentence each.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let took_no_part = |s: &SuspectLandmark| {
            let SuspectLandmark { name, distance } = s;
            format!(
                "landmark {name:?} is {distance:.0} mm from where the others put it and took no part; check its name and place"
            )
        };
        let mut remarks: Vec<String> = self.suspects.iter().map(took_no_part).collect();
        if self.scatter > PLAUSIBLE && self.scatter >= self.above_scan {
            remarks.push(format!(
                "the landmarks are off by {:.0} times what is expected of them, each otherwise than its neighbours: they count \
                 {:.2} of what they would; place them better",
                self.scatter,
                self.trust()
            ));
        }
        if self.above_scan > PLAUSIBLE.max(self.scatter) {
            remarks.push(format!(
                "the landmarks lie {:.0} times as far off the scan's surface as is expected of them: they count {:.2} of what they \
                 would; was the scan moved after they were placed, or are they another scan's?",
                self.above_scan,
                self.trust()
            ));
        } else if self.off_scan > MOST_OFF_SCAN {
            remarks.push(format!(
                "{:.0} % of the landmarks lie far off the scan: are they another scan's, or was it moved after they were placed?",
                100.0 * self.off_scan
            ));
        }
        remarks
    }
}

/// A landmark farther from the scan than this is on none of it, millimetres on a face: a hole, or what the scan lacks of a nose, is less.
pub(super) const OFF_SCAN: f64 = 15.0;
/// Share of the landmarks that may be off the scan without a word: parts that it lacks.
const MOST_OFF_SCAN: f64 = 0.3;

/// Scatter, and distance from the scan, that landmarks may have without counting less.
const PLAUSIBLE: f64 = 2.0;

impl StartSearch {
    /// How close the best pose elsewhere comes: its gain (one minus the loss) over that of the start. Measured: up to 0.8 for
    /// right starts, from 0.93 for wrong ones.
    #[must_use]
    pub fn rival(&self) -> f64 {
        self.runner_up.map_or(0.0, |other| other.gain() / self.fit.gain().max(f64::MIN_POSITIVE))
    }
}

/// The template and scan that a start is searched for.
pub(super) struct StartInput<'a> {
    /// The template, its centroid at the origin.
    pub template: &'a TriangleMesh,
    /// Vertices that find no scan.
    pub ignored: &'a [bool],
    /// Where the centroid was.
    pub centre: Vec3,
    /// Length of one of the schedule's millimetres.
    pub unit: f64,
    /// Shapes on the template's vertices, or none.
    pub shapes: &'a ShapeBasis,
    /// Whether the subject may be of another size than the template and no shape says so.
    pub size_is_open: bool,
    /// The scan and its own normals.
    pub scan: &'a TriangleMesh,
    pub scan_normals: Option<&'a [Vec3]>,
    /// Points of the template, as given, and the landmarks that say where they are on the scan.
    pub landmarks: &'a [(Vec3, &'a Landmark)],
    /// Deviation of a landmark without its own, as long as the template's.
    pub sigma: f64,
    /// Whether the scan may be, or is, inside out.
    pub flip: ScanFlip,
    /// What ends the search.
    pub cancel: Cancel<'a>,
}

/// A flag that another thread sets to end a search.
#[derive(Clone, Copy)]
pub(super) struct Cancel<'a>(pub Option<&'a AtomicBool>);

impl Cancel<'_> {
    pub(super) fn is_set(self) -> bool {
        self.0.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// # Errors
    /// [`RegistrationError::Cancelled`] once it is set.
    pub(super) fn check(self) -> Result<(), RegistrationError> {
        if self.is_set() { Err(RegistrationError::Cancelled) } else { Ok(()) }
    }
}

/// Where a registration starts.
pub(super) struct Start {
    pub pose: Pose,
    /// Where it was searched.
    pub search: Option<StartSearch>,
    /// Where three or more landmarks gave it.
    pub by_landmarks: Option<LandmarkStart>,
}

impl Start {
    /// From the model's frame, which has the template's `centre` at its origin, to the scan's.
    pub fn frame(&self, centre: Vec3) -> Pose {
        Pose { translation: self.pose.apply(centre), ..self.pose }
    }
}

/// The start of a registration: by three or more landmarks in closed form, otherwise by search. Where the landmarks leave much
/// of the pose open, it is searched as well, and the better one counts.
pub(super) fn find_start(
    input: &StartInput<'_>,
    kind: PoseKind,
    options: &StartOptions,
) -> Result<Start, RegistrationError> {
    if input.landmarks.len() < 3 {
        let (pose, search) = search_start(input, kind, options, None)?;
        return Ok(Start { pose, search: Some(search), by_landmarks: None });
    }
    let LandmarkPose { pose, suspects, scatter } = match landmark_pose(input, kind, options) {
        Ok(found) => found,
        // On a line, they leave a turn open.
        Err(RegistrationError::Start(PoseError::Collinear(count))) => {
            let (pose, search) = search_start(input, kind, options, None).map_err(|e| match e {
                RegistrationError::Cancelled => e,
                _ => PoseError::Collinear(count).into(),
            })?;
            return Ok(Start { pose, search: Some(search), by_landmarks: None });
        }
        Err(e) => return Err(e),
    };
    let trusted: Vec<(Vec3, &Landmark)> = (0..input.landmarks.len())
        .filter(|i| !suspects.iter().any(|s| s.0 == *i))
        .map(|i| input.landmarks[i])
        .collect();
    let deviation = deviation(input, &trusted, &pose);
    let mut start = Start { pose, search: None, by_landmarks: None };
    if deviation > VAGUE * input.unit * pose.scale {
        let of_trusted = StartInput { landmarks: &trusted, ..*input };
        // Where nothing fits, the landmarks still say what they say.
        if let Ok((pose, search)) = search_start(&of_trusted, kind, options, Some(&pose)) {
            if !search.given {
                start.pose = pose;
            }
            start.search = Some(search);
        }
        input.cancel.check()?;
    }
    let away = |(p, l): &(Vec3, &Landmark)| (start.pose.apply(*p) - l.target).norm();
    let weight = |l: &Landmark| l.weight(start.pose.scale * input.sigma);
    let total: f64 = trusted.iter().map(|t| weight(t.1)).sum();
    let rms = (trusted.iter().map(|t| weight(t.1) * away(t).powi(2)).sum::<f64>() / total).sqrt();
    let named = |&(i, distance): &(usize, f64)| {
        let name = input.landmarks[i].1.name.clone();
        SuspectLandmark { name, distance }
    };
    let searched = start.search.as_ref().is_some_and(|search| !search.given);
    let suspects = suspects.iter().map(named).collect();
    start.by_landmarks =
        Some(LandmarkStart { rms, std_dev: deviation, suspects, scatter, searched, off_scan: 0.0, above_scan: 0.0 });
    Ok(start)
}

/// Deviation of a pose by landmarks above which it is searched as well, millimetres at the template's vertices.
const VAGUE: f64 = 8.0;
/// Logarithm of the scale below which a rigid start keeps its own size.
const OTHER_SIZE: f64 = 0.12;
