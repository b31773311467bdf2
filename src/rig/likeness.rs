//! Whether a mesh has the vertices of a rig in the rig's order: what transfers and fits rest on, and nothing else tells.
//!
//! Faces of one topology differ from a neutral, posed and scaled onto them, by a tenth of their size or less, mouths wide open by a sixth.
//! A mesh whose vertices are in another order, a mirror image, a flat or a collapsed mesh differ by far more, or by other signs.

use std::fmt;

use nalgebra::{Matrix3, Rotation3, SymmetricEigen};

use super::{Rig, RigError, RigWarning, ShapeBasis, ShapeSelection};
use crate::mesh::normals::face_cross;
use crate::mesh::{PolygonMesh, Pose, PoseKind, Vec3, bounding_box_diagonal, closest_pose, spikes};

/// Root mean square distance from the posed neutral, as a share of the size, above which a mesh is doubtful, and is refused.
const FAR: [f64; 2] = [0.2, 0.6];
/// The same from what the rig's shapes make of it, above which it is doubtful.
const UNEXPLAINED: f64 = 0.15;
/// The same where the neutral's mirror image comes at least twice as close.
const MIRRORED: f64 = 0.1;
/// Thickness, as a share of the neutral's, below which a mesh is flat.
const FLAT: f64 = 0.2;
/// Shares of triangles without area above which a mesh is doubtful, and is refused; and a triangle's least share of its area on the
/// posed neutral.
const COLLAPSED: [f64; 2] = [0.01, 0.1];
const LEAST_AREA: f64 = 1e-4;
/// Shares of triangles that face backwards.
const FOLDED: [f64; 2] = [0.02, 0.25];
/// How far a vertex stands out at least, as a share of the size, to be a [spike](spikes).
const SPIKE: f64 = 0.15;
/// A shift, as a share of the bounding box's diagonal, beyond which a shape stands beside the neutral, if what it moves besides is less
/// than a share of the shift.
const BESIDE: f64 = 0.5;
const APART: f64 = 0.25;
/// Sizes, as a share of the neutral's, beyond which a unit is likely to be wrong.
const SIZES: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// What a mesh shows that no mesh with a rig's vertices should.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unlike {
    /// Its vertices are elsewhere.
    Far {
        /// Root mean square distance from the posed neutral, millimetres.
        rms: f64,
        /// Root mean square distance from the centroid, millimetres.
        size: f64,
    },
    /// What the rig's shapes make of it is elsewhere.
    Unexplained {
        /// Root mean square distance, millimetres.
        rms: f64,
        /// Root mean square distance from the centroid, millimetres.
        size: f64,
    },
    /// It is the neutral's mirror image.
    Mirrored {
        /// As in [`Unlike::Far`].
        rms: f64,
        /// The same of the mirror image.
        mirrored: f64,
    },
    /// It is flat, and the neutral is not.
    Flat {
        /// Smallest deviation along any axis, as a share of the size.
        thickness: f64,
        /// That of the neutral.
        neutral: f64,
    },
    /// Triangles have no area.
    Collapsed {
        /// How many.
        triangles: usize,
        /// Of so many that have one on the neutral.
        of: usize,
    },
    /// Triangles face backwards.
    Folded {
        /// How many.
        triangles: usize,
        /// Of so many.
        of: usize,
    },
    /// Vertices stand out from their neighbours.
    Spiked {
        /// How many.
        vertices: usize,
    },
    /// It stands beside the neutral, as targets that are set out in a row do.
    Beside {
        /// Distance of their middles, millimetres.
        shift: f64,
    },
    /// It is of another size.
    Size {
        /// Times the neutral's.
        factor: f64,
    },
}

impl fmt::Display for Unlike {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Far { rms, size } => write!(
                f,
                "its vertices are {rms:.1} mm rms from those of the neutral, posed onto it, and {size:.1} mm rms from \
                 their own middle: give a mesh with the rig's vertices in the rig's order, as `nonrigid register` writes it"
            ),
            Self::Unexplained { rms, size } => write!(
                f,
                "the rig explains its vertices to {rms:.1} mm rms only, and they are {size:.1} mm rms from their own middle: give meshes \
                 with the rig's vertices in the rig's order, and the subject's own neutral"
            ),
            Self::Mirrored { rms, mirrored } => write!(
                f,
                "it is a mirror image: {rms:.1} mm rms from the neutral, posed onto it, but {mirrored:.1} mm from the neutral's mirror \
                 image: mirror it back"
            ),
            Self::Flat { thickness, neutral } => write!(
                f,
                "it is flat: {:.1} % of its size thick, the neutral {:.1} %: give the whole surface, not a projection",
                100.0 * thickness,
                100.0 * neutral
            ),
            Self::Collapsed { triangles, of } => write!(
                f,
                "{triangles} of its {of} triangles have no area: vertices have fallen together; look at the mesh"
            ),
            Self::Folded { triangles, of } => {
                write!(f, "{triangles} of its {of} triangles face backwards; look at the mesh")
            }
            Self::Spiked { vertices } => {
                write!(f, "{vertices} of its vertices stand out from their neighbours like spikes; look at the mesh")
            }
            Self::Beside { shift } => {
                write!(f, "it stands {shift:.1} mm beside the neutral, as a whole: move it to where the neutral is")
            }
            Self::Size { factor } => {
                write!(f, "it is {factor:.2} times as large as the neutral; if that is not so, state its unit")
            }
        }
    }
}

