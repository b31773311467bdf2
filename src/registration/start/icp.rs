//! Trimmed ICP of surfels, and the loss of a pose: what the search refines and compares poses by.

use nalgebra::{Rotation3, SMatrix, SVector};

use super::{Cancel, StartFit};
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{Pose, PoseKind, Vec3};
use crate::registration::surfels::{Lattice, Surfel};

/// Size of the scan's surfels in the end, millimetres.
pub(super) const FINE_SURFEL: f64 = 4.0;
/// Reach of the first look and of the coarse refinement, millimetres.
pub(super) const LOOK_REACH: f64 = 20.0;
/// Poses nearer than this, millimetres at the template's surfels, are one.
const SAME: f64 = 20.0;
/// One minus the cosine of 60 degrees.
const WIDEST_TURN: f64 = 0.5;
/// Prior standard deviation of a similarity's scale where none is stated, and that of a surfel's distance, millimetres.
pub(super) const SCALE_SIGMA: f64 = 0.15;
const SCALE_NOISE: f64 = 1.0;
/// Lever arm that turns radians into millimetres where a step is measured.
const ARM: f64 = 67.0;

/// The scan, in its frame and the schedule's millimetres.
pub(super) struct ScanSurfels {
    pub coarse: Vec<Surfel>,
    pub lattice: Lattice,
    pub fine: Vec<Surfel>,
    pub tree: ClosestVertices,
}

/// What is put on the scan.
pub(super) struct Problem<'a> {
    /// Surfels of the template about its centroid, spread: any first part of them covers all of it.
    pub template: Vec<Surfel>,
    pub scan: &'a ScanSurfels,
    /// Landmarks: on the template, about its centroid; on the scan; and their weight, as a share of the template.
    pub landmarks: &'a [(Vec3, Vec3, f64)],
    pub kind: PoseKind,
    /// Prior standard deviation of the scale's logarithm.
    pub scale_sigma: f64,
    pub cancel: Cancel<'a>,
}

/// How surfels find each other.
#[derive(Clone, Copy)]
pub(super) struct Matching {
    /// How many of the template's.
    pub count: usize,
    pub reach: f64,
    /// Exact nearest surfels and the distance along the normal, or the lattice's and the distance in space.
    pub exact: bool,
}

#[derive(Clone, Copy)]
struct Match {
    point: Vec3,
    normal: Vec3,
    /// Distance along `normal`.
    height: f64,
    /// Below 1.
    loss: f64,
}

