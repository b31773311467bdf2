//! Which parts of a surface the surface itself hides: insides of nostrils, lips and armpits, teeth and sockets of a whole head.
//!
//! Ambient occlusion (S. Zhukov, A. Iones, G. Kronin, "An ambient light illumination model", 1998): the share of the directions
//! over a vertex, weighted by their cosine to its normal, along which the surface stands in the way.

use nalgebra::Unit;
use rayon::prelude::*;

use super::closest_point::ClosestPoint;
use super::normals::{NormalWeighting, vertex_areas, vertex_normals};
use super::{MeshError, TriangleMesh, Vec3, rms_size};

/// Directions over a vertex, and how many must be free for a scanner to see it.
const DIRECTIONS: usize = 16;
const FREE: usize = 2;
/// How far along a direction the surface stands in the way, and from where on, as a share of its size: what touches hides nothing.
const FAR: f64 = 2.0;
const NEAR: f64 = 5e-4;

/// Vertices that no scanner sees, whatever it looks at from outside: the surface's own front stands in the way of all but one of
/// sixteen directions over them. None if that would be half of its area or more: then it faces inwards.
///
/// Turning and scaling the mesh changes nothing (but for rounding).
///
/// # Errors
/// When a triangle indexes past the vertices, or a vertex of one is not finite.
pub fn hidden_vertices(mesh: &TriangleMesh) -> Result<Vec<bool>, MeshError> {
    let surface = ClosestPoint::new(mesh)?;
    let size = rms_size(&mesh.surface_points());
    // the whole of the way is what lies so near to its middle
    let (middle, reach) = (0.5 * (NEAR + FAR) * size, 0.5 * (FAR - NEAR) * size);
    let normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
    let neighbours = neighbours(mesh);
    let directions = directions();
    let is_hidden = |v: usize| {
        let normal = normals[v];
        let along = mesh.positions[neighbours[v] as usize] - mesh.positions[v];
        let Some(side) = Unit::try_new(along - normal * normal.dot(&along), 0.0).filter(|_| normal != Vec3::zeros())
        else {
            return false;
        };
        let (x, y) = (side.into_inner(), normal.cross(&side));
        let is_free = |d: &&Vec3| {
            let direction = x * d.x + y * d.y + normal * d.z;
            // fronts face against it
            surface.along(&(mesh.positions[v] + direction * middle), &-direction, reach, u32::MAX).is_none()
        };
        directions.iter().filter(is_free).take(FREE).count() < FREE
    };
    let hidden: Vec<bool> = (0..mesh.positions.len()).into_par_iter().map(is_hidden).collect();
    let areas = vertex_areas(&mesh.positions, &mesh.triangles);
    let hidden_area: f64 = areas.iter().zip(&hidden).filter_map(|(area, hidden)| hidden.then_some(area)).sum();
    Ok(if 2.0 * hidden_area >= areas.iter().sum() { vec![false; hidden.len()] } else { hidden })
}

/// A neighbour of each vertex, itself where no triangle has it.
fn neighbours(mesh: &TriangleMesh) -> Vec<u32> {
    let mut neighbours: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for &[a, b, c] in mesh.triangles.iter().rev() {
        (neighbours[a as usize], neighbours[b as usize], neighbours[c as usize]) = (b, c, a);
    }
    neighbours
}

/// Directions whose density over the half sphere is the cosine to its pole, z, those near the pole first: a spiral of Fibonacci's on
/// the disc below it.
fn directions() -> [Vec3; DIRECTIONS] {
    let turn = std::f64::consts::PI * (1.0 + 5f64.sqrt());
    std::array::from_fn(|i| {
        let squared = (i as f64 + 0.5) / DIRECTIONS as f64;
        let (y, x) = (turn * (i as f64 + 0.5)).sin_cos();
        let radius = squared.sqrt();
        Vec3::new(radius * x, radius * y, (1.0 - squared).sqrt())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;

    /// A round table with a bag below an opening in its middle.
    fn bag(opening: f64) -> TriangleMesh {
        let profile = |s: f64| match s {
            s if s < 1.0 => (20.0 * s, -40.0),
            s if s < 2.0 => (20.0, -40.0 + 38.0 * (s - 1.0)),
            s if s < 3.0 => (20.0 + (opening - 20.0) * (s - 2.0), -2.0 + 2.0 * (s - 2.0)),
            s => (opening + 60.0 * (s - 3.0), 0.0),
        };
        sheet(49, 41, |c, r| {
            let ((radius, height), angle) = (profile(r / 10.0), -c / 48.0 * std::f64::consts::TAU);
            Vec3::new(radius.max(1e-3) * angle.cos(), radius.max(1e-3) * angle.sin(), height)
        })
    }

    fn share(hidden: &[bool], mesh: &TriangleMesh, of: impl Fn(&Vec3) -> bool) -> f64 {
        let among: Vec<bool> = mesh.positions.iter().zip(hidden).filter(|(p, _)| of(p)).map(|(_, h)| *h).collect();
        among.iter().filter(|h| **h).count() as f64 / among.len() as f64
    }

    #[test]
    fn a_cavity_is_hidden_and_a_bowl_is_not() {
        let inside = |p: &Vec3| p.z < -3.0;
        let (narrow, open) = (bag(3.0), bag(20.0));
        let hidden = hidden_vertices(&narrow).unwrap();
        assert!(share(&hidden, &narrow, inside) > 0.9, "{}", share(&hidden, &narrow, inside));
        assert_eq!(share(&hidden, &narrow, |p| p.z > -1e-9), 0.0);
        let hidden = hidden_vertices(&open).unwrap();
        assert!(share(&hidden, &open, inside) < 0.2, "{}", share(&hidden, &open, inside));
    }

    #[test]
    fn turned_and_scaled_it_is_the_same() {
        let mesh = bag(6.0);
        let hidden = hidden_vertices(&mesh).unwrap();
        let count = hidden.iter().filter(|h| **h).count();
        assert!(count > 100);
        let turn = nalgebra::Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        let moved = |scale: f64| TriangleMesh {
            positions: mesh.positions.iter().map(|p| turn * p * scale + Vec3::new(5.0, 900.0, -3.0)).collect(),
            ..mesh.clone()
        };
        for scale in [1.0, 1e-3, 37.0] {
            let other = hidden_vertices(&moved(scale)).unwrap();
            let differ = hidden.iter().zip(&other).filter(|(a, b)| a != b).count();
            assert!(differ <= count / 50, "{differ} of {count}");
        }
    }

    #[test]
    fn what_faces_inwards_hides_nothing() {
        let mut mesh = sheet(33, 17, |c, r| {
            let (around, up) = (c / 32.0 * std::f64::consts::TAU, (r / 16.0 - 0.5) * 3.1);
            Vec3::new(around.cos() * up.cos(), around.sin() * up.cos(), up.sin())
        });
        assert_eq!(hidden_vertices(&mesh).unwrap(), vec![false; mesh.positions.len()]);
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        assert_eq!(hidden_vertices(&mesh).unwrap(), vec![false; mesh.positions.len()]);
        let nothing = TriangleMesh { positions: vec![Vec3::zeros(); 3], triangles: vec![] };
        assert_eq!(hidden_vertices(&nothing).unwrap(), [false; 3]);
    }
}
