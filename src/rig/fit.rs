//! The weights of a rig's shapes that explain a mesh of the same topology, and of a sequence of them, such as a registered
//! performance.
//!
//! ```text
//!     min over w, s, R, t   sum_i |s R (b_i(w) - c) + t - y_i|^2  +  lambda |w|^2       l <= w <= u
//! ```
//!
//! b_i(w): the blended vertices of [`ShapeBasis`], c: the centroid of the neutral, y_i: the vertices of the mesh. Weights and
//! pose are found together by Levenberg-Marquardt with exact bounds; each frame starts from the one before.

use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3};

use super::{RigError, ShapeBasis, Unlike, likeness};
use crate::mesh::{PolygonMesh, Pose, PoseError, PoseKind, Vec3, closest_pose};
use crate::nlls::{BlockStructure, BorderBounds, Minimizer, NormalEquations, Options, Problem, StopReason, Workspace};

/// How to fit weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightFitOptions {
    /// Smallest and largest weight. Default 0 and 1.
    pub bounds: [f64; 2],
    /// What is fitted beside the weights; `None` for meshes that lie as the neutral does. Default rigid motions.
    pub pose: Option<PoseKind>,
    /// `lambda` as a share of the largest `|delta_k|^2`: keeps weights at zero that nothing tells apart. Default 1e-8.
    pub regularisation: f64,
}

impl Default for WeightFitOptions {
    fn default() -> Self {
        Self { bounds: [0.0, 1.0], pose: Some(PoseKind::Rigid), regularisation: 1e-8 }
    }
}

/// What a frame comes to.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct FittedFrame {
    /// In the order of the shapes.
    pub weights: Vec<f64>,
    /// From the blended neutral to the mesh: `y = s R b + t`.
    pub pose: Pose,
    /// Root mean square distance between the vertices of the mesh and of the rig, millimetres.
    pub rms: f64,
    /// The largest distance, millimetres.
    pub max: f64,
    /// Whether the minimiser came to rest within its iterations.
    pub converged: bool,
    /// What looks as if the mesh had not the vertices of the rig, or the rig not the shapes of the mesh.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<String>,
}

/// Fits the frames of a sequence one after the other; what depends on the rig alone is computed once.
#[derive(Debug)]
pub struct WeightFitter {
    /// Vertices of a frame, those of no polygon included.
    vertex_count: usize,
    /// Those that count.
    vertices: Vec<u32>,
    problem: Fit,
    minimizer: Minimizer,
    workspace: Workspace,
    /// The last frame's parameters.
    x: Option<Vec<f64>>,
}

impl WeightFitter {
    /// A fitter of these shapes on a neutral. Where `mesh` says what is surface, vertices of no polygon do not count.
    ///
    /// # Errors
    /// When there are no shapes, the neutral has another number of vertices than they have, or the bounds are not in order.
    pub fn new(
        neutral: &[Vec3],
        mesh: Option<&PolygonMesh>,
        basis: ShapeBasis,
        options: &WeightFitOptions,
    ) -> Result<Self, RigError> {
        let (found, expected) = (neutral.len(), basis.vertex_count());
        if basis.is_empty() || found != expected {
            return Err(RigError::VertexCount { what: "the neutral of the shapes to fit".into(), found, expected });
        }
        let [lower, upper] = options.bounds;
        // written so that NaN fails
        if !(lower <= upper && lower.is_finite() && upper.is_finite() && options.regularisation >= 0.0) {
            return Err(RigError::Weights { bounds: options.bounds, regularisation: options.regularisation });
        }
        let solver = Options { gradient_tolerance: 0.0, damping_floor: 1e-14, ..Options::default() };
        let minimizer = Minimizer::new(solver).expect("proven: the defaults are within bounds");
        let on_surface = mesh.map_or_else(|| vec![true; found], PolygonMesh::on_surface);
        let vertices: Vec<u32> = (0..).zip(on_surface).filter(|(_, on)| *on).map(|(v, _)| v).collect();
        let problem = if vertices.len() == found {
            Fit::new(neutral, basis, options)
        } else {
            Fit::new(&chosen(neutral, &vertices), basis.masked(&vertices, &vec![1.0; vertices.len()]), options)
        };
        let (vertex_count, workspace) = (found, Workspace::new());
        Ok(Self { vertex_count, vertices, problem, minimizer, workspace, x: None })
    }

