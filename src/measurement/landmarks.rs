//! Named landmarks of facial anthropometry, and where they are on a template.

use std::path::{Path, PathBuf};

use super::MeasurementError;
use crate::io::LengthUnit;
use crate::landmark::{
    LandmarkFormat, LandmarkSet, OffTemplate, TemplatePoint, parse_landmark_set, read_landmark_set, swapped_sides,
};
use crate::mesh::{PolygonMesh, Vec3};

/// A landmark: what its name means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LandmarkDefinition {
    /// Its name in files; `_left` and `_right` are the subject's.
    pub name: &'static str,
    /// Where it is.
    pub place: &'static str,
    /// The Multi-PIE/iBUG landmarks (0 to 67) whose mean it is; none where the 68 do not have it. Those of the jaw's contour
    /// lie somewhere on it, and 31 and 35 below the wings of the nose: they are not zygion, gonion or alare.
    pub numbered: &'static [u32],
}

const fn at(name: &'static str, numbered: &'static [u32], place: &'static str) -> LandmarkDefinition {
    LandmarkDefinition { name, place, numbered }
}

/// All landmarks, from top to bottom, then pairs from the middle outwards.
///
/// The places are the soft tissue's, in the words of anthropometry after Farkas, as tabulated in
/// <https://pmc.ncbi.nlm.nih.gov/articles/PMC2666135/table/tbl1> and <https://pmc.ncbi.nlm.nih.gov/articles/PMC8192579/table/Tab1>.
pub const LANDMARKS: [LandmarkDefinition; 25] = [
    at("trichion", &[], "hairline, on the midline"),
    at("glabella", &[], "most prominent point between the eyebrows, on the midline"),
    at("nasion", &[27], "root of the nose, over the nasofrontal suture, on the midline"),
    at("pronasale", &[30], "most protruded point of the tip of the nose"),
    at("subnasale", &[33], "where the septum's lower border meets the upper lip, on the midline"),
    at("labiale_superius", &[51], "middle of the upper lip's vermilion border"),
    at("stomion", &[62, 66], "middle of the line where the lips meet"),
    at("labiale_inferius", &[57], "middle of the lower lip's vermilion border"),
    at("sublabiale", &[], "deepest point of the mentolabial fold, on the midline"),
    at("pogonion", &[], "most anterior point of the chin, on the midline"),
    at("menton", &[8], "lowest point of the chin, on the midline (gnathion)"),
    at("endocanthion_right", &[39], "inner corner of the eye"),
    at("endocanthion_left", &[42], "inner corner of the eye"),
    at("exocanthion_right", &[36], "outer corner of the eye"),
    at("exocanthion_left", &[45], "outer corner of the eye"),
    at("subalare_right", &[31], "where the wing of the nose ends in the upper lip"),
    at("subalare_left", &[35], "where the wing of the nose ends in the upper lip"),
    at("alare_right", &[], "most lateral point of the wing of the nose"),
    at("alare_left", &[], "most lateral point of the wing of the nose"),
    at("cheilion_right", &[48], "corner of the mouth"),
    at("cheilion_left", &[54], "corner of the mouth"),
    at("zygion_right", &[], "most lateral point over the zygomatic arch"),
    at("zygion_left", &[], "most lateral point over the zygomatic arch"),
    at("gonion_right", &[], "most lateral point of the angle of the jaw"),
    at("gonion_left", &[], "most lateral point of the angle of the jaw"),
];

const SYNONYMS: [(&str, &str); 1] = [("gnathion", "menton")];

/// Numbered landmarks of Multi-PIE.
const NUMBERED: usize = 68;

/// Landmarks in the folder of a rig: the 68, and those by name.
const FILES_OF_RIG: [&str; 2] = ["landmarks_multipie68.json", "landmarks_anthropometric.json"];

/// Index in [`LANDMARKS`].
pub(super) fn index(name: &str) -> Option<usize> {
    let name = SYNONYMS.iter().find(|s| s.0 == name).map_or(name, |s| s.1);
    LANDMARKS.iter().position(|l| l.name == name)
}

/// Where the landmarks of a template are.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Landmarks {
    /// Of each of [`LANDMARKS`], the points whose mean it is, and whether they were given by its name.
    points: [Option<(Vec<TemplatePoint>, bool)>; LANDMARKS.len()],
    off: OffTemplate,
}

impl Landmarks {
    /// No landmarks.
    pub(super) const fn none() -> Self {
        Self { points: [const { None }; LANDMARKS.len()], off: OffTemplate::none() }
    }

    /// Of points of any names those that it knows: others are left out, and so are numbers where not all 68 are there.
    ///
    /// # Errors
    /// When a landmark comes under two names.
    pub fn among(points: &[(String, TemplatePoint)]) -> Result<Self, MeasurementError> {
        let all: Vec<String> = (0..NUMBERED).map(|n| n.to_string()).collect();
        let numbered = all.iter().all(|number| points.iter().any(|p| p.0 == *number));
        let known = points.iter().filter(|(name, _)| index(name).is_some() || (numbered && all.contains(name)));
        let mut landmarks = Self::default();
        landmarks.add(&known.cloned().collect::<Vec<_>>())?;
        Ok(landmarks)
    }

