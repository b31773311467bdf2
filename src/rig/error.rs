//! What can be wrong with a rig, and what is merely odd.

use std::fmt;

use super::Unlike;
use crate::io::ReadError;

/// A rig cannot be read or used.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// A file is missing or malformed.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something has another number of vertices than the neutral.
    #[error("{what}: found {found} vertices, expected {expected}")]
    VertexCount {
        /// A file or a part of the rig.
        what: String,
        /// Its number of vertices.
        found: usize,
        /// That of the neutral.
        expected: usize,
    },
    /// An array has another number of shapes than its list of names.
    #[error("{array}: found {found} shapes, expected {expected}, as many as names in {names}")]
    NameCount {
        /// The array's file.
        array: String,
        /// Shapes in it.
        found: usize,
        /// The names' file.
        names: String,
        /// Names in it.
        expected: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("{what}: vertex {vertex} is not finite")]
    NotFinite {
        /// A file or a part of the rig.
        what: String,
        /// Index of the vertex.
        vertex: usize,
    },
    /// A displacement is absurdly long.
    #[error(
        "shape {shape:?} moves vertex {vertex} by {displacement:?}, the neutral is {size:.6} across; mend the shape or leave it out"
    )]
    Displacement {
        /// The shape.
        shape: String,
        /// Index of the vertex.
        vertex: usize,
        /// Where it goes.
        displacement: [f64; 3],
        /// Diagonal of the neutral's box.
        size: f64,
    },
    /// A name is too long for one.
    #[error("shape {name:?} has a name of more than {} letters", crate::text::LONGEST_NAME)]
    LongName {
        /// Its beginning.
        name: String,
    },
    /// A shape is there twice, or asked for twice.
    #[error("shape {name:?} is named twice, expected every shape once")]
    DuplicateName {
        /// The shape.
        name: String,
    },
    /// No shape of that name.
    #[error("no shape {name:?} in the rig; did you mean {closest:?}? It has: {known}")]
    UnknownShape {
        /// What was asked for.
        name: String,
        /// The most similar name.
        closest: String,
        /// All names.
        known: String,
    },
    /// The shape was dropped when the rig was read.
    #[error("shape {name:?} moves nothing and cannot be fitted; leave it out")]
    MotionlessShape {
        /// What was asked for.
        name: String,
    },
    /// No region of that name.
    #[error("no region {name:?}; known regions: {known}")]
    UnknownRegion {
        /// What was asked for.
        name: String,
        /// All names.
        known: String,
    },
    /// No weight lies between the bounds, or the regularisation is negative.
    #[error(
        "bounds of the weights {bounds:?} and regularisation {regularisation}: expected two numbers in order and one from 0"
    )]
    Weights {
        /// Lower and upper.
        bounds: [f64; 2],
        /// Share of the largest squared shape.
        regularisation: f64,
    },
    /// Weights of a mesh were not found.
    #[error("the weights cannot be found: {reason}")]
    Fit {
        /// Why.
        reason: String,
    },
    /// A mesh has not the vertices of the rig or of another mesh, in their order.
    #[error("{what} is no mesh of {of}: {}", why.told(of))]
    Unlike {
        /// The mesh.
        what: &'static str,
        /// The rig, or the other mesh.
        of: &'static str,
        /// What was seen.
        why: Unlike,
    },
    /// A file of a folder of meshes holds no shape of the neutral.
    #[error(
        "shape {name:?} is none of this rig: {why}; whether the folder's files are whole shapes or differences to the neutral, its \
         rig.json says: {{\"kind\": \"full\"}}, {{\"kind\": \"delta\"}}"
    )]
    ShapeUnlike {
        /// The shape.
        name: String,
        /// What was seen.
        why: Unlike,
    },
    /// Fewer identity modes than asked for.
    #[error("{asked} identity modes asked for, the rig has {found}")]
    IdentityModes {
        /// Asked for.
        asked: usize,
        /// In the rig.
        found: usize,
    },
}

/// Something odd about a rig that does not keep it from being used.
#[derive(Debug, Clone, PartialEq)]
pub enum RigWarning {
    /// A shape moves nothing and was dropped.
    Motionless {
        /// The shape.
        name: String,
    },
    /// A mesh looks as if it had not the vertices of the rig or of another mesh.
    Unlike {
        /// The mesh.
        what: &'static str,
        /// The rig, or the other mesh.
        of: &'static str,
        /// What was seen.
        why: Unlike,
    },
    /// A shape looks as if it were none of the neutral's.
    ShapeUnlike {
        /// The shape.
        name: String,
        /// What was seen.
        why: Unlike,
    },
    /// The neutral array and the polygon mesh disagree about where the vertices are; the array is used.
    NeutralDiffers {
        /// The largest distance, millimetres.
        distance: f64,
    },
    /// A subject that should be neutral has an expression.
    NotNeutral {
        /// The shape.
        name: String,
        /// Its weight.
        weight: f64,
        /// How far it moves the subject at most, millimetres.
        by: f64,
    },
    /// An archive has arrays that are none of a rig's.
    UnreadArrays {
        /// Their names.
        names: Vec<String>,
    },
}

impl fmt::Display for RigWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unlike { what, of, why } => write!(f, "{what} is an odd mesh for {of}: {}", why.told(of)),
            Self::ShapeUnlike { name, why } => write!(f, "shape {name:?} is an odd one of this rig: {why}"),
            Self::Motionless { name } => write!(f, "shape {name:?} moves nothing and was left out"),
            Self::NeutralDiffers { distance } => {
                write!(f, "neutral.npy and the template mesh differ by up to {distance:.3} mm; neutral.npy is used")
            }
            Self::NotNeutral { name, weight, by } => write!(
                f,
                "the subject looks like {name:?} of {weight:.2}, which moves it by {by:.0} mm: shapes are to begin at a neutral face, mouth closed \
                 and eyes open"
            ),
            Self::UnreadArrays { names } => write!(
                f,
                "not read are arrays that no rig has: {}; polygons are polygon_starts and corners, texture coordinates uvs and corner_uvs",
                names.join(", ")
            ),
        }
    }
}
