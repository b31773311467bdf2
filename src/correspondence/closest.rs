//! Correspondences: for every vertex of the template, the closest point of the scan, and whether to believe it.

use rayon::prelude::*;

use super::{Acceptance, ScanSurface, VertexMasks};
use crate::mesh::normals::{NormalWeighting, vertex_normals_into};
use crate::mesh::{TriangleMesh, Vec3};
use crate::nlls::mad_scale;

/// One correspondence per template vertex, in the model's frame.
#[derive(Debug, Clone, Default)]
pub struct Correspondences {
    /// Closest point of the scan's surface.
    pub points: Vec<Vec3>,
    /// Unit normal of the scan there, interpolated between its vertices.
    pub normals: Vec<Vec3>,
    /// One for an accepted correspondence and each vertex that it speaks for, zero for a rejected one, less where a mask says so or the
    /// scan is noisy.
    pub weights: Vec<f64>,
    /// Share of each vertex that nothing holds: one where nothing was accepted, less where a mask says so.
    pub unseen: Vec<f64>,
    /// Unit normal of the template at each vertex.
    pub template_normals: Vec<Vec3>,
    found: Vec<Found>,
    /// Vertices that a correspondence was accepted for, and those that it could be.
    inliers: usize,
    counted: usize,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    feature: Option<u32>,
    point: Vec3,
    normal: Vec3,
    trust: f64,
    accepted: bool,
}

impl Default for Found {
    fn default() -> Self {
        let zero = Vec3::zeros();
        Self { feature: None, point: zero, normal: zero, trust: 0.0, accepted: false }
    }
}

impl Correspondences {
    /// Finds the correspondences of `positions`, whose triangles are those of `template`. The last ones serve as hints.
    /// Vertices take none on the rim, where their data weigh nothing, and where another speaks for them.
    pub fn find(
        &mut self,
        scan: &ScanSurface,
        positions: &[Vec3],
        template: &TriangleMesh,
        masks: &VertexMasks,
        accept: &Acceptance,
    ) {
        self.template_normals.resize(positions.len(), Vec3::zeros());
        vertex_normals_into(positions, &template.triangles, NormalWeighting::Area, &mut self.template_normals);
        self.found.resize(positions.len(), Found::default());
        let cosine = accept.angle.to_radians().cos();
        let normals = &self.template_normals;
        self.found.par_iter_mut().with_min_len(64).enumerate().for_each(|(i, found)| {
            if masks.speaker(i) == i {
                found.update(scan, positions[i], normals[i], accept, cosine);
            }
        });
        self.points.clear();
        self.points.extend(self.found.iter().map(|f| f.point));
        self.normals.clear();
        self.normals.extend(self.found.iter().map(|f| f.normal));
        for ((found, data), on_rim) in self.found.iter_mut().zip(&masks.data).zip(&masks.rim) {
            found.accepted &= !on_rim && *data > 0.0;
        }
        let found = &self.found;
        let weight =
            |i: usize| if masks.speaker(i) == i && found[i].accepted { masks.weight(i) * found[i].trust } else { 0.0 };
        let seen = |i: usize| if found[masks.speaker(i)].accepted { masks.own_weight(i) } else { 0.0 };
        self.weights.clear();
        self.weights.extend((0..positions.len()).map(weight));
        self.unseen.clear();
        self.unseen.extend((0..positions.len()).map(|i| masks.bound[i] - seen(i)));
        self.inliers = (0..positions.len()).filter(|&i| seen(i) > 0.0).count();
        self.counted = masks.counted();
    }

    /// Robust standard deviation of the distances from `positions` to the planes of the accepted correspondences, `1.4826 median |n . (v -
    /// c)|`; `None` without any.
    #[must_use]
    pub fn residual_scale(&self, positions: &[Vec3]) -> Option<f64> {
        let all = positions.iter().zip(&self.points).zip(&self.normals).zip(&self.weights);
        let mut distances: Vec<f64> = all.filter(|(_, w)| **w > 0.0).map(|(((v, c), n), _)| n.dot(&(v - c))).collect();
        mad_scale(&mut distances)
    }

