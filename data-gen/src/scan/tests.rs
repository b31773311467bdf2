//! Laws of scans.

use nonrigid::mesh::closest_point::{ClosestPoint, ClosestVertices};
use rand::Rng;

use super::*;
use crate::FaceOptions;
use crate::face::Site;

fn rig() -> FaceRig {
    FaceRig::generate(&FaceOptions { vertices: 1200, identity_modes: 6 })
}

fn small() -> ScanOptions {
    ScanOptions { triangles: 8000, ..ScanOptions::default() }
}

/// The posed face of a person with all its detail, seen from everywhere, without faults.
fn faultless(triangles: usize) -> ScanOptions {
    ScanOptions {
        triangles,
        cameras: Vec::new(),
        noise: 0.0,
        holes: 0,
        spikes: 0.0,
        outliers: 0.0,
        loose_parts: 0,
        eyeballs: false,
        expressions: Some(vec![("jawOpen".into(), 0.6), ("eyeBlink".into(), 0.4), ("mouthSmile".into(), 0.7)]),
        ..ScanOptions::default()
    }
}

fn scan(rig: &FaceRig, options: &ScanOptions, seed: u64) -> ScanCase {
    simulate_scan(rig, options, seed).unwrap()
}

fn bits(case: &ScanCase) -> Vec<u64> {
    let positions = case.scan.positions.iter().chain(&case.truth).chain(case.landmarks.iter().map(|l| &l.1));
    positions.flat_map(|p| [p.x, p.y, p.z]).map(f64::to_bits).collect()
}

fn share(flags: &[bool]) -> f64 {
    flags.iter().filter(|o| **o).count() as f64 / flags.len() as f64
}

/// Vertices of the template that are on none of its borders, nor next to one.
fn inner(rig: &FaceRig) -> Vec<usize> {
    let triangles = rig.mesh.triangulate();
    let boundary = nonrigid::mesh::adjacency::OpenBoundary::of(&triangles);
    let mut inner = vec![true; rig.neutral.len()];
    for (k, t) in triangles.triangles.iter().enumerate() {
        let at = |c: usize| std::array::from_fn(|i| f64::from(u8::from(i == c)));
        if (0..3).any(|c| boundary.holds(k, *t, at(c))) {
            t.iter().for_each(|v| inner[*v as usize] = false);
        }
    }
    (0..inner.len()).filter(|v| inner[*v]).collect()
}

#[test]
fn the_truth_lies_on_the_scan_up_to_the_chords_of_its_triangles() {
    let rig = rig();
    // Nine tenths of the vertices are nearer than this, at edges of about 1, 1/2 and 1/4: 1/16 in the end, but for detail
    // that the first do not resolve.
    let errors = [20_000, 80_000, 320_000].map(|triangles| {
        let case = scan(&rig, &faultless(triangles), 3);
        let tree = ClosestPoint::new(&case.scan).unwrap();
        let mut off: Vec<f64> = case.truth.iter().map(|p| tree.query(p).unwrap().squared_distance.sqrt()).collect();
        off.sort_by(f64::total_cmp);
        off[off.len() * 9 / 10]
    });
    assert!(errors[0] < 0.2 && errors[2] < 0.016, "{errors:?}");
    assert!(errors[1] < 0.45 * errors[0] && errors[2] < 0.12 * errors[0], "{errors:?}");
    // A shift of the truth along the surface by its own detail's height would not pass unseen:
    let smooth = scan(&rig, &ScanOptions { detail: 0.0, ..faultless(160_000) }, 3);
    let detailed = scan(&rig, &faultless(10_000), 3);
    let moved: Vec<f64> = smooth.truth.iter().zip(&detailed.truth).map(|(a, b)| (a - b).norm()).collect();
    let largest = moved.iter().copied().fold(0.0, f64::max);
    let mean = moved.iter().sum::<f64>() / moved.len() as f64;
    assert!(largest <= 0.8 && largest > 0.5 && mean > 0.05, "detail: {largest}, {mean}");
}

