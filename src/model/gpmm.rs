//! Gaussian-process morphable model (M. Luethi, T. Gerig, C. Jud, T. Vetter, "Gaussian process morphable models", PAMI 40(8), 2018; the
//! program scalismo): displacements are a Gaussian process, so a smooth prior becomes a linear model like one learnt from shapes.
//!
//! ```text
//!     u ~ GP(0, k),   k(x, y) = sum_s sigma_s^2 exp(-|x - y|^2 / l_s^2) 1          1: 3 x 3
//!     u(x) = sum_k w_k sqrt(lambda_k) phi_k(x),   w_k ~ N(0, 1)                    Karhunen-Loeve, cut at the rank
//!     v_i = R (n_i + u(n_i)) + t                  E_smooth = lambda_blend sum_k w_k^2
//! ```
//!
//! `phi_k` are orthonormal over the surface's area. The axes do not depend on each other, so every function of the scalar kernel gives
//! three shapes. With a rig (`gpmm_rig`) its shapes are added to these: the sum of a kernel learnt from examples and a smooth one, as the
//! paper has it in section 3.3.
//!
//! The functions come from a pivoted Cholesky factor, `K = G G'` for the kernel at all pairs of vertices (Harbrecht, Peters, Schneider
//! 2012): the pivot is the vertex that the columns so far explain least, so K itself is never built. `G U`, with `U` the eigenvectors of
//! `G' A G` and `A` the vertices' share of the area, holds the `sqrt(lambda_k) phi_k`. It is an ordinary basis of shapes: the hybrid with
//! one node hosts it.

use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::factory::BuiltIn;
use super::{
    Blendshape, BlendshapeLevel, Hybrid, ModelError, ModelInput, NodeGraph, PatchInput, RegistrationModel, Stiffness,
    blendshape_in_place,
};
use crate::energy::{DeformationModel, OptionTable, OptionsError};
use crate::mesh::normals::vertex_areas;
use crate::mesh::{MeshError, TriangleMesh, Vec3, bounding_box_diagonal};
use crate::rig::{Family, Shape, ShapeBasis};

/// A Gaussian kernel, `sigma^2 exp(-|x - y|^2 / length^2)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussianKernel {
    /// Standard deviation of the displacement along each axis, millimetres of the schedule.
    pub sigma: f64,
    /// Distance over which displacements are alike, millimetres of the schedule.
    pub length: f64,
}

impl GaussianKernel {
    /// Refused under the names that the schedule has for sigma and length.
    pub(super) fn check(&self, [sigma, length]: [&str; 2]) -> Result<(), OptionsError> {
        OptionsError::positive(sigma, self.sigma)?;
        OptionsError::positive(length, self.length)
    }
}

/// `[model]` of Gaussian-process morphable models.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GpmmOptions {
    /// Gaussian kernels that are summed: each `{ sigma, length }`, the standard deviation of the displacement along an axis and the
    /// distance over which displacements are alike, millimetres.
    pub kernels: Vec<GaussianKernel>,
    /// Number of smooth shapes at most, three for each function.
    pub rank: usize,
    /// Share of the displacements' variance over the surface that may be left out; with it fewer shapes than `rank` may do.
    pub tolerance: f64,
}

impl Default for GpmmOptions {
    fn default() -> Self {
        let kernel = |sigma, length| GaussianKernel { sigma, length };
        Self { kernels: vec![kernel(5.0, 70.0), kernel(3.0, 35.0)], rank: 201, tolerance: 1e-4 }
    }
}

impl OptionTable for GpmmOptions {
    fn check(&self) -> Result<(), OptionsError> {
        self.kernels.iter().try_for_each(|kernel| kernel.check(["kernels.sigma", "kernels.length"]))?;
        if self.kernels.is_empty() {
            return Err(OptionsError::Conflict { key: "kernels", reason: "there must be one at least" });
        }
        if self.rank > MOST_SHAPES {
            return Err(OptionsError::Conflict { key: "rank", reason: "it must be at most 3000" });
        }
        OptionsError::count("rank", self.rank)?;
        OptionsError::not_negative("tolerance", self.tolerance)
    }
}

/// Greatest rank: factorisations grow with its cube.
pub(super) const MOST_SHAPES: usize = 3000;

/// Columns of the Cholesky factor for each function that is kept.
const OVERSAMPLING: usize = 3;

/// Vertices of a task.
const CHUNK: usize = 512;

