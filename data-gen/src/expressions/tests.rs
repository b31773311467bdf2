//! Laws of the shapes.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use std::sync::LazyLock;

use nonrigid::mesh::Vec3;

use super::*;
use crate::face::{Around, CLOSED_MOUTH, EYEBALL, FaceModel, FaceWeights, Flat, MOUTH, eye_point, flatten, site};
use crate::{FaceOptions, FaceRig};

/// A rig and where its vertices lie.
struct Sample {
    rig: FaceRig,
    sites: Vec<Site>,
    triangles: Vec<[u32; 3]>,
    /// Two triangles and the edge between them.
    hinges: Vec<[usize; 2]>,
    border: BTreeSet<u32>,
}

static SAMPLES: LazyLock<[Sample; 3]> = LazyLock::new(|| [1000, 5000, 40_000].map(Sample::new));

impl Sample {
    fn new(vertices: usize) -> Self {
        let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: 1 });
        let sites: Vec<Site> = rig.places.iter().map(|p| site(*p)).collect();
        let triangles = rig.mesh.triangulate().triangles;
        let mut edges: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
        for (k, t) in triangles.iter().enumerate() {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                edges.entry((a.min(b), a.max(b))).or_default().push(k);
            }
        }
        let hinges = edges.values().filter(|t| t.len() == 2).map(|t| [t[0], t[1]]).collect();
        let outer = |v: u32| {
            let s = &sites[v as usize];
            s.mouth.r > 5.0 && s.left_eye.r > 5.0 && s.right_eye.r > 5.0
        };
        let border = edges.iter().filter(|e| e.1.len() == 1 && outer(e.0.0)).map(|e| e.0.0).collect();
        Self { rig, sites, triangles, hinges, border }
    }

    /// At these weights; a name without side means both.
    fn posed(&self, mixture: &[(&str, f64)]) -> Vec<Vec3> {
        let of = |name: &str| {
            let both = name.strip_suffix("_L").or(name.strip_suffix("_R")).unwrap_or(name);
            mixture.iter().find(|m| m.0 == name || m.0 == both).map_or(0.0, |m| m.1)
        };
        let weights: Vec<f64> = self.rig.expressions.iter().map(|e| of(&e.0)).collect();
        self.rig.pose(&weights, &[])
    }

    fn deltas(&self, name: &str) -> &[Vec3] {
        &self.rig.expressions.iter().find(|e| e.0 == name).unwrap().1
    }

    fn landmark(&self, name: &str) -> usize {
        self.rig.landmarks.iter().find(|l| l.name == name).unwrap().vertex as usize
    }

    /// Names without the right ones of the twins.
    fn names(&self) -> impl Iterator<Item = &str> {
        self.rig.expressions.iter().map(|e| e.0.as_str()).filter(|n| !n.ends_with("_R") && !n.ends_with("Right"))
    }
}

/// Strong mixtures that people make.
const MIXTURES: [&[(&str, f64)]; 4] = [
    &[("jawOpen", 1.0), ("mouthStretch", 0.6), ("browOuterUp", 0.7), ("eyeWide", 0.8)],
    &[("mouthSmile", 1.0), ("cheekRaiser", 1.0), ("eyeSquint", 1.0)],
    &[("jawOpen", 1.0), ("mouthFunnel", 1.0)],
    &[("eyeBlink", 1.0), ("noseSneer", 1.0), ("mouthUpperUp", 1.0)],
];

fn largest<'a>(deltas: impl IntoIterator<Item = &'a Vec3>) -> f64 {
    deltas.into_iter().map(|d| d.norm()).fold(0.0, f64::max)
}

#[test]
fn has_every_shape_once() {
    let names: Vec<String> = expressions().into_iter().map(|e| e.name).collect();
    let twins = "browDown browInnerUp browOuterUp cheekPuff cheekRaiser cheekSquint eyeBlink eyeLookDown eyeLookIn \
        eyeLookOut eyeLookUp eyeSquint eyeWide mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile mouthStretch \
        mouthUpperUp noseSneer";
    let single = "jawForward jawLeft jawOpen jawRight mouthFunnel mouthLeft mouthPucker mouthRight mouthRollLower \
        mouthRollUpper mouthShrugLower mouthShrugUpper";
    let twins = twins.split_whitespace().flat_map(|n| [format!("{n}_L"), format!("{n}_R")]);
    let wanted: BTreeSet<String> = twins.chain(single.split_whitespace().map(str::to_owned)).collect();
    assert_eq!(names.len(), wanted.len());
    assert_eq!(names.into_iter().collect::<BTreeSet<_>>(), wanted);
}

