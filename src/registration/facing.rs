//! Which side of a scan is its front: triangles that face either way are made to agree with their neighbours, and a scan
//! whose normals point inwards is turned over.

use std::borrow::Cow;

use rayon::prelude::*;
use serde::Serialize;

use crate::correspondence::ScanSurface;
use crate::mesh::normals::{NormalWeighting, face_areas, vertex_normals};
use crate::mesh::rows::Rows;
use crate::mesh::{TriangleMesh, Vec3, first_at_place};

/// What was done to a scan so that it is one surface that faces outwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct ScanFacing {
    /// Vertices of triangles that are where one before them is, bit for bit, and count as that one: some files keep the corners of each
    /// triangle, or the two sides of a seam, apart. Normals of the file are not used then.
    pub joined: usize,
    /// Triangles that were left out, since two of their corners are at one place: strips are sewn with such.
    pub collapsed: usize,
    /// Triangles that were left out, since one before them has the same corners: a scan whose surface is there twice, for both sides
    /// to be seen, faces nowhere.
    pub repeated: usize,
    /// Triangles that were turned to agree with their neighbours.
    pub turned: usize,
    /// Whether the file's normals are not those of its triangles, and were not used.
    pub normals_ignored: bool,
    /// Whether the whole scan was turned over after that.
    pub flipped: bool,
}

/// Scans of depth cameras have some triangles twice; so many are another matter.
const WORTH_A_WORD: usize = 100;

/// A scan and its normals, as registered.
pub(super) type Faced<'a> = (Cow<'a, TriangleMesh>, Option<Cow<'a, [Vec3]>>);

impl ScanFacing {
    /// What was found wrong with the scan, but that it was turned over.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let Self { repeated, turned, normals_ignored, .. } = self;
        let repeats = format!(
            "{repeated} of the scan's triangles repeat others, as the far side of a double-sided surface does, and were left out"
        );
        let turns = format!("{turned} of the scan's triangles faced against their neighbours and were turned");
        let normals = "the scan's normals are not those of its triangles, as after a program that turned its vertices alone; they were \
                       not used";
        let all = [(*repeated >= WORTH_A_WORD, repeats), (*turned > 0, turns), (*normals_ignored, normals.to_owned())];
        all.into_iter().filter(|remark| remark.0).map(|remark| remark.1).collect()
    }

    /// The scan and its own normals, facing outwards.
    #[must_use]
    pub fn apply<'a>(
        &self,
        scan: &'a TriangleMesh,
        normals: Option<&'a [Vec3]>,
    ) -> (Cow<'a, TriangleMesh>, Option<Cow<'a, [Vec3]>>) {
        let normals = normals.filter(|_| !self.normals_ignored && self.joined == 0);
        let scan = if self.joined + self.collapsed > 0 { joined(scan).0 } else { Cow::Borrowed(scan) };
        let scan = if self.repeated + self.turned > 0 { agreeing(scan).0 } else { scan };
        if self.flipped { flipped((scan, normals.map(Cow::Borrowed))) } else { (scan, normals.map(Cow::Borrowed)) }
    }

    /// Which of the scan's triangles each one of [`apply`](Self::apply) is; `None` if none was left out.
    #[must_use]
    pub fn sources(&self, scan: &TriangleMesh) -> Option<Vec<u32>> {
        if self.collapsed + self.repeated == 0 {
            return None;
        }
        let first = first_at_place(&scan.positions);
        let corners = |t: u32| scan.triangles[t as usize].map(|v| first[v as usize]);
        let mut left: Vec<u32> = (0..scan.triangles.len() as u32).filter(|&t| !is_collapsed(&corners(t))).collect();
        if self.repeated > 0 {
            let triangles = left.iter().map(|&t| corners(t)).collect();
            leave_out(&mut left, &shared_edges(&TriangleMesh { positions: scan.positions.clone(), triangles }).1);
        }
        Some(left)
    }
}

