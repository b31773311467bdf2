//! The exact closest point on a triangle mesh, and the closest vertices of a point cloud.
//!
//! A bounding volume hierarchy in a flat array (binned surface-area heuristic, Wald 2007), eight boxes to a node so that
//! registers test them together (Wald, Benthin & Boulos 2008), searched nearest box first.
//!
//! **Conventions.** Millimetres; squared distances in square millimetres. Winding does not matter. Barycentric
//! coordinates belong to the triangle's corners in their order, are not negative and sum to 1 up to rounding. Triangles
//! without area are the segments or points that they have become.
//!
//! **Ties** go to the lowest triangle or vertex index, and the answer is the same to the last bit whatever bound or hint
//! a query starts from. That holds because the distance to a triangle is, in floating point and not just in theory, at
//! least the distance to every box round it: both are sums of squares of differences to the query, and rounding is
//! monotone. So a box is skipped only if nothing in it can win or tie.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::{MeshError, TriangleMesh, Vec3};

/// Primitives in a leaf at most.
const LEAF: usize = 4;
const BINS: usize = 16;
/// From here on, halves instead of the heuristic: bounds the depth, and with it the stack of a search.
const HALVES_FROM_DEPTH: usize = 40;
/// Entries that the stack of a search has without asking for memory.
const STACK: usize = 96;
/// Children of a node.
const WIDTH: usize = 8;
/// Slots of a child that is not there.
const EMPTY: u32 = u32::MAX;

/// The closest point of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its corners.
    pub barycentric: [f64; 3],
    /// The point, millimetres.
    pub point: Vec3,
    /// Squared distance to the query, square millimetres.
    pub squared_distance: f64,
}

/// The closest vertex of a point cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestVertex {
    /// Index of the vertex.
    pub vertex: u32,
    /// Squared distance to the query, square millimetres.
    pub squared_distance: f64,
}

type Point = [f64; 3];

#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Point,
    high: Point,
}

impl Bounds {
    const EMPTY: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    fn include(&mut self, other: &Self) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
        }
    }

    fn half_area(&self) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|axis| (self.high[axis] - self.low[axis]).max(0.0));
        x * y + y * z + z * x
    }

    fn center(&self, axis: usize) -> f64 {
        0.5 * self.low[axis] + 0.5 * self.high[axis]
    }
}

/// One child of a node: its box, rounded outwards, and what it is.
#[derive(Debug, Clone, Copy)]
struct Child {
    low: [f32; 3],
    high: [f32; 3],
    /// First slot of a leaf, or index of a node.
    first: u32,
    /// Slots in a leaf, 0 for a node.
    count: u32,
}

impl Child {
    const NONE: Self = Self { low: [f32::MAX; 3], high: [f32::MAX; 3], first: 0, count: EMPTY };

    fn new(bounds: &Bounds, first: usize, count: usize) -> Self {
        let (first, count) = (first as u32, count as u32);
        Self { low: bounds.low.map(below), high: bounds.high.map(above), first, count }
    }

    fn half_area(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| self.high[axis] - self.low[axis]);
        x * y + y * z + z * x
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
            low: std::array::from_fn(|axis| std::array::from_fn(|i| child(i).low[axis])),
            high: std::array::from_fn(|axis| std::array::from_fn(|i| child(i).high[axis])),
            first: std::array::from_fn(|i| child(i).first),
            count: std::array::from_fn(|i| child(i).count),
        }
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
struct BoxTree {
    /// The root first.
    nodes: Vec<Node>,
    /// Primitive in every slot.
    order: Vec<u32>,
    /// Entries that the stack of a search may need.
    stack: usize,
}

/// What a search has found so far: the lexicographically least (squared distance, primitive).
#[derive(Clone, Copy)]
struct Best {
    squared_distance: f64,
    primitive: u32,
}

impl Best {
    #[inline(always)]
    fn beaten_by(&self, squared_distance: f64, primitive: u32) -> bool {
        squared_distance < self.squared_distance
            || (squared_distance == self.squared_distance && primitive < self.primitive)
    }
}

