//! A scan's texture in the template's texture coordinates: for each texel of the template, what the scan shows there.
//!
//! A texel is a place on the registered template. From there the line along the template's interpolated normal, both ways, meets
//! the scan first at the point whose colour the texel takes; where it meets nothing, the closest point of the scan counts. A point
//! counts only within [`BakeOptions::reach`], where the scan faces the same way (60 degrees at most) and does not end. The colour
//! there is that of the scan's image, or of its vertices. Each texel is the mean of `supersampling` squared samples, in light
//! ([`srgb`](crate::mesh::srgb)); images that are finer than the samples are reduced first (Williams, "Pyramidal parametrics", 1983).
//!
//! Texels that the scan does not show are filled from those round them, coarse to fine (Gortler et al., "The lumigraph", 1996, pull
//! and push), and [`Baked::seen`] tells them apart. Beyond each seam the colours go on, so that none shows when the texture is
//! interpolated or reduced.
//!
//! The shape can be baked as well: the scan's normal in the template's tangent space, and how far along the normal the scan is.
//!
//! Equal inputs give equal bits at any number of threads.

mod atlas;
mod bake;
mod encode;
mod fill;
mod painter;
mod picture;
mod tangents;

pub use bake::{BakeInput, BakeOptions, Baked, bake, check_bake};
pub use encode::{encode_color, encode_displacement, encode_normals, encode_seen};
pub use painter::{PaintError, Painter};
pub use picture::{Picture, PictureKind};

use crate::mesh::MeshError;

/// The side of a texture, texels.
pub const SIDES: std::ops::RangeInclusive<usize> = 16..=8192;

/// Why nothing was baked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BakeError {
    /// A size that makes no sense.
    #[error("a texture of {0} x {0} texels: give from {low} to {high}", low = SIDES.start(), high = SIDES.end())]
    Size(usize),
    /// There is nowhere to bake to.
    #[error(
        "the template has no texture coordinates, so a texture has no place on it; unwrap it (Blender: UV > Smart UV Project) and \
         give a template with UVs, in OBJ or glTF"
    )]
    NoUvs,
    /// None of its triangles covers anything.
    #[error("the template's texture coordinates cover nothing: every triangle is without area there; unwrap it again")]
    FlatUvs,
    /// Points have no surface to be seen on.
    #[error(
        "the scan has no triangles, and only surfaces are baked; make a mesh of the points first (Poisson, ball pivoting)"
    )]
    NoSurface,
    /// Counts that do not belong together.
    #[error("found {found} {what}, expected {expected}")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Geometry that cannot be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}
