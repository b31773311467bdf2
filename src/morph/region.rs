//! Regions of the image plane, drawn by shapes and set operations, and their coverage of pixels (Li et al. 2018, section 1).
//!
//! A line parallel to the x axis meets a region in intervals, which are exact for every shape and closed under union,
//! difference and intersection. A pixel's coverage is the mean length of those intervals inside it over evenly spaced lines:
//! exact along x, the midpoint rule along y. So a region and what it was subtracted from add up to the whole.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{MorphError, Texture};

/// A shape in the drawing's coordinates. Angles are in degrees and turn from +x towards +y.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// Points at most `radius` from `centre`.
    Circle {
        /// Middle.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        centre: [f64; 2],
        /// Positive.
        radius: f64,
    },
    /// Points within an ellipse.
    Ellipse {
        /// Middle.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        centre: [f64; 2],
        /// Half axes, positive.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        radii: [f64; 2],
        /// Turn of the first half axis from +x.
        #[serde(default)]
        angle: f64,
    },
    /// Part of a disc, or of a ring.
    Sector {
        /// Tip.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        centre: [f64; 2],
        /// Inner radius; 0 (the default) for a part of a disc.
        #[serde(default)]
        inner: f64,
        /// Outer radius, above the inner one.
        outer: f64,
        /// Direction of the first side.
        start: f64,
        /// Turn from the first side to the second, above 0 and at most 360.
        sweep: f64,
    },
    /// What lies inside an odd number of the rings (**even-odd rule**): a ring inside another is a hole, a ring that crosses
    /// itself is outside where it winds twice. Rings close themselves.
    Polygon {
        /// Points of each ring.
        #[serde(deserialize_with = "crate::io::arrays::lists_of_arrays")]
        rings: Vec<Vec<[f64; 2]>>,
    },
}

/// A shape, or a combination of regions.
///
/// In files a shape stands by itself, `{ circle = { centre = [0, 0], radius = 9 } }`, and combinations are lists, `{ subtract = [A, B, C] }`
/// what is in A and neither in B nor in C.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Region {
    /// In either.
    Union(Box<Region>, Box<Region>),
    /// In the first and not in the second.
    Subtract(Box<Region>, Box<Region>),
    /// In both.
    Intersect(Box<Region>, Box<Region>),
    /// One shape.
    #[serde(untagged)]
    Shape(Shape),
}

impl From<Shape> for Region {
    fn from(shape: Shape) -> Self {
        Self::Shape(shape)
    }
}

/// What a drawing's coordinates mean on a texture.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coordinates {
    /// Pixels from the top left **corner** of the image, y down: the first pixel's centre is (0.5, 0.5). Lengths are pixels.
    #[default]
    Pixels,
    /// 0 to 1 as texture coordinates are: (0, 0) is the lower left corner, (1, 1) the upper right one, y up. On a texture that
    /// is not square a circle becomes an ellipse.
    Unit,
    /// The texture covers this box, y up: for instance millimetres of a [`LandmarkFrame`](super::LandmarkFrame).
    Box {
        /// Its lower left corner.
        low: [f64; 2],
        /// Its upper right corner.
        high: [f64; 2],
    },
}

/// Lines to a pixel that [`Region::rasterize`] takes: an edge along x is placed to 1/128 pixel, others better.
pub const DEFAULT_SUB_ROWS: usize = 64;

/// Bounds of coordinates and lengths, between which nothing overflows.
const SMALLEST: f64 = 1e-9;
const LARGEST: f64 = 1e9;

impl Region {
    /// In `self` or in `other`.
    #[must_use]
    pub fn union(self, other: impl Into<Self>) -> Self {
        Self::Union(Box::new(self), Box::new(other.into()))
    }

    /// In `self` and not in `other`.
    #[must_use]
    pub fn subtract(self, other: impl Into<Self>) -> Self {
        Self::Subtract(Box::new(self), Box::new(other.into()))
    }

    /// In `self` and in `other`.
    #[must_use]
    pub fn intersect(self, other: impl Into<Self>) -> Self {
        Self::Intersect(Box::new(self), Box::new(other.into()))
    }