impl BoxTree {
    fn build(boxes: impl ExactSizeIterator<Item = Bounds>) -> Self {
        // Boxes move with their numbers: a million of them are more than the caches hold, and every level reads all.
        let mut items: Vec<Item> = boxes.zip(0..).collect();
        let mut tree = Self::default();
        if !items.is_empty() {
            let mut pairs = Vec::with_capacity(items.len() / 2 + 1);
            let all = bounds_of(&items);
            let root = halve(&mut items, 0, &all, 0, &mut pairs);
            tree.widen(&[root], &pairs, 1);
            tree.order = items.into_iter().map(|item| item.1).collect();
        }
        tree
    }

    /// Adds the node of some children, each pair of which is opened as long as there is room, the largest first.
    fn widen(&mut self, children: &[Child], pairs: &[[Child; 2]], depth: usize) -> u32 {
        let mut children = children.to_vec();
        while children.len() < WIDTH {
            let inner = children.iter().enumerate().filter(|(_, child)| child.count == 0);
            let Some((largest, _)) = inner.max_by(|a, b| a.1.half_area().total_cmp(&b.1.half_area())) else { break };
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

    /// Visits the leaves that may hold something at least as good as `best`, nearest first.
    #[inline(always)]
    fn search(&self, query: Point, best: &mut Best, leaf: impl FnMut(Range<usize>, &mut Best)) {
        Arch::new().dispatch(Search { tree: self, query, best, leaf });
    }

    /// Visits the leaves whose box meets `query`, both closed.
    fn meeting(&self, query: &Bounds, mut leaf: impl FnMut(Range<usize>)) {
        let (mut short, mut long) = ([0u32; STACK], Vec::new());
        let stack = if self.stack <= STACK { &mut short[..] } else { with_length(&mut long, self.stack) };
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            for i in 0..WIDTH {
                let meets = (0..3).all(|axis| {
                    f64::from(node.low[axis][i]) <= query.high[axis] && f64::from(node.high[axis][i]) >= query.low[axis]
                });
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

/// [`BoxTree::search`], compiled for the best instruction set that the processor has.
struct Search<'a, F> {
    tree: &'a BoxTree,
    query: Point,
    best: &'a mut Best,
    leaf: F,
}

impl<F: FnMut(Range<usize>, &mut Best)> WithSimd for Search<'_, F> {
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
            let mut squared = [0.0f64; WIDTH];
            for axis in 0..3 {
                for i in 0..WIDTH {
                    let under = f64::from(node.low[axis][i]) - query[axis];
                    let over = query[axis] - f64::from(node.high[axis][i]);
                    let outside = if under > over { under } else { over };
                    let outside = if outside > 0.0 { outside } else { 0.0 };
                    squared[i] += outside * outside;
                }
            }
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
type Item = (Bounds, u32);

fn bounds_of(items: &[Item]) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    items.iter().for_each(|(b, _)| bounds.include(b));
    bounds
}

/// The child that holds `items`, slots from `first` on, in the box `bounds`: a leaf, or one of `pairs`.
fn halve(items: &mut [Item], first: usize, bounds: &Bounds, depth: usize, pairs: &mut Vec<[Child; 2]>) -> Child {
    if items.len() <= LEAF {
        return Child::new(bounds, first, items.len());
    }
    let (middle, left, right) = split(items, depth);
    let index = pairs.len();
    pairs.push([Child::NONE; 2]);
    let (low, high) = items.split_at_mut(middle);
    let low = halve(low, first, &left, depth + 1, pairs);
    let high = halve(high, first + middle, &right, depth + 1, pairs);
    pairs[index] = [low, high];
    Child::new(bounds, index, 0)
}

/// Reorders `items` into two parts; returns the size of the first and the boxes of both. Neither part is empty.
fn split(items: &mut [Item], depth: usize) -> (usize, Bounds, Bounds) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for (bounds, _) in items.iter() {
        for axis in 0..3 {
            let center = bounds.center(axis);
            low[axis] = low[axis].min(center);
            high[axis] = high[axis].max(center);
        }
    }
    let extent = [0, 1, 2].map(|axis| high[axis] - low[axis]);
    let axis = (0..3).fold(0, |widest, axis| if extent[axis] > extent[widest] { axis } else { widest });
    let scale = BINS as f64 / extent[axis];
    if depth < HALVES_FROM_DEPTH && scale.is_finite() && scale > 0.0 {
        let bin = |item: &Item| (((item.0.center(axis) - low[axis]) * scale) as usize).min(BINS - 1);
        let mut bins = [(Bounds::EMPTY, 0usize); BINS];
        for item in items.iter() {
            let (bounds, count) = &mut bins[bin(item)];
            bounds.include(&item.0);
            *count += 1;
        }
        // cost of the part from bin b on, for every cut b
        let mut after = [f64::INFINITY; BINS];
        let (mut bounds, mut count) = bins[BINS - 1];
        for b in (1..BINS).rev() {
            after[b] = bounds.half_area() * count as f64;
            bounds.include(&bins[b - 1].0);
            count += bins[b - 1].1;
        }
        let (mut bounds, mut count) = (Bounds::EMPTY, 0);
        let mut best = (f64::INFINITY, 0);
        for b in 1..BINS {
            bounds.include(&bins[b - 1].0);
            count += bins[b - 1].1;
            let cost = bounds.half_area() * count as f64 + after[b];
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
            let (mut left, mut right) = (Bounds::EMPTY, Bounds::EMPTY);
            bins[..best.1].iter().for_each(|(b, _)| left.include(b));
            bins[best.1..].iter().for_each(|(b, _)| right.include(b));
            return (middle, left, right);
        }
    }
    let middle = items.len() / 2;
    let by_center = |a: &Item, b: &Item| a.0.center(axis).total_cmp(&b.0.center(axis)).then(a.1.cmp(&b.1));
    items.select_nth_unstable_by(middle, by_center);
    (middle, bounds_of(&items[..middle]), bounds_of(&items[middle..]))
}

#[inline(always)]
fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn squared(a: Point) -> f64 {
    a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
}

/// Closest point to the origin of a segment: weight of `b`, the point, its squared length.
#[inline(always)]
fn closest_on_segment(a: Point, b: Point) -> (f64, Point, f64) {
    let along = sub(b, a);
    let length = squared(along);
    let t = -dot(a, along);
    // not(>) so that a segment without length is its first end
    let (t, point) = if !(t > 0.0 && length > 0.0) {
        (0.0, a)
    } else if t >= length {
        (1.0, b)
    } else {
        let t = t / length;
        (t, [a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]])
    };
    (t, point, squared(point))
}

/// Closest point to the origin of triangle `a b c`: barycentric coordinates, the point, its squared length.
///
/// Inside, by the sub-triangles' areas along the normal (whose relative error is that of the normal, not of its square,
/// so slivers stay accurate); otherwise on a side that the projection lies beyond.
#[inline(always)]
fn closest_on_triangle(a: Point, b: Point, c: Point) -> ([f64; 3], Point, f64) {
    let normal = cross(sub(b, a), sub(c, a));
    let areas = [dot(normal, cross(b, c)), dot(normal, cross(c, a)), dot(normal, cross(a, b))];
    let inside = areas.map(|area| area > 0.0);
    let (barycentric, mut point) = if inside == [true; 3] {
        let sum = areas[0] + areas[1] + areas[2];
        let w = [areas[0] / sum, areas[1] / sum, areas[2] / sum];
        // the projection of the origin along the normal
        let height = dot(normal, a) / squared(normal);
        (w, [height * normal[0], height * normal[1], height * normal[2]])
    } else {
        let mut best = ([1.0, 0.0, 0.0], a, f64::INFINITY);
        if !inside[2] {
            let (t, point, d) = closest_on_segment(a, b);
            best = ([1.0 - t, t, 0.0], point, d);
        }
        if !inside[0] {
            let (t, point, d) = closest_on_segment(b, c);
            if d < best.2 {
                best = ([0.0, 1.0 - t, t], point, d);
            }
        }
        if !inside[1] {
            let (t, point, d) = closest_on_segment(c, a);
            if d < best.2 {
                best = ([t, 0.0, 1.0 - t], point, d);
            }
        }
        (best.0, best.1)
    };
    // rounding may have left the triangle's box: see "Ties" above
    for i in 0..3 {
        let low = a[i].min(b[i]).min(c[i]);
        let high = a[i].max(b[i]).max(c[i]);
        point[i] = if point[i] < low {
            low
        } else if point[i] > high {
            high
        } else {
            point[i]
        };
    }
    (barycentric, point, squared(point))
}

/// Answers closest-point queries on a triangle mesh. Queries only read, so threads may share it.
#[derive(Debug, Clone)]
pub struct ClosestPoint {
    tree: BoxTree,
    /// Corners of the triangle in every slot.
    triangles: Vec<[Point; 3]>,
    /// Slot of every triangle.
    slots: Vec<u32>,
}

impl ClosestPoint {
    /// Builds the hierarchy. A mesh without triangles is allowed: every query answers `None`.
    ///
    /// # Errors
    /// When a triangle indexes past the vertices, or a vertex of one is not finite.
    pub fn new(mesh: &TriangleMesh) -> Result<Self, MeshError> {
        let mut boxes = Vec::with_capacity(mesh.triangles.len());
        let mut corners: Vec<[Point; 3]> = Vec::with_capacity(mesh.triangles.len());
        for (triangle, indices) in mesh.triangles.iter().enumerate() {
            let mut points = [[0.0; 3]; 3];
            for (point, &index) in points.iter_mut().zip(indices) {
                let Some(position) = mesh.positions.get(index as usize) else {
                    return Err(MeshError::IndexOutOfRange { triangle, index, count: mesh.positions.len() });
                };
                *point = finite(index as usize, position)?;
            }
            let mut bounds = Bounds::EMPTY;
            points.iter().for_each(|&p| bounds.include(&Bounds { low: p, high: p }));
            boxes.push(bounds);
            corners.push(points);
        }
        let tree = BoxTree::build(boxes.into_iter());
        let triangles = tree.order.iter().map(|&t| corners[t as usize]).collect();
        let mut slots = vec![0; corners.len()];
        tree.order.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        Ok(Self { tree, triangles, slots })
    }

