//! A regression whose answer NIST certifies to eleven digits: MGH09 of the Statistical Reference Datasets, of higher difficulty
//! (<https://www.itl.nist.gov/div898/strd/nls/data/mgh09.shtml>), from its far start.
//!
//! ```text
//!     y = b1 (x^2 + b2 x) / (x^2 + b3 x + b4)
//! ```

use std::error::Error;

use super::{Check, largest};
use crate::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar};

/// The worst of the four parameters and the sum of squares. The certified digits are known to 4e-11; the minimum is as flat as
/// rounding leaves it, so that parameters are determined to about the root of the machine's epsilon, 1.5e-8, at worst.
pub const MGH09: Check = Check {
    what: "NIST's MGH09 by Levenberg-Marquardt: worst relative error",
    expected: 0.0,
    tolerance: 1e-7,
    compute: worst_relative_error,
};

/// x, y.
const OBSERVATIONS: [[f64; 2]; 11] = [
    [4.0, 0.1957],
    [2.0, 0.1947],
    [1.0, 0.1735],
    [0.5, 0.16],
    [0.25, 0.0844],
    [0.167, 0.0627],
    [0.125, 0.0456],
    [0.1, 0.0342],
    [0.0833, 0.0323],
    [0.0714, 0.0235],
    [0.0625, 0.0246],
];
const START: [f64; 4] = [25.0, 39.0, 41.5, 39.0];
const CERTIFIED: [f64; 4] = [1.928_069_345_8e-1, 1.912_823_287_3e-1, 1.230_565_069_3e-1, 1.360_623_306_8e-1];
const CERTIFIED_SUM_OF_SQUARES: f64 = 3.075_056_038_5e-4;

struct Observation {
    x: f64,
    y: f64,
}

impl Residual<1, 4> for Observation {
    type Blocks = (Euclidean<4>,);

    fn evaluate<D: Scalar>(&self, (b,): &([D; 4],)) -> [D; 1] {
        let x = self.x;
        [b[0] * (b[1] * x + x * x) / (b[2] * x + b[3] + x * x) - self.y]
    }
}

fn worst_relative_error() -> Result<f64, Box<dyn Error>> {
    let mut builder = ResidualProblem::builder();
    let b = builder.add_border_block::<Euclidean<4>>(&START);
    let residuals = OBSERVATIONS.map(|[x, y]| Observation { x, y }).into();
    builder.add_family(Family::new(residuals, &[[b]; OBSERVATIONS.len()]));
    let mut problem = builder.build()?;
    let mut x = problem.initial();
    let options = Options::levenberg_marquardt().with_energy_tolerance(1e-15).with_max_iterations(1000);
    let summary = Minimizer::new(options)?.minimize(&mut problem, &mut x);
    let found = x.iter().chain([&summary.final_energy]);
    let certified = CERTIFIED.iter().chain([&CERTIFIED_SUM_OF_SQUARES]);
    Ok(largest(found.zip(certified).map(|(found, certified)| found / certified - 1.0)))
}
