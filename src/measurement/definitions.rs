//! The measurements: one table of names and formulas, and what evaluates it.
//!
//! **Frame.** The mid-sagittal plane is the mirror plane that best maps the left landmarks on the right ones and those of the midline
//! on themselves ([`MirrorPlane::of_pairs`]). Its normal, towards the subject's left, is the lateral axis; the vertical axis is the
//! direction from menton to nasion in that plane. Which side is left is said by the landmarks that have a side, or else by the surface:
//! landmarks lie on the front of a face. Nothing depends on how the mesh lies in its file.
//!
//! A face after has the frame of the face before, carried along by the motion of the head ([`head_motion`](super::motion::head_motion)):
//! a frame of its own would turn with a chin that moves, and change what is measured where nothing does.

use std::fmt;

use super::landmarks::{LANDMARKS, Placed, index, mirrored};
use crate::mesh::adjacency::middle_of_parts;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{MirrorPlane, Pose, TriangleMesh, Vec3, bounding_box_diagonal};

/// An axis of the face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Towards the subject's left.
    Lateral,
    /// From menton to nasion, in the mid-sagittal plane.
    Vertical,
    /// At right angles to both, out of the face.
    Forwards,
}

/// How a measurement follows from landmarks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Formula {
    /// Straight distance, millimetres.
    Distance(&'static str, &'static str),
    /// How far the second lies from the first along an axis, millimetres.
    Extent(Axis, &'static str, &'static str),
    /// Angle at the second between the directions to the first and the third, in space, degrees.
    Angle(&'static str, &'static str, &'static str),
    /// The same of the landmarks' projections on the mid-sagittal plane.
    ProfileAngle(&'static str, &'static str, &'static str),
    /// How far the third lies in front of the line from the first down to the second, in the mid-sagittal plane, millimetres.
    BeforeLine(&'static str, &'static str, &'static str),
    /// By how many degrees the line from the first to the second rises against the lateral axis in the frontal plane, which lateral
    /// and vertical axis span.
    Slope(&'static str, &'static str),
    /// One measurement in per cent of another, both further up in the table.
    Percent(&'static str, &'static str),
}

impl Formula {
    /// Unit of the value.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Distance(..) | Self::Extent(..) | Self::BeforeLine(..) => "mm",
            Self::Angle(..) | Self::ProfileAngle(..) | Self::Slope(..) => "deg",
            Self::Percent(..) => "%",
        }
    }

    /// The landmarks that it joins.
    #[must_use]
    pub fn landmarks(&self) -> Vec<&'static str> {
        match *self {
            Self::Distance(a, b) | Self::Extent(_, a, b) | Self::Slope(a, b) => vec![a, b],
            Self::Angle(a, b, c) | Self::ProfileAngle(a, b, c) | Self::BeforeLine(a, b, c) => vec![a, b, c],
            Self::Percent(..) => Vec::new(),
        }
    }
}

impl fmt::Display for Formula {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Distance(a, b) => write!(f, "distance from {a} to {b}"),
            Self::Extent(Axis::Lateral, a, b) => write!(f, "from {a} to {b} along the lateral axis"),
            Self::Extent(Axis::Vertical, a, b) => write!(f, "from {a} to {b} along the vertical axis"),
            Self::Extent(Axis::Forwards, a, b) => write!(f, "of {b} before the vertical through {a}"),
            Self::BeforeLine(a, b, c) => write!(f, "of {c} before the line from {a} to {b}, in the mid-sagittal plane"),
            Self::Angle(a, b, c) => write!(f, "at {b} between {a} and {c}, in space"),
            Self::ProfileAngle(a, b, c) => write!(f, "at {b} between {a} and {c}, in the mid-sagittal plane"),
            Self::Slope(a, b) => write!(f, "rise of the line from {a} to {b} in the frontal plane"),
            Self::Percent(a, b) => write!(f, "100 x {a} / {b}"),
        }
    }
}

/// A range from the literature.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct TypicalRange {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Of what, and where that is written.
    pub source: &'static str,
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Definition {
    /// What it belongs to.
    pub group: &'static str,
    /// Its name.
    pub name: &'static str,
    /// Its formula.
    pub formula: Formula,
    /// A range that the literature gives, for what it is worth.
    pub typical: Option<TypicalRange>,
}

impl Definition {
    /// Its name as people read it.
    #[must_use]
    pub fn title(&self) -> String {
        self.name.replace('_', " ").replace("e line", "E-line")
    }
}

