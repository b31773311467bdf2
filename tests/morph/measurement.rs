//! Laws of measurements: what is turned measures the same, what is its own mirror image is found to be, what moves sweeps its volume.

use std::path::Path;

use crate::threads::on_threads;
use data_gen::{Eyeball, FaceOptions, FaceRig};
use nalgebra::Rotation3;
use nonrigid::io::{LengthUnit, read_polygon_mesh};
use nonrigid::landmark::TemplatePoint;
use nonrigid::measurement::{
    DEFINITIONS, Formula, LANDMARKS, Landmarks, MeasurementError, Measurements, Missing, NamedRegion, Plan, Subject,
    Symmetry, SymmetryOptions, WHOLE, report,
};
use nonrigid::mesh::{MirrorPlane, PolygonMesh, Pose, TriangleMesh, Vec3};
use nonrigid::rig::Regions;

fn rig(vertices: usize) -> FaceRig {
    FaceRig::generate(&FaceOptions { vertices, identity_modes: 20 })
}

fn named(landmarks: &[data_gen::Landmark]) -> Landmarks {
    let points: Vec<(String, TemplatePoint)> =
        landmarks.iter().map(|l| (l.name.clone(), TemplatePoint::Vertex(l.vertex))).collect();
    let mut named = Landmarks::default();
    named.add(&points).unwrap();
    named
}

fn regions(rig: &FaceRig) -> Vec<NamedRegion<'_>> {
    rig.regions.iter().map(|(name, vertices)| NamedRegion { name, vertices, polygons: None }).collect()
}

fn turn() -> Pose {
    Pose::rigid(Vec3::new(0.4, -1.9, 0.7), Vec3::new(30.0, -200.0, 55.0))
}

fn posed(pose: &Pose, positions: &[Vec3]) -> Vec<Vec3> {
    positions.iter().map(|p| pose.apply(*p)).collect()
}

/// A smooth bump along the normal of the face's front, on the subject's left cheek.
fn with_bump(positions: &[Vec3], height: f64) -> Vec<Vec3> {
    let centre = Vec3::new(45.0, -35.0, -20.0);
    let out = Vec3::new(0.5, 0.0, 0.87).normalize();
    let bump = |p: &Vec3| height * (-(p - centre).norm_squared() / (2.0 * 9.0 * 9.0)).exp();
    positions.iter().map(|p| p + out * bump(p)).collect()
}

#[test]
fn a_turned_face_measures_the_same() {
    let rig = rig(3000);
    let landmarks = named(&rig.anthropometric);
    let (before, after) = (rig.pose(&[], &[1.0, -1.5, 0.7]), rig.pose(&[], &[-0.5, 1.0, 0.0, 1.2]));
    let regions = regions(&rig);
    let measure = |pose: &Pose| -> Measurements {
        let mesh = rig.mesh.with_positions(posed(pose, &before));
        let after = posed(pose, &after);
        Subject { mesh: &mesh, after: Some(&after), landmarks: &landmarks, regions: &regions }.measure().unwrap()
    };
    let (here, there) = (measure(&Pose::identity()), measure(&turn()));
    assert_eq!(here.values.len(), DEFINITIONS.len());
    for (a, b) in here.values.iter().zip(&there.values) {
        assert_eq!(a.missing, None, "{}", a.definition.name);
        for (a, b) in [(a.before, b.before), (a.after, b.after)] {
            approx::assert_abs_diff_eq!(a.unwrap(), b.unwrap(), epsilon = 1e-9);
        }
    }
    for (a, b) in here.regions.iter().zip(&there.regions) {
        let all = |r: &nonrigid::measurement::RegionMeasurement| {
            let (before, after, change) = (r.before, r.after.unwrap(), r.change.unwrap());
            [
                before.area,
                after.area,
                before.asymmetry.rms,
                after.asymmetry.p95,
                change.volume,
                change.displacement_mean,
            ]
        };
        for (x, y) in all(a).into_iter().zip(all(b)) {
            assert!((x - y).abs() < 1e-6 * x.abs().max(1.0), "{}: {x} {y}", a.name);
        }
    }
    let (plane, turned) = (here.before.symmetry.plane, there.before.symmetry.plane);
    approx::assert_abs_diff_eq!(turned.normal, turn().rotation * plane.normal, epsilon = 1e-9);
    approx::assert_abs_diff_eq!(turned.height(turn().apply(plane.point)), 0.0, epsilon = 1e-7);
}