    /// Whether none is known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.iter().all(Option::is_none)
    }

    /// Adds named points. Names are those of [`LANDMARKS`], `gnathion`, or "0" to "67"; a point given by name stands before one
    /// by number, a later one before an earlier one.
    ///
    /// # Errors
    /// When a name is none of these, there are numbers but not all 68, or a landmark comes under two names.
    pub fn add(&mut self, points: &[(String, TemplatePoint)]) -> Result<(), MeasurementError> {
        let mut numbered: [Option<TemplatePoint>; NUMBERED] = [None; NUMBERED];
        let mut named: [Option<&str>; LANDMARKS.len()] = [None; LANDMARKS.len()];
        for (name, point) in points {
            let number = name.parse::<usize>().ok().filter(|n| *n < NUMBERED && n.to_string() == *name);
            if let Some(n) = number {
                numbered[n] = Some(*point);
                continue;
            }
            let Some(i) = index(name) else {
                let known = LANDMARKS.map(|l| l.name).join(", ");
                return Err(MeasurementError::UnknownLandmark { name: name.clone(), known });
            };
            if let Some(before) = named[i].replace(name) {
                return Err(MeasurementError::SameLandmark(before.to_owned(), name.clone()));
            }
            self.points[i] = Some((vec![*point], true));
        }
        match numbered.iter().flatten().count() {
            0 => return Ok(()),
            NUMBERED => {}
            found => return Err(MeasurementError::Numbered { found }),
        }
        for (definition, slot) in LANDMARKS.iter().zip(&mut self.points) {
            let parts: Vec<TemplatePoint> = definition.numbered.iter().filter_map(|n| numbered[*n as usize]).collect();
            if !parts.is_empty() && !slot.as_ref().is_some_and(|s| s.1) {
                *slot = Some((parts, false));
            }
        }
        Ok(())
    }

    /// Reads the landmarks of a template from files, one after the other; `unit` is that of positions in files which state none.
    ///
    /// # Errors
    /// When one cannot be read, a position is far off the template, or for [`Self::add`]'s reasons: the message names the file.
    pub fn read(
        paths: &[impl AsRef<Path>],
        template: &PolygonMesh,
        unit: LengthUnit,
    ) -> Result<Self, MeasurementError> {
        let mut landmarks = Self::default();
        for path in paths.iter().map(AsRef::as_ref) {
            let mut set = read_landmark_set(path)?;
            set.assume(unit);
            landmarks.add_set(path, set, template)?;
        }
        Ok(landmarks)
    }

    /// Adds the landmarks of a file, millimetres; `path` is named in errors. A position is the closest point of the template's surface.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn add_set(
        &mut self,
        path: &Path,
        mut set: LandmarkSet,
        template: &PolygonMesh,
    ) -> Result<(), MeasurementError> {
        let failed = |source| MeasurementError::File { path: path.to_owned(), source: Box::new(source) };
        // Positions of plain JSON would be vertices otherwise, which can be millimetres off.
        set.format = LandmarkFormat::Native;
        let points = set.on_template(path, template)?;
        self.add(&points).map_err(failed)?;
        self.off.extend(OffTemplate::of(path, &set, &points, template)?);
        Ok(())
    }

    /// Those that a rig has: the 68 of a file beside it, or else those that it holds itself, and those by name of a file beside it. The
    /// files come with what is in them, unless it cannot be read.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn of_rig(
        beside: &[(PathBuf, Option<Vec<u8>>)],
        numbered: Option<&[u32]>,
        template: &PolygonMesh,
    ) -> Result<Self, MeasurementError> {
        let mut landmarks = Self::default();
        let file = |name: &str| beside.iter().find(|(path, _)| path.ends_with(name));
        for (path, text) in FILES_OF_RIG.into_iter().filter_map(file) {
            // what cannot be read says so when it is tried again
            let read = || text.as_ref().map_or_else(|| read_landmark_set(path), |text| parse_landmark_set(text, path));
            let mut set = read()?;
            set.assume(LengthUnit::Millimetre);
            landmarks.add_set(path, set, template)?;
        }
        if let (None, Some(numbered)) = (file(FILES_OF_RIG[0]), numbered) {
            let point = |(n, vertex): (usize, &u32)| (n.to_string(), TemplatePoint::Vertex(*vertex));
            landmarks.add(&numbered.iter().enumerate().map(point).collect::<Vec<_>>())?;
        }
        Ok(landmarks)
    }

    /// What is to be said of them on the template, whose vertices are at `positions`: those off it, left and right that are swapped.
    #[must_use]
    pub fn doubts(&self, positions: &[Vec3]) -> Vec<String> {
        let placed = self.placed(positions).unwrap_or([None; LANDMARKS.len()]); // what is past the end is said where it is measured
        let named: Vec<(&str, Vec3)> =
            LANDMARKS.iter().zip(placed).filter_map(|(landmark, p)| Some((landmark.name, p?))).collect();
        self.off.doubt().into_iter().chain(swapped_sides(&named)).collect()
    }

    /// Names of those that are known, in the order of [`LANDMARKS`].
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        LANDMARKS.iter().zip(&self.points).filter(|(_, p)| p.is_some()).map(|(l, _)| l.name)
    }

    /// Where each of [`LANDMARKS`] is when the template's vertices are at `positions`.
    ///
    /// # Errors
    /// When a landmark has a vertex past the end.
    pub(super) fn placed(&self, positions: &[Vec3]) -> Result<Placed, MeasurementError> {
        let mut placed: Placed = [None; LANDMARKS.len()];
        for ((slot, points), definition) in placed.iter_mut().zip(&self.points).zip(&LANDMARKS) {
            let Some((points, _)) = points else { continue };
            for point in points {
                let corners = match point {
                    TemplatePoint::Vertex(v) => &[*v; 3],
                    TemplatePoint::Face { corners, .. } => corners,
                };
                if let Some(&vertex) = corners.iter().find(|v| **v as usize >= positions.len()) {
                    let what = format!("landmark {}", definition.name);
                    return Err(MeasurementError::NoSuchVertex { what, vertex, vertices: positions.len() });
                }
            }
            *slot = Some(points.iter().map(|p| p.position(positions)).sum::<Vec3>() / points.len() as f64);
        }
        Ok(placed)
    }
}

