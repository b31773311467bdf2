//! Blurs of a grey texture (Li et al. 2018, section 1.3 and table 1): mean, Gaussian and median of k x k pixels, n times.
//!
//! Mean and Gaussian are products of a blur along the columns and one along the rows. The two commute, the rules for the border
//! being rules for each axis, so n blurs of the texture are n blurs of each column and then n of each row: eight columns at a
//! time stay in the cache for all n.
//!
//! The **mean** adds the pixel that comes and takes away the one that goes, so its cost does not depend on k. Its numbers are
//! multiples of a power of two so large that the sums of k of them are exact: nothing drifts, and where the texture is constant
//! it stays so to the last bit. Rounding costs less than 2^-52 times the power of two above k at each blur (4e-15 for k = 13).
//!
//! The **median** is exact too, not that of a coarser scale of greys. Its values are those of the texture, so all n run on
//! ranks. In each tile of the image the pixels are sorted, after which a window is a set of bits; it slides as Huang's does (Huang,
//! Yang and Tang, "A fast two-dimensional median filtering algorithm", 1979) and costs O(k) a pixel whatever the levels.

use std::fmt;

use rayon::prelude::*;
use serde::de::value::MapAccessDeserializer;
use serde::de::{IntoDeserializer, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::{MorphError, Texture};
use crate::nlls::dense_kernels::vectorized;

/// Largest side of a kernel, pixels.
pub const MAX_KERNEL: usize = 1023;

/// What the k x k pixels under the kernel make of their middle.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum BlurKind {
    /// Their mean: the paper's choice.
    #[default]
    Mean,
    /// Their mean with weights `exp(-(x^2 + y^2) / (2 sigma^2))`, which sum to 1; in files also
    /// `{ gaussian = { sigma = 2 } }`.
    Gaussian {
        /// Pixels; without it [`Blur::sigma_of`] the kernel's side.
        sigma: Option<f64>,
    },
    /// Their median.
    Median,
}

/// What lies beyond the texture's border.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Border {
    /// The nearest pixel of the border. The default: a mask that reaches the picture's edge goes on, and no border is darkened.
    #[default]
    Replicate,
    /// The picture's mirror image in its outermost pixels, which are not repeated (OpenCV's default).
    Reflect101,
    /// Zeros: a mask fades at the picture's edge too.
    Zero,
}

/// A blur.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields, default)]
pub struct Blur {
    /// Default mean.
    #[serde(deserialize_with = "kind_or_its_name")]
    pub kind: BlurKind,
    /// Side k of the kernel, odd, at most [`MAX_KERNEL`]; default 13, the paper's.
    pub kernel: usize,
    /// How many times, n; default 20. The paper shows 0, 20 and 40.
    pub iterations: usize,
    /// Default [`Border::Replicate`].
    pub border: Border,
}

/// A kind, or the name of one whose numbers have defaults.
fn kind_or_its_name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BlurKind, D::Error> {
    struct Kind;

    impl<'de> Visitor<'de> for Kind {
        type Value = BlurKind;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("\"mean\", \"gaussian\", \"median\" or { gaussian = { sigma = 2 } }")
        }

        fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<BlurKind, E> {
            match name {
                "gaussian" => Ok(BlurKind::Gaussian { sigma: None }),
                _ => BlurKind::deserialize(name.into_deserializer()),
            }
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<BlurKind, A::Error> {
            BlurKind::deserialize(MapAccessDeserializer::new(map))
        }
    }

    deserializer.deserialize_any(Kind)
}

impl Default for Blur {
    fn default() -> Self {
        Self { kind: BlurKind::Mean, kernel: 13, iterations: 20, border: Border::Replicate }
    }
}

impl Blur {
    /// The width of a Gaussian for a kernel of side k, as OpenCV takes it: `0.3 ((k - 1) / 2 - 1) + 0.8` pixels.
    #[must_use]
    pub fn sigma_of(kernel: usize) -> f64 {
        0.3 * ((kernel as f64 - 1.0) * 0.5 - 1.0) + 0.8
    }