impl GpmmOptions {
    /// The shapes `sqrt(lambda_k) phi_k` at the vertices of `mesh`, by falling variance, x, y and z of each function. `unit` is the mesh'
    /// length of one of the options' millimetres. Vertices of no triangle move as the process says there, but do not count.
    ///
    /// # Errors
    /// When a position is not finite or a triangle indexes past the vertices.
    pub fn basis(&self, mesh: &TriangleMesh, unit: f64) -> Result<ShapeBasis, MeshError> {
        mesh.check()?;
        let n = &mesh.positions;
        let mut areas = vertex_areas(n, &mesh.triangles);
        if areas.iter().sum::<f64>() <= 0.0 {
            areas.fill(1.0);
        }
        let functions = self.rank.div_ceil(3);
        let (factor, columns) = self.cholesky(n, &areas, unit, OVERSAMPLING * functions);

        // G'AG in chunks of fixed size, summed in order.
        let chunks: Vec<DMatrix<f64>> = (factor.par_chunks(CHUNK * columns.max(1)).zip(areas.par_chunks(CHUNK)))
            .map(|(rows, areas)| {
                let g = DMatrix::from_row_slice(areas.len(), columns, rows);
                let weighted = DMatrix::from_fn(areas.len(), columns, |i, m| areas[i] * g[(i, m)]);
                g.tr_mul(&weighted)
            })
            .collect();
        let gram = chunks.iter().fold(DMatrix::zeros(columns, columns), |sum, chunk| sum + chunk);
        let eigen = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..columns).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let total: f64 = self.kernels.iter().map(|k| (k.sigma * unit).powi(2)).sum::<f64>() * areas.iter().sum::<f64>();
        let mut left = total;
        let kept = order.iter().take(functions).take_while(|&&k| {
            let needed = left > self.tolerance * total && eigen.eigenvalues[k] > 0.0;
            left -= eigen.eigenvalues[k];
            needed
        });
        let kept: Vec<usize> = kept.copied().collect();
        let turn = DMatrix::from_fn(columns, kept.len(), |m, k| eigen.eigenvectors[(m, kept[k])]);

        let shapes = (0..kept.len()).flat_map(|k| {
            ["x", "y", "z"].map(|axis| Shape { name: format!("smooth_{k}_{axis}"), family: Family::Other })
        });
        let width = 3 * kept.len();
        let mut slab = vec![0f32; 3 * n.len() * width];
        let slabs = slab.par_chunks_exact_mut((3 * width).max(1)).with_min_len(CHUNK);
        slabs.zip(factor.par_chunks_exact(columns.max(1))).for_each(|(slab, row)| {
            for k in 0..kept.len() {
                let value: f64 = row.iter().zip(turn.column(k)).map(|(g, u)| g * u).sum();
                (0..3).for_each(|a| slab[a * width + 3 * k + a] = value as f32);
            }
        });
        Ok(ShapeBasis::new(shapes.collect(), slab))
    }

    /// `G`, row by row, and its number of columns: at most `most`, fewer where rounding is all that is left.
    fn cholesky(&self, n: &[Vec3], areas: &[f64], unit: f64, most: usize) -> (Vec<f64>, usize) {
        let most = most.min(areas.iter().filter(|a| **a > 0.0).count());
        let kernels: Vec<[f64; 2]> =
            self.kernels.iter().map(|k| [(k.sigma * unit).powi(2), -(k.length * unit).powi(-2)]).collect();
        let kernel = |d: f64| kernels.iter().map(|[variance, rate]| variance * (rate * d).exp()).sum::<f64>();
        let full = kernel(0.0);
        let mut left = vec![full; n.len()];
        let mut factor = vec![0.0; n.len() * most];
        for m in 0..most {
            let candidates = (0..n.len()).filter(|&i| areas[i] > 0.0);
            // The first of the largest.
            let Some(pivot) = candidates.reduce(|best, i| if left[i] > left[best] { i } else { best }) else { break };
            if left[pivot] <= 1e-12 * full {
                let rows = factor.chunks_exact(most).flat_map(|row| row[..m].iter().copied());
                return (rows.collect(), m);
            }
            let root = left[pivot].sqrt();
            let own = factor[pivot * most..pivot * most + m].to_vec();
            let tasks = factor.par_chunks_mut(CHUNK * most).zip(left.par_chunks_mut(CHUNK)).zip(n.par_chunks(CHUNK));
            tasks.for_each(|((rows, left), n_of)| {
                for ((row, left), p) in rows.chunks_exact_mut(most).zip(left).zip(n_of) {
                    let known: f64 = row[..m].iter().zip(&own).map(|(a, b)| a * b).sum();
                    row[m] = (kernel((p - n[pivot]).norm_squared()) - known) / root;
                    *left -= row[m] * row[m];
                }
            });
        }
        (factor, most)
    }
}