/// The scan turned over.
pub(super) fn flipped((scan, normals): Faced<'_>) -> Faced<'_> {
    let mut scan = scan.into_owned();
    scan.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    (Cow::Owned(scan), normals.map(|n| Cow::Owned(n.iter().map(|n| -n).collect())))
}

/// The scan with the first vertex at each place for all that are there, and without triangles that have two corners at one.
pub(super) fn joined(scan: &TriangleMesh) -> (Cow<'_, TriangleMesh>, ScanFacing) {
    if scan.triangles.is_empty() {
        return (Cow::Borrowed(scan), ScanFacing::default());
    }
    let first = first_at_place(&scan.positions);
    let corners = scan.triangles.as_flattened().iter().copied();
    let mut again: Vec<u32> = corners.filter(|&v| first[v as usize] != v).collect();
    again.sort_unstable();
    again.dedup();
    let triangles = scan.triangles.iter().map(|t| t.map(|v| first[v as usize]));
    let triangles: Vec<[u32; 3]> = triangles.filter(|t| !is_collapsed(t)).collect();
    let collapsed = scan.triangles.len() - triangles.len();
    // Where nothing would be left, whoever asks for its area says so.
    if triangles.is_empty() || again.len() + collapsed == 0 {
        return (Cow::Borrowed(scan), ScanFacing::default());
    }
    let facing = ScanFacing { joined: again.len(), collapsed, ..ScanFacing::default() };
    (Cow::Owned(TriangleMesh { positions: scan.positions.clone(), triangles }), facing)
}

pub(super) fn is_collapsed([a, b, c]: &[u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// The scan without triangles that repeat others, where triangles on both sides of an edge that only they share run along it in opposite
/// directions. Parts where some do not are made so, by turning those of the smaller area; what cannot be, as a Moebius strip, is left
/// alone. The scan, and what was done to it.
pub(super) fn agreeing(scan: Cow<'_, TriangleMesh>) -> (Cow<'_, TriangleMesh>, ScanFacing) {
    let (shared, repeated) = shared_edges(&scan);
    let (mut once, turned) = turned_alike(scan, shared);
    if !repeated.is_empty() {
        leave_out(&mut once.to_mut().triangles, &repeated);
    }
    (once, ScanFacing { repeated: repeated.len(), turned, ..ScanFacing::default() })
}

/// Takes out those at these indices, which are in order.
fn leave_out<T>(items: &mut Vec<T>, indices: &[u32]) {
    let (mut k, mut left_out) = (0, indices.iter().peekable());
    items.retain(|_| {
        k += 1;
        left_out.next_if_eq(&&(k - 1)).is_none()
    });
}

/// The scan, those of its triangles turned that face against their neighbours, and how many these are.
pub(super) fn turned(scan: Cow<'_, TriangleMesh>) -> (Cow<'_, TriangleMesh>, usize) {
    let shared = shared_edges(&scan).0;
    turned_alike(scan, shared)
}

/// Turns triangles until neighbours agree, and says how many. Of two at an edge that only they share is known whether they run along it
/// the same way.
fn turned_alike(scan: Cow<'_, TriangleMesh>, shared: Vec<(u32, u32, bool)>) -> (Cow<'_, TriangleMesh>, usize) {
    if !shared.iter().any(|&(.., disagree)| disagree) {
        return (scan, 0);
    }
    let mut neighbours: Vec<[(u32, bool); 3]> = vec![[(u32::MAX, false); 3]; scan.triangles.len()];
    for (i, j, disagree) in shared {
        for (from, to) in [(i, j), (j, i)] {
            if let Some(free) = neighbours[from as usize].iter_mut().find(|n| n.0 == u32::MAX) {
                *free = (to, disagree);
            }
        }
    }
    let areas = face_areas(&scan.positions, &scan.triangles);
    let mut turn: Vec<Option<bool>> = vec![None; scan.triangles.len()];
    let mut turned = 0;
    for seed in 0..turn.len() {
        if turn[seed].is_some() {
            continue;
        }
        turn[seed] = Some(false);
        let (mut part, mut next, mut contradiction) = (vec![seed], 0, false);
        while next < part.len() {
            let at = part[next];
            next += 1;
            for &(other, disagree) in neighbours[at].iter().filter(|n| n.0 != u32::MAX) {
                let wanted = turn[at] == Some(!disagree);
                match turn[other as usize] {
                    None => {
                        turn[other as usize] = Some(wanted);
                        part.push(other as usize);
                    }
                    Some(is) => contradiction |= is != wanted,
                }
            }
        }
        let area = |turned: bool| part.iter().filter(|&&k| turn[k] == Some(turned)).map(|&k| areas[k]).sum::<f64>();
        let keep = area(true) <= area(false);
        for &k in &part {
            turn[k] = Some(!contradiction && (turn[k] == Some(keep)));
            turned += usize::from(turn[k] == Some(true));
        }
    }
    let mut scan = scan.into_owned();
    scan.triangles.iter_mut().zip(turn).filter(|t| t.1 == Some(true)).for_each(|t| t.0.swap(1, 2));
    (Cow::Owned(scan), turned)
}

/// The triangles at each edge that has just two, and whether both run along it in the same direction, by the edges' vertices; and triangles
/// that have the corners of one before them, which do not count.
fn shared_edges(scan: &TriangleMesh) -> (Vec<(u32, u32, bool)>, Vec<u32>) {
    let side = |s: u32| {
        let (t, corner) = (scan.triangles[s as usize / 3], s as usize % 3);
        (t[corner], t[(corner + 1) % 3])
    };
    let proper = (0..scan.triangles.len() as u32).filter(|&k| !is_collapsed(&scan.triangles[k as usize]));
    let sides = proper.flat_map(|k| 3 * k..3 * k + 3);
    let lowest = Rows::sorted(scan.positions.len(), sides.map(|s| (side(s).0.min(side(s).1), s)));
    let third = |k: u32| scan.triangles[k as usize].iter().fold(0, |all, v| all ^ v);
    let (mut shared, mut row) = (Vec::with_capacity(lowest.items().len() / 2), Vec::new());
    let (mut repeated, mut once) = (Vec::new(), Vec::new());
    for low in 0..lowest.len() {
        row.clear();
        row.extend(lowest.row(low).iter().map(|&s| (side(s).0.max(side(s).1), side(s).0 == low as u32, s / 3)));
        row.sort_unstable();
        for edge in row.chunk_by(|x, y| x.0 == y.0).filter(|edge| edge.len() > 1) {
            if let [(_, first, i), (_, second, j)] = *edge
                && third(i) != third(j)
            {
                shared.push((i, j, first == second));
                continue;
            }
            // Of those with one third corner the first.
            once.clear();
            once.extend(edge.iter().map(|&(_, direction, k)| (third(k), k, direction)));
            once.sort_unstable();
            repeated.extend(once.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1));
            once.dedup_by_key(|of| of.0);
            if let [(_, i, first), (_, j, second)] = once[..] {
                shared.push((i, j, first == second));
            }
        }
    }
    repeated.sort_unstable();
    repeated.dedup();
    (shared, repeated)
}

/// Share of the vertices at which a file's normals are within 60 degrees of those of its triangles, whichever way these face, below which
/// they are of something else.
const BELIEVED: f64 = 0.8;

/// Whether normals are those of a mesh; of a cloud they are all there is.
pub(super) fn belong(mesh: &TriangleMesh, normals: &[Vec3]) -> bool {
    let of_triangles = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
    let known = normals.iter().zip(&of_triangles).filter(|(a, b)| **a != Vec3::zeros() && **b != Vec3::zeros());
    let (agree, known) = known
        .fold((0, 0), |(agree, known), (a, b)| (agree + usize::from(a.dot(b).abs() > ALIKE * a.norm()), known + 1));
    mesh.triangles.is_empty() || (known > 0 && agree as f64 >= BELIEVED * f64::from(known))
}

/// Cosine between two normals that agree, and minus that between those that do not.
const ALIKE: f64 = 0.5;
/// Points that have to say so, and how many times those that say otherwise.
const LEAST: usize = 20;
const TIMES: usize = 3;

/// Whether a surface faces inwards, by points of the template near it and their normals.
pub(super) fn faces_inwards(scan: &ScanSurface, points: &[Vec3], normals: &[Vec3], reach: f64) -> bool {
    let cosine = |(p, n): (&Vec3, &Vec3)| {
        let hit = scan.closest(p, None, reach * reach).filter(|hit| !hit.on_boundary)?;
        Some(hit.normal.dot(n))
    };
    let cosines: Vec<f64> = points.par_iter().zip(normals).filter_map(cosine).collect();
    let with = cosines.iter().filter(|c| **c > ALIKE).count();
    let against = cosines.iter().filter(|c| **c < -ALIKE).count();
    against >= LEAST && against > TIMES * with
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet, side_by_side};

    fn turned_over(mesh: &TriangleMesh, which: impl Fn(usize) -> bool) -> TriangleMesh {
        let mut mesh = mesh.clone();
        mesh.triangles.iter_mut().enumerate().filter(|t| which(t.0)).for_each(|t| t.1.swap(1, 2));
        mesh
    }

    #[test]
    fn triangles_of_either_winding_agree_with_the_larger_part_of_each_piece() {
        let one = sheet(12, 9, |c, r| Vec3::new(c, r, 0.1 * c * r));
        let both = side_by_side(&one, &one);
        let (same, turned) = agreeing(Cow::Borrowed(&both));
        assert!(matches!(same, Cow::Borrowed(_)) && turned == ScanFacing::default());
        for which in [&(|k: usize| k.is_multiple_of(5)) as &dyn Fn(usize) -> bool, &|k| k < 60, &|k| noise(k) > 0.3] {
            let scan = turned_over(&both, which);
            let wrong = (0..both.triangles.len()).filter(|&k| which(k)).count();
            let (found, turned) = agreeing(Cow::Borrowed(&scan));
            assert!(wrong > 20 && turned == ScanFacing { turned: wrong, ..turned }, "{turned:?} of {wrong}");
            assert_eq!(found.triangles, both.triangles);
            let facing = ScanFacing { flipped: true, ..turned };
            assert_eq!(facing.apply(&scan, None).0.triangles, turned_over(&both, |_| true).triangles);
        }
    }

    #[test]
    fn a_surface_that_is_there_twice_is_there_once() {
        let one = sheet(12, 9, |c, r| Vec3::new(c, r, 0.1 * c * r));
        let alike = one.triangles.iter().copied();
        let turned = one.triangles.iter().map(|&[a, b, c]| [b, a, c]);
        for again in [alike.clone().collect::<Vec<_>>(), turned.clone().collect(), turned.chain(alike).collect()] {
            let scan = TriangleMesh { triangles: [&one.triangles[..], &again].concat(), ..one.clone() };
            let (once, facing) = agreeing(Cow::Borrowed(&scan));
            assert_eq!(once.triangles, one.triangles);
            assert_eq!(facing, ScanFacing { repeated: again.len(), ..ScanFacing::default() });
            assert_eq!(facing.apply(&scan, None).0.triangles, one.triangles);
        }
        let remarks = |repeated| ScanFacing { repeated, ..ScanFacing::default() }.remarks().len();
        assert_eq!([remarks(4), remarks(WORTH_A_WORD)], [0, 1]);
        // Two sides of one triangle share all their edges with each other alone.
        let leaf = TriangleMesh { triangles: vec![[0, 1, 2], [0, 2, 1]], ..one.clone() };
        assert_eq!(agreeing(Cow::Borrowed(&leaf)).1.repeated, 1);
    }

    #[test]
    fn corners_that_are_kept_apart_are_joined() {
        let one = sheet(12, 9, |c, r| Vec3::new(c, r, 0.1 * c * r));
        assert!(matches!(joined(&one), (Cow::Borrowed(_), ScanFacing { joined: 0, collapsed: 0, .. })));
        let corners = |mesh: &TriangleMesh| {
            let at = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize]));
            at.collect::<Vec<[Vec3; 3]>>()
        };
        let positions = one.triangles.as_flattened().iter().map(|&v| one.positions[v as usize]).collect::<Vec<_>>();
        let apart: Vec<[u32; 3]> = (0..one.triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        // A strip goes on from each triangle to the next by one that has no area.
        let sewn = apart.iter().flat_map(|&[a, b, c]| [[a, b, c], [c, c, (c + 1) % positions.len() as u32]]).collect();
        for (triangles, collapsed) in [(apart.clone(), 0), (sewn, apart.len())] {
            let scan = TriangleMesh { positions: positions.clone(), triangles };
            let (found, facing) = joined(&scan);
            assert_eq!(corners(&found), corners(&one));
            let used: std::collections::HashSet<u32> = found.triangles.as_flattened().iter().copied().collect();
            assert_eq!(used.len(), 12 * 9);
            assert_eq!(facing, ScanFacing { joined: positions.len() - 12 * 9, collapsed, ..ScanFacing::default() });
            assert_eq!(facing.apply(&scan, Some(&positions)), (found, None));
        }
        // A surface that is there twice, with vertices of its own for each side, is there once.
        let back = turned_over(&one, |_| true);
        let both = side_by_side(&one, &back);
        let (found, facing) = agreeing(joined(&both).0);
        assert_eq!((&found.triangles, facing.repeated), (&one.triangles, one.triangles.len()));
    }

    #[test]
    fn normals_of_another_mesh_are_known_as_such() {
        let mesh = sheet(12, 9, |c, r| Vec3::new(c, r, 2.0 * (0.5 * c).sin()));
        let own = vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area);
        let each = |change: &dyn Fn(usize, Vec3) -> Vec3| -> Vec<Vec3> {
            own.iter().enumerate().map(|(i, n)| change(i, *n)).collect()
        };
        assert!(belong(&mesh, &own));
        assert!(belong(&mesh, &each(&|_, n| -3.0 * n)));
        assert!(belong(&mesh, &each(&|i, n| if i.is_multiple_of(9) { n.yzx() } else { n })));
        assert!(!belong(&mesh, &each(&|_, n| n.yzx())));
        assert!(!belong(&mesh, &each(&|_, _| Vec3::zeros())));
        assert!(belong(&TriangleMesh { triangles: vec![], ..mesh.clone() }, &own));
    }

    #[test]
    fn a_moebius_strip_is_left_alone() {
        let mut strip = TriangleMesh::default();
        for k in 0..12u32 {
            let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 12.0).sin_cos();
            let (tilt, lift) = (f64::from(k) * std::f64::consts::PI / 12.0).sin_cos();
            for side in [-1.0, 1.0] {
                let r = 5.0 + side * lift;
                strip.positions.push(Vec3::new(r * cos, r * sin, side * tilt));
            }
            let [a, b] = [2 * k, 2 * k + 1];
            let [c, d] = if k == 11 { [1, 0] } else { [2 * k + 2, 2 * k + 3] };
            strip.triangles.extend([[a, b, c], [b, d, c]]);
        }
        let (found, turned) = agreeing(Cow::Borrowed(&strip));
        assert_eq!((found.triangles.clone(), turned), (strip.triangles.clone(), ScanFacing::default()));
    }
}
