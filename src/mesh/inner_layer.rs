//! A layer of tissue under a surface: an inner surface below it, and tetrahedra that fill what lies between.
//!
//! Each vertex has an inner node, `thickness` below it along its normal; each triangle then spans a prism, cut into three
//! tetrahedra. The diagonal of a prism's side runs from the outer end of its lower vertex to the inner end of its higher one, so
//! that neighbouring prisms agree (J. Dompierre et al., "How to subdivide pyramids, prisms, and hexahedra into tetrahedra", 1999).

use super::adjacency::vertex_triangles;
use super::closest_point::ClosestVertices;
use super::normals::{NormalWeighting, face_cross, vertex_normals};
use super::{MeshError, TriangleMesh, Vec3};

/// A prism's tetrahedra must have this part of the volume that they would have under a flat triangle.
const LEAST_VOLUME: f64 = 0.1;

/// How often the layer is halved where it folds before the prism is left out.
const HALVINGS: usize = 5;

/// A triangle has an area if its height is this part of its longest side.
const LEAST_HEIGHT: f64 = 1e-9;

/// The layer of a surface at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct InnerLayer {
    /// Nodes at rest: the surface's vertices, then the inner nodes.
    pub nodes: Vec<Vec3>,
    /// The node below each vertex; none where no prism has the vertex.
    pub below: Vec<Option<u32>>,
    /// Tetrahedra of the prisms, three for each, of positive volume.
    pub tetrahedra: Vec<[u32; 4]>,
    /// A tetrahedron of positive volume for each vertex without a prism, the vertex first: with three nodes of the nearest prism
    /// that has one.
    pub ties: Vec<[u32; 4]>,
}

/// Six times the signed volume of a tetrahedron: positive if `d` lies where `(b - a) x (c - a)` points.
#[must_use]
pub fn determinant(nodes: &[Vec3], [a, b, c, d]: [u32; 4]) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|k| nodes[k as usize]);
    (b - a).cross(&(c - a)).dot(&(d - a))
}

/// Gradients of the four linear shape functions of a tetrahedron, by the place.
pub(crate) fn shape_gradients(nodes: &[Vec3], tetrahedron: [u32; 4]) -> [Vec3; 4] {
    let [a, b, c, d] = tetrahedron.map(|k| nodes[k as usize]);
    let (p, q, r) = (b - a, c - a, d - a);
    let [b, c, d] = [q.cross(&r), r.cross(&p), p.cross(&q)].map(|g| g / determinant(nodes, tetrahedron));
    [-(b + c + d), b, c, d]
}

impl InnerLayer {
    /// The layer under `mesh`, `thickness` deep (in the mesh's unit), thinner where it would fold. Repeated triangles and those
    /// without area have no prism, nor has one that folds however thin it is; which way round a triangle goes says only where
    /// inside is.
    ///
    /// # Errors
    /// When a position is not finite, a triangle indexes past the vertices, or no triangle has an area.
    ///
    /// # Panics
    /// If `thickness` is not positive.
    pub fn new(mesh: &TriangleMesh, thickness: f64) -> Result<Self, MeshError> {
        assert!(thickness > 0.0, "the thickness must be positive");
        mesh.check()?;
        let count = mesh.positions.len();
        let triangles = bases(mesh);
        let directions = directions(mesh, &triangles);
        let mut depth = vec![thickness; count];
        let mut nodes = [&mesh.positions[..], &mesh.positions].concat();
        let mut sound = Vec::new();
        for halvings in 0..=HALVINGS {
            for (v, p) in mesh.positions.iter().enumerate() {
                nodes[count + v] = p - directions[v] * depth[v];
            }
            sound = triangles.iter().map(|&t| prism(&nodes, t, &depth)).collect();
            if sound.iter().all(Option::is_some) {
                break;
            }
            if halvings < HALVINGS {
                let mut folded = vec![false; count];
                let bad = triangles.iter().zip(&sound).filter(|s| s.1.is_none());
                bad.for_each(|(t, _)| t.iter().for_each(|&v| folded[v as usize] = true));
                depth.iter_mut().zip(&folded).filter(|f| *f.1).for_each(|(d, _)| *d /= 2.0);
            }
        }
        let mut below = vec![None; count];
        let mut tetrahedra = sound.into_iter().flatten().flatten().collect::<Vec<_>>();
        if tetrahedra.is_empty() {
            return Err(MeshError::NoArea);
        }
        tetrahedra.iter().flatten().filter(|k| **k >= count as u32).for_each(|k| below[*k as usize - count] = Some(0));
        let mut inner = Vec::new();
        for (v, below) in below.iter_mut().enumerate().filter(|(_, b)| b.is_some()) {
            *below = Some((count + inner.len()) as u32);
            inner.push(nodes[count + v]);
        }
        let renumbered =
            |k: &mut u32| *k = if *k < count as u32 { *k } else { below[*k as usize - count].unwrap_or(*k) };
        tetrahedra.iter_mut().flatten().for_each(renumbered);
        nodes.truncate(count);
        nodes.extend(inner);
        let ties = ties(&nodes, &below, &tetrahedra)?;
        Ok(Self { nodes, below, tetrahedra, ties })
    }
}