#[test]
fn the_numbers_are_those_of_their_formulas() {
    let rig = rig(5000);
    let landmarks = named(&rig.anthropometric);
    let measured = Subject { landmarks: &landmarks, ..Subject::new(&rig.mesh) }.measure().unwrap();
    let value = |name: &str| measured.value(name).unwrap();
    let at = |name: &str| rig.neutral[rig.anthropometric.iter().find(|l| l.name == name).unwrap().vertex as usize];
    // The midline lies in x = 0: the profile is (z, y).
    let direction = |from: &str, to: &str| {
        let d = at(to) - at(from);
        d.y.atan2(d.z).to_degrees()
    };
    let between = |a: &str, b: &str, c: &str| {
        let angle = (direction(b, a) - direction(b, c)).abs();
        angle.min(360.0 - angle)
    };
    approx::assert_abs_diff_eq!(value("nasofrontal"), between("glabella", "nasion", "pronasale"), epsilon = 1e-9);
    approx::assert_abs_diff_eq!(
        value("nasolabial"),
        between("pronasale", "subnasale", "labiale_superius"),
        epsilon = 1e-9
    );
    approx::assert_abs_diff_eq!(
        value("mentolabial"),
        between("labiale_inferius", "sublabiale", "pogonion"),
        epsilon = 1e-9
    );
    approx::assert_abs_diff_eq!(value("mouth_width"), 2.0 * at("cheilion_left").x, epsilon = 1e-9);
    let height = (at("nasion") - at("menton")).norm();
    approx::assert_abs_diff_eq!(value("facial_index"), 50.0 * height / at("zygion_left").x, epsilon = 1e-9);
    let up = (at("nasion") - at("menton")) / height;
    let eye = at("exocanthion_left") - at("endocanthion_left");
    approx::assert_abs_diff_eq!(value("canthal_tilt_left"), eye.dot(&up).atan2(eye.x).to_degrees(), epsilon = 1e-9);
    // A symmetric face.
    for pair in ["canthal_tilt", "eye_width", "outer_fifth", "eye_fifth_share"] {
        let stem = pair.strip_suffix("_share").unwrap_or(pair);
        let end = &pair[stem.len()..];
        approx::assert_abs_diff_eq!(
            value(&format!("{stem}_left{end}")),
            value(&format!("{stem}_right{end}")),
            epsilon = 1e-9
        );
    }
    approx::assert_abs_diff_eq!(value("mouth_cant"), 0.0, epsilon = 1e-9);
    for shares in [
        ["upper_third_share", "middle_third_share", "lower_third_share"].as_slice(),
        &[
            "outer_fifth_right_share",
            "eye_fifth_right_share",
            "middle_fifth_share",
            "eye_fifth_left_share",
            "outer_fifth_left_share",
        ],
    ] {
        let sum: f64 = shares.iter().map(|name| value(name)).sum();
        approx::assert_abs_diff_eq!(sum, 100.0, epsilon = 1e-9);
    }
    // The face is a human one.
    for (name, low, high) in [
        ("face_height", 95.0, 135.0),
        ("face_width", 115.0, 160.0),
        ("nasofrontal", 110.0, 165.0),
        ("nasolabial", 80.0, 130.0),
        ("mentolabial", 90.0, 160.0),
        ("canthal_tilt_left", -2.0, 12.0),
        ("nose_width", 25.0, 45.0),
    ] {
        assert!((low..high).contains(&value(name)), "{name}: {}", value(name));
    }
}