    /// Fits the next frame, vertices in millimetres; it starts where the last one ended.
    ///
    /// # Errors
    /// When the frame has another number of vertices, is not finite, has no pose or is no mesh of this rig
    /// ([`Unlike`](super::Unlike)), or the minimiser fails.
    pub fn fit(&mut self, frame: &[Vec3]) -> Result<FittedFrame, RigError> {
        let problem = &mut self.problem;
        let (found, expected) = (frame.len(), self.vertex_count);
        if found != expected {
            return Err(RigError::VertexCount { what: "the frame".into(), found, expected });
        }
        if let Some(vertex) = frame.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(RigError::NotFinite { what: "the frame".into(), vertex });
        }
        let frame = &chosen(frame, &self.vertices)[..];
        let unlike = |why| RigError::Unlike { what: "the frame", of: likeness::OF_RIG, why };
        let mut doubts = likeness::compare(&problem.neutral, &[], frame).map_err(unlike)?.doubts;
        doubts.retain(|doubt| !matches!(doubt, Unlike::Far { .. })); // expressions are: what the fit leaves counts
        problem.frame.clear();
        problem.frame.extend_from_slice(frame);
        let mut x = match self.x.take() {
            Some(x) => x,
            None => problem.start()?,
        };
        let summary = self.minimizer.minimize_with(problem, &mut x, &mut self.workspace, &mut crate::nlls::Silent);
        // at an energy of rounding alone no step lowers it
        let converged = summary.stop.converged() || summary.stop == StopReason::NoDecrease;
        if !converged && summary.stop != StopReason::MaxIterations {
            return Err(RigError::Fit { reason: summary.stop.to_string() });
        }
        let (pose, w) = Fit::parts(&x);
        let blended = problem.blended(w);
        let squares = blended.iter().zip(frame).map(|(b, y)| (pose.apply(*b) - y).norm_squared());
        let (sum, max) = squares.fold((0.0, 0.0f64), |(sum, max), d| (sum + d, max.max(d)));
        let translation = pose.translation - pose.rotation * problem.centroid * pose.scale;
        let rms = (sum / frame.len() as f64).sqrt();
        doubts.extend(likeness::unexplained(frame, rms));
        let fitted = FittedFrame {
            weights: w.to_vec(),
            pose: Pose { translation, ..pose },
            rms,
            max: max.sqrt(),
            converged,
            doubts: doubts.iter().map(ToString::to_string).collect(),
        };
        self.x = Some(x);
        Ok(fitted)
    }
}

fn chosen(points: &[Vec3], vertices: &[u32]) -> Vec<Vec3> {
    vertices.iter().map(|&v| points[v as usize]).collect()
}

/// Scale, rotation by columns and translation, ahead of the weights in `x`.
const POSE: usize = 13;

/// The problem of one frame. Tangent of the pose, in the rig's frame: turn, translation, logarithm of the scale.
#[derive(Debug)]
struct Fit {
    /// Relative to `centroid`.
    neutral: Vec<Vec3>,
    centroid: Vec3,
    basis: ShapeBasis,
    structure: Arc<BlockStructure>,
    bounds: [Vec<f64>; 2],
    lambda: f64,
    /// `B' B`, row-major.
    gram: Vec<f64>,
    frame: Vec<Vec3>,
    pose: Option<PoseKind>,
}

impl Fit {
    fn new(neutral: &[Vec3], basis: ShapeBasis, options: &WeightFitOptions) -> Self {
        let count = basis.len();
        let mut gram = vec![0.0; count * count];
        for i in 0..neutral.len() {
            let displacements: Vec<Vec3> = (0..count).map(|k| basis.displacement(i, k)).collect();
            for (k, d) in displacements.iter().enumerate().filter(|(_, d)| **d != Vec3::zeros()) {
                for (l, e) in displacements[..=k].iter().enumerate() {
                    gram[k * count + l] += d.dot(e);
                }
            }
        }
        let largest = (0..count).map(|k| gram[k * count + k]).fold(0.0, f64::max);
        let centroid = neutral.iter().sum::<Vec3>() / neutral.len() as f64;
        let structure = match options.pose {
            None => BlockStructure::dense(count),
            Some(kind) => {
                let size = if kind == PoseKind::Rigid { 6 } else { 7 };
                BlockStructure::new(&[size], [], count).expect("proven: there are no pairs")
            }
        };
        Self {
            neutral: neutral.iter().map(|p| p - centroid).collect(),
            centroid,
            structure: Arc::new(structure),
            bounds: options.bounds.map(|b| vec![b; count]),
            lambda: options.regularisation * largest,
            gram,
            frame: Vec::new(),
            pose: options.pose,
            basis,
        }
    }

