//! A deformation model from its formula alone: state `v_i(p)`, and dual numbers do the rest.

use rayon::prelude::*;

use self::assembly::{Formula, FormulaAssembly, Supports};
use super::factory::{RegistrationModel, SmoothLevel};
use crate::energy::{DeformationModel, NamedEnergy, Options, OptionsError, Quadric, QuadricField, Samples};
use crate::mesh::Vec3;
use crate::nlls::{Assembly, BlockStructure, Manifold, NormalEquations, Scalar};

mod assembly;

/// Where vertices go, as a function of parameter blocks, stated once for any dual number. [`Autodiff`] makes a
/// [`DeformationModel`] of it: sparsity, derivatives and normal equations follow from what is stated here.
///
/// All blocks are of one type: plain vectors ([`Euclidean`](crate::nlls::Euclidean)), rigid motions
/// ([`Se3`](crate::nlls::Se3)), or a manifold of your own. Blocks of one number each state any vector of parameters.
///
/// ```
/// use nonrigid::energy::DeformationModel;
/// use nonrigid::mesh::Vec3;
/// use nonrigid::model::{Autodiff, PositionFunction};
/// use nonrigid::nlls::{Euclidean, Scalar};
///
/// /// Twist about the y axis: one angle per end, in between they blend.
/// struct Twist { rest: Vec<Vec3>, bottom: f64, top: f64 }
///
/// impl PositionFunction for Twist {
///     type Block = Euclidean<1>;
///
///     fn name(&self) -> &'static str { "twist" }
///     fn rest_blocks(&self) -> Vec<[f64; 1]> { vec![[0.0]; 2] }
///     fn vertex_blocks(&self) -> Vec<Vec<usize>> { vec![vec![0, 1]; self.rest.len()] }
///
///     fn position<D: Scalar>(&self, vertex: usize, p: &[[D; 1]]) -> [D; 3] {
///         let n = self.rest[vertex];
///         let up = (n.y - self.bottom) / (self.top - self.bottom);
///         let (sin, cos) = (p[0][0] * (1.0 - up) + p[1][0] * up).sin_cos();
///         [cos * n.x + sin * n.z, D::from(n.y), cos * n.z - sin * n.x]
///     }
/// }
///
/// let rest = vec![Vec3::zeros(), Vec3::new(1.0, 2.0, 0.0)];
/// let mut model = Autodiff::new(Twist { rest, bottom: 0.0, top: 2.0 }).unwrap();
/// let mut vertices = Vec::new();
/// model.positions(&[0.0, std::f64::consts::FRAC_PI_2], &mut vertices);
/// assert!((vertices[1] - Vec3::new(0.0, 2.0, -1.0)).norm() < 1e-15);
/// ```
///
/// `examples/own_model.rs` is a free-form deformation lattice, registered to scans next to the models that come with the crate.
pub trait PositionFunction: Send + Sync {
    /// What a parameter block is.
    type Block: Manifold;

    /// Name in reports.
    fn name(&self) -> &'static str;

    /// The blocks of the undeformed rest shape; their number is the number of blocks.
    fn rest_blocks(&self) -> Vec<Point<Self, f64>>;

    /// For each vertex, the blocks that move it, in the order in which [`position`](Self::position) takes them. Asked once.
    /// Vertices with equal lists are assembled together, as those in one cell of a lattice.
    fn vertex_blocks(&self) -> Vec<Vec<usize>>;

    /// Position of a vertex, millimetres, for the blocks `p` of [`vertex_blocks`](Self::vertex_blocks).
    fn position<D: Scalar>(&self, vertex: usize, p: &[Point<Self, D>]) -> [D; 3];

    /// The blocks of each residual of the regulariser `lambda_smooth sum_m |r_m|^2`. Asked once; none by default. A block
    /// that neither a vertex nor a residual names is observed by nothing and needs a damping floor
    /// ([`Options::damping_floor`](crate::nlls::Options::damping_floor)) to stay where it is; registration has one.
    fn smoothness_blocks(&self) -> Vec<Vec<usize>> {
        Vec::new()
    }

    /// Residual `m` of the regulariser, for the blocks `p` of [`smoothness_blocks`](Self::smoothness_blocks). A shorter one
    /// leaves entries zero, a longer one is several.
    ///
    /// # Panics
    /// Unless it is overridden together with `smoothness_blocks`.
    fn smoothness<D: Scalar>(&self, m: usize, _p: &[Point<Self, D>]) -> [D; 3] {
        panic!("{}: smoothness_blocks states residual {m}, smoothness does not", self.name())
    }
}

/// One parameter block of `F`, in numbers `D`.
pub type Point<F, D> = <<F as PositionFunction>::Block as Manifold>::Point<D>;

/// Why a stated model is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AutodiffError {
    /// A vertex or residual names a block that does not exist.
    #[error("{model}: {what} {index} names block {block}, but there are {blocks} blocks")]
    BlockOutOfRange {
        /// The model's name.
        model: &'static str,
        /// "vertex" or "smoothness residual".
        what: &'static str,
        /// Its index.
        index: usize,
        /// The block asked for.
        block: usize,
        /// Number of blocks.
        blocks: usize,
    },
}

/// The deformation model that a [`PositionFunction`] states. Derivatives are forward-mode, in strides of 16 duals over the
/// blocks of a vertex.
///
/// ```text
///     E_smooth = lambda_smooth sum_m |r_m(p)|^2
/// ```
pub struct Autodiff<F: PositionFunction> {
    function: F,
    /// `lambda_smooth`; a registration sets it from [`SmoothLevel`].
    pub stiffness: f64,
    rest: Vec<f64>,
    vertices: Supports,
    residuals: Supports,
    data: FormulaAssembly<F::Block>,
    smooth: FormulaAssembly<F::Block>,
    values: Vec<Vec3>,
    /// Blocks gathered for vertices, and for residuals.
    gathered: [Vec<Vec<Point<F, f64>>>; 2],
}