#[test]
fn lips_and_chin_are_measured_off_the_profile_and_plans_stand_beside_each_other() {
    let rig = rig(3000);
    let landmarks = named(&rig.anthropometric);
    let vertex = |name: &str| rig.anthropometric.iter().find(|l| l.name == name).unwrap().vertex as usize;
    let moved = |name: &str, by: f64| {
        // Forwards in the frame of the face before, which is that of the face after too.
        let up = (rig.neutral[vertex("nasion")] - rig.neutral[vertex("menton")]).normalize();
        let mut positions = rig.neutral.clone();
        positions[vertex(name)] += Vec3::x().cross(&up) * by;
        positions
    };
    let (lip, chin) = (moved("labiale_inferius", 2.0), moved("pogonion", 3.0));
    let mut low_chin = chin.clone();
    low_chin[vertex("menton")] = chin[vertex("menton")] + Vec3::new(0.0, 0.0, 3.0);
    let subject = Subject { landmarks: &landmarks, ..Subject::new(&rig.mesh) };
    let plans = [("lip", &lip), ("chin", &chin), ("both ends of the chin", &low_chin)];
    let plans = plans.map(|(name, positions)| Plan { name, positions });
    let all = subject.compare(&plans).unwrap();
    let difference = |plan: usize, name: &str| -> f64 {
        let measured = all.plans().nth(plan).unwrap().1;
        measured.measurement(name).unwrap().difference().unwrap()
    };
    approx::assert_abs_diff_eq!(difference(0, "lower_lip_projection"), 2.0, epsilon = 1e-9);
    approx::assert_abs_diff_eq!(difference(0, "upper_lip_to_e_line"), 0.0, epsilon = 1e-9);
    assert!((1.0..2.0).contains(&difference(0, "lower_lip_to_e_line")));
    // The chin's menton does not turn the vertical by which the chin is measured.
    approx::assert_abs_diff_eq!(difference(1, "chin_projection"), 3.0, epsilon = 1e-9);
    approx::assert_abs_diff_eq!(difference(2, "chin_projection"), 3.0, epsilon = 1e-9);
    assert!(difference(1, "lower_lip_to_e_line") < -1.0);
    let at = |name: &str| rig.neutral[vertex(name)];
    let (tip, end, lip) = (at("pronasale").yz(), at("pogonion").yz(), at("labiale_superius").yz());
    let line = (tip - end).normalize();
    let off = (lip - tip).y * line.x - (lip - tip).x * line.y;
    approx::assert_abs_diff_eq!(all.before().value("upper_lip_to_e_line").unwrap(), off, epsilon = 1e-9);
    // One table, one CSV file, one list.
    let (text, csv) = (all.to_string(), all.to_csv());
    let header = text.lines().find(|l| l.starts_with("profile ")).unwrap();
    let words: Vec<&str> = header.split_whitespace().collect();
    assert_eq!(words[..6], ["profile", "unit", "before", "lip", "difference", "chin"], "{header}");
    assert!(text.contains("change: both ends of the chin"), "{text}");
    assert!(csv.starts_with("group,name,unit,before,lip,lip difference,chin,chin difference,"), "{csv:.200}");
    let columns = csv.lines().next().unwrap().split(',').count();
    assert!(csv.lines().filter(|l| !l.contains('"')).all(|l| l.split(',').count() == columns));
    let json = serde_json::to_value(&all).unwrap();
    assert_eq!((&json[2]["name"], json.as_array().unwrap().len()), (&"both ends of the chin".into(), 3));
}

#[test]
fn landmarks_of_the_midline_alone_find_the_front() {
    let rig = rig(2000);
    let sided = |name: &str| name.ends_with("_left") || name.ends_with("_right");
    let only = |keep: &dyn Fn(&str) -> bool| {
        named(&rig.anthropometric.iter().filter(|l| keep(&l.name)).cloned().collect::<Vec<_>>())
    };
    let (all, midline) = (named(&rig.anthropometric), only(&|name| !sided(name)));
    let one_side = only(&|name| !name.ends_with("_right"));
    for k in 0..8 {
        let pose = Pose::rigid(Vec3::new(0.7 * f64::from(k), -1.9, 0.3 * f64::from(k)), Vec3::new(30.0, -200.0, 55.0));
        let mesh = rig.mesh.with_positions(posed(&pose, &rig.neutral));
        let measure = |landmarks: &Landmarks| Subject { landmarks, ..Subject::new(&mesh) }.measure().unwrap();
        let expected = measure(&all);
        for landmarks in [&midline, &one_side] {
            let found = measure(landmarks);
            for name in ["chin_projection", "lower_lip_projection", "upper_lip_to_e_line", "lower_lip_to_e_line"] {
                let [found, expected] = [&found, &expected].map(|m| m.value(name).unwrap());
                approx::assert_abs_diff_eq!(found, expected, epsilon = 1e-6);
            }
            let [found, expected] = [&found, &expected].map(|m| m.before.frame.unwrap().plane.normal);
            approx::assert_abs_diff_eq!(found, expected, epsilon = 1e-9);
        }
    }
    // A relief of a face that is nearly flat has no front.
    let flat = rig.mesh.with_positions(rig.neutral.iter().map(|p| Vec3::new(p.x, p.y, 0.02 * p.z)).collect());
    let measured = Subject { landmarks: &midline, ..Subject::new(&flat) }.measure().unwrap();
    let chin = measured.measurement("chin_projection").unwrap();
    assert_eq!((chin.before, &chin.missing), (None, &Some(Missing::Front)));
}

