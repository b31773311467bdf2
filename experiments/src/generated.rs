//! Generated data: a rig and one scan with its truth on disk, as a first run needs it; the standard cases in memory. All use of
//! `data-gen` is here.

use std::path::{Path, PathBuf};

use anyhow::Result;
use data_gen::{
    FaceModel, FaceOptions, FaceRig, STANDARD_CASES, ScanOptions, Subject, simulate_scan, write_case, write_rig,
};
use nonrigid::cli::Failure;
use nonrigid::mesh::io::{Landmark, Scan, TemplatePoint};
use nonrigid::mesh::{Pose, TriangleMesh, Vec3};
use nonrigid::rig::{Family, Rig, Shape, ShapeBasis, ShapeSelection};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::scan_bench::BenchCase;

/// Where the data is, and what the files do not say.
pub struct Generated {
    /// Rig folder.
    pub rig: PathBuf,
    /// Folder of the one case.
    pub case: PathBuf,
    /// From the rig's coordinates to the scan's: pictures are taken in the rig's.
    pub pose: Pose,
    /// Template vertices of the mouth's landmarks.
    pub mouth: Vec<u32>,
    /// Number of the rig's identity modes.
    pub identity_modes: usize,
}

/// Makes a rig of about `vertices` vertices and the first standard case, a mouth wide open under raised brows of a person whose
/// neutral is known, and writes them to `folder`/rig and `folder`/cases/same_open.
///
/// # Errors
/// When a file cannot be written.
pub fn extreme_mouth(folder: &Path, vertices: usize, seed: u64) -> Result<Generated> {
    let rig = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    let [standard, ..] = STANDARD_CASES;
    let options = ScanOptions { expressions: Some(standard.expressions()), ..ScanOptions::default() };
    let scan = simulate_scan(&rig, &options, seed)?;

    let (rig_folder, case_folder) = (folder.join("rig"), folder.join("cases").join(standard.name));
    let unwritten = |e: anyhow::Error| Failure::writing(format!("{e:#}"));
    write_rig(&rig_folder, &rig).map_err(unwritten)?;
    write_case(&case_folder, &rig, &scan, &standard.subject(&rig)?, seed).map_err(unwritten)?;
    let mouth = rig.landmarks.iter().skip(48).map(|l| l.vertex).collect(); // 48 to 67 of the 68 are the mouth
    Ok(Generated { rig: rig_folder, case: case_folder, pose: scan.pose, mouth, identity_modes: rig.identities.len() })
}

/// The standard cases on a template of about `vertices` vertices, scans of about `triangles` triangles; as `data-gen` writes them
/// to files, but for its rounding to 32 bits.
///
/// # Errors
/// When `triangles` is too few for a scan.
pub fn standard_cases(vertices: usize, triangles: usize, seed: u64) -> Result<Vec<BenchCase>> {
    let face = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    let rig = rig_of(&face)?;
    (0..STANDARD_CASES.len()).map(|k| case_of(&face, &rig, k, triangles, seed)).collect()
}

/// The first of [`standard_cases`] alone.
///
/// # Errors
/// When `triangles` is too few for a scan.
pub fn first_standard_case(vertices: usize, triangles: usize, seed: u64) -> Result<BenchCase> {
    let face = FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    case_of(&face, &rig_of(&face)?, 0, triangles, seed)
}

fn rig_of(face: &FaceRig) -> Result<Rig> {
    let expressions = face.expressions.iter().map(|(name, d)| (name.clone(), Family::Expression, d));
    let identities = face.identities.iter().enumerate().map(|(k, d)| (format!("identity{k:03}"), Family::Identity, d));
    let (mut shapes, mut deltas) = (Vec::new(), Vec::new());
    for (name, family, delta) in expressions.chain(identities) {
        shapes.push(Shape { name, family });
        deltas.extend(delta.iter().flat_map(|d| [d.x as f32, d.y as f32, d.z as f32]));
    }
    Ok(Rig::new(face.neutral.clone(), Some(face.mesh.clone()), shapes, deltas)?.0)
}

/// Standard case `k`.
fn case_of(face: &FaceRig, rig: &Rig, k: usize, triangles: usize, seed: u64) -> Result<BenchCase> {
    let standard = &STANDARD_CASES[k];
    let options = ScanOptions { expressions: Some(standard.expressions()), triangles, ..ScanOptions::default() };
    let scan = simulate_scan(face, &options, seed + k as u64)?;
    let (withheld, identity_modes) = match standard.subject(face)? {
        Subject::Same { withheld } => (withheld, 0),
        Subject::New { identity_modes } => (Vec::new(), identity_modes),
    };
    let offered = rig.shapes().iter().filter(|s| s.family == Family::Expression).map(|s| s.name.clone());
    let names: Vec<String> = offered.filter(|name| !withheld.contains(name)).collect();
    let landmark = |&(vertex, target): &(u32, _)| Landmark {
        name: vertex.to_string(),
        template: TemplatePoint::Vertex(vertex),
        target,
    };
    Ok(BenchCase {
        name: standard.name.to_owned(),
        template: face.mesh.clone(),
        neutral: standard.withheld.map(|_| face.pose(&[], &scan.identity_weights)),
        shapes: rig.select(ShapeSelection { names: Some(&names), identity_modes })?,
        landmarks: scan.landmarks.iter().map(landmark).collect(),
        scan: Scan { mesh: scan.scan, normals: None, colors: None },
        truth: scan.truth,
        observed: scan.observed,
    })
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

/// Makes a face of about `vertices` vertices (1,000 to 500,000) with `shapes` shapes and a goal drawn from `seed`.
#[must_use]
pub fn face(vertices: usize, shapes: usize, bump: f64, seed: u64) -> Face {
    let expressions = FaceModel::new(0).expression_names().len();
    let face = FaceRig::generate(&FaceOptions { vertices, identity_modes: shapes.saturating_sub(expressions) });
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut weights = vec![0.0; expressions];
    (0..3).for_each(|_| weights[rng.random_range(0..expressions)] = rng.random_range(0.3..0.8));
    let [frequency, direction] = [0.05, 1.0].map(|s| Vec3::from_fn(|_, _| rng.random_range(-s..s)));
    let mut goal = face.pose(&weights, &[]);
    goal.iter_mut().for_each(|p| *p += direction * (bump * frequency.dot(p).sin()));

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
