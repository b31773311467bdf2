//! A scan of a face: what a structured-light scanner would deliver, with the truth that it would not.

pub(crate) mod arguments;
mod curved;
mod deformation;
mod depth;
mod detail;
mod domain;
mod faults;
mod fusion;
mod manner;
mod net;
mod options;
mod person;
mod surface;
#[cfg(test)]
mod tests;
mod view;

use std::fmt;

use nonrigid::landmark::Landmark;
use nonrigid::mesh::normals::{NormalWeighting::Area, vertex_normals};
use nonrigid::mesh::{Pose, TriangleMesh, Vec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::{FaceRig, FaceWeights, Flat};
use depth::DepthImage;
use detail::Detail;
use faults::Hole;
use manner::Manner;
use surface::{Shell, Surface};
use view::{Occluder, View};

pub use deformation::Bend;
pub use options::{Camera, ScanOptions, Scanner, WrinkleMix};
pub use person::{PRESETS, resolve_shapes};
pub(crate) use person::{random_weights, weights_by_name};

/// Why there is no scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScanError {
    /// An option that makes no sense.
    Option(String),
    /// The cameras see less than a fiftieth of the face.
    NothingSeen,
}

impl fmt::Display for ScanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Option(what) => f.write_str(what),
            Self::NothingSeen => f.write_str("the cameras see next to nothing of the face"),
        }
    }
}

impl std::error::Error for ScanError {}

/// A simulated scan and everything that is known about it.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanCase {
    /// What the scanner delivers.
    pub scan: TriangleMesh,
    /// Where each template vertex truly is, in scan coordinates, detail included.
    pub truth: Vec<Vec3>,
    /// Whether the scan shows the surface all round the vertex.
    pub observed: Vec<bool>,
    /// Template vertex and noisy position in the scan, for the landmarks whose vertex is observed.
    pub landmarks: Vec<(u32, Vec3)>,
    /// Weight of each of the rig's expressions.
    pub expression_weights: Vec<f64>,
    /// Weight of each of the rig's identity modes.
    pub identity_weights: Vec<f64>,
    /// Standard deviation that these were drawn with; `None`: they were given.
    pub identity_sigma: Option<f64>,
    /// From the rig's coordinates to the scan's.
    pub pose: Pose,
}

impl ScanCase {
    /// The landmarks as a registration takes them, named after their vertices.
    #[must_use]
    pub fn landmark_pairs(&self) -> Vec<Landmark> {
        self.landmarks.iter().map(|&(vertex, target)| Landmark::new(vertex.to_string(), vertex, target)).collect()
    }
}

/// Points of the trial scan, which tells what is visible and how many points the scan needs.
const TRIAL: usize = 40_000;

/// Least share of the surface that is worth a scan.
const LEAST_SEEN: f64 = 0.02;
/// Points of a scan at most, before what is not seen is dropped: a small part of a face at millions of triangles would be
/// more than memory holds.
const MOST_POINTS: f64 = 2e7;

/// What is drawn from a random stream of its own, so that one option does not change what the others draw.
#[derive(Clone, Copy)]
enum Stream {
    Expression = 1,
    Identity,
    Pose,
    Trial,
    Detail,
    Holes,
    Noise,
    Spikes,
    LooseParts,
    Outliers,
    Order,
    Landmarks,
    Points,
    Manner,
    Edges,
    Camera,
    Field,
    Bends,
    Cut,
}

impl Stream {
    fn of(self, seed: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(self as u64);
        rng
    }
}

/// Scans `rig`. Everything random comes from `seed`; equal arguments give equal bits, with any number of threads.
///
/// # Errors
/// When an option makes no sense or names an expression that the rig does not have, or the cameras see next to nothing.
pub fn simulate_scan(rig: &FaceRig, options: &ScanOptions, seed: u64) -> Result<ScanCase, ScanError> {
    options.validate(rig)?;
    let expression_weights = match &options.expressions {
        Some(wanted) => weights_by_name(rig, wanted)?,
        None => random_weights(rig.expressions.len(), 0.4, &mut Stream::Expression.of(seed)),
    };
    let identity_weights = person::identity_weights(rig, options, &mut Stream::Identity.of(seed));
    let pose = options.pose.unwrap_or_else(|| person::random_pose(options, &mut Stream::Pose.of(seed)));
    let shared_seed = options.shared_seed.unwrap_or(seed);
    let Some(model) = &rig.model else {
        let solid = curved::person(rig, options, [&expression_weights, &identity_weights], pose, shared_seed)?;
        let (mesh, observed) = measured(&solid, options, seed)?;
        return Ok(finished(
            rig,
            options,
            mesh,
            (solid.truth, observed),
            [expression_weights, identity_weights],
            pose,
            seed,
        ));
    };
    let detail = Detail::new(options.detail, options.wrinkles, &mut Stream::Detail.of(shared_seed));
    let manner = Manner::new(options.manner, &mut Stream::Manner.of(shared_seed));
    let weights = FaceWeights { expressions: expression_weights.clone(), identity: identity_weights.clone() };
    let contains = |place: Flat| model.contains(place);
    let surface = Surface::new(model, &contains, weights, pose, manner, detail, options.eyeballs);
    let (mesh, truth, observed) = if options.scanner == Scanner::Net {
        sampled(rig, &surface, options, seed)?
    } else {
        let Shell { positions, triangles, skin_points, .. } = surface.sample(SOLID, &mut Stream::Points.of(seed));
        let solid = Solid { positions, triangles, skin_points, truth: surface.skin(&rig.places) };
        let (mesh, observed) = measured(&solid, options, seed)?;
        (mesh, solid.truth, observed)
    };
    Ok(finished(rig, options, mesh, (truth, observed), [expression_weights, identity_weights], pose, seed))
}

