//! A bounding volume hierarchy in a flat array (binned surface-area heuristic, Wald 2007), eight boxes to a node so that
//! registers test them together (Wald, Benthin & Boulos 2008), searched nearest box first: from a point, or along a line.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::Point;

/// Primitives in a leaf at most.
const LEAF: usize = 4;
const BINS: usize = 16;
/// From here on, halves instead of the heuristic: bounds the depth, and with it the stack of a search.
const HALVES_FROM_DEPTH: usize = 40;
/// Entries that the stack of a search has without asking for memory.
const STACK: usize = 96;
/// Children of a node.
const WIDTH: usize = 8;
/// Primitives from which on both halves are built at once.
const SIDE_BY_SIDE: usize = 4096;
/// Slots of a child that is not there.
const EMPTY: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub low: Point,
    pub high: Point,
}

impl Bounds {
    pub const EMPTY: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    pub fn include(&mut self, other: &Self) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
        }
    }

    /// Whether they have a point in common.
    pub fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.low[axis] <= other.high[axis] && self.high[axis] >= other.low[axis])
    }
}

/// A box of the tree, rounded outwards; the fourth coordinate is there for the registers.
#[derive(Debug, Clone, Copy)]
struct Rounded {
    low: [f32; 4],
    high: [f32; 4],
}

impl Rounded {
    const EMPTY: Self = Self { low: [f32::INFINITY; 4], high: [f32::NEG_INFINITY; 4] };

    fn new(bounds: &Bounds) -> Self {
        let ([a, b, c], [d, e, f]) = (bounds.low.map(below), bounds.high.map(above));
        Self { low: [a, b, c, 0.0], high: [d, e, f, 0.0] }
    }

    fn include(&mut self, other: &Self) {
        for axis in 0..4 {
            self.low[axis] = least(self.low[axis], other.low[axis]);
            self.high[axis] = greatest(self.high[axis], other.high[axis]);
        }
    }

    fn half_area(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| (self.high[axis] - self.low[axis]).max(0.0));
        x * y + y * z + z * x
    }

    fn center(&self) -> [f32; 4] {
        std::array::from_fn(|axis| 0.5 * self.low[axis] + 0.5 * self.high[axis])
    }
}

/// The box round some boxes, and that round their centres.
#[derive(Debug, Clone, Copy)]
struct Extent {
    boxes: Rounded,
    centers: Rounded,
}

impl Extent {
    const EMPTY: Self = Self { boxes: Rounded::EMPTY, centers: Rounded::EMPTY };

    fn of(items: &[Item]) -> Self {
        let mut extent = Self::EMPTY;
        items.iter().for_each(|item| extent.add(&item.0));
        extent
    }

    fn add(&mut self, bounds: &Rounded) {
        let center = bounds.center();
        self.include(&Self { boxes: *bounds, centers: Rounded { low: center, high: center } });
    }

    fn include(&mut self, other: &Self) {
        self.boxes.include(&other.boxes);
        self.centers.include(&other.centers);
    }
}

// One instruction each, where the standard library's take care of NaN.

fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

fn greatest(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// One child of a node: its box and what it is.
#[derive(Debug, Clone, Copy)]
struct Child {
    bounds: Rounded,
    /// First slot of a leaf, or index of a node.
    first: u32,
    /// Slots in a leaf, 0 for a node.
    count: u32,
}

impl Child {
    const NONE: Self = Self { bounds: Rounded { low: [f32::MAX; 4], high: [f32::MAX; 4] }, first: 0, count: EMPTY };

    fn new(bounds: &Rounded, first: usize, count: usize) -> Self {
        Self { bounds: *bounds, first: first as u32, count: count as u32 }
    }
}

/// Children side by side.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
    first: [u32; WIDTH],
    count: [u32; WIDTH],
}

impl Node {
    fn new(children: &[Child]) -> Self {
        let child = |i: usize| children.get(i).unwrap_or(&Child::NONE);
        Self {
            low: std::array::from_fn(|axis| std::array::from_fn(|i| child(i).bounds.low[axis])),
            high: std::array::from_fn(|axis| std::array::from_fn(|i| child(i).bounds.high[axis])),
            first: std::array::from_fn(|i| child(i).first),
            count: std::array::from_fn(|i| child(i).count),
        }
    }
}

impl Node {
    /// The box round all children.
    fn hull(&self) -> ([f32; 3], [f32; 3]) {
        let there = |i: &usize| self.count[*i] != EMPTY;
        let low = self.low.map(|side| (0..WIDTH).filter(there).fold(f32::INFINITY, |low, i| low.min(side[i])));
        let high = self.high.map(|side| (0..WIDTH).filter(there).fold(f32::NEG_INFINITY, |high, i| high.max(side[i])));
        (low, high)
    }
}

