//! Which parameter blocks exist and which of them meet: the sparsity of the normal equations.

use thiserror::Error;

/// Why a sparsity pattern could not be built.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum StructureError {
    /// A pair names a block that does not exist.
    #[error("block pair ({row}, {col}) lies outside the {blocks} blocks of the problem")]
    PairOutOfRange {
        /// First block of the pair.
        row: usize,
        /// Second block of the pair.
        col: usize,
        /// Number of blocks.
        blocks: usize,
    },
}

/// The tangent space of a problem, split into small sparse blocks followed by one dense border.
///
/// ```text
///            blocks 0..n        border
///         [ H_gg (block sparse)  H_gw ]
///         [ H_gw'                H_ww ]
/// ```
///
/// `H_gg` is symmetric; its lower triangle is stored by block rows, columns ascending, the diagonal block last. Blocks are
/// dense and row-major. The pattern is fixed when the problem is built; later linearisations only refill the values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockStructure {
    offsets: Vec<usize>,
    border: usize,
    row_starts: Vec<usize>,
    cols: Vec<usize>,
    value_starts: Vec<usize>,
}

impl BlockStructure {
    /// Builds the pattern of blocks with the given tangent `sizes` that meet in `pairs` (any order, repetitions allowed;
    /// diagonal blocks are always present), bordered by `border` dense parameters.
    pub fn new(
        sizes: &[usize],
        pairs: impl IntoIterator<Item = (usize, usize)>,
        border: usize,
    ) -> Result<Self, StructureError> {
        let n = sizes.len();
        let mut rows: Vec<Vec<usize>> = (0..n).map(|i| vec![i]).collect();
        for (a, b) in pairs {
            if a >= n || b >= n {
                return Err(StructureError::PairOutOfRange { row: a, col: b, blocks: n });
            }
            rows[a.max(b)].push(a.min(b));
        }
        let mut offsets = vec![0];
        for &s in sizes {
            offsets.push(offsets[offsets.len() - 1] + s);
        }
        let (mut row_starts, mut cols, mut value_starts) = (vec![0], Vec::new(), vec![0]);
        let mut values = 0;
        for (i, mut row) in rows.into_iter().enumerate() {
            row.sort_unstable();
            row.dedup();
            for j in row {
                cols.push(j);
                values += sizes[i] * sizes[j];
                value_starts.push(values);
            }
            row_starts.push(cols.len());
        }
        Ok(Self { offsets, border, row_starts, cols, value_starts })
    }

    /// A purely dense problem: no sparse blocks, `dimension` border parameters.
    #[must_use]
    pub fn dense(dimension: usize) -> Self {
        Self { offsets: vec![0], border: dimension, row_starts: vec![0], cols: Vec::new(), value_starts: vec![0] }
    }

    /// Number of sparse blocks.
    #[must_use]
    pub fn block_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Tangent dimension of block `i`.
    #[must_use]
    pub fn size(&self, i: usize) -> usize {
        self.offsets[i + 1] - self.offsets[i]
    }

    /// First tangent coordinate of block `i`; `offset(block_count())` is where the border starts.
    #[must_use]
    pub fn offset(&self, i: usize) -> usize {
        self.offsets[i]
    }

    /// Tangent coordinates of all sparse blocks together.
    #[must_use]
    pub fn sparse_dimension(&self) -> usize {
        self.offsets[self.block_count()]
    }

    /// Number of border parameters.
    #[must_use]
    pub fn border(&self) -> usize {
        self.border
    }

    /// Tangent coordinates altogether: sparse blocks, then the border.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.sparse_dimension() + self.border
    }

    /// Block columns of block row `i` in the lower triangle, ascending, the diagonal `i` last.
    #[must_use]
    pub fn row(&self, i: usize) -> &[usize] {
        &self.cols[self.row_starts[i]..self.row_starts[i + 1]]
    }

    /// Number of stored blocks in the lower triangle, diagonals included.
    #[must_use]
    pub fn slot_count(&self) -> usize {
        self.cols.len()
    }

    /// Storage slots of block row `i`, in the order of [`row`](Self::row).
    #[must_use]
    pub fn row_slots(&self, i: usize) -> std::ops::Range<usize> {
        self.row_starts[i]..self.row_starts[i + 1]
    }

    /// Storage slot of block (`i`, `j`) with `i >= j`, if the two meet.
    #[must_use]
    pub fn slot(&self, i: usize, j: usize) -> Option<usize> {
        self.row(i).binary_search(&j).ok().map(|k| self.row_starts[i] + k)
    }

    /// Where the values of a slot lie in [`NormalEquations::blocks`](super::NormalEquations::blocks).
    #[must_use]
    pub fn values(&self, slot: usize) -> std::ops::Range<usize> {
        self.value_starts[slot]..self.value_starts[slot + 1]
    }

    /// Where the values of block row `i` lie; rows are contiguous.
    #[must_use]
    pub fn row_values(&self, i: usize) -> std::ops::Range<usize> {
        self.value_starts[self.row_starts[i]]..self.value_starts[self.row_starts[i + 1]]
    }

    /// Number of stored values of the lower triangle.
    #[must_use]
    pub fn value_count(&self) -> usize {
        self.value_starts[self.cols.len()]
    }
}
