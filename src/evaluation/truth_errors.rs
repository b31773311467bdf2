//! Errors against a known truth, vertex by vertex.
//!
//! With e = result - truth and n the true unit vertex normal (the normalised sum of the unit normals of the faces around
//! it): `off` = |e.n|, `slide` = sqrt(max(|e|^2 - off^2, 0)).

use serde::{Deserialize, Serialize};

use super::percentile::of_sorted;
use super::{EvaluationError, check_count, check_triangles};
use crate::mesh::Vec3;

/// Errors of a result whose true vertex positions are known; millimetres over the *observed* vertices unless said
/// otherwise. With a non-finite observed vertex of the result they are NaN (`null` in JSON) and `finite` is false.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthErrors {
    /// Root mean square of |result - truth|.
    pub rmse: f64,
    /// Median of |result - truth|.
    pub median: f64,
    /// 95th percentile of |result - truth|.
    pub p95: f64,
    /// Largest |result - truth|.
    pub max: f64,
    /// Root mean square of the part along the true normal.
    pub normal: f64,
    /// Root mean square of the part along the true surface.
    pub tangential: f64,
    /// Root mean square of |result - truth| over the vertices that were *not* observed, if there are any.
    pub unobserved: Option<f64>,
    /// Triangles whose normal turned by more than 90 degrees against the truth, over the whole mesh.
    pub flipped: usize,
    /// Number of observed vertices.
    pub observed_vertices: usize,
    /// Whether every coordinate of the result is finite.
    pub finite: bool,
}

/// Errors of every vertex, observed or not: what a heat map shows. Millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexErrors {
    /// |result - truth|.
    pub distance: Vec<f64>,
    /// Part along the true normal, without sign.
    pub normal: Vec<f64>,
    /// Part along the true surface.
    pub tangential: Vec<f64>,
}

impl VertexErrors {
    /// `distance` with NaN where the scan does not show the vertex: pictures leave those grey.
    #[must_use]
    pub fn observed_distance(&self, observed: &[bool]) -> Vec<f64> {
        let shown = |i: usize| observed.get(i).copied().unwrap_or(false);
        self.distance.iter().enumerate().map(|(i, d)| if shown(i) { *d } else { f64::NAN }).collect()
    }
}

impl TruthErrors {
    /// Compares `result` with `truth`, both in the template's vertex order; `triangles` are the template's fan
    /// triangulation and `observed` says which vertices the scan shows.
    ///
    /// # Errors
    /// When the lengths differ, a triangle names a vertex that does not exist, no vertex is observed, or the truth is not finite.
    pub fn new(
        result: &[Vec3],
        truth: &[Vec3],
        observed: &[bool],
        triangles: &[[u32; 3]],
    ) -> Result<(Self, VertexErrors), EvaluationError> {
        check_count("the result", truth.len(), result.len())?;
        check_count("the observed mask", truth.len(), observed.len())?;
        check_triangles(triangles, truth.len())?;
        if !observed.contains(&true) {
            return Err(EvaluationError::NothingObserved);
        }
        if let Some(vertex) = truth.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(EvaluationError::NotFinite { vertex });
        }

        let face_normals: Vec<Vec3> = triangles.iter().map(|t| face_normal(truth, t)).collect();
        let mut normals = vec![Vec3::zeros(); truth.len()];
        for (t, normal) in triangles.iter().zip(&face_normals) {
            for &v in t {
                normals[v as usize] += normal;
            }
        }
        let mut errors = VertexErrors {
            distance: Vec::with_capacity(truth.len()),
            normal: Vec::with_capacity(truth.len()),
            tangential: Vec::with_capacity(truth.len()),
        };
        for ((v, t), n) in result.iter().zip(truth).zip(&normals) {
            let e = v - t;
            let normal = e.dot(&(n / n.norm().max(LEAST_LENGTH))).abs();
            errors.distance.push(e.norm());
            errors.normal.push(normal);
            let along = e.norm_squared() - normal * normal;
            // `max` would turn a NaN into 0 and hide it.
            errors.tangential.push(if along < 0.0 { 0.0 } else { along.sqrt() });
        }
        let pick = |values: &[f64], wanted: bool| -> Vec<f64> {
            values.iter().zip(observed).filter(|(_, o)| **o == wanted).map(|(v, _)| *v).collect()
        };
        let mut seen = pick(&errors.distance, true);
        let rmse = root_mean_square(&seen);
        seen.sort_unstable_by(f64::total_cmp);
        let at = |percent| if rmse.is_nan() { f64::NAN } else { of_sorted(&seen, percent).unwrap_or(0.0) };
        let turned = |(t, normal): (&[u32; 3], &Vec3)| face_normal(result, t).dot(normal) < 0.0;
        let summary = Self {
            rmse,
            median: at(50.0),
            p95: at(95.0),
            max: at(100.0),
            normal: root_mean_square(&pick(&errors.normal, true)),
            tangential: root_mean_square(&pick(&errors.tangential, true)),
            unobserved: observed.contains(&false).then(|| root_mean_square(&pick(&errors.distance, false))),
            flipped: triangles.iter().zip(&face_normals).filter(|pair| turned(*pair)).count(),
            observed_vertices: seen.len(),
            finite: result.iter().all(|v| v.iter().all(|c| c.is_finite())),
        };
        Ok((summary, errors))
    }
}

