//! Units of length of files. Inside, everything is millimetres.
//!
//! Most formats state no unit. That of a face, head or bust can be told from its size: metric units are ten times apart or more,
//! faces are not. Inches are 2.54 cm, so that one number may be a small face in centimetres and a large one in inches: what is
//! likely in one of them only is taken for that, and said; the rest has to be stated. What is as large as a body in millimetres, and no face
//! in any unit, is in millimetres.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::Serialize;

use super::error::extension;
use crate::mesh::Vec3;

/// From where to where the extent of a face, head or bust lies, millimetres: see [`face_extent`].
pub const FACE_EXTENT: [f64; 2] = [100.0, 900.0];
/// From where to where that of a body lies, millimetres: in that unit alone a body is told by its size.
pub const BODY_EXTENT: [f64; 2] = [900.0, 5000.0];
/// Where nearly all of them lie: from a child's face without ears to a head with its neck.
pub const LIKELY_EXTENT: [f64; 2] = [150.0, 450.0];

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// um
    Micrometre,
    /// mm
    Millimetre,
    /// cm
    Centimetre,
    /// m
    Metre,
    /// in
    Inch,
}

/// What the size of a face says of its unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceUnit {
    /// In this unit alone has it the size of a face, or in millimetres that of a body.
    One(LengthUnit),
    /// In both, but in the second it would be unlikely.
    Likely(LengthUnit, LengthUnit),
    /// In both, neither likelier.
    Either(LengthUnit, LengthUnit),
    /// In none.
    Unknown,
}

impl LengthUnit {
    /// All of them.
    const ALL: [Self; 5] = [Self::Micrometre, Self::Millimetre, Self::Centimetre, Self::Metre, Self::Inch];

    /// Its symbol.
    const fn symbol(self) -> &'static str {
        match self {
            Self::Micrometre => "um",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Metre => "m",
            Self::Inch => "in",
        }
    }

    /// How many millimetres one is.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Micrometre => 1e-3,
            Self::Millimetre => 1.0,
            Self::Centimetre => 10.0,
            Self::Metre => 1000.0,
            Self::Inch => 25.4,
        }
    }

    /// The unit that a file format states, by the file's extension: glTF is in metres. Readers bring it to millimetres.
    #[must_use]
    pub fn of_format(path: &Path) -> Option<Self> {
        matches!(extension(path).as_str(), "glb" | "gltf").then_some(Self::Metre)
    }

    /// The unit that points are probably in instead of the one that their format states, in which `extent` is that of no face and no body.
    #[must_use]
    pub fn instead_of(self, extent: f64) -> Option<Self> {
        let stated = extent * self.millimetres();
        match FaceUnit::of(extent) {
            _ if (FACE_EXTENT[0]..BODY_EXTENT[1]).contains(&stated) => None,
            FaceUnit::One(unit) | FaceUnit::Likely(unit, _) | FaceUnit::Either(unit, _) => Some(unit),
            FaceUnit::Unknown => None,
        }
    }

    /// What is to be said of points whose format states this unit, in which `extent` is that of no face and no body: `named` and the words
    /// that ask for the unit that it is [probably in](Self::instead_of).
    #[must_use]
    pub fn misfit(self, named: impl fmt::Display, extent: f64, ask: impl Fn(Self) -> String) -> Option<String> {
        let other = self.instead_of(extent)?;
        let [of_stated, of_other] = [self, other].map(|unit| extent * unit.millimetres());
        Some(format!(
            "{named}: {of_stated:.0} mm across in {self}, the unit of its format, which no face or body is; if it is in {other}, \
             {of_other:.0} mm, say {}",
            ask(other)
        ))
    }

    /// The unit in which the points have the extent of a face: within [`FACE_EXTENT`]. `None` if there is none, or if
    /// [`FaceUnit::Either`].
    #[must_use]
    pub fn of_face(points: &[Vec3]) -> Option<Self> {
        match FaceUnit::of(face_extent(points)) {
            FaceUnit::One(unit) | FaceUnit::Likely(unit, _) => Some(unit),
            FaceUnit::Either(..) | FaceUnit::Unknown => None,
        }
    }
}

impl FaceUnit {
    /// What an extent ([`face_extent`]) says.
    #[must_use]
    pub fn of(extent: f64) -> Self {
        let within = |unit: LengthUnit, [low, high]: [f64; 2]| (low..high).contains(&(extent * unit.millimetres()));
        let inch = LengthUnit::Inch;
        let metric = LengthUnit::ALL.into_iter().find(|unit| *unit != inch && within(*unit, FACE_EXTENT));
        match metric {
            None if within(LengthUnit::Millimetre, BODY_EXTENT) => Self::One(LengthUnit::Millimetre),
            None => Self::Unknown,
            Some(unit) if !within(inch, FACE_EXTENT) => Self::One(unit),
            Some(unit) if within(unit, LIKELY_EXTENT) && !within(inch, LIKELY_EXTENT) => Self::Likely(unit, inch),
            Some(unit) => Self::Either(unit, inch),
        }
    }
}

/// The unit of an input, and how it is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct KnownUnit {
    /// The unit.
    pub unit: LengthUnit,
    /// How it is known.
    pub by: UnitSource,
}

/// How the unit of an input is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum UnitSource {
    /// The user has said it.
    Option,
    /// The file states it, or its format.
    File,
    /// Only in this unit has it the size of a face: [`LengthUnit::of_face`].
    Size,
    /// It is that of the mesh on which the points are.
    Mesh,
}

