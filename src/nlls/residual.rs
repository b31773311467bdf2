//! Residual families: any residuals over any parameter blocks, differentiated by dual numbers.
//!
//! ```text
//!     E(x) = sum_families alpha sum_m rho( |r_m(x)|^2 )
//!
//!     J_m = d r_m(x [+] delta) / d delta at delta = 0        one pass with duals of static width, all blocks of r_m at once
//!     w_m = alpha rho'(|r_m|^2)
//!     g  += w_m J_m' r_m          H += w_m J_m' J_m
//! ```
//!
//! Linearising has two phases, both parallel and both independent of the number of threads: every residual writes its own
//! slot (r, J, w); then every block row sums the residuals that touch it, in the order in which they were added.

use std::any::{Any, TypeId};
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use nalgebra::DMatrix;
use num_dual::DualSVec64;
use thiserror::Error;

use super::manifold::{Manifold, PointArray};
use super::parallel::for_each;
use super::{BlockStructure, Kernel, NormalEquations, OptionError, Problem, RobustKernel, Scalar};

/// A residual with `R` entries over blocks with `T` tangent coordinates altogether.
///
/// ```
/// use nonrigid::nlls::{Residual, Scalar, Se3};
///
/// /// A point of a rigid body, measured: r = T p - q.
/// struct Measured { p: [f64; 3], q: [f64; 3] }
///
/// impl Residual<3, 6> for Measured {
///     type Blocks = (Se3,);
///
///     fn evaluate<D: Scalar>(&self, (pose,): &([D; 12],)) -> [D; 3] {
///         let moved = Se3::transform(pose, self.p.map(D::from));
///         std::array::from_fn(|i| moved[i] - self.q[i])
///     }
/// }
/// ```
///
/// `T` is the width of the dual numbers. It must be the sum of the blocks' `TANGENT`; a wrong sum does not compile.
pub trait Residual<const R: usize, const T: usize>: Send + Sync + 'static {
    /// The manifolds of the parameter blocks, as a tuple: `(Se3, Euclidean<2>)`.
    type Blocks: BlockList;

    /// The residual at the points of its blocks.
    fn evaluate<D: Scalar>(&self, points: &<Self::Blocks as BlockList>::Points<D>) -> [D; R];
}

/// Tuples of one to six [`Manifold`]s.
pub trait BlockList: 'static {
    /// A tuple of arrays, one a block.
    type Points<D: Scalar>;
    /// `[BlockId; COUNT]`.
    type Ids: AsRef<[BlockId]>;
    /// Number of blocks.
    const COUNT: usize;
    /// Tangent coordinates of all blocks.
    const TANGENT: usize;
    /// Type and tangent dimension of each block.
    fn manifolds() -> Vec<(TypeId, &'static str, usize)>;
    /// Copies the points `x(0), x(1), ..`.
    fn load<'a>(x: impl Fn(usize) -> &'a [f64]) -> Self::Points<f64>;
    /// Moves the points `x(0), x(1), ..` by the tangent steps laid one after the other in `delta`.
    fn plus<'a, D: Scalar>(x: impl Fn(usize) -> &'a [f64], delta: &[D]) -> Self::Points<D>;
}

macro_rules! block_list {
    ($count:literal: $($m:ident $k:tt),+) => {
        impl<$($m: Manifold),+> BlockList for ($($m,)+) {
            type Points<D: Scalar> = ($($m::Point<D>,)+);
            type Ids = [BlockId; $count];
            const COUNT: usize = $count;
            const TANGENT: usize = 0 $(+ $m::TANGENT)+;

            fn manifolds() -> Vec<(TypeId, &'static str, usize)> {
                vec![$((TypeId::of::<$m>(), std::any::type_name::<$m>(), $m::TANGENT)),+]
            }

            fn load<'a>(x: impl Fn(usize) -> &'a [f64]) -> Self::Points<f64> {
                ($({
                    let mut point = $m::Point::<f64>::filled(0.0);
                    point.as_mut().copy_from_slice(x($k));
                    point
                },)+)
            }

            fn plus<'a, D: Scalar>(x: impl Fn(usize) -> &'a [f64], delta: &[D]) -> Self::Points<D> {
                let mut rest = delta;
                ($({
                    let (own, others) = rest.split_at($m::TANGENT);
                    rest = others;
                    let _ = rest;
                    let mut point = $m::Point::<D>::filled(D::from(0.0));
                    $m::plus(x($k), own, point.as_mut());
                    point
                },)+)
            }
        }
    };
}