    /// The closest point; `None` if there are no triangles or `query` is not finite.
    #[must_use]
    pub fn query(&self, query: &Vec3) -> Option<Closest> {
        self.run(query, Best { squared_distance: f64::INFINITY, primitive: u32::MAX })
    }

    /// The closest point no farther than the square root of `max_squared_distance`, or `None`.
    #[must_use]
    pub fn query_within(&self, query: &Vec3, max_squared_distance: f64) -> Option<Closest> {
        self.run(query, Best { squared_distance: max_squared_distance, primitive: u32::MAX })
    }

    /// As [`Self::query`], faster if triangle `hint` is near. The answer does not depend on the hint; one that is out of
    /// range is ignored.
    #[must_use]
    pub fn query_from(&self, query: &Vec3, hint: u32) -> Option<Closest> {
        self.query_from_within(query, hint, f64::INFINITY)
    }

    /// [`Self::query_from`] and [`Self::query_within`] at once.
    #[must_use]
    pub fn query_from_within(&self, query: &Vec3, hint: u32, max_squared_distance: f64) -> Option<Closest> {
        let mut best = Best { squared_distance: max_squared_distance, primitive: u32::MAX };
        if let Some(&slot) = self.slots.get(hint as usize) {
            let (_, _, d) = self.closest(slot as usize, (*query).into());
            if d <= best.squared_distance {
                best = Best { squared_distance: d, primitive: hint };
            }
        }
        self.run(query, best)
    }

