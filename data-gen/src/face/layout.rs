//! The template's polygons: quads in loops round mouth and eyes, laid out on the flat face.
//!
//! Half a face is ten blocks of quads, the other half their mirror image. Opposite sides of a block have the same number of
//! quads, neighbouring blocks share a side:
//!
//! ```text
//!   H ----- P --------- Q            H brow to hairline: forehead (G P, J Q), temple (K T)
//!   G ----- J --------- K            ring of quads round the eye inside I J K L
//!   |  gla. |   eye     |  \
//!   N ----- I --------- L --- T      glabella (N I, G J), nose (A B, N I)
//!   | nose  |   cheek   |     |
//!   A ----- B -.        |     |      ring round the mouth outside its lips, inside A B C D
//!     mouth     `------ C --- U      jaw (D C, M U)
//!   D ------------------'
//!   M                                A, N, G, H and D, M lie on the symmetry plane
//! ```
//!
//! Where three blocks and a ring meet (I, J, L, C) a vertex has five edges, elsewhere inside four.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use nonrigid::mesh::Vec3;

use super::rings::Around;
use super::sculpt::site;
use super::site::{EYELIDS, FLAT_MOUTH, Flat, MOUTH, Site, eye_point, flatten};
use super::spline::Spline;

/// The polygons on the flat face.
pub(crate) struct Layout {
    /// Place of each vertex.
    pub flat: Vec<Flat>,
    /// Counter-clockwise, seen from in front.
    pub quads: Vec<[u32; 4]>,
}

/// Quads along the sides of the blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Counts {
    nose_width: usize,
    /// Nose to cheek round the mouth, brow, lower lid.
    eye_width: usize,
    chin: usize,
    eye_height: usize,
    nose_height: usize,
    rim: usize,
    lips: usize,
    lids: usize,
}

impl Counts {
    fn scaled(scale: f64) -> Self {
        let n = |base: f64, least: usize| ((base * scale).round() as usize).max(least);
        Self {
            nose_width: n(10.0, 2),
            eye_width: n(14.0, 4),
            chin: n(9.0, 2),
            eye_height: n(7.0, 2),
            nose_height: n(15.0, 4),
            rim: n(12.0, 3),
            lips: n(11.0, 4),
            lids: n(9.0, 3),
        }
    }

    /// The counts whose vertices come nearest to `vertices`: of one scale, but for a row more or less in the rings.
    fn nearest(vertices: usize) -> Self {
        let guess = (vertices as f64 / 3900.0).sqrt();
        let candidates = (0..400).flat_map(|k| {
            let scaled = Self::scaled(guess * (0.7 + 0.0015 * f64::from(k)));
            [0, 1, -1].into_iter().flat_map(move |lips| {
                [0, 1, -1].map(|lids| Self {
                    lips: scaled.lips.saturating_add_signed(lips).max(4),
                    lids: scaled.lids.saturating_add_signed(lids).max(3),
                    ..scaled
                })
            })
        });
        let off = |c: &Self| c.vertices().abs_diff(vertices);
        candidates.min_by_key(off).unwrap_or_else(|| Self::scaled(guess))
    }

    fn vertices(&self) -> usize {
        let c = self;
        let half = c.nose_width * (c.nose_height + c.eye_height + c.rim)
            + c.lips * (c.nose_width + c.eye_width + c.chin)
            + c.lids * 2 * (c.eye_width + c.eye_height)
            + c.rim * (c.eye_width + c.eye_height + c.nose_height + c.chin)
            + c.eye_width * c.nose_height;
        let boundary = 4 * c.eye_width + 2 * c.chin + 3 * c.eye_height + c.nose_height + 2 * c.nose_width;
        2 * half + boundary
    }
}

type Corner = char;

/// A side of a block: from one corner to another.
type Side = (Corner, Corner);

impl Layout {
    /// The layout whose number of vertices is nearest to `vertices`.
    pub fn new(vertices: usize) -> Self {
        Builder::new(Counts::nearest(vertices)).finish()
    }
}