#[test]
fn how_a_head_is_held_changes_nothing_and_where_nothing_moves_nothing_does() {
    let rig = rig(3000);
    let landmarks = named(&rig.anthropometric);
    let at = |name: &str| rig.neutral[rig.anthropometric.iter().find(|l| l.name == name).unwrap().vertex as usize];
    // the chin comes forward, menton with it
    let (chin, reach) = (at("pogonion"), 18.0_f64);
    let bump = |p: &Vec3| 6.0 * (1.0 - ((p - chin).norm() / reach).powi(2)).max(0.0);
    let plan: Vec<Vec3> = rig.neutral.iter().map(|p| p + Vec3::new(0.0, 0.0, bump(p))).collect();
    let nod = Pose::rigid(Vec3::new(15.0_f64.to_radians(), 0.0, 0.0), Vec3::new(0.0, 12.0, -40.0));
    let differences = |after: &[Vec3]| -> Vec<f64> {
        let subject = Subject { after: Some(after), landmarks: &landmarks, ..Subject::new(&rig.mesh) };
        subject.measure().unwrap().values.iter().map(|m| m.difference().unwrap()).collect()
    };
    for difference in differences(&posed(&nod, &rig.neutral)) {
        approx::assert_abs_diff_eq!(difference, 0.0, epsilon = 1e-9);
    }
    let (held, nodded) = (differences(&plan), differences(&posed(&nod, &plan)));
    let mut still = 0;
    for ((definition, held), nodded) in DEFINITIONS.iter().zip(held).zip(nodded) {
        approx::assert_abs_diff_eq!(held, nodded, epsilon = 1e-6);
        let landmarks = definition.formula.landmarks();
        if !landmarks.is_empty() && landmarks.iter().all(|name| bump(&at(name)) == 0.0) {
            approx::assert_abs_diff_eq!(held, 0.0, epsilon = 1e-6);
            still += 1;
        }
        if definition.name == "chin_projection" {
            assert!((5.0..6.5).contains(&held), "{held}");
        }
    }
    assert!(still > 25 && bump(&at("menton")) > 0.0, "{still}");
}

#[test]
fn areas_of_a_partition_are_the_whole_by_vertices_and_by_polygons() {
    let rig = rig(2000);
    let groups = Regions::of_groups(&rig.mesh);
    let of_groups: Vec<NamedRegion<'_>> = groups
        .names()
        .map(|name| NamedRegion { name, vertices: groups.vertices(name).unwrap(), polygons: groups.polygons(name) })
        .collect();
    let after = with_bump(&rig.neutral, 4.0);
    for regions in [&of_groups[..], &regions(&rig)] {
        let subject = Subject { after: Some(&after), regions, ..Subject::new(&rig.mesh) };
        let measured = subject.measure().unwrap();
        let (whole, parts) = measured.regions.split_first().unwrap();
        assert!(parts.len() > 5);
        let sum = |of: &dyn Fn(&nonrigid::measurement::RegionMeasurement) -> f64| parts.iter().map(of).sum::<f64>();
        approx::assert_relative_eq!(sum(&|r| r.before.area), whole.before.area, max_relative = 1e-12);
        let swept = sum(&|r| r.change.unwrap().volume);
        approx::assert_relative_eq!(swept, whole.change.unwrap().volume, max_relative = 1e-9);
    }
    // A group is the area of its polygons.
    let nose = groups.polygons("nose").unwrap();
    let polygon = |f: &u32| -> f64 {
        let corners = rig.mesh.polygon(*f as usize);
        let at = |k: usize| rig.neutral[corners[k] as usize];
        (1..corners.len() - 1).map(|k| 0.5 * (at(k) - at(0)).cross(&(at(k + 1) - at(0))).norm()).sum()
    };
    let measured = Subject { regions: &of_groups, ..Subject::new(&rig.mesh) }.measure().unwrap();
    let found = measured.regions.iter().find(|r| r.name == "nose").unwrap().before.area;
    approx::assert_relative_eq!(found, nose.iter().map(polygon).sum::<f64>(), max_relative = 1e-12);
}

#[test]
fn a_position_off_the_mesh_is_measured_on_it_and_said() {
    let rig = rig(1000);
    let folder = tempfile::tempdir().unwrap();
    let read = |off: f64| {
        let path = folder.path().join("points.json");
        let [nasion, menton] = ["nasion", "menton"].map(|name| {
            rig.neutral[rig.anthropometric.iter().find(|l| l.name == name).unwrap().vertex as usize]
                + Vec3::new(0.0, if name == "menton" { -off } else { 0.0 }, 0.0)
        });
        let text = format!("{{\"nasion\": {:?}, \"menton\": {:?}}}", nasion.as_slice(), menton.as_slice());
        std::fs::write(&path, text).unwrap();
        Landmarks::read(&[path], &rig.mesh, LengthUnit::Millimetre).unwrap()
    };
    assert_eq!(read(0.0).doubts(&rig.neutral), [""; 0]);
    let doubt = read(5.0).doubts(&rig.neutral).remove(0);
    assert!(doubt.starts_with("1 landmark lies off the mesh, menton by "), "{doubt}");
    // A point inside a polygon is that point, not the vertex next to it.
    let middle = {
        let c = rig.mesh.polygon(0);
        let [a, b, c] = [c[0], c[1], c[2]].map(|v| rig.neutral[v as usize]);
        (a + b + c) / 3.0
    };
    let path = folder.path().join("inside.json");
    std::fs::write(&path, format!("{{\"nasion\": {:?}}}", middle.as_slice())).unwrap();
    let mut landmarks = Landmarks::read(&[path], &rig.mesh, LengthUnit::Millimetre).unwrap();
    landmarks.add(&[("menton".to_owned(), TemplatePoint::Vertex(0))]).unwrap();
    let measured = Subject { landmarks: &landmarks, ..Subject::new(&rig.mesh) }.measure().unwrap();
    approx::assert_abs_diff_eq!(
        measured.value("face_height").unwrap(),
        (middle - rig.neutral[0]).norm(),
        epsilon = 1e-9
    );
}

