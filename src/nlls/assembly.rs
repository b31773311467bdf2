//! The one assembler: rows of residuals over a few blocks each, and over the dense border, to bordered normal equations.
//!
//! An *item* is some rows over the same blocks: a residual, a sample of a template with the rows of its quadric, an edge of a
//! regulariser. With its Jacobians `Y_j` by each of its blocks j, `U` by the border, and residuals e, all weighted,
//!
//! ```text
//!     H_jk += Y_j' Y_k      H_jw += Y_j' U      H_ww += U' U      g_j += Y_j' e      g_w += U' e
//! ```
//!
//! Items are linearised in chunks of fixed size, each the work of one task; then every block row sums the items that it takes part
//! in. All orders of summation are fixed. Who assembles says what the rows are ([`FillRows`], or a closure) and nothing else.
//!
//! `U` is kept in single precision, since most of the numbers are its own: the equations are exactly those of a Jacobian whose border
//! is rounded to 24 bits, so they stay positive semidefinite. The gradient is that of the Jacobian before, so minima do not move.

use pulp::{Simd, WithSimd, bytemuck};
use rayon::prelude::*;

use super::border_sum::BorderSum;
use super::dense_kernels::{OuterProducts, Tile, add_to, dispatch, padded, sum_of_products, sweep};
use super::{BlockRow, BlockStructure, NormalEquations};

/// Items of a chunk, and the rows after which one is full too.
const CHUNK: usize = 512;

/// Chunks whose products for the border are summed by one task.
const BORDER_GROUP: usize = 4;

/// Rows of Y and U that are gathered before they are multiplied.
const BATCH: usize = 96;

/// Items over blocks, laid out for one [`BlockStructure`].
///
/// ```
/// use std::sync::Arc;
/// use nonrigid::nlls::{Assembly, BlockStructure, NormalEquations};
///
/// // r_0 = x_0 - 1 over block 0; r_1 = 2 (x_1 - x_0) over both.
/// let items = [vec![0], vec![0, 1]];
/// let structure = Arc::new(BlockStructure::new(&[1, 1], [(1, 0)], 0)?);
/// let mut assembly = Assembly::new(items.iter().map(Vec::as_slice), &structure, |_| 1);
/// let x = [3.0, 5.0];
/// assembly.linearize(0, |_| 1, |item, rows| match item {
///     0 => {
///         rows.of_block(0, 0)[0] = 1.0;
///         rows.set_residuals(&[x[0] - 1.0]);
///     }
///     _ => {
///         rows.of_block(0, 0)[0] = -2.0;
///         rows.of_block(1, 0)[0] = 2.0;
///         rows.set_residuals(&[2.0 * (x[1] - x[0])]);
///     }
/// });
/// let mut equations = NormalEquations::new(structure);
/// assembly.add_to(&mut equations);
/// assert_eq!(equations.to_dense(), nalgebra::dmatrix![5.0, -4.0; -4.0, 4.0]);
/// assert_eq!(equations.gradient, [2.0 - 8.0, 8.0]);
/// # Ok::<(), nonrigid::nlls::StructureError>(())
/// ```
#[derive(Debug, Default)]
pub struct Assembly {
    chunks: Vec<Chunk>,
    by_block: Vec<BlockItems>,
    /// What groups of chunks add to the border.
    borders: Vec<BorderSum>,
    /// Coordinates of the border at the last linearisation.
    border: usize,
}

/// The rows of an item, for a linearisation to fill: zero when handed over.
#[derive(Debug)]
pub struct ItemRows<'a> {
    slots: &'a [Slot],
    count: usize,
    border: usize,
    y: &'a mut [f64],
    u: &'a mut [f64],
    e: &'a mut [f64],
}

/// What writes the rows of items.
pub(crate) trait FillRows: Sync {
    /// Memory that a task needs, kept from call to call.
    type Scratch: Default + Send;

    /// Number of rows of an item.
    fn count(&self, item: usize) -> usize;