    /// The neutral in the pose closest to the frame.
    fn start(&self) -> Result<Vec<f64>, RigError> {
        let pairs: Vec<(Vec3, Vec3)> = self.neutral.iter().copied().zip(self.frame.iter().copied()).collect();
        let pose = match self.pose {
            None => Pose { translation: self.centroid, ..Pose::identity() },
            Some(kind) => {
                closest_pose(&pairs, kind).map_err(|source: PoseError| RigError::Fit { reason: source.to_string() })?
            }
        };
        let mut x = vec![pose.scale];
        x.extend(pose.rotation.iter());
        x.extend(pose.translation.iter());
        x.extend(self.bounds[0].iter().zip(&self.bounds[1]).map(|(l, u)| 0.0f64.clamp(*l, *u)));
        Ok(x)
    }

    fn parts(x: &[f64]) -> (Pose, &[f64]) {
        let (pose, w) = x.split_at(POSE);
        let rotation = Matrix3::from_column_slice(&pose[1..10]);
        (Pose { scale: pose[0], rotation, translation: Vec3::from_column_slice(&pose[10..]) }, w)
    }

    fn blended(&self, w: &[f64]) -> Vec<Vec3> {
        self.neutral.iter().enumerate().map(|(i, n)| self.basis.blend(i, *n, w)).collect()
    }
}

impl Problem for Fit {
    fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    fn parameter_len(&self) -> usize {
        POSE + self.basis.len()
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        let (pose, w) = Self::parts(x);
        let residual = |(i, y): (usize, &Vec3)| pose.apply(self.basis.blend(i, self.neutral[i], w)) - y;
        let data: f64 = self.frame.iter().enumerate().map(residual).map(|r| r.norm_squared()).sum();
        data + self.lambda * w.iter().map(|w| w * w).sum::<f64>()
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        let (Pose { scale, rotation, translation }, w) = Self::parts(x);
        let (count, size) = (self.basis.len(), self.structure.sparse_dimension());
        equations.clear();
        let (of_pose, of_weights) = equations.gradient.split_at_mut(size);
        let mut energy = 0.0;
        for (i, y) in self.frame.iter().enumerate() {
            let b = self.basis.blend(i, self.neutral[i], w);
            // in the rig's frame, where all derivatives are simple
            let r = b * scale + rotation.tr_mul(&(translation - y));
            energy += r.norm_squared();
            // columns: turn -s [b]x, translation I, logarithm of the scale s b
            let s = b * scale;
            let rows = [
                [0.0, s.z, -s.y, 1.0, 0.0, 0.0, s.x],
                [-s.z, 0.0, s.x, 0.0, 1.0, 0.0, s.y],
                [s.y, -s.x, 0.0, 0.0, 0.0, 1.0, s.z],
            ];
            for (a, row) in rows.iter().enumerate() {
                for (p, jp) in row[..size].iter().enumerate() {
                    of_pose[p] += jp * r[a];
                    for (q, jq) in row[..size].iter().enumerate() {
                        equations.blocks[p * size + q] += jp * jq;
                    }
                }
            }
            for (shapes, slab) in self.basis.vertex(i) {
                for ((row, residual), displacements) in rows.iter().zip(r.iter()).zip(slab.chunks_exact(shapes.len())) {
                    for (p, jp) in row[..size].iter().enumerate() {
                        let cross = &mut equations.cross[p * count..][shapes.clone()];
                        cross.iter_mut().zip(displacements).for_each(|(c, d)| *c += scale * jp * f64::from(*d));
                    }
                    let gradient = &mut of_weights[shapes.clone()];
                    gradient.iter_mut().zip(displacements).for_each(|(g, d)| *g += scale * residual * f64::from(*d));
                }
            }
        }
        for (h, g) in equations.border.iter_mut().zip(&self.gram) {
            *h = scale * scale * g;
        }
        for (k, w) in w.iter().enumerate() {
            equations.border[k * count + k] += self.lambda;
            of_weights[k] += self.lambda * w;
            energy += self.lambda * w * w;
        }
        energy
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        out.copy_from_slice(x);
        let size = self.structure.sparse_dimension();
        let (of_pose, of_weights) = step.split_at(size);
        if size > 0 {
            let (pose, _) = Self::parts(x);
            let turned = pose.rotation * Rotation3::new(Vec3::from_column_slice(&of_pose[..3])).into_inner();
            let moved = pose.translation + pose.rotation * Vec3::from_column_slice(&of_pose[3..6]);
            out[0] = pose.scale * of_pose.get(6).map_or(1.0, |d| d.exp());
            out[1..10].copy_from_slice(turned.as_slice());
            out[10..13].copy_from_slice(moved.as_slice());
        }
        out[POSE..].iter_mut().zip(of_weights).for_each(|(w, d)| *w += d);
    }

