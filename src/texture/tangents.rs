//! Tangents of the template, along which its texture's u grows: at each corner the mean over the triangles that share its vertex and
//! its texture coordinate, by their angles (Mikkelsen, "Simulation of wrinkled surfaces revisited", 2008), so that programs that make
//! tangents in that way show the normals that were baked.

use std::collections::HashMap;

use super::atlas::Atlas;
use crate::mesh::{PolygonMesh, Vec3};

/// For each corner of each triangle a tangent perpendicular to its vertex's normal, and for each triangle whether its texture is in
/// the mirror: -1 then, else 1.
pub(super) fn tangents(mesh: &PolygonMesh, atlas: &Atlas, normals: &[Vec3]) -> (Vec<[Vec3; 3]>, Vec<f64>) {
    let uv = |corner: u32| {
        let index = mesh.metadata.corner_uvs.get(corner as usize).copied().unwrap_or(u32::MAX);
        (index, mesh.metadata.uvs.get(index as usize).copied().unwrap_or([0.0; 2]))
    };
    let mut signs = Vec::with_capacity(atlas.corners.len());
    let mut sums: HashMap<(u32, u32, bool), Vec3> = HashMap::new();
    for corners in &atlas.corners {
        let vertices = corners.map(|c| mesh.corners[c as usize]);
        let [p, q, r] = vertices.map(|v| mesh.positions[v as usize]);
        let [a, b, c] = corners.map(|c| uv(c).1);
        let (along, up) = ([b[0] - a[0], c[0] - a[0]], [b[1] - a[1], c[1] - a[1]]);
        let double_area = along[0] * up[1] - along[1] * up[0];
        signs.push(if double_area < 0.0 { -1.0 } else { 1.0 });
        let tangent = ((q - p) * up[1] - (r - p) * up[0]) * double_area.signum();
        for k in 0..3 {
            let v = vertices[k] as usize;
            let flat = |e: Vec3| e - normals[v] * normals[v].dot(&e);
            let here = [p, q, r];
            let (e, f) = (flat(here[(k + 1) % 3] - here[k]), flat(here[(k + 2) % 3] - here[k]));
            let angle = e.cross(&f).norm().atan2(e.dot(&f));
            if let Some(unit) = flat(tangent).try_normalize(0.0).filter(|_| double_area != 0.0) {
                *sums.entry((vertices[k], uv(corners[k]).0, double_area < 0.0)).or_default() += unit * angle;
            }
        }
    }
    let tangents = atlas.corners.iter().zip(&signs).map(|(corners, sign)| {
        corners.map(|corner| {
            let v = mesh.corners[corner as usize];
            let sum = sums.get(&(v, uv(corner).0, *sign < 0.0)).copied().unwrap_or_default();
            sum.try_normalize(0.0).unwrap_or_else(|| any_perpendicular(&normals[v as usize]))
        })
    });
    (tangents.collect(), signs)
}

fn any_perpendicular(normal: &Vec3) -> Vec3 {
    let axis = if normal.x.abs() < 0.5 { Vec3::x() } else { Vec3::y() };
    normal.cross(&axis).try_normalize(0.0).unwrap_or_else(Vec3::x)
}