impl Unlike {
    /// In words, where the vertices are to be those `of` a rig or another mesh.
    pub(super) fn told(&self, of: &str) -> String {
        let of_rig = self.to_string();
        if of == OF_RIG { of_rig } else { of_rig.replace("the rig", of).replace("the neutral", of) }
    }
}

/// What to doubt of a mesh, and how the neutral is posed onto it, unless either has no extent.
pub(super) struct Likeness {
    pub doubts: Vec<Unlike>,
    pub pose: Option<Pose>,
}

/// Compares a mesh of `points` with a neutral of as many vertices, or says why it cannot be used.
pub(super) fn compare(neutral: &[Vec3], triangles: &[[u32; 3]], points: &[Vec3]) -> Result<Likeness, Unlike> {
    let pairs: Vec<(Vec3, Vec3)> = neutral.iter().copied().zip(points.iter().copied()).collect();
    let flipped: Vec<(Vec3, Vec3)> = pairs.iter().map(|(p, q)| (Vec3::new(-p.x, p.y, p.z), *q)).collect();
    let (Ok(pose), Ok(mirror)) =
        (closest_pose(&pairs, PoseKind::Similarity), closest_pose(&flipped, PoseKind::Similarity))
    else {
        return Ok(Likeness { doubts: Vec::new(), pose: None });
    };
    let mut doubts = Vec::new();
    let ([size, thickness], [neutral_size, neutral_thickness]) = (spread(points), spread(neutral));
    if thickness < FLAT * neutral_thickness {
        return Err(Unlike::Flat { thickness, neutral: neutral_thickness });
    }
    let posed: Vec<Vec3> = neutral.iter().map(|p| pose.apply(*p)).collect();
    let (of, collapsed, folded) = triangles.iter().fold((0, 0, 0), |(of, collapsed, folded), t| {
        let (a, b) = (face_cross(&posed, *t), face_cross(points, *t));
        // what has no area on the neutral says nothing
        if a.norm() <= LEAST_AREA * LEAST_AREA * size * size {
            return (of, collapsed, folded);
        }
        (of + 1, collapsed + usize::from(b.norm() < LEAST_AREA * a.norm()), folded + usize::from(a.dot(&b) < 0.0))
    });
    let share = |count: usize| count as f64 / of.max(1) as f64;
    if share(collapsed) > COLLAPSED[1] {
        return Err(Unlike::Collapsed { triangles: collapsed, of });
    }
    let rms = |pose: &Pose, pairs: &[(Vec3, Vec3)]| {
        (pairs.iter().map(|(p, q)| (pose.apply(*p) - q).norm_squared()).sum::<f64>() / pairs.len() as f64).sqrt()
    };
    let (far, mirrored) = (rms(&pose, &pairs), rms(&mirror, &flipped));
    if far > MIRRORED * size && 2.0 * mirrored < far {
        return Err(Unlike::Mirrored { rms: far, mirrored });
    }
    if far > FAR[1] * size {
        return Err(Unlike::Far { rms: far, size });
    }
    if share(folded) > FOLDED[1] {
        return Err(Unlike::Folded { triangles: folded, of });
    }
    if far > FAR[0] * size {
        doubts.push(Unlike::Far { rms: far, size });
    }
    if share(collapsed) > COLLAPSED[0] {
        doubts.push(Unlike::Collapsed { triangles: collapsed, of });
    }
    if share(folded) > FOLDED[0] {
        doubts.push(Unlike::Folded { triangles: folded, of });
    }
    let sides = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    match spikes(sides, &posed, points, SPIKE * size) {
        0 => {}
        vertices => doubts.push(Unlike::Spiked { vertices }),
    }
    if !SIZES.contains(&(size / neutral_size)) {
        doubts.push(Unlike::Size { factor: size / neutral_size });
    }
    Ok(Likeness { doubts, pose: Some(pose) })
}