    /// Standard deviation of what all its iterations together spread a point to, pixels; of the median, which does not spread, the
    /// kernel's own.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        let k = self.kernel as f64;
        let mean = ((k * k - 1.0) / 12.0).sqrt();
        let times = (self.iterations as f64).sqrt();
        match self.kind {
            BlurKind::Mean => mean * times,
            BlurKind::Gaussian { sigma } => sigma.unwrap_or_else(|| Self::sigma_of(self.kernel)) * times,
            BlurKind::Median => mean,
        }
    }

    /// The texture blurred: [`Self::iterations`] times, 0 to 1 again.
    ///
    /// # Errors
    /// When the kernel's side is even or too large, or sigma is not a positive number.
    pub fn apply(&self, texture: &Texture) -> Result<Texture, MorphError> {
        let k = self.kernel;
        if k.is_multiple_of(2) || k > MAX_KERNEL {
            return Err(MorphError::Kernel { size: k });
        }
        let weights = match self.kind {
            BlurKind::Gaussian { sigma } => {
                let sigma = sigma.unwrap_or_else(|| Self::sigma_of(k));
                if !(sigma > 0.0 && sigma.is_finite()) {
                    return Err(MorphError::Sigma { sigma });
                }
                gaussian(k, sigma)
            }
            BlurKind::Mean | BlurKind::Median => Vec::new(),
        };
        if self.iterations == 0 {
            return Ok(texture.clone());
        }
        let (width, height) = (texture.width(), texture.height());
        if self.kind == BlurKind::Median {
            return Ok(texture.with_grey(medians(texture.grey(), width, height, self)));
        }
        let columns = blur_columns(texture.grey(), width, height, self, &weights);
        Ok(texture.with_grey(blur_columns(&columns, height, width, self, &weights)))
    }
}

/// From the middle outwards; the middle counts once, the others twice.
fn gaussian(k: usize, sigma: f64) -> Vec<f64> {
    let mut half: Vec<f64> = (0..=k / 2).map(|x| (-0.5 * (x as f64 / sigma).powi(2)).exp()).collect();
    let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    half.iter_mut().for_each(|w| *w /= sum);
    half
}

/// Index of the pixel at each place from -r to n + r along an axis of `n` pixels; `n` stands for a zero.
fn places(n: usize, r: usize, border: Border) -> Vec<usize> {
    let (length, last) = (n as isize, n as isize - 1);
    let place = |i: isize| match border {
        _ if (0..length).contains(&i) => i,
        Border::Zero => length,
        Border::Replicate => i.clamp(0, last),
        Border::Reflect101 if last == 0 => 0,
        Border::Reflect101 => {
            let turn = i.rem_euclid(2 * last);
            turn.min(2 * last - turn)
        }
    };
    (-(r as isize)..(n + r) as isize).map(|i| place(i) as usize).collect()
}

/// Columns that are blurred together: a cache line.
const LANES: usize = 8;
type Lane = [f64; LANES];

