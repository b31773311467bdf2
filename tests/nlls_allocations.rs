//! After the first call a workspace minimises without allocating, as an alternation of single steps relies on.
#![allow(unsafe_code)] // a counting allocator cannot be written without

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use nonrigid::nlls::{
    Bounded, Euclidean, Family, Kernel, LinearSolverKind, Minimizer, Options, Problem, Residual, ResidualProblem,
    Scalar, Se3, Silent, Workspace,
};

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: forwards to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Poses carry points that a shared offset shifts.
struct Carried {
    p: [f64; 3],
    q: [f64; 3],
}

impl Residual<3, 15> for Carried {
    type Blocks = (Se3, Se3, Euclidean<3>);

    fn evaluate<D: Scalar>(&self, (a, b, w): &([D; 12], [D; 12], [D; 3])) -> [D; 3] {
        let p: [D; 3] = std::array::from_fn(|i| w[i] + self.p[i]);
        let p = Se3::transform(b, Se3::transform(a, p));
        std::array::from_fn(|i| p[i] - self.q[i])
    }
}

#[test]
fn single_steps_do_not_allocate_after_the_first() {
    let mut builder = ResidualProblem::builder();
    let poses: Vec<_> = (0..30).map(|_| builder.add_block::<Se3>(&Se3::IDENTITY)).collect();
    let offset = builder.add_border_block::<Euclidean<3>>(&[0.1, 0.2, 0.3]);
    let (mut residuals, mut blocks) = (Vec::new(), Vec::new());
    for k in 0..30 * 6 {
        let p: [f64; 3] = std::array::from_fn(|i| (k as f64 * (1.3 + i as f64)).sin());
        residuals.push(Carried { p, q: p.map(|v| 1.1 * v + 0.1 * (7.0 * v).cos()) });
        blocks.push([poses[k % 30], poses[(k + 1) % 30], offset]);
    }
    builder.add_family(Family::new(residuals, &blocks).with_kernel(Kernel::Huber { delta: 0.3 }));
    let mut problem = builder.build().unwrap();
    let x = problem.initial();
    check(&mut problem, &x);
    // Bounds that some steps run into and others do not, free and held weights.
    let (lower, upper) = (vec![-9.0, 0.19, 0.0], vec![0.12, 0.25, 9.0]);
    check(&mut Bounded { problem, first: 30 * 12, lower, upper }, &x);
}

fn check(problem: &mut (impl Problem + Send), start: &[f64]) {
    for options in [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()] {
        use LinearSolverKind::{BlockJacobi, Bordered, Dense, Sparse};
        for kind in [Dense, Sparse, Bordered, BlockJacobi] {
            let options = options.with_linear_solver(kind).with_max_iterations(1).with_damping_floor(1e-9);
            let minimizer = Minimizer::new(options).unwrap();
            let mut workspace = Workspace::new();
            let mut x = start.to_vec();
            // One thread: what is counted is what this thread does.
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            pool.install(|| {
                let first = minimizer.minimize_with(problem, &mut x, &mut workspace, &mut Silent).final_energy;
                let before = COUNT.get();
                for _ in 0..3 {
                    minimizer.minimize_with(problem, &mut x, &mut workspace, &mut Silent);
                }
                assert_eq!(COUNT.get() - before, 0, "{kind:?}, {}", workspace.summary());
                assert!(workspace.summary().final_energy < first, "{}", workspace.summary());
            });
        }
    }
}