/// The largest `f32` not above `x`.
fn below(x: f64) -> f32 {
    let rounded = x as f32;
    if f64::from(rounded) > x { rounded.next_down() } else { rounded }
}

/// The smallest `f32` not below `x`.
fn above(x: f64) -> f32 {
    -below(-x)
}

/// Boxes of boxes; knows nothing of what lies in them.
#[derive(Debug, Clone, Default)]
pub(super) struct BoxTree {
    /// The root first.
    nodes: Vec<Node>,
    /// Primitive in every slot.
    pub order: Vec<u32>,
    /// Entries that the stack of a search may need.
    stack: usize,
}

/// What a search has found so far: the lexicographically least (squared distance, primitive).
#[derive(Clone, Copy)]
pub(super) struct Best {
    pub squared_distance: f64,
    pub primitive: u32,
}

impl Best {
    #[inline(always)]
    pub fn beaten_by(&self, squared_distance: f64, primitive: u32) -> bool {
        squared_distance < self.squared_distance
            || (squared_distance == self.squared_distance && primitive < self.primitive)
    }
}

impl BoxTree {
    pub fn build(boxes: impl ExactSizeIterator<Item = Bounds>) -> Self {
        // Boxes move with their numbers: a million of them are more than the caches hold, and every level reads all.
        let mut items: Vec<Item> = boxes.map(|bounds| Rounded::new(&bounds)).zip(0..).collect();
        let mut tree = Self::default();
        if !items.is_empty() {
            let mut pairs = Vec::with_capacity(items.len() / 2 + 1);
            let all = Extent::of(&items);
            let root = halve(&mut items, 0, &all, 0, &mut pairs);
            tree.widen(&[root], &pairs, 1);
            // Of memory of its own: `into_iter` would collect into that of the boxes, nine times as much.
            tree.order = items.iter().map(|item| item.1).collect();
            tree.nodes.shrink_to_fit();
        }
        tree
    }

    /// Adds the node of some children, each pair of which is opened as long as there is room, the largest first.
    fn widen(&mut self, children: &[Child], pairs: &[[Child; 2]], depth: usize) -> u32 {
        let mut children = children.to_vec();
        while children.len() < WIDTH {
            let inner = children.iter().enumerate().filter(|(_, child)| child.count == 0);
            let Some((largest, _)) = inner.max_by(|a, b| a.1.bounds.half_area().total_cmp(&b.1.bounds.half_area()))
            else {
                break;
            };
            let opened = children.swap_remove(largest);
            children.extend(pairs[opened.first as usize]);
        }
        let index = self.nodes.len();
        self.nodes.push(Node::new(&children));
        self.stack = self.stack.max(depth * WIDTH);
        for (i, child) in children.iter().enumerate().filter(|(_, child)| child.count == 0) {
            self.nodes[index].first[i] = self.widen(&pairs[child.first as usize], pairs, depth + 1);
        }
        index as u32
    }

    /// Fits the boxes to what has moved, `bounds` by slot, in one pass. Searches stay exact.
    pub fn refit(&mut self, bounds: impl Fn(usize) -> Bounds) {
        // A node comes after its parent.
        for index in (0..self.nodes.len()).rev() {
            for i in 0..WIDTH {
                let (first, count) = (self.nodes[index].first[i] as usize, self.nodes[index].count[i]);
                let (low, high) = match count {
                    EMPTY => continue,
                    0 => self.nodes[first].hull(),
                    _ => {
                        let mut all = Bounds::EMPTY;
                        (first..first + count as usize).for_each(|slot| all.include(&bounds(slot)));
                        (all.low.map(below), all.high.map(above))
                    }
                };
                let node = &mut self.nodes[index];
                for axis in 0..3 {
                    (node.low[axis][i], node.high[axis][i]) = (low[axis], high[axis]);
                }
            }
        }
    }

    /// Visits the leaves that may hold something at least as good as `best`, nearest first.
    #[inline(always)]
    pub fn search(&self, query: impl Query, best: &mut Best, leaf: impl FnMut(Range<usize>, &mut Best)) {
        Arch::new().dispatch(Search { tree: self, query, best, leaf });
    }

    /// Visits the leaves whose box meets `query`, both closed and rounded outwards.
    pub fn meeting(&self, query: &Bounds, mut leaf: impl FnMut(Range<usize>)) {
        let query = Rounded::new(query);
        let (mut short, mut long) = ([0u32; STACK], Vec::new());
        let stack = if self.stack <= STACK { &mut short[..] } else { with_length(&mut long, self.stack) };
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            let mut meets = [true; WIDTH];
            for axis in 0..3 {
                for (i, meets) in meets.iter_mut().enumerate() {
                    // no branch: registers compare them together
                    *meets &= (node.low[axis][i] <= query.high[axis]) & (node.high[axis][i] >= query.low[axis]);
                }
            }
            for (i, meets) in meets.into_iter().enumerate() {
                let (first, count) = (node.first[i], node.count[i]);
                if !meets || count == EMPTY {
                    continue;
                }
                if count > 0 {
                    leaf(first as usize..(first + count) as usize);
                } else {
                    stack[height] = first;
                    height += 1;
                }
            }
        }
    }
}