    /// Writes them: all of the border, and of the blocks what is not zero. Items without rows are left out.
    fn fill<S: Simd>(&self, simd: S, item: usize, scratch: &mut Self::Scratch, rows: &mut ItemRows<'_>);
}

/// A run of items with their Jacobians.
#[derive(Debug, Default)]
struct Chunk {
    first_item: usize,
    /// Slots of each item; one more for the end of the last.
    slot_starts: Vec<u32>,
    slots: Vec<Slot>,
    /// Where the rows of each item start; one more for the end of the last.
    row_starts: Vec<u32>,
    /// Where the `Y` of each item start.
    y_starts: Vec<u32>,
    /// `Y_j`: slot by slot of an item, row by row, padded to [`pitch`], the residual after the row's end.
    y: Vec<f64>,
    /// `U`, padded rows.
    u: Vec<f32>,
}

/// A block of an item.
#[derive(Debug, Clone, Copy)]
struct Slot {
    /// Tangent coordinates of the block.
    width: u32,
    /// Numbers of the slots before it, in one row of each.
    offset: u32,
}

/// Length of a row by a block of `width` coordinates, with the residual after it.
const fn pitch(width: usize) -> usize {
    padded(width + 1)
}

/// What a block has to add up.
#[derive(Debug, Default)]
struct BlockItems {
    items: Vec<Place>,
    /// Blocks left of the diagonal.
    runs: Vec<Run>,
    pairs: Vec<Pair>,
}

/// An item at one of its slots.
#[derive(Debug, Clone, Copy)]
struct Place {
    chunk: u32,
    item: u32,
    offset: u32,
}

/// An item with two blocks: the row's own and that of another slot.
#[derive(Debug, Clone, Copy)]
struct Pair {
    own: Place,
    other: u32,
}

/// The items of a block left of the diagonal.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Where the block starts in the block row.
    start: u32,
    /// Its columns.
    width: u32,
    /// Where its pairs end.
    end: u32,
}

