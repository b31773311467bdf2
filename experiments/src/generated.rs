//! Generated data: a rig and the standard cases with their truth on disk, and any scans in memory. All use of `data-gen` is here.

use std::path::Path;

use anyhow::Result;
use data_gen::{
    FaceModel, FaceOptions, FaceRig, Motion, StandardCase, Subject, resolve_shapes, simulate_scan, write_case,
    write_rig,
};
pub use data_gen::{STANDARD_CASES, ScanOptions};
use nonrigid::console::Failure;
use nonrigid::io::Scan;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::rig::{Family, Regions, Rig, Shape, ShapeBasis, ShapeSelection};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use crate::scan_bench::BenchCase;

/// Makes a rig of about `vertices` vertices and the standard cases of these names, scans of about `triangles` triangles, and writes
/// them to `folder`/rig and `folder`/cases, as `data-gen` does.
///
/// # Errors
/// When a file cannot be written.
pub fn write_standard_cases(folder: &Path, vertices: usize, triangles: usize, cases: &[&str], seed: u64) -> Result<()> {
    let rig = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    write_rig(&folder.join("rig"), &rig).map_err(Failure::writing)?;
    let write = |(k, standard): (usize, &StandardCase)| -> Result<()> {
        let options = ScanOptions { expressions: Some(standard.expressions()), triangles, ..ScanOptions::default() };
        let (seed, place) = (seed + k as u64, folder.join("cases").join(standard.name));
        let scan = simulate_scan(&rig, &options, seed)?;
        Ok(write_case(&place, &rig, &scan, &standard.subject(&rig)?, seed).map_err(Failure::writing)?)
    };
    STANDARD_CASES.iter().enumerate().filter(|(_, standard)| cases.contains(&standard.name)).try_for_each(write)
}

/// A generated face, and scans of it in memory: as `data-gen` writes them to files, but for its rounding to 32 bits.
pub struct Studio {
    face: FaceRig,
    rig: Rig,
}

/// What the person of a scan in a [`Studio`] does, how well it is scanned, and what a fit may know.
#[derive(Debug, Clone)]
pub struct Shot {
    /// Name of the case.
    pub name: String,
    /// Person, expression, scanner.
    pub scan: ScanOptions,
    /// Whether a fit knows the person's neutral; otherwise it gets the first forty identity modes.
    pub known: bool,
    /// Expressions that no fit may use; a name without `_L` or `_R` stands for both sides.
    pub withheld: Vec<String>,
    /// Seed of everything random.
    pub seed: u64,
}

impl Studio {
    /// Makes a face of about `vertices` vertices.
    ///
    /// # Errors
    /// When the rig cannot be made.
    pub fn new(vertices: usize) -> Result<Self> {
        let face = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
        let rig = face.to_rig()?;
        Ok(Self { face, rig })
    }

    /// The rig.
    #[must_use]
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The template.
    #[must_use]
    pub fn template(&self) -> &PolygonMesh {
        &self.face.mesh
    }

    /// Vertices of the 68 Multi-PIE/iBUG landmarks.
    #[must_use]
    pub fn landmarks(&self) -> Vec<u32> {
        self.face.landmarks.iter().map(|landmark| landmark.vertex).collect()
    }

    /// Faces of random people with random expressions, one position per template vertex.
    #[must_use]
    pub fn random_faces(&self, count: usize, seed: u64) -> Vec<Vec<Vec3>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut faces = Vec::with_capacity(count);
        for _ in 0..count {
            let mut expressions = vec![0.0; self.face.expressions.len()];
            (0..5).for_each(|_| {
                expressions[rng.random_range(0..self.face.expressions.len())] = rng.random_range(0.2..1.0)
            });
            let identity: Vec<f64> = self.face.identities.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
            faces.push(self.face.pose(&expressions, &identity));
        }
        faces
    }

    /// Standard case `k` with a scan of about `triangles` triangles.
    ///
    /// # Errors
    /// When there are too few triangles for a scan.
    pub fn standard(&self, k: usize, triangles: usize, seed: u64) -> Result<BenchCase> {
        let standard = &STANDARD_CASES[k];
        let withheld = match standard.subject(&self.face)? {
            Subject::Same { withheld } => withheld,
            Subject::New { .. } => Vec::new(),
        };
        self.shoot(&Shot {
            name: standard.name.to_owned(),
            scan: ScanOptions { expressions: Some(standard.expressions()), triangles, ..ScanOptions::default() },
            known: standard.withheld.is_some(),
            withheld,
            seed: seed + k as u64,
        })
    }

    /// A sequence of so many frames, so many a second: an unknown person of this seed, moving smoothly, each frame scanned with noise and
    /// landmarks of its own.
    ///
    /// # Errors
    /// When there are too few triangles for a scan.
    pub fn sequence(&self, frames: usize, fps: f64, triangles: usize, seed: u64) -> Result<Vec<BenchCase>> {
        let options = ScanOptions { triangles, ..ScanOptions::default() };
        let motion = Motion::new(&self.face, &options, frames as f64 / fps, seed)?;
        let frame = |k: usize| Shot {
            name: format!("frame_{k:04}"),
            scan: motion.options(k as f64 / fps),
            known: false,
            withheld: Vec::new(),
            seed: seed + k as u64,
        };
        (0..frames).map(|k| self.shoot(&frame(k))).collect()
    }

    /// Scans a face.
    ///
    /// # Errors
    /// When the scan's options make no sense, or the cameras see next to nothing.
    pub fn shoot(&self, shot: &Shot) -> Result<BenchCase> {
        let scan = simulate_scan(&self.face, &shot.scan, shot.seed)?;
        let modes = if shot.known { 0 } else { self.face.identities.len() * 2 / 5 };
        let all: Vec<&str> = self.face.expressions.iter().map(|e| &*e.0).collect();
        let withheld: Vec<Vec<&str>> =
            shot.withheld.iter().map(|w| resolve_shapes(&all, w)).collect::<Result<_, _>>()?;
        let offered = all.iter().filter(|name| !withheld.iter().flatten().any(|w| w == *name));
        let names: Vec<String> = offered.map(|name| (*name).to_owned()).collect();
        Ok(BenchCase {
            name: shot.name.clone(),
            template: self.face.mesh.clone(),
            neutral: shot.known.then(|| self.face.pose(&[], &scan.identity_weights)),
            shapes: self.rig.select(ShapeSelection { names: Some(&names), identity_modes: modes })?,
            landmarks: scan.landmark_pairs(),
            regions: Regions::new(self.face.neutral.len(), self.face.regions.clone())?,
            rig_landmarks: self.face.landmarks.iter().map(|l| l.vertex).collect(),
            scan: Scan { mesh: scan.scan, normals: None, colors: None },
            truth: scan.truth,
            observed: scan.observed,
        })
    }
}

