//! Laws that every deformation model obeys: those on the common assembly, and those stated as a formula.

use std::sync::Arc;

use nonrigid::energy::{DataTerm, Deformation, DeformationModel, Pointwise, Samples};
use nonrigid::mesh::Vec3;
use nonrigid::model::{
    Autodiff, AutodiffError, Linearisation, NodeAssembly, NodeGraph, NodeTransform, PositionFunction,
};
use nonrigid::model::{Stiffness, blendshape, graph, hybrid, rigid, similarity};
use nonrigid::nlls::{
    Euclidean, GradientCheck, Kernel, Minimizer, NormalEquations, Options, Problem, Scalar, Se3, check_gradient,
};
use nonrigid::rig::{Family, Shape, ShapeBasis};
use nonrigid::term::{Landmarks, PointToPlane, PointToPoint};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const VERTICES: usize = 60;
const NODES: usize = 9;
const SHAPES: usize = 21; // more than one stride of the reference linearisation

fn random_vec(rng: &mut ChaCha8Rng, size: f64) -> Vec3 {
    Vec3::from_fn(|_, _| rng.random_range(-size..size))
}

fn rest(rng: &mut ChaCha8Rng) -> Vec<Vec3> {
    (0..VERTICES).map(|_| random_vec(rng, 50.0)).collect()
}

fn nodes(rng: &mut ChaCha8Rng, rest: &[Vec3]) -> NodeGraph {
    let nodes: Vec<Vec3> = (0..NODES).map(|j| rest[j * 5]).collect();
    let influences: Vec<Vec<(u32, f64)>> = (0..VERTICES)
        .map(|i| {
            let count = 1 + i % 4;
            let raw: Vec<f64> = (0..count).map(|_| rng.random_range(0.1..1.0)).collect();
            let sum: f64 = raw.iter().sum();
            raw.iter().enumerate().map(|(k, w)| (((i * 3 + k * 2) % NODES) as u32, w / sum)).collect()
        })
        .collect();
    NodeGraph::from_influences(nodes, influences)
}

fn shapes(rng: &mut ChaCha8Rng) -> ShapeBasis {
    let shapes = (0..SHAPES).map(|k| Shape { name: format!("shape{k}"), family: Family::Expression }).collect();
    let slab = (0..3 * VERTICES * SHAPES).map(|_| rng.random_range(-4.0..4.0)).collect();
    ShapeBasis::new(shapes, slab).with_sigmas(|shape| 0.5 + shape.name.len() as f64 / 10.0)
}

/// All vertices and three points inside faces.
fn samples() -> Samples {
    let mut samples = Samples::vertices(VERTICES);
    for k in 0..3 {
        samples.push(&[(k, 0.2), (k + 7, 0.5), (k + 20, 0.3)]).expect("a convex combination");
    }
    samples
}

fn terms(rng: &mut ChaCha8Rng, rest: &[Vec3], kernel: Kernel) -> Vec<Box<dyn DataTerm>> {
    let near = |rng: &mut ChaCha8Rng| -> Vec<Vec3> { rest.iter().map(|&p| p + random_vec(rng, 3.0)).collect() };
    let weights: Vec<f64> = (0..VERTICES).map(|i| if i % 7 == 3 { 0.0 } else { 1.0 }).collect();
    let normals = (0..VERTICES).map(|_| random_vec(rng, 1.0).normalize()).collect();
    let plane = PointToPlane { targets: near(rng), normals, weights: weights.clone(), scale: 1.3 };
    let point = PointToPoint { targets: near(rng), weights, scale: 0.2 };
    let targets = (0..4).map(|_| random_vec(rng, 40.0)).collect();
    let landmarks = Landmarks { samples: vec![5, 60, 61, 62], targets, weights: vec![1.0; 4], scale: 0.7 };
    vec![
        Box::new(Pointwise::new("plane", plane, kernel)),
        Box::new(Pointwise::new("point", point, kernel)),
        Box::new(Pointwise::new("landmarks", landmarks, Kernel::None)),
    ]
}

fn random_step(rng: &mut ChaCha8Rng, dimension: usize) -> Vec<f64> {
    (0..dimension).map(|_| rng.random_range(-0.3..0.3)).collect()
}