#[test]
fn right_is_left_mirrored_and_the_rest_is_symmetric() {
    let all = expressions();
    let twin = |name: &str| match name {
        n if n.ends_with("_L") => n.replace("_L", "_R"),
        n if n.ends_with("Left") => n.replace("Left", "Right"),
        n => n.to_owned(),
    };
    let sites = &SAMPLES[0].sites;
    for e in all.iter().filter(|e| !e.mirrored) {
        let other = all.iter().find(|o| o.name == twin(&e.name)).unwrap();
        for s in sites {
            let (d, m) = (e.displacement(s), other.displacement(&s.mirrored()));
            assert!((Vec3::new(-d.x, d.y, d.z) - m).norm() < 1e-6, "{} at {} {}", e.name, s.x, s.y);
        }
    }
}

#[test]
fn open_jaw_is_rigid_at_the_chin_and_parts_the_lips_to_an_oval() {
    for sample in SAMPLES.iter() {
        let (open, neutral) = (sample.posed(&[("jawOpen", 1.0)]), &sample.rig.neutral);
        let d = |name: &str| {
            let v = sample.landmark(name);
            open[v] - neutral[v]
        };
        let at = |name: &str| open[sample.landmark(name)];
        assert!((at("mouth_upper") - at("mouth_lower")).norm() >= 40.0);
        let chin: Vec<usize> = (0..open.len())
            .filter(|v| sample.sites[*v].x.abs() < 14.0 && (-122.0..-92.0).contains(&sample.sites[*v].y))
            .collect();
        for (&a, &b) in chin.iter().zip(chin.iter().rev().step_by(2)) {
            let (before, after) = ((neutral[a] - neutral[b]).norm(), (open[a] - open[b]).norm());
            assert!((after - before).abs() < 0.04 * before + 0.2, "{before} {after}");
        }
        let drop = d("mouth_corner_L").y / d("mouth_lower").y;
        assert!((0.2..0.45).contains(&drop), "corners drop by {drop}");
        assert!((-6.0..-1.0).contains(&d("mouth_corner_L").x), "and narrow by {}", d("mouth_corner_L").x);
        // In an oval the lower lip follows the more the nearer to the middle.
        assert!((0.75..1.0).contains(&(d("mouth_lower_L").y / d("mouth_lower").y)));
        for (still, by) in
            [("nose_tip", 0.5), ("nose_base", 1.0), ("mouth_upper", 2.0), ("jaw_L8", 1.5), ("eye_L_outer", 0.5)]
        {
            assert!(d(still).norm() < by, "{still} moves {}", d(still).norm());
        }
        let cheek = sample.rig.model.as_ref().unwrap().expression_deltas(
            sample.rig.expressions.iter().position(|e| e.0 == "jawOpen").unwrap(),
            &[site(flatten([45.0, -70.0])), site(flatten([0.0, -138.0]))],
        );
        assert!((4.0..25.0).contains(&cheek[0].norm()), "cheek {}", cheek[0].norm());
        assert!(cheek[1].norm() > 25.0, "under the chin {}", cheek[1].norm());
    }
}

#[test]
fn jaw_slides_by_eight_millimetres() {
    let sample = &SAMPLES[1];
    let chin = sample.landmark("chin");
    let [forward, left, right] = ["jawForward", "jawLeft", "jawRight"].map(|n| sample.deltas(n)[chin]);
    assert!(forward.z > 7.0 && forward.norm() < 10.0);
    assert!(left.x > 7.0 && left.norm() < 10.0 && (left.x + right.x).abs() < 1e-6);
}

/// Places on the left eye's lids: ring, angle.
fn lid(r: f64, eta: f64) -> Flat {
    flatten(eye_point(Around { r, eta }))
}

fn at_full(model: &FaceModel, name: &str, places: &[Flat]) -> Vec<Vec3> {
    let expressions = model.expression_names().map(|n| f64::from(u8::from(n == name))).collect();
    model.positions(places, &FaceWeights { expressions, identity: Vec::new() })
}