/// The model on the rest shape of `mesh`: the smooth shapes of `options`, after those of a `rig` if it has any. `unit` as for
/// [`GpmmOptions::basis`].
///
/// # Errors
/// As [`GpmmOptions::basis`].
///
/// # Panics
/// If the rig's shapes are not of as many vertices.
pub fn gpmm(
    mesh: &TriangleMesh,
    options: &GpmmOptions,
    unit: f64,
    rig: &ShapeBasis,
    lambda_blend: f64,
) -> Result<Blendshape, MeshError> {
    let graph = NodeGraph::single(super::centroid(&mesh.positions), mesh.positions.len());
    let shapes = rig.joined(&options.basis(mesh, unit)?);
    let stiffness = Stiffness { blend: lambda_blend, ..Stiffness::default() };
    let mut model = Hybrid::named("gpmm", mesh.positions.clone(), graph, shapes, stiffness);
    model.reported_shapes = rig.len();
    Ok(model)
}

/// The process alone.
pub(super) const MODEL: BuiltIn =
    BuiltIn::new::<GpmmOptions>("gpmm", include_str!("schedules/gpmm.toml"), |input| build(input, &ShapeBasis::none()))
        .with_level::<BlendshapeLevel>()
        .on_patch(&["prior"], build_on_patch);

/// The process and the blendshapes.
pub(super) const WITH_RIG: BuiltIn =
    BuiltIn::new::<GpmmOptions>("gpmm_rig", include_str!("schedules/gpmm_rig.toml"), |input| {
        build(input, input.shapes)
    })
    .with_level::<BlendshapeLevel>()
    .needing_shapes();

fn build(input: &ModelInput<'_>, rig: &ShapeBasis) -> Result<Box<dyn RegistrationModel>, ModelError> {
    Ok(Box::new(gpmm(input.rest, &input.options.read()?, input.unit, rig, 0.0)?))
}