impl Assembly {
    /// Items with the blocks of each, every block once, ascending; blocks that are not in the structure (constants) are left out by
    /// the caller. `most_rows` is how many rows an item has at most: it decides how many share a chunk.
    ///
    /// # Panics
    /// If two blocks of an item do not meet in the structure.
    #[must_use]
    pub fn new<'a>(
        items: impl IntoIterator<Item = &'a [u32]>,
        structure: &BlockStructure,
        most_rows: impl Fn(usize) -> usize,
    ) -> Self {
        let mut chunks: Vec<Chunk> = Vec::new();
        let mut by_block = vec![(Vec::new(), Vec::new()); structure.block_count()];
        let mut filled = CHUNK;
        for (item, blocks) in items.into_iter().enumerate() {
            if filled >= CHUNK {
                chunks.push(Chunk { first_item: item, slot_starts: vec![0], ..Chunk::default() });
                filled = 0;
            }
            filled += most_rows(item).div_ceil(3).max(1);
            let at = chunks.len() as u32 - 1;
            let chunk = chunks.last_mut().expect("proven: pushed above");
            let place = |slot: &Slot| Place { chunk: at, item: (item - chunk.first_item) as u32, offset: slot.offset };
            let first = chunk.slots.len();
            let mut offset = 0;
            for &block in blocks {
                let width = structure.size(block as usize);
                chunk.slots.push(Slot { width: width as u32, offset });
                offset += pitch(width) as u32;
            }
            chunk.slot_starts.push(chunk.slots.len() as u32);
            let slots = &chunk.slots[first..];
            for (p, (&j, slot)) in blocks.iter().zip(slots).enumerate() {
                let own = place(slot);
                by_block[j as usize].0.push(own);
                let row = structure.row_values(j as usize).start;
                for (&k, other) in blocks[..p].iter().zip(slots) {
                    let block = structure.slot(j as usize, k as usize).expect("blocks of an item meet");
                    let start = (structure.values(block).start - row) as u32;
                    by_block[j as usize].1.push((start, other.width, Pair { own, other: other.offset }));
                }
            }
        }
        let by_block = by_block.into_par_iter().map(|(items, mut pairs): (Vec<_>, Vec<_>)| {
            pairs.sort_by_key(|pair| pair.0);
            let runs = pairs.chunk_by(|a, b| a.0 == b.0).scan(0, |end, run| {
                *end += run.len() as u32;
                Some(Run { start: run[0].0, width: run[0].1, end: *end })
            });
            // As much memory as they need: `into_iter` would collect into what they were sorted in.
            let (items, runs) = (items.as_slice().to_vec(), runs.collect());
            BlockItems { items, runs, pairs: pairs.iter().map(|pair| pair.2).collect() }
        });
        Self { by_block: by_block.collect(), chunks, borders: Vec::new(), border: 0 }
    }

    /// The pairs of blocks that `items` make meet, for [`BlockStructure::new`].
    pub fn pairs<'a>(items: impl IntoIterator<Item = &'a [u32]>) -> Vec<(usize, usize)> {
        let mut pairs = Vec::new();
        for blocks in items {
            for (p, &j) in blocks.iter().enumerate() {
                pairs.extend(blocks[..p].iter().map(|&k| (j as usize, k as usize)));
            }
        }
        pairs.par_sort_unstable();
        pairs.dedup();
        pairs
    }

    /// Has `fill` write the rows of every item, `count` of them, over a border of `border` coordinates. A `fill` that is marked
    /// `#[inline(always)]` is compiled for the instruction set that the processor has, where fused products are no calls.
    pub fn linearize(
        &mut self,
        border: usize,
        count: impl Fn(usize) -> usize + Sync,
        fill: impl Fn(usize, &mut ItemRows<'_>) + Sync,
    ) {
        struct Closures<C, F>(C, F);
        impl<C: Fn(usize) -> usize + Sync, F: Fn(usize, &mut ItemRows<'_>) + Sync> FillRows for Closures<C, F> {
            type Scratch = ();

            fn count(&self, item: usize) -> usize {
                (self.0)(item)
            }

            #[inline(always)]
            fn fill<S: Simd>(&self, _: S, item: usize, (): &mut (), rows: &mut ItemRows<'_>) {
                rows.u.fill(0.0);
                (self.1)(item, rows);
            }
        }
        self.linearize_by(border, &mut Vec::new(), &Closures(count, fill));
    }

    /// [`linearize`](Self::linearize) with the registers at hand, and memory for each chunk.
    pub(crate) fn linearize_by<R: FillRows>(&mut self, border: usize, scratch: &mut Vec<R::Scratch>, rows: &R) {
        if self.border != border {
            self.borders.clear();
            self.border = border;
        }
        scratch.resize_with(self.chunks.len(), Default::default);
        let group = if border == 0 { 1 } else { BORDER_GROUP };
        self.borders.resize_with(self.chunks.len().div_ceil(group), || BorderSum::new(padded(border)));
        let groups = self.chunks.par_chunks_mut(group).zip(scratch.par_chunks_mut(group));
        groups.zip(&mut self.borders).for_each(|((chunks, scratch), sum)| {
            sum.clear();
            for (chunk, scratch) in chunks.iter_mut().zip(scratch) {
                dispatch(Linearize { chunk, scratch, border, sum: &mut *sum, rows });
            }
        });
    }

    /// Adds what was linearised last to the equations.
    pub fn add_to(&self, equations: &mut NormalEquations) {
        let border = self.border;
        let start = equations.structure().sparse_dimension();
        for sum in self.borders.iter().filter(|_| border > 0) {
            for (r, row) in sum.square.chunks_exact(padded(border)).take(border).enumerate() {
                equations.border[r * border..][..=r].iter_mut().zip(row).for_each(|(h, s)| *h += s);
            }
            equations.gradient[start..].iter_mut().zip(&sum.gradient).for_each(|(g, s)| *g += s);
        }
        let structure = equations.structure().clone();
        equations.for_each_block_row(&|j, row| {
            let of = FillRow { chunks: &self.chunks, items: &self.by_block[j], border, row };
            match structure.size(j) {
                12 => dispatch(Wide::<12>(of)),
                7 => dispatch(Wide::<7>(of)),
                6 => dispatch(Wide::<6>(of)),
                3 => dispatch(Wide::<3>(of)),
                2 => dispatch(Wide::<2>(of)),
                1 => dispatch(Wide::<1>(of)),
                _ => of.any_width(structure.size(j)),
            }
        });
    }
}

impl ItemRows<'_> {
    /// Number of rows.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Derivatives of a row by the `slot`-th block of the item; longer than the block, by zeros that must stay.
    #[inline(always)]
    pub fn of_block(&mut self, slot: usize, row: usize) -> &mut [f64] {
        let Slot { width, offset } = self.slots[slot];
        let pitch = pitch(width as usize);
        &mut self.y[offset as usize * self.count + row * pitch..][..pitch]
    }

    /// Derivatives of a row by the border; the equations take them rounded to f32, so that they must be below 3e38, the gradient as
    /// they are.
    #[inline(always)]
    pub fn of_border(&mut self, row: usize) -> &mut [f64] {
        &mut self.u[row * padded(self.border)..][..self.border]
    }

    /// The residuals, one for each row; more than that are left out.
    ///
    /// # Panics
    /// If there are fewer than rows.
    #[inline(always)]
    pub fn set_residuals(&mut self, residuals: &[f64]) {
        let residuals = &residuals[..self.count];
        for slot in self.slots {
            let width = slot.width as usize;
            let rows = self.y[slot.offset as usize * self.count..].chunks_exact_mut(pitch(width));
            rows.zip(residuals).for_each(|(row, e)| row[width] = *e);
        }
        self.e.copy_from_slice(residuals);
    }
}

