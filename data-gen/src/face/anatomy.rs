//! Names on the face: landmarks and regions.

use super::rings::Around;
use super::sculpt::lip_height;
use super::site::{FLAT_MOUTH, MOUTH, Site, eye_point, flatten};

/// Where a landmark lies: in the chart's left half, or on a ring round mouth or left eye.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Mark {
    Chart([f64; 2]),
    /// Angle in degrees on the left lid's edge.
    Lid(f64),
    /// Angle in degrees and share of the lips' red height: 0 where they meet, 1 at the border.
    Lip(f64, f64),
}

/// The 68 landmarks of Multi-PIE/iBUG in their order: name, side (-1: mirrored to the subject's right), place.
pub(crate) const LANDMARKS: [(&str, f64, Mark); 68] = {
    use Mark::{Chart, Lid, Lip};
    const L: f64 = 1.0;
    const R: f64 = -1.0;
    const JAW: [[f64; 2]; 8] = [
        [14.0, -112.5],
        [28.0, -107.0],
        [42.0, -100.0],
        [57.0, -92.0],
        [70.0, -82.0],
        [80.0, -62.0],
        [86.0, -38.0],
        [89.0, -12.0],
    ];
    const BROW: [[f64; 2]; 5] = [[11.0, 17.5], [20.0, 21.0], [30.0, 22.5], [40.0, 21.5], [50.0, 17.0]];
    [
        ("jaw_R8", R, Chart(JAW[7])),
        ("jaw_R7", R, Chart(JAW[6])),
        ("jaw_R6", R, Chart(JAW[5])),
        ("jaw_R5", R, Chart(JAW[4])),
        ("jaw_R4", R, Chart(JAW[3])),
        ("jaw_R3", R, Chart(JAW[2])),
        ("jaw_R2", R, Chart(JAW[1])),
        ("jaw_R1", R, Chart(JAW[0])),
        ("chin", L, Chart([0.0, -114.0])),
        ("jaw_L1", L, Chart(JAW[0])),
        ("jaw_L2", L, Chart(JAW[1])),
        ("jaw_L3", L, Chart(JAW[2])),
        ("jaw_L4", L, Chart(JAW[3])),
        ("jaw_L5", L, Chart(JAW[4])),
        ("jaw_L6", L, Chart(JAW[5])),
        ("jaw_L7", L, Chart(JAW[6])),
        ("jaw_L8", L, Chart(JAW[7])),
        ("brow_R5", R, Chart(BROW[4])),
        ("brow_R4", R, Chart(BROW[3])),
        ("brow_R3", R, Chart(BROW[2])),
        ("brow_R2", R, Chart(BROW[1])),
        ("brow_R1", R, Chart(BROW[0])),
        ("brow_L1", L, Chart(BROW[0])),
        ("brow_L2", L, Chart(BROW[1])),
        ("brow_L3", L, Chart(BROW[2])),
        ("brow_L4", L, Chart(BROW[3])),
        ("brow_L5", L, Chart(BROW[4])),
        ("nose_bridge1", L, Chart([0.0, 3.0])),
        ("nose_bridge2", L, Chart([0.0, -11.0])),
        ("nose_bridge3", L, Chart([0.0, -25.0])),
        ("nose_tip", L, Chart([0.0, -38.0])),
        ("nose_base_R2", R, Chart([13.0, -47.5])),
        ("nose_base_R1", R, Chart([6.5, -48.0])),
        ("nose_base", L, Chart([0.0, -49.0])),
        ("nose_base_L1", L, Chart([6.5, -48.0])),
        ("nose_base_L2", L, Chart([13.0, -47.5])),
        ("eye_R_outer", R, Lid(0.0)),
        ("eye_R_upper_outer", R, Lid(60.0)),
        ("eye_R_upper_inner", R, Lid(120.0)),
        ("eye_R_inner", R, Lid(180.0)),
        ("eye_R_lower_inner", R, Lid(-120.0)),
        ("eye_R_lower_outer", R, Lid(-60.0)),
        ("eye_L_inner", L, Lid(180.0)),
        ("eye_L_upper_inner", L, Lid(120.0)),
        ("eye_L_upper_outer", L, Lid(60.0)),
        ("eye_L_outer", L, Lid(0.0)),
        ("eye_L_lower_outer", L, Lid(-60.0)),
        ("eye_L_lower_inner", L, Lid(-120.0)),
        ("lip_corner_R", R, Lip(0.0, 1.0)),
        ("lip_upper_R2", R, Lip(50.0, 1.0)),
        ("lip_upper_R1", R, Lip(77.0, 1.0)),
        ("lip_upper", L, Lip(90.0, 1.0)),
        ("lip_upper_L1", L, Lip(77.0, 1.0)),
        ("lip_upper_L2", L, Lip(50.0, 1.0)),
        ("lip_corner_L", L, Lip(0.0, 1.0)),
        ("lip_lower_L2", L, Lip(-45.0, 1.0)),
        ("lip_lower_L1", L, Lip(-70.0, 1.0)),
        ("lip_lower", L, Lip(-90.0, 1.0)),
        ("lip_lower_R1", R, Lip(-70.0, 1.0)),
        ("lip_lower_R2", R, Lip(-45.0, 1.0)),
        ("mouth_corner_R", R, Lip(0.0, 0.0)),
        ("mouth_upper_R", R, Lip(65.0, 0.0)),
        ("mouth_upper", L, Lip(90.0, 0.0)),
        ("mouth_upper_L", L, Lip(65.0, 0.0)),
        ("mouth_corner_L", L, Lip(0.0, 0.0)),
        ("mouth_lower_L", L, Lip(-65.0, 0.0)),
        ("mouth_lower", L, Lip(-90.0, 0.0)),
        ("mouth_lower_R", R, Lip(-65.0, 0.0)),
    ]
};