#[test]
fn the_table_is_sound() {
    for (k, d) in DEFINITIONS.iter().enumerate() {
        assert!(!DEFINITIONS[..k].iter().any(|e| e.name == d.name), "{} twice", d.name);
        if let Formula::Percent(a, b) = &d.formula {
            assert!([a, b].iter().all(|name| DEFINITIONS[..k].iter().any(|d| d.name == **name)), "{}", d.name);
        }
        assert!(d.formula.landmarks().iter().all(|name| LANDMARKS.iter().any(|l| l.name == *name)), "{}", d.name);
        assert!(d.typical.is_none_or(|t| t.low < t.high && t.source.len() > 20));
    }
}

#[test]
fn what_is_missing_is_named_and_nothing_is_made_up() {
    let rig = rig(1000);
    let points: Vec<(String, TemplatePoint)> =
        rig.landmarks.iter().enumerate().map(|(n, l)| (n.to_string(), TemplatePoint::Vertex(l.vertex))).collect();
    let mut landmarks = Landmarks::default();
    landmarks.add(&points).unwrap();
    let measured = Subject { landmarks: &landmarks, ..Subject::new(&rig.mesh) }.measure().unwrap();
    let missing = |name: &str| measured.measurement(name).unwrap().missing.clone();
    assert_eq!(missing("mouth_width"), None);
    assert_eq!(missing("nasofrontal"), Some(Missing::Landmarks(vec!["glabella"])));
    assert_eq!(missing("upper_third_share"), Some(Missing::Landmarks(vec!["trichion", "glabella"])));
    assert_eq!(measured.value("upper_third_share"), None);

    let of = |names: &[&str]| {
        let mut some = Landmarks::default();
        let all = |name: &str| rig.anthropometric.iter().find(|l| l.name == name).unwrap().vertex;
        some.add(&names.iter().map(|n| ((*n).to_owned(), TemplatePoint::Vertex(all(n)))).collect::<Vec<_>>()).unwrap();
        Subject { landmarks: &some, ..Subject::new(&rig.mesh) }.measure()
    };
    let lone = of(&["nasion", "pronasale"]).unwrap();
    assert!(lone.value("nose_length").is_some());
    // One point each side of no plane: the profile is not known, a distance is.
    let profile = of(&["endocanthion_left", "exocanthion_left", "nasion", "menton"]).unwrap();
    assert_eq!(profile.measurement("canthal_tilt_left").unwrap().missing, Some(Missing::Plane));
    let message = of(&["trichion"]).unwrap_err().to_string();
    assert!(message.contains("nothing can be measured") && message.contains("trichion"), "{message}");
    // Without any landmarks there is still a surface.
    let surface = Subject::new(&rig.mesh).measure().unwrap();
    assert!(surface.values.is_empty() && surface.regions[0].before.area > 1e4);
}

#[test]
fn the_plane_of_a_symmetric_face_is_found_to_rounding_from_a_bad_start() {
    let rig = rig(4000);
    for pose in [Pose::identity(), turn()] {
        let mesh = TriangleMesh { positions: posed(&pose, &rig.neutral), ..rig.mesh.triangulate() };
        // 25 degrees and 15 mm off; and none at all.
        let tilt = Rotation3::new(Vec3::new(0.0, 0.3, 0.316)).into_inner();
        let bad =
            MirrorPlane { point: pose.apply(Vec3::new(15.0, 0.0, 0.0)), normal: pose.rotation * (tilt * Vec3::x()) };
        for start in [Some(bad), None] {
            let found = Symmetry::find(&mesh, start, &SymmetryOptions::default(), "the face").unwrap();
            let truth = pose.rotation * Vec3::x();
            assert!(found.converged);
            let off = found.plane.towards(truth).normal - truth;
            assert!(off.norm() < 1e-12, "{start:?}: normal off by {}", off.norm());
            let origin = pose.apply(Vec3::zeros());
            assert!(found.plane.height(origin).abs() < 1e-10, "{start:?}: {}", found.plane.height(origin));
            let all = found.of(0..mesh.positions.len());
            assert!(all.max < 1e-10 && all.vertices > 3 * mesh.positions.len() / 4, "{all:?}");
        }
    }
}