/// Without room for more: from step to step there are about as many rows, and they are most of the memory of a solver.
fn resize_exactly<T: Clone + Default>(numbers: &mut Vec<T>, length: usize) {
    numbers.reserve_exact(length.saturating_sub(numbers.len()));
    numbers.resize(length, T::default());
}

struct Linearize<'a, F: FillRows> {
    chunk: &'a mut Chunk,
    scratch: &'a mut F::Scratch,
    border: usize,
    sum: &'a mut BorderSum,
    rows: &'a F,
}

impl<F: FillRows> WithSimd for Linearize<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chunk, scratch, border, sum, rows } = self;
        let items = chunk.slot_starts.len() - 1;
        let (mut count, mut numbers) = (0, 0);
        chunk.row_starts.clear();
        chunk.y_starts.clear();
        for item in 0..items {
            chunk.row_starts.push(count);
            chunk.y_starts.push(numbers);
            let rows = rows.count(chunk.first_item + item) as u32;
            let slots = &chunk.slots[chunk.slot_starts[item] as usize..chunk.slot_starts[item + 1] as usize];
            count += rows;
            numbers += rows * slots.last().map_or(0, |slot| slot.offset + pitch(slot.width as usize) as u32);
        }
        chunk.row_starts.push(count);
        chunk.y_starts.push(numbers);
        let width = padded(border);
        resize_exactly(&mut chunk.y, numbers as usize);
        resize_exactly(&mut chunk.u, count as usize * width);
        let mut u = chunk.u.as_mut_slice();
        for item in 0..items {
            let range = chunk.row_starts[item] as usize..chunk.row_starts[item + 1] as usize;
            if range.is_empty() {
                continue;
            }
            let y = &mut chunk.y[chunk.y_starts[item] as usize..chunk.y_starts[item + 1] as usize];
            y.fill(0.0);
            let slots = &chunk.slots[chunk.slot_starts[item] as usize..chunk.slot_starts[item + 1] as usize];
            if sum.is_full_for(range.len()) {
                u = sum.add_rows(u);
            }
            let (pending, e) = sum.next_rows(range.len());
            let mut item_rows = ItemRows { slots, count: range.len(), border, y, u: pending, e };
            rows.fill(simd, chunk.first_item + item, scratch, &mut item_rows);
        }
        sum.add_rows(u);
    }
}

impl Chunk {
    /// Rows of an item.
    #[inline(always)]
    fn count(&self, item: u32) -> usize {
        (self.row_starts[item as usize + 1] - self.row_starts[item as usize]) as usize
    }

    /// `Y` of an item by a block of this `pitch`, row by row.
    #[inline(always)]
    fn rows(&self, item: u32, offset: u32, pitch: usize) -> impl Iterator<Item = &[f64]> {
        let count = self.count(item);
        let start = self.y_starts[item as usize] as usize + offset as usize * count;
        self.y[start..start + count * pitch].chunks_exact(pitch)
    }
}

/// Adds to a block row the products `Y_j' Y_k`, `Y_j' U` and `Y_j' e` of its items.
struct FillRow<'a> {
    chunks: &'a [Chunk],
    items: &'a BlockItems,
    border: usize,
    row: BlockRow<'a>,
}

/// The same for a block of `W` coordinates.
struct Wide<'a, const W: usize>(FillRow<'a>);

impl<const W: usize> WithSimd for Wide<'_, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let FillRow { chunks, items, border, mut row } = self.0;
        let mut first = 0;
        for run in &items.runs {
            let pairs = &items.pairs[first..run.end as usize];
            first = run.end as usize;
            let width = run.width as usize;
            let block = &mut row.blocks[run.start as usize..][..W * width];
            sweep::<S, W>(simd, pitch(width), &mut BlockTile::<W> { chunks, pairs, width, block });
        }

        let (mut y, mut u): ([&[f64]; BATCH], [&[f32]; BATCH]) = ([&[]; BATCH], [&[]; BATCH]);
        let mut batched = 0;
        let width = padded(border);
        for at in &items.items {
            let chunk = &chunks[at.chunk as usize];
            let u_start = chunk.row_starts[at.item as usize] as usize;
            for (r, own) in chunk.rows(at.item, at.offset, pitch(W)).enumerate() {
                y[batched] = own;
                u[batched] = &chunk.u[(u_start + r) * width..][..width];
                batched += 1;
                if batched == BATCH {
                    multiply::<S, W>(simd, &y, &u, &mut row, border);
                    batched = 0;
                }
            }
        }
        multiply::<S, W>(simd, &y[..batched], &u[..batched], &mut row, border);
    }
}