    /// Corners, low and high, of a box that the region lies in.
    #[must_use]
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        let join = |a: &Self, b: &Self, low: fn(f64, f64) -> f64, high: fn(f64, f64) -> f64| {
            let (a, b) = (a.bounds(), b.bounds());
            [[0, 1].map(|k| low(a[0][k], b[0][k])), [0, 1].map(|k| high(a[1][k], b[1][k]))]
        };
        match self {
            Self::Shape(shape) => shape.bounds(),
            Self::Union(a, b) => join(a, b, f64::min, f64::max),
            Self::Subtract(a, _) => a.bounds(),
            Self::Intersect(a, b) => join(a, b, f64::max, f64::min),
        }
    }

    /// The texture of this region: for each pixel, the share of it that the region covers.
    ///
    /// # Errors
    /// When a number is not finite or out of its range, a polygon encloses nothing, or there are no or too many pixels.
    pub fn rasterize(&self, width: usize, height: usize, coordinates: Coordinates) -> Result<Texture, MorphError> {
        self.rasterize_with(width, height, coordinates, DEFAULT_SUB_ROWS)
    }

    /// As [`Self::rasterize`] with this many lines to a pixel, 1 to 1024.
    ///
    /// # Errors
    /// As [`Self::rasterize`], and for another number of lines.
    pub fn rasterize_with(
        &self,
        width: usize,
        height: usize,
        coordinates: Coordinates,
        sub_rows: usize,
    ) -> Result<Texture, MorphError> {
        self.check()?;
        if !(1..=1024).contains(&sub_rows) {
            return Err(MorphError::SubRows { found: sub_rows });
        }
        let (low, high) = match coordinates {
            Coordinates::Pixels => ([0.0, height as f64], [width as f64, 0.0]),
            Coordinates::Unit => ([0.0; 2], [1.0; 2]),
            Coordinates::Box { low, high } => {
                let bounded = |v: f64| v.abs() <= LARGEST;
                let wrong = |a: usize| !(bounded(low[a]) && bounded(high[a]) && high[a] - low[a] >= SMALLEST);
                if wrong(0) || wrong(1) {
                    return Err(MorphError::Covered { low, high });
                }
                (low, high)
            }
        };
        let mut grey = Texture::blank(width, height)?.into_grey();
        // Pixels along x, and the drawing's y, which falls from the top row to the bottom row of the image.
        let scale = width as f64 / (high[0] - low[0]);
        let step = (low[1] - high[1]) / height as f64;
        grey.par_chunks_mut(width).enumerate().for_each(|(row, pixels)| {
            for sub_row in 0..sub_rows {
                let line = row as f64 + (sub_row as f64 + 0.5) / sub_rows as f64;
                for [a, b] in self.intervals(high[1] + line * step) {
                    cover((a - low[0]) * scale, (b - low[0]) * scale, pixels);
                }
            }
            for pixel in pixels {
                *pixel = (*pixel / sub_rows as f64).clamp(0.0, 1.0);
            }
        });
        Texture::new(width, height, grey)
    }

    fn check(&self) -> Result<(), MorphError> {
        match self {
            Self::Shape(shape) => shape.check(),
            Self::Union(a, b) | Self::Subtract(a, b) | Self::Intersect(a, b) => a.check().and_then(|()| b.check()),
        }
    }

    /// Where the line at `y` meets the region.
    fn intervals(&self, y: f64) -> Intervals {
        match self {
            Self::Shape(shape) => shape.intervals(y),
            Self::Union(a, b) => combine(&a.intervals(y), &b.intervals(y), |a, b| a || b),
            Self::Subtract(a, b) => combine(&a.intervals(y), &b.intervals(y), |a, b| a && !b),
            Self::Intersect(a, b) => combine(&a.intervals(y), &b.intervals(y), |a, b| a && b),
        }
    }
}

/// Disjoint, ascending.
type Intervals = Vec<[f64; 2]>;

