//! Deformation transfer: the shapes of a rig on another face of the same topology, a personal rig from one neutral scan.
//!
//! ```text
//!     S_j  deformation gradient of source triangle j, with a fourth vertex v1 + n / sqrt(|n|) along its normal
//!     min over u   sum_j A_j |grad_j u - (S_j - I) P_j|^2  +  a / d^2 sum_i A_i |u_i - s R delta_i|^2
//! ```
//!
//! u: displacements of the subject's vertices; grad_j, A_j and P_j: gradient, area and tangent projection of its triangle j.
//! The first sum is R. Sumner, J. Popovic, "Deformation Transfer for Triangle Meshes", 2004, with the fourth vertices
//! eliminated and triangles weighted by area as in M. Botsch, R. Sumner, M. Pauly, M. Gross, "Deformation Transfer for
//! Detail-Preserving Surface Editing", 2006. Gradients say nothing of where each part of a mesh goes, such as the lower teeth;
//! the second sum does: each vertex' own displacement, carried over by the similarity p -> s R p + t that maps the rig's
//! neutral closest to the subject's; d is the diagonal of the subject's bounding box. The matrix, a cotangent Laplacian with a
//! small diagonal, is factorised once for all shapes.

use std::sync::Arc;

use nalgebra::Matrix3;
use rayon::prelude::*;

use super::{Family, Rig, RigError, RigWarning, Shape, ShapeSelection, WeightFitOptions, WeightFitter, likeness};
use crate::mesh::{PoseError, PoseKind, Vec3, bounding_box_diagonal, closest_pose};
use crate::nlls::linear::BorderedCholesky;
use crate::nlls::{BlockStructure, LinearError, LinearSolver as _, NormalEquations};

/// A triangle of less than this share of the squared diagonal has no gradient, on either face, and no say.
const DEGENERATE_SHARE: f64 = 1e-14;

/// A subject with more than this weight of an expression, which moves it by more than this share of its diagonal (7 mm of a face), is no neutral.
const EXPRESSION: (f64, f64) = (0.3, 0.025);
/// Bounds of the weights by which that is seen: those of identity modes are standard deviations.
const WEIGHTS: [f64; 2] = [-3.0, 3.0];

/// How to transfer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TransferOptions {
    /// `a`, how much vertices keep to their own displacement. Default 1: it decides where parts go, not their shape, since
    /// displacements that change over a tenth of the face have gradients that count thousands of times as much.
    pub anchor: f64,
}

impl Default for TransferOptions {
    fn default() -> Self {
        Self { anchor: 1.0 }
    }
}