/// Shorter vectors keep their direction but are not lengthened to one.
const LEAST_LENGTH: f64 = 1e-12;

/// Unit normal of a triangle; (almost) zero for a degenerate one.
pub(super) fn face_normal(positions: &[Vec3], t: &[u32; 3]) -> Vec3 {
    let [a, b, c] = t.map(|v| positions[v as usize]);
    let n = (b - a).cross(&(c - a));
    n / n.norm().max(LEAST_LENGTH)
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit square in the plane z = 0, facing +Z.
    fn square() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let p = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
        (p.to_vec(), vec![[0, 1, 2], [0, 2, 3]])
    }

    #[test]
    fn errors_split_along_and_off_the_surface() {
        let (truth, triangles) = square();
        let mut result = truth.clone();
        result[0] += Vec3::new(3.0, 0.0, 4.0); // distance 5, off 4, slide 3
        result[1] += Vec3::new(0.0, 0.0, -1.0); // distance 1, off 1
        result[3] += Vec3::new(0.0, 2.0, 0.0); // not observed
        let observed = [true, true, true, false];
        let (e, per_vertex) = TruthErrors::new(&result, &truth, &observed, &triangles).unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(e.rmse, (26.0f64 / 3.0).sqrt());
        close(e.median, 1.0);
        close(e.p95, 1.0 + 0.9 * 4.0);
        close(e.max, 5.0);
        close(e.normal, (17.0f64 / 3.0).sqrt());
        close(e.tangential, 3.0f64.sqrt());
        close(e.unobserved.unwrap(), 2.0);
        close(per_vertex.tangential[0], 3.0);
        assert!(e.finite && e.observed_vertices == 3);
        assert!(per_vertex.observed_distance(&observed)[3].is_nan());
    }

    #[test]
    fn flips_are_counted_and_a_perfect_result_has_no_error() {
        let (truth, triangles) = square();
        let (e, _) = TruthErrors::new(&truth, &truth, &[true; 4], &triangles).unwrap();
        assert_eq!((e.rmse, e.max, e.normal, e.tangential, e.unobserved, e.flipped), (0.0, 0.0, 0.0, 0.0, None, 0));
        let mut folded = truth.clone();
        folded[3] = Vec3::new(2.0, 0.0, 0.0); // over the diagonal
        let (e, _) = TruthErrors::new(&folded, &truth, &[true; 4], &triangles).unwrap();
        assert_eq!(e.flipped, 1);
    }

    #[test]
    fn bad_input_is_named_and_nan_is_reported() {
        let (truth, triangles) = square();
        let short = TruthErrors::new(&truth[..3], &truth, &[true; 4], &triangles).unwrap_err();
        assert_eq!(
            short.to_string(),
            "the result has 3 vertices where 4 were expected; both must have the template's vertex order"
        );
        assert!(TruthErrors::new(&truth, &truth, &[true; 4], &[[0, 1, 9]]).is_err());
        let mut broken = truth.clone();
        broken[2].x = f64::NAN;
        let (e, _) = TruthErrors::new(&broken, &truth, &[true; 4], &triangles).unwrap();
        assert!(!e.finite && e.rmse.is_nan() && e.max.is_nan() && e.tangential.is_nan());
        let unknown = TruthErrors::new(&truth, &broken, &[true; 4], &triangles).unwrap_err();
        assert_eq!(unknown.to_string(), "the truth is not finite at vertex 2");
        let unseen = TruthErrors::new(&truth, &truth, &[false; 4], &triangles).unwrap_err();
        assert_eq!(unseen.to_string(), "no vertex is observed, so there is nothing to measure");
    }
}