impl<F: PositionFunction> Autodiff<F> {
    /// The model of `function`, with `lambda_smooth` one.
    ///
    /// # Errors
    /// When a vertex or residual names a block that does not exist.
    pub fn new(function: F) -> Result<Self, AutodiffError> {
        let blocks = function.rest_blocks();
        let rest: Vec<f64> = blocks.iter().flat_map(|b| b.as_ref().to_vec()).collect();
        let checked = |what, lists: &[Vec<usize>]| {
            let (model, blocks) = (function.name(), blocks.len());
            Supports::new(lists, blocks).map_err(|(index, block)| AutodiffError::BlockOutOfRange {
                model,
                what,
                index,
                block,
                blocks,
            })
        };
        let vertices = checked("vertex", &function.vertex_blocks())?;
        let residuals = checked("smoothness residual", &function.smoothness_blocks())?;
        let smooth = FormulaAssembly::new(&residuals, (0..residuals.len()).map(|m| vec![(m as u32, 1.0)]));
        let data = FormulaAssembly::new(&vertices, std::iter::empty());
        let (values, gathered) = (Vec::new(), [Vec::new(), Vec::new()]);
        Ok(Self { function, stiffness: 1.0, rest, vertices, residuals, data, smooth, values, gathered })
    }

    /// What was stated.
    #[must_use]
    pub fn function(&self) -> &F {
        &self.function
    }

    fn block_count(&self) -> usize {
        self.rest.len() / F::Block::AMBIENT
    }
}

struct Positions<'a, F>(&'a F);

impl<F: PositionFunction> Formula<F::Block> for Positions<'_, F> {
    #[inline(always)]
    fn evaluate<D: Scalar>(&self, index: usize, p: &[Point<F, D>]) -> [D; 3] {
        self.0.position(index, p)
    }
}

struct Residuals<'a, F>(&'a F);

impl<F: PositionFunction> Formula<F::Block> for Residuals<'_, F> {
    #[inline(always)]
    fn evaluate<D: Scalar>(&self, index: usize, p: &[Point<F, D>]) -> [D; 3] {
        self.0.smoothness(index, p)
    }
}

impl<F: PositionFunction> DeformationModel for Autodiff<F> {
    fn name(&self) -> &'static str {
        self.function.name()
    }

    fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    fn parameter_len(&self) -> usize {
        self.rest.len()
    }

    fn rest_parameters(&self) -> Vec<f64> {
        self.rest.clone()
    }

    fn analyse(&mut self, samples: &Samples) -> BlockStructure {
        assert_eq!(samples.vertex_count(), self.vertex_count(), "samples were made for another template");
        self.data = FormulaAssembly::new(&self.vertices, (0..samples.len()).map(|s| samples.corners(s).to_vec()));
        let pairs = Assembly::pairs(self.data.items().chain(self.smooth.items()));
        let structure = BlockStructure::new(&vec![F::Block::TANGENT; self.block_count()], pairs, 0)
            .expect("proven: every block was checked when the model was made");
        self.data.analyse(&structure);
        self.smooth.analyse(&structure);
        structure
    }

    fn positions(&mut self, x: &[f64], out: &mut Vec<Vec3>) {
        self.vertices.evaluate(&Positions(&self.function), x, &mut self.gathered[0], out);
    }

    fn pull_back(&mut self, x: &[f64], field: &QuadricField, equations: &mut NormalEquations) {
        let quadrics = field.quadrics();
        self.data.linearize(&Positions(&self.function), &self.vertices, x, &|s, _| quadrics[s]);
        self.data.add_to(equations);
    }

    fn regulariser_energy(&mut self, x: &[f64], out: &mut Vec<NamedEnergy>) {
        if self.residuals.len() > 0 {
            self.residuals.evaluate(&Residuals(&self.function), x, &mut self.gathered[1], &mut self.values);
            out.push(("smoothness", self.stiffness * self.values.iter().map(Vec3::norm_squared).sum::<f64>()));
        }
    }

    fn regularise(&mut self, x: &[f64], equations: &mut NormalEquations) {
        let stiffness = self.stiffness;
        // |r|^2 is the quadric of a sample at r with M = I.
        self.smooth.linearize(&Residuals(&self.function), &self.residuals, x, &|_, r| {
            let mut quadric = Quadric::default();
            for a in 0..3 {
                quadric.add(stiffness, std::array::from_fn(|b| f64::from(a == b)), r[a]);
            }
            quadric
        });
        self.smooth.add_to(equations);
    }

    fn retract(&self, x: &[f64], step: &[f64], out: &mut [f64]) {
        let (ambient, tangent) = (F::Block::AMBIENT, F::Block::TANGENT);
        out.par_chunks_mut(ambient).enumerate().for_each(|(j, out)| {
            F::Block::plus(&x[j * ambient..(j + 1) * ambient], &step[j * tangent..(j + 1) * tangent], out);
            F::Block::normalize(out);
        });
    }
}

impl<F: PositionFunction> RegistrationModel for Autodiff<F> {
    fn set_level(&mut self, options: &Options, _unit: f64) -> Result<(), OptionsError> {
        self.stiffness = options.read::<SmoothLevel>()?.lambda_smooth;
        Ok(())
    }
}