/// What is before the cameras: a fine mesh, the skin's points first, and where the template's vertices truly are.
struct Solid {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    skin_points: usize,
    truth: Vec<Vec3>,
}

/// Points of a generated face before depth cameras: about half a millimetre apart.
const SOLID: usize = 300_000;
/// Pixels of depth images that are fused, millimetres on a face, at most.
const PITCH: f64 = 0.7;
/// Pixels and voxels of the trial, which tells how fine a scan of so many triangles has to be, millimetres on a face.
const COARSE: f64 = 2.0;
/// Share of the triangles by which a scan may miss their number before it is made again, and how often it is.
const MISSED: f64 = 0.03;
const AGAIN: usize = 3;

/// The mesh that depth cameras make of a solid, and which of the template's vertices it shows.
fn measured(solid: &Solid, options: &ScanOptions, seed: u64) -> Result<(TriangleMesh, Vec<bool>), ScanError> {
    let Solid { positions, triangles, skin_points, truth } = solid;
    let occluder = Occluder { positions, triangles, skin_points: *skin_points };
    let centre = positions.iter().sum::<Vec3>() / positions.len().max(1) as f64;
    let scale = (curved::extent(positions) / curved::FACE).max(1e-6);
    let cameras =
        options.scanner.cameras(&options.cameras, scale, &mut Stream::Camera.of(options.shared_seed.unwrap_or(seed)));
    let eyes: Vec<Vec3> = cameras.iter().map(|c| c.position(centre)).collect();
    let fused = options.scanner == Scanner::Fused;
    let images = |fineness: f64| -> Vec<DepthImage> {
        let pitch = if fused { fineness.min(PITCH * scale) } else { fineness };
        let mut images: Vec<DepthImage> =
            eyes.par_iter().filter_map(|eye| DepthImage::new(*eye, occluder, pitch, options.grazing)).collect();
        let visible: Vec<Vec3> = images.iter().flat_map(DepthImage::points).collect();
        let holes = Hole::all(&visible, options, seed);
        let mut rngs = [Stream::Edges, Stream::Noise, Stream::Spikes].map(|stream| stream.of(seed));
        let [edges, noise, spikes] = &mut rngs;
        for image in &mut images {
            image.spoil(options, &holes, [edges, noise, spikes]);
        }
        images
    };
    let mesh = |images: &[DepthImage], fineness: f64| match images {
        [only] if !fused => only.mesh(),
        _ => fusion::fuse(images, fineness),
    };
    // Triangles grow with the inverse square of pixel or voxel.
    let wanted = options.triangles as f64 * (1.0 - options.outliers);
    let mut fineness = COARSE * scale;
    let mut made = images(fineness);
    let mut scan = mesh(&made, fineness);
    for _ in 0..AGAIN {
        let share = scan.triangles.len() as f64 / wanted;
        if scan.triangles.len() < 50 {
            return Err(ScanError::NothingSeen);
        }
        if (share - 1.0).abs() < MISSED {
            break;
        }
        fineness *= share.sqrt();
        made = images(fineness);
        scan = mesh(&made, fineness);
    }
    let observed = truth.par_iter().map(|p| made.iter().any(|image| image.shows(p))).collect();
    Ok((scan, observed))
}

/// What every scanner adds: things that float about, and an order that says nothing.
fn finished(
    rig: &FaceRig,
    options: &ScanOptions,
    mut mesh: TriangleMesh,
    (truth, observed): (Vec<Vec3>, Vec<bool>),
    [expression_weights, identity_weights]: [Vec<f64>; 2],
    pose: Pose,
    seed: u64,
) -> ScanCase {
    let (edge, centre) = (mean_edge(&mesh), truth.iter().sum::<Vec3>() / truth.len().max(1) as f64);
    let outliers = (options.outliers * options.triangles as f64) as usize;
    faults::add_outliers(&mut mesh, edge, outliers, &mut Stream::Outliers.of(seed));
    faults::add_loose_parts(&mut mesh, centre, edge, options.loose_parts, &mut Stream::LooseParts.of(seed));
    let scan = faults::shuffled(&mesh, &mut Stream::Order.of(seed));
    let landmarks = landmarks(rig, &truth, &observed, options, &mut Stream::Landmarks.of(seed));
    let identity_sigma = options.identity.is_none().then_some(options.identity_sigma);
    ScanCase { scan, truth, observed, landmarks, expression_weights, identity_weights, identity_sigma, pose }
}