fn kernels() -> Vec<Kernel> {
    vec![
        Kernel::None,
        Kernel::Huber { delta: 1.0 },
        Kernel::Cauchy { delta: 1.5 },
        Kernel::GemanMcClure { delta: 2.0 },
        Kernel::Welsch { delta: 3.0 },
        Kernel::Tukey { delta: 4.0 },
        Kernel::L1 { eps: 0.1 },
        Kernel::Lp { p: 0.5, eps: 0.1 },
    ]
}

type Visit<'a> = &'a mut dyn FnMut(&mut ChaCha8Rng, Box<dyn Fn() -> Box<dyn TestModel>>, Vec<Vec3>);

fn each_assembly(visit: Visit<'_>) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let rest = rest(&mut rng);
    let graph_of = nodes(&mut rng, &rest);
    let basis = shapes(&mut rng);
    let stiffness = Stiffness { graph: 0.7, blend: 0.3 };
    let (r, g, b) = (rest.clone(), graph_of.clone(), basis.clone());
    visit(&mut rng, Box::new(move || Box::new(hybrid(r.clone(), g.clone(), b.clone(), stiffness))), rest.clone());
    let (r, g) = (rest.clone(), graph_of);
    visit(&mut rng, Box::new(move || Box::new(graph(r.clone(), g.clone(), 0.7))), rest.clone());
    let (r, b) = (rest.clone(), basis);
    visit(&mut rng, Box::new(move || Box::new(blendshape(r.clone(), b.clone(), 0.3))), rest.clone());
    let r = rest.clone();
    visit(&mut rng, Box::new(move || Box::new(rigid(r.clone()))), rest.clone());
    let r = rest.clone();
    visit(&mut rng, Box::new(move || Box::new(similarity(r.clone()))), rest.clone());
}

fn each_model(visit: Visit<'_>) {
    each_assembly(visit);
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let rest = rest(&mut rng);
    let (r, nodes) = (rest.clone(), nodes(&mut rng, &rest));
    visit(&mut rng, Box::new(move || Box::new(stated_graph(&r, &nodes, 0.7))), rest.clone());
    let r = rest.clone();
    visit(&mut rng, Box::new(move || Box::new(Autodiff::new(Swirl { rest: r.clone() }).unwrap())), rest.clone());
}

/// The deformation graph, eqs. (6) and (7), as a formula.
struct StatedGraph {
    rest: Vec<Vec3>,
    graph: NodeGraph,
}

impl PositionFunction for StatedGraph {
    type Block = Se3;

    fn name(&self) -> &'static str {
        "stated graph"
    }

    fn rest_blocks(&self) -> Vec<[f64; 12]> {
        vec![Se3::IDENTITY; self.graph.nodes().len()]
    }

    fn vertex_blocks(&self) -> Vec<Vec<usize>> {
        (0..self.rest.len()).map(|i| self.graph.influences(i).iter().map(|i| i.0 as usize).collect()).collect()
    }

    fn position<D: Scalar>(&self, vertex: usize, p: &[[D; 12]]) -> [D; 3] {
        let mut v = [D::from(0.0); 3];
        for (&(j, omega), p) in self.graph.influences(vertex).iter().zip(p) {
            let x_j = self.graph.nodes()[j as usize];
            let moved = Se3::transform(p, std::array::from_fn(|a| D::from(self.rest[vertex][a] - x_j[a])));
            for a in 0..3 {
                v[a] += (moved[a] + x_j[a]) * omega;
            }
        }
        v
    }

    fn smoothness_blocks(&self) -> Vec<Vec<usize>> {
        self.graph.edges().iter().map(|&(i, j)| vec![i as usize, j as usize]).collect()
    }

    fn smoothness<D: Scalar>(&self, m: usize, p: &[[D; 12]]) -> [D; 3] {
        let (i, j) = self.graph.edges()[m];
        let (x_i, x_j) = (self.graph.nodes()[i as usize], self.graph.nodes()[j as usize]);
        let moved = Se3::transform(&p[0], std::array::from_fn(|a| D::from(x_j[a] - x_i[a])));
        std::array::from_fn(|a| moved[a] + x_i[a] - p[1][9 + a] - x_j[a])
    }
}

fn stated_graph(rest: &[Vec3], graph: &NodeGraph, stiffness: f64) -> Autodiff<StatedGraph> {
    let mut model = Autodiff::new(StatedGraph { rest: rest.to_vec(), graph: graph.clone() }).unwrap();
    model.stiffness = stiffness;
    model
}