fn with_length<T: Default + Clone>(memory: &mut Vec<T>, length: usize) -> &mut [T] {
    memory.resize(length, T::default());
    memory
}

/// What waits on the stack of a search: a child, and the squared distance of its box.
#[derive(Clone, Copy, Default)]
struct Waiting {
    squared_distance: f64,
    first: u32,
    count: u32,
}

/// What is searched from.
pub(super) trait Query {
    /// For each child, a squared distance that nothing in its box is below; infinite if nothing in it can be found at all.
    fn squared_distances(&self, low: &[[f32; WIDTH]; 3], high: &[[f32; WIDTH]; 3]) -> [f64; WIDTH];
}

/// From a point, to a box.
impl Query for Point {
    #[inline(always)]
    fn squared_distances(&self, low: &[[f32; WIDTH]; 3], high: &[[f32; WIDTH]; 3]) -> [f64; WIDTH] {
        let mut squared = [0.0f64; WIDTH];
        for axis in 0..3 {
            for i in 0..WIDTH {
                let under = f64::from(low[axis][i]) - self[axis];
                let over = self[axis] - f64::from(high[axis][i]);
                let outside = if under > over { under } else { over };
                let outside = if outside > 0.0 { outside } else { 0.0 };
                squared[i] += outside * outside;
            }
        }
        squared
    }
}

/// From a point along a line through it, either way, to where it enters a box.
#[derive(Clone, Copy)]
pub(super) struct Line {
    pub origin: Point,
    /// One over each coordinate of the unit direction.
    inverse: Point,
}

impl Line {
    pub fn new(origin: Point, direction: Point) -> Self {
        // a coordinate of 0 would make 0 times infinity of a box that begins at the origin
        let inverse = direction.map(|d| 1.0 / if d.abs() < 1e-150 { 1e-150 } else { d });
        Self { origin, inverse }
    }
}

impl Query for Line {
    #[inline(always)]
    fn squared_distances(&self, low: &[[f32; WIDTH]; 3], high: &[[f32; WIDTH]; 3]) -> [f64; WIDTH] {
        // a line that runs in a side of the box is inside of it, and triangles are met a little beyond their borders
        const MARGIN: f64 = 1e-6;
        let (mut enter, mut leave) = ([f64::NEG_INFINITY; WIDTH], [f64::INFINITY; WIDTH]);
        for axis in 0..3 {
            for i in 0..WIDTH {
                let a = (f64::from(low[axis][i]) - MARGIN - self.origin[axis]) * self.inverse[axis];
                let b = (f64::from(high[axis][i]) + MARGIN - self.origin[axis]) * self.inverse[axis];
                let (first, last) = if a < b { (a, b) } else { (b, a) };
                enter[i] = if first > enter[i] { first } else { enter[i] };
                leave[i] = if last < leave[i] { last } else { leave[i] };
            }
        }
        let mut squared = [0.0f64; WIDTH];
        for i in 0..WIDTH {
            // rounding may part what touches
            let slack = 1e-9 * (1.0 + enter[i].abs() + leave[i].abs());
            let near = if enter[i] > -leave[i] { enter[i] } else { -leave[i] } - slack;
            let near = if near > 0.0 { near } else { 0.0 };
            squared[i] = if enter[i] <= leave[i] + slack { near * near } else { f64::INFINITY };
        }
        squared
    }
}

/// [`BoxTree::search`], compiled for the best instruction set that the processor has.
struct Search<'a, Q, F> {
    tree: &'a BoxTree,
    query: Q,
    best: &'a mut Best,
    leaf: F,
}

impl<Q: Query, F: FnMut(Range<usize>, &mut Best)> WithSimd for Search<'_, Q, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { tree, query, best, mut leaf } = self;
        let (mut short, mut long) = ([Waiting::default(); STACK], Vec::new());
        let stack = if tree.stack <= STACK { &mut short[..] } else { with_length(&mut long, tree.stack) };
        // Slot 0 holds the root, if there is one.
        let mut height = usize::from(!tree.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let Waiting { squared_distance, first, count } = stack[height];
            if squared_distance > best.squared_distance {
                continue;
            }
            if count > 0 {
                leaf(first as usize..(first + count) as usize, best);
                continue;
            }
            let node = &tree.nodes[first as usize];
            let squared = query.squared_distances(&node.low, &node.high);
            let mut near = 0u32;
            for i in 0..WIDTH {
                near |= u32::from(squared[i] <= best.squared_distance && node.count[i] != EMPTY) << i;
            }
            // The nearest on top.
            let bottom = height;
            while near != 0 {
                let i = near.trailing_zeros() as usize;
                near &= near - 1;
                let new = Waiting { squared_distance: squared[i], first: node.first[i], count: node.count[i] };
                let mut at = height;
                while at > bottom && stack[at - 1].squared_distance < new.squared_distance {
                    stack[at] = stack[at - 1];
                    at -= 1;
                }
                stack[at] = new;
                height += 1;
            }
        }
    }
}