block_list!(1: A 0);
block_list!(2: A 0, B 1);
block_list!(3: A 0, B 1, C 2);
block_list!(4: A 0, B 1, C 2, D4 3);
block_list!(5: A 0, B 1, C 2, D4 3, E 4);
block_list!(6: A 0, B 1, C 2, D4 3, E 4, F 5);

/// Names a parameter block of a [`ResidualProblem`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BlockId(usize);

/// Names a family of a [`ResidualProblem`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FamilyId(usize);

/// Why a problem could not be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ProblemError {
    /// A family's residuals and lists of blocks do not pair up.
    #[error("family {family} has {residuals} residuals, but {block_lists} lists of blocks; give one list a residual")]
    LengthMismatch {
        /// Index of the family.
        family: usize,
        /// Number of residuals.
        residuals: usize,
        /// Number of lists.
        block_lists: usize,
    },
    /// A residual names a block of another problem.
    #[error("residual {residual} of family {family} names block {block}, but the problem has {blocks}")]
    BlockOutOfRange {
        /// Index of the family.
        family: usize,
        /// Index of the residual.
        residual: usize,
        /// The block.
        block: usize,
        /// Number of blocks.
        blocks: usize,
    },
    /// A block is not of the manifold that the residual is written for.
    #[error(
        "residual {residual} of family {family} wants a block of type {expected} in place {place}, but block {block} is {found}"
    )]
    WrongManifold {
        /// Index of the family.
        family: usize,
        /// Index of the residual.
        residual: usize,
        /// Position in the residual's tuple of blocks.
        place: usize,
        /// The block.
        block: usize,
        /// Manifold of the residual.
        expected: &'static str,
        /// Manifold of the block.
        found: &'static str,
    },
    /// The initial value of a block has the wrong length or is not finite.
    #[error("the initial value of block {block} ({manifold}) must be {expected} finite numbers, but is {found:?}")]
    BadInitialValue {
        /// The block.
        block: usize,
        /// Its manifold.
        manifold: &'static str,
        /// Ambient coordinates of the manifold.
        expected: usize,
        /// What was given.
        found: Vec<f64>,
    },
    /// A weight or a kernel is out of bounds.
    #[error("family {family}: {source}")]
    Setting {
        /// Index of the family.
        family: usize,
        /// What is wrong.
        source: OptionError,
    },
}

/// Where the tangent coordinates of a parameter block live.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// A block of the sparse part.
    Sparse,
    /// A stretch of the dense border.
    Border,
    /// Nowhere: the block does not move.
    Constant,
}

/// A parameter block, its manifold erased.
#[derive(Debug, Clone)]
struct Block {
    place: Place,
    manifold: TypeId,
    name: &'static str,
    ambient: usize,
    tangent: usize,
    initial: Vec<f64>,
    move_by: fn(&[f64], &[f64], &mut [f64]),
    /// First ambient coordinate in x.
    ambient_at: usize,
    /// First tangent coordinate: in the gradient.
    tangent_at: usize,
    /// Sparse: index in the block structure.
    index: usize,
}

/// Residuals of one kind that share a kernel and a weight.
pub struct Family<F, const R: usize, const T: usize>
where
    F: Residual<R, T>,
{
    residuals: Vec<F>,
    blocks: Vec<BlockId>,
    block_lists: usize,
    kernel: Box<dyn RobustKernel>,
    kernel_error: Option<OptionError>,
    weight: f64,
    slots: Vec<Slot<R, T>>,
    tangents: PhantomData<[(); T]>,
}

/// What one residual writes.
#[derive(Debug, Clone, Copy)]
struct Slot<const R: usize, const T: usize> {
    residual: [f64; R],
    jacobian: [[f64; T]; R],
    weight: f64,
    energy: f64,
}

