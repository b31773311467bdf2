//! Whether landmarks make sense on a mesh: how far they are off it, which coincide, whether left and right are swapped.
//!
//! Pairs are known by name (`left` against `right`, `l` against `r` between underscores, a number behind it or not) or, when all 68 numbers of Multi-PIE are there, by
//! number. A pair is swapped when it points against most of the others. All are swapped, or the mesh is mirrored, when
//! left, up (from mouth and chin to eyes and brows) and front (the surface's normals) do not make a right-handed frame.

use std::fmt;

use serde::Serialize;

use super::{LandmarkError, LandmarkSet};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::{PolygonMesh, Vec3, bounding_box_diagonal, surface_points};

/// Landmarks closer than this share of the mesh's size are one point.
const SAME: f64 = 1e-6;
const UPPER: [&str; 6] = ["eye", "brow", "canthion", "nasion", "glabella", "trichion"];
const LOWER: [&str; 8] = ["mouth", "lip", "labiale", "cheilion", "stomion", "chin", "pogonion", "menton"];
/// Right and left of the 68 numbers.
const PAIRS: [[u32; 2]; 29] = [
    [0, 16],
    [1, 15],
    [2, 14],
    [3, 13],
    [4, 12],
    [5, 11],
    [6, 10],
    [7, 9],
    [17, 26],
    [18, 25],
    [19, 24],
    [20, 23],
    [21, 22],
    [31, 35],
    [32, 34],
    [36, 45],
    [37, 44],
    [38, 43],
    [39, 42],
    [40, 47],
    [41, 46],
    [48, 54],
    [49, 53],
    [50, 52],
    [59, 55],
    [58, 56],
    [60, 64],
    [61, 63],
    [67, 65],
];
const EYES: std::ops::Range<u32> = 36..48;
const MOUTH: std::ops::Range<u32> = 48..68;

/// A landmark and the surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OnSurface {
    /// Its name.
    pub name: String,
    /// Where it is, millimetres.
    pub position_mm: [f64; 3],
    /// Distance to the closest point of the surface, millimetres.
    pub distance_mm: f64,
}

/// What is to be said about landmarks on a mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LandmarkCheck {
    /// Each landmark, in the order of the file.
    pub landmarks: Vec<OnSurface>,
    /// Names of those farther from the surface than the tolerance.
    pub off: Vec<String>,
    /// Names of landmarks that are at the same point, each with one other there.
    pub duplicates: Vec<[String; 2]>,
    /// How many pairs of left and right are known.
    pub pairs: usize,
    /// Pairs, right first, that point against most of the others.
    pub swapped: Vec<[String; 2]>,
    /// Whether left and right of all of them are swapped, or the mesh is mirrored or inside out; unknown without pairs, or
    /// without landmarks of the upper and the lower face.
    pub mirrored: Option<bool>,
    /// Names that the file says are not placed.
    pub missing: Vec<String>,
}