    /// Calls `found` with every triangle whose bounding box meets the box from `low` to `high`, boundaries included. Their
    /// order depends on nothing but mesh and box.
    pub fn triangles_meeting_box(&self, low: &Vec3, high: &Vec3, mut found: impl FnMut(u32)) {
        let query = Bounds { low: (*low).into(), high: (*high).into() };
        self.tree.meeting(&query, |slots| {
            for slot in slots {
                let [a, b, c] = self.triangles[slot];
                let meets = (0..3)
                    .all(|i| a[i].min(b[i]).min(c[i]) <= query.high[i] && a[i].max(b[i]).max(c[i]) >= query.low[i]);
                if meets {
                    found(self.tree.order[slot]);
                }
            }
        });
    }

    #[inline(always)]
    fn closest(&self, slot: usize, query: Point) -> ([f64; 3], Point, f64) {
        let [a, b, c] = self.triangles[slot];
        closest_on_triangle(sub(a, query), sub(b, query), sub(c, query))
    }

    fn run(&self, query: &Vec3, mut best: Best) -> Option<Closest> {
        let q: Point = (*query).into();
        if !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        self.tree.search(
            q,
            &mut best,
            #[inline(always)]
            |slots, best| {
                for slot in slots {
                    let (_, _, d) = self.closest(slot, q);
                    let triangle = self.tree.order[slot];
                    if best.beaten_by(d, triangle) {
                        *best = Best { squared_distance: d, primitive: triangle };
                    }
                }
            },
        );
        let slot = *self.slots.get(best.primitive as usize)?;
        let (barycentric, offset, squared_distance) = self.closest(slot as usize, q);
        let point = query + Vec3::from(offset);
        Some(Closest { triangle: best.primitive, barycentric, point, squared_distance })
    }
}

fn finite(vertex: usize, position: &Vec3) -> Result<Point, MeshError> {
    let position: Point = (*position).into();
    if position.iter().all(|x| x.is_finite()) { Ok(position) } else { Err(MeshError::NotFinite { vertex, position }) }
}

/// Answers closest-vertex queries on a point cloud. Queries only read, so threads may share it.
#[derive(Debug, Clone)]
pub struct ClosestVertices {
    tree: BoxTree,
    points: Vec<Point>,
}

impl ClosestVertices {
    /// Builds the hierarchy. No points are allowed: every query answers `None`.
    ///
    /// # Errors
    /// When a point is not finite.
    pub fn new(positions: &[Vec3]) -> Result<Self, MeshError> {
        let points: Vec<Point> = positions.iter().enumerate().map(|(i, p)| finite(i, p)).collect::<Result<_, _>>()?;
        let tree = BoxTree::build(points.iter().map(|&p| Bounds { low: p, high: p }));
        let points = tree.order.iter().map(|&i| points[i as usize]).collect();
        Ok(Self { tree, points })
    }

