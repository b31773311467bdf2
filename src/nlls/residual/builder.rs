//! Blocks and families put together: checked, and laid out as blocks of the equations with what contributes to each.

use std::any::TypeId;
use std::fmt;
use std::sync::Arc;

use super::analytic::AnalyticFamily;
use super::block::{Block, Place};
use super::family::{AnyFamily, Family};
use super::{AnalyticResidual, BlockId, FamilyId, ProblemError, Residual, ResidualProblem};
use crate::nlls::manifold::Manifold;
use crate::nlls::{BlockStructure, BorderBounds, OptionError};

/// How far off its manifold a block may start: rounding to single precision, as of what was read from a file.
const OFF_MANIFOLD: f64 = 1e-6;

/// One block of one residual, seen from the row of `H` that it contributes to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contribution {
    pub family: u32,
    pub residual: u32,
    /// Position of the block in the residual's tuple.
    pub place: u32,
    /// First of its [`Target`]s.
    pub first_target: u32,
    /// Number of its targets.
    pub target_count: u32,
}

/// Where the product of the row's block with another block of the same residual goes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target {
    /// Position of the other block in the residual's tuple.
    pub place: u32,
    pub kind: TargetKind,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum TargetKind {
    /// At this position of the row's stored blocks.
    Blocks(u32),
    /// At this column of the border part.
    Border(u32),
}

/// The contributions to every row of one part (sparse or border), grouped by block.
#[derive(Debug, Default)]
pub(super) struct Gather {
    pub starts: Vec<usize>,
    pub contributions: Vec<Contribution>,
    pub targets: Vec<Target>,
}

/// Offsets of a family's blocks inside its Jacobian rows.
#[derive(Debug)]
pub(super) struct Layout {
    /// `starts[k]..starts[k + 1]` are the columns of block `k`.
    pub starts: Vec<usize>,
}

impl Layout {
    /// Columns of a Jacobian.
    pub fn width(&self) -> usize {
        self.starts[self.starts.len() - 1]
    }
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
            plain: M::PLAIN,
            bounds: None,
            ambient: M::AMBIENT,
            tangent: M::TANGENT,
            initial: initial.to_vec(),
            move_by: |x, step, out| {
                M::plus(x, step, out);
                M::normalize(out);
            },
            contains: M::contains,
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

    /// Holds the coordinates of a block between bounds `lower <= x <= upper`, exactly: every point that a minimiser visits is inside
    /// and a coordinate at a bound equals it bit for bit. Infinities for none. A block between bounds belongs to the dense border
    /// and is moved there, where all blocks must then be [plain](Manifold::PLAIN); [`build`](Self::build) checks that.
    pub fn set_bounds(&mut self, block: BlockId, lower: &[f64], upper: &[f64]) {
        let block = &mut self.blocks[block.0];
        if block.place == Place::Sparse {
            block.place = Place::Border;
        }
        block.bounds = Some([lower.to_vec(), upper.to_vec()]);
    }

    /// Adds residuals that bring their own Jacobians.
    pub fn add_analytic_family<F: AnalyticResidual<K>, const K: usize>(
        &mut self,
        family: AnalyticFamily<F, K>,
    ) -> FamilyId {
        self.families.push(Box::new(family));
        FamilyId(self.families.len() - 1)
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
            for ids in family.common().blocks.chunks_exact(family.block_count()) {
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
                for (.., tangent) in family.manifolds(&blocks) {
                    starts.push(starts[starts.len() - 1] + tangent);
                }
                Layout { starts }
            })
            .collect();
        let sparse_gather = gather(&blocks, &families, &structure, Place::Sparse);
        let border_gather = gather(&blocks, &families, &structure, Place::Border);
        for (family, layout) in families.iter_mut().zip(&layouts) {
            family.prepare(layout.width());
        }
        let bounds = border_bounds(&blocks);
        let ranges = blocks.iter().map(|b| b.ambient_at..b.ambient_at + b.ambient).collect();
        let border_blocks = (0..blocks.len()).filter(|&i| blocks[i].place == Place::Border).collect();
        Ok(ResidualProblem {
            structure: Arc::new(structure),
            parameter_len: ambient,
            blocks,
            ranges,
            border_blocks,
            bounds,
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
        if !(block.contains)(&block.initial, OFF_MANIFOLD) {
            return Err(ProblemError::OffManifold { block: i, manifold: block.name, found: block.initial.clone() });
        }
    }
    if let Some((block, b)) = blocks.iter().enumerate().find(|(_, b)| b.bounds.is_some() && !b.plain) {
        return Err(ProblemError::BoundsOnManifold { block, manifold: b.name });
    }
    // The border's bounds count its coordinates in x.
    let border = || blocks.iter().enumerate().filter(|(_, b)| b.place == Place::Border);
    if border().any(|(_, b)| b.bounds.is_some())
        && let Some((block, b)) = border().find(|(_, b)| !b.plain)
    {
        return Err(ProblemError::ManifoldBesideBounds { block, manifold: b.name });
    }
    for (block, b) in blocks.iter().enumerate() {
        let Some([lower, upper]) = &b.bounds else { continue };
        BorderBounds { first: 0, lower, upper }
            .validate(b.ambient, b.ambient)
            .map_err(|source| ProblemError::Bounds { block, source })?;
        let inside = b.initial.iter().zip(lower.iter().zip(upper)).all(|(x, (l, u))| l <= x && x <= u);
        if b.place == Place::Constant && !inside {
            return Err(ProblemError::ConstantOutOfBounds { block });
        }
    }
    Ok(())
}

/// Lower and upper bounds of all coordinates of the border, if any has some.
fn border_bounds(blocks: &[Block]) -> Option<[Vec<f64>; 2]> {
    let border = || blocks.iter().filter(|b| b.place == Place::Border);
    border().any(|b| b.bounds.is_some()).then(|| {
        [(0, f64::NEG_INFINITY), (1, f64::INFINITY)].map(|(side, none)| {
            border()
                .flat_map(|b| b.bounds.as_ref().map_or_else(|| vec![none; b.ambient], |bounds| bounds[side].clone()))
                .collect()
        })
    })
}

fn check_family(f: usize, family: &dyn AnyFamily, blocks: &[Block]) -> Result<(), ProblemError> {
    let (residuals, block_lists) = (family.residual_count(), family.common().block_lists);
    if residuals != block_lists {
        return Err(ProblemError::LengthMismatch { family: f, residuals, block_lists });
    }
    let alpha = family.common().weight;
    OptionError::require(alpha >= 0.0 && alpha.is_finite(), "weight", alpha, "finite and not negative")
        .and_then(|()| family.common().kernel.validate())
        .map_err(|source| ProblemError::Setting { family: f, source })?;
    let manifolds = family.manifolds(blocks);
    for (m, ids) in family.common().blocks.chunks_exact(family.block_count()).enumerate() {
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
        for (m, ids) in family.common().blocks.chunks_exact(family.block_count()).enumerate() {
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