impl fmt::Display for KnownUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let by = match self.by {
            UnitSource::Option => "by --unit",
            UnitSource::File => "as the file says",
            UnitSource::Size => "by its size",
            UnitSource::Mesh => "as its mesh",
        };
        write!(f, "{} ({by})", self.unit)
    }
}

impl Serialize for LengthUnit {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The diagonal of the box that holds the middle 90 % of the points along each axis, in their unit: spikes and a few points of
/// the background leave it as it is. 0 without points.
#[must_use]
pub fn face_extent(points: &[Vec3]) -> f64 {
    let Some(last) = points.len().checked_sub(1) else { return 0.0 };
    let cut = last / 20;
    let middle = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
        let low = *values.select_nth_unstable_by(cut, f64::total_cmp).1;
        let high = *values.select_nth_unstable_by(last - cut, f64::total_cmp).1;
        high - low
    };
    Vec3::new(middle(0), middle(1), middle(2)).norm()
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.symbol())
    }
}

impl FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|unit| unit.symbol() == text);
        found.ok_or_else(|| format!("unknown unit {text:?}; known are um, mm, cm, m and in"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face's width, height and depth, as a grid over half an ellipsoid, millimetres.
    fn face() -> Vec<Vec3> {
        let point = |i: usize| {
            let (u, v) = ((i % 40) as f64 / 19.5 - 1.0, (i / 40) as f64 / 19.5 - 1.0);
            Vec3::new(70.0 * u, 100.0 * v, 90.0 * (1.0 - (u * u + v * v) / 2.0).sqrt())
        };
        (0..1600).map(point).collect()
    }

    #[test]
    fn a_face_has_the_same_extent_in_every_unit_and_with_spikes() {
        let mut points = face();
        let extent = face_extent(&points);
        assert!((200.0..280.0).contains(&extent), "{extent}");
        for p in points.iter_mut().step_by(50) {
            *p *= 1000.0; // 2 % of the points are far away
        }
        let spiky = face_extent(&points);
        assert!((spiky / extent - 1.0).abs() < 0.05, "{spiky}");
        for unit in ["um", "mm", "cm", "m"].map(|u| u.parse::<LengthUnit>().unwrap()) {
            let scaled: Vec<Vec3> = points.iter().map(|p| p / unit.millimetres()).collect();
            assert_eq!(LengthUnit::of_face(&scaled), Some(unit));
        }
    }

    /// A face in inches is nowhere taken for another unit without a word.
    #[test]
    fn inches_are_told_from_centimetres_or_asked_for() {
        use LengthUnit::{Centimetre, Inch};
        for (millimetres, of_inches, of_centimetres) in [
            (110.0, FaceUnit::Unknown, FaceUnit::Either(Centimetre, Inch)),
            (160.0, FaceUnit::Unknown, FaceUnit::Either(Centimetre, Inch)),
            (200.0, FaceUnit::Unknown, FaceUnit::Likely(Centimetre, Inch)),
            (260.0, FaceUnit::Either(Centimetre, Inch), FaceUnit::Likely(Centimetre, Inch)),
            (440.0, FaceUnit::Either(Centimetre, Inch), FaceUnit::One(Centimetre)),
            (800.0, FaceUnit::Likely(Centimetre, Inch), FaceUnit::One(Centimetre)),
        ] {
            assert_eq!(FaceUnit::of(millimetres / 25.4), of_inches, "{millimetres} mm in inches");
            assert_eq!(FaceUnit::of(millimetres / 10.0), of_centimetres, "{millimetres} mm in centimetres");
            assert_eq!(FaceUnit::of(millimetres), FaceUnit::One(LengthUnit::Millimetre));
        }
    }

    #[test]
    fn a_body_is_told_in_millimetres() {
        for extent in [950.0, 1500.0, 4000.0] {
            assert_eq!(FaceUnit::of(extent), FaceUnit::One(LengthUnit::Millimetre));
        }
        // In metres it is as large as nothing that is known.
        assert_eq!(FaceUnit::of(1.5), FaceUnit::Unknown);
    }

    #[test]
    fn a_stated_unit_is_doubted_where_another_fits_and_it_does_not() {
        use LengthUnit::{Centimetre, Metre, Millimetre};
        for (extent, instead) in [(0.05, None), (0.2, None), (1.8, None), (7.0, None), (20.0, Some(Centimetre))] {
            assert_eq!(Metre.instead_of(extent), instead, "{extent} m");
        }
        assert_eq!(
            [200.0, 1800.0, 9000.0].map(|extent| Metre.instead_of(extent)),
            [Some(Millimetre), Some(Millimetre), None]
        );
    }

    #[test]
    fn what_is_no_face_has_no_unit() {
        for size in [0.0, 2.0, 8e4] {
            assert_eq!(
                LengthUnit::of_face(&face().iter().map(|p| p / 250.0 * size).collect::<Vec<_>>()),
                None,
                "{size}"
            );
        }
        assert_eq!(LengthUnit::of_face(&[]), None);
        assert_eq!(LengthUnit::of_face(&[Vec3::zeros(); 3]), None);
        assert_eq!(LengthUnit::of_format(Path::new("a.GLB")), Some(LengthUnit::Metre));
        assert_eq!(LengthUnit::of_format(Path::new("a.obj")), None);
    }
}
