//! Dense products that assemble normal equations and factor them. Row-major, single-threaded, the same bits on every call;
//! instruction sets beyond the build's baseline are used where the processor has them. Products are fused with the sums that they
//! go to, and every entry is summed in the order of the rows, so results do not depend on the width of its registers; a processor
//! that cannot fuse (x86 before 2013) is slow.
//!
//! All products are sums of outer products, `sum_k left_k' right_k`, in tiles that stay in registers from the first `k` to the
//! last: [`sum_of_products`] is the inner loop, [`sweep`] cuts rows into tiles. Rows are padded to a multiple of [`PAD`] numbers, so
//! that tiles need no ends.

use pulp::{Simd, WithSimd, bytemuck};

/// Rows are padded to a multiple of so many numbers: the widest register.
pub const PAD: usize = 8;

/// Rows of a tile where they are free to choose; divides [`PAD`]. Of sixteen registers three columns of sums fill twelve, and what is
/// multiplied fits into the rest: of eight rows the compiler keeps a sum in memory, and the forward solve takes more than twice as long.
pub const TILE_ROWS: usize = 4;

/// Length of a padded row of `n` numbers.
#[must_use]
pub const fn padded(n: usize) -> usize {
    n.next_multiple_of(PAD)
}

/// Runs `work` compiled for the best instruction set that this processor has.
#[inline]
pub fn vectorized<R>(work: impl FnMut() -> R) -> R {
    dispatch(Work(work))
}

/// Runs `work` with the registers of the best instruction set that this processor has.
#[inline]
pub fn dispatch<R>(work: impl WithSimd<Output = R>) -> R {
    pulp::Arch::new().dispatch(work)
}

/// `FnMut`, though it is called once: calling a closure by value goes through a shim that is not always inlined, and what is not
/// inlined is compiled for the baseline.
struct Work<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Work<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

/// What the right-hand rows of a product are kept as. They are multiplied and summed as f64.
pub trait Stored: Copy + 'static {
    /// The first `V` registers of a row.
    ///
    /// # Panics
    /// If the row is shorter.
    fn load<S: Simd, const V: usize>(simd: S, row: &[Self]) -> [S::f64s; V];
}

impl Stored for f64 {
    #[inline(always)]
    fn load<S: Simd, const V: usize>(_: S, row: &[Self]) -> [S::f64s; V] {
        let row = &S::as_simd_f64s(row).0[..V];
        std::array::from_fn(|v| row[v])
    }
}

impl Stored for f32 {
    #[inline(always)]
    fn load<S: Simd, const V: usize>(simd: S, row: &[Self]) -> [S::f64s; V] {
        let mut registers = [simd.splat_f64s(0.0); V];
        let numbers: &mut [f64] = bytemuck::cast_slice_mut(&mut registers);
        let row = &row[..numbers.len()];
        numbers.iter_mut().zip(row).for_each(|(wide, number)| *wide = f64::from(*number));
        registers
    }
}

/// `sum_k left_k' right_k` over the first `R` numbers of each `left` and the first `V` registers of each `right`.
///
/// # Panics
/// If a `left` or a `right` is shorter.
#[inline(always)]
pub fn sum_of_products<'a, S: Simd, T: Stored, const R: usize, const V: usize>(
    simd: S,
    terms: impl Iterator<Item = (&'a [f64], &'a [T])>,
) -> [[S::f64s; V]; R] {
    // Two functions and a sum that nobody else changes: otherwise the compiler keeps it in memory, at half the speed.
    let mut sum = [[simd.splat_f64s(0.0); V]; R];
    for (left, right) in terms {
        add_product(simd, left, right, &mut sum);
    }
    sum
}

/// `sum += left' right`.
#[inline(always)]
fn add_product<S: Simd, T: Stored, const R: usize, const V: usize>(
    simd: S,
    left: &[f64],
    right: &[T],
    sum: &mut [[S::f64s; V]; R],
) {
    let (left, right) = (&left[..R], T::load::<S, V>(simd, right));
    for r in 0..R {
        let l = simd.splat_f64s(left[r]);
        for v in 0..V {
            sum[r][v] = simd.mul_add_f64s(l, right[v], sum[r][v]);
        }
    }
}

/// `out += numbers`, as many as both have. Short rows are not worth the compiler's loops: whole registers, then one that is partly
/// used.
#[inline(always)]
pub fn add_to<S: Simd>(simd: S, numbers: &[f64], out: &mut [f64]) {
    let length = numbers.len().min(out.len());
    let (whole, rest) = S::as_simd_f64s(&numbers[..length]);
    let (out_whole, out_rest) = S::as_mut_simd_f64s(&mut out[..length]);
    for (o, number) in out_whole.iter_mut().zip(whole) {
        *o = simd.add_f64s(*o, *number);
    }
    if !rest.is_empty() {
        simd.partial_store_f64s(
            out_rest,
            simd.add_f64s(simd.partial_load_f64s(out_rest), simd.partial_load_f64s(rest)),
        );
    }
}