/// A box, and the number of what lies in it.
type Item = (Rounded, u32);

/// The child that holds `items`, slots from `first` on, of that extent: a leaf, or one of `pairs`.
fn halve(items: &mut [Item], first: usize, extent: &Extent, depth: usize, pairs: &mut Vec<[Child; 2]>) -> Child {
    if items.len() <= LEAF {
        return Child::new(&extent.boxes, first, items.len());
    }
    let side_by_side = items.len() >= SIDE_BY_SIDE;
    let (middle, left, right) = split(items, &extent.centers, depth);
    let index = pairs.len();
    pairs.push([Child::NONE; 2]);
    let (low, high) = items.split_at_mut(middle);
    pairs[index] = if side_by_side {
        let half = |items, first, extent| {
            let mut pairs = Vec::new();
            (halve(items, first, extent, depth + 1, &mut pairs), pairs)
        };
        let (low, high) = rayon::join(|| half(low, first, &left), || half(high, first + middle, &right));
        [low, high].map(|(mut child, of_half)| {
            let before = pairs.len() as u32;
            let moved = |child: &mut Child| child.first += if child.count == 0 { before } else { 0 };
            pairs.extend(of_half);
            pairs[before as usize..].iter_mut().flatten().for_each(moved);
            moved(&mut child);
            child
        })
    } else {
        let low = halve(low, first, &left, depth + 1, pairs);
        [low, halve(high, first + middle, &right, depth + 1, pairs)]
    };
    Child::new(&extent.boxes, index, 0)
}

/// Reorders `items`, whose centres lie in that box, into two parts; returns the size of the first and the extents of both. Neither
/// part is empty.
fn split(items: &mut [Item], centers: &Rounded, depth: usize) -> (usize, Extent, Extent) {
    let extent = [0, 1, 2].map(|axis| centers.high[axis] - centers.low[axis]);
    let axis = (0..3).fold(0, |widest, axis| if extent[axis] > extent[widest] { axis } else { widest });
    let (low, scale) = (centers.low[axis], BINS as f32 / extent[axis]);
    if depth < HALVES_FROM_DEPTH && scale.is_finite() && scale > 0.0 {
        let bin = |item: &Item| (((item.0.center()[axis] - low) * scale) as usize).min(BINS - 1);
        let mut bins = [(Extent::EMPTY, 0usize); BINS];
        for item in items.iter() {
            let (extent, count) = &mut bins[bin(item)];
            extent.add(&item.0);
            *count += 1;
        }
        // cost of the part from bin b on, for every cut b
        let mut after = [f32::INFINITY; BINS];
        let (mut bounds, mut count) = (bins[BINS - 1].0.boxes, bins[BINS - 1].1);
        for b in (1..BINS).rev() {
            after[b] = bounds.half_area() * count as f32;
            bounds.include(&bins[b - 1].0.boxes);
            count += bins[b - 1].1;
        }
        let (mut bounds, mut count) = (Rounded::EMPTY, 0);
        let mut best = (f32::INFINITY, 0);
        for b in 1..BINS {
            bounds.include(&bins[b - 1].0.boxes);
            count += bins[b - 1].1;
            let cost = bounds.half_area() * count as f32 + after[b];
            if count > 0 && count < items.len() && cost < best.0 {
                best = (cost, b);
            }
        }
        if best.1 > 0 {
            let mut middle = 0;
            for i in 0..items.len() {
                if bin(&items[i]) < best.1 {
                    items.swap(i, middle);
                    middle += 1;
                }
            }
            let (mut left, mut right) = (Extent::EMPTY, Extent::EMPTY);
            bins[..best.1].iter().for_each(|(extent, _)| left.include(extent));
            bins[best.1..].iter().for_each(|(extent, _)| right.include(extent));
            return (middle, left, right);
        }
    }
    let middle = items.len() / 2;
    let by_center = |a: &Item, b: &Item| a.0.center()[axis].total_cmp(&b.0.center()[axis]).then(a.1.cmp(&b.1));
    items.select_nth_unstable_by(middle, by_center);
    (middle, Extent::of(&items[..middle]), Extent::of(&items[middle..]))
}
