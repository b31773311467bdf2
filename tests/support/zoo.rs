//! Every deformation model, data term and kernel on a random template: what laws are held against.
#![allow(dead_code)] // every test binary uses its own part of this

use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, SampleResidual, Samples};
use nonrigid::mesh::{TriangleMesh, Vec3};
use nonrigid::model::{
    Affine, AngleAxisMotion, Arap, ArapOptions, ArapSolver, Autodiff, EdgeWeights, Fem, Ffd, Frames, Free, FreeOptions,
    Guidance, Hybrid, Laplacian, LaplacianOptions, LatticeOptions, Linearisation, MassSpring, NodeGraph, NodeTransform,
    Poisson, PoissonOptions, PositionFunction, QuaternionMotion, Smoothness, SpringOptions, Stiffness, TissueOptions,
};
use nonrigid::model::{AffineMotion, blendshape, blendshape_in_place, graph, rigid, similarity, sumner};
use nonrigid::nlls::{Euclidean, Kernel, RobustKernel, Scalar};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::{Landmarks, PointToPlane, PointToPoint, ScanToTemplate, Symmetric};
use num_dual::DualSVec64;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::reference::{self, Reference, Rigidity};
use super::stated_graph::stated_graph;

pub fn random_vec(rng: &mut ChaCha8Rng, size: f64) -> Vec3 {
    Vec3::from_fn(|_, _| rng.random_range(-size..size))
}

pub fn random_step(rng: &mut ChaCha8Rng, dimension: usize) -> Vec<f64> {
    (0..dimension).map(|_| rng.random_range(-0.3..0.3)).collect()
}

/// A template with a graph and shapes. The last six vertices belong to no triangle; some vertices are held by the models that
/// can, away from where they rest.
pub struct Zoo {
    pub mesh: TriangleMesh,
    pub nodes: NodeGraph,
    pub basis: ShapeBasis,
    pub stiffness: Stiffness,
    pub held: Vec<bool>,
    pub places: Vec<Vec3>,
}

const LOOSE: usize = 6;

