//! Morphs by grey masks: Li et al., "Mesh morphing process for facial plastic surgery simulation", 2018.
//!
//! A [`Region`] of the picture becomes a grey [`Texture`], a [`Blur`] softens its rim, a [`Projector`] gives each vertex its
//! [`Weights`], and a [`MorphStep`] moves the vertices. Where a camera would have to be stated, a [`LandmarkFrame`] makes the
//! projector; [`uv_weights`] reads masks painted in the mesh's texture coordinates. Lengths are millimetres.
//!
//! Everything has the same bits at any number of threads.
//!
//! ```
//! use nonrigid::mesh::{TriangleMesh, Vec3};
//! use nonrigid::morph::*;
//! use nonrigid::render::Projection;
//!
//! let mesh = TriangleMesh {
//!     positions: vec![Vec3::new(0., 0., 0.), Vec3::new(90., 0., 0.), Vec3::new(0., 90., 0.)],
//!     triangles: vec![[0, 1, 2]],
//! };
//! let nose = Region::from(Shape::Circle { centre: [64., 64.], radius: 20. });
//! let texture = Blur { kernel: 5, ..Blur::default() }.apply(&nose.rasterize(128, 128, Coordinates::Pixels)?)?;
//! let camera = Projector::look(
//!     Vec3::new(0., 0., 500.), Vec3::zeros(), Vec3::y(), Projection::Orthographic { height: 200. }, 1.0,
//! )?;
//! let weights = camera.weights(&mesh, &texture, Sampling::Bilinear, Visibility::default())?;
//! let pairs = vec![MaskedDisplacement { weights, displacement: Vec3::new(0., 0., 3.) }];
//! let moved = MorphStep { pairs, ..MorphStep::default() }.apply(&mesh.positions)?;
//! assert!(moved[0].z > 2.9 && moved[0].z <= 3.0);
//! assert_eq!(moved[1], mesh.positions[1]);
//! # Ok::<(), MorphError>(())
//! ```

mod blur;
mod change;
mod direct;
mod energy;
mod error;
mod frame;
mod presets;
mod projection;
mod recipe;
mod region;
mod region_format;
mod replay;
mod texture;
mod weights;

pub use blur::{Blur, BlurKind, Border, MAX_KERNEL};
pub use change::MorphChange;
pub use direct::{DEFAULT_THRESHOLD, MaskedDisplacement, MorphStep};
pub use energy::{Constraints, EnergyOptions, EnergyReport, MorphEnergy, MorphModel, PIN_TOLERANCE, PlacedPoint};
pub use error::{MorphError, NO_LANDMARKS};
pub use frame::{FrameScale, FrameSpec, LandmarkFrame};
pub use presets::{preset, preset_names, preset_text};
pub use projection::{Projector, Visibility, uv_weights};
pub use recipe::{MaskSpec, PointSpec, Recipe, RecipeError, RecipeStep, ViewSpec};
pub use region::{Coordinates, DEFAULT_SUB_ROWS, Region, Shape};
pub use replay::{DrawnMask, LiveStep, ReplayOptions, StepOutcome, StepReport, Subject, replay};
pub use texture::{GreyWeights, MAX_TEXTURE_PIXELS, MAX_TEXTURE_SIDE, Sampling, Texture};
pub use weights::Weights;