impl<F: Residual<R, T>, const R: usize, const T: usize> Family<F, R, T> {
    /// The width of the dual numbers must be the sum of the blocks' tangent coordinates; anything else does not compile.
    const WIDTH: () = assert!(T == F::Blocks::TANGENT, "T of Residual<R, T> must be the sum of the blocks' TANGENT");

    /// Residuals and, for each, the blocks that it reads, in the order of [`Residual::Blocks`].
    #[must_use]
    pub fn new(residuals: Vec<F>, blocks: &[<F::Blocks as BlockList>::Ids]) -> Self {
        const { Self::WIDTH };
        Self {
            residuals,
            blocks: blocks.iter().flat_map(|ids| ids.as_ref().iter().copied()).collect(),
            block_lists: blocks.len(),
            kernel: Box::new(Kernel::None),
            kernel_error: None,
            weight: 1.0,
            slots: Vec::new(),
            tangents: PhantomData,
        }
    }

    /// The same residuals under one of the [`Kernel`]s. Default: plain squares.
    #[must_use]
    pub fn with_kernel(self, kernel: Kernel) -> Self {
        Self { kernel: Box::new(kernel), kernel_error: kernel.validate().err(), ..self }
    }

    /// The same residuals under a kernel of your own.
    #[must_use]
    pub fn with_robust_kernel(self, kernel: impl RobustKernel + 'static) -> Self {
        Self { kernel: Box::new(kernel), kernel_error: None, ..self }
    }

    /// The same residuals with the weight alpha >= 0. Default 1.
    #[must_use]
    pub fn with_weight(self, alpha: f64) -> Self {
        Self { weight: alpha, ..self }
    }
}

/// A family without its types.
trait AnyFamily: Send + Sync {
    fn block_count(&self) -> usize;
    fn residual_count(&self) -> usize;
    fn block_lists(&self) -> usize;
    fn entries(&self) -> usize;
    fn blocks(&self) -> &[BlockId];
    fn manifolds(&self) -> Vec<(TypeId, &'static str, usize)>;
    fn kernel_error(&self) -> Option<&OptionError>;
    fn weight(&self) -> f64;
    fn set_weight(&mut self, weight: f64);
    fn set_kernel(&mut self, kernel: Box<dyn RobustKernel>);
    /// Allocates the slots.
    fn prepare(&mut self);
    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64;
    /// Residual, Jacobian (row-major) and weight of residual `m`, as of the last linearisation.
    fn row(&self, m: usize) -> (&[f64], &[f64], f64);
    fn residuals_mut(&mut self) -> &mut dyn Any;
}

/// Residuals that one thread takes at least.
const GRAIN: usize = 32;

impl<F: Residual<R, T>, const R: usize, const T: usize> AnyFamily for Family<F, R, T> {
    fn block_count(&self) -> usize {
        F::Blocks::COUNT
    }

    fn residual_count(&self) -> usize {
        self.residuals.len()
    }

    fn block_lists(&self) -> usize {
        self.block_lists
    }

    fn entries(&self) -> usize {
        R
    }

    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn manifolds(&self) -> Vec<(TypeId, &'static str, usize)> {
        F::Blocks::manifolds()
    }

    fn kernel_error(&self) -> Option<&OptionError> {
        self.kernel_error.as_ref()
    }

    fn weight(&self) -> f64 {
        self.weight
    }

    fn set_weight(&mut self, weight: f64) {
        self.weight = weight;
    }

    fn set_kernel(&mut self, kernel: Box<dyn RobustKernel>) {
        self.kernel = kernel;
    }

    fn prepare(&mut self) {
        let empty = Slot { residual: [0.0; R], jacobian: [[0.0; T]; R], weight: 0.0, energy: 0.0 };
        self.slots = vec![empty; self.residuals.len()];
    }

