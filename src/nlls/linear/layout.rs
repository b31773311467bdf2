//! Where the values of a supernodal factor lie.

use std::ops::Range;

use faer::sparse::linalg::cholesky::supernodal;

use crate::nlls::dense_kernels::{PAD, padded};

/// The supernodes of a factor and where their values lie.
#[derive(Debug)]
pub(super) struct Layout {
    pub supernodes: Vec<SupernodeLayout>,
    patterns: Vec<usize>,
    /// The supernode of each column.
    pub owner: Vec<usize>,
    /// Numbers in all, with [`PAD`] more at the end.
    pub len: usize,
}

/// One supernode of a [`Layout`].
#[derive(Debug)]
pub(super) struct SupernodeLayout {
    /// First column, in permuted order.
    pub start: usize,
    /// Number of columns.
    pub width: usize,
    /// Where its values start.
    pub values: usize,
    /// Distance between its columns.
    pub stride: usize,
    pub pattern: Range<usize>,
}

impl Layout {
    pub fn new(symbolic: &supernodal::SymbolicSupernodalCholesky<usize>) -> Self {
        let ends = symbolic.supernode_end();
        let mut layout = Self {
            supernodes: Vec::new(),
            patterns: Vec::new(),
            owner: vec![0; ends.last().map_or(0, |&n| n)],
            len: 0,
        };
        for (k, (&start, &end)) in symbolic.supernode_begin().iter().zip(ends).enumerate() {
            let first = layout.patterns.len();
            layout.patterns.extend_from_slice(symbolic.supernode(k).pattern());
            let pattern = first..layout.patterns.len();
            let (width, values) = (end - start, layout.len);
            let stride = padded(width + pattern.len());
            layout.owner[start..end].fill(k);
            layout.len += width * stride;
            layout.supernodes.push(SupernodeLayout { start, width, values, stride, pattern });
        }
        layout.len += PAD;
        layout
    }

    /// Rows below the triangle of supernode `k`, ascending, in permuted order.
    pub fn pattern(&self, k: usize) -> &[usize] {
        &self.patterns[self.supernodes[k].pattern.clone()]
    }

    /// The row of supernode `k` that is row `row` of the matrix, in permuted order.
    pub fn local_row(&self, k: usize, row: usize) -> usize {
        let node = &self.supernodes[k];
        if row < node.start + node.width {
            row - node.start
        } else {
            node.width
                + self.pattern(k).binary_search(&row).expect("proven: the factor has the rows that are asked for")
        }
    }
}