impl Zoo {
    /// 60 vertices anywhere in a cube, 9 nodes, and more shapes than a stride of the reference linearisation has duals.
    pub fn small() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let (columns, rows, nodes) = (9, 6, 9);
        let count = columns * rows + LOOSE;
        let positions: Vec<Vec3> = (0..count).map(|_| random_vec(&mut rng, 50.0)).collect();
        let centres = (0..nodes).map(|j| positions[j * 5]).collect();
        let influences: Vec<Vec<(u32, f64)>> = (0..count)
            .map(|i| {
                let raw: Vec<f64> = (0..1 + i % 4).map(|_| rng.random_range(0.1..1.0)).collect();
                let sum: f64 = raw.iter().sum();
                raw.iter().enumerate().map(|(k, w)| (((i * 3 + k * 2) % nodes) as u32, w / sum)).collect()
            })
            .collect();
        let mesh = TriangleMesh { positions, triangles: triangles(columns, rows) };
        Self::on(mesh, NodeGraph::from_influences(centres, influences), 21, rng)
    }

    /// A wavy sheet with several chunks of 512 samples, tens of nodes, and more shapes than the 56 columns of the border that
    /// one task of the bordered solver takes.
    pub fn large() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(13);
        let (columns, rows) = (60, 52);
        let place = |i: usize| {
            let (c, r) = ((i % columns) as f64, (i / columns) as f64);
            Vec3::new(3.0 * c, 3.0 * r, 9.0 * (0.2 * c).sin() * (0.13 * r).cos())
        };
        let positions = (0..columns * rows + LOOSE).map(|i| place(i) + random_vec(&mut rng, 0.6)).collect();
        let mesh = TriangleMesh { positions, triangles: triangles(columns, rows) };
        let nodes = NodeGraph::along_surface(&mesh, 60, 4).expect("a finite mesh");
        Self::on(mesh, nodes, 70, rng)
    }

    fn on(mesh: TriangleMesh, nodes: NodeGraph, shapes: usize, mut rng: ChaCha8Rng) -> Self {
        let names = (0..shapes).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
        let slab = (0..3 * mesh.positions.len() * shapes).map(|_| rng.random_range(-4.0..4.0)).collect();
        let basis = ShapeBasis::new(names, slab).with_sigmas(|shape| 0.5 + shape.name.len() as f64 / 10.0);
        let stiffness = Stiffness { graph: 0.7, rotation: 0.4, blend: 0.3, ..Stiffness::default() };
        let held = (0..mesh.positions.len()).map(|i| i % 11 == 4).collect();
        let places = mesh.positions.iter().map(|&p| p + random_vec(&mut rng, 2.0)).collect();
        Self { mesh, nodes, basis, stiffness, held, places }
    }

    pub fn vertex_count(&self) -> usize {
        self.mesh.positions.len()
    }

    /// All vertices, and points inside faces.
    pub fn samples(&self) -> Samples {
        let mut samples = Samples::vertices(self.vertex_count());
        for k in 0..3 {
            samples.push(&[(k, 0.2), (k + 7, 0.5), (k + 20, 0.3)]).expect("a convex combination");
        }
        samples.push(&[(2, 0.4), (3, 0.6)]).expect("a convex combination");
        samples
    }

    /// Where the samples rest.
    pub fn resting(&self) -> Vec<Vec3> {
        let mut positions = Vec::new();
        self.samples().positions(&self.mesh.positions, &mut positions);
        positions
    }

    /// Every model.
    pub fn models(&self) -> Vec<Specimen> {
        let mut all = self.assembled();
        let (mesh, rest) = (&self.mesh, &self.mesh.positions);
        for kind in [Smoothness::Laplacian, Smoothness::BiLaplacian] {
            for weights in [EdgeWeights::Uniform, EdgeWeights::Cotangent] {
                let options = FreeOptions { kind, weights, reference_vertices: 100.0 };
                let build = || {
                    let model = Free::new(mesh, options, 0.7).expect("a sound mesh");
                    model.with_held_at(&self.held, &self.places)
                };
                all.push(Specimen::new(format!("free, {kind:?}, {weights:?}"), build(), reference::quadratic(build())));
            }
        }
        all.push(Specimen::new("affine", self.affine(), reference::quadratic(self.affine())));
        for solver in [ArapSolver::LocalGlobal, ArapSolver::Joint] {
            for clamp in [true, false] {
                let options = ArapOptions { solver, clamp };
                let model = Arap::new(mesh, options, 0.7).expect("a sound mesh");
                let model = model.with_held_at(&self.held, &self.places);
                let stated = Rigidity::stars(mesh, options, 0.7, &self.held, &self.places);
                let name = format!("arap, {solver:?}, {}", if clamp { "clamped" } else { "as it comes" });
                all.push(Specimen::new(name, model, move |x| stated.reference(x)));
            }
            let options = PoissonOptions { guidance: Guidance::Turned, solver };
            let model = Poisson::new(mesh, options, 0.7).expect("a sound mesh").with_held_at(&self.held, &self.places);
            let stated = Rigidity::patches(mesh, solver, 0.7, &self.held, &self.places);
            all.push(Specimen::new(format!("poisson, {solver:?}"), model, move |x| stated.reference(x)));
        }
        let standing = || {
            let options = PoissonOptions { guidance: Guidance::Rest, ..PoissonOptions::default() };
            Poisson::new(mesh, options, 0.7).expect("a sound mesh").with_held_at(&self.held, &self.places)
        };
        all.push(Specimen::new("poisson, guidance at rest", standing(), reference::quadratic(standing())));
        for weights in [EdgeWeights::Uniform, EdgeWeights::Cotangent] {
            let options = LaplacianOptions { weights, frames: Frames::Rest };
            let build = || {
                let model = Laplacian::new(mesh, options, 100.0, 0.7).expect("a sound mesh");
                model.with_held_at(&self.held, &self.places)
            };
            all.push(Specimen::new(format!("laplacian, {weights:?}"), build(), reference::quadratic(build())));
        }
        let skin = &self.skin();
        let springs = || MassSpring::new(skin, SpringOptions { thickness: 4.0 }, 0.7).expect("a sound mesh");
        all.push(Specimen::new("springs", springs(), reference::formula(springs())));
        let tissue = TissueOptions { thickness: 4.0, poisson: 0.4, anchor: 0.1, ..TissueOptions::default() };
        let stated = reference::formula(reference::Tissue::new(skin, tissue.clone(), 0.7));
        all.push(Specimen::new("tissue", Fem::new(skin, tissue, 0.7).expect("a sound mesh"), stated));
        let lattice = || Ffd::new(mesh, LatticeOptions { spacing: 60.0 }, 100.0, 0.7).expect("a sound mesh");
        all.push(Specimen::new("lattice", lattice(), reference::quadratic(lattice())));
        let stated = || stated_graph(rest, &self.nodes, 0.7);
        all.push(Specimen::new("stated graph", stated(), reference::formula(stated())));
        let swirl = || Autodiff::new(Swirl { rest: rest.clone() }).expect("a sound formula");
        all.push(Specimen::new("swirl", swirl(), reference::formula(swirl())));
        all
    }

    /// The models on the assembly of blendshapes inside a graph.
    pub fn assembled(&self) -> Vec<Specimen> {
        let (rest, nodes, basis) = (&self.mesh.positions, &self.nodes, &self.basis);
        let single = NodeGraph::single(Vec3::new(3.0, -2.0, 1.0), rest.len());
        let held: Vec<bool> = (0..rest.len()).map(|i| 3 * i > 2 * rest.len()).collect();
        let region = NodeGraph::on_region(&self.mesh, &held, nodes.nodes().len()).expect("a finite mesh");
        vec![
            Specimen::assembled("hybrid", || Hybrid::new(rest.clone(), nodes.clone(), basis.clone(), self.stiffness)),
            Specimen::assembled("hybrid by quaternions", || {
                Hybrid::<QuaternionMotion, 6>::with_motion(rest.clone(), nodes.clone(), basis.clone(), self.stiffness)
            }),
            Specimen::assembled("hybrid by rotation vectors", || {
                Hybrid::<AngleAxisMotion, 6>::with_motion(rest.clone(), nodes.clone(), basis.clone(), self.stiffness)
            }),
            Specimen::assembled("graph", || graph(rest.clone(), nodes.clone(), 0.7)),
            Specimen::assembled("blendshape", || blendshape(rest.clone(), basis.clone(), 0.3)),
            Specimen::assembled("rigid", || rigid(rest.clone())),
            Specimen::assembled("similarity", || similarity(rest.clone())),
            Specimen::assembled("affine hybrid", || {
                Hybrid::<AffineMotion, 12>::with_motion(rest.clone(), nodes.clone(), basis.clone(), self.stiffness)
            }),
            Specimen::assembled("sumner", || sumner(rest.clone(), nodes.clone(), 0.7, 0.4)),
            Specimen::assembled("hybrid in a region", || {
                Hybrid::new(rest.clone(), region.clone(), basis.clone(), self.stiffness)
            }),
            Specimen::assembled("sumner in a region", || sumner(rest.clone(), region.clone(), 0.7, 0.4)),
            Specimen::assembled("blendshape in place", || blendshape_in_place(rest.clone(), basis.clone(), 0.3)),
            Specimen::assembled("sumner, one node", || sumner(rest.clone(), single.clone(), 0.7, 0.4)),
        ]
    }

    /// A body has an inside. The small template, triangles anywhere in a cube, has none: a wavy sheet instead.
    fn skin(&self) -> TriangleMesh {
        let joined = self.vertex_count() - LOOSE;
        let mut skin = self.mesh.clone();
        if joined < 100 {
            for (i, p) in skin.positions.iter_mut().enumerate().take(joined) {
                *p = *p * 0.04 + Vec3::new((i % 9) as f64, (i / 9) as f64, 0.0) * 10.0;
            }
        }
        skin
    }

    /// On the small template triangles join vertices at random, so that vertices have neighbours near and far.
    pub fn affine(&self) -> Affine {
        let joined = self.vertex_count() - LOOSE;
        let corner = |k: usize| (k % joined) as u32;
        let far = (0..joined).map(|k| [corner(k), corner(5 * k + 1), corner(7 * k + 3)]);
        let triangles = if joined < 100 { far.collect() } else { self.mesh.triangles.clone() };
        Affine::new(&TriangleMesh { triangles, ..self.mesh.clone() }, 0.7, 1.3).expect("a finite mesh")
    }
}