/// Landmarks of anthropometry, those on the midline and the left ones of pairs. Where they are is what their definitions say of
/// the neutral face: `nonrigid measure --list`.
pub(crate) const ANTHROPOMETRIC: [(&str, Mark); 18] = {
    use Mark::{Chart, Lid, Lip};
    [
        ("trichion", Chart([0.0, 80.0])),
        ("glabella", Chart([0.0, 21.5])),
        ("nasion", Chart([0.0, 5.0])),
        ("pronasale", Chart([0.0, -39.2])),
        ("subnasale", Chart([0.0, -50.0])),
        ("labiale_superius", Lip(90.0, 1.0)),
        ("stomion", Lip(90.0, 0.0)),
        ("labiale_inferius", Lip(-90.0, 1.0)),
        ("sublabiale", Chart([0.0, -88.0])),
        ("pogonion", Chart([0.0, -100.0])),
        ("menton", Chart([0.0, -118.0])),
        ("endocanthion_left", Lid(180.0)),
        ("exocanthion_left", Lid(0.0)),
        ("subalare_left", Chart([13.0, -48.0])),
        ("alare_left", Chart([18.5, -42.0])),
        ("cheilion_left", Lip(0.0, 1.0)),
        ("zygion_left", Chart([92.0, -14.0])),
        ("gonion_left", Chart([80.0, -62.0])),
    ]
};

impl Mark {
    /// The flat place of a mark on the left side.
    pub fn flat(self) -> [f64; 2] {
        match self {
            Self::Chart(at) => flatten(at),
            Self::Lid(degrees) => flatten(eye_point(Around { r: 0.0, eta: degrees.to_radians() })),
            Self::Lip(degrees, share) => {
                let eta = degrees.to_radians();
                let [x, y] = FLAT_MOUTH.point(Around { r: share * lip_height(eta), eta });
                [MOUTH[0] + x, MOUTH[1] + y]
            }
        }
    }
}

/// Names of the regions; every place belongs to exactly one.
pub(crate) const REGIONS: [&str; 10] =
    ["forehead", "temples", "brows", "eyelids", "nose", "cheeks", "philtrum", "lips", "chin", "jaw"];