#[test]
fn scan_vertices_say_nothing_about_template_vertices() {
    let rig = FaceRig::generate(&FaceOptions { vertices: 4000, identity_modes: 6 });
    let inner = inner(&rig);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut at_vertices, mut elsewhere, mut close, mut nearest) = (0.0, 0.0, [0, 0], f64::INFINITY);
    for seed in 0..2 {
        let options = faultless(30_000);
        let case = scan(&rig, &options, seed);
        let tree = ClosestVertices::new(&case.scan.positions).unwrap();
        let distance = |p: &Vec3| tree.query(p).unwrap().squared_distance.sqrt();
        nearest = case.truth.iter().map(distance).fold(nearest, f64::min);
        // Other points of the surface: each vertex' place moved a few scan edges in a random direction.
        let places: Vec<Flat> = inner
            .iter()
            .map(|v| {
                let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
                [rig.places[*v][0] + 3.0 * cos, rig.places[*v][1] + 3.0 * sin]
            })
            .collect();
        let weights =
            FaceWeights { expressions: case.expression_weights.clone(), identity: case.identity_weights.clone() };
        let model = rig.model.as_ref().unwrap();
        let contains = |p: Flat| model.contains(p);
        let detail = Detail::new(options.detail, options.wrinkles, &mut Stream::Detail.of(seed));
        let manner = Manner::new(options.manner, &mut Stream::Manner.of(seed));
        let surface = Surface::new(model, &contains, weights, case.pose, manner, detail, false);
        let controls = surface.skin(&places);
        for ((v, place), control) in inner.iter().zip(&places).zip(&controls) {
            if contains(*place) {
                let (vertex, control) = (distance(&case.truth[*v]), distance(control));
                at_vertices += vertex;
                elsewhere += control;
                close[0] += i32::from(vertex < 0.15);
                close[1] += i32::from(control < 0.15);
            }
        }
    }
    let ratio = at_vertices / elsewhere;
    assert!((0.95..1.05).contains(&ratio), "{ratio}");
    // Close pairs are as many as elsewhere, up to four standard deviations, and none is more than close.
    assert!(
        close[1] > 100 && f64::from(close[0] - close[1]).abs() < 4.0 * f64::from(close[0] + close[1]).sqrt(),
        "{close:?}"
    );
    assert!(nearest > 1e-7, "{nearest}");
}

#[test]
fn scans_have_as_many_triangles_as_asked_for() {
    let rig = rig();
    for (triangles, options) in
        [(5000, ScanOptions::default()), (30_000, ScanOptions::default()), (100_000, faultless(1000))]
    {
        let found = scan(&rig, &ScanOptions { triangles, ..options }, 4).scan.triangles.len();
        assert!((found as f64 / triangles as f64 - 1.0).abs() < 0.04, "{found} of {triangles}");
    }
}

#[test]
fn triangles_are_a_clean_oriented_even_sampling() {
    let rig = rig();
    let case = scan(&rig, &faultless(20_000), 5);
    let TriangleMesh { positions, triangles } = &case.scan;
    let mut edges = std::collections::BTreeSet::new();
    let mut areas = Vec::new();
    for t in triangles {
        for i in 0..3 {
            assert!(edges.insert((t[i], t[(i + 1) % 3])), "an edge is used twice in one direction");
        }
        let [a, b, c] = t.map(|v| positions[v as usize]);
        areas.push(0.5 * (b - a).cross(&(c - a)).norm());
    }
    // One component of three holes and an outer border: Euler's characteristic is 1 - 3.
    let open = edges.iter().filter(|(a, b)| !edges.contains(&(*b, *a))).count();
    let undirected = (edges.len() + open) / 2;
    assert_eq!(positions.len() as i64 - undirected as i64 + triangles.len() as i64, -2);
    // Even: few triangles far from the mean area, but not a lattice either.
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    let odd = areas.iter().filter(|a| **a < 0.1 * mean || **a > 3.0 * mean).count() as f64 / areas.len() as f64;
    let spread = (areas.iter().map(|a| (a / mean - 1.0).powi(2)).sum::<f64>() / areas.len() as f64).sqrt();
    assert!(odd < 0.03 && (0.25..0.7).contains(&spread), "{odd} {spread}");
    // They face the viewer, mostly.
    let front = triangles.iter().filter(|t| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        (b - a).cross(&(c - a)).z > 0.0
    });
    assert!(front.count() as f64 > 0.85 * triangles.len() as f64);
}

