//! provisional
#![allow(missing_docs)]
use super::*;
use std::sync::Arc;
#[derive(Default)]
pub struct Workspace { eq: Option<NormalEquations>, solver: Option<Box<dyn LinearSolver>> }
#[derive(Default, Clone, Copy)]
pub struct GaussNewton;
pub struct Summary { pub final_energy: f64 }
impl GaussNewton {
    pub fn with_max_iterations(self, _: usize) -> Self { self }
    pub fn minimize<P: Problem>(&self, p: &mut P, x: &mut [f64], w: &mut Workspace) -> Summary {
        let s = Arc::clone(p.structure());
        let eq = w.eq.get_or_insert_with(|| NormalEquations::new(Arc::clone(&s)));
        let solver = w.solver.get_or_insert_with(|| LinearSolverKind::Auto.build(&s));
        let t0 = std::time::Instant::now();
        let e0 = p.linearize(x, eq);
        let t1 = std::time::Instant::now();
        let mut step = vec![0.0; s.dimension()];
        let mut diag = vec![0.0; s.dimension()];
        eq.copy_diagonal(&mut diag);
        let m = diag.iter().fold(0.0f64, |a, b| a.max(*b));
        diag.iter_mut().for_each(|d| *d = 1e-9 * m.min(*d + 1.0));
        solver.solve(eq, &diag, &mut step).expect("solve");
        let t2 = std::time::Instant::now();
        let mut y = x.to_vec();
        let mut e = e0;
        for _ in 0..8 {
            p.retract(x, &step, &mut y);
            e = p.energy(&y);
            if e <= e0 { x.copy_from_slice(&y); break; }
            step.iter_mut().for_each(|s| *s *= 0.5);
        }
        if std::env::var("NR_TIME").is_ok() { eprintln!("lin {:.1} solve {:.1} ms rest {:.1} e {e0} -> {e}", (t1-t0).as_secs_f64()*1e3, (t2-t1).as_secs_f64()*1e3, t2.elapsed().as_secs_f64()*1e3); }
        Summary { final_energy: e }
    }
}