const NASOFRONTAL: TypicalRange = TypicalRange {
    low: 115.0,
    high: 130.0,
    source: "Rhinoplasty Dissection Manual, surface angles, therhinoplastycenter.com/rhinoplasty-dissection-manual/surface-angles",
};
const NASOMENTAL: TypicalRange = TypicalRange { low: 120.0, high: 132.0, ..NASOFRONTAL };
const MESOPROSOPIC: TypicalRange = TypicalRange {
    low: 84.0,
    high: 87.9,
    source: "the class of average faces, mesoprosopic: Anatomy Research International 2015, 780756, table 1",
};
const UPPER_LIP_TO_E_LINE: TypicalRange = TypicalRange {
    low: -6.0,
    high: -2.0,
    source: "2 mm either way of the average Caucasian face after Ricketts, upper lip 4 and lower lip 2 mm behind the line: \
             speareducation.com/spear-review/2013/08/evaluating-facial-esthetics-the-esthetic-plane; lips lie further forward in most \
             other populations: Progress in Orthodontics 2015, 16:8, table 5",
};
const LOWER_LIP_TO_E_LINE: TypicalRange = TypicalRange { low: -4.0, high: 0.0, ..UPPER_LIP_TO_E_LINE };

/// Every measurement. Angles of the profile are those of
/// <https://bmcoralhealth.biomedcentral.com/articles/10.1186/s12903-022-02439-0/tables/1>; the nasolabial angle has the nose's tip for its
/// first point, where some use the columella. Thirds and fifths are after
/// <http://therhinoplastycenter.com/rhinoplasty-dissection-manual/surface-angles/>; the outer fifths end at the zygion, not at the ear.
/// The E-line, from the tip of the nose to the chin, is that of Ricketts (Esthetics, environment, and the law of lip relation, 1968), who
/// found no single ideal; the ranges are 2 mm either way of the averages that are taught after him.
pub const DEFINITIONS: &[Definition] = {
    use Axis::{Forwards, Lateral, Vertical};
    use Formula::{Angle, BeforeLine, Distance, Extent, Percent, ProfileAngle, Slope};
    const fn row(group: &'static str, name: &'static str, formula: Formula) -> Definition {
        Definition { group, name, formula, typical: None }
    }
    const fn typical(definition: Definition, range: TypicalRange) -> Definition {
        Definition { typical: Some(range), ..definition }
    }
    &[
        row("distances", "face_height", Distance("nasion", "menton")),
        row("distances", "face_width", Distance("zygion_right", "zygion_left")),
        row("distances", "jaw_width", Distance("gonion_right", "gonion_left")),
        row("distances", "forehead_height", Distance("trichion", "glabella")),
        row("distances", "lower_face_height", Distance("subnasale", "menton")),
        row("distances", "intercanthal_width", Distance("endocanthion_right", "endocanthion_left")),
        row("distances", "biocular_width", Distance("exocanthion_right", "exocanthion_left")),
        row("distances", "eye_width_right", Distance("exocanthion_right", "endocanthion_right")),
        row("distances", "eye_width_left", Distance("endocanthion_left", "exocanthion_left")),
        row("distances", "nose_height", Distance("nasion", "subnasale")),
        row("distances", "nose_length", Distance("nasion", "pronasale")),
        row("distances", "nose_protrusion", Distance("subnasale", "pronasale")),
        row("distances", "nose_width", Distance("alare_right", "alare_left")),
        row("distances", "nose_base_width", Distance("subalare_right", "subalare_left")),
        row("distances", "philtrum_height", Distance("subnasale", "labiale_superius")),
        row("distances", "upper_lip_height", Distance("subnasale", "stomion")),
        row("distances", "upper_vermilion_height", Distance("labiale_superius", "stomion")),
        row("distances", "lower_vermilion_height", Distance("stomion", "labiale_inferius")),
        row("distances", "lower_lip_height", Distance("stomion", "sublabiale")),
        row("distances", "chin_height", Distance("sublabiale", "menton")),
        row("distances", "mouth_width", Distance("cheilion_right", "cheilion_left")),
        row("thirds", "upper_third", Extent(Vertical, "glabella", "trichion")),
        row("thirds", "middle_third", Extent(Vertical, "subnasale", "glabella")),
        row("thirds", "lower_third", Extent(Vertical, "menton", "subnasale")),
        row("thirds", "three_thirds", Extent(Vertical, "menton", "trichion")),
        row("thirds", "upper_third_share", Percent("upper_third", "three_thirds")),
        row("thirds", "middle_third_share", Percent("middle_third", "three_thirds")),
        row("thirds", "lower_third_share", Percent("lower_third", "three_thirds")),
        row("fifths", "outer_fifth_right", Extent(Lateral, "zygion_right", "exocanthion_right")),
        row("fifths", "eye_fifth_right", Extent(Lateral, "exocanthion_right", "endocanthion_right")),
        row("fifths", "middle_fifth", Extent(Lateral, "endocanthion_right", "endocanthion_left")),
        row("fifths", "eye_fifth_left", Extent(Lateral, "endocanthion_left", "exocanthion_left")),
        row("fifths", "outer_fifth_left", Extent(Lateral, "exocanthion_left", "zygion_left")),
        row("fifths", "five_fifths", Extent(Lateral, "zygion_right", "zygion_left")),
        row("fifths", "outer_fifth_right_share", Percent("outer_fifth_right", "five_fifths")),
        row("fifths", "eye_fifth_right_share", Percent("eye_fifth_right", "five_fifths")),
        row("fifths", "middle_fifth_share", Percent("middle_fifth", "five_fifths")),
        row("fifths", "eye_fifth_left_share", Percent("eye_fifth_left", "five_fifths")),
        row("fifths", "outer_fifth_left_share", Percent("outer_fifth_left", "five_fifths")),
        typical(row("ratios", "facial_index", Percent("face_height", "face_width")), MESOPROSOPIC),
        row("ratios", "jaw_index", Percent("jaw_width", "face_width")),
        row("ratios", "lower_face_share", Percent("lower_face_height", "face_height")),
        row("ratios", "intercanthal_index", Percent("intercanthal_width", "biocular_width")),
        row("ratios", "nasal_index", Percent("nose_width", "nose_height")),
        row("ratios", "nose_protrusion_index", Percent("nose_protrusion", "nose_width")),
        row("ratios", "upper_lip_share", Percent("upper_lip_height", "lower_face_height")),
        row("ratios", "mouth_to_nose_width", Percent("mouth_width", "nose_width")),
        typical(row("angles", "nasofrontal", ProfileAngle("glabella", "nasion", "pronasale")), NASOFRONTAL),
        row("angles", "nasolabial", ProfileAngle("pronasale", "subnasale", "labiale_superius")),
        row("angles", "mentolabial", ProfileAngle("labiale_inferius", "sublabiale", "pogonion")),
        row("angles", "nasal_tip", ProfileAngle("nasion", "pronasale", "subnasale")),
        typical(row("angles", "nasomental", ProfileAngle("nasion", "pronasale", "pogonion")), NASOMENTAL),
        row("angles", "facial_convexity", ProfileAngle("glabella", "subnasale", "pogonion")),
        row("angles", "upper_face_convexity", Angle("exocanthion_right", "nasion", "exocanthion_left")),
        row("angles", "lower_face_convexity", Angle("gonion_right", "pogonion", "gonion_left")),
        row("angles", "canthal_tilt_right", Slope("endocanthion_right", "exocanthion_right")),
        row("angles", "canthal_tilt_left", Slope("endocanthion_left", "exocanthion_left")),
        row("angles", "mouth_cant", Slope("cheilion_right", "cheilion_left")),
        typical(
            row("profile", "upper_lip_to_e_line", BeforeLine("pronasale", "pogonion", "labiale_superius")),
            UPPER_LIP_TO_E_LINE,
        ),
        typical(
            row("profile", "lower_lip_to_e_line", BeforeLine("pronasale", "pogonion", "labiale_inferius")),
            LOWER_LIP_TO_E_LINE,
        ),
        row("profile", "upper_lip_projection", Extent(Forwards, "subnasale", "labiale_superius")),
        row("profile", "lower_lip_projection", Extent(Forwards, "subnasale", "labiale_inferius")),
        row("profile", "chin_projection", Extent(Forwards, "subnasale", "pogonion")),
    ]
};