/// Where each of [`LANDMARKS`] is, millimetres.
pub(super) type Placed = [Option<Vec3>; LANDMARKS.len()];

/// Indices in [`LANDMARKS`] of pairs, right and left, and of what lies on the midline, twice.
pub(super) fn mirrored() -> impl Iterator<Item = [usize; 2]> {
    LANDMARKS.iter().enumerate().filter_map(|(i, landmark)| match landmark.name.strip_suffix("_right") {
        Some(stem) => index(&format!("{stem}_left")).map(|left| [i, left]),
        None => (!landmark.name.ends_with("_left")).then_some([i, i]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(names: &[&str]) -> Vec<(String, TemplatePoint)> {
        names.iter().zip(0..).map(|(n, v)| ((*n).to_owned(), TemplatePoint::Vertex(v))).collect()
    }

    #[test]
    fn numbers_give_what_they_are_and_names_stand_before_them() {
        let all: Vec<String> = (0..68).map(|n| n.to_string()).collect();
        let numbered = points(&all.iter().map(String::as_str).collect::<Vec<_>>());
        let positions: Vec<Vec3> = (0..68).map(|v| Vec3::x() * f64::from(v)).collect();
        let mut landmarks = Landmarks::default();
        landmarks.add(&points(&["nasion", "gnathion"])).unwrap();
        landmarks.add(&numbered).unwrap();
        let placed = landmarks.placed(&positions).unwrap();
        let x = |name: &str| placed[index(name).unwrap()].map(|p| p.x);
        assert_eq!((x("nasion"), x("menton"), x("gnathion")), (Some(0.0), Some(1.0), Some(1.0)));
        assert_eq!((x("stomion"), x("cheilion_left")), (Some(64.0), Some(54.0)));
        assert_eq!((x("trichion"), x("zygion_left"), x("alare_right")), (None, None, None));
        assert!(landmarks.placed(&positions[..60]).unwrap_err().to_string().contains("stomion has vertex 62"));
    }

    #[test]
    fn among_other_points_those_that_are_known_are_found() {
        let names = |points: &[&str]| Landmarks::among(&self::points(points)).unwrap().names().count();
        assert_eq!([names(&["nasion", "mole", "27", "8"]), names(&["27"]), names(&[])], [1, 0, 0]);
        let all: Vec<String> = (0..68).map(|n| n.to_string()).chain(["mole".to_owned()]).collect();
        assert!(names(&all.iter().map(String::as_str).collect::<Vec<_>>()) > 10);
        assert!(Landmarks::among(&points(&["gnathion", "menton"])).is_err());
    }

    #[test]
    fn what_is_no_landmark_is_named() {
        let message = |names: &[&str]| Landmarks::default().add(&points(names)).unwrap_err().to_string();
        assert!(message(&["nasion", "nosion"]).contains("\"nosion\"; known are trichion, glabella"));
        assert!(message(&["007"]).contains("\"007\"") && message(&["68"]).contains("\"68\""));
        assert!(message(&["0", "1"]).contains("found 2 of the numbered"));
        assert!(message(&["gnathion", "menton"]).contains("one landmark"));
    }

    #[test]
    fn every_right_has_its_left() {
        let pairs: Vec<[usize; 2]> = mirrored().collect();
        assert_eq!(pairs.iter().filter(|[a, b]| a == b).count(), 11);
        assert_eq!(pairs.iter().filter(|[a, b]| a != b).count(), 7);
        assert!(pairs.iter().all(|p| LANDMARKS[p[0]].name.replace("right", "left") == LANDMARKS[p[1]].name));
    }
}