/// That a shape stands beside the neutral: its middle is far away, and what it moves apart from that is little. Shapes that move
/// the whole of a face by so much there are none.
pub(super) fn beside(neutral: &[Vec3], shape: &[Vec3]) -> Option<Unlike> {
    let count = neutral.len().max(1) as f64;
    let moves = || shape.iter().zip(neutral).map(|(p, n)| p - n);
    let shift = moves().sum::<Vec3>() / count;
    let rest = (moves().map(|d| (d - shift).norm_squared()).sum::<f64>() / count).sqrt();
    let shift = shift.norm();
    (shift > BESIDE * bounding_box_diagonal(neutral) && rest < APART * shift).then_some(Unlike::Beside { shift })
}

/// A subject that is turned by more than this against the neutral has the rig's shapes turned with it, radians. People of one pose
/// differ by a degree or so.
const TURNED: f64 = 0.05;

/// Whose vertices a mesh is to have: those of a rig.
pub(super) const OF_RIG: &str = "this rig";

/// What is odd about `points` that have the vertices of `mesh` in its order; messages call them `what` and `of`.
///
/// # Errors
/// When they cannot be that: of another number, in another order, mirrored, flat, collapsed ([`Unlike`]).
pub fn check_order(
    mesh: &PolygonMesh,
    of: &'static str,
    what: &'static str,
    points: &[Vec3],
) -> Result<Vec<RigWarning>, RigError> {
    let found = compared((&mesh.positions, Some(mesh)), (what, of), points)?;
    Ok(warnings((what, of), found.doubts))
}

fn compared(
    (neutral, mesh): (&[Vec3], Option<&PolygonMesh>),
    (what, of): (&'static str, &'static str),
    points: &[Vec3],
) -> Result<Likeness, RigError> {
    let [found, expected] = [points.len(), neutral.len()];
    if found != expected {
        return Err(RigError::VertexCount { what: what.to_owned(), found, expected });
    }
    let triangles = mesh.map_or_else(Vec::new, |mesh| mesh.triangulate().triangles);
    compare(neutral, &triangles, points).map_err(|why| RigError::Unlike { what, of, why })
}

fn warnings((what, of): (&'static str, &'static str), doubts: Vec<Unlike>) -> Vec<RigWarning> {
    doubts.into_iter().map(|why| RigWarning::Unlike { what, of, why }).collect()
}

impl Rig {
    /// [`check_order`] of a mesh of this rig.
    ///
    /// # Errors
    /// As [`check_order`].
    pub fn check_subject(&self, what: &'static str, subject: &[Vec3]) -> Result<Vec<RigWarning>, RigError> {
        compared((&self.neutral, self.mesh.as_ref()), (what, OF_RIG), subject)
            .map(|found| warnings((what, OF_RIG), found.doubts))
    }

    /// [`select`](Self::select) for `subject`, a mesh of this rig, and what is odd about that: shapes turn with it where it is turned.
    ///
    /// # Errors
    /// As [`select`](Self::select) and [`check_order`].
    pub fn select_for(
        &self,
        selection: ShapeSelection<'_>,
        what: &'static str,
        subject: &[Vec3],
    ) -> Result<(ShapeBasis, Vec<RigWarning>), RigError> {
        let Likeness { doubts, pose } = compared((&self.neutral, self.mesh.as_ref()), (what, OF_RIG), subject)?;
        let shapes = self.select(selection)?;
        let is_turned = |pose: &Pose| Rotation3::from_matrix_unchecked(pose.rotation).angle() > TURNED;
        let shapes = match pose.filter(is_turned) {
            Some(pose) => shapes.turned(&pose.rotation),
            None => shapes,
        };
        Ok((shapes, warnings((what, OF_RIG), doubts)))
    }
}

/// What to doubt where a rig's shapes, fitted, are `rms` from a mesh.
pub(super) fn unexplained(points: &[Vec3], rms: f64) -> Option<Unlike> {
    let [size, _] = spread(points);
    (rms > UNEXPLAINED * size).then_some(Unlike::Unexplained { rms, size })
}