/// The standard cases on a template of about `vertices` vertices, scans of about `triangles` triangles.
///
/// # Errors
/// When `triangles` is too few for a scan.
pub fn standard_cases(vertices: usize, triangles: usize, seed: u64) -> Result<Vec<BenchCase>> {
    let studio = Studio::new(vertices)?;
    (0..STANDARD_CASES.len()).map(|k| studio.standard(k, triangles, seed)).collect()
}

/// The first of [`standard_cases`] alone.
///
/// # Errors
/// When `triangles` is too few for a scan.
pub fn first_standard_case(vertices: usize, triangles: usize, seed: u64) -> Result<BenchCase> {
    Studio::new(vertices)?.standard(0, triangles, seed)
}

/// A face as the solver sees it: a triangle mesh at rest, its first shapes (expressions, then identity modes), and a goal.
pub struct Face {
    /// The template.
    pub mesh: TriangleMesh,
    /// The shapes.
    pub shapes: ShapeBasis,
    /// Where each vertex should go: three expressions, and a smooth displacement of up to `bump` that no shape is.
    pub goal: Vec<Vec3>,
}

/// How many shapes there are: [`face`] offers the expressions first.
#[must_use]
pub fn shapes_at_most() -> usize {
    let all = FaceModel::new(usize::MAX);
    all.expression_names().len() + all.identity_modes()
}

/// Displaces points smoothly, by up to `bump` along each axis.
pub fn bend(points: &mut [Vec3], bump: f64, rng: &mut ChaCha8Rng) {
    let [frequency, direction] = [0.05, 1.0].map(|s| Vec3::from_fn(|_, _| rng.random_range(-s..s)));
    points.iter_mut().for_each(|p| *p += direction * (bump * frequency.dot(p).sin()));
}

/// Makes a face of about `vertices` vertices (1,000 to 500,000) with `shapes` shapes and a goal drawn from `seed`.
#[must_use]
pub fn face(vertices: usize, shapes: usize, bump: f64, seed: u64) -> Face {
    let expressions = FaceModel::new(0).expression_names().len();
    let face = FaceRig::generate(&FaceOptions { vertices, identity_modes: shapes.saturating_sub(expressions) });
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut weights = vec![0.0; expressions];
    (0..3).for_each(|_| weights[rng.random_range(0..expressions)] = rng.random_range(0.3..0.8));
    let mut goal = face.pose(&weights, &[]);
    bend(&mut goal, bump, &mut rng);

    let named = face.expressions.iter().map(|(name, d)| (name.clone(), Family::Expression, d));
    let modes = face.identities.iter().enumerate().map(|(k, d)| (format!("identity{k:03}"), Family::Identity, d));
    let chosen: Vec<_> = named.chain(modes).take(shapes).collect();
    let mut slab = vec![0.0; 3 * goal.len() * chosen.len()];
    for (k, (.., deltas)) in chosen.iter().enumerate() {
        for (i, delta) in deltas.iter().enumerate() {
            for a in 0..3 {
                slab[(3 * i + a) * chosen.len() + k] = delta[a] as f32;
            }
        }
    }
    let names = chosen.into_iter().map(|(name, family, _)| Shape { name, family }).collect();
    Face { mesh: face.mesh.triangulate(), shapes: ShapeBasis::new(names, slab), goal }
}