/// Adds the products of rows of `y` with themselves and with rows of `u`.
#[inline(always)]
fn multiply<S: Simd, const W: usize>(simd: S, y: &[&[f64]], u: &[&[f32]], row: &mut BlockRow<'_>, border: usize) {
    let diagonal = row.blocks.len() - W * W;
    let (block, gradient) = (&mut row.blocks[diagonal..], &mut *row.gradient);
    sweep::<S, W>(simd, pitch(W), &mut DiagonalTile::<W> { y, block, gradient });
    if border > 0 {
        OuterProducts::<W> { left: y, right: u, n: border, out: row.cross }.with_simd(simd);
    }
}

/// `Y_j' Y_k` of a block.
struct BlockTile<'a, const W: usize> {
    chunks: &'a [Chunk],
    pairs: &'a [Pair],
    width: usize,
    block: &'a mut [f64],
}

impl<const W: usize> Tile for BlockTile<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let other_pitch = pitch(self.width);
        let rows = self.pairs.iter().flat_map(|pair| {
            let Place { chunk, item, offset } = pair.own;
            let chunk = &self.chunks[chunk as usize];
            let rows = chunk.rows(item, offset, pitch(W)).zip(chunk.rows(item, pair.other, other_pitch));
            rows.map(|(own, other)| (own, &other[first..]))
        });
        let sum = sum_of_products::<S, _, W, V>(simd, rows);
        for (row, sum) in self.block.chunks_exact_mut(self.width).zip(&sum) {
            add_to(simd, bytemuck::cast_slice(sum), &mut row[first.min(self.width)..]);
        }
    }
}

/// `Y_j' [Y_j e]`: the diagonal block and the gradient.
struct DiagonalTile<'a, const W: usize> {
    y: &'a [&'a [f64]],
    block: &'a mut [f64],
    gradient: &'a mut [f64],
}

impl<const W: usize> Tile for DiagonalTile<'_, W> {
    #[inline(always)]
    fn tile<S: Simd, const V: usize>(&mut self, simd: S, first: usize) {
        let sum = sum_of_products::<S, _, W, V>(simd, self.y.iter().map(|y| (*y, &y[first..])));
        for (t, sum) in sum.iter().enumerate() {
            add_to(simd, bytemuck::cast_slice(sum), &mut self.block[t * W..][..W][first.min(W)..]);
            if (first..first + V * S::F64_LANES).contains(&W) {
                self.gradient[t] += bytemuck::cast_slice::<S::f64s, f64>(sum)[W - first];
            }
        }
    }
}

impl FillRow<'_> {
    /// For blocks of a width that has no kernel of its own.
    fn any_width(self, width: usize) {
        let Self { chunks, items, border, row } = self;
        let mut first = 0;
        for run in &items.runs {
            let (other, block) = (run.width as usize, &mut row.blocks[run.start as usize..]);
            for pair in &items.pairs[first..run.end as usize] {
                let Place { chunk, item, offset } = pair.own;
                let chunk = &chunks[chunk as usize];
                let rows = chunk.rows(item, offset, pitch(width)).zip(chunk.rows(item, pair.other, pitch(other)));
                rows.for_each(|(own, right)| add_outer(&own[..width], &right[..other], block));
            }
            first = run.end as usize;
        }
        let diagonal = row.blocks.len() - width * width;
        for at in &items.items {
            let chunk = &chunks[at.chunk as usize];
            let u_start = chunk.row_starts[at.item as usize] as usize;
            for (r, own) in chunk.rows(at.item, at.offset, pitch(width)).enumerate() {
                add_outer(&own[..width], &own[..width], &mut row.blocks[diagonal..]);
                add_outer(&own[..width], &own[width..=width], row.gradient);
                if border > 0 {
                    add_outer(&own[..width], &chunk.u[(u_start + r) * padded(border)..][..border], row.cross);
                }
            }
        }
    }
}