/// Root mean square distance from the centroid, and the smallest deviation along any axis as a share of it.
fn spread(points: &[Vec3]) -> [f64; 2] {
    let count = points.len() as f64;
    let centre = points.iter().sum::<Vec3>() / count;
    let covariance = points.iter().fold(Matrix3::zeros(), |m, p| m + (p - centre) * (p - centre).transpose()) / count;
    let values = SymmetricEigen::new(covariance).eigenvalues;
    let size = values.sum().max(0.0).sqrt();
    [size, values.min().max(0.0).sqrt() / size]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::{noise, sheet};

    #[test]
    fn shapes_turn_with_a_subject_that_is_turned() {
        let face = sheet(20, 16, |x, y| Vec3::new(8.0 * x, 12.0 * y, 40.0 * (0.16 * x).sin() * (0.2 * y).sin()));
        let count = face.positions.len();
        let shape = crate::rig::Shape { name: "up".into(), family: crate::rig::Family::Expression };
        let rig =
            Rig::new(face.positions.clone(), Some(face.clone().into()), vec![shape], [0.0, 3.0, 0.0].repeat(count));
        let rig = rig.unwrap().0;
        let selection = ShapeSelection { names: None, identity_modes: 0 };
        let turned = |angle: f64| {
            let pose = crate::mesh::Pose::rigid(Vec3::new(0.0, 0.0, angle), Vec3::new(5.0, 100.0, 3.0));
            let subject: Vec<Vec3> = face.positions.iter().map(|p| pose.apply(*p)).collect();
            let (shapes, odd) = rig.select_for(selection, "the template", &subject).unwrap();
            assert_eq!(odd, []);
            shapes.displacement(0, 0)
        };
        assert_eq!(turned(0.04), Vec3::new(0.0, 3.0, 0.0));
        let quarter = turned(std::f64::consts::FRAC_PI_2);
        assert!((quarter - Vec3::new(-3.0, 0.0, 0.0)).norm() < 1e-5, "{quarter:?}");
        let shuffled: Vec<Vec3> = (0..count).map(|i| face.positions[i * 7 % count]).collect();
        assert!(rig.select_for(selection, "the template", &shuffled).is_err());
        for few in
            [rig.select_for(selection, "mesh", &shuffled[1..]).err(), rig.check_subject("mesh", &shuffled[1..]).err()]
        {
            assert!(matches!(few, Some(RigError::VertexCount { .. })));
        }
    }

    #[test]
    fn what_is_no_such_mesh_is_told_and_what_is_one_is_not() {
        let face = sheet(20, 16, |x, y| {
            Vec3::new(8.0 * x, 12.0 * y, 40.0 * (0.16 * x).sin() * (0.2 * y).sin() + 5.0 * (0.9 * x).cos())
        });
        let (neutral, triangles) = (&face.positions, &face.triangles);
        let with = |change: &dyn Fn(usize, Vec3) -> Vec3| {
            let points: Vec<Vec3> = neutral.iter().enumerate().map(|(i, p)| change(i, *p)).collect();
            compare(neutral, triangles, &points).map(|likeness| likeness.doubts)
        };
        assert_eq!(with(&|_, p| p), Ok(vec![]));
        // another person, turned, larger
        let turn = crate::mesh::Pose::rigid(Vec3::new(0.4, 2.0, -0.3), Vec3::new(5.0, 100.0, 3.0));
        let other = |p: Vec3| 1.3 * turn.apply(p + Vec3::new(0.1 * p.y, 6.0 * (0.03 * p.x).sin(), 0.15 * p.z));
        assert_eq!(with(&|_, p| other(p)), Ok(vec![]));
        let count = neutral.len();
        assert!(matches!(with(&|i, _| neutral[i * 7 % count]), Err(Unlike::Far { .. })));
        assert!(with(&|i, _| 50.0 * Vec3::new(noise(i), noise(i + count), noise(i + 2 * count))).is_err());
        assert!(matches!(with(&|_, p| Vec3::new(-p.x, p.y, p.z)), Err(Unlike::Mirrored { .. })));
        assert!(matches!(with(&|_, p| Vec3::new(p.x, p.y, -p.z)), Err(Unlike::Mirrored { .. })));
        assert!(matches!(with(&|_, p| Vec3::new(p.x, p.y, 1.0)), Err(Unlike::Flat { .. })));
        assert!(matches!(with(&|i, p| if i < count / 3 { neutral[0] } else { p }), Err(Unlike::Collapsed { .. })));
        assert!(matches!(with(&|_, p| 25.4 * p).as_deref(), Ok([Unlike::Size { .. }])));
        assert_eq!(
            with(&|i, p| if i == 50 { p + Vec3::z() * 60.0 } else { p }),
            Ok(vec![Unlike::Spiked { vertices: 1 }])
        );
        assert!(matches!(with(&|i, p| if i == 50 { neutral[51] } else { p }), Ok(doubts) if doubts.len() <= 1));
        // a part in another order
        let doubts = with(&|i, p| if i % 40 == 3 { neutral[(i + 97) % count] } else { p });
        assert!(doubts.is_err() || doubts.is_ok_and(|d| !d.is_empty()));
    }
}