    fn energy(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        let Self { residuals, blocks, kernel, weight, slots, .. } = self;
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::load(|k| &x[ambient[ids[k].0].clone()]);
            let residual = residuals[m].evaluate(&points);
            let square: f64 = residual.iter().map(|r| r * r).sum();
            slot.energy = *weight * kernel.evaluate(square)[0];
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn linearize(&mut self, x: &[f64], ambient: &[std::ops::Range<usize>]) -> f64 {
        let Self { residuals, blocks, kernel, weight, slots, .. } = self;
        let seeds: [DualSVec64<T>; T] = std::array::from_fn(|i| DualSVec64::from_re(0.0).derivative(i));
        for_each(slots, GRAIN, &|m, slot: &mut Slot<R, T>| {
            let ids = &blocks[m * F::Blocks::COUNT..(m + 1) * F::Blocks::COUNT];
            let points = F::Blocks::plus(|k| &x[ambient[ids[k].0].clone()], &seeds);
            let dual = residuals[m].evaluate(&points);
            for (i, value) in dual.into_iter().enumerate() {
                slot.residual[i] = value.re;
                slot.jacobian[i] = value.eps.0.map_or([0.0; T], |eps| eps.data.0[0]);
            }
            let square: f64 = slot.residual.iter().map(|r| r * r).sum();
            let [rho, first, _] = kernel.evaluate(square);
            slot.weight = *weight * first;
            slot.energy = *weight * rho;
        });
        slots.iter().map(|slot| slot.energy).sum()
    }

    fn row(&self, m: usize) -> (&[f64], &[f64], f64) {
        let slot = &self.slots[m];
        (&slot.residual, slot.jacobian.as_flattened(), slot.weight)
    }

    fn residuals_mut(&mut self) -> &mut dyn Any {
        &mut self.residuals
    }
}

/// One block of one residual, seen from the row of `H` that it contributes to.
#[derive(Debug, Clone, Copy)]
struct Contribution {
    family: u32,
    residual: u32,
    /// Position of the block in the residual's tuple.
    place: u32,
    /// First of its [`Target`]s.
    first_target: u32,
    /// Number of its targets.
    target_count: u32,
}

/// Where the product of the row's block with another block of the same residual goes.
#[derive(Debug, Clone, Copy)]
struct Target {
    /// Position of the other block in the residual's tuple.
    place: u32,
    kind: TargetKind,
}

#[derive(Debug, Clone, Copy)]
enum TargetKind {
    /// At this position of the row's stored blocks.
    Blocks(u32),
    /// At this column of the border part.
    Border(u32),
}

/// The contributions to every row of one part (sparse or border), grouped by block.
#[derive(Debug, Default)]
struct Gather {
    starts: Vec<usize>,
    contributions: Vec<Contribution>,
    targets: Vec<Target>,
}

/// Offsets of a family's blocks inside its Jacobian rows.
#[derive(Debug)]
struct Layout {
    /// `starts[k]..starts[k + 1]` are the columns of block `k`.
    starts: Vec<usize>,
}

/// Collects parameter blocks and families; [`build`](Self::build) checks them and lays out the equations.
#[derive(Default)]
pub struct ResidualProblemBuilder {
    blocks: Vec<Block>,
    families: Vec<Box<dyn AnyFamily>>,
}

impl fmt::Debug for ResidualProblemBuilder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ResidualProblemBuilder {{ blocks: {}, families: {} }}", self.blocks.len(), self.families.len())
    }
}

impl ResidualProblemBuilder {
    fn add<M: Manifold>(&mut self, place: Place, initial: &[f64]) -> BlockId {
        self.blocks.push(Block {
            place,
            manifold: TypeId::of::<M>(),
            name: std::any::type_name::<M>(),
            ambient: M::AMBIENT,
            tangent: M::TANGENT,
            initial: initial.to_vec(),
            move_by: |x, step, out| {
                M::plus(x, step, out);
                M::normalize(out);
            },
            ambient_at: 0,
            tangent_at: 0,
            index: 0,
        });
        BlockId(self.blocks.len() - 1)
    }

    /// Adds a block to the sparse part: one of many that each meet few others (poses, nodes, points).
    pub fn add_block<M: Manifold>(&mut self, initial: &[f64]) -> BlockId {
        self.add::<M>(Place::Sparse, initial)
    }

    /// Adds a block to the dense border: one of few that meet nearly everything (a camera's calibration, shape weights).
    pub fn add_border_block<M: Manifold>(&mut self, initial: &[f64]) -> BlockId {
        self.add::<M>(Place::Border, initial)
    }

    /// Holds a block at its initial value. Its coordinates stay in x, but have no place in the equations.
    pub fn set_constant(&mut self, block: BlockId) {
        self.blocks[block.0].place = Place::Constant;
    }

