//! Rigs in numbers, to put one next to another: sizes of the template's edges, its curvature, the spectrum of the identity
//! modes, the reach of the expressions.

use anyhow::{Context, Result};
use nonrigid::evaluation::percentile;
use nonrigid::mesh::Vec3;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::rig::{Family, Rig};

/// Percentiles that are reported.
pub const PERCENTS: [f64; 5] = [1.0, 25.0, 50.0, 75.0, 99.0];

/// Modes whose deviation is reported, counted from 1.
pub const MODES: [usize; 8] = [1, 2, 5, 10, 20, 40, 60, 100];

/// What a rig is like.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct RigStatistics {
    /// Vertices of the template.
    pub vertices: usize,
    /// Polygons of the template.
    pub polygons: usize,
    /// Lengths of the polygons' edges at [`PERCENTS`], mm.
    pub edge_lengths: Vec<f64>,
    /// Normal curvature along the edges at [`PERCENTS`], 1/mm: (n_j - n_i).(x_j - x_i) / |x_j - x_i|^2, positive where the
    /// surface bulges.
    pub curvature: Vec<f64>,
    /// Expressions that move something.
    pub expressions: usize,
    /// Longest way of a vertex at weight 1, at [`PERCENTS`] of the expressions, mm.
    pub expression_reach: Vec<f64>,
    /// Share of the vertices that an expression moves by more than a tenth of its reach, at [`PERCENTS`] of the expressions.
    pub expression_extent: Vec<f64>,
    /// Root mean square displacement of the vertices by each identity mode at weight 1, mm.
    pub identity_rms: Vec<f64>,
    /// Root mean square distance of a random person's vertices from the neutral, mm.
    pub identity_total: f64,
}

impl RigStatistics {
    /// Measures a rig.
    ///
    /// # Errors
    /// When it has no polygons.
    pub fn of(rig: &Rig) -> Result<Self> {
        let mesh = rig.mesh().context("the rig has no polygons: template.obj is missing")?;
        let graph = EdgeGraph::from_polygons(mesh);
        let positions = &mesh.positions;
        let normals = vertex_normals(positions, &mesh.triangulate().triangles, NormalWeighting::Area);
        let curvature = |[i, j]: &[u32; 2]| {
            let (i, j) = (*i as usize, *j as usize);
            let along = positions[j] - positions[i];
            (normals[j] - normals[i]).dot(&along) / along.norm_squared()
        };
        let curvature: Vec<f64> = graph.edges().iter().map(curvature).filter(|c| c.is_finite()).collect();

        let (mut reach, mut extent, mut identity_rms) = (Vec::new(), Vec::new(), Vec::new());
        for (k, shape) in rig.shapes().iter().enumerate() {
            let deltas = rig.deltas(k).chunks_exact(3).map(|d| Vec3::new(d[0].into(), d[1].into(), d[2].into()).norm());
            let moved: Vec<f64> = deltas.collect();
            if shape.family == Family::Identity {
                identity_rms.push((moved.iter().map(|d| d * d).sum::<f64>() / moved.len() as f64).sqrt());
            } else {
                let longest = moved.iter().copied().fold(0.0, f64::max);
                reach.push(longest);
                extent.push(moved.iter().filter(|d| **d > 0.1 * longest).count() as f64 / moved.len() as f64);
            }
        }
        Ok(Self {
            vertices: positions.len(),
            polygons: mesh.polygon_count(),
            edge_lengths: percentiles(&graph.lengths(positions)),
            curvature: percentiles(&curvature),
            expressions: reach.len(),
            expression_reach: percentiles(&reach),
            expression_extent: percentiles(&extent),
            identity_total: identity_rms.iter().map(|r| r * r).sum::<f64>().sqrt(),
            identity_rms,
        })
    }

    /// Name and text of each row of a table that puts rigs side by side.
    #[must_use]
    pub fn rows(&self) -> Vec<(String, String)> {
        let list = |values: &[f64], digits: usize| {
            values.iter().map(|v| format!("{v:.digits$}")).collect::<Vec<_>>().join("  ")
        };
        let percents = format!("at {} %", PERCENTS.map(|p| p.to_string()).join(", "));
        let spectrum = MODES.iter().filter_map(|k| Some((k, self.identity_rms.get(k - 1)?)));
        let mut rows = vec![
            ("vertices, polygons".into(), format!("{}, {}", self.vertices, self.polygons)),
            (format!("edge length / mm {percents}"), list(&self.edge_lengths, 2)),
            (format!("curvature / (1/mm) {percents}"), list(&self.curvature, 3)),
            ("expressions".into(), self.expressions.to_string()),
            (format!("their reach / mm {percents}"), list(&self.expression_reach, 1)),
            (format!("share of vertices moved {percents}"), list(&self.expression_extent, 2)),
            ("identity modes".into(), self.identity_rms.len().to_string()),
            ("identity, all modes: rms / mm".into(), format!("{:.2}", self.identity_total)),
        ];
        rows.extend(spectrum.map(|(k, rms)| (format!("identity mode {k}: rms / mm"), format!("{rms:.3}"))));
        rows
    }
}

fn percentiles(values: &[f64]) -> Vec<f64> {
    PERCENTS.iter().filter_map(|p| percentile(values, *p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nonrigid::mesh::PolygonMesh;
    use nonrigid::rig::Shape;

    #[test]
    fn measures_what_is_known_of_a_cylinder() {
        // Radius 10, 60 quads round, 5 high.
        let ring = |k: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 60.0).sin_cos();
            Vec3::new(10.0 * sin, 0.0, 10.0 * cos)
        };
        let positions: Vec<Vec3> =
            (0..6).flat_map(|j| (0..60).map(move |k| ring(k) + Vec3::y() * f64::from(j))).collect();
        let at = |j: u32, k: u32| j * 60 + k % 60;
        let corners =
            (0..5).flat_map(|j| (0..60).flat_map(move |k| [at(j, k), at(j, k + 1), at(j + 1, k + 1), at(j + 1, k)]));
        let mesh = PolygonMesh {
            positions: positions.clone(),
            starts: (0..=300).map(|k| 4 * k).collect(),
            corners: corners.collect(),
            ..PolygonMesh::default()
        };
        let mode = |length: f32| (0..360).flat_map(move |_| [0.0, length, 0.0]);
        let shapes = [("a", Family::Identity), ("b", Family::Identity), ("c", Family::Expression)]
            .map(|(name, family)| Shape { name: name.into(), family });
        let deltas = mode(4.0).chain(mode(3.0)).chain((0..1080).map(|i| if i == 0 { 7.0 } else { 0.0 }));
        let (rig, _) = Rig::new(positions, Some(mesh), shapes.to_vec(), deltas.collect()).unwrap();
        let s = RigStatistics::of(&rig).unwrap();
        assert_eq!((s.vertices, s.polygons, s.expressions), (360, 300, 1));
        assert!((s.curvature[0]).abs() < 1e-12 && (s.curvature[4] - 0.1).abs() < 1e-3, "{:?}", s.curvature);
        assert!((s.edge_lengths[2] - 1.0).abs() < 0.05);
        assert_eq!((s.identity_rms.clone(), s.identity_total), (vec![4.0, 3.0], 5.0));
        assert!((s.expression_reach[2] - 7.0).abs() < 1e-9 && (s.expression_extent[2] - 1.0 / 360.0).abs() < 1e-9);
    }
}