/// The triangles with an area, each once, its corners ascending.
fn bases(mesh: &TriangleMesh) -> Vec<[u32; 3]> {
    let mut bases: Vec<[u32; 3]> = mesh.triangles.clone();
    bases.iter_mut().for_each(|t| t.sort_unstable());
    bases.sort_unstable();
    bases.dedup();
    bases.retain(|&t| {
        let side = |a: usize| (mesh.positions[t[a] as usize] - mesh.positions[t[(a + 1) % 3] as usize]).norm_squared();
        let longest = side(0).max(side(1)).max(side(2));
        face_cross(&mesh.positions, t).norm() > LEAST_HEIGHT * longest
    });
    bases
}

/// Outward unit normal of every vertex with a base. Where its triangles point against each other, that of the first.
fn directions(mesh: &TriangleMesh, bases: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Angle);
    let of = vertex_triangles(mesh.positions.len(), bases);
    for (v, normal) in normals.iter_mut().enumerate().filter(|(_, n)| **n == Vec3::zeros()) {
        if let Some(&first) = of.row(v).first() {
            *normal = face_cross(&mesh.positions, bases[first as usize]).normalize();
        }
    }
    normals
}

/// The three tetrahedra under a base whose corners ascend; none if one of them is flat or turned inside out.
fn prism(nodes: &[Vec3], [a, b, c]: [u32; 3], depth: &[f64]) -> Option<[[u32; 4]; 3]> {
    let below = |v: u32| v + (nodes.len() / 2) as u32;
    // Of positive volume where a, b, c run counter-clockwise seen from outside.
    let cut = [[b, a, c, below(c)], [a, b, below(b), below(c)], [below(a), a, below(b), below(c)]];
    let volumes = cut.map(|t| determinant(nodes, t));
    let side = volumes.iter().sum::<f64>().signum();
    let base = face_cross(nodes, [a, b, c]).norm();
    let sound = volumes.iter().zip([c, b, a]).all(|(v, k)| side * v >= LEAST_VOLUME * base * depth[k as usize]);
    sound.then(|| if side > 0.0 { cut } else { cut.map(|[p, q, r, s]| [q, p, r, s]) })
}

/// For each vertex without a node below, a tetrahedron with the nearest vertex' first one: of its four sides the one from which
/// the vertex is farthest.
fn ties(nodes: &[Vec3], below: &[Option<u32>], tetrahedra: &[[u32; 4]]) -> Result<Vec<[u32; 4]>, MeshError> {
    let mut first = vec![None; below.len()];
    for tetrahedron in tetrahedra.iter().rev() {
        let outer = tetrahedron.iter().filter(|k| (**k as usize) < below.len());
        outer.for_each(|&k| first[k as usize] = Some(*tetrahedron));
    }
    let anchors: Vec<[u32; 4]> = first.iter().flatten().copied().collect();
    let places: Vec<Vec3> = (0..below.len()).filter(|&v| first[v].is_some()).map(|v| nodes[v]).collect();
    let nearest = ClosestVertices::new(&places)?;
    let tie = |v: usize| {
        let anchor = anchors[nearest.query(&nodes[v])?.vertex as usize];
        let sides = (0..4).map(|k| [v as u32, anchor[(k + 1) % 4], anchor[(k + 2) % 4], anchor[(k + 3) % 4]]);
        let distance =
            |&[v, a, b, c]: &[u32; 4]| determinant(nodes, [v, a, b, c]).abs() / face_cross(nodes, [a, b, c]).norm();
        let farthest = sides.max_by(|s, t| distance(s).total_cmp(&distance(t)))?;
        let [v, a, b, c] = farthest;
        Some(if determinant(nodes, farthest) > 0.0 { farthest } else { [v, b, a, c] })
    };
    Ok((0..below.len()).filter(|&v| first[v].is_none()).filter_map(tie).collect())
}