/// A model under terms.
pub type TestProblem = Deformation<Box<dyn TestModel>, Box<dyn TestTerm>>;

/// Where the samples are at these parameters.
pub fn sampled(problem: &mut TestProblem, x: &[f64]) -> Vec<Vec3> {
    let vertices = problem.vertices(x).to_vec();
    let mut positions = Vec::new();
    problem.samples().positions(&vertices, &mut positions);
    positions
}

/// The model under terms near its rest shape, and its parameters there.
pub fn problem_at_rest(zoo: &Zoo, model: Box<dyn TestModel>, seed: u64) -> (TestProblem, Vec<f64>) {
    let mut problem = Deformation::new(model, zoo.samples());
    let rest = problem.model.rest_parameters();
    let positions = sampled(&mut problem, &rest);
    problem.terms = terms(&mut ChaCha8Rng::seed_from_u64(seed), &positions, Kernel::Huber { delta: 1.0 });
    (problem, rest)
}

/// Two triangles in each quad of a grid.
fn triangles(columns: usize, rows: usize) -> Vec<[u32; 3]> {
    let quads = (0..(columns - 1) * (rows - 1)).map(|q| (q + q / (columns - 1)) as u32);
    let next = columns as u32;
    quads.flat_map(|a| [[a, a + 1, a + next + 1], [a, a + next + 1, a + next]]).collect()
}

