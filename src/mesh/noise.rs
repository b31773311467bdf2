//! How noisy a scan is, and where: the deviation of each point along its normal, told from shape by neighbours.
//!
//! The height of a point over the mean of its neighbours is alike for neighbours on a smooth surface, and is not on a rough one: hair,
//! grazing sight, what a scanner has torn. So the mean square of a height less its neighbours' mean height, `((I - A)^2 x)_i` with the
//! averaging operator `A`, is that of the noise times a constant; it is averaged over two rings. What is as rough as this and as long as a
//! few edges cannot be told from shape, and shape that is not smooth along edges looks rough: a share of their length is taken off.

use rayon::prelude::*;

use super::Vec3;

/// Deviation that shape may have, as a share of the mean distance to the neighbours: faces scanned with edges of 1 to 4 mm have less.
const OF_SHAPE: f64 = 0.08;

/// Standard deviation of each point's noise along its unit normal, in the unit of `positions`; some 10 % right of white noise above a fifth of
/// the distance between points, and 0 where all may be shape. The nearest points of a cloud are those at its height, so that its noise seems
/// less, by up to a half.
pub fn noise<'a>(positions: &[Vec3], normals: &[Vec3], neighbours: impl Fn(usize) -> &'a [u32] + Sync) -> Vec<f32> {
    let count = positions.len();
    let mean = |of: &[f32], i: usize| {
        let round = neighbours(i);
        round.iter().map(|&j| of[j as usize]).sum::<f32>() / round.len().max(1) as f32
    };
    let height = |i: usize| {
        let round = neighbours(i);
        let middle = round.iter().map(|&j| positions[j as usize]).sum::<Vec3>() / round.len() as f64;
        if round.is_empty() { 0.0 } else { normals[i].dot(&(positions[i] - middle)) as f32 }
    };
    let heights: Vec<f32> = (0..count).into_par_iter().map(height).collect();
    let square = |i: usize| (heights[i] - mean(&heights, i)).powi(2) / of_white_noise(neighbours(i).len());
    let mut squares: Vec<f32> = (0..count).into_par_iter().map(square).collect();
    for _ in 0..2 {
        squares = (0..count).into_par_iter().map(|i| (squares[i] + mean(&squares, i)) / 2.0).collect();
    }
    let deviation = |i: usize| {
        let round = neighbours(i);
        let edges = round.iter().map(|&j| (positions[j as usize] - positions[i]).norm()).sum::<f64>();
        let of_shape = OF_SHAPE * edges / round.len().max(1) as f64;
        (squares[i] - of_shape.powi(2) as f32).max(0.0).sqrt()
    };
    (0..count).into_par_iter().map(deviation).collect()
}

/// Mean square of `((I - A)^2 x)_i` where `x` is white noise of variance one: 1.85 on the lattice where six meet, 1.3 among the
/// sixteen nearest of a cloud, between which this goes.
fn of_white_noise(neighbours: usize) -> f32 {
    1.0 + 5.0 / neighbours.max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::EdgeGraph;
    use crate::mesh::normals::{NormalWeighting, vertex_normals};
    use crate::mesh::testing;
    use crate::mesh::{OrientedPoints, TriangleMesh};

    /// A bowl with edges of about a millimetre, white noise of deviation `rough` along its normals where x is above 30.
    fn bowl(rough: f64) -> TriangleMesh {
        let place = |c: f64, r: f64| {
            let i = 3 * (61.0 * r + c) as usize;
            // the sum of three uniform numbers in [-1, 1) has variance one
            let white: f64 = (0..3).map(|k| testing::noise(i + k)).sum();
            let z = 0.01 * ((c - 30.0).powi(2) + (r - 30.0).powi(2));
            Vec3::new(c, r, z) + if c > 30.0 { Vec3::z() * (rough * white) } else { Vec3::zeros() }
        };
        testing::sheet(61, 61, place)
    }

    fn median(noise: &[f32], mesh: &TriangleMesh, from: f64) -> f64 {
        let inside = |p: &Vec3| (from..from + 20.0).contains(&p.x) && (5.0..55.0).contains(&p.y);
        let mut all: Vec<f32> =
            noise.iter().zip(&mesh.positions).filter(|(_, p)| inside(p)).map(|(noise, _)| *noise).collect();
        let middle = all.len() / 2;
        f64::from(*all.select_nth_unstable_by(middle, f32::total_cmp).1)
    }

    #[test]
    fn it_is_that_of_white_noise_where_there_is_some_on_a_mesh_and_in_a_cloud() {
        for rough in [0.3, 1.0] {
            let mesh = bowl(rough);
            let normals = vertex_normals(&bowl(0.0).positions, &mesh.triangles, NormalWeighting::Area);
            let edges = EdgeGraph::of(&mesh);
            let of_mesh = noise(&mesh.positions, &normals, |i| edges.neighbours(i));
            let cloud = OrientedPoints::new(&mesh.positions, &normals, 0).unwrap();
            let of_cloud: Vec<f32> = (0..mesh.positions.len()).map(|i| cloud.noise(i) as f32).collect();
            for (found, least) in [(of_mesh, 0.6), (of_cloud, 0.35)] {
                let (smooth, noisy) = (median(&found, &mesh, 5.0), median(&found, &mesh, 35.0));
                assert_eq!(smooth, 0.0);
                // less what may be shape
                assert!((least * rough..1.2 * rough).contains(&noisy), "{rough}: {noisy}");
            }
        }
    }

    #[test]
    fn what_hangs_together_with_nothing_has_none() {
        let points = [Vec3::zeros(), Vec3::x()];
        assert_eq!(noise(&points, &[Vec3::z(); 2], |_| &[]), [0.0; 2]);
    }
}
