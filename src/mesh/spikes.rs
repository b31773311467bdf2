//! Vertices that have left their neighbours behind: damage of a file, or of a solution, that no median or percentile shows.

use super::Vec3;

/// An edge that has grown beyond this multiple of its length is drawn out.
const DRAWN_OUT: f64 = 3.0;

/// How many vertices stand out from their neighbours at `moved` and did not at `rest`: of those, half the edges or more are drawn out to
/// over three times their length, and by more than `least`, in the unit of the positions. `sides` are the pairs of neighbours, those of
/// inner edges once for each face.
///
/// # Panics
/// When a side names a vertex that does not exist.
#[must_use]
pub fn spikes(sides: impl Iterator<Item = [u32; 2]>, rest: &[Vec3], moved: &[Vec3], least: f64) -> usize {
    let mut edges = vec![[0_u32; 2]; rest.len()]; // all, and those that are drawn out
    for [a, b] in sides.map(|side| side.map(|v| v as usize)) {
        let [before, after] = [rest, moved].map(|positions| (positions[a] - positions[b]).norm());
        let drawn_out = after > DRAWN_OUT * before && after > before + least;
        for v in [a, b] {
            edges[v][0] += 1;
            edges[v][1] += u32::from(drawn_out);
        }
    }
    edges.iter().filter(|[all, drawn_out]| *all > 0 && 2 * drawn_out >= *all).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::sheet;

    #[test]
    fn spikes_are_counted_and_a_stretched_sheet_has_none() {
        let mesh = sheet(9, 9, |x, y| Vec3::new(x, y, 0.0));
        let sides = || mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let count = |moved: &[Vec3]| spikes(sides(), &mesh.positions, moved, 1.0);
        let stretched: Vec<Vec3> = mesh.positions.iter().map(|p| p * 2.9).collect();
        assert_eq!((count(&mesh.positions), count(&stretched)), (0, 0));
        // one in the middle, whose neighbours keep most of their edges
        let mut moved = mesh.positions.clone();
        moved[40].z += 30.0;
        assert_eq!(count(&moved), 1);
        // little is none, however short the edges
        let small = |p: &[Vec3]| p.iter().map(|p| p * 0.01).collect::<Vec<_>>();
        assert_eq!(spikes(sides(), &small(&mesh.positions), &small(&moved), 1.0), 0);
    }
}
