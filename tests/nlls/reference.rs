//! Certified values: problems of NIST's Statistical Reference Datasets for nonlinear regression
//! (<https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml>), from both of their starts; and a bundle adjustment against SciPy
//! (`tests/references/bundle_adjustment.py` writes the files that are read here).

#[allow(dead_code)] // its own `main`
#[path = "../../examples/bundle_adjustment.rs"]
mod bundle_adjustment;

use bundle_adjustment::Scene;
use nonrigid::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar};

/// y = b1 (1 - exp(-b2 x)), lower difficulty. Dental research, monomolecular adsorption.
struct Misra1a {
    x: f64,
    y: f64,
}

impl Residual<1, 2> for Misra1a {
    type Blocks = (Euclidean<2>,);

    fn evaluate<D: Scalar>(&self, (b,): &([D; 2],)) -> [D; 1] {
        [b[0] * (-(b[1] * -self.x).exp() + 1.0) - self.y]
    }
}

/// x, then y.
const MISRA_1A: [[f64; 14]; 2] = [
    [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0],
    [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78],
];

#[test]
fn misra_1a() {
    for start in [[500.0, 0.0001], [250.0, 0.0005]] {
        for options in [Options::gauss_newton(), Options::levenberg_marquardt(), Options::dogleg()] {
            let mut builder = ResidualProblem::builder();
            let b = builder.add_border_block::<Euclidean<2>>(&start);
            let [x, y] = MISRA_1A;
            let residuals = x.into_iter().zip(y).map(|(x, y)| Misra1a { x, y }).collect();
            builder.add_family(Family::new(residuals, &[[b]; 14]));
            let mut problem = builder.build().unwrap();
            let mut x = problem.initial();
            let options = options.with_energy_tolerance(1e-14).with_max_iterations(200);
            let summary = Minimizer::new(options).unwrap().minimize(&mut problem, &mut x);
            assert!(summary.stop.converged(), "{summary}");
            for (value, certified) in x.iter().zip([2.389_421_291_8e2, 5.501_564_318_1e-4]) {
                assert!((value / certified - 1.0).abs() < 1e-8, "{value} {certified}\n{summary}");
            }
            assert!((summary.final_energy / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9, "{summary}");
        }
    }
}

#[test]
fn a_bundle_adjustment_ends_at_scipys_minimum() {
    let mut scene: Scene = include_str!("../references/bundle_adjustment.txt").parse().unwrap();
    let reference: serde_json::Value =
        serde_json::from_str(include_str!("../references/bundle_adjustment.json")).unwrap();
    let summary = scene.adjust().unwrap();
    assert!(summary.stop.converged(), "{summary}");
    for (found, key) in [(summary.initial_energy, "initial_energy"), (summary.final_energy, "energy")] {
        let expected = reference[key].as_f64().unwrap();
        assert!((found / expected - 1.0).abs() < 1e-8, "{key}: {found} {expected}\n{summary}");
    }
    // Points are eliminated, five cameras are left.
    assert_eq!((summary.size.border, summary.size.blocks), (45, 40));
    assert_eq!(summary.linear_solver, "bordered Cholesky");
}