#[test]
fn seams_of_texture_are_no_boundary() {
    let rig = rig(1500);
    let mut whole = rig.mesh.triangulate();
    whole.positions.iter_mut().filter(|p| p.x > 0.0).for_each(|p| p.z += 1.0 * (0.05 * p.y).sin());
    let of: Vec<u32> = whole.triangles.as_flattened().to_vec();
    let cut = TriangleMesh {
        positions: of.iter().map(|&v| whole.positions[v as usize]).collect(),
        triangles: (0..of.len() as u32).collect::<Vec<_>>().as_chunks().0.to_vec(),
    };
    let find = |mesh| Symmetry::find(mesh, None, &SymmetryOptions::default(), "the face").unwrap();
    let (one, other) = (find(&whole), find(&cut));
    assert!(one.of(0..whole.positions.len()).max > 0.3);
    let pairs = || of.iter().zip(&other.offsets).map(|(&w, b)| (one.offsets[w as usize], *b));
    // matches at the rim, and in the end, change by rounding
    let unlike = pairs().filter(|(a, b)| a.is_nan() != b.is_nan()).count();
    let apart = pairs().map(|(a, b)| (a - b).abs()).filter(|d| !d.is_nan()).fold(0.0, f64::max);
    assert!(50 * unlike < of.len() && apart < 0.05, "{unlike} of {}, {apart} mm", of.len());
}

#[test]
fn a_known_asymmetry_is_measured_and_does_not_draw_the_plane() {
    let rig = rig(8000);
    let regions = regions(&rig);
    for height in [0.5, 3.0] {
        let after = with_bump(&rig.neutral, height);
        let subject = Subject { after: Some(&after), regions: &regions, ..Subject::new(&rig.mesh) };
        let measured = subject.measure().unwrap();
        let symmetry = &measured.after.as_ref().unwrap().symmetry;
        let normal = symmetry.plane.towards(Vec3::x()).normal;
        let (tilt, shift) = ((normal - Vec3::x()).norm().to_degrees(), symmetry.plane.height(Vec3::zeros()).abs());
        assert!(tilt < 0.02 && shift < 0.02, "{height}: {tilt} degrees, {shift} mm");
        // Along the bump's own direction it is `height`; the distance to the surface is a little less.
        let region = |name: &str| measured.regions.iter().find(|r| r.name == name).unwrap();
        let cheeks = region("cheeks").after.unwrap().asymmetry;
        assert!((0.9 * height..1.01 * height).contains(&cheeks.max), "{height}: {cheeks:?}");
        assert!(region("chin").after.unwrap().asymmetry.max < 0.05 * height);
        assert!(region(WHOLE).before.asymmetry.max < 1e-9);
        // It stands out on the left and the right falls behind it.
        let extreme = |pick: fn(f64, f64) -> f64, right: bool| {
            let side = rig.neutral.iter().zip(&symmetry.offsets).filter(|(p, o)| (p.x < 0.0) == right && !o.is_nan());
            side.map(|s| *s.1).fold(0.0, pick)
        };
        assert!(extreme(f64::max, false) > 0.9 * height && extreme(f64::min, true) < -0.9 * height);
        assert!(extreme(f64::min, false) > -0.1 * height && extreme(f64::max, true) < 0.1 * height);
        // The bump's volume: its mean height times area, to first order.
        let change = region(WHOLE).change.unwrap();
        let area = measured.regions[0].before.area;
        assert!((change.displacement_max - height).abs() < 0.1 * height && change.volume > 0.0);
        assert!(change.volume < change.displacement_mean * area);
    }
}

/// Volume inside a closed surface: that of the tetrahedra to the origin.
fn enclosed(positions: &[Vec3], triangles: &[[u32; 3]]) -> f64 {
    let corner = |v: u32| positions[v as usize];
    triangles.iter().map(|t| corner(t[0]).dot(&corner(t[1]).cross(&corner(t[2]))) / 6.0).sum()
}

