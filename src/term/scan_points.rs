//! The other direction of correspondences: points of the scan, and the closest point of the moving template for each.

use rayon::prelude::*;

use super::ScanToTemplate;
use crate::correspondence::{Acceptance, ScanSample, ScanSurface, VertexMasks};
use crate::mesh::adjacency::OpenBoundary;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::normals::face_areas;
use crate::mesh::{MeshError, TriangleMesh, Vec3};

/// Area for each point of a spread with no two points nearer than one: between discs packed as closely as they go (0.87) and
/// discs dropped at random until none fits in (1.44). How many there are does not change what they weigh together.
const AREA_OF_ONE: f64 = 1.2;

/// Scan points as dense as the template's vertices, evenly spread ([`ScanSurface::spread`]).
#[derive(Debug)]
pub struct ScanPoints {
    points: Vec<ScanSample>,
    /// Area that a point stands for over that of a template vertex.
    weight: f64,
    /// The template's own boundary.
    boundary: OpenBoundary,
    /// The template where it was at the last search, and the triangle that each point found there.
    last: Option<(ClosestPoint, Vec<u32>)>,
}

/// Points that are searched for before what was found is put down.
const BATCH: usize = 2048;

impl ScanPoints {
    /// Spreads points over the scan for a template of this rest shape.
    #[must_use]
    pub fn new(scan: &ScanSurface, template: &TriangleMesh) -> Self {
        let area: f64 = face_areas(&template.positions, &template.triangles).iter().sum();
        let per_vertex = area / template.surface_points().len() as f64;
        let (points, each) = scan.spread((per_vertex / AREA_OF_ONE).sqrt());
        Self { points, weight: each / per_vertex, boundary: OpenBoundary::of(template), last: None }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Writes the residuals of the points whose closest point on the template, with its vertices at `positions` and their
    /// unit `normals`, is to be accepted, off the template's boundary, and nearest (by its barycentric
    /// coordinates) to a vertex that takes part. `template` gives the triangles.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn find(
        &mut self,
        positions: &[Vec3],
        normals: &[Vec3],
        template: &TriangleMesh,
        masks: &VertexMasks,
        accept: &Acceptance,
        found: &mut ScanToTemplate,
    ) -> Result<(), MeshError> {
        let (surface, hints) = match &mut self.last {
            Some((surface, hints)) => {
                surface.move_to(positions)?;
                (surface, hints)
            }
            none => {
                let moved = TriangleMesh { positions: positions.to_vec(), triangles: template.triangles.clone() };
                let (surface, hints) = none.insert((ClosestPoint::new(&moved)?, vec![u32::MAX; self.points.len()]));
                (surface, hints)
            }
        };
        let (cosine, cap) = (accept.angle.to_radians().cos(), accept.distance * accept.distance);
        let search = |(&ScanSample { point: q, normal, noise }, hint): (&ScanSample, &mut u32)| {
            let hit = surface.query_from_within(&q, *hint, cap)?;
            *hint = hit.triangle;
            let corners = template.triangles[hit.triangle as usize];
            let interpolated: Vec3 = corners.iter().zip(hit.barycentric).map(|(&v, b)| normals[v as usize] * b).sum();
            if self.boundary.holds(hit.triangle as usize, corners, hit.barycentric)
                || interpolated.try_normalize(0.0)?.dot(&normal) <= cosine
            {
                return None;
            }
            // On a side, the corner opposite has weight 0: both triangles there give the same answer.
            let (nearest, _) = corners.into_iter().zip(hit.barycentric).max_by(|a, b| a.1.total_cmp(&b.1))?;
            let nearest = nearest as usize;
            let weight = if masks.rim[nearest] { 0.0 } else { masks.data[nearest] * accept.trust(noise) };
            let nearest = masks.speaker(nearest);
            (weight > 0.0).then(|| (nearest, q + (positions[nearest] - hit.point), normal, self.weight * weight))
        };
        let ScanToTemplate { samples, targets, normals, weights, .. } = found;
        samples.clear();
        targets.clear();
        normals.clear();
        weights.clear();
        let mut batch = Vec::with_capacity(BATCH);
        for (points, hints) in self.points.chunks(BATCH).zip(hints.chunks_mut(BATCH)) {
            points.par_iter().zip(hints).with_min_len(64).map(search).collect_into_vec(&mut batch);
            for (sample, target, normal, weight) in batch.drain(..).flatten() {
                samples.push(sample);
                targets.push(target);
                normals.push(normal);
                weights.push(weight);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspondence::{Correspondences, ScanOptions};
    use crate::energy::SampleResidual as _;
    use crate::mesh::testing::{noise, sheet};

    /// A plane facing up with a sharp tip of 4 mm above the middle of a template's triangle.
    fn tipped() -> TriangleMesh {
        sheet(41, 41, |c, r| {
            let (x, y) = (0.5 * c + 0.1 * noise(r as usize * 41 + c as usize), 0.5 * r);
            let height = 4.0 - 3.0 * (x - 10.6).hypot(y - 10.3);
            Vec3::new(x, y, height.max(0.0))
        })
    }

    fn surface(mesh: TriangleMesh) -> ScanSurface {
        ScanSurface::new(mesh, None, &ScanOptions { normal_smoothing: 0, ..ScanOptions::default() }).unwrap()
    }

    fn template() -> TriangleMesh {
        sheet(11, 11, |c, r| Vec3::new(2.0 * c, 2.0 * r, -0.2))
    }

    fn limits() -> Acceptance {
        Acceptance { distance: 5.0, angle: 80.0, noise: 0.0 }
    }

    fn find(scan: &ScanSurface, template: &TriangleMesh, masks: &VertexMasks, accept: &Acceptance) -> ScanToTemplate {
        let mut correspondences = Correspondences::default();
        correspondences.find(scan, &template.positions, template, masks, accept);
        let mut points = ScanPoints::new(scan, template);
        let mut found = ScanToTemplate { scale: 1.0, ..ScanToTemplate::default() };
        let normals = &correspondences.template_normals;
        points.find(&template.positions, normals, template, masks, accept, &mut found).unwrap();
        found
    }

    #[test]
    fn points_are_spread_as_densely_as_the_template_whatever_the_scan() {
        let template = template();
        let area_each = 400.0 / 121.0;
        let fine = sheet(201, 51, |c, r| Vec3::new(0.1 * c + 0.03 * noise(c as usize), 0.4 * r, 0.0));
        let cloud = TriangleMesh { triangles: Vec::new(), ..fine.clone() };
        let normals = vec![Vec3::z(); cloud.positions.len()];
        let cloud = ScanSurface::new(cloud, Some(&normals), &ScanOptions::default()).unwrap();
        let coarse = sheet(6, 6, |c, r| Vec3::new(4.0 * c, 4.0 * r, 0.0));
        let spacing = (area_each / AREA_OF_ONE).sqrt();
        for (what, scan) in [("fine", &surface(fine)), ("cloud", &cloud)] {
            let points = ScanPoints::new(scan, &template);
            assert!((95..165).contains(&points.len()), "{what}: {}", points.len());
            let total = points.weight * points.len() as f64;
            assert!((total - 121.0).abs() < 0.15 * 121.0, "{what}: all points weigh as much as {total} vertices");
            for (i, s) in points.points.iter().enumerate() {
                assert!(points.points[..i].iter().all(|t| (s.point - t.point).norm() >= spacing), "{what}");
            }
            for i in 0..300 {
                let p = Vec3::new(10.0 + 9.0 * noise(2 * i), 10.0 + 9.0 * noise(2 * i + 1), 0.0);
                assert!(points.points.iter().any(|s| (p - s.point).norm() < 1.4 * spacing), "{what}: nothing near {p}");
            }
        }
        // Inner vertices only, each for more than one of the template's.
        let points = ScanPoints::new(&surface(coarse), &template);
        assert_eq!(points.len(), 16);
        approx::assert_abs_diff_eq!(points.weight, 121.0 / 16.0, epsilon = 1e-9);
    }

    #[test]
    fn a_tip_pulls_though_it_is_no_vertex_closest_point() {
        let scan = surface(tipped());
        let template = template();
        let found = find(&scan, &template, &VertexMasks::all(121), &limits());
        let mut pulls = vec![0.0f64; 121];
        for m in 0..found.len() {
            let s = found.sample(m);
            let [r] = found.residual::<f64>(m, template.positions[s].into());
            pulls[s] = pulls[s].min(r);
            // The offset is no error: at the vertex' place it is that of the closest point, straight below here.
            let q = found.targets[m] - (template.positions[s] - Vec3::new(found.targets[m].x, found.targets[m].y, 0.0));
            assert!(q.z >= -1e-9, "{q}");
        }
        let nearest = (0..121).min_by(|&a, &b| pulls[a].total_cmp(&pulls[b])).unwrap();
        assert_eq!(template.positions[nearest].xy(), nalgebra::Vector2::new(10.0, 10.0));
        assert!(pulls[nearest] < -0.9, "{}", pulls[nearest]);
    }

    #[test]
    fn residuals_are_the_distance_of_the_closest_point_to_the_plane_of_the_scan() {
        let scan = surface(sheet(41, 41, |c, r| Vec3::new(0.5 * c, 0.5 * r, 0.02 * c)));
        let template = template();
        let found = find(&scan, &template, &VertexMasks::all(121), &limits());
        assert!(found.len() > 80);
        let slope = Vec3::new(-0.04, 0.0, 1.0).normalize();
        for m in 0..found.len() {
            let s = found.sample(m);
            approx::assert_abs_diff_eq!(found.normals[m], slope, epsilon = 1e-12);
            let [r] = found.residual::<f64>(m, template.positions[s].into());
            let offset = template.positions[s] - found.targets[m];
            // q is above its closest point: height 0.2 + 0.04 x along the vertical, less along the normal.
            let height = -offset.z;
            approx::assert_abs_diff_eq!(r, -height * slope.z, epsilon = 1e-9);
            assert!(offset.xy().norm() < 1e-9);
        }
    }

    #[test]
    fn far_turned_off_boundary_rim_and_masked_out_points_are_rejected() {
        let scan = || sheet(41, 41, |c, r| Vec3::new(0.5 * c, 0.5 * r, 0.0));
        let template = sheet(6, 6, |c, r| Vec3::new(5.0 + 2.0 * c, 5.0 + 2.0 * r, -1.0));
        let all = VertexMasks::all(36);
        let found = find(&surface(scan()), &template, &all, &limits());
        assert!(found.len() > 20);
        // Scan points beyond the template would pile up on its boundary.
        for target in &found.targets {
            assert!(target.x > 4.0 && target.x < 16.0 && target.y > 4.0 && target.y < 16.0, "{target}");
        }
        assert_eq!(find(&surface(scan()), &template, &all, &Acceptance { distance: 0.9, ..limits() }).len(), 0);
        let mut turned = scan();
        turned.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(find(&surface(turned), &template, &all, &limits()).len(), 0);
        let right: Vec<bool> = template.positions.iter().map(|p| p.x > 10.0).collect();
        let half: Vec<f64> = right.iter().map(|r| if *r { 0.0 } else { 0.5 }).collect();
        for masks in [VertexMasks::new(Some(&half), None, vec![false; 36]), VertexMasks::new(None, None, right.clone())]
        {
            let part = find(&surface(scan()), &template, &masks, &limits());
            assert!(!part.is_empty() && part.len() < found.len());
            assert!(part.samples.iter().all(|&s| !right[s]));
            let share = masks.data[part.samples[0]];
            assert!((part.weights[0] - share * found.weights[0]).abs() < 1e-12);
        }
    }
}