#[test]
fn observed_vertices_lie_on_the_scan_and_hidden_ones_do_not_count() {
    let rig = rig();
    let options = ScanOptions::default();
    let case = scan(&rig, &options, 4);
    let all = share(&case.observed);
    assert!(all > 0.75 && all < 1.0, "{all}");
    let frontal =
        ScanOptions { cameras: vec![Camera::orbit(0.0, 0.0)], grazing: 50.0, pose: Some(case.pose), ..options.clone() };
    let fewer = share(&scan(&rig, &frontal, 4).observed);
    assert!(fewer < 0.85 * all, "{fewer} of {all}");
    // On it: no further than noise; spikes and outliers are where they are.
    let quiet = scan(&rig, &ScanOptions { spikes: 0.0, outliers: 0.0, ..options }, 4);
    let tree = ClosestPoint::new(&quiet.scan).unwrap();
    let far = |p: &Vec3| tree.query(p).unwrap().squared_distance.sqrt();
    let shown = quiet.truth.iter().zip(&quiet.observed).filter(|(_, o)| **o).map(|(p, _)| far(p));
    let mut shown: Vec<f64> = shown.collect();
    shown.sort_by(f64::total_cmp);
    assert!(shown[shown.len() * 99 / 100] < 0.4 && shown[shown.len() - 1] < 1.5);
    let hidden: Vec<f64> = quiet.truth.iter().zip(&quiet.observed).filter(|(_, o)| !**o).map(|(p, _)| far(p)).collect();
    assert!(hidden.iter().filter(|d| **d > 0.5).count() > hidden.len() / 4);
    assert!(case.landmarks.len() > 40);
    for (v, p) in &case.landmarks {
        assert!(case.observed[*v as usize] && (p - case.truth[*v as usize]).norm() < 6.0);
    }
    // The inside of the closed lips is never seen.
    let neutral = scan(&rig, &ScanOptions { expressions: Some(Vec::new()), holes: 0, ..small() }, 4);
    let in_the_mouth: Vec<bool> = (0..rig.places.len())
        .filter(|v| Site::flat(rig.places[*v]).mouth.r < -3.0)
        .map(|v| neutral.observed[v])
        .collect();
    assert!(in_the_mouth.len() > 20 && !in_the_mouth.contains(&true));
}

#[test]
fn eyeballs_show_between_open_lids_and_not_between_closed_ones() {
    let rig = rig();
    let shown = |expression: &str, eyeballs: bool| {
        let options = ScanOptions {
            expressions: Some(vec![(expression.into(), 1.0)]),
            identity: Some(Vec::new()),
            rotation: 0.0,
            translation: 0.0,
            cameras: ScanOptions::default().cameras,
            eyeballs,
            ..faultless(60_000)
        };
        let case = scan(&rig, &options, 4);
        let [left, right] = rig.eyeballs(&[]).unwrap();
        let on = |p: &Vec3| [left, right].iter().any(|e| ((p - e.centre).norm() - e.radius).abs() < 1e-6);
        case.scan.positions.iter().filter(|p| on(p)).count()
    };
    let (open, closed) = (shown("eyeWide", true), shown("eyeBlink", true));
    assert!(open > 150 && closed < open / 20, "{open} {closed}");
    assert_eq!(shown("eyeWide", false), 0);
}

#[test]
fn faults_are_as_large_as_asked_for() {
    let rig = rig();
    let base = ScanOptions {
        cameras: vec![Camera::Position([0.0, 0.0, 800.0])],
        pose: Some(Pose::identity()),
        ..faultless(20_000)
    };
    let clean = scan(&rig, &base, 6);
    let moved = |options: &ScanOptions| -> Vec<Vec3> {
        let case = scan(&rig, options, 6);
        assert_eq!(case.scan.triangles, clean.scan.triangles, "faults do not change what is seen, nor the order");
        case.scan.positions.iter().zip(&clean.scan.positions).map(|(a, b)| a - b).collect()
    };
    let rms = |d: &[Vec3]| (d.iter().map(Vec3::norm_squared).sum::<f64>() / d.len() as f64).sqrt();
    let noisy = moved(&ScanOptions { noise: 0.2, grazing_noise: 0.0, ..base.clone() });
    assert!((rms(&noisy) / 0.2 - 1.0).abs() < 0.03, "{}", rms(&noisy));
    let along = noisy.iter().zip(&clean.scan.positions).all(|(d, p)| {
        let ray = (Vec3::new(0.0, 0.0, 800.0) - p).normalize();
        (d - ray * d.dot(&ray)).norm() < 1e-9
    });
    assert!(along, "along the view ray");
    assert!(rms(&moved(&ScanOptions { noise: 0.2, grazing_noise: 2.0, ..base.clone() })) > 1.2 * 0.2);
    let spiky = moved(&ScanOptions { spikes: 0.02, ..base.clone() });
    let heights: Vec<f64> = spiky.iter().map(Vec3::norm).filter(|h| *h > 0.0).collect();
    assert!((heights.len() as f64 / spiky.len() as f64 / 0.02 - 1.0).abs() < 0.3);
    assert!(heights.iter().all(|h| (3.0..=15.0).contains(h)));

    let holes = scan(&rig, &ScanOptions { holes: 3, hole_radius: [6.0, 6.0], ..base.clone() }, 6);
    let lost = share(&clean.observed) - share(&holes.observed);
    assert!(lost > 0.002 && lost < 0.06, "{lost}");
    let loose = scan(&rig, &ScanOptions { loose_parts: 2, outliers: 0.01, ..base }, 6);
    let tree = ClosestPoint::new(&clean.scan).unwrap();
    let far = loose.scan.positions.iter().filter(|p| tree.query(p).unwrap().squared_distance > 4.0).count();
    assert!(far > 400, "{far}");
}