/// Shapes cannot be transferred.
#[derive(Debug, thiserror::Error)]
pub enum TransferError {
    /// The rig has no polygons.
    #[error("the rig has no polygons, which say how its vertices hang together; add a template")]
    NoPolygons,
    /// The rig has identity modes alone, or nothing.
    #[error("the rig has no shapes to transfer; identity modes, which say how faces differ, are left out")]
    NoShapes,
    /// The anchor is no positive number.
    #[error("anchor: found {0}, expected a number above 0")]
    Anchor(f64),
    /// The faces have no common pose.
    #[error("the subject cannot be aligned with the rig's neutral: {0}")]
    Pose(#[from] PoseError),
    /// The equations cannot be solved.
    #[error("deformation transfer: {0}")]
    Linear(#[from] LinearError),
    /// The subject is of another topology, or the result is not finite.
    #[error(transparent)]
    Rig(#[from] RigError),
}

/// The corners of a triangle, area and gradients of its hat functions on the subject, inverse frame on the source.
struct Element {
    corners: [usize; 3],
    area: f64,
    gradients: [Vec3; 3],
    inverse_frame: Matrix3<f64>,
}

impl Rig {
    /// The rig with the neutral `subject`, which has the vertices of this one's, millimetres. Identity modes, which say how
    /// faces differ, are left out; landmarks, regions, textures and groups stay.
    ///
    /// # Errors
    /// When there are no polygons or no shapes, the subject has another number of vertices or is not finite, is a line or a point, or is no mesh of
    /// this rig: in another order, mirrored, flat, collapsed ([`Unlike`](super::Unlike)). What is merely odd is a warning.
    pub fn transfer(
        &self,
        subject: &[Vec3],
        options: &TransferOptions,
    ) -> Result<(Self, Vec<RigWarning>), TransferError> {
        let mesh = self.mesh.as_ref().ok_or(TransferError::NoPolygons)?;
        let anchor = options.anchor;
        if !(anchor > 0.0 && anchor.is_finite()) {
            return Err(TransferError::Anchor(anchor));
        }
        let chosen: Vec<usize> =
            (0..self.shapes.len()).filter(|&k| self.shapes[k].family != Family::Identity).collect();
        if chosen.is_empty() {
            return Err(TransferError::NoShapes);
        }
        let (found, expected) = (subject.len(), self.neutral.len());
        if found != expected {
            return Err(RigError::VertexCount { what: "the subject".into(), found, expected }.into());
        }
        if let Some(vertex) = subject.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(RigError::NotFinite { what: "the subject".into(), vertex }.into());
        }
        let pairs: Vec<(Vec3, Vec3)> = self.neutral.iter().copied().zip(subject.iter().copied()).collect();
        let pose = closest_pose(&pairs, PoseKind::Similarity)?;
        let doubts = likeness::compare(&self.neutral, &mesh.triangulate().triangles, subject)
            .map_err(|why| RigError::Unlike { what: "the subject", of: likeness::OF_RIG, why })?
            .doubts;
        let source: Vec<Vec3> = self.neutral.iter().map(|&p| pose.apply(p)).collect();
        let diagonal = bounding_box_diagonal(subject);
        let first = self.seams(subject);
        let triangles: Vec<_> = mesh.triangulate().triangles.iter().map(|t| t.map(|v| first[v as usize])).collect();
        let elements = elements(&triangles, &source, subject, DEGENERATE_SHARE * diagonal * diagonal);

        let mut anchors = vec![0.0; subject.len()];
        for Element { corners, area, .. } in &elements {
            corners.iter().for_each(|&i| anchors[i] += anchor / diagonal.powi(2) * area / 3.0);
        }
        // a vertex of no triangle has no gradient either: any weight will do
        anchors.iter_mut().filter(|a| **a == 0.0).for_each(|a| *a = 1.0);
        let mut equations = laplacian(&elements, &anchors);
        let mut solver = BorderedCholesky::new(equations.structure());

        let linear = pose.rotation * pose.scale;
        let mut deltas = Vec::with_capacity(3 * subject.len() * chosen.len());
        let mut step = vec![0.0; subject.len()];
        // some shapes at a time, so that their right-hand sides need not all be held
        for shapes in chosen.chunks(16) {
            let sides: Vec<Vec<Vec3>> = shapes
                .par_iter()
                .map(|&k| {
                    let delta = |d: &[f32]| linear * Vec3::new(f64::from(d[0]), f64::from(d[1]), f64::from(d[2]));
                    let moves: Vec<Vec3> = self.deltas(k).chunks_exact(3).map(delta).collect();
                    right_side(&elements, &source, &moves, &anchors)
                })
                .collect();
            for side in sides {
                let mut moved = vec![0.0f32; 3 * subject.len()];
                for axis in 0..3 {
                    equations.gradient.iter_mut().zip(&side).for_each(|(g, b)| *g = -b[axis]);
                    solver.solve(&equations, &[], &mut step)?;
                    moved.chunks_exact_mut(3).zip(&first).for_each(|(d, &v)| d[axis] = step[v as usize] as f32);
                }
                deltas.extend(moved);
            }
        }
        let shapes: Vec<Shape> = chosen.iter().map(|&k| self.shapes[k].clone()).collect();
        let mesh = mesh.with_positions(subject.to_vec());
        let (mut rig, dropped) = Rig::new(subject.to_vec(), Some(mesh), shapes, deltas)?;
        let mut warnings: Vec<RigWarning> = doubts
            .into_iter()
            .map(|why| RigWarning::Unlike { what: "the subject", of: likeness::OF_RIG, why })
            .collect();
        warnings.extend(dropped);
        warnings.extend(self.expression_of(subject));
        rig.landmarks.clone_from(&self.landmarks);
        rig.regions.clone_from(&self.regions);
        Ok((rig, warnings))
    }

    /// The expression that a subject has instead of being neutral, the one that moves it most, by the weights that explain it best.
    fn expression_of(&self, subject: &[Vec3]) -> Option<RigWarning> {
        let identity_modes = self.usual_identity_modes(None, false);
        let basis = self.select(ShapeSelection { names: None, identity_modes }).ok()?;
        let reach = |k: usize| (0..subject.len()).map(|i| basis.displacement(i, k).norm()).fold(0.0, f64::max);
        let expressions = basis.shapes().iter().enumerate().filter(|(_, shape)| shape.family == Family::Expression);
        let reaches: Vec<(usize, String, f64)> =
            expressions.map(|(k, shape)| (k, shape.name.clone(), reach(k))).collect();
        let options =
            WeightFitOptions { bounds: WEIGHTS, pose: Some(PoseKind::Similarity), ..WeightFitOptions::default() };
        let mut fitter = WeightFitter::new(&self.neutral, self.mesh.as_ref(), basis, &options).ok()?;
        let fitted = fitter.fit(subject).ok()?;
        let (least, share) = EXPRESSION;
        let far = share * bounding_box_diagonal(subject);
        let moved = reaches
            .into_iter()
            .map(|(k, name, reach)| (name, fitted.weights[k], fitted.weights[k] * reach * fitted.pose.scale));
        let most = moved.filter(|(_, weight, by)| *weight > least && *by > far).max_by(|a, b| a.2.total_cmp(&b.2));
        most.map(|(name, weight, by)| RigWarning::NotNeutral { name, weight, by })
    }
}

/// Edges of a triangle and a vector along its normal as long as the root of twice its area; zero without area.
fn frame([a, b, c]: [Vec3; 3]) -> Matrix3<f64> {
    let (e1, e2) = (b - a, c - a);
    let cross = e1.cross(&e2);
    let length = cross.norm();
    let normal = if length > 0.0 { cross / length.sqrt() } else { Vec3::zeros() };
    Matrix3::from_columns(&[e1, e2, normal])
}

/// Triangles with an area on both faces.
fn elements(triangles: &[[u32; 3]], source: &[Vec3], subject: &[Vec3], smallest: f64) -> Vec<Element> {
    let element = |t: &[u32; 3]| {
        let corners = t.map(|v| v as usize);
        let [a, b, c] = corners.map(|i| subject[i]);
        let cross = (b - a).cross(&(c - a));
        let area = 0.5 * cross.norm();
        let of_source = frame(corners.map(|i| source[i]));
        // the third column is as long as the root of twice the area
        if area <= smallest || 0.5 * of_source.column(2).norm_squared() <= smallest {
            return None;
        }
        let over = cross / cross.norm_squared();
        let gradients = [over.cross(&(c - b)), over.cross(&(a - c)), over.cross(&(b - a))];
        Some(Element { corners, area, gradients, inverse_frame: of_source.try_inverse()? })
    };
    triangles.iter().filter_map(element).collect()
}

/// `sum_j A_j g_a . g_b` and the anchors on the diagonal.
fn laplacian(elements: &[Element], anchors: &[f64]) -> NormalEquations {
    let edges = elements.iter().flat_map(|e| [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (e.corners[a], e.corners[b])));
    let structure = BlockStructure::new(&vec![1; anchors.len()], edges, 0).expect("proven: corners are vertices");
    let structure = Arc::new(structure);
    let mut equations = NormalEquations::new(structure.clone());
    let mut add = |i: usize, j: usize, value: f64| {
        let slot = structure.slot(i.max(j), i.min(j)).expect("proven: corners of a triangle meet");
        equations.block_mut(slot)[0] += value;
    };
    anchors.iter().enumerate().for_each(|(i, a)| add(i, i, *a));
    for Element { corners, area, gradients, .. } in elements {
        for a in 0..3 {
            for b in 0..=a {
                add(corners[a], corners[b], area * gradients[a].dot(&gradients[b]));
            }
        }
    }
    equations
}

/// `sum_j A_j (S_j - I) g_a` and the anchored displacements.
fn right_side(elements: &[Element], source: &[Vec3], moves: &[Vec3], anchors: &[f64]) -> Vec<Vec3> {
    let mut side: Vec<Vec3> = moves.iter().zip(anchors).map(|(d, a)| d * *a).collect();
    for Element { corners, area, gradients, inverse_frame } in elements {
        if corners.iter().all(|&i| moves[i] == Vec3::zeros()) {
            continue;
        }
        let gradient = frame(corners.map(|i| source[i] + moves[i])) * inverse_frame - Matrix3::identity();
        for (&i, g) in corners.iter().zip(gradients) {
            side[i] += gradient * g * *area;
        }
    }
    side
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet, side_by_side};
    use crate::mesh::{PolygonMesh, Pose, TriangleMesh};

    /// Two bumpy sheets, unconnected, and a vertex of no triangle.
    fn rig() -> Rig {
        let bumpy = |x0: f64| {
            sheet(9, 7, move |x, y| Vec3::new(x0 + 5.0 * x, 5.0 * y, 3.0 * (0.7 * x).sin() * (0.5 * y).cos()))
        };
        let mut both = side_by_side(&bumpy(0.0), &bumpy(60.0));
        both.positions.push(Vec3::new(7.0, 8.0, 90.0));
        let mesh = PolygonMesh::from(both);
        let n = mesh.positions.len();
        let shapes = ["a", "b"].map(|name| Shape { name: name.into(), family: Family::Expression });
        let bend = |k: usize, i: usize| {
            let p = mesh.positions[i];
            let up = 4.0 * (0.1 * p.x + k as f64).sin() + 0.2 * noise(i);
            [0.3 * p.y * k as f64, 0.1 * p.x, up].map(|v| v as f32)
        };
        let deltas = (0..2).flat_map(|k| (0..n).flat_map(move |i| bend(k, i))).collect();
        Rig::new(mesh.positions.clone(), Some(mesh.clone()), shapes.to_vec(), deltas).unwrap().0
    }

    #[test]
    fn a_rig_that_was_cut_gives_the_shapes_of_the_whole_one() {
        let all = rig();
        let n = all.neutral().len() - 1; // the last is of no triangle
        let mesh = all.mesh().unwrap().triangulate();
        let corners = mesh.triangles.concat();
        let mesh = PolygonMesh::from(TriangleMesh { positions: mesh.positions[..n].to_vec(), ..mesh });
        let deltas = (0..2).flat_map(|k| all.deltas(k)[..3 * n].to_vec()).collect();
        let whole = Rig::new(mesh.positions.clone(), Some(mesh), all.shapes().to_vec(), deltas).unwrap().0;
        let of = |positions: &[Vec3]| corners.iter().map(|&v| positions[v as usize]).collect::<Vec<_>>();
        let mesh = PolygonMesh {
            positions: of(whole.neutral()),
            starts: (0..=corners.len() as u32 / 3).map(|t| 3 * t).collect(),
            corners: (0..corners.len() as u32).collect(),
            ..PolygonMesh::default()
        };
        let deltas =
            (0..2).flat_map(|k| corners.iter().flat_map(move |&v| (0..3).map(move |a| (k, 3 * v as usize + a))));
        let deltas = deltas.map(|(k, at)| whole.deltas(k)[at]).collect();
        let (cut, _) = Rig::new(mesh.positions.clone(), Some(mesh), whole.shapes().to_vec(), deltas).unwrap();
        let subject: Vec<Vec3> =
            whole.neutral().iter().map(|p| Vec3::new(1.2 * p.x, p.y, p.z + 0.02 * p.x * p.y)).collect();
        let [whole, cut] = [(&whole, &subject), (&cut, &of(&subject))]
            .map(|(rig, subject)| rig.transfer(subject, &TransferOptions::default()).unwrap().0);
        for k in 0..2 {
            let mut at = vec![None; whole.neutral().len()];
            for (c, &v) in corners.iter().enumerate() {
                let (here, expected) = (displacement(&cut, k, c), displacement(&whole, k, v as usize));
                // the pose of the neutral on the subject counts a vertex as often as it stands there
                assert!((here - expected).norm() < 0.1 * (1.0 + expected.norm()), "{k}, {c}: {here} {expected}");
                assert_eq!(*at[v as usize].get_or_insert(here), here, "{k}: corners of vertex {v} stay together");
            }
        }
    }

    fn displacement(rig: &Rig, k: usize, i: usize) -> Vec3 {
        let d = &rig.deltas(k)[3 * i..];
        Vec3::new(f64::from(d[0]), f64::from(d[1]), f64::from(d[2]))
    }

    #[test]
    fn a_subject_that_is_the_neutral_posed_gets_the_shapes_posed() {
        let rig = rig();
        let turned = Pose { scale: 1.7, ..Pose::rigid(Vec3::new(0.4, -1.1, 0.8), Vec3::new(30.0, -5.0, 12.0)) };
        for pose in [Pose::identity(), turned] {
            let subject: Vec<Vec3> = rig.neutral().iter().map(|&p| pose.apply(p)).collect();
            let (moved, warnings) = rig.transfer(&subject, &TransferOptions::default()).unwrap();
            assert_eq!((warnings.len(), moved.shapes()), (0, rig.shapes()));
            for k in 0..2 {
                for i in 0..subject.len() {
                    let expected = pose.rotation * displacement(&rig, k, i) * pose.scale;
                    assert!((displacement(&moved, k, i) - expected).norm() < 1e-4, "shape {k}, vertex {i}");
                }
            }
        }
    }

    /// A linear map of a flat source has one gradient, which some displacement of any flat subject has everywhere.
    #[test]
    fn gradients_are_reproduced_on_another_face() {
        let map = Matrix3::new(0.1, 0.2, 0.0, -0.05, -0.2, 0.0, 0.2, 0.1, 0.0);
        let mesh = PolygonMesh::from(sheet(9, 7, |x, y| Vec3::new(5.0 * x, 5.0 * y, 0.0)));
        let triangles = mesh.triangulate().triangles;
        let deltas = mesh.positions.iter().flat_map(|p| <[f64; 3]>::from(map * p)).map(|d| d as f32).collect();
        let shape = Shape { name: "linear".into(), family: Family::Other };
        let (rig, _) = Rig::new(mesh.positions.clone(), Some(mesh), vec![shape], deltas).unwrap();
        let warp = |p: &Vec3| p + Vec3::new((0.2 * p.y).sin(), 0.01 * p.x * p.x, 0.0);
        let subject: Vec<Vec3> = rig.neutral().iter().map(warp).collect();
        let pairs: Vec<(Vec3, Vec3)> = rig.neutral().iter().copied().zip(subject.iter().copied()).collect();
        let turn = closest_pose(&pairs, PoseKind::Similarity).unwrap().rotation;
        assert!((turn - Matrix3::identity()).norm() > 0.01, "the test needs a turn");
        let (moved, _) = rig.transfer(&subject, &TransferOptions { anchor: 1e-9 }).unwrap();
        let expected = turn * map * turn.transpose();
        for e in elements(&triangles, rig.neutral(), &subject, 0.0) {
            let part = |a: usize| displacement(&moved, 0, e.corners[a]) * e.gradients[a].transpose();
            let found = part(0) + part(1) + part(2);
            assert!((expected - found).norm() < 1e-4, "{expected} {found}");
        }
    }

    #[test]
    fn what_cannot_be_transferred_is_named() {
        let rig = rig();
        let options = TransferOptions::default();
        let message = |subject: &[Vec3], options| rig.transfer(subject, &options).unwrap_err().to_string();
        assert!(message(&rig.neutral()[1..], options).contains("found 126 vertices, expected 127"));
        assert!(message(&vec![Vec3::zeros(); 127], options).contains("aligned"));
        assert!(message(&vec![Vec3::repeat(f64::NAN); 127], options).contains("not finite"));
        for anchor in [0.0, -1.0, f64::NAN] {
            assert!(message(rig.neutral(), TransferOptions { anchor }).contains("above 0"));
        }
        let bare = Rig::new(rig.neutral().to_vec(), None, Vec::new(), Vec::new()).unwrap().0;
        assert!(bare.transfer(rig.neutral(), &options).unwrap_err().to_string().contains("no polygons"));
    }
}