    /// Adds residuals.
    pub fn add_family<F: Residual<R, T>, const R: usize, const T: usize>(
        &mut self,
        family: Family<F, R, T>,
    ) -> FamilyId {
        self.families.push(Box::new(family));
        FamilyId(self.families.len() - 1)
    }

    /// Checks everything, builds the [`BlockStructure`] and allocates what linearising needs.
    ///
    /// # Errors
    /// [`ProblemError`], naming family, residual and block.
    pub fn build(self) -> Result<ResidualProblem, ProblemError> {
        let Self { mut blocks, mut families } = self;
        check_blocks(&blocks)?;
        for (f, family) in families.iter().enumerate() {
            check_family(f, family.as_ref(), &blocks)?;
        }

        // x and the tangent space: sparse blocks, border, constants, each in the order of addition.
        let (mut ambient, mut tangent, mut sizes) = (0, 0, Vec::new());
        for place in [Place::Sparse, Place::Border, Place::Constant] {
            for block in blocks.iter_mut().filter(|b| b.place == place) {
                block.ambient_at = ambient;
                ambient += block.ambient;
                if place != Place::Constant {
                    block.tangent_at = tangent;
                    tangent += block.tangent;
                }
                if place == Place::Sparse {
                    block.index = sizes.len();
                    sizes.push(block.tangent);
                }
            }
        }
        let sparse: usize = sizes.iter().sum();
        let mut pairs = Vec::new();
        for family in &families {
            for ids in family.blocks().chunks_exact(family.block_count()) {
                let indices = ids.iter().map(|id| &blocks[id.0]).filter(|b| b.place == Place::Sparse).map(|b| b.index);
                let indices: Vec<usize> = indices.collect();
                pairs.extend(indices.iter().flat_map(|&i| indices.iter().map(move |&j| (i, j))));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let structure = BlockStructure::new(&sizes, pairs, tangent - sparse).expect("indices count the sparse blocks");

        let layouts: Vec<Layout> = families
            .iter()
            .map(|family| {
                let mut starts = vec![0];
                for (.., tangent) in family.manifolds() {
                    starts.push(starts[starts.len() - 1] + tangent);
                }
                Layout { starts }
            })
            .collect();
        let sparse_gather = gather(&blocks, &families, &structure, Place::Sparse);
        let border_gather = gather(&blocks, &families, &structure, Place::Border);
        for family in &mut families {
            family.prepare();
        }
        let ranges = blocks.iter().map(|b| b.ambient_at..b.ambient_at + b.ambient).collect();
        let border_blocks = (0..blocks.len()).filter(|&i| blocks[i].place == Place::Border).collect();
        Ok(ResidualProblem {
            structure: Arc::new(structure),
            parameter_len: ambient,
            blocks,
            ranges,
            border_blocks,
            families,
            layouts,
            sparse_gather,
            border_gather,
        })
    }
}

fn check_blocks(blocks: &[Block]) -> Result<(), ProblemError> {
    for (i, block) in blocks.iter().enumerate() {
        if block.initial.len() != block.ambient || block.initial.iter().any(|v| !v.is_finite()) {
            return Err(ProblemError::BadInitialValue {
                block: i,
                manifold: block.name,
                expected: block.ambient,
                found: block.initial.clone(),
            });
        }
    }
    Ok(())
}

fn check_family(f: usize, family: &dyn AnyFamily, blocks: &[Block]) -> Result<(), ProblemError> {
    let (residuals, block_lists) = (family.residual_count(), family.block_lists());
    if residuals != block_lists {
        return Err(ProblemError::LengthMismatch { family: f, residuals, block_lists });
    }
    let alpha = family.weight();
    OptionError::require(alpha >= 0.0 && alpha.is_finite(), "weight", alpha, "finite and not negative")
        .and(family.kernel_error().map_or(Ok(()), |e| Err(e.clone())))
        .map_err(|source| ProblemError::Setting { family: f, source })?;
    let manifolds = family.manifolds();
    for (m, ids) in family.blocks().chunks_exact(family.block_count()).enumerate() {
        for (place, (id, &(manifold, expected, _))) in ids.iter().zip(&manifolds).enumerate() {
            let Some(block) = blocks.get(id.0) else {
                return Err(ProblemError::BlockOutOfRange {
                    family: f,
                    residual: m,
                    block: id.0,
                    blocks: blocks.len(),
                });
            };
            if block.manifold != manifold {
                return Err(ProblemError::WrongManifold {
                    family: f,
                    residual: m,
                    place,
                    block: id.0,
                    expected,
                    found: block.name,
                });
            }
        }
    }
    Ok(())
}

/// Lists, for every block of one part and in the order of addition, what contributes to its row.
fn gather(blocks: &[Block], families: &[Box<dyn AnyFamily>], s: &BlockStructure, part: Place) -> Gather {
    let narrow = |v: usize| u32::try_from(v).expect("fewer than 2^32 residuals and values in a row");
    let mut row_of = vec![usize::MAX; blocks.len()];
    let mut rows = 0;
    for (i, block) in blocks.iter().enumerate().filter(|(_, b)| b.place == part) {
        row_of[i] = rows;
        rows += 1;
        debug_assert!(part == Place::Border || block.index == row_of[i]);
    }
    let mut lists: Vec<Vec<Contribution>> = vec![Vec::new(); rows];
    let mut targets = Vec::new();
    for (f, family) in families.iter().enumerate() {
        for (m, ids) in family.blocks().chunks_exact(family.block_count()).enumerate() {
            for (a, id) in ids.iter().enumerate() {
                let row = &blocks[id.0];
                if row.place != part {
                    continue;
                }
                let first_target = targets.len();
                for (b, other) in ids.iter().enumerate() {
                    let col = &blocks[other.0];
                    let kind = match (part, col.place) {
                        (Place::Sparse, Place::Sparse) if col.index <= row.index => {
                            let slot = s.slot(row.index, col.index).expect("the pattern holds all pairs");
                            TargetKind::Blocks(narrow(s.values(slot).start - s.row_values(row.index).start))
                        }
                        (Place::Sparse, Place::Border) => {
                            TargetKind::Border(narrow(col.tangent_at - s.sparse_dimension()))
                        }
                        (Place::Border, Place::Border) if col.tangent_at <= row.tangent_at => {
                            TargetKind::Border(narrow(col.tangent_at - s.sparse_dimension()))
                        }
                        _ => continue,
                    };
                    targets.push(Target { place: narrow(b), kind });
                }
                let target_count = targets.len() - first_target;
                lists[row_of[id.0]].push(Contribution {
                    family: narrow(f),
                    residual: narrow(m),
                    place: narrow(a),
                    first_target: narrow(first_target),
                    target_count: narrow(target_count),
                });
            }
        }
    }
    let mut gather = Gather { starts: vec![0], contributions: Vec::new(), targets };
    for list in lists {
        gather.contributions.extend(list);
        gather.starts.push(gather.contributions.len());
    }
    gather
}

/// A least-squares problem stated residual by residual, over parameter blocks on manifolds.
///
/// ```
/// use nonrigid::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar};
///
/// /// One measurement of y = a exp(b t).
/// struct Sample { t: f64, y: f64 }
///
/// impl Residual<1, 2> for Sample {
///     type Blocks = (Euclidean<2>,);
///
///     fn evaluate<D: Scalar>(&self, (p,): &([D; 2],)) -> [D; 1] {
///         [p[0] * (p[1] * self.t).exp() - self.y]
///     }
/// }
///
/// let samples: Vec<Sample> = (0..20).map(|k| 0.1 * k as f64).map(|t| Sample { t, y: 3.0 * (0.5 * t).exp() }).collect();
/// let mut builder = ResidualProblem::builder();
/// let curve = builder.add_border_block::<Euclidean<2>>(&[1.0, 0.0]);
/// let blocks = vec![[curve]; samples.len()];
/// builder.add_family(Family::new(samples, &blocks));
/// let mut problem = builder.build()?;
///
/// let mut x = problem.initial();
/// let summary = Minimizer::new(Options::gauss_newton())?.minimize(&mut problem, &mut x);
/// let p = problem.block(&x, curve);
/// assert!((p[0] - 3.0).abs() < 1e-9 && (p[1] - 0.5).abs() < 1e-9, "{summary}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// In x the sparse blocks come first, then the border, then the constant blocks, each in the order of addition.
pub struct ResidualProblem {
    structure: Arc<BlockStructure>,
    parameter_len: usize,
    blocks: Vec<Block>,
    /// Ambient coordinates of every block.
    ranges: Vec<std::ops::Range<usize>>,
    /// Blocks of the border, in order.
    border_blocks: Vec<usize>,
    families: Vec<Box<dyn AnyFamily>>,
    layouts: Vec<Layout>,
    sparse_gather: Gather,
    border_gather: Gather,
}

impl fmt::Debug for ResidualProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ResidualProblem")
            .field("blocks", &self.blocks.len())
            .field("families", &self.families.len())
            .field("residuals", &self.residual_count())
            .finish_non_exhaustive()
    }
}