/// Blurs each column n times. The result is transposed: its rows are the columns.
fn blur_columns(grey: &[f64], width: usize, height: usize, blur: &Blur, weights: &[f64]) -> Vec<f64> {
    let radius = blur.kernel / 2;
    let places = places(height, radius, blur.border);
    let mut result = vec![0.0; grey.len()];
    let strip = |(index, columns): (usize, &mut [f64]), [from, to]: &mut [Vec<Lane>; 2]| {
        let first = index * LANES;
        let lanes = columns.len() / height;
        for (row, lane) in grey.chunks_exact(width).zip(from[radius..].iter_mut()) {
            lane[..lanes].copy_from_slice(&row[first..first + lanes]);
        }
        if weights.is_empty() {
            from.as_flattened_mut().iter_mut().for_each(|value| *value = rounded(*value, blur.kernel));
        }
        for _ in 0..blur.iterations {
            for beyond in (0..radius).chain(radius + height..height + 2 * radius) {
                let place = places[beyond];
                from[beyond] = if place < height { from[radius + place] } else { [0.0; LANES] };
            }
            vectorized(|| match weights {
                [] => mean(from, &mut to[radius..], blur.kernel),
                _ => weighted_mean(from, &mut to[radius..], weights),
            });
            std::mem::swap(from, to);
        }
        for (lane, column) in columns.chunks_exact_mut(height).enumerate() {
            for (value, from) in column.iter_mut().zip(&from[radius..]) {
                *value = from[lane];
            }
        }
    };
    let buffers = || [(); 2].map(|()| vec![[0.0; LANES]; height + 2 * radius]);
    let strips = result.par_chunks_mut(LANES * height).enumerate();
    strips.for_each_init(buffers, |buffers, chunk| strip(chunk, buffers));
    result
}

/// A number from 0 to 1 rounded to a multiple of 2^(b - 52), where 2^b is the first power above k: the sum of k of them is exact.
#[inline(always)]
fn rounded(value: f64, k: usize) -> f64 {
    let spacing = 1.5 * (k + 1).next_power_of_two() as f64;
    (value + spacing) - spacing
}

/// `to[i]` = mean of `from[i .. i + k]`, all [`rounded`].
#[inline(always)]
fn mean(from: &[Lane], to: &mut [Lane], k: usize) {
    let inverse = 1.0 / k as f64;
    let mut sum = [0.0; LANES];
    for row in &from[..k - 1] {
        for l in 0..LANES {
            sum[l] += row[l];
        }
    }
    for ((to, comes), goes) in to.iter_mut().zip(&from[k - 1..]).zip(from) {
        for l in 0..LANES {
            let all = sum[l] + comes[l];
            to[l] = rounded(all * inverse, k);
            sum[l] = all - goes[l];
        }
    }
}

/// `to[i] = sum_j w_|j| from[i + r + j]`, from the middle outwards.
#[inline(always)]
fn weighted_mean(from: &[Lane], to: &mut [Lane], weights: &[f64]) {
    let r = weights.len() - 1;
    for (to, window) in to.iter_mut().zip(from.windows(2 * r + 1)) {
        let (before, after) = window.split_at(r);
        let mut sum = after[0].map(|middle| weights[0] * middle);
        for ((a, b), weight) in before.iter().rev().zip(&after[1..]).zip(&weights[1..]) {
            for l in 0..LANES {
                sum[l] += weight * (a[l] + b[l]);
            }
        }
        *to = sum;
    }
}

/// Side of the tiles that medians are taken in, unless the kernel is larger.
const TILE: usize = 64;

fn medians(grey: &[f64], width: usize, height: usize, blur: &Blur) -> Vec<f64> {
    // Not negative, so the order of the bits is that of the numbers.
    let mut order: Vec<(u64, u32)> = grey.iter().zip(0..).map(|(g, i)| (g.to_bits(), i)).collect();
    order.par_sort_unstable();
    let mut levels = vec![0.0];
    let mut ranks = vec![0u32; grey.len()];
    for (bits, i) in order {
        let value = f64::from_bits(bits);
        if levels.last() != Some(&value) {
            levels.push(value);
        }
        ranks[i as usize] = levels.len() as u32 - 1;
    }
    let tile = TILE.max(blur.kernel);
    let radius = blur.kernel / 2;
    let (columns, rows) = (places(width, radius, blur.border), places(height, radius, blur.border));
    let mut next = vec![0; ranks.len()];
    for _ in 0..blur.iterations {
        let bands = next.par_chunks_mut(width * tile).enumerate();
        bands.for_each_init(MedianTile::default, |work, (band, out)| {
            let top = band * tile;
            let rows = &rows[top..top + out.len() / width + 2 * radius];
            for left in (0..width).step_by(tile) {
                let columns = &columns[left..(left + tile).min(width) + 2 * radius];
                work.gather(&ranks, width, columns, rows);
                vectorized(|| work.filter(blur.kernel, &mut out[left..], width));
            }
        });
        std::mem::swap(&mut ranks, &mut next);
    }
    ranks.iter().map(|&rank| levels[rank as usize]).collect()
}