/// A curved model with all that a statement may contain: blocks in any order and named twice, as at a clamped end, lists of
/// different lengths, more tangent coordinates than a stride of duals, residuals of one entry, and a block of nobody's.
struct Swirl {
    rest: Vec<Vec3>,
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
        [bend, if m % 2 == 0 { p[0][1] * p[2][1] } else { D::from(0.0) }, D::from(0.0)]
    }
}

#[test]
fn a_graph_stated_as_a_formula_is_the_graph() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let rest = rest(&mut rng);
    let nodes = nodes(&mut rng, &rest);
    let start = random_step(&mut rng, 6 * NODES);
    let near = rng.clone();
    fn run<M: DeformationModel>(
        model: M,
        rest: &[Vec3],
        mut rng: ChaCha8Rng,
        start: &[f64],
    ) -> (Vec<(String, f64)>, NormalEquations, Vec<f64>) {
        let mut problem = Deformation::new(model, samples());
        problem.terms = terms(&mut rng, rest, Kernel::GemanMcClure { delta: 2.0 });
        let x0 = problem.model.rest_parameters();
        let mut x = x0.clone();
        problem.retract(&x0, start, &mut x);
        let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
        problem.linearize(&x, &mut equations);
        let energies = problem.energies(&x);
        let step = Options::gauss_newton().with_max_iterations(1);
        Minimizer::new(step).unwrap().minimize(&mut problem, &mut x);
        (energies, equations, x)
    }
    let (stated, built) = (stated_graph(&rest, &nodes, 0.7), graph(rest.clone(), nodes.clone(), 0.7));
    let (energies, equations, x) = run(stated, &rest, near.clone(), &start);
    let (expected_energies, expected, expected_x) = run(built, &rest, near, &start);
    assert_eq!(energies.len(), expected_energies.len());
    for ((name, found), (_, expected)) in energies.iter().zip(&expected_energies) {
        approx::assert_relative_eq!(*found, *expected, max_relative = 1e-13);
        assert!(*expected > 0.0, "{name}");
    }
    let largest = expected.to_dense().amax();
    assert!((equations.to_dense() - expected.to_dense()).amax() < 1e-13 * largest);
    let largest = expected.gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    for (found, expected) in equations.gradient.iter().zip(&expected.gradient) {
        assert!((found - expected).abs() < 1e-12 * largest);
    }
    for (found, expected) in x.iter().zip(&expected_x) {
        approx::assert_abs_diff_eq!(*found, *expected, epsilon = 1e-9);
    }
}

#[test]
fn a_block_of_nobodys_stays_where_it_is() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let rest = rest(&mut rng);
    let mut problem = Deformation::new(Autodiff::new(Swirl { rest: rest.clone() }).unwrap(), samples());
    problem.terms = terms(&mut rng, &rest, Kernel::None);
    let mut x = problem.model.rest_parameters();
    let own = x.len() - 2..x.len();
    x[own.clone()].copy_from_slice(&[0.25, -0.5]);
    let before = problem.energy(&x);
    let options = Options::gauss_newton().with_damping_floor(1e-9).with_max_iterations(3);
    let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
    assert!(summary.final_energy < 0.95 * before, "{summary}");
    assert_eq!(x[own], [0.25, -0.5]);
    assert_eq!(summary.weak_directions(), 2, "{summary}");
}

#[test]
fn a_block_that_does_not_exist_is_named() {
    struct Wrong;
    impl PositionFunction for Wrong {
        type Block = Euclidean<1>;

        fn name(&self) -> &'static str {
            "wrong"
        }

        fn rest_blocks(&self) -> Vec<[f64; 1]> {
            vec![[0.0]; 5]
        }

        fn vertex_blocks(&self) -> Vec<Vec<usize>> {
            (0..9).map(|vertex| vec![0, vertex]).collect()
        }

        fn position<D: Scalar>(&self, _: usize, p: &[[D; 1]]) -> [D; 3] {
            [p[0][0]; 3]
        }
    }
    let error = Autodiff::new(Wrong).err().unwrap();
    let AutodiffError::BlockOutOfRange { index, block, blocks, .. } = error;
    assert_eq!((index, block, blocks), (5, 5, 5));
    assert_eq!(error.to_string(), "wrong: vertex 5 names block 5, but there are 5 blocks");
}

trait TestModel: DeformationModel {
    fn set_linearisation(&mut self, linearisation: Linearisation);
}