impl ResidualProblem {
    /// An empty builder.
    #[must_use]
    pub fn builder() -> ResidualProblemBuilder {
        ResidualProblemBuilder::default()
    }

    /// The initial values of all blocks, laid out as x.
    #[must_use]
    pub fn initial(&self) -> Vec<f64> {
        let mut x = vec![0.0; self.parameter_len];
        for (block, range) in self.blocks.iter().zip(&self.ranges) {
            x[range.clone()].copy_from_slice(&block.initial);
        }
        x
    }

    /// The ambient coordinates of a block inside x.
    #[must_use]
    pub fn block<'x>(&self, x: &'x [f64], block: BlockId) -> &'x [f64] {
        &x[self.ranges[block.0].clone()]
    }

    /// Where a block's tangent coordinates lie in the gradient; `None` for a constant block.
    #[must_use]
    pub fn tangent_range(&self, block: BlockId) -> Option<std::ops::Range<usize>> {
        let block = &self.blocks[block.0];
        (block.place != Place::Constant).then(|| block.tangent_at..block.tangent_at + block.tangent)
    }

    /// Number of residuals in all families.
    #[must_use]
    pub fn residual_count(&self) -> usize {
        self.families.iter().map(|f| f.residual_count()).sum()
    }

    /// Changes the weight alpha of a family.
    ///
    /// # Errors
    /// If it is negative or not finite.
    pub fn set_weight(&mut self, family: FamilyId, alpha: f64) -> Result<(), OptionError> {
        OptionError::require(alpha >= 0.0 && alpha.is_finite(), "weight", alpha, "finite and not negative")?;
        self.families[family.0].set_weight(alpha);
        Ok(())
    }

    /// Changes the kernel of a family, as a graduated schedule does.
    ///
    /// # Errors
    /// If its scale or exponent is out of bounds.
    pub fn set_kernel(&mut self, family: FamilyId, kernel: Kernel) -> Result<(), OptionError> {
        kernel.validate()?;
        self.families[family.0].set_kernel(Box::new(kernel));
        Ok(())
    }

    /// The residuals of a family, to change their data (not the blocks that they read); `None` if they are not of type `F`.
    pub fn residuals_mut<F: 'static>(&mut self, family: FamilyId) -> Option<&mut [F]> {
        self.families[family.0].residuals_mut().downcast_mut::<Vec<F>>().map(Vec::as_mut_slice)
    }

    /// All residuals and their Jacobian by the tangent coordinates, as of the last linearisation, each row multiplied by the
    /// square root of its weight: `g = J'r` and `H = J'J`. Dense; for diagnostics, covariances and tests.
    #[must_use]
    pub fn weighted_jacobian(&self) -> (Vec<f64>, DMatrix<f64>) {
        let rows: usize = self.families.iter().map(|f| f.residual_count() * f.entries()).sum();
        let mut jacobian = DMatrix::zeros(rows, self.structure.dimension());
        let mut residuals = Vec::with_capacity(rows);
        for (family, layout) in self.families.iter().zip(&self.layouts) {
            let width = layout.starts[layout.starts.len() - 1];
            for (m, ids) in family.blocks().chunks_exact(family.block_count()).enumerate() {
                let (r, j, weight) = family.row(m);
                let root = weight.sqrt();
                for (r, row) in r.iter().zip(j.chunks_exact(width)) {
                    for (k, id) in ids.iter().enumerate() {
                        let Some(range) = self.tangent_range(*id) else { continue };
                        for (c, v) in range.zip(&row[layout.starts[k]..]) {
                            jacobian[(residuals.len(), c)] += root * v;
                        }
                    }
                    residuals.push(root * r);
                }
            }
        }
        (residuals, jacobian)
    }

    /// Adds what one contribution gives to its row: gradient, stored blocks, border part (whose rows are `stride` apart).
    fn contribute(&self, gather: &Gather, c: Contribution, row: &mut Row<'_>) {
        let starts = &self.layouts[c.family as usize].starts;
        let width = starts[starts.len() - 1];
        let (r, j, weight) = self.families[c.family as usize].row(c.residual as usize);
        let own = starts[c.place as usize]..starts[c.place as usize + 1];
        for (r, line) in r.iter().zip(j.chunks_exact(width)) {
            for (g, v) in row.gradient.iter_mut().zip(&line[own.clone()]) {
                *g += weight * v * r;
            }
        }
        for target in &gather.targets[c.first_target as usize..][..c.target_count as usize] {
            let other = starts[target.place as usize]..starts[target.place as usize + 1];
            let (values, stride) = match target.kind {
                TargetKind::Blocks(start) => (&mut row.blocks[start as usize..], other.len()),
                TargetKind::Border(start) => (&mut row.border[start as usize..], row.stride),
            };
            for line in j.chunks_exact(width) {
                for (a, v) in line[own.clone()].iter().enumerate() {
                    let scaled = weight * v;
                    for (h, u) in values[a * stride..].iter_mut().zip(&line[other.clone()]) {
                        *h += scaled * u;
                    }
                }
            }
        }
    }
}

