//! A plane domain with holes, and how a map stretches it: what a scanner needs to know to sample the surface evenly.

use nonrigid::mesh::Vec3;
use rayon::prelude::*;

use crate::Flat;

/// Smallest and largest stretch that sampling follows.
const STRETCH: [f64; 2] = [0.2, 6.0];

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Outside,
    Border,
    Inside,
}

/// A domain on a lattice of square cells.
pub(super) struct Domain<'a> {
    low: Flat,
    step: f64,
    /// Nodes along each axis.
    size: [usize; 2],
    state: Vec<State>,
    /// First fundamental form (E, F, G) of each cell.
    metric: Vec<[f64; 3]>,
    /// Closed borders, as fine polygons; the first is the outer one.
    pub loops: Vec<Vec<Flat>>,
    contains: &'a (dyn Fn(Flat) -> bool + Sync),
    /// Position of each node, and whether it belongs to the domain.
    nodes: Vec<Vec3>,
    inside: Vec<bool>,
}

impl<'a> Domain<'a> {
    /// Of what lies within `loops`; `step` is the lattice's, `positions` the map.
    pub fn new(
        loops: Vec<Vec<Flat>>,
        step: f64,
        contains: &'a (dyn Fn(Flat) -> bool + Sync),
        positions: &dyn Fn(&[Flat]) -> Vec<Vec3>,
    ) -> Self {
        let bound = |k: usize, pick: fn(f64, f64) -> f64| loops[0].iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0);
        let low = [0, 1].map(|k| bound(k, f64::min) - 2.0 * step);
        let size = [0, 1].map(|k| ((bound(k, f64::max) - low[k]) / step).ceil() as usize + 3);
        let node = |i: usize| [low[0] + step * (i % size[0]) as f64, low[1] + step * (i / size[0]) as f64];
        let places: Vec<Flat> = (0..size[0] * size[1]).map(node).collect();
        let inside: Vec<bool> = places.par_iter().map(|p| contains(*p)).collect();
        let nodes = positions(&places);
        let mut domain =
            Self { low, step, size, state: Vec::new(), metric: Vec::new(), loops, contains, nodes, inside };
        domain.state = domain.states();
        domain.metric = domain.metrics();
        domain
    }

    fn cells(&self) -> [usize; 2] {
        self.size.map(|n| n - 1)
    }

    /// Cell of a place; what lies outside the lattice counts to its edge.
    pub fn cell(&self, p: Flat) -> usize {
        let cells = self.cells();
        let [x, y] = [0, 1].map(|k| (((p[k] - self.low[k]) / self.step).max(0.0) as usize).min(cells[k] - 1));
        y * cells[0] + x
    }

    fn corners(&self, cell: usize) -> [usize; 4] {
        let wide = self.cells()[0];
        let first = cell / wide * self.size[0] + cell % wide;
        [first, first + 1, first + self.size[0], first + self.size[0] + 1]
    }

    fn states(&self) -> Vec<State> {
        let [wide, high] = self.cells();
        let mut state: Vec<State> = (0..wide * high)
            .map(|c| {
                let within = self.corners(c).iter().filter(|n| self.inside[**n]).count();
                if within == 4 { State::Inside } else { State::Outside }
            })
            .collect();
        for polygon in &self.loops {
            for (k, a) in polygon.iter().enumerate() {
                let b = polygon[(k + 1) % polygon.len()];
                let pieces = ((b[0] - a[0]).hypot(b[1] - a[1]) / (0.5 * self.step)).ceil().max(1.0) as usize;
                for piece in 0..pieces {
                    let t = piece as f64 / pieces as f64;
                    let c = self.cell([0, 1].map(|k| a[k] + t * (b[k] - a[k])));
                    for (dx, dy) in (0..9).map(|k| (k % 3, k / 3)) {
                        let (x, y) = ((c % wide + dx).saturating_sub(1), (c / wide + dy).saturating_sub(1));
                        state[y.min(high - 1) * wide + x.min(wide - 1)] = State::Border;
                    }
                }
            }
        }
        state
    }

    fn metrics(&self) -> Vec<[f64; 3]> {
        let one = |c: usize| {
            let corners = self.corners(c);
            corners.iter().all(|n| self.inside[*n]).then(|| {
                let [a, b, c, d] = corners.map(|n| self.nodes[n]);
                let (x, y) = ((b - a + d - c) / (2.0 * self.step), (c - a + d - b) / (2.0 * self.step));
                clamped([x.dot(&x), x.dot(&y), y.dot(&y)])
            })
        };
        let [wide, high] = self.cells();
        let known: Vec<Option<[f64; 3]>> = (0..wide * high).map(one).collect();
        let average =
            |found: &[[f64; 3]]| [0, 1, 2].map(|k| found.iter().map(|m| m[k]).sum::<f64>() / found.len() as f64);
        let filled = spread(known, wide, &average);
        filled.into_iter().map(|m| m.unwrap_or([1.0, 0.0, 1.0])).collect()
    }

    /// Whether a place belongs to the domain.
    pub fn contains(&self, p: Flat) -> bool {
        match self.state[self.cell(p)] {
            State::Inside => true,
            State::Outside => false,
            State::Border => (self.contains)(p),
        }
    }

    /// First fundamental form of a cell.
    pub fn metric(&self, cell: usize) -> [f64; 3] {
        self.metric[cell]
    }

    /// Area of the surface over each cell, square millimetres; border cells count whole.
    pub fn areas(&self) -> Vec<f64> {
        let area = |(state, [e, f, g]): (&State, &[f64; 3])| {
            if *state == State::Outside { 0.0 } else { (e * g - f * f).max(0.0).sqrt() * self.step.powi(2) }
        };
        self.state.iter().zip(&self.metric).map(area).collect()
    }

    /// Area of the surface, square millimetres; border cells count half.
    pub fn area(&self) -> f64 {
        let half = |state: &State| if *state == State::Border { 0.5 } else { 1.0 };
        self.areas().iter().zip(&self.state).map(|(area, state)| area * half(state)).sum()
    }

    /// A place in a cell, by two numbers from 0 to 1.
    pub fn place(&self, cell: usize, [s, t]: [f64; 2]) -> Flat {
        let wide = self.cells()[0];
        [self.low[0] + self.step * ((cell % wide) as f64 + s), self.low[1] + self.step * ((cell / wide) as f64 + t)]
    }

    /// Lowest corner and extent.
    pub fn bounds(&self) -> (Flat, [f64; 2]) {
        (self.low, self.cells().map(|n| n as f64 * self.step))
    }

    /// A smooth field of the surface's unit normals times `weight`, a function of the place.
    pub fn normals(&self, weight: impl Fn(Flat) -> f64 + Sync) -> Field {
        let [wide, high] = self.size;
        let normal = |i: usize| {
            let (x, y) = (i % wide, i / wide);
            if x == 0 || y == 0 || x + 1 == wide || y + 1 == high {
                return None;
            }
            let around = [i - 1, i + 1, i - wide, i + wide];
            around.iter().all(|n| self.inside[*n]).then(|| {
                let [left, right, below, above] = around.map(|n| self.nodes[n]);
                (right - left).cross(&(above - below)).try_normalize(0.0)
            })?
        };
        let known: Vec<Option<Vec3>> = (0..wide * high).map(normal).collect();
        let average = |found: &[Vec3]| found.iter().sum::<Vec3>() / found.len() as f64;
        let filled = spread(known, wide, &average);
        let node =
            |i: usize| [self.low[0] + self.step * (i % wide) as f64, self.low[1] + self.step * (i / wide) as f64];
        let values: Vec<Vec3> = filled
            .into_par_iter()
            .enumerate()
            .map(|(i, n)| n.map_or_else(Vec3::zeros, |n| n * weight(node(i))))
            .collect();
        Field { low: self.low, step: self.step, size: self.size, values }
    }
}