/// Its negative weights make H indefinite, so that it has no Gauss-Newton step.
pub const INDEFINITE: &str = "arap, Joint, as it comes";

/// Derivatives at some parameters.
pub type Differentiate = Box<dyn Fn(&[f64]) -> Reference>;

/// A model, and another way to its derivatives.
pub struct Specimen {
    pub name: String,
    pub model: Box<dyn TestModel>,
    pub reference: Differentiate,
}

impl Specimen {
    fn new(
        name: impl Into<String>,
        model: impl TestModel + 'static,
        reference: impl Fn(&[f64]) -> Reference + 'static,
    ) -> Self {
        Self { name: name.into(), model: Box::new(model), reference: Box::new(reference) }
    }

    fn assembled<T: NodeTransform<W>, const W: usize>(name: &str, build: impl Fn() -> Hybrid<T, W>) -> Self {
        Self::new(name, build(), reference::formula(build()))
    }
}

pub trait TestModel: DeformationModel {
    /// Whether there is a choice.
    fn set_linearisation(&mut self, _: Linearisation) -> bool {
        false
    }
}

impl<T: NodeTransform<W>, const W: usize> TestModel for Hybrid<T, W> {
    fn set_linearisation(&mut self, linearisation: Linearisation) -> bool {
        self.linearisation = linearisation;
        true
    }
}

impl TestModel for Free {}
impl TestModel for Affine {}
impl TestModel for Arap {}
impl TestModel for MassSpring {}
impl TestModel for Fem {}
impl TestModel for Ffd {}
impl TestModel for Poisson {}
impl TestModel for Laplacian {}
impl<F: PositionFunction> TestModel for Autodiff<F> {}

pub const KERNELS: [Kernel; 9] = [
    Kernel::None,
    Kernel::Huber { delta: 1.0 },
    Kernel::Cauchy { delta: 1.5 },
    Kernel::GemanMcClure { delta: 2.0 },
    Kernel::Welsch { delta: 3.0 },
    Kernel::Tukey { delta: 2.5 },
    Kernel::L1 { eps: 0.5 },
    Kernel::Lp { p: 0.5, eps: 0.6 },
    Kernel::Lp { p: 1.6, eps: 0.4 },
];

/// A data term, and another way to its derivatives.
pub trait TestTerm: DataTerm {
    /// `(sample, alpha rho', row, r)` of every scalar residual.
    fn rows(&self, positions: &[Vec3]) -> Vec<(usize, f64, [f64; 3], f64)>;
}

impl<T: SampleResidual<R>, const R: usize> TestTerm for Pointwise<T, Kernel, R> {
    fn rows(&self, positions: &[Vec3]) -> Vec<(usize, f64, [f64; 3], f64)> {
        let mut rows = Vec::new();
        for m in 0..self.residuals.len() {
            let sample = self.residuals.sample(m);
            let v = std::array::from_fn(|a| DualSVec64::<3>::from_re(positions[sample][a]).derivative(a));
            let r = self.residuals.residual(m, v);
            let weight = self.residuals.weight(m) * self.kernel.weight(r.iter().map(|r| r.re * r.re).sum());
            rows.extend(r.map(|r| (sample, weight, r.eps.0.map_or([0.0; 3], Into::into), r.re)));
        }
        rows
    }
}