impl Problem<'_> {
    #[inline]
    fn find(&self, point: Vec3, normal: Vec3, how: Matching) -> Option<Match> {
        let at = if how.exact {
            &self.scan.fine[self.scan.tree.query_within(&point, 4.0 * how.reach * how.reach)?.vertex as usize]
        } else {
            &self.scan.coarse[self.scan.lattice.near(point)?]
        };
        let away = point - at.point;
        let height = away.dot(&at.normal);
        let squared = away.norm_squared();
        let distance = if how.exact {
            let aside = (squared - height * height).max(0.0).sqrt();
            // The way to the nearest point of a surface is along its normal, except past its edge.
            if aside > 1.5 * FINE_SURFEL + 0.5 * height.abs() {
                return None;
            }
            height * height
        } else {
            squared
        };
        let loss = distance / (how.reach * how.reach) + (1.0 - normal.dot(&at.normal)) / WIDEST_TURN;
        (loss < 1.0).then_some(Match { point: at.point, normal: at.normal, height, loss })
    }

    pub fn fit(&self, pose: &Pose, how: Matching) -> StartFit {
        let (mut loss, mut matched, mut squares) = (0.0, 0, 0.0);
        let template = &self.template[..how.count.min(self.template.len())];
        for s in template {
            match self.find(pose.apply(s.point), pose.rotation * s.normal, how) {
                Some(m) => {
                    loss += m.loss;
                    matched += 1;
                    squares += m.height * m.height;
                }
                None => loss += 1.0,
            }
        }
        let count = template.len() as f64;
        let mut total = count;
        for (p, q, share) in self.landmarks {
            let weight = share * count;
            loss += weight * ((pose.apply(*p) - q).norm_squared() / (LOOK_REACH * LOOK_REACH)).min(1.0);
            total += weight;
        }
        StartFit {
            loss: loss / total,
            share: f64::from(matched) / count,
            residual: (squares / f64::from(matched.max(1))).sqrt() / pose.scale,
        }
    }

    /// One step of trimmed ICP; how far it moved, or `None` where nothing holds the template.
    fn step(&self, pose: &mut Pose, how: Matching) -> Option<f64> {
        let mut hessian = SMatrix::<f64, 7, 7>::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        let mut add = |row: SVector<f64, 7>, r: f64, w: f64| {
            hessian.syger(w, &row, &row, 1.0);
            gradient.axpy(w * r, &row, 1.0);
        };
        let row = |arm: Vec3, m: Vec3| {
            let turn = arm.cross(&m);
            SVector::<f64, 7>::from([turn.x, turn.y, turn.z, m.x, m.y, m.z, arm.dot(&m)])
        };
        let count = how.count.min(self.template.len());
        let mut matched = 0;
        for s in &self.template[..count] {
            let (arm, normal) = (pose.rotation * s.point * pose.scale, pose.rotation * s.normal);
            let point = arm + pose.translation;
            if let Some(m) = self.find(point, normal, how) {
                let between = (normal + m.normal).normalize();
                add(row(arm, between), (point - m.point).dot(&between), (1.0 - m.loss).powi(2));
                matched += 1;
            }
        }
        for (p, q, share) in self.landmarks {
            let arm = pose.rotation * p * pose.scale;
            let away = arm + pose.translation - q;
            for axis in 0..3 {
                add(row(arm, Vec3::ith(axis, 1.0)), away[axis], share * count as f64);
            }
        }
        if matched < 6 {
            return None;
        }
        if self.kind == PoseKind::Similarity {
            let stiffness = SCALE_NOISE * SCALE_NOISE * count as f64 / (self.scale_sigma * self.scale_sigma);
            let mut scale = SVector::<f64, 7>::zeros();
            scale[6] = 1.0;
            add(scale, pose.scale.ln(), stiffness);
        } else {
            for i in 0..7 {
                (hessian[(i, 6)], hessian[(6, i)]) = (0.0, 0.0);
            }
            (hessian[(6, 6)], gradient[6]) = (1.0, 0.0);
        }
        for i in 0..6 {
            hessian[(i, i)] *= 1.0 + 1e-6;
        }
        let step = -hessian.cholesky()?.solve(&gradient);
        let turn = step.fixed_rows::<3>(0).into_owned();
        let shift = step.fixed_rows::<3>(3).into_owned();
        let shorter = (0.4 / turn.norm()).min(LOOK_REACH / shift.norm()).min(0.2 / step[6].abs()).min(1.0);
        pose.rotation = Rotation3::new(turn * shorter).into_inner() * pose.rotation;
        pose.translation += shift * shorter;
        pose.scale *= (step[6] * shorter).exp();
        Some(shorter * (turn.norm() * ARM + shift.norm() + step[6].abs() * ARM))
    }

    /// Trimmed ICP until it moves less than `still`, for `steps` at most.
    pub fn descend(&self, pose: &mut Pose, how: Matching, steps: usize, still: f64) {
        for _ in 0..steps {
            if self.cancel.is_set() || self.step(pose, how).is_none_or(|moved| moved < still) {
                break;
            }
        }
    }

    /// Whether two poses are one.
    pub fn same(&self, a: &Pose, b: &Pose) -> bool {
        self.template.iter().take(16).all(|s| (a.apply(s.point) - b.apply(s.point)).norm() < SAME)
    }
}