/// Starts to fetch the line of memory that number `at` of `row` lies in, if there is one. Processors foresee what follows in memory,
/// not what an index will ask for: with this, derivatives by a hundred shapes take a sixth less time and their products with the
/// nodes a twentieth.
#[inline(always)]
pub fn prefetch<T>(row: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(number) = row.get(at) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: fetching reads nothing and cannot fault; the instruction is part of every x86-64 processor.
        #[allow(unsafe_code)]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(number).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (row, at);
}

/// Work on a tile of `V` registers' width.
pub trait Tile {
    /// Does it for the tile that starts at column `first`.
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize);
}

/// Cuts `columns`, a multiple of [`PAD`], into tiles as wide as the registers allow that hold `R` rows of them.
#[inline(always)]
pub fn sweep<S: Simd, const R: usize>(simd: S, columns: usize, work: &mut impl Tile) {
    let widest = (S::REGISTER_COUNT * 3 / 4 / R).clamp(1, 4);
    let mut registers = columns / S::F64_LANES;
    let mut first = 0;
    for tiles in (1..=registers.div_ceil(widest)).rev() {
        let width = registers.div_ceil(tiles); // alike: one that is left over would be narrow, and wait for its own sums
        match width {
            4 => work.tile::<S, 4>(simd, first),
            3 => work.tile::<S, 3>(simd, first),
            2 => work.tile::<S, 2>(simd, first),
            _ => work.tile::<S, 1>(simd, first),
        }
        registers -= width;
        first += width * S::F64_LANES;
    }
}

/// `out += sum_k left_k' right_k` for gathered rows: `left` of `W` numbers, `right` of `n`, padded; `out` is `W x n`.
pub(crate) struct OuterProducts<'a, const W: usize> {
    pub left: &'a [&'a [f64]],
    pub right: &'a [&'a [f32]],
    pub n: usize,
    pub out: &'a mut [f64],
}

/// How many rows before a gathered row it is fetched.
const ROWS_AHEAD: usize = 8;

impl<const W: usize> WithSimd for OuterProducts<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        sweep::<S, W>(simd, padded(self.n), &mut self);
    }
}

impl<const W: usize> Tile for OuterProducts<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let rows = self.left.iter().zip(self.right).enumerate().map(|(k, (left, right))| {
            let later = self.right.get(k + ROWS_AHEAD).copied().unwrap_or(&[]);
            (0..V).for_each(|v| prefetch(later, first + v * S::F64_LANES));
            (*left, &right[first..])
        });
        let sum = sum_of_products::<S, _, W, V>(simd, rows);
        for (row, sum) in self.out.chunks_exact_mut(self.n).zip(&sum) {
            add_to(simd, bytemuck::cast_slice(sum), &mut row[first.min(self.n)..]);
        }
    }
}

/// `out += a' b` for the first `rows` rows of `a` and `b`, which are as wide as their padded rows; of `out`, `a_width x b_width`,
/// only what a lower triangle needs if `lower`.
pub struct Gram<'a> {
    pub a: &'a [f64],
    pub b: &'a [f64],
    pub a_width: usize,
    pub b_width: usize,
    pub rows: usize,
    pub lower: bool,
    pub out: &'a mut [f64],
}

/// Rows that [`Gram`] multiplies before it turns to the next tile: few enough for the first-level cache.
pub const GRAM_ROWS: usize = 32;

impl WithSimd for Gram<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for first in (0..self.rows).step_by(GRAM_ROWS) {
            let rows = first..(first + GRAM_ROWS).min(self.rows);
            for i in (0..self.a_width).step_by(TILE_ROWS) {
                let columns = if self.lower { padded(i + TILE_ROWS) } else { self.b_width };
                let out = &mut self.out[i * self.b_width..];
                let (a, b) = ((self.a, self.a_width), (self.b, self.b_width));
                sweep::<S, TILE_ROWS>(simd, columns, &mut GramTile { a, b, i, rows: rows.clone(), out });
            }
        }
    }
}

struct GramTile<'a> {
    a: (&'a [f64], usize),
    b: (&'a [f64], usize),
    i: usize,
    rows: std::ops::Range<usize>,
    out: &'a mut [f64],
}

impl Tile for GramTile<'_> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let ((a, a_width), (b, b_width)) = (self.a, self.b);
        let (from, count, i) = (self.rows.start, self.rows.len(), self.i);
        let (a, b) = (a[from * a_width..].chunks_exact(a_width), b[from * b_width..].chunks_exact(b_width));
        let rows = a.zip(b).take(count).map(|(a, b)| (&a[i..], &b[first..]));
        let sum = sum_of_products::<S, _, TILE_ROWS, V>(simd, rows);
        for r in 0..TILE_ROWS {
            let out = &mut S::as_mut_simd_f64s(&mut self.out[r * b_width + first..]).0[..V];
            for v in 0..V {
                out[v] = simd.add_f64s(out[v], sum[r][v]);
            }
        }
    }
}