#[test]
fn a_blink_closes_the_eye_near_the_lower_lid() {
    let model = FaceModel::new(1);
    let rim = |side: f64| -> Vec<Flat> { (0..=400).map(|k| lid(0.0, side * PI * f64::from(k) / 400.0)).collect() };
    let (upper, lower) = (rim(1.0), rim(-1.0));
    let (up, low) = (at_full(&model, "eyeBlink_L", &upper), at_full(&model, "eyeBlink_L", &lower));
    let gap = |p: &Vec3, others: &[Vec3]| others.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min);
    let widest = up.iter().map(|p| gap(p, &low)).chain(low.iter().map(|p| gap(p, &up))).fold(0.0, f64::max);
    assert!(widest < 0.5, "{widest}");
    let neutral = |places: &[Flat]| model.positions(&[places[200]], &FaceWeights::default())[0];
    let down = neutral(&upper).y - up[200].y;
    let closed = down / (neutral(&upper).y - neutral(&lower).y);
    assert!((0.7..0.95).contains(&closed), "the upper lid does {closed} of the way");
    // Rows of vertices lie on the lids' edges.
    for sample in SAMPLES.iter() {
        let closed = sample.posed(&[("eyeBlink", 1.0)]);
        let on_edge = |v: &usize| sample.sites[*v].left_eye.r.abs() < 1e-6;
        let (above, below): (Vec<usize>, Vec<usize>) =
            (0..closed.len()).filter(on_edge).partition(|v| sample.sites[*v].left_eye.eta > 0.0);
        assert!(above.len() > 4 && below.len() > 4);
        for (rows, curve) in [(above, &low), (below, &up)] {
            for v in rows {
                assert!(gap(&closed[v], curve) < 0.5);
            }
        }
    }
}

#[test]
fn lids_never_sink_into_the_eyeballs() {
    let centre = Vec3::from(EYEBALL.0);
    for sample in SAMPLES.iter() {
        for name in sample.names() {
            let posed = sample.posed(&[(name, 1.0)]);
            let near = (0..posed.len()).filter(|v| sample.sites[*v].left_eye.r < 12.0);
            let nearest = near.map(|v| (posed[v] - centre).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest > EYEBALL.1 + 0.05, "{name} {nearest}");
        }
    }
}

/// What a pose does to the triangles: those of the skin turned by more than 90 degrees; the smallest share of its area that
/// a triangle keeps; the sharpest new fold, degrees between the normals of neighbours.
fn folds(sample: &Sample, posed: &[Vec3]) -> (usize, f64, f64) {
    let normal = |p: &[Vec3], t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| p[v as usize]);
        (b - a).cross(&(c - a))
    };
    let normals = |p: &[Vec3]| -> Vec<Vec3> { sample.triangles.iter().map(|t| normal(p, t)).collect() };
    let (before, after) = (normals(&sample.rig.neutral), normals(posed));
    let every = |t: &[u32; 3], law: fn(&Site) -> bool| t.iter().all(|v| law(&sample.sites[*v as usize]));
    // The margins of closed lids are pressed together out of sight; in the eyes' corners those of the neutral cross already.
    let outside_eyes: Vec<bool> =
        sample.triangles.iter().map(|t| every(t, |s| s.left_eye.r.min(s.right_eye.r) > -1e-6)).collect();
    // Where lips meet they face each other; at the corners of a mouth that opens they come to face forwards. In an eye's
    // corner the skin turns about it when the lids close.
    let law = |s: &Site| {
        let corner = |a: &Around, r: f64| a.r < r && a.eta.sin().abs() < 0.25;
        s.mouth.r > 3.0 && !corner(&s.mouth, 4.0) && !corner(&s.left_eye, 1.5) && !corner(&s.right_eye, 1.5)
    };
    let skin: Vec<bool> = sample.triangles.iter().zip(&outside_eyes).map(|(t, out)| *out && every(t, law)).collect();
    let turned = (0..before.len()).filter(|k| skin[*k] && before[*k].dot(&after[*k]) < 0.0).count();
    let shares = (0..before.len()).filter(|k| outside_eyes[*k]).map(|k| after[k].norm() / before[k].norm());
    let bend = |n: &[Vec3], [a, b]: [usize; 2]| n[a].angle(&n[b]).to_degrees();
    let sharpest = sample
        .hinges
        .iter()
        .filter(|h| h.iter().all(|k| outside_eyes[*k]) && bend(&after, **h) > bend(&before, **h) + 20.0)
        .map(|h| bend(&after, *h))
        .fold(0.0, f64::max);
    (turned, shares.fold(f64::INFINITY, f64::min), sharpest)
}