#[test]
fn the_swept_volume_of_a_closed_surface_is_the_change_of_what_it_encloses() {
    let ball = Eyeball { centre: Vec3::new(5.0, -3.0, 40.0), radius: 12.0 }.surface();
    let mesh = PolygonMesh::from(ball.clone());
    let wild = |p: &Vec3| {
        let q = Vec3::new(1.3 * p.x + 0.1 * p.y * p.y, 0.8 * p.y - 4.0 * (0.3 * p.x).sin(), p.z + 0.02 * p.x * p.z);
        turn().apply(q)
    };
    let halves = [false, true].map(|upper| {
        let side = |v: &usize| (ball.positions[*v].y > -3.0) == upper;
        (0..ball.positions.len()).filter(side).map(|v| v as u32).collect::<Vec<u32>>()
    });
    let regions = ["lower", "upper"].map(|name| NamedRegion {
        name,
        vertices: &halves[usize::from(name == "upper")],
        polygons: None,
    });
    for (what, after) in [
        ("wild", ball.positions.iter().map(wild).collect::<Vec<_>>()),
        ("shift", ball.positions.iter().map(|p| p + Vec3::new(7.0, -1.0, 2.0)).collect()),
        ("double", ball.positions.iter().map(|p| p * 2.0).collect()),
    ] {
        let subject = Subject { after: Some(&after), regions: &regions, ..Subject::new(&mesh) };
        let measured = subject.measure().unwrap();
        let [whole, lower, upper] = [0, 1, 2].map(|k| measured.regions[k].change.unwrap());
        let (before, expected) = (enclosed(&ball.positions, &ball.triangles), enclosed(&after, &ball.triangles));
        assert!(
            (whole.volume - (expected - before)).abs() < 1e-9 * expected.abs(),
            "{what}: {} {}",
            whole.volume,
            expected - before
        );
        assert!((lower.volume + upper.volume - whole.volume).abs() < 1e-9 * expected.abs(), "{what}");
        let area = |k: usize| measured.regions[k].after.unwrap().area;
        assert!((area(1) + area(2) - area(0)).abs() < 1e-9 * area(0), "{what}");
        if what == "double" {
            approx::assert_relative_eq!(area(0), 4.0 * measured.regions[0].before.area, max_relative = 1e-12);
        }
    }
}

#[test]
fn a_report_is_the_same_bytes_at_any_number_of_threads() {
    let rig = rig(1500);
    let landmarks = named(&rig.anthropometric);
    let regions = regions(&rig);
    let after = with_bump(&rig.neutral, 4.0);
    let mask: Vec<f64> = rig.neutral.iter().zip(&after).map(|(b, a)| ((a - b).norm() / 4.0).min(1.0)).collect();
    let subject = Subject { mesh: &rig.mesh, after: Some(&after), landmarks: &landmarks, regions: &regions };
    let about = [("recipe".to_owned(), "a <bump>".to_owned())];
    let full = report::Report {
        about: &about,
        mask: Some(&mask),
        panel: 120,
        ..report::Report::new("Before & after", subject)
    };
    let folder = tempfile::tempdir().unwrap();
    let write = |threads: usize| {
        let path = folder.path().join(threads.to_string());
        on_threads(threads, || report::write(&path, &full)).unwrap();
        let names = ["measurements.json", "measurements.csv", "pictures.png", "symmetry.png", "index.html"];
        names.map(|name| std::fs::read(path.join(name)).unwrap())
    };
    let (one, two) = (write(1), write(2));
    assert!(one == two);
    let page = String::from_utf8(one[4].clone()).unwrap();
    assert!(page.contains("Before &amp; after") && page.contains("a &lt;bump&gt;") && page.contains("nasofrontal"));
    assert!(page.matches("src=\"data:image/png;base64,").count() == 2 && !page.contains("src=\"http"));
    let picture = image::load_from_memory(&one[2]).unwrap().to_rgb8();
    // Five columns, three rows; the mask is red and nothing else is.
    assert!(picture.width() > 5 * 120 && picture.height() > 3 * 120);
    let red = picture.pixels().filter(|p| p.0[0] > 220 && p.0[1] < 90 && p.0[2] < 90).count();
    assert!(red > 20, "{red} red pixels");
    // What is protected is drawn in every column of both sheets; a second plan takes two more of them.
    let protected: Vec<f64> = rig.neutral.iter().map(|p| f64::from(u8::from(p.y > 30.0))).collect();
    let plans = [("A", &after), ("B", &rig.neutral)].map(|(name, positions)| Plan { name, positions });
    let both = report::Report { plans: &plans, protected: Some(&protected), ..full.clone() };
    report::write(&folder.path().join("plans"), &both).unwrap();
    let page = std::fs::read_to_string(folder.path().join("plans/index.html")).unwrap();
    assert!(page.contains("<th>B</th>") && page.contains("change: B"));
    // below both sheets, and in words for who does not see them
    assert_eq!(page.matches("Blue: protected").count(), 4);
    let bare = report::Report { protected: None, ..both.clone() };
    report::write(&folder.path().join("bare"), &bare).unwrap();
    let sheets =
        |name: &str| ["plans", "bare"].map(|of| image::open(folder.path().join(of).join(name)).unwrap().to_rgb8());
    assert!(sheets("pictures.png")[0].width() > picture.width() + 2 * 110);
    // before, landmarks, A, B, mask, two displacements; before, A, B
    for (name, columns) in [("pictures.png", 7), ("symmetry.png", 3)] {
        let [wide, bare] = sheets(name);
        assert_eq!(bare.dimensions(), wide.dimensions());
        let drawn = |x: u32| (0..wide.height()).any(|y| wide.get_pixel(x, y) != bare.get_pixel(x, y));
        let starts = (1..wide.width()).filter(|x| drawn(*x) && !drawn(x - 1)).count();
        assert_eq!(starts, columns, "{name}");
    }
    let without = report::Report { mask: None, ..full.clone() };
    report::write(&folder.path().join("no_mask"), &without).unwrap();
    let plain = image::open(folder.path().join("no_mask/pictures.png")).unwrap().to_rgb8();
    assert!(plain.width() < picture.width());

    let refused = |report: &report::Report<'_>| report::write(&folder.path().join("none"), report).unwrap_err();
    assert!(matches!(
        refused(&report::Report { mask: Some(&mask[1..]), ..full.clone() }),
        MeasurementError::VertexCount { .. }
    ));
    let odd = vec![1.5; mask.len()];
    for (report, what) in [
        (report::Report { mask: Some(&odd), ..full.clone() }, "the mask"),
        (report::Report { protected: Some(&odd), ..full.clone() }, "the weights of what is protected"),
    ] {
        let said = refused(&report).to_string();
        assert_eq!(said, format!("{what}: 1.5 at vertex 0, expected a number from 0 to 1"));
    }
    assert!(!folder.path().join("none").exists());
}