/// Why a measurement has no value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Missing {
    /// Landmarks that are not given.
    Landmarks(Vec<&'static str>),
    /// The landmarks do not fix the mid-sagittal plane: there is no pair, and no three of the midline off one line.
    Plane,
    /// No landmark says which side is left, and those of the midline do not say where the front is.
    Front,
    /// Landmarks coincide, or a length to divide by is zero.
    Degenerate,
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Landmarks(names) => write!(f, "not given: {}", names.join(", ")),
            Self::Plane => f.write_str("the landmarks do not fix the mid-sagittal plane"),
            Self::Front => {
                f.write_str("nothing says where the face's front is; give landmarks of the left and the right")
            }
            Self::Degenerate => f.write_str("landmarks coincide"),
        }
    }
}

/// The axes of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FacialFrame {
    /// The mid-sagittal plane; its normal is the lateral axis.
    pub plane: MirrorPlane,
    /// Vertical axis, unit length, if menton and nasion fix it.
    pub vertical: Option<Vec3>,
}

impl FacialFrame {
    /// The frame of landmarks that are in their places on a mesh, or why they fix none.
    pub(super) fn of(placed: &Placed, mesh: &TriangleMesh) -> Result<Self, Missing> {
        let pairs: Vec<(Vec3, Vec3, f64)> =
            mirrored().filter_map(|[a, b]| Some((placed[a]?, placed[b]?, 1.0))).collect();
        let plane = MirrorPlane::of_pairs(pairs.iter().copied()).ok_or(Missing::Plane)?;
        let in_plane = |up: Vec3| (up - plane.normal * plane.normal.dot(&up)).try_normalize(1e-9);
        let find = |name| index(name).and_then(|i| placed[i]);
        let vertical = find("nasion").zip(find("menton")).and_then(|(top, bottom)| in_plane(top - bottom));
        let leftwards: Vec3 = sided(placed).map(|(p, side)| (p - plane.point) * side).sum();
        let (left, least) = if sided(placed).next().is_some() {
            (plane.normal.dot(&leftwards), 1e-9 * leftwards.norm())
        } else {
            // The table goes from top to bottom.
            let midline = || placed.iter().flatten().copied();
            let ends = midline().next().zip(midline().last()).and_then(|(top, bottom)| in_plane(top - bottom));
            let up = vertical.or(ends).ok_or(Missing::Front)?;
            let size = bounding_box_diagonal(&mesh.surface_points());
            (plane.normal.cross(&up).dot(&out_of_face(placed, mesh)), FRONT_SHARE * size)
        };
        if left.abs() <= least {
            return Err(Missing::Front);
        }
        Ok(Self { plane: MirrorPlane { normal: plane.normal * left.signum(), ..plane }, vertical })
    }