/// `out += left right'`.
fn add_outer<T: Copy + Into<f64>>(left: &[f64], right: &[T], out: &mut [f64]) {
    for (row, l) in out.chunks_exact_mut(right.len()).zip(left) {
        row.iter_mut().zip(right).for_each(|(sum, r)| *sum = l.mul_add((*r).into(), *sum));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use crate::nlls::linear::{Coordinate, LinearError, choose};

    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Blocks of every kind of width, items of up to four of them, with rows that come and go.
    #[test]
    fn it_is_the_product_of_the_whole_jacobian_with_itself() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let sizes = [6, 3, 12, 1, 2, 7, 4, 6, 9, 3, 6];
        for border in [0, 1, 5, 17] {
            let items: Vec<Vec<u32>> = (0..1500)
                .map(|_| {
                    let mut blocks: Vec<u32> = (0..rng.random_range(1..5)).map(|_| rng.random_range(0..11)).collect();
                    blocks.sort_unstable();
                    blocks.dedup();
                    blocks
                })
                .collect();
            let slices = || items.iter().map(Vec::as_slice);
            let structure = Arc::new(BlockStructure::new(&sizes, Assembly::pairs(slices()), border).unwrap());
            let mut assembly = Assembly::new(slices(), &structure, |_| 3);
            for round in 0..2 {
                let counts: Vec<usize> = items.iter().map(|_| rng.random_range(0..4)).collect();
                let total: usize = counts.iter().sum();
                let n = structure.dimension();
                let jacobian = DMatrix::from_fn(total, n, |_, _| rng.random_range(-1.0..1.0));
                let residuals = DVector::from_fn(total, |_, _| rng.random_range(-1.0..1.0));
                let starts: Vec<usize> = counts
                    .iter()
                    .scan(0, |s, c| {
                        *s += c;
                        Some(*s - c)
                    })
                    .collect();
                let mut dense = DMatrix::zeros(total, n);
                for (i, blocks) in items.iter().enumerate() {
                    for r in starts[i]..starts[i] + counts[i] {
                        let columns = blocks.iter().flat_map(|&b| {
                            let first = structure.offset(b as usize);
                            first..first + structure.size(b as usize)
                        });
                        for c in columns.chain(structure.sparse_dimension()..n) {
                            dense[(r, c)] = jacobian[(r, c)];
                        }
                    }
                }
                assembly.linearize(
                    border,
                    |i| counts[i],
                    |i, rows| {
                        for r in 0..counts[i] {
                            for (slot, &b) in items[i].iter().enumerate() {
                                let first = structure.offset(b as usize);
                                for t in 0..structure.size(b as usize) {
                                    rows.of_block(slot, r)[t] = jacobian[(starts[i] + r, first + t)];
                                }
                            }
                            for w in 0..border {
                                rows.of_border(r)[w] = jacobian[(starts[i] + r, structure.sparse_dimension() + w)];
                            }
                        }
                        let own: Vec<f64> = (0..counts[i]).map(|r| residuals[starts[i] + r]).collect();
                        rows.set_residuals(&own);
                    },
                );
                let mut equations = NormalEquations::new(structure.clone());
                assembly.add_to(&mut equations);
                let g = dense.transpose() * &residuals;
                dense.columns_mut(structure.sparse_dimension(), border).apply(|u| *u = f64::from(*u as f32));
                let h = dense.transpose() * &dense;
                assert!((equations.to_dense() - h).amax() < 1e-11, "border {border}, round {round}");
                let gradient = DVector::from_column_slice(&equations.gradient);
                assert!((gradient - g).amax() < 1e-11, "border {border}, round {round}");
            }
        }
    }

    #[test]
    fn a_derivative_beyond_single_precision_is_that_of_the_border() {
        let items = [vec![0]];
        let structure = Arc::new(BlockStructure::new(&[1], [], 2).unwrap());
        let mut assembly = Assembly::new(items.iter().map(Vec::as_slice), &structure, |_| 1);
        let mut solve = |derivative: f64| {
            assembly.linearize(
                2,
                |_| 1,
                |_, rows| {
                    rows.of_block(0, 0)[0] = 1.0;
                    rows.of_border(0).copy_from_slice(&[1.0, derivative]);
                    rows.set_residuals(&[1.0]);
                },
            );
            let mut equations = NormalEquations::new(structure.clone());
            assembly.add_to(&mut equations);
            choose(&structure).solve(&equations, &[1.0; 3], &mut [0.0; 3])
        };
        solve(1e10).unwrap();
        let error = solve(1e39).unwrap_err();
        assert_eq!(error, LinearError::NonFinite { at: Coordinate::Border { index: 1 } });
        assert!(error.to_string().contains("beyond 3e38"), "{error}");
    }
}