/// The region of a place: an index into [`REGIONS`].
pub(crate) fn region(site: &Site) -> usize {
    let (x, y) = (site.x.abs(), site.y);
    let eye = site.left_eye.r.min(site.right_eye.r);
    let nose_width = 8.0 + 12.0 * ((5.0 - y) / 40.0).clamp(0.0, 1.0);
    let name = if site.mouth.r <= lip_height(site.mouth.eta) + 0.2 {
        "lips"
    } else if eye <= 7.5 {
        "eyelids"
    } else if x < nose_width && (-50.0..12.0).contains(&y) {
        "nose"
    } else if x < 56.0 && (8.0..27.0).contains(&y) {
        "brows"
    } else if y >= 8.0 && x < 56.0 {
        "forehead"
    } else if y >= -2.0 {
        "temples"
    } else if x < 24.0 && (MOUTH[1] - 3.0..-40.0).contains(&y) {
        "philtrum"
    } else if x < 24.0 && y < MOUTH[1] {
        "chin"
    } else if y < -84.0 || y < -50.0 - 1.6 * (78.0 - x) {
        "jaw"
    } else {
        "cheeks"
    };
    REGIONS.iter().position(|r| *r == name).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::site;
    use nonrigid::mesh::Vec3;
    use std::collections::BTreeSet;

    #[test]
    fn landmarks_have_68_names_and_lie_in_their_regions() {
        let names: BTreeSet<&str> = LANDMARKS.iter().map(|l| l.0).collect();
        assert_eq!(names.len(), 68);
        for (name, side, mark) in LANDMARKS {
            let [x, y] = mark.flat();
            let site = site([side * x, y]);
            let expected: &[&str] = match name.split('_').next() {
                Some("jaw") => &["jaw", "cheeks", "chin"],
                Some("brow") => &["brows"],
                Some("nose") => &["nose", "philtrum"],
                Some("eye") => &["eyelids"],
                Some("lip" | "mouth") => &["lips"],
                _ => &["chin"],
            };
            assert!(expected.contains(&REGIONS[region(&site)]), "{name} in {}", REGIONS[region(&site)]);
            let right = name.contains("_R");
            let left = name.contains("_L");
            assert!((!right || site.neutral.x < 0.0) && (!left || site.neutral.x > 0.0), "{name}: {}", site.neutral);
        }
    }

    #[test]
    fn landmarks_of_anthropometry_are_where_their_definitions_say() {
        let place = |name: &str| site(ANTHROPOMETRIC.iter().find(|l| l.0 == name).unwrap().1.flat()).neutral;
        // Most and least prominent points of the midline between two heights of the chart.
        for (name, low, high, forwards) in [
            ("glabella", 15, 35, 1.0),
            ("nasion", -5, 15, -1.0),
            ("pronasale", -45, -30, 1.0),
            ("sublabiale", -95, -80, -1.0),
            ("pogonion", -108, -92, 1.0),
        ] {
            let midline = (10 * low..10 * high).map(|y| site(Mark::Chart([0.0, 0.1 * f64::from(y)]).flat()).neutral.z);
            let most = midline.map(|z| forwards * z).fold(f64::MIN, f64::max);
            let found = forwards * place(name).z;
            assert!(place(name).x == 0.0 && most - found < 0.1, "{name}: {found} of {most}");
        }
        let left: Vec<Vec3> =
            ANTHROPOMETRIC.iter().filter(|l| l.0.ends_with("_left")).map(|l| site(l.1.flat()).neutral).collect();
        assert!(left.len() == 7 && left.iter().all(|p| p.x > 10.0));
        let widest = left.iter().map(|p| p.x).fold(0.0, f64::max);
        assert!(place("zygion_left").x == widest && place("gonion_left").x < widest - 5.0);
        assert!(place("alare_left").x > place("subalare_left").x && place("menton").y < place("pogonion").y - 10.0);
    }

    #[test]
    fn the_line_from_brow_to_chin_goes_down_in_order() {
        let height = |name: &str| {
            let mark = LANDMARKS.iter().find(|l| l.0 == name).unwrap().2;
            site(mark.flat()).neutral.y
        };
        let order = [
            "brow_L3",
            "eye_L_upper_inner",
            "eye_L_lower_inner",
            "nose_tip",
            "nose_base",
            "lip_upper",
            "lip_lower",
            "chin",
        ];
        assert!(order.windows(2).all(|w| height(w[0]) > height(w[1]) + 1.0));
    }
}