/// Chart points of the corners of the left half.
const CORNERS: [(Corner, [f64; 2]); 16] = [
    ('A', [0.0, -51.5]),
    ('B', [20.5, -48.0]),
    ('C', [41.0, -78.0]),
    ('D', [0.0, -87.0]),
    ('N', [0.0, 1.0]),
    ('I', [12.5, -9.0]),
    ('G', [0.0, 17.0]),
    ('J', [13.0, 14.0]),
    ('K', [50.0, 15.0]),
    ('L', [52.0, -13.0]),
    ('H', [0.0, 80.0]),
    ('P', [26.0, 79.0]),
    ('Q', [76.0, 55.0]),
    ('T', [98.0, -4.0]),
    ('U', [84.0, -84.0]),
    ('M', [0.0, -140.0]),
];

/// Sides that are not straight in the chart: points on the way.
const BENDS: [(Side, &[[f64; 2]]); 13] = [
    (('A', 'B'), &[[11.0, -50.8]]),
    (('B', 'C'), &[[30.0, -57.0], [37.5, -68.0]]),
    (('D', 'C'), &[[20.0, -88.5]]),
    (('B', 'I'), &[[21.0, -40.0], [16.0, -27.0]]),
    (('J', 'K'), &[[31.0, 20.5]]),
    (('C', 'L'), &[[52.0, -60.0], [54.0, -34.0]]),
    (('L', 'K'), &[[56.5, 1.0]]),
    (('I', 'L'), &[[31.0, -20.5]]),
    (('I', 'J'), &[[9.5, 2.0]]),
    (('P', 'Q'), &[[54.0, 73.0]]),
    (('T', 'Q'), &[[93.0, 28.0]]),
    (('U', 'T'), &[[95.0, -48.0]]),
    (('M', 'U'), &[[30.0, -134.0], [62.0, -112.0]]),
];

/// An opening with rows of quads round it.
struct Opening {
    /// The ring where the skin ends.
    innermost: f64,
    /// Above 1, rows are denser at ring 0.
    grade: f64,
    around: fn(Flat) -> Around,
    place: fn(Around) -> Flat,
}

struct Builder {
    counts: Counts,
    flat: Vec<Flat>,
    quads: Vec<[u32; 4]>,
    corners: BTreeMap<Corner, u32>,
    sides: BTreeMap<Side, Vec<u32>>,
}

impl Builder {
    fn new(counts: Counts) -> Self {
        Self { counts, flat: Vec::new(), quads: Vec::new(), corners: BTreeMap::new(), sides: BTreeMap::new() }
    }

    fn vertex(&mut self, flat: Flat) -> u32 {
        self.flat.push(flat);
        self.flat.len() as u32 - 1
    }

    fn finish(mut self) -> Layout {
        let c = self.counts;
        for (name, at) in CORNERS {
            let v = self.vertex(flatten(at));
            self.corners.insert(name, v);
        }
        // Sides by the number of quads along them; `grade` above 1 makes them denser at their beginning.
        for (sides, count, grade) in [
            ("AB NI GJ HP", c.nose_width, 1.0),
            ("BC IL JK PQ", c.eye_width, 1.0),
            ("DC MU", c.chin, 1.0),
            ("NG IJ LK TQ", c.eye_height, 1.0),
            ("AN BI CL UT", c.nose_height, 1.0),
            ("GH JP KQ LT CU DM", c.rim, 1.25),
        ] {
            for side in sides.split(' ') {
                let mut names = side.chars();
                if let (Some(a), Some(b)) = (names.next(), names.next()) {
                    self.side((a, b), count, grade);
                }
            }
        }
        // Bottom, right, top, left.
        for [bottom, right, top, left] in [
            [('A', 'B'), ('B', 'I'), ('N', 'I'), ('A', 'N')],
            [('N', 'I'), ('I', 'J'), ('G', 'J'), ('N', 'G')],
            [('G', 'J'), ('J', 'P'), ('H', 'P'), ('G', 'H')],
            [('J', 'K'), ('K', 'Q'), ('P', 'Q'), ('J', 'P')],
            [('L', 'T'), ('T', 'Q'), ('K', 'Q'), ('L', 'K')],
            [('B', 'C'), ('C', 'L'), ('I', 'L'), ('B', 'I')],
            [('C', 'U'), ('U', 'T'), ('L', 'T'), ('C', 'L')],
            [('M', 'U'), ('U', 'C'), ('D', 'C'), ('M', 'D')],
        ] {
            self.block(bottom, right, top, left);
        }
        self.mouth_ring();
        self.eye_ring();
        self.mirrored()
    }

    fn walk(&self, (a, b): Side) -> Vec<u32> {
        if let Some(side) = self.sides.get(&(a, b)) {
            return side.clone();
        }
        self.sides[&(b, a)].iter().rev().copied().collect()
    }