/// One of each data term on samples that are at `positions`, some residuals beyond the kernel's scale and others not, none
/// near enough to a kink of the kernel (Huber, Tukey) for differences to see it. Some samples weigh nothing.
pub fn terms(rng: &mut ChaCha8Rng, positions: &[Vec3], kernel: Kernel) -> Vec<Box<dyn TestTerm>> {
    let count = positions.len();
    let weights: Vec<f64> = (0..count).map(|i| if i % 7 == 3 { 0.0 } else { rng.random_range(0.5..1.5) }).collect();
    let directions: [Vec<Vec3>; 3] =
        std::array::from_fn(|_| (0..count).map(|_| random_vec(rng, 1.0).normalize()).collect());
    let [normals, source_normals, target_normals] = directions;
    let kink = match kernel {
        Kernel::Huber { delta } | Kernel::Tukey { delta } => delta,
        _ => f64::INFINITY,
    };
    // A target near sample s at which the residual is no kink.
    let mut near = |s: usize, size: &dyn Fn(Vec3) -> f64| {
        loop {
            let offset = random_vec(rng, 1.0) * rng.random_range(0.3..3.0);
            if (size(offset) - kink).abs() > 0.15 {
                return positions[s] - offset;
            }
        }
    };
    let mut targets = |size: &dyn Fn(usize, Vec3) -> f64| -> Vec<Vec3> {
        (0..count).map(|s| near(s, &|offset| size(s, offset))).collect()
    };
    let plane = targets(&|s, offset| offset.dot(&normals[s]).abs());
    let point = targets(&|_, offset| offset.norm());
    let middle = targets(&|s, offset| (offset.dot(&(source_normals[s] + target_normals[s])) / 2.0).abs());
    // Several scan points on one sample, none on others; on those inside faces too.
    let samples: Vec<usize> = (0..count).map(|m| if m < count - 4 { m * m % (count - 4) } else { m }).collect();
    let from_scan = (0..count).map(|m| near(samples[m], &|offset| offset.dot(&normals[m]).abs())).collect();
    let marked = vec![5, count - 4, count - 3, count - 2, count - 1];
    let marks = marked.iter().map(|&s| near(s, &|offset| offset.norm())).collect();
    vec![
        Box::new(Pointwise::new(
            "point to point",
            PointToPoint { targets: point, weights: weights.clone(), scale: 0.2 },
            kernel,
        )),
        Box::new(Pointwise::new(
            "point to plane",
            PointToPlane { targets: plane, normals: normals.clone(), weights: weights.clone(), scale: 1.3 },
            kernel,
        )),
        Box::new(Pointwise::new(
            "symmetric",
            Symmetric { targets: middle, source_normals, target_normals, weights: weights.clone(), scale: 0.8 },
            kernel,
        )),
        Box::new(Pointwise::new(
            "scan to template",
            ScanToTemplate { samples, targets: from_scan, normals, weights, scale: 0.6 },
            kernel,
        )),
        Box::new(Pointwise::new(
            "landmarks",
            Landmarks { samples: marked, targets: marks, weights: vec![1.0, 0.5, 2.0, 1.0, 0.7], scale: 0.7 },
            kernel,
        )),
    ]
}

/// A curved model with all that a statement may contain: blocks in any order and named twice, as at a clamped end, lists of
/// different lengths, more tangent coordinates than a stride of duals, residuals of one entry, and a block of nobody's.
pub struct Swirl {
    pub rest: Vec<Vec3>,
}

impl Swirl {
    const BLOCKS: usize = 14;
}

impl PositionFunction for Swirl {
    type Block = Euclidean<2>;

    fn name(&self) -> &'static str {
        "swirl"
    }

    fn rest_blocks(&self) -> Vec<[f64; 2]> {
        vec![[0.0; 2]; Self::BLOCKS]
    }

    /// All but the last.
    fn vertex_blocks(&self) -> Vec<Vec<usize>> {
        let blocks =
            |i: usize| (0..=i % 11).map(move |k| (5 * i + 9 * k) % (Self::BLOCKS - 1)).chain([i % 3]).collect();
        (0..self.rest.len()).map(blocks).collect()
    }

    fn position<D: Scalar>(&self, vertex: usize, p: &[[D; 2]]) -> [D; 3] {
        let mut v: [D; 3] = std::array::from_fn(|a| D::from(self.rest[vertex][a]));
        for (k, [turn, push]) in p.iter().enumerate() {
            let (sin, cos) = (*turn * (0.5 + 0.1 * k as f64)).sin_cos();
            v = [cos * v[1] - sin * v[2], sin * v[1] + cos * v[2], v[0] + *push * *turn + push.exp()];
        }
        v
    }

    fn smoothness_blocks(&self) -> Vec<Vec<usize>> {
        (2..Self::BLOCKS - 1).map(|k| vec![k, k - 1, k - 2]).collect()
    }

    fn smoothness<D: Scalar>(&self, m: usize, p: &[[D; 2]]) -> [D; 3] {
        let bend = p[0][0] - p[1][0] * 2.0 + p[2][0];
        [bend, if m.is_multiple_of(2) { p[0][1] * p[2][1] } else { D::from(0.0) }, D::from(0.0)]
    }
}