/// The points whose membership in `a` and in `b` gives `keep`; `keep(false, false)` is false.
fn combine(a: &[[f64; 2]], b: &[[f64; 2]], keep: impl Fn(bool, bool) -> bool) -> Intervals {
    let (ends_a, ends_b) = (a.as_flattened(), b.as_flattened());
    let (mut i, mut j) = (0, 0);
    let mut found: Intervals = Vec::new();
    let mut open = None;
    while i < ends_a.len() || j < ends_b.len() {
        let next = |ends: &[f64], k: usize| ends.get(k).copied().unwrap_or(f64::INFINITY);
        let x = next(ends_a, i).min(next(ends_b, j));
        // Past an end with an even index we are inside.
        while ends_a.get(i).is_some_and(|&end| end <= x) {
            i += 1;
        }
        while ends_b.get(j).is_some_and(|&end| end <= x) {
            j += 1;
        }
        match (open, keep(i % 2 == 1, j % 2 == 1)) {
            (None, true) => open = Some(x),
            (Some(start), false) => {
                found.push([start, x]);
                open = None;
            }
            _ => {}
        }
    }
    found
}

/// Adds the length of [a, b] inside each pixel.
fn cover(a: f64, b: f64, pixels: &mut [f64]) {
    let (a, b) = (a.clamp(0.0, pixels.len() as f64), b.clamp(0.0, pixels.len() as f64));
    if a >= b {
        return;
    }
    let (first, last) = (a as usize, (b as usize).min(pixels.len() - 1));
    if first == last {
        pixels[first] += b - a;
        return;
    }
    pixels[first] += (first + 1) as f64 - a;
    pixels[last] += b - last as f64;
    for pixel in &mut pixels[first + 1..last] {
        *pixel += 1.0;
    }
}

impl Shape {
    fn check(&self) -> Result<(), MorphError> {
        let fail = |shape, what, value, expected| Err(MorphError::Shape { shape, what, value, expected });
        let finite = |shape, what, values: &[f64]| match values.iter().find(|v| !(-LARGEST..=LARGEST).contains(*v)) {
            Some(&value) => fail(shape, what, value, "a number from -1e9 to 1e9"),
            None => Ok(()),
        };
        let positive = |shape, what, value: f64| match (SMALLEST..=LARGEST).contains(&value) {
            true => Ok(()),
            false => fail(shape, what, value, "a number from 1e-9 to 1e9"),
        };
        match self {
            Self::Circle { centre, radius } => {
                finite("circle", "a coordinate of the centre", centre)?;
                positive("circle", "the radius", *radius)
            }
            Self::Ellipse { centre, radii, angle } => {
                finite("ellipse", "a coordinate of the centre", centre)?;
                finite("ellipse", "the angle", &[*angle])?;
                positive("ellipse", "the first radius", radii[0])?;
                positive("ellipse", "the second radius", radii[1])
            }
            Self::Sector { centre, inner, outer, start, sweep } => {
                finite("sector", "a coordinate of the centre", centre)?;
                finite("sector", "the start", &[*start])?;
                positive("sector", "the outer radius", *outer)?;
                if !(*inner >= 0.0 && inner < outer) {
                    return fail("sector", "the inner radius", *inner, "at least 0 and below the outer radius");
                }
                if !(*sweep > 0.0 && *sweep <= 360.0) {
                    return fail("sector", "the sweep", *sweep, "above 0 and at most 360 degrees");
                }
                Ok(())
            }
            Self::Polygon { rings } => {
                if rings.is_empty() {
                    return Err(MorphError::EmptyPolygon { ring: 0, points: 0 });
                }
                for (ring, points) in rings.iter().enumerate() {
                    finite("polygon", "a coordinate", points.as_flattened())?;
                    if on_one_line(points) {
                        return Err(MorphError::EmptyPolygon { ring, points: points.len() });
                    }
                }
                Ok(())
            }
        }
    }

    fn bounds(&self) -> [[f64; 2]; 2] {
        let about = |c: &[f64; 2], r: f64| [[c[0] - r, c[1] - r], [c[0] + r, c[1] + r]];
        match self {
            Self::Circle { centre, radius } => about(centre, *radius),
            Self::Ellipse { centre, radii, .. } => about(centre, radii[0].max(radii[1])),
            Self::Sector { centre, outer, .. } => about(centre, *outer),
            Self::Polygon { rings } => {
                let extreme =
                    |k: usize, take: fn(f64, f64) -> f64, start| rings.iter().flatten().map(|p| p[k]).fold(start, take);
                [
                    [0, 1].map(|k| extreme(k, f64::min, f64::INFINITY)),
                    [0, 1].map(|k| extreme(k, f64::max, f64::NEG_INFINITY)),
                ]
            }
        }
    }