    /// The closest vertex; `None` if there are none or `query` is not finite.
    #[must_use]
    pub fn query(&self, query: &Vec3) -> Option<ClosestVertex> {
        self.query_within(query, f64::INFINITY)
    }

    /// The closest vertex no farther than the square root of `max_squared_distance`, or `None`.
    #[must_use]
    pub fn query_within(&self, query: &Vec3, max_squared_distance: f64) -> Option<ClosestVertex> {
        let q: Point = (*query).into();
        let mut best = Best { squared_distance: max_squared_distance, primitive: u32::MAX };
        if !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        self.tree.search(
            q,
            &mut best,
            #[inline(always)]
            |slots, best| {
                for slot in slots {
                    let d = squared(sub(self.points[slot], q));
                    if best.beaten_by(d, self.tree.order[slot]) {
                        *best = Best { squared_distance: d, primitive: self.tree.order[slot] };
                    }
                }
            },
        );
        let found = best.primitive != u32::MAX;
        found.then_some(ClosestVertex { vertex: best.primitive, squared_distance: best.squared_distance })
    }

    /// The `k` closest vertices, nearest first, lowest index on ties, into `found` (cleared first).
    pub fn k_nearest(&self, query: &Vec3, k: usize, found: &mut Vec<ClosestVertex>) {
        found.clear();
        let q: Point = (*query).into();
        if k == 0 || !q.iter().all(|x| x.is_finite()) {
            return;
        }
        let mut best = Best { squared_distance: f64::INFINITY, primitive: u32::MAX };
        self.tree.search(q, &mut best, |slots, best| {
            for slot in slots {
                let new = ClosestVertex {
                    vertex: self.tree.order[slot],
                    squared_distance: squared(sub(self.points[slot], q)),
                };
                if !best.beaten_by(new.squared_distance, new.vertex) {
                    continue;
                }
                let before = |o: &ClosestVertex| (o.squared_distance, o.vertex) < (new.squared_distance, new.vertex);
                found.insert(found.partition_point(before), new);
                found.truncate(k);
                if found.len() == k {
                    let last = found[k - 1];
                    *best = Best { squared_distance: last.squared_distance, primitive: last.vertex };
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn v(p: Point) -> Vec3 {
        Vec3::from(p)
    }

    /// Coordinates on a coarse grid now and then, so that ties and degenerate triangles happen.
    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![-3.0..3.0f64, (-3i32..4).prop_map(f64::from), Just(1e-9), Just(100.0)]
    }

    fn point() -> impl Strategy<Value = Vec3> {
        [coordinate(), coordinate(), coordinate()].prop_map(v)
    }

    fn mesh() -> impl Strategy<Value = TriangleMesh> {
        (prop::collection::vec(point(), 3..40), prop::collection::vec([0u32..1000, 0u32..1000, 0u32..1000], 1..80))
            .prop_map(|(positions, triangles)| {
                let n = positions.len() as u32;
                TriangleMesh { positions, triangles: triangles.into_iter().map(|t| t.map(|i| i % n)).collect() }
            })
    }

    /// Ericson, "Real-Time Collision Detection", 5.1.5, by regions: another route to the same distance.
    fn reference(p: Vec3, [a, b, c]: [Vec3; 3]) -> f64 {
        let segment = |a: Vec3, b: Vec3| {
            let ab = b - a;
            let t = if ab.norm_squared() > 0.0 { ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0) } else { 0.0 };
            (a + ab * t - p).norm_squared()
        };
        let mut best = segment(a, b).min(segment(b, c)).min(segment(c, a));
        let n = (b - a).cross(&(c - a));
        if n.norm() > 1e-7 * (b - a).norm() * (c - a).norm() {
            let inside = [(a, b), (b, c), (c, a)].iter().all(|(s, e)| (e - s).cross(&(p - s)).dot(&n) >= 0.0);
            if inside {
                best = best.min(n.normalize().dot(&(p - a)).powi(2));
            }
        }
        best
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn the_closest_point_is_that_of_all_triangles(mesh in mesh(), queries in prop::collection::vec(point(), 1..20),
                                                      hint in 0u32..90) {
            let tree = ClosestPoint::new(&mesh).unwrap();
            for q in &queries {
                let found = tree.query(q).unwrap();
                // the same function over all triangles: same bits, lowest index
                let all = (0..mesh.triangles.len()).map(|t| {
                    let (_, _, d) = tree.closest(tree.slots[t] as usize, (*q).into());
                    (d, t as u32)
                });
                let (d, t) = all.reduce(|a, b| if b < a { b } else { a }).unwrap();
                prop_assert_eq!((found.squared_distance, found.triangle), (d, t));
                // another function over all triangles: same distance
                let brute = mesh.triangles.iter().map(|t| reference(*q, t.map(|i| mesh.positions[i as usize])))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!((brute.sqrt() - d.sqrt()).abs() < 1e-6, "{} {}", brute.sqrt(), d.sqrt());
                // the point is where it says
                let corners = mesh.triangles[t as usize].map(|i| mesh.positions[i as usize]);
                let w = found.barycentric;
                let by_weights = corners[0] * w[0] + corners[1] * w[1] + corners[2] * w[2];
                prop_assert!((by_weights - found.point).norm() < 1e-6, "{by_weights} {}", found.point);
                prop_assert!(w.iter().all(|w| *w >= 0.0) && (w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                // hints and bounds change nothing
                prop_assert_eq!(tree.query_from(q, hint), Some(found));
                prop_assert_eq!(tree.query_within(q, d), Some(found));
                prop_assert_eq!(tree.query_from_within(q, hint, d), Some(found));
                if d > 0.0 {
                    prop_assert_eq!(tree.query_within(q, d.next_down()), None);
                    prop_assert_eq!(tree.query_from_within(q, hint, d.next_down()), None);
                }
            }
        }

        #[test]
        fn the_triangles_in_a_box_are_those_of_all(mesh in mesh(), a in point(), b in point()) {
            let (low, high) = (a.inf(&b), a.sup(&b));
            let mut found = Vec::new();
            ClosestPoint::new(&mesh).unwrap().triangles_meeting_box(&low, &high, |t| found.push(t));
            found.sort_unstable();
            let meets = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                let (l, h) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
                (0..3).all(|i| l[i] <= high[i] && low[i] <= h[i])
            };
            let all = (0..mesh.triangles.len() as u32).filter(|t| meets(&mesh.triangles[*t as usize]));
            prop_assert_eq!(found, all.collect::<Vec<_>>());
        }

        #[test]
        fn the_closest_vertices_are_those_of_all(points in prop::collection::vec(point(), 1..120), q in point(),
                                                 k in 1usize..8) {
            let tree = ClosestVertices::new(&points).unwrap();
            let mut all: Vec<ClosestVertex> = points.iter().enumerate()
                .map(|(i, p)| ClosestVertex { vertex: i as u32, squared_distance: squared(sub((*p).into(), q.into())) })
                .collect();
            all.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.vertex.cmp(&b.vertex)));
            prop_assert_eq!(tree.query(&q), Some(all[0]));
            let mut found = Vec::new();
            tree.k_nearest(&q, k, &mut found);
            all.truncate(k);
            prop_assert_eq!(found, all);
        }
    }

    #[test]
    fn slivers_and_triangles_without_area() {
        let positions = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 1e-9, 0.0]].map(v).to_vec();
        let q = Vec3::new(0.5, 1.0, 0.0);
        for (triangle, distance) in [([0, 1, 2], 1.0), ([0, 0, 0], 1.25f64.sqrt()), ([1, 1, 0], 1.0), ([0, 1, 3], 1.0)]
        {
            let mesh = TriangleMesh { positions: positions.clone(), triangles: vec![triangle] };
            let found = ClosestPoint::new(&mesh).unwrap().query(&q).unwrap();
            assert!((found.squared_distance.sqrt() - distance).abs() < 2e-9, "{found:?}");
        }
    }

