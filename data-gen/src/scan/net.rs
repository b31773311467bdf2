//! Irregular meshes of a plane domain: places scattered evenly over the surface, and their Delaunay triangles.
//!
//! Places are thrown at random, dense as the surface's area, and dropped where another one is nearer than a share of the
//! mean spacing on the surface (dart throwing, Cook 1986). Borders get places first, so that their triangles follow them.

use delaunator::{EMPTY, Point, Triangulation, triangulate};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::domain::Domain;
use crate::Flat;

/// Least distance of two places, in mean spacings; near 0.83 no further place would find room.
const LEAST: f64 = 0.7;
/// Distance of places along borders, in mean spacings.
const BORDER: f64 = 0.85;

/// A triangulated scatter of places.
pub(super) struct Net {
    pub places: Vec<Flat>,
    delaunay: Triangulation,
    /// Of each Delaunay triangle, whether it belongs to the domain.
    inside: Vec<bool>,
}

impl Net {
    /// About `wanted` places, at random.
    pub fn new(domain: &Domain, wanted: usize, rng: &mut ChaCha8Rng) -> Self {
        let (places, borders) = scatter(domain, wanted, rng);
        let points: Vec<Point> = places.iter().map(|p| Point { x: p[0], y: p[1] }).collect();
        let delaunay = triangulate(&points);
        let border = Borders::new(&borders);
        let inside = delaunay.triangles.par_chunks_exact(3).map(|t| belongs(domain, &places, &border, t)).collect();
        Self { places, delaunay, inside }
    }

    /// Triangles of the domain, counter-clockwise.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        let domain = (0..self.inside.len()).filter(|t| self.inside[*t]);
        domain.map(|t| self.triangle(t)).collect()
    }

    fn triangle(&self, t: usize) -> [u32; 3] {
        let [a, b, c] = [0, 1, 2].map(|k| self.delaunay.triangles[3 * t + k]);
        let [a, b, c] = if twice_area(&self.places, [a, b, c]) < 0.0 { [a, c, b] } else { [a, b, c] };
        [a as u32, b as u32, c as u32]
    }

    /// Of each of `places`, whether the triangle that holds it and the domain's triangles beside that are all there, given
    /// which points are `kept`.
    pub fn shown(&self, places: &[Flat], kept: &[bool]) -> Vec<bool> {
        let count = self.inside.len();
        let whole = |t: usize| (0..3).all(|k| kept[self.delaunay.triangles[3 * t + k]]);
        let starts = Starts::new(self);
        let one = |p: &Flat| {
            if count == 0 {
                return false;
            }
            let t = self.holding(*p, starts.near(*p));
            let beside = (0..3).map(|k| self.delaunay.halfedges[3 * t + k]).filter(|e| *e != EMPTY).map(|e| e / 3);
            // A place on a curved border may lie a hair beyond it: the triangles inside then speak for it.
            let mut domain = std::iter::once(t).chain(beside).filter(|t| self.inside[*t]).peekable();
            domain.peek().is_some() && domain.all(whole)
        };
        places.par_iter().map(one).collect()
    }

    /// The Delaunay triangle that holds a place, or the last one on the way there: a walk from `start`.
    fn holding(&self, p: Flat, start: usize) -> usize {
        let mut t = start;
        for _ in 0..self.inside.len() {
            let [a, b, c] = [0, 1, 2].map(|k| self.delaunay.triangles[3 * t + k]);
            let turn = twice_area(&self.places, [a, b, c]).signum();
            let beyond = [(a, b), (b, c), (c, a)].into_iter().position(|(a, b)| {
                let (a, b) = (self.places[a], self.places[b]);
                turn * cross(a, b, p) < 0.0
            });
            let Some(edge) = beyond else { return t };
            let twin = self.delaunay.halfedges[3 * t + edge];
            if twin == EMPTY {
                return t;
            }
            t = twin / 3;
        }
        t
    }
}

/// Triangles to start walks from, on a lattice.
struct Starts {
    low: Flat,
    step: f64,
    size: [usize; 2],
    triangle: Vec<u32>,
}