/// Vectors on a lattice, interpolated by quadratic B-splines: continuous with their first derivatives.
pub(super) struct Field {
    low: Flat,
    step: f64,
    size: [usize; 2],
    values: Vec<Vec3>,
}

impl Field {
    pub fn at(&self, p: Flat) -> Vec3 {
        let axis = |k: usize| {
            let x = (p[k] - self.low[k]) / self.step;
            let node = x.round().clamp(1.0, self.size[k] as f64 - 2.0);
            let t = (x - node).clamp(-0.5, 0.5);
            (node as usize - 1, [0.5 * (0.5 - t).powi(2), 0.75 - t * t, 0.5 * (0.5 + t).powi(2)])
        };
        let ((x, across), (y, up)) = (axis(0), axis(1));
        let mut sum = Vec3::zeros();
        for j in 0..3 {
            for i in 0..3 {
                sum += self.values[(y + j) * self.size[0] + x + i] * (across[i] * up[j]);
            }
        }
        sum
    }
}

/// Fills what is unknown within four cells of what is known by averages of neighbours.
fn spread<T: Copy>(mut values: Vec<Option<T>>, wide: usize, average: &dyn Fn(&[T]) -> T) -> Vec<Option<T>> {
    for _ in 0..4 {
        let before = values.clone();
        for (i, value) in values.iter_mut().enumerate().filter(|v| v.1.is_none()) {
            let (x, y) = (i % wide, i / wide);
            let mut found = Vec::new();
            for (dx, dy) in (0..9).map(|k| (k % 3, k / 3)) {
                if let (Some(x), Some(y)) = ((x + dx).checked_sub(1), (y + dy).checked_sub(1))
                    && x < wide
                    && let Some(Some(known)) = before.get(y * wide + x)
                {
                    found.push(*known);
                }
            }
            if !found.is_empty() {
                *value = Some(average(&found));
            }
        }
    }
    values
}