    /// Whether any correspondence was accepted.
    #[must_use]
    pub fn any(&self) -> bool {
        self.weights.iter().any(|&w| w > 0.0)
    }

    /// Share of accepted correspondences, of the vertices that no mask takes out.
    #[must_use]
    pub fn inlier_share(&self) -> f64 {
        self.inliers as f64 / self.counted.max(1) as f64
    }
}

impl Found {
    fn update(&mut self, scan: &ScanSurface, position: Vec3, normal: Vec3, accept: &Acceptance, cosine: f64) {
        self.accepted = false;
        let cap = accept.distance * accept.distance;
        let Some(hit) = scan.closest(&position, self.feature, cap) else { return };
        self.feature = Some(hit.feature);
        self.point = hit.point;
        if hit.normal == Vec3::zeros() {
            return;
        }
        self.normal = hit.normal;
        self.trust = accept.trust(hit.noise);
        let on_rim = scan.rejects_boundary() && hit.on_boundary;
        self.accepted = !on_rim && hit.normal.dot(&normal) > cosine;
    }
}

#[cfg(test)]
mod tests {
    use super::super::ScanOptions;
    use super::*;
    use crate::mesh::testing::{noise, sheet};

    fn limits() -> Acceptance {
        Acceptance { distance: 2.0, angle: 40.0, noise: 0.0 }
    }

    fn scan_of(mesh: TriangleMesh, reject_boundary: bool) -> ScanSurface {
        ScanSurface::new(mesh, None, &ScanOptions { reject_boundary, ..ScanOptions::default() }).unwrap()
    }

    fn flat(columns: usize, rows: usize) -> TriangleMesh {
        sheet(columns, rows, |c, r| Vec3::new(c, r, 0.0))
    }

    fn find(scan: &ScanSurface, template: &TriangleMesh, accept: &Acceptance) -> Correspondences {
        let mut found = Correspondences::default();
        found.find(scan, &template.positions, template, &VertexMasks::all(template.positions.len()), accept);
        found
    }

    #[test]
    fn far_correspondences_are_rejected() {
        let scan = scan_of(flat(9, 9), true);
        let template = sheet(5, 5, |c, r| Vec3::new(2.0 + c, 2.0 + r, 0.4 * c));
        // Columns at heights 0, 0.4, .. 1.6; the slope is 22 degrees.
        let found = find(&scan, &template, &Acceptance { distance: 1.0, ..limits() });
        for (i, weight) in found.weights.iter().enumerate() {
            assert_eq!(*weight, f64::from(u8::from(i % 5 <= 2)), "vertex {i}");
        }
        assert_eq!(found.inlier_share(), 0.6);
        let p = template.positions[2];
        approx::assert_abs_diff_eq!(found.points[2], Vec3::new(p.x, p.y, 0.0), epsilon = 1e-12);
        approx::assert_abs_diff_eq!(found.normals[2], Vec3::z(), epsilon = 1e-12);
    }

    #[test]
    fn correspondences_of_another_direction_are_rejected() {
        let scan = scan_of(flat(9, 9), true);
        let slope = 30f64.to_radians().tan();
        let tilted = sheet(3, 3, |c, r| Vec3::new(3.0 + c, 3.0 + r, slope * (c - 1.0)));
        let any = |template: &TriangleMesh, normal_angle| {
            let found = find(&scan, template, &Acceptance { angle: normal_angle, ..limits() });
            (found.any(), found.inlier_share())
        };
        assert_eq!(any(&tilted, 31.0), (true, 1.0));
        assert_eq!(any(&tilted, 29.0), (false, 0.0));
        let mut turned = tilted.clone();
        turned.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(any(&turned, 149.0), (false, 0.0));
        assert_eq!(any(&turned, 151.0), (true, 1.0));
    }