    fn walks(&self, sides: &[Side]) -> Vec<u32> {
        let mut walk = self.walk(sides[0]);
        for side in &sides[1..] {
            walk.extend(&self.walk(*side)[1..]);
        }
        walk
    }

    /// Lays vertices along a side, evenly on the surface but for `grade`.
    fn side(&mut self, side: Side, count: usize, grade: f64) {
        let curve = Curve::of(side);
        let mut walk = vec![self.corners[&side.0]];
        for k in 1..count {
            let share = (k as f64 / count as f64).powf(grade);
            let v = self.vertex(flatten(curve.at(share)));
            walk.push(v);
        }
        walk.push(self.corners[&side.1]);
        self.sides.insert(side, walk);
    }

    /// Fills a block between its sides (Coons).
    fn block(&mut self, bottom: Side, right: Side, top: Side, left: Side) {
        let [bottom, right, top, left] = [bottom, right, top, left].map(|s| self.walk(s));
        let (n, m) = (bottom.len() - 1, left.len() - 1);
        let mut grid = vec![vec![0u32; n + 1]; m + 1];
        for j in 0..=m {
            for i in 0..=n {
                grid[j][i] = match (i, j) {
                    (_, 0) => bottom[i],
                    (_, j) if j == m => top[i],
                    (0, _) => left[j],
                    (i, _) if i == n => right[j],
                    _ => {
                        let (s, t) = (i as f64 / n as f64, j as f64 / m as f64);
                        let p = |v: u32, k: usize| self.flat[v as usize][k];
                        let coons = [0, 1].map(|k| {
                            (1.0 - t) * p(bottom[i], k)
                                + t * p(top[i], k)
                                + (1.0 - s) * p(left[j], k)
                                + s * p(right[j], k)
                                - (1.0 - s) * ((1.0 - t) * p(bottom[0], k) + t * p(top[0], k))
                                - s * ((1.0 - t) * p(bottom[n], k) + t * p(top[n], k))
                        });
                        self.vertex(coons)
                    }
                };
            }
        }
        self.tile(&grid);
    }

    fn tile(&mut self, grid: &[Vec<u32>]) {
        for rows in grid.windows(2) {
            for i in 0..rows[0].len() - 1 {
                self.quads.push([rows[0][i], rows[0][i + 1], rows[1][i + 1], rows[1][i]]);
            }
        }
    }

    /// Rows of quads from an opening's edge to the walk round it. Column `i` starts at the angle `inner(i)`.
    fn ring(&mut self, opening: &Opening, walk: &[u32], rows: usize, inner: impl Fn(usize) -> f64) {
        let closed = walk.first() == walk.last();
        let columns = walk.len() - usize::from(closed);
        let turned_in = (0.2 * rows as f64).round().max(1.0) as usize;
        let mut grid = Vec::new();
        for j in 0..rows {
            let t = j as f64 / rows as f64;
            let mut row = Vec::new();
            for (i, &v) in walk[..columns].iter().enumerate() {
                let outer = (opening.around)(self.flat[v as usize]);
                // The short way round.
                let turn = outer.eta - inner(i);
                let turn = turn - (turn / TAU).round() * TAU;
                let eta = inner(i) + turn * t * t * (3.0 - 2.0 * t);
                // Ring 0, where lips meet and lids end, is a row of vertices.
                let r = match j.checked_sub(turned_in) {
                    None => opening.innermost * (1.0 - j as f64 / turned_in as f64),
                    Some(j) => outer.r * (j as f64 / (rows - turned_in) as f64).powf(opening.grade),
                };
                row.push(self.vertex((opening.place)(Around { r, eta })));
            }
            row.extend(closed.then(|| row[0]));
            grid.push(row);
        }
        grid.push(walk.to_vec());
        self.tile(&grid);
    }

    fn mouth_ring(&mut self) {
        let walk = self.walks(&[('A', 'B'), ('B', 'C'), ('C', 'D')]);
        let last = (walk.len() - 1) as f64;
        let mouth = Opening {
            innermost: FLAT_MOUTH.innermost,
            grade: 1.15,
            around: |place| Site::flat(place).mouth,
            place: |at| {
                let [x, y] = FLAT_MOUTH.point(at);
                [MOUTH[0] + x, MOUTH[1] + y]
            },
        };
        self.ring(&mouth, &walk, self.counts.lips, |i| PI * (0.5 - i as f64 / last));
    }

