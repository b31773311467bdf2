//! Before the first step: what a registration is made of, and where it starts.

use std::borrow::Cow;

use super::RegistrationProblem;
use crate::correspondence::{ScanFlip, ScanOptions, ScanSurface};
use crate::energy::{DeformationModel as _, Options, Samples};
use crate::landmark::{Landmark, TemplatePoint};
use crate::mesh::{Pose, Vec3};
use crate::model::{ModelFactory, ModelInput, RegistrationModel};
use crate::nlls::Problem as _;
use crate::registration::facing::{self, Faced};
use crate::registration::input::check_geometry;
use crate::registration::one_surface::OneSurface;
use crate::registration::rest::Rest;
use crate::registration::start::{self, Start, StartInput};
use crate::registration::{RegistrationError, RegistrationInput, ScanFacing, Schedule, StartSearch, WarmStart};
use crate::rig::{Family, Regions, ShapeBasis};
use crate::term::{RegistrationTerm, TermFactory, TermInput, TermLandmark};

/// Where [`register`](super::register) starts: by three or more landmarks in closed form, otherwise by a search, which then says what it found.
///
/// # Errors
/// Those of [`register`](super::register) before its first step.
pub fn find_start(
    input: &RegistrationInput<'_>,
    schedule: &Schedule,
) -> Result<(Pose, Option<StartSearch>), RegistrationError> {
    schedule.validate()?;
    check_geometry(input)?;
    let surface = OneSurface::of(input);
    let input = &surface.as_ref().map_or(*input, |surface| surface.input(input));
    let template = Rest::new(input, schedule)?;
    let start = start_of(input, &agreeing(input).0, &template, schedule, start::Cancel(None))?;
    Ok((start.pose, start.search))
}

/// The scan, each vertex and triangle once and facing as its neighbours do, unless it has normals of its own; and what was done to it.
fn agreeing<'a>(input: &RegistrationInput<'a>) -> (Faced<'a>, ScanFacing) {
    let own = |normals: &&[Vec3]| normals.len() != input.scan.positions.len() || facing::belong(input.scan, normals);
    let (scan, joined) = facing::joined(input.scan);
    match input.scan_normals.filter(|_| joined.joined == 0).filter(own) {
        Some(normals) => ((scan, Some(Cow::Borrowed(normals))), joined),
        None => {
            let (scan, agreed) = facing::agreeing(scan);
            let normals_ignored = input.scan_normals.is_some() && joined.joined == 0;
            ((scan, None), ScanFacing { repeated: agreed.repeated, turned: agreed.turned, normals_ignored, ..joined })
        }
    }
}

fn start_of(
    input: &RegistrationInput<'_>,
    (scan, scan_normals): &Faced<'_>,
    rest: &Rest,
    schedule: &Schedule,
    cancel: start::Cancel<'_>,
) -> Result<Start, RegistrationError> {
    let at = |l: &Landmark| l.template.position(&rest.mesh.positions) + rest.centre;
    let landmarks: Vec<_> = input.landmarks.iter().map(|l| (at(l), l)).collect();
    let search = StartInput {
        template: &rest.mesh,
        ignored: &rest.masks.unseen(),
        centre: rest.centre,
        unit: rest.unit,
        shapes: input.shapes,
        size_is_open: input.neutral.is_none() && input.shapes.shapes().iter().all(|s| s.family != Family::Identity),
        scan,
        scan_normals: scan_normals.as_deref(),
        landmarks: &landmarks,
        sigma: schedule.sigma.landmark * rest.unit,
        flip: schedule.scan.flip,
        cancel,
    };
    start::find_start(&search, schedule.start, &schedule.search)
}

/// A sample for every landmark: the vertex' own, or a new one inside a face.
pub(super) fn landmark_samples(landmarks: &[Landmark], samples: &mut Samples) -> Result<Vec<usize>, RegistrationError> {
    let sample = |landmark: &Landmark| match landmark.template {
        TemplatePoint::Vertex(vertex) => Ok(vertex as usize),
        TemplatePoint::Face { corners, weights } => {
            Ok(samples.push(&std::array::from_fn::<_, 3, _>(|c| (corners[c], weights[c])))?)
        }
    };
    landmarks.iter().map(sample).collect()
}

/// The model of the template; one of the caller's own may be of another mesh.
pub(super) fn build_model(
    model: &dyn ModelFactory,
    template: &Rest,
    shapes: &ShapeBasis,
    regions: Option<&Regions>,
    schedule: &Schedule,
) -> Result<Box<dyn RegistrationModel>, RegistrationError> {
    let (options, reference_vertices) = (&schedule.model, schedule.reference_vertices);
    let rest = &template.mesh;
    let model = model.build(&ModelInput { rest, shapes, regions, options, reference_vertices, unit: template.unit })?;
    let (found, template) = (model.vertex_count(), rest.positions.len());
    if found == template { Ok(model) } else { Err(RegistrationError::VertexCount { what: "model", found, template }) }
}

/// The parameters to start with: of rest, or of a warm start, within bounds.
pub(super) fn first_parameters(
    problem: &mut RegistrationProblem,
    model: &str,
    warm_start: Option<&WarmStart>,
) -> Result<Vec<f64>, RegistrationError> {
    let mut x = problem.model.rest_parameters();
    if let Some(warm) = warm_start {
        warm.check(model, x.len())?;
        if !warm.parameters.is_empty() {
            x.copy_from_slice(&warm.parameters);
        }
    }
    if let Some(bounds) = problem.border_bounds() {
        bounds.validate(problem.structure().border(), x.len())?;
        bounds.project(&mut x);
    }
    Ok(x)
}