impl Starts {
    fn new(net: &Net) -> Self {
        let bound = |k: usize, pick: fn(f64, f64) -> f64| net.places.iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0);
        let low = [0, 1].map(|k| bound(k, f64::min));
        let extent = [0, 1].map(|k| bound(k, f64::max) - low[k]);
        let step = (extent[0] * extent[1] / (net.inside.len() as f64 / 8.0).max(1.0)).sqrt().max(1e-9);
        let size = extent.map(|e| (e / step) as usize + 1);
        let mut starts = Self { low, step, size, triangle: vec![0; size[0] * size[1]] };
        for t in 0..net.inside.len() {
            let cell = starts.cell(net.places[net.delaunay.triangles[3 * t]]);
            starts.triangle[cell] = t as u32;
        }
        starts
    }

    fn cell(&self, p: Flat) -> usize {
        let [x, y] = [0, 1].map(|k| (((p[k] - self.low[k]) / self.step).max(0.0) as usize).min(self.size[k] - 1));
        y * self.size[0] + x
    }

    fn near(&self, p: Flat) -> usize {
        self.triangle[self.cell(p)] as usize
    }
}

/// The places on borders: the first ones, border after border.
struct Borders {
    /// Beginning and number of each.
    ranges: Vec<(usize, usize)>,
    all: usize,
}

impl Borders {
    fn new(counts: &[usize]) -> Self {
        let ranges = counts.iter().scan(0, |start, &count| {
            let range = (*start, count);
            *start += count;
            Some(range)
        });
        Self { ranges: ranges.collect(), all: counts.iter().sum() }
    }

    /// Which border and where along it.
    fn of(&self, v: usize) -> Option<(usize, usize)> {
        let border = self.ranges.iter().position(|(start, count)| (*start..start + count).contains(&v))?;
        Some((border, v - self.ranges[border].0))
    }

    /// Whether two of its places follow each other.
    fn neighbours(&self, border: usize, i: usize, j: usize) -> bool {
        let apart = i.abs_diff(j);
        apart == 1 || apart + 1 == self.ranges[border].1
    }
}

fn cross(a: Flat, b: Flat, p: Flat) -> f64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

fn twice_area(places: &[Flat], [a, b, c]: [usize; 3]) -> f64 {
    cross(places[a], places[b], places[c])
}

/// Whether a Delaunay triangle lies in the domain.
fn belongs(domain: &Domain, places: &[Flat], borders: &Borders, t: &[usize]) -> bool {
    let middle =
        |corners: &[usize]| [0, 1].map(|k| corners.iter().map(|v| places[*v][k]).sum::<f64>() / corners.len() as f64);
    if !domain.contains(middle(t)) {
        return false;
    }
    if t.iter().all(|v| *v >= borders.all) {
        return true;
    }
    let on = [t[0], t[1], t[2]].map(|v| borders.of(v));
    let mut longest: f64 = 0.0;
    for k in 0..3 {
        let (a, b) = (t[k], t[(k + 1) % 3]);
        longest = longest.max((places[a][0] - places[b][0]).powi(2) + (places[a][1] - places[b][1]).powi(2));
        if let (Some((first, i)), Some((second, j))) = (on[k], on[(k + 1) % 3]) {
            let along = first == second && borders.neighbours(first, i, j);
            if !along && !domain.contains(middle(&[a, b])) {
                return false;
            }
        }
    }
    // What is left between a straight border and its chord.
    let sliver = twice_area(places, [t[0], t[1], t[2]]).abs() < 0.03 * longest;
    !(sliver && on.iter().all(Option::is_some))
}

/// Places, and how many of the first ones lie on each border.
fn scatter(domain: &Domain, wanted: usize, rng: &mut ChaCha8Rng) -> (Vec<Flat>, Vec<usize>) {
    let spacing = (domain.area() / wanted.max(1) as f64).sqrt();
    let mut places = Vec::with_capacity(wanted);
    let mut counts = Vec::new();
    for polygon in &domain.loops {
        let before = places.len();
        along_border(domain, polygon, spacing, &mut places, rng);
        counts.push(places.len() - before);
    }
    let areas = domain.areas();
    let all = areas.iter().sum::<f64>().max(1e-300);
    let mut grid = Buckets::new(domain, spacing, &places);
    let (mut thrown, mut hits) = (0.0, 1.0);
    // Rounds over the lattice: neighbours in space are neighbours in memory.
    for _ in 0..200 {
        let missing = wanted.saturating_sub(places.len());
        if missing == 0 || thrown > 80.0 * wanted as f64 {
            break;
        }
        // A round hits less than the one before: the last one ends with the face rather than in the middle of it.
        let darts = (missing as f64 / hits).min(wanted as f64);
        thrown += darts;
        let before = places.len();
        for (cell, area) in areas.iter().enumerate().filter(|a| *a.1 > 0.0) {
            let expected = area / all * darts;
            let count = expected.floor() as usize + usize::from(rng.random::<f64>() < expected.fract());
            for _ in 0..count {
                let p = domain.place(cell, [rng.random(), rng.random()]);
                let metric = domain.metric(cell);
                if grid.free(p, metric, LEAST * spacing, &places) && domain.contains(p) {
                    grid.insert(p);
                    places.push(p);
                }
            }
        }
        hits = (places.len() - before).max(1) as f64 / darts;
        places.truncate(wanted.max(counts.iter().sum()));
    }
    (places, counts)
}

