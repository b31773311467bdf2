//! Laws that every manifold obeys, yours included.

use nalgebra::DMatrix;
use num_dual::Dual64;

use super::{Manifold, PointArray};

/// Checks `M` at the point `x`:
///
/// 1. `x` has `AMBIENT` entries, `Point` too, `normalize(x)` leaves `x` alone, and `M` contains it;
/// 2. a zero step goes nowhere: `plus(x, 0) = x`;
/// 3. the derivative of `plus` at 0, taken by dual numbers, is that of central differences;
/// 4. it has rank `TANGENT`: no direction is lost (a chart whose derivative is zero at 0 fails here);
/// 5. a step stays on the manifold: `normalize` moves its end by rounding only.
///
/// # Errors
/// A sentence that names the law and the numbers that break it.
pub fn check_manifold<M: Manifold>(x: &[f64]) -> Result<(), String> {
    let storage = M::Point::<f64>::filled(0.0).as_ref().len();
    if x.len() != M::AMBIENT || storage != M::AMBIENT {
        return Err(format!("AMBIENT is {}, the point has {} entries, Point has {storage}", M::AMBIENT, x.len()));
    }
    let size = x.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
    let differs = |a: &[f64], b: &[f64], tolerance: f64| {
        (0..a.len()).find(|&i| (a[i] - b[i]).abs() > tolerance || !a[i].is_finite())
    };
    let mut normal = x.to_vec();
    M::normalize(&mut normal);
    if let Some(i) = differs(&normal, x, 1e-14 * size) {
        return Err(format!(
            "the point is not on the manifold: normalize moves entry {i} from {} to {}",
            x[i], normal[i]
        ));
    }
    if !M::contains(x, 1e-14) {
        return Err(format!("the point is not on the manifold: {x:?}"));
    }

    let mut moved = x.to_vec();
    M::plus(x, &vec![0.0; M::TANGENT], &mut moved);
    if let Some(i) = differs(&moved, x, 1e-15 * size) {
        return Err(format!("a zero step must go nowhere, but moves entry {i} from {} to {}", x[i], moved[i]));
    }

    let mut jacobian = DMatrix::zeros(M::AMBIENT, M::TANGENT);
    for k in 0..M::TANGENT {
        let mut delta = vec![Dual64::from(0.0); M::TANGENT];
        delta[k] = delta[k].derivative();
        let mut dual = vec![Dual64::from(0.0); M::AMBIENT];
        M::plus(x, &delta, &mut dual);
        let h = 1e-5;
        let mut step = vec![0.0; M::TANGENT];
        let (mut high, mut low) = (x.to_vec(), x.to_vec());
        step[k] = h;
        M::plus(x, &step, &mut high);
        step[k] = -h;
        M::plus(x, &step, &mut low);
        for i in 0..M::AMBIENT {
            let difference = (high[i] - low[i]) / (2.0 * h);
            let error = (dual[i].eps - difference).abs();
            if error.is_nan() || error > 1e-8 * size {
                return Err(format!(
                    "derivative of entry {i} by tangent coordinate {k} at 0: dual numbers {}, central difference {difference}",
                    dual[i].eps
                ));
            }
            jacobian[(i, k)] = dual[i].eps;
        }
    }
    let rank = jacobian.rank(1e-8);
    if rank != M::TANGENT {
        return Err(format!("the derivative at 0 has rank {rank}, TANGENT is {}", M::TANGENT));
    }

    for length in [1e-8, 1e-3, 0.3, 2.0] {
        let step: Vec<f64> = (0..M::TANGENT).map(|k| length * (1.0 + k as f64).sin()).collect();
        M::plus(x, &step, &mut moved);
        normal.copy_from_slice(&moved);
        M::normalize(&mut normal);
        let size = moved.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
        if let Some(i) = differs(&normal, &moved, 1e-13 * size) {
            return Err(format!(
                "a step of {length} leaves the manifold: normalize moves entry {i} from {} to {}",
                moved[i], normal[i]
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nlls::{Scalar, So3};

    /// Quaternion steps through `sqrt`, whose derivative at 0 is NaN: the classical mistake.
    struct NoDerivative;

    impl Manifold for NoDerivative {
        const AMBIENT: usize = 1;
        const TANGENT: usize = 1;
        type Point<D: Scalar> = [D; 1];

        fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
            out[0] = (delta[0] * delta[0]).sqrt() + x[0];
        }
    }

    #[test]
    fn what_normalizing_leaves_alone_may_still_be_no_rotation() {
        let diagonal = |d: [f64; 3]| [d[0], 0.0, 0.0, 0.0, d[1], 0.0, 0.0, 0.0, d[2]];
        for wrong in [diagonal([-1.0, 1.0, 1.0]), [0.0; 9]] {
            let error = check_manifold::<So3>(&wrong).unwrap_err();
            assert!(error.starts_with("the point is not on the manifold"), "{error}");
        }
        check_manifold::<So3>(&diagonal([-1.0, -1.0, 1.0])).unwrap();
    }

    #[test]
    fn the_checker_catches_a_missing_derivative() {
        let error = check_manifold::<NoDerivative>(&[1.0]).unwrap_err();
        assert!(error.contains("entry 0 by tangent coordinate 0"), "{error}");
    }
}