/// The form with its principal stretches clamped to [`STRETCH`].
fn clamped([e, f, g]: [f64; 3]) -> [f64; 3] {
    let (middle, half) = (0.5 * (e + g), 0.5 * (e - g));
    let radius = half.hypot(f);
    let [low, high] = [middle - radius, middle + radius].map(|l| l.clamp(STRETCH[0].powi(2), STRETCH[1].powi(2)));
    let scale = if radius > 1e-12 { 0.5 * (high - low) / radius } else { 0.0 };
    let middle = 0.5 * (low + high);
    [middle + half * scale, f * scale, middle - half * scale]
}

/// The border of a hole that is star-shaped about `centre`, clockwise or not as it comes, on the side of the domain. Empty
/// where `centre` is in no hole.
pub(super) fn hole(contains: &(dyn Fn(Flat) -> bool + Sync), centre: Flat) -> Vec<Flat> {
    const POINTS: usize = 512;
    let at = |direction: [f64; 2], t: f64| [centre[0] + direction[0] * t, centre[1] + direction[1] * t];
    // The first place of the domain in a direction, its distance guessed.
    let border = |direction: [f64; 2], guess: f64| -> Option<f64> {
        let mut high = guess;
        while !contains(at(direction, high)) {
            high *= 1.25;
            if high > 200.0 {
                return None;
            }
        }
        let mut low = high / 1.25;
        if contains(at(direction, low)) {
            low = 0.0;
        }
        for _ in 0..34 {
            let middle = 0.5 * (low + high);
            if contains(at(direction, middle)) { high = middle } else { low = middle }
        }
        Some(high)
    };
    if contains(centre) {
        return Vec::new();
    }
    let half_axes = [border([1.0, 0.0], 0.1), border([0.0, 1.0], 0.1)];
    let [Some(a), Some(b)] = half_axes else { return Vec::new() };
    let point = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
        let direction = [a * cos, b * sin];
        Some(at(direction, border(direction, 0.9)?))
    };
    (0..POINTS).into_par_iter().map(point).collect::<Option<Vec<Flat>>>().unwrap_or_default()
}