#[test]
fn bad_meshes_are_refused() {
    let rig = rig(1000);
    let message = |subject: Subject<'_>| subject.measure().unwrap_err().to_string();
    let mut nan = rig.neutral.clone();
    nan[7].y = f64::NAN;
    let landmarks = named(&rig.anthropometric);
    let subject = Subject { landmarks: &landmarks, ..Subject::new(&rig.mesh) };
    assert!(message(Subject { after: Some(&nan), ..subject }).contains("the mesh after: vertex 7"));
    assert!(message(Subject { after: Some(&nan[1..]), ..subject }).contains("they must correspond"));
    assert!(message(Subject { mesh: &rig.mesh.with_positions(nan), ..subject }).contains("the mesh: vertex 7"));
    let nose = NamedRegion { name: "nose", vertices: &[3], polygons: None };
    let past = [NamedRegion { vertices: &[3, 99_999], ..nose }];
    assert!(message(Subject { regions: &past, ..subject }).contains("region \"nose\" has vertex 99999"));
    let past = [NamedRegion { polygons: Some(&[3, 99_999]), ..nose }];
    assert!(message(Subject { regions: &past, ..subject }).contains("region \"nose\" has polygon 99999"));
    let points = PolygonMesh { positions: rig.neutral.clone(), ..PolygonMesh::default() };
    assert!(message(Subject { mesh: &points, ..subject }).contains("no faces"));
    let flat = rig.mesh.with_positions(vec![Vec3::zeros(); rig.neutral.len()]);
    assert!(message(Subject { mesh: &flat, ..subject }).contains("no faces, or none with an area"));
    let small = PolygonMesh {
        positions: vec![Vec3::zeros(); 3],
        starts: vec![0, 3],
        corners: vec![0, 1, 2],
        ..PolygonMesh::default()
    };
    assert!(message(Subject { mesh: &small, ..subject }).contains("expected one below 3"));
    assert!(message(Subject::new(&PolygonMesh::default())).contains("no faces"));
}

#[test]
fn the_landmarks_of_ict_facekit_lie_in_mirrored_pairs() {
    let Some(path) = crate::real_data::real_data("ict-facekit/head/template.obj") else { return };
    let mesh = read_polygon_mesh(&path).unwrap();
    let files = ["ict-facekit.json", "ict-facekit-head.json"]
        .map(|f| Path::new(env!("CARGO_MANIFEST_DIR")).join("landmarks").join(f));
    let landmarks = Landmarks::read(&files, &mesh, LengthUnit::Millimetre).unwrap();
    let measured = Subject { landmarks: &landmarks, ..Subject::new(&mesh) }.measure().unwrap();
    assert!(measured.values.iter().all(|v| v.missing.is_none()));
    let at = |name: &str| measured.before.landmarks.iter().find(|l| l.0 == name).unwrap().1;
    for l in LANDMARKS {
        let twin = l.name.strip_suffix("_right").map_or(l.name.to_owned(), |stem| format!("{stem}_left"));
        let p = at(l.name);
        if !l.name.ends_with("_left") {
            approx::assert_abs_diff_eq!(at(&twin), Vec3::new(-p.x, p.y, p.z), epsilon = 0.01);
        }
    }
    assert!(measured.before.symmetry.converged && measured.before.symmetry.plane.normal.x > 1.0 - 1e-9);
    assert!(measured.regions[0].before.asymmetry.rms < 0.01);
}
