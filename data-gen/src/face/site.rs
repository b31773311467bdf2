//! Where a point of the skin is: the flat face, the chart, and the rings round mouth and eyes.
//!
//! The **flat face** is a plane domain with three holes, about as large as the skin in millimetres, the mouth held open:
//! it names material points, and the texture coordinates are taken from it. The **chart** is the same with the lips closed:
//! near the symmetry plane its coordinates are those of a front view (Y = 0 between the pupils), further out they are arc
//! lengths. All that is known about the face's shape is a function of a [`Site`].

use nonrigid::mesh::Vec3;

use super::rings::{Around, Rings};

/// A material point of the skin, in the flat face, millimetres.
pub type Flat = [f64; 2];

/// Centre of the mouth and of the left eye in the chart.
pub(crate) const MOUTH: [f64; 2] = [0.0, -68.0];
pub(crate) const EYE: [f64; 2] = [31.5, 0.0];
/// The outer corner of an eye is higher than the inner one.
pub(crate) const EYE_TILT: f64 = 0.06;

/// Rings round the closed lips, from the chart.
pub(crate) const CLOSED_MOUTH: Rings =
    Rings { half_width: 25.5, half_heights: [0.0; 2], alpha: 0.45, opening: 0.0, fade: 1.0, innermost: 0.0 };
/// The same rings in the flat face; the inner 4 mm roll into the mouth.
pub(crate) const FLAT_MOUTH: Rings = Rings { opening: 4.2, fade: 12.0, innermost: -4.0, ..CLOSED_MOUTH };
/// Rings round the left eye's opening; the inner 2 mm are the lids' margin.
pub(crate) const EYELIDS: Rings =
    Rings { half_width: 14.2, half_heights: [6.6, 4.9], alpha: 0.65, opening: 0.0, fade: 1.0, innermost: -2.0 };

/// A material point and where it lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Site {
    /// Chart coordinates; on the rolled-in part of the lips those of the line where they meet.
    pub x: f64,
    pub y: f64,
    pub mouth: Around,
    /// Round the left eye.
    pub left_eye: Around,
    /// Round the right eye, mirrored: angle 0 is its outer corner.
    pub right_eye: Around,
    /// Position in the neutral face.
    pub neutral: Vec3,
}

impl Site {
    /// What is known without the face's shape; `neutral` is zero.
    pub fn flat([u, v]: Flat) -> Self {
        let mouth = FLAT_MOUTH.around(u - MOUTH[0], v - MOUTH[1]);
        let outer = CLOSED_MOUTH.point(Around { r: mouth.r.max(0.0), ..mouth });
        let inner_width = (CLOSED_MOUTH.half_width + CLOSED_MOUTH.alpha * mouth.r) * mouth.eta.cos();
        let x = MOUTH[0] + if mouth.r < 0.0 { inner_width } else { outer[0] };
        let y = MOUTH[1] + outer[1];
        let [left_eye, right_eye] = [around_eye(x, y), around_eye(-x, y)];
        Self { x, y, mouth, left_eye, right_eye, neutral: Vec3::zeros() }
    }

    /// The site on the other side of the face.
    pub fn mirrored(&self) -> Self {
        Self {
            x: -self.x,
            mouth: Around { r: self.mouth.r, eta: mirrored_angle(self.mouth.eta) },
            left_eye: self.right_eye,
            right_eye: self.left_eye,
            neutral: Vec3::new(-self.neutral.x, self.neutral.y, self.neutral.z),
            ..*self
        }
    }
}

fn mirrored_angle(eta: f64) -> f64 {
    if eta >= 0.0 { std::f64::consts::PI - eta } else { -std::f64::consts::PI - eta }
}

fn around_eye(x: f64, y: f64) -> Around {
    let (sin, cos) = EYE_TILT.sin_cos();
    let (dx, dy) = (x - EYE[0], y - EYE[1]);
    EYELIDS.around(cos * dx + sin * dy, cos * dy - sin * dx)
}

/// The chart's point round the left eye.
pub(crate) fn eye_point(at: Around) -> [f64; 2] {
    let (sin, cos) = EYE_TILT.sin_cos();
    let [dx, dy] = EYELIDS.point(at);
    [EYE[0] + cos * dx - sin * dy, EYE[1] + sin * dx + cos * dy]
}

/// The flat face's point at a chart point outside the lips' roll.
pub(crate) fn flatten([x, y]: [f64; 2]) -> Flat {
    let [u, v] = FLAT_MOUTH.point(CLOSED_MOUTH.around(x - MOUTH[0], y - MOUTH[1]));
    [MOUTH[0] + u, MOUTH[1] + v]
}