impl<T: NodeTransform<W>, const W: usize> TestModel for NodeAssembly<T, W> {
    fn set_linearisation(&mut self, linearisation: Linearisation) {
        self.linearisation = linearisation;
    }
}

impl<F: PositionFunction> TestModel for Autodiff<F> {
    fn set_linearisation(&mut self, _: Linearisation) {
        unreachable!("a stated model has one linearisation")
    }
}

#[test]
fn structured_and_reference_linearisation_agree_for_every_model_and_kernel() {
    each_assembly(&mut |rng, build, rest| {
        for kernel in kernels() {
            let mut problem = Deformation::new(build(), samples());
            problem.terms = terms(rng, &rest, kernel);
            let x0 = problem.model.rest_parameters();
            let mut x = x0.clone();
            problem.retract(&x0, &random_step(rng, problem.structure().dimension()), &mut x);
            let mut equations = [Linearisation::Structured, Linearisation::Reference].map(|linearisation| {
                problem.model.set_linearisation(linearisation);
                let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
                problem.linearize(&x, &mut equations);
                equations
            });
            let scale = equations[0].to_dense().amax();
            let difference = (equations[0].to_dense() - equations[1].to_dense()).amax();
            assert!(difference <= 1e-12 * scale, "{} {kernel:?}: {difference} of {scale}", problem.model.name());
            let scale = equations[0].gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
            let [structured, reference] = &mut equations;
            for (a, b) in structured.gradient.iter().zip(&reference.gradient) {
                assert!((a - b).abs() <= 1e-12 * scale, "{} {kernel:?}: {a} {b}", problem.model.name());
            }
        }
    });
}

#[test]
fn gradients_pass_the_derivative_checker_for_every_model_and_kernel() {
    each_model(&mut |rng, build, rest| {
        for kernel in kernels() {
            let mut problem = Deformation::new(build(), samples());
            problem.terms = terms(rng, &rest, kernel);
            let x0 = problem.model.rest_parameters();
            let mut x = x0.clone();
            problem.retract(&x0, &random_step(rng, problem.structure().dimension()), &mut x);
            let report = check_gradient(&mut problem, &x, GradientCheck::default());
            assert!(report.passed(), "{} {kernel:?}:\n{report}", problem.model.name());
        }
    });
}

#[test]
fn a_rigid_motion_costs_nothing_and_moves_every_vertex_rigidly() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let rest = rest(&mut rng);
    let nodes = nodes(&mut rng, &rest);
    let centres = nodes.nodes().to_vec();
    let mut model = hybrid(rest.clone(), nodes, shapes(&mut rng), Stiffness { graph: 5.0, blend: 5.0 });
    let rotation = nalgebra::Rotation3::from_euler_angles(0.4, -2.0, 1.1);
    let shift = Vec3::new(30.0, -80.0, 12.0);
    let mut x = model.rest_parameters();
    for (j, &centre) in centres.iter().enumerate() {
        let node = &mut x[12 * j..12 * (j + 1)];
        for a in 0..3 {
            for b in 0..3 {
                node[3 * a + b] = rotation.matrix()[(a, b)];
            }
        }
        let t = rotation * centre + shift - centre;
        node[9..].copy_from_slice(t.as_slice());
    }
    let mut energies = Vec::new();
    model.regulariser_energy(&x, &mut energies);
    for (name, energy) in energies {
        assert!(energy < 1e-22, "{name}: {energy}");
    }
    let mut moved = Vec::new();
    model.positions(&x, &mut moved);
    for (v, n) in moved.iter().zip(&rest) {
        approx::assert_abs_diff_eq!(*v, rotation * n + shift, epsilon = 1e-11);
    }
}

#[test]
fn the_same_bits_at_any_thread_count() {
    each_model(&mut |rng, build, rest| {
        let mut problem = Deformation::new(build(), samples());
        problem.terms = terms(rng, &rest, Kernel::Huber { delta: 1.0 });
        let x0 = problem.model.rest_parameters();
        let mut x = x0.clone();
        problem.retract(&x0, &random_step(rng, problem.structure().dimension()), &mut x);
        let mut run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
            let mut equations = NormalEquations::new(Arc::clone(problem.structure()));
            pool.install(|| problem.linearize(&x, &mut equations));
            let all = [equations.blocks, equations.cross, equations.border, equations.gradient].concat();
            all.iter().map(|v| v.to_bits()).collect::<Vec<u64>>()
        };
        let one = run(1);
        assert!(one == run(2) && one == run(4));
    });
}