    #[test]
    fn nothing_to_find_and_nothing_to_build() {
        let mut mesh = TriangleMesh { positions: vec![Vec3::zeros(); 3], triangles: vec![] };
        assert_eq!(ClosestPoint::new(&mesh).unwrap().query(&Vec3::zeros()), None);
        assert_eq!(ClosestVertices::new(&[]).unwrap().query(&Vec3::zeros()), None);
        mesh.triangles = vec![[0, 1, 2]; 300]; // all boxes alike
        let tree = ClosestPoint::new(&mesh).unwrap();
        assert_eq!(tree.query(&Vec3::x()).unwrap().triangle, 0);
        assert_eq!(tree.query(&Vec3::new(f64::NAN, 0.0, 0.0)), None);
        mesh.triangles.push([0, 1, 3]);
        assert!(matches!(
            ClosestPoint::new(&mesh),
            Err(MeshError::IndexOutOfRange { triangle: 300, index: 3, count: 3 })
        ));
        mesh.triangles.pop();
        mesh.positions[1].y = f64::NAN;
        assert!(matches!(ClosestPoint::new(&mesh), Err(MeshError::NotFinite { vertex: 1, .. })));
        assert!(ClosestVertices::new(&mesh.positions).is_err());
    }

    #[test]
    fn enormous_coordinates_neither_panic_nor_lose_the_answer() {
        let positions = [[1e300, 0.0, 0.0], [0.0, 1e300, 0.0], [0.0, 0.0, 1e300], [-1e300; 3]].map(v).to_vec();
        let mesh = TriangleMesh { positions, triangles: vec![[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3], [3, 3, 3]] };
        let tree = ClosestPoint::new(&mesh).unwrap();
        assert!(tree.query(&Vec3::repeat(-1e300)).is_some());
    }
}
