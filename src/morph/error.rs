//! What makes a mask or a morph impossible.

use crate::mesh::MeshError;
use crate::model::ModelError;
use crate::render::CameraError;

/// A mask, or what it is to move, cannot be computed with.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MorphError {
    /// A texture without pixels, or with more than can be addressed.
    #[error(
        "a texture of {width} x {height} pixels; both must be from 1 to {}, their product at most {}",
        super::MAX_TEXTURE_SIDE,
        super::MAX_TEXTURE_PIXELS
    )]
    TextureSize {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// Grey values that do not fill the texture.
    #[error("{found} grey values for a texture of {width} x {height} pixels")]
    TextureLength {
        /// Number of values.
        found: usize,
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// A grey value is NaN or outside 0..=1.
    #[error("pixel {x}, {y} (from the top left) has the grey value {value}, expected 0 to 1")]
    GreyValue {
        /// Column.
        x: usize,
        /// Row, from the top.
        y: usize,
        /// The value.
        value: f64,
    },
    /// A number of a shape is NaN, infinite or out of its range.
    #[error("{shape}: {what} is {value}, expected {expected}")]
    Shape {
        /// Kind of the shape.
        shape: &'static str,
        /// Which number.
        what: &'static str,
        /// The number.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A polygon without rings, or a ring that encloses nothing.
    #[error("polygon: ring {ring} has {points} points, expected at least 3 that are not on one line")]
    EmptyPolygon {
        /// Index of the ring; 0 if there is none.
        ring: usize,
        /// Number of its points.
        points: usize,
    },
    /// The box that a texture covers has no area or is not finite.
    #[error(
        "the texture covers {low:?} to {high:?}; expected corners within 1e9, the second above the first on both axes"
    )]
    Covered {
        /// Lower corner.
        low: [f64; 2],
        /// Upper corner.
        high: [f64; 2],
    },
    /// Sub-rows to a pixel out of range.
    #[error("{found} sub-rows a pixel, expected 1 to 1024")]
    SubRows {
        /// What was asked for.
        found: usize,
    },
    /// A kernel without a middle, or beyond the limit.
    #[error("a blur kernel of {size} x {size} pixels; its side must be odd and at most {}", super::MAX_KERNEL)]
    Kernel {
        /// Side, pixels.
        size: usize,
    },
    /// The width of a Gaussian is not a positive number.
    #[error("the Gaussian's sigma is {sigma} pixels, expected a positive number")]
    Sigma {
        /// The width, pixels.
        sigma: f64,
    },
    /// A matrix has an entry that is not finite, or cannot be inverted.
    #[error("the projection's matrix is singular or not finite: {0}")]
    Matrix(String),
    /// A camera that looks nowhere.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Something is given in the frame of landmarks, and there is none.
    #[error("this needs the frame of landmarks: give the recipe a frame")]
    NoFrame,
    /// A frame whose z points into the face.
    #[error(
        "the frame of landmarks points into the face: the mesh is mirrored, or left and right of its landmarks are swapped"
    )]
    Mirrored,
    /// A picture in the frame of landmarks that does not say what it covers.
    #[error(
        "a picture in the frame of landmarks must say what it covers: view = {{ frame = {{ covers = [[x, y], [x, y]] }} }}"
    )]
    NoCover,
    /// A part that the rig or mesh does not have.
    #[error("{0}")]
    Parts(String),
    /// The result cannot be judged.
    #[error("{0}")]
    Evaluation(String),
    /// No mask lifts a vertex above the threshold, or all that it lifts are protected.
    #[error("nothing is left to move: no vertex has a weight above the threshold")]
    NothingMoves,
    /// A model that does not minimise anything, and a step that asks for it.
    #[error("the direct model has no energy: goals, pins and free masks need another model")]
    NoEnergy,
    /// Blendshapes that a model needs and that are missing, or another mesh's.
    #[error("model {model} needs blendshapes of {vertices} vertices, found {found}")]
    Shapes {
        /// The model.
        model: String,
        /// Vertices of the shapes; 0 without shapes.
        found: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// A pin or a goal that no vertex could follow.
    #[error("{0:?} is to move, but lies where every vertex is held: outside the masks, or protected")]
    PointHeld(String),
    /// A point that is not one of the mesh.
    #[error("{name:?}: {error}")]
    Point {
        /// Name of the point.
        name: String,
        /// What is wrong with it.
        error: String,
    },
    /// A target that is not finite.
    #[error("{name:?} has the target {target:?}, expected finite coordinates")]
    Target {
        /// Name of the point.
        name: String,
        /// The target.
        target: [f64; 3],
    },
    /// A point pinned to two places.
    #[error("{0:?} is pinned to two places")]
    PinnedTwice(String),
    /// What the model can do does not reach a pin.
    #[error("pin {name:?} is out of the model's reach: {distance:.3e} mm are left")]
    PinOutOfReach {
        /// The pin farthest off.
        name: String,
        /// Its distance, millimetres.
        distance: f64,
    },
    /// The minimiser gave up.
    #[error("the energy could not be minimised: {0}")]
    Minimizer(String),
    /// The mesh, or the positions.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The model cannot be built on the part that moves.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A corner of a polygon indexes past the vertices.
    #[error("corner {corner} has vertex index {index}, expected one below {count}")]
    CornerVertex {
        /// Index of the polygon corner.
        corner: usize,
        /// The offending index.
        index: u32,
        /// Number of vertices.
        count: usize,
    },
    /// A mesh without texture coordinates cannot take a mask in them.
    #[error("the mesh has no texture coordinates, so a mask in UV space says nothing about its vertices")]
    NoTextureCoordinates,
    /// A texture coordinate that does not exist or is not finite.
    #[error("corner {corner} has the texture coordinate {index} of {count}, expected the index of a finite one")]
    TextureCoordinate {
        /// Index of the polygon corner.
        corner: usize,
        /// Index of the coordinate.
        index: u32,
        /// Number of coordinates.
        count: usize,
    },
    /// No landmark of that name.
    #[error("there is no landmark {name:?}; known landmarks: {known}")]
    UnknownLandmark {
        /// The name.
        name: String,
        /// Those there are, or "none".
        known: String,
    },
    /// Landmarks that span no frame.
    #[error("the landmarks span no frame: {0}")]
    Frame(&'static str),
    /// Weights that do not belong to the vertices.
    #[error("{found} weights for {vertices} vertices")]
    WeightCount {
        /// Number of weights.
        found: usize,
        /// Number of vertices.
        vertices: usize,
    },
    /// A weight is NaN or outside 0..=1.
    #[error("vertex {vertex} has the weight {value}, expected 0 to 1")]
    WeightValue {
        /// Index of the vertex.
        vertex: usize,
        /// The weight.
        value: f64,
    },
    /// An option is NaN or out of its range.
    #[error("{what} is {value}, expected {expected}")]
    Option {
        /// Which option.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A displacement is NaN or infinite.
    #[error("displacement {index} is {displacement:?}, expected finite millimetres")]
    Displacement {
        /// Which of the step's pairs.
        index: usize,
        /// Its vector.
        displacement: [f64; 3],
    },
    /// A buffer of another size than the positions.
    #[error("a buffer for {found} positions, expected {vertices}")]
    BufferLength {
        /// Its length.
        found: usize,
        /// Number of vertices.
        vertices: usize,
    },
    /// No triangle to measure on.
    #[error("the mesh has no surface: without triangles, painted weights have no mirror image")]
    NoSurface,
    /// A picture and a mask of different sizes.
    #[error("a picture of {picture:?} pixels under a mask of {mask:?}; both must be of one size")]
    OverlaySize {
        /// Width and height of the picture.
        picture: [usize; 2],
        /// Width and height of the mask.
        mask: [usize; 2],
    },
}

/// What stands for the known landmarks in [`MorphError::UnknownLandmark`] where there are none.
pub const NO_LANDMARKS: &str = "none";

impl MorphError {
    /// Whether what was given is at fault, not the computation.
    #[must_use]
    pub fn is_input(&self) -> bool {
        !matches!(
            self,
            Self::NothingMoves
                | Self::PinOutOfReach { .. }
                | Self::Minimizer(_)
                | Self::Evaluation(_)
                | Self::Mesh(_)
                | Self::Model(_)
        )
    }

    pub(super) fn unknown_landmark<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Self {
        let known = known.collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { NO_LANDMARKS.to_owned() } else { known };
        Self::UnknownLandmark { name: name.to_owned(), known }
    }
}