/// Smooth shapes within the mask, of kernels half and a quarter as long as the patch.
fn build_on_patch(input: &PatchInput<'_>) -> Result<Box<dyn DeformationModel>, ModelError> {
    let options = GpmmOptions::default();
    let longest = options.kernels.iter().map(|k| k.length).fold(f64::MIN_POSITIVE, f64::max);
    let unit = 0.5 * bounding_box_diagonal(&input.mesh.positions) / longest;
    let all: Vec<u32> = (0..input.mask.len() as u32).collect();
    let smooth = options.basis(input.mesh, unit)?.masked(&all, input.mask);
    Ok(Box::new(blendshape_in_place(input.mesh.positions.clone(), smooth, input.shape_weight())))
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;

    use super::*;
    use crate::energy::{Deformation, DeformationModel, Samples};
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::model::blendshape_in_place;
    use crate::model::vertex_assembly::testing::pins;
    use crate::nlls::{Minimizer, Options};

    fn bumpy() -> TriangleMesh {
        sheet(9, 8, |c, r| {
            let k = (9.0 * r + c) as usize;
            Vec3::new(10.0 * c + 3.0 * noise(k), 10.0 * r + 3.0 * noise(k + 100), 4.0 * noise(k + 200))
        })
    }

    fn complete() -> GpmmOptions {
        let kernel = |sigma, length| GaussianKernel { sigma, length };
        GpmmOptions { kernels: vec![kernel(4.0, 40.0), kernel(1.5, 12.0)], rank: 3000, tolerance: 0.0 }
    }

    /// The scalar kernel of [`complete`], stated again.
    fn kernel(a: &Vec3, b: &Vec3) -> f64 {
        let d = (a - b).norm_squared();
        16.0 * (-d / 1600.0).exp() + 2.25 * (-d / 144.0).exp()
    }

    /// Covariance of coordinate `a` of vertex i and `b` of vertex j.
    fn covariance(basis: &ShapeBasis, [i, a]: [usize; 2], [j, b]: [usize; 2]) -> f64 {
        (0..basis.len()).map(|k| basis.displacement(i, k)[a] * basis.displacement(j, k)[b]).sum()
    }

    #[test]
    fn with_all_functions_the_covariance_is_the_kernel() {
        let mut mesh = bumpy();
        mesh.positions.push(Vec3::new(33.0, 21.0, 5.0)); // in no triangle: predicted from the others
        let basis = complete().basis(&mesh, 1.0).unwrap();
        assert_eq!(basis.len(), 3 * 72);
        for i in 0..72 {
            for j in 0..72 {
                let expected = kernel(&mesh.positions[i], &mesh.positions[j]);
                for (a, b) in [(0, 0), (1, 1), (2, 2), (0, 1), (2, 0)] {
                    let expected = if a == b { expected } else { 0.0 };
                    approx::assert_abs_diff_eq!(covariance(&basis, [i, a], [j, b]), expected, epsilon = 1e-4);
                }
            }
        }
        let loose = covariance(&basis, [72, 1], [72, 1]);
        assert!((10.0..18.25).contains(&loose), "{loose}");
    }

    #[test]
    fn functions_are_orthogonal_over_the_surface_and_the_best_of_their_number() {
        let mesh = bumpy();
        let areas = vertex_areas(&mesh.positions, &mesh.triangles);
        let total: f64 = areas.iter().sum();
        let symmetric = DMatrix::from_fn(72, 72, |i, j| {
            (areas[i] * areas[j]).sqrt() * kernel(&mesh.positions[i], &mesh.positions[j])
        });
        let mut eigenvalues: Vec<f64> = symmetric.symmetric_eigenvalues().iter().copied().collect();
        eigenvalues.sort_by(|a, b| b.total_cmp(a));
        let basis = GpmmOptions { rank: 60, ..complete() }.basis(&mesh, 1.0).unwrap();
        assert_eq!(basis.len(), 60);
        let product = |k: usize, l: usize| -> f64 {
            (0..72).map(|i| areas[i] * basis.displacement(i, k).x * basis.displacement(i, l).x).sum()
        };
        for k in 0..20 {
            // From three times as many columns of the factor: the last functions are a little off.
            let tolerance = if k < 10 { 0.01 } else { 0.05 };
            approx::assert_relative_eq!(product(3 * k, 3 * k), eigenvalues[k], max_relative = tolerance);
            for l in 0..k {
                assert!(product(3 * k, 3 * l).abs() < 1e-4 * product(0, 0), "{k} {l}");
            }
        }
        // The fewest that leave a tenth of the variance.
        let few = GpmmOptions { tolerance: 0.1, ..complete() }.basis(&mesh, 1.0).unwrap().len() / 3;
        let left = |count: usize| 1.0 - eigenvalues[..count].iter().sum::<f64>() / (18.25 * total);
        assert!(left(few) < 0.1 && left(few - 1) > 0.1, "{few}: {}", left(few));
    }

    /// The fit of some vertices is the posterior mean: `K_*o (K_oo + lambda 1)^-1 y`.
    #[test]
    fn fitting_points_is_regression_with_the_kernel() {
        let mesh = bumpy();
        let n = &mesh.positions;
        let observed: Vec<usize> = (0..72).step_by(5).collect();
        let targets: Vec<Vec3> =
            observed.iter().map(|&i| n[i] + Vec3::new(noise(i), 3.0 * noise(i + 50), noise(i + 80))).collect();
        let basis = complete().basis(&mesh, 1.0).unwrap();
        let mut problem = Deformation::new(blendshape_in_place(n.clone(), basis, 0.3), Samples::vertices(72));
        problem.terms = pins(&observed, &targets);
        let mut x = problem.model.rest_parameters();
        Minimizer::new(Options::gauss_newton()).unwrap().minimize(&mut problem, &mut x);
        let found = problem.vertices(&x).to_vec();
        let count = observed.len();
        let k = DMatrix::from_fn(count, count, |a, b| kernel(&n[observed[a]], &n[observed[b]]))
            + DMatrix::identity(count, count) * 0.3;
        let factor = k.cholesky().unwrap();
        for axis in 0..3 {
            let y = DVector::from_fn(count, |a, _| targets[a][axis] - n[observed[a]][axis]);
            let w = factor.solve(&y);
            for i in 0..72 {
                let mean: f64 = (0..count).map(|a| kernel(&n[i], &n[observed[a]]) * w[a]).sum();
                approx::assert_abs_diff_eq!(found[i][axis] - n[i][axis], mean, epsilon = 1e-4);
            }
        }
    }

    #[test]
    fn the_process_knows_neither_resolution_nor_unit() {
        let square = |n: usize, unit: f64| sheet(n, n, |c, r| Vec3::new(c, r, 0.0) * (100.0 * unit / (n - 1) as f64));
        let options = GpmmOptions { rank: 240, ..GpmmOptions::default() };
        let [coarse, fine, metres] =
            [(17, 1.0), (33, 1.0), (33, 1e-3)].map(|(n, unit)| options.basis(&square(n, unit), unit).unwrap());
        for (i, j) in [(0, 0), (3, 40), (100, 288), (144, 145)] {
            let at = |i: usize| 2 * (i % 17) + 66 * (i / 17);
            let [a, b] = [covariance(&coarse, [i, 0], [j, 0]), covariance(&fine, [at(i), 0], [at(j), 0])];
            approx::assert_abs_diff_eq!(a, b, epsilon = 0.02 * 34.0);
            let small = covariance(&metres, [at(i), 0], [at(j), 0]);
            approx::assert_abs_diff_eq!(small * 1e6, b, epsilon = 1e-4 * 34.0);
        }
    }

    #[test]
    fn a_rigs_shapes_come_first_with_their_priors_and_alone_have_weights_to_report() {
        let mesh = bumpy();
        let names = ["a", "b"].map(|name| Shape { name: name.into(), family: Family::Identity }).to_vec();
        let slab: Vec<f32> = (0..6 * 72).map(|k| noise(k) as f32).collect();
        let rig = ShapeBasis::new(names, slab).with_sigmas(|_| 0.5).with_bounds(|_| [-1.0, 2.0]);
        let smooth = complete().basis(&mesh, 1.0).unwrap();
        let model = gpmm(&mesh, &complete(), 1.0, &rig, 1.0).unwrap();
        let both = model.shapes();
        assert_eq!(both.len(), 2 + smooth.len());
        assert_eq!(both.sigmas()[..3], [0.5, 0.5, 1.0]);
        let (lower, upper) = both.bounds().unwrap();
        assert_eq!((lower[1], upper[1], lower[2], upper[2]), (-1.0, 2.0, f64::NEG_INFINITY, f64::INFINITY));
        let w: Vec<f64> = (0..both.len()).map(|k| noise(k + 9)).collect();
        for (i, n) in mesh.positions.iter().enumerate() {
            let expected = smooth.blend(i, rig.blend(i, *n, &w[..2]), &w[2..]);
            approx::assert_abs_diff_eq!(both.blend(i, *n, &w), expected, epsilon = 1e-12);
        }
        assert_eq!(model.named_weights(&model.rest_parameters()).len(), 2);
        let none = gpmm(&mesh, &complete(), 1.0, &ShapeBasis::none(), 1.0).unwrap();
        assert!(none.shapes().bounds().is_none() && none.named_weights(&none.rest_parameters()).is_empty());
    }

    #[test]
    fn small_and_broken_templates_have_shapes_too() {
        let one = TriangleMesh { positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y()], triangles: vec![[0, 1, 2]] };
        let flat = TriangleMesh { positions: vec![Vec3::x(); 4], triangles: vec![[0, 1, 2], [0, 0, 1]] };
        let apart = side_by_side(&bumpy(), &one);
        for (mesh, functions) in [(&one, 3), (&flat, 1), (&apart, 67)] {
            let basis = GpmmOptions { tolerance: 0.0, ..GpmmOptions::default() }.basis(mesh, 1.0).unwrap();
            assert!(basis.len() <= 3 * functions && basis.len() >= 3, "{}", basis.len());
            let variance = covariance(&basis, [0, 0], [0, 0]);
            approx::assert_relative_eq!(variance, 34.0, max_relative = 0.01);
        }
        let mut broken = one;
        broken.positions[1].z = f64::NAN;
        assert!(matches!(complete().basis(&broken, 1.0), Err(MeshError::NotFinite { vertex: 1, .. })));
    }

    #[test]
    fn options_out_of_bounds_are_named() {
        let check = |text: &str| {
            let options: crate::energy::Options = toml::from_str(text).unwrap();
            options.read::<GpmmOptions>().err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert_eq!(check("kernels = [{ sigma = 2.0, length = 20.0 }]"), "");
        assert!(check("kernels = [{ sigma = 2.0, length = 0.0 }]").contains("kernels.length = 0"));
        assert!(check("kernels = []").contains("kernels"));
        assert!(check("rank = 0").contains("rank") && check("rank = 9000").contains("rank"));
        assert!(check("tolerance = -1.0").contains("tolerance"));
    }
}