    /// Whether the landmarks lie behind the middle of their face, by the frame's front. Those of the midline alone have no other.
    pub(super) fn is_mirrored(&self, placed: &Placed, mesh: &TriangleMesh) -> bool {
        let Some(up) = self.vertical.filter(|_| sided(placed).next().is_some()) else { return false };
        self.plane.normal.cross(&up).dot(&out_of_face(placed, mesh)) < 0.0
    }

    /// The frame of a face that a motion has moved.
    pub(super) fn carried(&self, motion: &Pose) -> Self {
        let turned = |axis: Vec3| motion.rotation * axis;
        let plane = MirrorPlane { point: motion.apply(self.plane.point), normal: turned(self.plane.normal) };
        Self { plane, vertical: self.vertical.map(turned) }
    }

    /// Coordinates along the lateral axis, the vertical one and forwards, from the plane's point; without a vertical axis, `p`.
    #[must_use]
    pub fn coordinates(&self, p: Vec3) -> Vec3 {
        let Some(up) = self.vertical else { return p };
        let (d, lateral) = (p - self.plane.point, self.plane.normal);
        Vec3::new(d.dot(&lateral), d.dot(&up), d.dot(&lateral.cross(&up)))
    }
}

/// Landmarks of the midline say where the front is if they lie before the middle of the face by more than this share of its size.
const FRONT_SHARE: f64 = 0.01;

/// Landmarks that have a side, and which: 1 is left, -1 right.
fn sided(placed: &Placed) -> impl Iterator<Item = (Vec3, f64)> {
    LANDMARKS.iter().zip(placed).filter_map(|(landmark, p)| {
        let side = if landmark.name.ends_with("_left") {
            1.0
        } else if landmark.name.ends_with("_right") {
            -1.0
        } else {
            return None;
        };
        Some(((*p)?, side))
    })
}

/// From the middle of the parts of the mesh that landmarks lie on to the middle of the landmarks: about forwards.
fn out_of_face(placed: &Placed, mesh: &TriangleMesh) -> Vec3 {
    let points: Vec<Vec3> = placed.iter().flatten().copied().collect();
    let Ok(tree) = ClosestVertices::new(&mesh.positions) else { return Vec3::zeros() };
    let vertices = points.iter().filter_map(|p| tree.query(p)).map(|found| found.vertex);
    points.iter().sum::<Vec3>() / points.len() as f64 - middle_of_parts(mesh, vertices)
}