#[test]
fn nothing_folds() {
    let important =
        ["jawOpen", "eyeBlink_L", "mouthSmile_L", "mouthPucker", "mouthFunnel", "browDown_L", "mouthRollLower"];
    for (k, sample) in SAMPLES.iter().enumerate() {
        let single = sample.names().filter(|n| k < 2 || important.contains(n)).map(|n| vec![(n, 1.0)]);
        for mixture in single.chain(MIXTURES.map(<[_]>::to_vec)) {
            let (turned, area, bend) = folds(sample, &sample.posed(&mixture));
            assert_eq!(turned, 0, "{mixture:?}");
            // The corner between closed lids keeps least.
            assert!(area > 0.04, "{mixture:?} leaves {area} of a triangle");
            assert!(bend < 120.0, "{mixture:?} bends by {bend}");
        }
    }
}

#[test]
fn shapes_are_local_and_of_plausible_size() {
    for sample in &SAMPLES[..2] {
        for name in sample.names() {
            let d = sample.deltas(name);
            let size = largest(d);
            let range = match name {
                "jawOpen" => 40.0..52.0,
                "eyeLookIn_L" | "eyeLookOut_L" => 0.5..2.0,
                "eyeLookUp_L" | "eyeWide_L" => 1.5..4.0,
                "mouthSmile_L" | "mouthFunnel" | "mouthPucker" => 10.0..16.0,
                _ => 3.0..12.0,
            };
            assert!(range.contains(&size), "{name} moves up to {size} mm");
            let moved = d.iter().filter(|d| d.norm() > 0.1 * size).count() as f64 / d.len() as f64;
            assert!(moved < 0.36, "{name} moves {moved}");
            if name.ends_with("_L") {
                let right = d.iter().zip(&sample.sites).filter(|(_, s)| s.x < -15.0).map(|(d, _)| d);
                assert!(largest(right) < 0.08 * size, "{name} moves the right half");
                assert!(moved < 0.25, "{name} moves {moved}");
            }
            if !name.starts_with("jaw") {
                let border = largest(sample.border.iter().map(|v| &d[*v as usize]));
                assert!(border < 0.5, "{name} moves the border by {border}");
            }
            // The forehead's top and the skin before the ears stay whatever the shape.
            let fixed = sample.border.iter().filter(|v| sample.sites[**v as usize].y > -20.0);
            assert!(largest(fixed.map(|v| &d[*v as usize])) < 1.0, "{name}");
        }
    }
}

#[test]
fn fields_are_smooth_away_from_lips_and_lids() {
    const STEP: f64 = 1e-3;
    let model = FaceModel::new(1);
    let mut places: Vec<Flat> = Vec::new();
    for i in -40..=40 {
        for j in -56..=34 {
            places.push([2.43 * f64::from(i) + 0.1, 2.43 * f64::from(j) + 0.2]);
        }
    }
    // Lines on which formulas change: beyond the corners of mouth and eyes, and the symmetry plane.
    for k in 0..30 {
        let r = 3.1 + 1.3 * f64::from(k);
        let [x, y] = CLOSED_MOUTH.point(Around { r, eta: 0.0 });
        places.push(flatten([MOUTH[0] + x, MOUTH[1] + y]));
        places.extend([0.0, PI].map(|eta| lid(r, eta)));
        places.push([0.0, 75.0 - 5.0 * f64::from(k)]);
    }
    places.retain(|p| model.contains(*p));
    // Far from the eyes a head without features, so that kinks are the shapes' own.
    let at = |place: Flat| {
        let mut s = site(place);
        if s.left_eye.r.min(s.right_eye.r) > 30.0 {
            s.neutral = Vec3::new(s.x, s.y, -s.x * s.x / 120.0);
        }
        s
    };
    for e in expressions().iter().filter(|e| !e.mirrored) {
        for [u, v] in &places {
            for [du, dv] in [[STEP, 0.0], [0.0, STEP]] {
                let sites = [-1.0, 0.0, 1.0].map(|k| at([u + k * du, v + k * dv]));
                let [a, b, c] = sites.each_ref().map(|s| e.displacement(s));
                let Site { x, y, mouth, left_eye, right_eye, .. } = sites[1];
                if mouth.r < 2.5 || left_eye.r.min(right_eye.r) < 0.5 {
                    continue;
                }
                let (slope, kink) = ((c - a).norm() / (2.0 * STEP), (a - 2.0 * b + c).norm() / STEP);
                // Beside the corners of the mouth the skin of 25 mm opens round the jaw's 40.
                let steepest = if e.name == "jawOpen" { 5.0 } else { 2.0 };
                assert!(slope < steepest, "{} changes by {slope} mm a millimetre at {x} {y}", e.name);
                assert!(kink < 0.01, "{} has a kink of {kink} at {x} {y}", e.name);
            }
        }
    }
}