    fn eye_ring(&mut self) {
        let walk = self.walks(&[('I', 'J'), ('J', 'K'), ('K', 'L'), ('L', 'I')]);
        let eye = Opening {
            innermost: EYELIDS.innermost,
            grade: 1.2,
            around: |place| Site::flat(place).left_eye,
            place: |at| flatten(eye_point(at)),
        };
        // The eye's corners lie before the middle of I J and of K L.
        let (first, columns) = (0.5 * self.counts.eye_height as f64, (walk.len() - 1) as f64);
        self.ring(&eye, &walk, self.counts.lids, |i| PI - TAU * (i as f64 - first) / columns);
    }

    /// Adds the right half.
    fn mirrored(mut self) -> Layout {
        let count = self.flat.len();
        let mut twin: Vec<u32> = Vec::with_capacity(count);
        for v in 0..count {
            let [x, y] = self.flat[v];
            twin.push(if x == 0.0 { v as u32 } else { self.vertex([-x, y]) });
        }
        for q in 0..self.quads.len() {
            let [a, b, c, d] = self.quads[q].map(|v| twin[v as usize]);
            self.quads.push([d, c, b, a]);
        }
        Layout { flat: self.flat, quads: self.quads }
    }
}

/// A chart curve through points, by its length on the surface.
struct Curve {
    coordinates: [Spline; 2],
    /// Length on the surface up to evenly spaced parameters.
    lengths: Vec<f64>,
}

impl Curve {
    const SAMPLES: usize = 256;

    /// The curve of a side.
    fn of(side: Side) -> Self {
        let mut points = vec![corner(side.0)];
        points.extend(BENDS.iter().filter(|b| b.0 == side).flat_map(|b| b.1.iter().copied()));
        points.push(corner(side.1));
        Self::new(&points)
    }

    fn new(points: &[[f64; 2]]) -> Self {
        let mut chord = vec![0.0];
        for w in points.windows(2) {
            chord.push(chord[chord.len() - 1] + (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]));
        }
        let all = chord[chord.len() - 1];
        let axis = |k: usize| Spline::new(&chord.iter().zip(points).map(|(c, p)| (c / all, p[k])).collect::<Vec<_>>());
        let mut curve = Self { coordinates: [axis(0), axis(1)], lengths: vec![0.0] };
        let mut before = curve.surface(0.0);
        for k in 1..=Self::SAMPLES {
            let p = curve.surface(k as f64 / Self::SAMPLES as f64);
            curve.lengths.push(curve.lengths[k - 1] + (p - before).norm());
            before = p;
        }
        curve
    }

    fn chart(&self, u: f64) -> [f64; 2] {
        [self.coordinates[0].at(u), self.coordinates[1].at(u)]
    }

    fn surface(&self, u: f64) -> Vec3 {
        site(flatten(self.chart(u))).neutral
    }

    /// The point after `share` of the length.
    fn at(&self, share: f64) -> [f64; 2] {
        let wanted = share * self.lengths[Self::SAMPLES];
        let k = self.lengths.partition_point(|l| *l < wanted).clamp(1, Self::SAMPLES);
        let (low, high) = (self.lengths[k - 1], self.lengths[k]);
        let u = (k as f64 - 1.0 + (wanted - low) / (high - low).max(1e-12)) / Self::SAMPLES as f64;
        self.chart(u)
    }
}

/// The face's outer border on the flat plane, counter-clockwise.
pub(crate) fn outline() -> Vec<Flat> {
    let sides = [(('M', 'U'), false), (('U', 'T'), false), (('T', 'Q'), false), (('P', 'Q'), true), (('H', 'P'), true)];
    let mut left: Vec<Flat> = Vec::new();
    for (side, backwards) in sides {
        let curve = Curve::of(side);
        let shares = (0..OUTLINE_SAMPLES).map(|k| k as f64 / OUTLINE_SAMPLES as f64);
        left.extend(shares.map(|share| flatten(curve.at(if backwards { 1.0 - share } else { share }))));
    }
    left.push(flatten(corner('H')));
    // The ends lie on the symmetry plane.
    let right: Vec<Flat> = left[1..left.len() - 1].iter().rev().map(|p| [-p[0], p[1]]).collect();
    left.extend(right);
    left
}

/// Points of the outline along a side.
const OUTLINE_SAMPLES: usize = 64;