impl LandmarkCheck {
    /// Checks landmarks that are at `positions`; farther from the surface than `tolerance` millimetres they are off it.
    ///
    /// # Errors
    /// When the mesh has no triangles, or its faces index past its vertices.
    ///
    /// # Panics
    /// When there is not one position for each landmark.
    pub fn new(
        set: &LandmarkSet,
        positions: &[Vec3],
        mesh: &PolygonMesh,
        tolerance: f64,
    ) -> Result<Self, LandmarkError> {
        assert_eq!(positions.len(), set.landmarks.len(), "a position for each landmark");
        let triangles = mesh.triangulate();
        let surface = ClosestPoint::new(&triangles)?;
        let mut front = Vec3::zeros();
        let mut landmarks = Vec::with_capacity(positions.len());
        for (landmark, p) in set.landmarks.iter().zip(positions) {
            let closest = surface.query(p).ok_or(LandmarkError::NoSurface)?;
            let [a, b, c] = triangles.triangles[closest.triangle as usize].map(|v| triangles.positions[v as usize]);
            front += (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
            let distance_mm = closest.squared_distance.sqrt();
            landmarks.push(OnSurface { name: landmark.name.clone(), position_mm: (*p).into(), distance_mm });
        }
        let off = landmarks.iter().filter(|l| l.distance_mm > tolerance).map(|l| l.name.clone()).collect();
        let names: Vec<&str> = set.landmarks.iter().map(|l| l.name.as_str()).collect();
        let both = |[a, b]: [usize; 2]| [names[a].to_owned(), names[b].to_owned()];
        let close = SAME * bounding_box_diagonal(&surface_points(&mesh.positions, mesh.corners.iter().copied()));
        let duplicates = duplicates(positions, close).into_iter().map(both).collect();

        let Sides { pairs, left, swapped } = Sides::of(&names, positions);
        let up = upwards(&names, positions).filter(|_| !pairs.is_empty());
        Ok(Self {
            landmarks,
            off,
            duplicates,
            pairs: pairs.len(),
            swapped: swapped.into_iter().map(both).collect(),
            mirrored: up.map(|up| left.cross(&up).dot(&front) < 0.0),
            missing: set.missing.clone(),
        })
    }

    /// Number of things that are wrong.
    #[must_use]
    pub fn problems(&self) -> usize {
        self.off.len() + self.duplicates.len() + self.swapped.len() + usize::from(self.mirrored == Some(true))
    }
}

/// What is to be said of landmarks, by name and position, of which a few have left and right swapped.
#[must_use]
pub fn swapped_sides(landmarks: &[(&str, Vec3)]) -> Option<String> {
    let (names, positions): (Vec<&str>, Vec<Vec3>) = landmarks.iter().copied().unzip();
    let Sides { pairs, swapped, .. } = Sides::of(&names, &positions);
    let couples: Vec<String> = swapped.iter().map(|&[a, b]| format!("{} and {}", names[a], names[b])).collect();
    let count = pairs.len();
    (!couples.is_empty()).then(|| {
        format!("left and right look swapped, against most of {count} pairs of landmarks: {}", couples.join(", "))
    })
}

/// Pairs of left and right.
struct Sides {
    /// Right first.
    pairs: Vec<[usize; 2]>,
    /// Where left is, by most of them.
    left: Vec3,
    /// Those that point against that.
    swapped: Vec<[usize; 2]>,
}

impl Sides {
    fn of(names: &[&str], positions: &[Vec3]) -> Self {
        let pairs = pairs(names);
        let directions: Vec<Vec3> = pairs.iter().map(|&[right, left]| positions[left] - positions[right]).collect();
        let left = majority(&directions);
        let against = pairs.iter().zip(&directions).filter(|(_, d)| d.dot(&left) < 0.0);
        Self { swapped: against.map(|(pair, _)| *pair).collect(), left, pairs }
    }
}

/// Pairs of points that are at most `close` to each other: each point with the first one after it along x.
fn duplicates(positions: &[Vec3], close: f64) -> Vec<[usize; 2]> {
    let mut by_x: Vec<usize> = (0..positions.len()).collect();
    by_x.sort_by(|&a, &b| positions[a].x.total_cmp(&positions[b].x));
    let mut pairs = Vec::new();
    for (i, &a) in by_x.iter().enumerate() {
        let mut within = by_x[i + 1..].iter().take_while(|&&b| positions[b].x - positions[a].x <= close);
        if let Some(&b) = within.find(|&&b| (positions[a] - positions[b]).norm() <= close) {
            pairs.push([a.min(b), a.max(b)]);
        }
    }
    pairs.sort_unstable();
    pairs
}

/// Indices of pairs, right first.
fn pairs(names: &[&str]) -> Vec<[usize; 2]> {
    let find = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
    let numbers: Option<Vec<usize>> = (0..68).map(|n| find(&n.to_string())).collect();
    if let Some(numbers) = numbers {
        return PAIRS.map(|pair| pair.map(|n| numbers[n as usize])).to_vec();
    }
    let mirror = |name: &str| -> Option<usize> {
        let name = name.to_lowercase();
        if name.contains("right") {
            return find(&name.replace("right", "left"));
        }
        let left = |part: &str| match part.strip_prefix('r') {
            Some(number) if number.bytes().all(|b| b.is_ascii_digit()) => format!("l{number}"),
            _ => part.to_owned(),
        };
        let left = name.split('_').map(left).collect::<Vec<_>>().join("_");
        (left != name).then(|| find(&left))?
    };
    let named = names.iter().enumerate();
    named.filter_map(|(right, name)| mirror(name).map(|left| [right, left])).collect()
}

/// The mean of directions, each turned so that it agrees with most of them.
fn majority(directions: &[Vec3]) -> Vec3 {
    let agree = |d: &Vec3| directions.iter().filter(|e| d.dot(e) > 0.0).count();
    let mut best = None;
    for d in directions {
        let count = agree(d);
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, *d));
        }
    }
    let Some((_, reference)) = best else { return Vec3::zeros() };
    directions.iter().map(|d| if d.dot(&reference) < 0.0 { -d } else { *d }).sum::<Vec3>() / directions.len() as f64
}

/// From mouth and chin to eyes and brows.
fn upwards(names: &[&str], positions: &[Vec3]) -> Option<Vec3> {
    let mean = |words: &[&str], numbers: std::ops::Range<u32>| {
        let belongs = |name: &str| {
            let name = name.to_lowercase();
            name.parse::<u32>().is_ok_and(|n| numbers.contains(&n)) || words.iter().any(|w| name.contains(w))
        };
        let found: Vec<Vec3> = names.iter().zip(positions).filter(|(n, _)| belongs(n)).map(|(_, p)| *p).collect();
        (!found.is_empty()).then(|| found.iter().sum::<Vec3>() / found.len() as f64)
    };
    Some(mean(&UPPER, EYES)? - mean(&LOWER, MOUTH)?)
}

impl fmt::Display for LandmarkCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.landmarks.iter().map(|l| l.name.chars().count()).max().unwrap_or(0).max(4);
        writeln!(f, "{:width$}  {:>9}  {:>9}  {:>9}  {:>9}", "name", "x mm", "y mm", "z mm", "off mm")?;
        for l in &self.landmarks {
            let [x, y, z] = l.position_mm;
            writeln!(f, "{:width$}  {x:9.3}  {y:9.3}  {z:9.3}  {:9.3}", l.name, l.distance_mm)?;
        }
        let list = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let couples = |pairs: &[[String; 2]]| list(&pairs.iter().map(|p| p.join(" and ")).collect::<Vec<_>>());
        writeln!(f, "off the surface: {}", list(&self.off))?;
        writeln!(f, "at the same point: {}", couples(&self.duplicates))?;
        writeln!(f, "not placed: {}", list(&self.missing))?;
        writeln!(f, "left and right swapped, of {} pairs: {}", self.pairs, couples(&self.swapped))?;
        f.write_str(match self.mirrored {
            None => "all left and right swapped, or the mesh mirrored: not known",
            Some(false) => "all left and right swapped, or the mesh mirrored: no",
            Some(true) => "all left and right swapped, or the mesh mirrored: yes",
        })
    }
}