#[test]
fn equal_seeds_give_equal_bits_with_any_number_of_threads_and_others_do_not() {
    let rig = rig();
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let a = pool(1).install(|| scan(&rig, &small(), 7));
    let b = pool(3).install(|| scan(&rig, &small(), 7));
    assert_eq!(bits(&a), bits(&b));
    assert_eq!((&a.scan.triangles, &a.observed), (&b.scan.triangles, &b.observed));
    assert_ne!(bits(&a), bits(&scan(&rig, &small(), 8)));
    let quiet = scan(&rig, &ScanOptions { noise: 0.0, spikes: 0.0, ..small() }, 7);
    assert_eq!((quiet.truth, quiet.scan.triangles), (a.truth, a.scan.triangles), "streams are independent");
}

#[test]
fn a_clean_scan_is_the_rig_in_its_own_place() {
    let rig = rig();
    let options = ScanOptions {
        expressions: Some(vec![("jawOpen".into(), 0.5), ("mouthSmile".into(), 1.0), ("mouthSmile_R".into(), 0.2)]),
        identity: Some(vec![1.0]),
        triangles: 8000,
        ..ScanOptions::clean()
    };
    let case = scan(&rig, &options, 1);
    let expected = rig.pose(&case.expression_weights, &case.identity_weights);
    let largest = case.truth.iter().zip(&expected).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(largest < 1e-9, "{largest}");
    let weight = |name: &str| case.expression_weights[rig.expressions.iter().position(|e| e.0 == name).unwrap()];
    assert_eq!(["jawOpen", "mouthSmile_L", "mouthSmile_R"].map(weight), [0.5, 1.0, 0.2]);
    assert_eq!(case.identity_weights[..2], [1.0, 0.0]);
    assert!(case.observed.iter().all(|o| *o), "{}", share(&case.observed));
}

/// A rig as if it were read from files, and a clean scan of its neutral.
fn read_rig() -> (FaceRig, ScanOptions) {
    let options = ScanOptions {
        scanner: Scanner::Fused,
        expressions: Some(Vec::new()),
        identity: Some(Vec::new()),
        triangles: 8000,
        ..ScanOptions::clean()
    };
    (FaceRig { model: None, ..rig() }, options)
}

#[test]
fn what_lies_beyond_a_joint_turns_as_one_and_the_rest_stays() {
    let (rig, options) = read_rig();
    let bend = Bend { tip: "chin".into(), joint: "nose_tip".into(), degrees: 40.0 };
    let before = scan(&rig, &options, 5).truth;
    let after = scan(&rig, &ScanOptions { bends: vec![bend.clone()], ..options.clone() }, 5).truth;
    let still = before.iter().zip(&after).filter(|(a, b)| (*a - *b).norm() < 1e-9).count();
    let at = |name: &str| rig.landmarks.iter().find(|l| l.name == name).unwrap().vertex as usize;
    let chin = at("chin");
    let part: Vec<usize> = (0..before.len()).filter(|v| (before[*v] - before[chin]).norm() < 20.0).collect();
    assert!(still > before.len() / 3 && part.len() > 10, "{still} {}", part.len());
    assert!((before[chin] - after[chin]).norm() > 1.0);
    for v in part {
        let [a, b] = [&before, &after].map(|p| (p[v] - p[chin]).norm());
        assert!((a - b).abs() < 1e-9, "{v}: {a} {b}");
    }
    let error = |bend: Bend| simulate_scan(&rig, &ScanOptions { bends: vec![bend], ..options.clone() }, 5).unwrap_err();
    let unknown = error(Bend { tip: "chni".into(), ..bend.clone() }).to_string();
    assert!(unknown.contains("chni") && unknown.contains("nose_tip"), "{unknown}");
    assert!(error(Bend { tip: "nose_tip".into(), ..bend }).to_string().contains("no way leads"));
}