/// Squared length on the surface of a step in the plane.
fn squared_length([e, f, g]: [f64; 3], [x, y]: [f64; 2]) -> f64 {
    e * x * x + 2.0 * f * x * y + g * y * y
}

/// Adds places along a closed border, about evenly spaced on the surface and no fewer than it takes to see its shape.
fn along_border(domain: &Domain, polygon: &[Flat], spacing: f64, places: &mut Vec<Flat>, rng: &mut ChaCha8Rng) {
    const FEWEST: f64 = 18.0;
    let step = |k: usize| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        [b[0] - a[0], b[1] - a[1]]
    };
    let shape = BORDER * spacing * FEWEST / polygon.len() as f64;
    let mut lengths = vec![0.0];
    for (k, p) in polygon.iter().enumerate() {
        let length = squared_length(domain.metric(domain.cell(*p)), step(k)).max(0.0).sqrt().max(shape);
        lengths.push(lengths[k] + length);
    }
    let all = lengths[polygon.len()];
    let count = (all / (BORDER * spacing)).round() as usize;
    let offset: f64 = rng.random();
    for i in 0..count {
        let jitter = rng.random_range(-0.2..0.2);
        let at = (i as f64 + offset + jitter).rem_euclid(count as f64) * all / count as f64;
        let k = (lengths.partition_point(|l| *l <= at).max(1) - 1).min(polygon.len() - 1);
        let t = (at - lengths[k]) / (lengths[k + 1] - lengths[k]);
        places.push([0, 1].map(|axis| polygon[k][axis] + t * step(k)[axis]));
    }
}

/// The places so far, by square of the plane.
struct Buckets {
    low: Flat,
    side: f64,
    size: [usize; 2],
    /// Last place of each bucket, and the one before each place in its bucket.
    last: Vec<u32>,
    before: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl Buckets {
    fn new(domain: &Domain, spacing: f64, places: &[Flat]) -> Self {
        let (low, extent) = domain.bounds();
        let side = LEAST * spacing;
        let size = extent.map(|e| (e / side) as usize + 1);
        let mut buckets = Self { low, side, size, last: vec![NONE; size[0] * size[1]], before: Vec::new() };
        places.iter().for_each(|p| buckets.insert(*p));
        buckets
    }

    fn index(&self, axis: usize, x: f64) -> usize {
        (((x - self.low[axis]) / self.side).max(0.0) as usize).min(self.size[axis] - 1)
    }

    fn insert(&mut self, p: Flat) {
        let bucket = self.index(1, p[1]) * self.size[0] + self.index(0, p[0]);
        let place = self.before.len() as u32;
        self.before.push(std::mem::replace(&mut self.last[bucket], place));
    }

    /// Whether no place is nearer on the surface than `least`.
    fn free(&self, p: Flat, metric: [f64; 3], least: f64, places: &[Flat]) -> bool {
        let [e, f, g] = metric;
        let shortest = 0.5 * (e + g) - (0.25 * (e - g) * (e - g) + f * f).sqrt();
        let reach = least / shortest.sqrt();
        for y in self.index(1, p[1] - reach)..=self.index(1, p[1] + reach) {
            for x in self.index(0, p[0] - reach)..=self.index(0, p[0] + reach) {
                let mut other = self.last[y * self.size[0] + x];
                while other != NONE {
                    let q = places[other as usize];
                    if squared_length(metric, [q[0] - p[0], q[1] - p[1]]) < least * least {
                        return false;
                    }
                    other = self.before[other as usize];
                }
            }
        }
        true
    }
}