/// The scanner `net`: irregular points on the formula's surface, of which cameras see some.
fn sampled(
    rig: &FaceRig,
    surface: &Surface<'_>,
    options: &ScanOptions,
    seed: u64,
) -> Result<(TriangleMesh, Vec<Vec3>, Vec<bool>), ScanError> {
    let trial = surface.sample(TRIAL, &mut Stream::Trial.of(seed));
    let centre = trial.positions.iter().sum::<Vec3>() / trial.positions.len().max(1) as f64;
    let eyes: Vec<Vec3> = options.cameras.iter().map(|c| c.position(centre)).collect();
    let Shell { positions, triangles, skin_points, .. } = &trial;
    let view = View::new(&eyes, Occluder { positions, triangles, skin_points: *skin_points }, options.grazing);
    let seen = Seen::new(&trial, &view, &[]);
    let visible: Vec<Vec3> =
        trial.positions.iter().zip(&seen.kept).filter(|(_, kept)| **kept).map(|(p, _)| *p).collect();
    let holes = Hole::all(&visible, options, seed);
    let seen = seen.without(&trial, &holes);
    let outliers = (options.outliers * options.triangles as f64) as usize;
    let points = seen.points_for(&trial, options.triangles - outliers).ok_or(ScanError::NothingSeen)?;
    drop((trial, seen));

    let mut shell = surface.sample(points, &mut Stream::Points.of(seed));
    let seen = Seen::new(&shell, &view, &holes);
    let truth = surface.skin(&rig.places);
    let observed = shell.skin.shown(&rig.places, &seen.kept);

    let mut mesh = TriangleMesh { positions: std::mem::take(&mut shell.positions), triangles: seen.whole(&shell) };
    drop(shell);
    if mesh.triangles.is_empty() {
        return Err(ScanError::NothingSeen);
    }
    faults::measure(
        &mut mesh.positions,
        &seen.rays,
        options,
        [&mut Stream::Noise.of(seed), &mut Stream::Spikes.of(seed)],
    );
    Ok((mesh, truth, observed))
}

/// Which points of a sampled surface the scanner measures, and along which rays.
struct Seen {
    rays: Vec<Option<(f64, Vec3)>>,
    kept: Vec<bool>,
}

impl Seen {
    fn new(shell: &Shell, view: &View, holes: &[Hole]) -> Self {
        let normals = vertex_normals(&shell.positions, &shell.triangles, Area);
        let rays = view.seen(&shell.positions, &normals, shell.skin_points);
        let kept = rays.iter().map(Option::is_some).collect();
        Self { rays, kept }.without(shell, holes)
    }

    fn without(mut self, shell: &Shell, holes: &[Hole]) -> Self {
        self.kept.par_iter_mut().zip(&shell.positions).for_each(|(kept, p)| *kept &= !holes.iter().any(|h| h.holds(p)));
        self
    }

    /// Triangles all of whose corners are kept.
    fn whole(&self, shell: &Shell) -> Vec<[u32; 3]> {
        shell.triangles.iter().copied().filter(|t| t.iter().all(|v| self.kept[*v as usize])).collect()
    }

    /// How many points a surface needs, of which these are some, for a number of `triangles` to be left.
    ///
    /// N points, a share s of them seen, are 2 s N triangles, less those along the borders, which number c sqrt(N).
    fn points_for(&self, shell: &Shell, triangles: usize) -> Option<usize> {
        let all = self.kept.len() as f64;
        let twice_kept = 2.0 * self.kept.iter().filter(|k| **k).count() as f64;
        let whole = self.whole(shell).len() as f64;
        if twice_kept < 2.0 * LEAST_SEEN * all || whole == 0.0 {
            return None;
        }
        let (a, b) = (twice_kept / all, (twice_kept - whole) / all.sqrt());
        let root = (b + (b * b + 4.0 * a * triangles as f64).sqrt()) / (2.0 * a);
        Some((root * root).min(MOST_POINTS) as usize)
    }
}

fn mean_edge(mesh: &TriangleMesh) -> f64 {
    let length = |t: &[u32; 3]| (mesh.positions[t[0] as usize] - mesh.positions[t[1] as usize]).norm();
    mesh.triangles.iter().map(length).sum::<f64>() / mesh.triangles.len().max(1) as f64
}

fn landmarks(
    rig: &FaceRig,
    truth: &[Vec3],
    observed: &[bool],
    options: &ScanOptions,
    rng: &mut ChaCha8Rng,
) -> Vec<(u32, Vec3)> {
    use rand_distr::{Distribution, StandardNormal};
    let mut found = Vec::new();
    for landmark in &rig.landmarks {
        let noise = Vec3::from_fn(|_, _| StandardNormal.sample(rng));
        let v = landmark.vertex as usize;
        if observed[v] {
            found.push((landmark.vertex, truth[v] + noise * options.landmark_noise));
        }
    }
    found
}