/// The medians of one tile, and what they take.
#[derive(Default)]
struct MedianTile {
    /// Width and height with what the kernel reaches beyond the tile.
    size: [usize; 2],
    /// Values, then their places among the sorted: no two are equal.
    pixels: Vec<u32>,
    /// Value in the upper half, pixel in the lower.
    sorted: Vec<u64>,
    /// Which places the window holds.
    window: Vec<u64>,
}

impl MedianTile {
    fn gather(&mut self, ranks: &[u32], width: usize, columns: &[usize], rows: &[usize]) {
        self.size = [columns.len(), rows.len()];
        self.pixels.clear();
        for &row in rows {
            // Beyond a border of zeros there is no such row or column, and the rank is that of 0.
            let line = ranks.get(row * width..(row + 1) * width);
            self.pixels.extend(columns.iter().map(|&c| line.and_then(|line| line.get(c)).copied().unwrap_or(0)));
        }
    }

    /// Medians of the k x k pixels, to rows of `out` that are `stride` apart.
    #[inline(always)]
    fn filter(&mut self, k: usize, out: &mut [u32], stride: usize) {
        let [width, height] = self.size;
        let (columns, rows) = (width + 1 - k, height + 1 - k);
        if self.pixels.iter().all(|p| *p == self.pixels[0]) {
            for row in out.chunks_mut(stride).take(rows) {
                row[..columns].fill(self.pixels[0]);
            }
            return;
        }
        self.sorted.clear();
        self.sorted.extend(self.pixels.iter().zip(0u64..).map(|(p, i)| u64::from(*p) << 32 | i));
        self.sorted.sort_unstable();
        for (place, sorted) in self.sorted.iter().enumerate() {
            self.pixels[*sorted as u32 as usize] = place as u32;
        }
        self.window.clear();
        self.window.resize(self.sorted.len().div_ceil(64), 0);
        let middle = (k * k / 2) as u32;
        let window = &mut self.window[..];
        let line = |row: usize, column: usize| &self.pixels[row * width + column..][..k];
        let value = |place: usize| (self.sorted[place] >> 32) as u32;
        for column in 0..columns {
            // `below` counts the window's places before word `at`.
            let (mut at, mut below) = (0, 0u32);
            window.fill(0);
            for row in 0..k - 1 {
                for &p in line(row, column) {
                    window[p as usize / 64] |= 1 << (p % 64);
                }
            }
            for row in 0..rows {
                for &p in line(row + k - 1, column) {
                    window[p as usize / 64] |= 1 << (p % 64);
                    below += u32::from((p as usize / 64) < at);
                }
                while below > middle {
                    at -= 1;
                    below -= window[at].count_ones();
                }
                while below + window[at].count_ones() <= middle {
                    below += window[at].count_ones();
                    at += 1;
                }
                out[row * stride + column] = value(at * 64 + nth_bit(window[at], middle - below));
                for &p in line(row, column) {
                    window[p as usize / 64] &= !(1 << (p % 64));
                    below -= u32::from((p as usize / 64) < at);
                }
            }
        }
    }
}

/// Place of the set bit that has `n` set bits before it.
#[inline(always)]
fn nth_bit(mut word: u64, mut n: u32) -> usize {
    let mut place = 0;
    for half in [32, 16, 8, 4, 2, 1] {
        let low = (word & ((1 << half) - 1)).count_ones();
        if n >= low {
            n -= low;
            word >>= half;
            place += half;
        }
    }
    place
}