/// The pose of a warm start, moved as its landmarks have.
pub(super) fn warm_pose(warm: &WarmStart, landmarks: &[Landmark], vertices: &[Vec3], centre: Vec3) -> Start {
    let at = |l: &Landmark| (l.template.position(vertices) + centre, l.target, l.weight(1.0));
    let pose = warm.pose_by(&landmarks.iter().map(at).collect::<Vec<_>>());
    Start { pose, search: None, by_landmarks: None }
}

/// A scan, and the start that puts it over the template.
pub(super) struct Placed {
    pub start: Start,
    pub scan: ScanSurface,
    pub facing: ScanFacing,
}

impl Placed {
    /// By landmarks or a search.
    pub fn by_search(
        input: &RegistrationInput<'_>,
        template: &Rest,
        schedule: &Schedule,
        cancel: start::Cancel<'_>,
    ) -> Result<Self, RegistrationError> {
        let (faced, facing) = agreeing(input);
        let start = || start_of(input, &faced, template, schedule, cancel);
        let (start, scan) = rayon::join(start, || surface(&faced, &schedule.scan));
        let (mut start, scan) = (start?, scan?);
        cancel.check()?;
        if let Some(by_landmarks) = &mut start.by_landmarks {
            let [reach, sigma] =
                [start::OFF_SCAN, schedule.sigma.landmark].map(|l| l * template.unit * start.pose.scale);
            let hits = input.landmarks.iter().filter_map(|l| Some((l, scan.closest(&l.target, None, f64::INFINITY)?)));
            let off = hits.map(|(l, hit)| ((hit.point - l.target).norm(), l.sigma.unwrap_or(sigma), hit.on_boundary));
            let off: Vec<(f64, f64, bool)> = off.collect();
            by_landmarks.off_scan = off.iter().filter(|l| l.0 > reach).count() as f64 / input.landmarks.len() as f64;
            let mut above: Vec<f64> = off.iter().filter(|l| !l.2).map(|l| l.0 / l.1).collect();
            let middle = above.len() / 2;
            if !above.is_empty() {
                by_landmarks.above_scan = *above.select_nth_unstable_by(middle, f64::total_cmp).1;
            }
        }
        Ok(Self::new(scan, facing, start, schedule.scan.flip))
    }

    /// By a start that is known.
    pub fn at(start: Start, input: &RegistrationInput<'_>, schedule: &Schedule) -> Result<Self, RegistrationError> {
        let (faced, facing) = agreeing(input);
        Ok(Self::new(surface(&faced, &schedule.scan)?, facing, start, schedule.scan.flip))
    }

    /// The scan, to which that was done already, turned over where the schedule or the search of the start says so.
    fn new(scan: ScanSurface, facing: ScanFacing, start: Start, flip: ScanFlip) -> Self {
        let flipped = match flip {
            ScanFlip::Yes => true,
            ScanFlip::No => false,
            ScanFlip::Auto => start.search.as_ref().is_some_and(|search| search.flipped),
        };
        let scan = if flipped { scan.turned_over() } else { scan };
        Self { start, scan, facing: ScanFacing { flipped, ..facing } }
    }

    /// Turned over besides where nothing has said yet which side is its front, and the template at those vertices sees the inside.
    pub fn facing_outwards(mut self, template: &Rest, vertices: &[Vec3], flip: ScanFlip) -> Self {
        let unsaid = flip == ScanFlip::Auto && self.start.search.is_none();
        if unsaid && template.sees_the_inside(&self.scan.seen_from(&self.start.frame(template.centre)), vertices) {
            self.facing.flipped = true;
            self.scan = self.scan.turned_over();
        }
        self
    }
}

fn surface((scan, normals): &Faced<'_>, options: &ScanOptions) -> Result<ScanSurface, RegistrationError> {
    Ok(ScanSurface::new(scan.clone().into_owned(), normals.as_deref(), options)?)
}

/// The terms, with the landmarks where the start puts them; those that contradict the others count nothing, and all less that scatter.
pub(super) fn build_terms(
    terms: &[&dyn TermFactory],
    landmarks: &[Landmark],
    on_template: &[usize],
    start: &Start,
    template: &Rest,
    schedule: &Schedule,
) -> Result<Vec<Box<dyn RegistrationTerm>>, RegistrationError> {
    let frame = start.frame(template.centre);
    let sigma = schedule.sigma.landmark * template.unit * frame.scale;
    let (suspects, trust) =
        start.by_landmarks.as_ref().map_or((&[][..], 1.0), |start| (&start.suspects, start.trust()));
    let weight = |l: &Landmark| if suspects.iter().any(|s| s.name == l.name) { 0.0 } else { l.weight(sigma) * trust };
    let placed = |(l, &sample): (&Landmark, &usize)| TermLandmark {
        sample,
        rest: l.template.position(&template.mesh.positions),
        target: frame.apply_inverse(l.target),
        weight: weight(l),
    };
    let landmarks: Vec<TermLandmark> = landmarks.iter().zip(on_template).map(placed).collect();
    let none = Options::new();
    let build = |term: &&dyn TermFactory| {
        let options = schedule.terms.get(term.name()).unwrap_or(&none);
        let (rest, unit) = (&template.mesh, template.unit);
        Ok(term.build(&TermInput { options, landmarks: &landmarks, rest, unit, frame })?)
    };
    terms.iter().map(build).collect()
}