fn corner(name: Corner) -> [f64; 2] {
    CORNERS.iter().find(|c| c.0 == name).map_or([0.0; 2], |c| c.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{BTreeMap, BTreeSet};

    #[test]
    fn has_the_wanted_number_of_vertices_and_each_is_used() {
        for wanted in [1000, 1500, 5000, 6706, 20_000, 100_000] {
            let layout = Layout::new(wanted);
            let off = layout.flat.len().abs_diff(wanted) as f64 / wanted as f64;
            assert!(off < 0.04, "{} for {wanted}", layout.flat.len());
            let used: BTreeSet<u32> = layout.quads.iter().flatten().copied().collect();
            assert_eq!(used.len(), layout.flat.len());
        }
    }

    #[test]
    fn is_one_sheet_with_three_holes_whose_quads_are_convex_and_do_not_overlap() {
        for wanted in [1000, 5000, 20_000] {
            let Layout { flat, quads } = Layout::new(wanted);
            let mut directed = BTreeSet::new();
            for q in &quads {
                for k in 0..4 {
                    assert!(directed.insert((q[k], q[(k + 1) % 4])), "an edge is used twice in one direction");
                    let [a, b, c] = [0, 1, 2].map(|i| flat[q[(k + i) % 4] as usize]);
                    let turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]);
                    assert!(turn > 0.0, "a quad turns inwards at {b:?}");
                }
            }
            assert!(
                flat.iter().filter(|p| p[0] == 0.0).count() > 8
                    && flat.iter().all(|p| p[0] == 0.0 || p[0].abs() > 0.05)
            );
            // Locally injective and of the outline's area less the openings': injective.
            let border: BTreeMap<u32, u32> =
                directed.iter().filter(|(a, b)| !directed.contains(&(*b, *a))).copied().collect();
            let mut left: BTreeSet<u32> = border.keys().copied().collect();
            let mut loops = 0;
            while let Some(start) = left.pop_first() {
                let mut v = border[&start];
                while v != start {
                    assert!(left.remove(&v), "the border branches");
                    v = border[&v];
                }
                loops += 1;
            }
            assert_eq!(loops, 4, "outline, mouth, two eyes");
            let edges = (directed.len() + border.len()) / 2;
            assert_eq!(flat.len() + quads.len(), edges - 2, "Euler characteristic of a disc with three holes");
            let shoelace = |a: Flat, b: Flat| 0.5 * (a[0] * b[1] - a[1] * b[0]);
            let covered: f64 = quads
                .iter()
                .flat_map(|q| (0..4).map(|k| shoelace(flat[q[k] as usize], flat[q[(k + 1) % 4] as usize])))
                .sum();
            let enclosed: f64 = border.iter().map(|(a, b)| shoelace(flat[*a as usize], flat[*b as usize])).sum();
            assert!((covered / enclosed - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn four_places_on_each_side_have_five_edges_and_all_others_inside_four() {
        let Layout { flat, quads } = Layout::new(3000);
        let mut valence = vec![BTreeSet::new(); flat.len()];
        for q in &quads {
            for k in 0..4 {
                valence[q[k] as usize].insert(q[(k + 1) % 4]);
                valence[q[(k + 1) % 4] as usize].insert(q[k]);
            }
        }
        let five: Vec<Flat> = (0..flat.len()).filter(|v| valence[*v].len() == 5).map(|v| flat[v]).collect();
        assert_eq!(five.len(), 8, "{five:?}");
        assert!(valence.iter().all(|v| (3..=5).contains(&v.len())));
    }

    #[test]
    fn the_outline_is_the_borders() {
        let outline = outline();
        let Layout { flat, .. } = Layout::new(5000);
        for (k, name) in [(0, 'M'), (64, 'U'), (128, 'T'), (192, 'Q'), (256, 'P'), (320, 'H')] {
            let at = flatten(corner(name));
            assert!((outline[k][0] - at[0]).hypot(outline[k][1] - at[1]) < 1e-9, "{name}");
            assert!(flat.iter().any(|p| (p[0] - at[0]).hypot(p[1] - at[1]) < 1e-9), "{name}");
        }
        let area: f64 = (0..outline.len())
            .map(|k| (outline[k], outline[(k + 1) % outline.len()]))
            .map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0]))
            .sum();
        assert!(area > 30_000.0, "counter-clockwise: {area}");
    }
}