    #[test]
    fn correspondences_on_the_open_boundary_are_rejected_unless_wanted() {
        let template = sheet(9, 9, |c, r| Vec3::new(c - 2.0, r - 2.0, 0.5));
        for (reject, accepted) in [(true, 9), (false, 81)] {
            let scan = scan_of(flat(5, 5), reject);
            let found = find(&scan, &template, &Acceptance { distance: 5.0, ..limits() });
            assert_eq!(found.weights.iter().filter(|w| **w == 1.0).count(), accepted);
            for (p, weight) in template.positions.iter().zip(&found.weights) {
                let inside = p.x > 0.0 && p.x < 4.0 && p.y > 0.0 && p.y < 4.0;
                assert_eq!(*weight == 1.0, inside || !reject, "{p}");
            }
        }
    }

    #[test]
    fn what_a_noisy_part_of_the_scan_says_counts_less() {
        let gaussian = |i: usize| noise(3 * i) + noise(3 * i + 1) + noise(3 * i + 2);
        let height = |c: f64, r: f64| if c > 20.0 { 0.6 * gaussian((41.0 * r + c) as usize) } else { 0.0 };
        let scan = scan_of(sheet(41, 41, |c, r| Vec3::new(c, r, height(c, r))), true);
        let template = sheet(31, 31, |c, r| Vec3::new(5.0 + c, 5.0 + r, 0.0));
        let weights = |noise| find(&scan, &template, &Acceptance { distance: 5.0, angle: 80.0, noise }).weights;
        assert!(weights(0.0).iter().all(|w| *w == 0.0 || *w == 1.0));
        let mean = |side: &dyn Fn(f64) -> bool| {
            let pairs = template.positions.iter().zip(weights(0.3)).filter(|(p, w)| side(p.x) && *w > 0.0);
            let (sum, count) = pairs.fold((0.0, 0.0), |(sum, count), (_, w)| (sum + w, count + 1.0));
            sum / count
        };
        assert_eq!(mean(&|x| x < 17.0), 1.0);
        // 0.3^2 / (0.3^2 + 0.6^2)
        assert!((0.15..0.3).contains(&mean(&|x| x > 24.0)), "{}", mean(&|x| x > 24.0));
    }

    #[test]
    fn ignored_vertices_and_stale_hints_do_no_harm() {
        let scan = scan_of(flat(9, 9), true);
        let mut template = sheet(5, 5, |c, r| Vec3::new(2.0 + c, 2.0 + r, 0.3));
        let masks = VertexMasks::new(None, None, (0..25).map(|i| i % 3 == 0).collect());
        let mut found = Correspondences::default();
        for shift in [0.0, 0.7, -0.9] {
            template.positions.iter_mut().for_each(|p| p.x += shift);
            found.find(&scan, &template.positions, &template, &masks, &limits());
            let mut fresh = Correspondences::default();
            fresh.find(&scan, &template.positions, &template, &masks, &limits());
            assert_eq!((&found.points, &found.weights), (&fresh.points, &fresh.weights));
            for (i, (weight, ignored)) in found.weights.iter().zip(&masks.rim).enumerate() {
                assert_eq!(*weight == 0.0, *ignored, "vertex {i}");
            }
        }
    }

    #[test]
    fn the_scale_of_residuals_is_that_of_the_noise_whatever_the_outliers() {
        // The sum of three uniform numbers in [-1, 1) has variance one.
        let gaussian = |i: usize| noise(3 * i) + noise(3 * i + 1) + noise(3 * i + 2);
        let height = |i: usize| if i.is_multiple_of(4) { 5.0 + noise(i) } else { 0.2 * gaussian(i) };
        let positions: Vec<Vec3> = (0..4000).map(|i| Vec3::new(i as f64, -7.0, height(i))).collect();
        let mut found = Correspondences {
            points: vec![Vec3::new(3.0, 4.0, 0.0); 4000],
            normals: vec![Vec3::z(); 4000],
            weights: vec![1.0; 4000],
            ..Correspondences::default()
        };
        let scale = found.residual_scale(&positions).unwrap();
        assert!((0.2..0.35).contains(&scale), "{scale}");
        found.weights = (0..4000).map(|i| f64::from(u8::from(i % 4 != 0))).collect();
        let scale = found.residual_scale(&positions).unwrap();
        assert!((scale - 0.2).abs() < 0.02, "{scale}");
        found.weights.fill(0.0);
        assert_eq!(found.residual_scale(&positions), None);
    }
}