/// The row of a block, borrowed for writing.
struct Row<'a> {
    gradient: &'a mut [f64],
    blocks: &'a mut [f64],
    border: &'a mut [f64],
    stride: usize,
}

impl Problem for ResidualProblem {
    fn structure(&self) -> &Arc<BlockStructure> {
        &self.structure
    }

    fn parameter_len(&self) -> usize {
        self.parameter_len
    }

    fn energy(&mut self, x: &[f64]) -> f64 {
        self.families.iter_mut().map(|family| family.energy(x, &self.ranges)).sum()
    }

    fn linearize(&mut self, x: &[f64], equations: &mut NormalEquations) -> f64 {
        let energy = self.families.iter_mut().map(|family| family.linearize(x, &self.ranges)).sum();
        let problem = &*self;
        let (sparse, border) = (problem.structure.sparse_dimension(), problem.structure.border());
        equations.for_each_block_row(&|i, row| {
            row.blocks.fill(0.0);
            row.cross.fill(0.0);
            row.gradient.fill(0.0);
            let gather = &problem.sparse_gather;
            let mut row = Row { gradient: row.gradient, blocks: row.blocks, border: row.cross, stride: border };
            for &c in &gather.contributions[gather.starts[i]..gather.starts[i + 1]] {
                problem.contribute(gather, c, &mut row);
            }
        });
        equations.border.fill(0.0);
        equations.gradient[sparse..].fill(0.0);
        let gather = &problem.border_gather;
        for (k, &i) in problem.border_blocks.iter().enumerate() {
            let block = &problem.blocks[i];
            let first = block.tangent_at - sparse;
            let mut row = Row {
                gradient: &mut equations.gradient[block.tangent_at..block.tangent_at + block.tangent],
                blocks: &mut [],
                border: &mut equations.border[first * border..(first + block.tangent) * border],
                stride: border,
            };
            for &c in &gather.contributions[gather.starts[k]..gather.starts[k + 1]] {
                problem.contribute(gather, c, &mut row);
            }
        }
        energy
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        for (block, range) in self.blocks.iter().zip(&self.ranges) {
            let (from, to) = (&x[range.clone()], &mut out[range.clone()]);
            if block.place == Place::Constant {
                to.copy_from_slice(from);
            } else {
                (block.move_by)(from, &step[block.tangent_at..block.tangent_at + block.tangent], to);
            }
        }
    }
}

#[cfg(test)]
mod tests;