#[test]
fn the_field_is_as_large_as_it_says_and_smooth() {
    let (rig, options) = read_rig();
    let before = scan(&rig, &options, 5).truth;
    let square: f64 = (0..8)
        .map(|seed| {
            let after = scan(&rig, &ScanOptions { field: 2.0, ..options.clone() }, seed).truth;
            let moved: Vec<Vec3> = before.iter().zip(&after).map(|(a, b)| b - a).collect();
            for t in rig.mesh.triangulate().triangles {
                let [a, b] = [t[0] as usize, t[1] as usize];
                assert!((moved[a] - moved[b]).norm() < 0.15 * (before[a] - before[b]).norm());
            }
            moved.iter().map(Vec3::norm_squared).sum::<f64>() / (8 * moved.len()) as f64
        })
        .sum();
    assert!((1.5..2.5).contains(&square.sqrt()), "{}", square.sqrt());
}

#[test]
fn one_end_is_cut_off() {
    let (rig, options) = read_rig();
    for seed in 0..3 {
        let whole = scan(&rig, &options, seed);
        let part = scan(&rig, &ScanOptions { keep: 0.5, ..options.clone() }, seed);
        let left = share(&part.observed) / share(&whole.observed);
        assert!((0.35..0.65).contains(&left), "{left}");
        // A face is longest from top to bottom.
        let height = |case: &ScanCase| {
            let heights = case.scan.positions.iter().map(|p| p.y);
            heights.clone().fold(f64::MIN, f64::max) - heights.fold(f64::MAX, f64::min)
        };
        assert!(height(&part) < 0.7 * height(&whole));
    }
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let rig = rig();
    let error = |options: ScanOptions| simulate_scan(&rig, &options, 1).unwrap_err().to_string();
    let unknown = error(ScanOptions { expressions: Some(vec![("jawOpne".into(), 1.0)]), ..small() });
    assert!(unknown.contains("jawOpne") && unknown.contains("jawOpen") && unknown.contains("eyeBlink_L"), "{unknown}");
    assert!(error(ScanOptions { noise: -1.0, ..small() }).contains("noise"));
    assert!(error(ScanOptions { detail: f64::NAN, ..small() }).contains("detail"));
    assert!(error(ScanOptions { triangles: 10, ..small() }).contains("500 to 10,000,000"));
    assert!(error(ScanOptions { hole_radius: [9.0, 1.0], ..small() }).contains("hole"));
    assert!(error(ScanOptions { identity: Some(vec![f64::INFINITY]), ..small() }).contains("weight"));
    assert!(error(ScanOptions { cameras: vec![Camera::orbit(0.0, 95.0)], ..small() }).contains("camera"));
    let behind = ScanOptions { cameras: vec![Camera::orbit(180.0, 0.0)], ..small() };
    assert_eq!(simulate_scan(&rig, &behind, 1), Err(ScanError::NothingSeen));
    for (name, shapes) in PRESETS {
        let names: Vec<&str> = rig.expressions.iter().map(|e| &*e.0).collect();
        assert!(shapes.iter().all(|s| resolve_shapes(&names, s.0).is_ok()), "{name}");
    }
}

#[test]
fn extreme_options_do_not_panic() {
    let rig = rig();
    let options = ScanOptions {
        cameras: vec![Camera::Position([30.0, 0.0, 60.0])],
        grazing: 90.0,
        holes: 50,
        hole_radius: [0.0, 30.0],
        spikes: 1.0,
        spike_height: [0.0, 1e6],
        outliers: 0.5,
        loose_parts: 40,
        detail: 5.0,
        rotation: 180.0,
        translation: 0.0,
        triangles: 500,
        ..ScanOptions::default()
    };
    for seed in 0..4 {
        let _ = simulate_scan(&rig, &options, seed);
    }
    let wild = vec![("jawOpen".to_owned(), 3.0), ("eyeBlink".into(), -2.0), ("mouthSmile".into(), 4.0)];
    let wild = ScanOptions { expressions: Some(wild), identity: Some(vec![20.0; 6]), ..small() };
    assert!(simulate_scan(&rig, &wild, u64::MAX).is_ok());
}