/// The values of [`DEFINITIONS`], in their order, in a frame or, without one, those that need none.
pub(super) fn evaluate(placed: &Placed, frame: &Result<FacialFrame, Missing>) -> Vec<Result<f64, Missing>> {
    let mut values: Vec<Result<f64, Missing>> = Vec::with_capacity(DEFINITIONS.len());
    for definition in DEFINITIONS {
        let value = match definition.formula {
            Formula::Percent(part, whole) => {
                let find = |name| match DEFINITIONS.iter().position(|d| d.name == name) {
                    Some(k) => values[k].clone(),
                    None => Err(Missing::Degenerate),
                };
                match (find(part), find(whole)) {
                    (Ok(part), Ok(whole)) => Ok(100.0 * part / whole),
                    (Err(Missing::Landmarks(mut a)), Err(Missing::Landmarks(b))) => {
                        a.extend(b);
                        a.sort_unstable_by_key(|name| index(name));
                        a.dedup();
                        Err(Missing::Landmarks(a))
                    }
                    (Err(missing), _) | (_, Err(missing)) => Err(missing),
                }
            }
            formula => of_landmarks(formula, placed, frame),
        };
        values.push(value.and_then(|v| if v.is_finite() { Ok(v) } else { Err(Missing::Degenerate) }));
    }
    values
}

fn of_landmarks(formula: Formula, placed: &Placed, frame: &Result<FacialFrame, Missing>) -> Result<f64, Missing> {
    let frame = || frame.as_ref().map_err(Clone::clone);
    let plane = || frame().map(|f| f.plane);
    let vertical = || match frame()?.vertical {
        Some(up) => Ok(up),
        None => points(placed, ["nasion", "menton"]).and(Err(Missing::Degenerate)),
    };
    match formula {
        Formula::Distance(a, b) => points(placed, [a, b]).map(|[a, b]| (b - a).norm()),
        Formula::Extent(axis, a, b) => {
            let [a, b] = points(placed, [a, b])?;
            let axis = match axis {
                Axis::Lateral => plane()?.normal,
                Axis::Vertical => vertical()?,
                Axis::Forwards => plane()?.normal.cross(&vertical()?),
            };
            Ok((b - a).dot(&axis))
        }
        Formula::BeforeLine(a, b, c) => {
            let [a, b, c] = points(placed, [a, b, c])?;
            let normal = plane()?.normal;
            // From below to above, the lateral axis times the line points out of the face.
            let forwards = normal.cross(&(a - b)).try_normalize(1e-9).ok_or(Missing::Degenerate)?;
            Ok((c - a).dot(&forwards))
        }
        Formula::Angle(a, b, c) => points(placed, [a, b, c]).map(|[a, b, c]| angle(a - b, c - b)),
        Formula::ProfileAngle(a, b, c) => {
            let [a, b, c] = points(placed, [a, b, c])?;
            let normal = plane()?.normal;
            let flat = |d: Vec3| d - normal * normal.dot(&d);
            Ok(angle(flat(a - b), flat(c - b)))
        }
        Formula::Slope(a, b) => {
            let [a, b] = points(placed, [a, b])?;
            let (across, up) = ((b - a).dot(&plane()?.normal).abs(), (b - a).dot(&vertical()?));
            if across == 0.0 && up == 0.0 { Err(Missing::Degenerate) } else { Ok(up.atan2(across).to_degrees()) }
        }
        Formula::Percent(..) => Err(Missing::Degenerate),
    }
}

/// Degrees, NaN where a direction has no length.
fn angle(u: Vec3, v: Vec3) -> f64 {
    if u.norm() == 0.0 || v.norm() == 0.0 { f64::NAN } else { u.cross(&v).norm().atan2(u.dot(&v)).to_degrees() }
}

/// Where landmarks are, or those that are not given.
fn points<const N: usize>(placed: &Placed, names: [&'static str; N]) -> Result<[Vec3; N], Missing> {
    let found = names.map(|name| index(name).and_then(|i| placed[i]));
    let missing: Vec<&str> = names.iter().zip(&found).filter(|f| f.1.is_none()).map(|f| *f.0).collect();
    if missing.is_empty() { Ok(found.map(Option::unwrap_or_default)) } else { Err(Missing::Landmarks(missing)) }
}