    fn border_bounds(&self) -> Option<BorderBounds<'_>> {
        Some(BorderBounds { first: POSE, lower: &self.bounds[0], upper: &self.bounds[1] })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Family, Rig, Shape, ShapeSelection};
    use super::*;
    use crate::mesh::testing::{noise, sheet};
    use crate::nlls::{GradientCheck, check_gradient};

    fn rig() -> Rig {
        let neutral = sheet(8, 6, |x, y| Vec3::new(50.0 + 10.0 * x, 10.0 * y, 4.0 * (x * y).sin())).positions;
        let n = neutral.len();
        let shapes = (0..5).map(|k| Shape { name: format!("s{k}"), family: Family::Expression }).collect();
        let deltas = (0..5 * 3 * n).map(|i| 5.0 * noise(i) as f32).collect();
        Rig::new(neutral, None, shapes, deltas).unwrap().0
    }

    fn blended(rig: &Rig, w: &[f64], pose: &Pose) -> Vec<Vec3> {
        let basis = rig.select(ShapeSelection::default()).unwrap();
        rig.neutral().iter().enumerate().map(|(i, n)| pose.apply(basis.blend(i, *n, w))).collect()
    }

    fn fitter(rig: &Rig, options: &WeightFitOptions) -> WeightFitter {
        WeightFitter::new(rig.neutral(), rig.mesh(), rig.select(ShapeSelection::default()).unwrap(), options).unwrap()
    }

    #[test]
    fn vertices_of_no_polygon_do_not_count() {
        let mesh = PolygonMesh::from(sheet(8, 6, |x, y| Vec3::new(10.0 * x, 10.0 * y, 4.0 * (x * y).sin())));
        let mut with_strays = mesh.clone();
        with_strays.positions.extend([Vec3::zeros(); 5]);
        let n = with_strays.positions.len();
        let shapes = (0..3).map(|k| Shape { name: format!("s{k}"), family: Family::Expression }).collect();
        let surface = 3 * mesh.positions.len();
        let deltas = (0..3 * 3 * n).map(|i| if i % (3 * n) < surface { 5.0 * noise(i) as f32 } else { 0.0 }).collect();
        let (rig, _) = Rig::new(with_strays.positions.clone(), Some(with_strays), shapes, deltas).unwrap();
        let weights = [0.2, 0.7, 0.4];
        let pose = Pose::rigid(Vec3::new(0.1, -0.2, 0.3), Vec3::new(300.0, 20.0, -7.0));
        let mut frame = blended(&rig, &weights, &pose);
        frame[n - 5..].fill(Vec3::zeros());
        let fitted = fitter(&rig, &WeightFitOptions::default()).fit(&frame).unwrap();
        assert!(fitted.weights.iter().zip(weights).all(|(f, w)| (f - w).abs() < 1e-4), "{fitted:?}");
        assert!(fitted.max < 1e-3 && fitted.doubts.is_empty(), "{fitted:?}");
    }

    #[test]
    fn weights_and_pose_of_a_sequence_are_found() {
        let rig = rig();
        for (kind, scale) in [(None, 1.0), (Some(PoseKind::Rigid), 1.0), (Some(PoseKind::Similarity), 1.3)] {
            let mut fitter = fitter(&rig, &WeightFitOptions { pose: kind, ..WeightFitOptions::default() });
            for frame in 0..4 {
                let truth: Vec<f64> = (0..5).map(|k| 0.5 + 0.5 * noise(10 * frame + k)).collect();
                let turn = Vec3::new(0.3, -0.2, 0.1) * frame as f64;
                let pose = Pose { scale, ..Pose::rigid(turn, Vec3::new(5.0, 9.0, -7.0)) };
                let pose = if kind.is_some() { pose } else { Pose::identity() };
                let found = fitter.fit(&blended(&rig, &truth, &pose)).unwrap();
                let far = found.weights.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(far < 1e-5 && found.max < 1e-4, "{kind:?}, frame {frame}: {far}, {}", found.max);
                assert!((found.pose.translation - pose.translation).norm() < 1e-3);
            }
        }
    }

    /// Beyond the bounds the fit is the best inside: no weight can be moved within them to a lower energy.
    #[test]
    fn bounds_hold_and_what_is_left_is_the_best() {
        let rig = rig();
        let mut fitter = fitter(&rig, &WeightFitOptions { regularisation: 0.0, ..WeightFitOptions::default() });
        let target = blended(&rig, &[1.6, -0.4, 0.3, 0.8, 1.2], &Pose::identity());
        let found = fitter.fit(&target).unwrap();
        assert!(found.weights.iter().all(|w| (0.0..=1.0).contains(w)), "{:?}", found.weights);
        assert_eq!((found.weights[0], found.weights[1], found.weights[4]), (1.0, 0.0, 1.0));
        let x = fitter.x.clone().unwrap();
        let least = fitter.problem.energy(&x);
        for k in 0..5 {
            for step in [-1e-3, 1e-3] {
                let mut other = x.clone();
                other[POSE + k] = (other[POSE + k] + step).clamp(0.0, 1.0);
                assert!(fitter.problem.energy(&other) >= least);
            }
        }
    }

    #[test]
    fn derivatives_are_right() {
        let rig = rig();
        for pose in [None, Some(PoseKind::Rigid), Some(PoseKind::Similarity)] {
            let options = WeightFitOptions { pose, regularisation: 0.1, ..WeightFitOptions::default() };
            let mut fitter = fitter(&rig, &options);
            fitter.problem.frame = blended(&rig, &[0.2; 5], &Pose::rigid(Vec3::new(0.1, 0.2, 0.3), Vec3::x()));
            let mut x = fitter.problem.start().unwrap();
            x[POSE..].copy_from_slice(&[0.7, 0.1, 0.4, 0.3, 0.9]);
            let report = check_gradient(&mut fitter.problem, &x, GradientCheck::default());
            assert!(report.passed(), "{report}");
        }
    }

    #[test]
    fn what_cannot_be_fitted_is_named() {
        let rig = rig();
        let basis = || rig.select(ShapeSelection::default()).unwrap();
        let new = |neutral: &[Vec3], basis, bounds| {
            let options = WeightFitOptions { bounds, ..WeightFitOptions::default() };
            WeightFitter::new(neutral, None, basis, &options).unwrap_err().to_string()
        };
        assert!(new(&rig.neutral()[1..], basis(), [0.0, 1.0]).contains("found 47 vertices, expected 48"));
        assert!(new(rig.neutral(), ShapeBasis::none(), [0.0, 1.0]).contains("vertices"));
        assert!(new(rig.neutral(), basis(), [1.0, 0.0]).contains("bounds"));
        assert!(new(rig.neutral(), basis(), [f64::NAN, 0.0]).contains("bounds"));
        let mut fitter = fitter(&rig, &WeightFitOptions::default());
        assert!(fitter.fit(&rig.neutral()[1..]).unwrap_err().to_string().contains("found 47"));
        assert!(fitter.fit(&[Vec3::repeat(f64::INFINITY); 48]).unwrap_err().to_string().contains("not finite"));
        assert!(fitter.fit(&[Vec3::zeros(); 48]).is_err());
    }
}