    fn intervals(&self, y: f64) -> Intervals {
        match self {
            Self::Circle { centre, radius } => disc(*centre, *radius, y),
            Self::Ellipse { centre, radii: [a, b], angle } => {
                // x'^2 / a^2 + y'^2 / b^2 = 1 with (x', y') turned by -angle: a quadratic in x - centre.
                let (s, c) = angle.to_radians().sin_cos();
                let (dy, extent) = (y - centre[1], (a * s).hypot(b * c));
                let t = dy / extent;
                if t.abs() >= 1.0 {
                    return Vec::new();
                }
                let middle = centre[0] + t * (s * c * (a * a - b * b)) / extent;
                let half = a * b / extent * ((1.0 - t) * (1.0 + t)).sqrt();
                vec![[middle - half, middle + half]]
            }
            Self::Sector { centre, inner, outer, start, sweep } => {
                let ring = combine(&disc(*centre, *outer, y), &disc(*centre, *inner, y), |out, hole| out && !hole);
                if *sweep >= 360.0 {
                    return ring;
                }
                // To the left of the first side, to the right of the second.
                let first = left_of(*centre, *start, y);
                let second = left_of(*centre, start + sweep + 180.0, y);
                let wedge = if *sweep <= 180.0 {
                    combine(&first, &second, |a, b| a && b)
                } else {
                    combine(&first, &second, |a, b| a || b)
                };
                combine(&ring, &wedge, |a, b| a && b)
            }
            Self::Polygon { rings } => {
                let mut crossings = Vec::new();
                for ring in rings {
                    let before = ring.iter().cycle().skip(ring.len() - 1);
                    for (p, q) in before.zip(ring) {
                        // An edge owns its lower end only, so a corner counts once.
                        if (p[1] <= y) != (q[1] <= y) {
                            crossings.push(p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0]));
                        }
                    }
                }
                crossings.sort_unstable_by(f64::total_cmp);
                crossings.chunks_exact(2).map(|c| [c[0], c[1]]).filter(|[a, b]| a < b).collect()
            }
        }
    }
}

fn disc(centre: [f64; 2], radius: f64, y: f64) -> Intervals {
    let dy = (y - centre[1]).abs();
    if dy >= radius {
        return Vec::new();
    }
    let half = ((radius - dy) * (radius + dy)).sqrt();
    vec![[centre[0] - half, centre[0] + half]]
}

/// The half plane to the left of the ray from `centre` at `angle` degrees: `cos (y - c_y) - sin (x - c_x) >= 0`.
fn left_of(centre: [f64; 2], angle: f64, y: f64) -> Intervals {
    // Multiples of 90 degrees exactly, so that a half disc is one.
    let turn = angle.rem_euclid(360.0);
    let (s, c) = match turn {
        0.0 | 360.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turn.to_radians().sin_cos(),
    };
    let dy = y - centre[1];
    let x = centre[0] + c * dy / s;
    if s > 0.0 {
        vec![[f64::NEG_INFINITY, x]]
    } else if s < 0.0 {
        vec![[x, f64::INFINITY]]
    } else if c * dy >= 0.0 {
        vec![[f64::NEG_INFINITY, f64::INFINITY]]
    } else {
        Vec::new()
    }
}

/// Do the points enclose nothing whatever their order?
fn on_one_line(points: &[[f64; 2]]) -> bool {
    let Some(o) = points.first() else { return true };
    let offset = |p: &[f64; 2]| [p[0] - o[0], p[1] - o[1]];
    let length2 = |d: [f64; 2]| d[0] * d[0] + d[1] * d[1];
    let Some(far) = points.iter().map(offset).max_by(|a, b| length2(*a).total_cmp(&length2(*b))) else { return true };
    points.iter().map(offset).all(|d| (far[0] * d[1] - far[1] * d[0]).abs() <= 1e-14 * length2(far))
}
