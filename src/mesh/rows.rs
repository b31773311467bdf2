//! Rows of items one after the other in one list: neighbours of vertices, influences, corners of samples.

use std::ops::Range;

/// Row `i` is `items[starts[i]..starts[i + 1]]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rows<T = u32> {
    starts: Vec<u32>,
    items: Vec<T>,
}

impl<T> Default for Rows<T> {
    fn default() -> Self {
        Self { starts: vec![0], items: Vec::new() }
    }
}

impl<T, R: IntoIterator<Item = T>> FromIterator<R> for Rows<T> {
    fn from_iter<I: IntoIterator<Item = R>>(rows: I) -> Self {
        let rows = rows.into_iter();
        let mut all = Self::default();
        all.starts.reserve(rows.size_hint().0);
        rows.for_each(|row| all.push(row));
        all
    }
}

impl<T: Copy + Default> Rows<T> {
    /// Counting sort of `(row, item)` pairs; items keep their order within a row.
    pub(crate) fn sorted(rows: usize, pairs: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut starts = vec![0u32; rows + 1];
        for (row, _) in pairs.clone() {
            starts[row as usize + 1] += 1;
        }
        for i in 0..rows {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut items = vec![T::default(); starts[rows] as usize];
        for (row, item) in pairs {
            items[next[row as usize] as usize] = item;
            next[row as usize] += 1;
        }
        Self { starts, items }
    }
}

impl<T> Rows<T> {
    /// Adds a row.
    pub(crate) fn push(&mut self, row: impl IntoIterator<Item = T>) {
        self.items.extend(row);
        self.starts.push(self.items.len() as u32);
    }

    /// Row `i`.
    #[must_use]
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[T] {
        &self.items[self.range(i)]
    }

    /// Row `i`, to be changed.
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [T] {
        let range = self.range(i);
        &mut self.items[range]
    }

    /// Where row `i` lies in [`Self::items`].
    #[must_use]
    #[inline(always)]
    pub fn range(&self, i: usize) -> Range<usize> {
        self.starts[i] as usize..self.starts[i + 1] as usize
    }

    /// The rows in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[T]> + Clone {
        self.starts.windows(2).map(|s| &self.items[s[0] as usize..s[1] as usize])
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// No rows at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All rows, one after the other.
    #[must_use]
    pub fn items(&self) -> &[T] {
        &self.items
    }

    /// The same, to keep.
    pub(crate) fn into_items(self) -> Vec<T> {
        self.items
    }

    /// Calls `fill(i, what belongs to row i)` for every row, in parallel; `of_items` has a place for each item.
    pub(crate) fn fill<U: Send>(&self, of_items: &mut [U], fill: impl Fn(usize, &mut [U]) + Sync) {
        split(&self.starts, 0, of_items, &fill);
    }
}

/// Rows that one task fills.
const CHUNK: usize = 512;

fn split<U: Send>(starts: &[u32], first: usize, of_items: &mut [U], fill: &(impl Fn(usize, &mut [U]) + Sync)) {
    let count = starts.len() - 1;
    if count <= CHUNK {
        let mut rest = of_items;
        for (k, row) in starts.windows(2).enumerate() {
            let (own, others) = rest.split_at_mut((row[1] - row[0]) as usize);
            fill(first + k, own);
            rest = others;
        }
        return;
    }
    let middle = count / 2;
    let (left, right) = of_items.split_at_mut((starts[middle] - starts[0]) as usize);
    rayon::join(
        || split(&starts[..=middle], first, left, fill),
        || split(&starts[middle..], first + middle, right, fill),
    );
}
