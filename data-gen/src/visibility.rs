//! What a camera sees of a mesh: a depth buffer and the angle of the surface.

use nonrigid::mesh::Vec3;

/// Side of the depth buffer, cells.
const SIZE: usize = 320;

/// For every vertex, the cosine between its normal and the direction to the camera at `eye`, or `None` where another part of
/// the mesh hides it by more than `tolerance` millimetres.
pub(crate) fn seen_from(
    eye: Vec3,
    positions: &[Vec3],
    normals: &[Vec3],
    triangles: &[[u32; 3]],
    tolerance: f64,
) -> Vec<Option<f64>> {
    let centre = positions.iter().sum::<Vec3>() / positions.len().max(1) as f64;
    let back = (eye - centre).normalize();
    let right = Vec3::y().cross(&back).try_normalize(1e-9).unwrap_or_else(Vec3::x);
    let up = back.cross(&right);
    let plane: Vec<[f64; 3]> = positions
        .iter()
        .map(|p| {
            let d = p - eye;
            let depth = -d.dot(&back);
            [d.dot(&right) / depth, d.dot(&up) / depth, depth]
        })
        .collect();
    let reach = plane.iter().flat_map(|p| [p[0].abs(), p[1].abs()]).fold(1e-9, f64::max);
    let cell = |c: f64| (c / reach * 0.5 + 0.5) * (SIZE - 1) as f64;
    let mut depth = vec![f64::INFINITY; SIZE * SIZE];
    for t in triangles {
        let [a, b, c] = t.map(|v| plane[v as usize]).map(|p| [cell(p[0]), cell(p[1]), p[2]]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-12 {
            continue;
        }
        let span = |axis: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).ceil().max(0.0) as usize;
            low..=(a[axis].max(b[axis]).max(c[axis]).floor().max(0.0) as usize).min(SIZE - 1)
        };
        for y in span(1) {
            for x in span(0) {
                let (px, py) = (x as f64 - a[0], y as f64 - a[1]);
                let wb = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / area;
                let wc = (py * (b[0] - a[0]) - px * (b[1] - a[1])) / area;
                if wb >= 0.0 && wc >= 0.0 && wb + wc <= 1.0 {
                    let z = a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2]);
                    let slot = &mut depth[y * SIZE + x];
                    *slot = slot.min(z);
                }
            }
        }
    }
    (0..positions.len())
        .map(|v| {
            let (x, y) = (cell(plane[v][0]).round() as usize, cell(plane[v][1]).round() as usize);
            let nearest = depth[y.min(SIZE - 1) * SIZE + x.min(SIZE - 1)];
            let cosine = normals[v].dot(&(eye - positions[v]).normalize());
            // A slanted surface changes depth within a cell.
            (plane[v][2] <= nearest + tolerance / cosine.abs().max(0.2)).then_some(cosine)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};

    #[test]
    fn what_lies_behind_is_hidden() {
        let square = |z: f64, h: f64| [[-h, -h], [h, -h], [h, h], [-h, h]].map(|[x, y]| Vec3::new(x, y, z));
        let mut positions = square(0.0, 30.0).to_vec();
        positions.extend(square(-50.0, 10.0));
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let normals = vertex_normals(&positions, &triangles, NormalWeighting::Area);
        let front = seen_from(Vec3::new(0.0, 0.0, 600.0), &positions, &normals, &triangles, 1.0);
        assert!(front[..4].iter().all(Option::is_some) && front[4..].iter().all(Option::is_none));
        let behind = seen_from(Vec3::new(0.0, 0.0, -600.0), &positions, &normals, &triangles, 1.0);
        assert!(behind.iter().all(|c| c.is_some_and(|c| c < 0.0)));
    }
}
