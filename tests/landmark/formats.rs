//! Landmark files: what each format's files say, round trips through every one, and what is wrong with malformed ones.

use std::path::Path;

use nonrigid::io::LengthUnit;
use nonrigid::landmark::{
    LandmarkCheck, LandmarkFormat, LandmarkPlace, LandmarkSet, PatientSpace, PlaceKind, PlacedLandmark, TemplatePoint,
    parse_landmark_set, read_landmark_set, read_landmarks, read_template_landmarks, write_landmark_set,
};
use nonrigid::mesh::{PolygonMesh, Vec3};

fn quad() -> PolygonMesh {
    let positions = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec();
    PolygonMesh { positions, starts: vec![0, 4], corners: vec![0, 1, 2, 3], ..PolygonMesh::default() }
}

fn parse(name: &str, text: &str) -> LandmarkSet {
    parse_landmark_set(text.as_bytes(), Path::new(name)).unwrap_or_else(|e| panic!("{e}"))
}

/// Names and positions.
fn points(set: &LandmarkSet) -> Vec<(&str, [f64; 3])> {
    let point = |l: &PlacedLandmark| match l.place {
        LandmarkPlace::Position(p) => p.into(),
        place => panic!("{place:?}"),
    };
    set.landmarks.iter().map(|l| (l.name.as_str(), point(l))).collect()
}

#[test]
fn slicer_files_say_space_and_unit() {
    let json = |space: &str, unit: &str| {
        format!(
            r#"{{"@schema": "x", "markups": [{{"type": "Fiducial"{space}{unit}, "controlPoints": [
            {{"id": "1", "label": "F-1", "position": [-53.5, -73.25, 1]}},
            {{"id": "2", "label": "", "position": [49.5, -88.5, 0.0], "positionStatus": "defined"}},
            {{"id": "3", "label": "gone", "position": [0, 0, 0], "positionStatus": "undefined"}}]}}]}}"#
        )
    };
    let lps = parse("a.mrk.json", &json(r#", "coordinateSystem": "LPS""#, ""));
    assert_eq!(points(&lps), [("F-1", [-53.5, -73.25, 1.0]), ("2", [49.5, -88.5, 0.0])]);
    assert_eq!((lps.unit, lps.space), (Some(LengthUnit::Millimetre), Some(PatientSpace::Lps)));
    assert_eq!(lps.missing, ["gone"]);
    let ras = parse("a.json", &json(r#", "coordinateSystem": "RAS""#, r#", "coordinateUnits": ["um", "UCUM", "x"]"#));
    assert!((Vec3::from(points(&ras)[0].1) - Vec3::new(0.0535, 0.07325, 0.001)).norm() < 1e-15);
    assert_eq!((ras.unit, ras.space), (Some(LengthUnit::Micrometre), Some(PatientSpace::Ras)));

    let fcsv = |space: &str| {
        format!(
            "# Markups fiducial file version = 4.13\n# CoordinateSystem = {space}\n\
             # columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n\
             0,-19.5,13.25,29.5,0,0,0,1,1,1,0,\"a, b\",,\r\n1,1,2,3,0,0,0,1,1,1,0,gone,,,0,0\n2,4,5,6,0,0,0,1,1,1,0,c,,,2,0\n"
        )
    };
    let set = parse("a.fcsv", &fcsv("LPS"));
    assert_eq!(points(&set), [("a, b", [-19.5, 13.25, 29.5]), ("c", [4.0, 5.0, 6.0])]);
    assert_eq!(set.missing, ["gone"]);
    assert_eq!(points(&parse("a.fcsv", &fcsv("0")))[0].1, [19.5, -13.25, 29.5]);
}

#[test]
fn files_of_other_tools() {
    let pp = "<!DOCTYPE PickedPoints>\n<PickedPoints>\n <DocumentData>\n  <DateTime time=\"13:57:53\" date=\"2020-05-01\"/>\n  \
              <templateName name=\"new &gt; Template\"/>\n </DocumentData>\n <!-- <point/> -->\n \
              <point x=\"0.5\" y=\"187.75\" z=\"46.25\" active=\"1\" name=\"p &amp; 1\"/>\n \
              <point active='0' name='off' z='1' y='1' x='1'/>\n <point name=\"2\" z=\"3e1\" y=\"-2\" x=\"1\"/>\n</PickedPoints>\n";
    let set = parse("a.pp", pp);
    assert_eq!(points(&set), [("p & 1", [0.5, 187.75, 46.25]), ("2", [1.0, -2.0, 30.0])]);
    assert_eq!((set.missing, set.unit), (vec!["off".to_owned()], None));

    let scalismo = r#"[{"id": "right.nose", "coordinates": [-18.5, -2.5, 103.75], "description": "d", "uncertainty":
        {"stddevs": [1.0, 1.0, 1.0], "pcvectors": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}, {"id": "b", "coordinates": [1, 2, 3]}]"#;
    let set = parse("a.json", scalismo);
    assert_eq!(points(&set), [("right.nose", [-18.5, -2.5, 103.75]), ("b", [1.0, 2.0, 3.0])]);
    assert_eq!((set.landmarks[0].sigma, set.landmarks[1].sigma), (Some(1.0), None));
    assert_eq!(
        points(&parse("a.csv", "# c\nnose, 1,2.5,3\n\n b,4,5,6\n")),
        [("nose", [1.0, 2.5, 3.0]), ("b", [4.0, 5.0, 6.0])]
    );
    let table = parse("a.csv", "label,r,a,s,defined,selected\nnose,1,2.5,3,1,1\n");
    assert_eq!((points(&table), table.space), (vec![("nose", [-1.0, -2.5, 3.0])], Some(PatientSpace::Ras)));

    let pts = parse("a.pts", "version: 1\nn_points:  2\n{\n1 2 3.5\n4 5 6\n}\n");
    assert_eq!((points(&pts), pts.named), (vec![("0", [1.0, 2.0, 3.5]), ("1", [4.0, 5.0, 6.0])], false));
    let idav = parse("a.pts", "Version 1.0\n2\nS000 1 2 3\nS001 9999 9999 9999\n");
    assert_eq!((points(&idav), idav.missing.clone()), (vec![("S000", [1.0, 2.0, 3.0])], vec!["S001".to_owned()]));
    let lm3 = "# Bosphorus\n2 Landmarks:\nOuter left eyebrow\n1 2 3.5\nNose tip\n-4 5 6\n";
    assert_eq!(points(&parse("a.lm3", lm3)), [("outer_left_eyebrow", [1.0, 2.0, 3.5]), ("nose_tip", [-4.0, 5.0, 6.0])]);
    assert_eq!(
        points(&parse("a.txt", "# v x y z\n978 1 2 3\nnose,4,5,6\n")),
        [("978", [1.0, 2.0, 3.0]), ("nose", [4.0, 5.0, 6.0])]
    );
    // FaceForm's Wrap saves JSON in text files too.
    assert_eq!(parse("a.txt", "[[42, 0.3, 0.5], [1337, 0.0, 1.0]]").format, LandmarkFormat::Wrap);
}

#[test]
fn menpo_labels_are_names_where_they_single_points_out() {
    let one = r#"{"version": 1, "groups": [{"label": "chin", "connectivity": [[0, 1]], "landmarks": [{"point": [1, 2, 3]},
        {"point": [null, null, null]}]}, {"label": "eye", "landmarks": [{"point": [4, 5, 6]}]}]}"#;
    let set = parse("a.ljson", one);
    assert_eq!((points(&set), set.named), (vec![("0", [1.0, 2.0, 3.0]), ("2", [4.0, 5.0, 6.0])], false));
    assert_eq!(set.missing, ["1"]);
    let labels =
        r#""labels": [{"label": "b", "mask": [1]}, {"label": "a", "mask": [0]}, {"label": "all", "mask": [0, 1]}]"#;
    let body = format!(r#"{{{labels}, "landmarks": {{"points": [[1, 2, 3], [4, 5, 6]]}}"#);
    for text in [format!("{body}, \"version\": 2}}"), format!(r#"{{"version": 3, "groups": {{"LJSON": {body}}}}}}}"#)] {
        assert_eq!(points(&parse("a.json", &text)), [("a", [1.0, 2.0, 3.0]), ("b", [4.0, 5.0, 6.0])]);
    }
}

const ALL: [(LandmarkFormat, &str); 12] = [
    (LandmarkFormat::Native, "a.json"),
    (LandmarkFormat::Points, "points.json"),
    (LandmarkFormat::Wrap, "wrap.json"),
    (LandmarkFormat::ScalismoJson, "scalismo.json"),
    (LandmarkFormat::Csv, "a.csv"),
    (LandmarkFormat::SlicerJson, "a.mrk.json"),
    (LandmarkFormat::SlicerFcsv, "a.fcsv"),
    (LandmarkFormat::MeshLab, "a.pp"),
    (LandmarkFormat::Pts, "a.pts"),
    (LandmarkFormat::Lm3, "a.lm3"),
    (LandmarkFormat::Ljson, "a.ljson"),
    (LandmarkFormat::Text, "a.txt"),
];

#[test]
fn every_format_gives_back_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let at = [[0.1, 1.0 / 3.0, 1e-7], [-123.456789012345, 0.9, -0.0], [1e11, 5e-300, 2.0]];
    let landmark = |(i, p): (usize, &[f64; 3])| PlacedLandmark {
        name: ["nose_tip", "b.2", "c"][i].to_owned(),
        place: LandmarkPlace::Position(Vec3::from(*p)),
        sigma: (i == 0).then_some(0.7),
    };
    let named =
        LandmarkSet { landmarks: at.iter().enumerate().map(landmark).collect(), named: true, ..LandmarkSet::default() };
    for (format, file) in ALL {
        for space in [None, Some(PatientSpace::Lps), Some(PatientSpace::Ras)] {
            let path = folder.path().join(file);
            let set = LandmarkSet { space, ..named.clone() };
            if format == LandmarkFormat::Wrap {
                let message = write_landmark_set(&path, &set, format).unwrap_err().to_string();
                assert!(message.contains("give the mesh") && !path.exists(), "{message}");
                continue;
            }
            write_landmark_set(&path, &set, format).unwrap();
            let again = read_landmark_set(&path).unwrap();
            assert_eq!(again.format, format);
            let bits = |s: &LandmarkSet| -> Vec<u64> {
                points(s).iter().flat_map(|p| p.1.map(|c| (c + 0.0).to_bits())).collect()
            };
            assert_eq!(bits(&again), bits(&set), "{format}");
            for (a, b) in again.landmarks.iter().zip(&set.landmarks) {
                assert!(a.name == b.name || !format.holds_names(), "{format}: {}", a.name);
                let close = a.sigma.zip(b.sigma).is_some_and(|(a, b)| (a - b).abs() < 1e-15) || a.sigma == b.sigma;
                assert!(close || !format.holds_sigma(), "{format}: {:?}", a.sigma);
            }
        }
    }
}

#[test]
fn places_on_a_mesh_survive_where_the_format_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = quad();
    let set = parse(
        "a.json",
        r#"{"unit": "cm", "landmarks": [{"name": "v", "vertex": 2, "sigma": 0.05},
        {"name": "f", "face": 1, "barycentric": [0.25, 0.5, 0.25]}, {"name": "p", "position": [0.05, 0.02, 0.03]}]}"#,
    );
    assert_eq!(set.landmarks[0].sigma, Some(0.5));
    let at = set.positions_on(Path::new("a.json"), &mesh).unwrap();
    assert_eq!(at[1], Vec3::new(0.5, 0.75, 0.0));
    assert!((at[2] - Vec3::new(0.5, 0.2, 0.3)).norm() < 1e-15);
    let (faces, moved) = set.placed_as(PlaceKind::Face, &at, &mesh).unwrap();
    assert!((moved - 0.3).abs() < 1e-12);
    for (format, file, set) in [
        (LandmarkFormat::Native, "native.json", &set),
        (LandmarkFormat::Native, "faces.json", &faces),
        (LandmarkFormat::Wrap, "wrap.json", &faces),
    ] {
        let path = folder.path().join(file);
        write_landmark_set(&path, set, format).unwrap();
        let again = read_landmark_set(&path).unwrap();
        let again = again.positions_on(&path, &mesh).unwrap();
        let before = set.positions_on(&path, &mesh).unwrap();
        assert!(again.iter().zip(&before).all(|(a, b)| (a - b).norm() < 1e-12), "{file}");
    }
    let (vertices, _) = set.placed_as(PlaceKind::Vertex, &at, &mesh).unwrap();
    let path = folder.path().join("vertices.json");
    write_landmark_set(&path, &vertices, LandmarkFormat::Points).unwrap();
    let fixed = read_template_landmarks(&path, &mesh).unwrap();
    assert_eq!(fixed[0], ("v".to_owned(), TemplatePoint::Vertex(2)));
    // a vertex of no polygon is no place on the mesh
    let mut stray = mesh.clone();
    stray.positions.push(Vec3::new(0.5, 0.2, 0.3));
    let (vertices, _) = set.placed_as(PlaceKind::Vertex, &at, &stray).unwrap();
    assert_eq!(vertices.landmarks[2].place, LandmarkPlace::Vertex(0));
}

#[test]
fn a_registration_takes_any_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = quad();
    let names = folder.path().join("names.json");
    std::fs::write(&names, r#"{"0": 3, "1": 1}"#).unwrap();
    let set = parse("a.json", "[[5.5, 6, 7], [8, 9, 10]]");
    for (format, file) in ALL.into_iter().filter(|(format, _)| *format != LandmarkFormat::Wrap) {
        let path = folder.path().join(file);
        write_landmark_set(&path, &set, format).unwrap();
        for template in [Some(names.as_path()), None].into_iter().take(1 + usize::from(format.holds_names())) {
            let found = read_landmarks(&path, template, &mesh, None).unwrap_or_else(|e| panic!("{e}"));
            let vertices = if template.is_some() { [3, 1] } else { [0, 1] };
            assert_eq!(found.iter().map(|l| l.template).collect::<Vec<_>>(), vertices.map(TemplatePoint::Vertex));
            assert_eq!(found[1].target, Vec3::new(8.0, 9.0, 10.0));
        }
    }
    // Points picked on the template go to its surface.
    let picked = folder.path().join("picked.pp");
    std::fs::write(&picked, "<PickedPoints><point name=\"0\" x=\"0.5\" y=\"0.25\" z=\"9\"/></PickedPoints>").unwrap();
    let at = read_template_landmarks(&picked, &mesh).unwrap()[0].1.position(&mesh.positions);
    assert!((at - Vec3::new(0.5, 0.25, 0.0)).norm() < 1e-12);
}

#[test]
fn points_of_one_triangle_alone_are_points_in_space() {
    let in_space = |text: &str| {
        let set = parse("a.json", text);
        set.landmarks.iter().all(|l| matches!(l.place, LandmarkPlace::Position(_)))
    };
    // the middle of a face, in metres
    assert!(in_space(r#"{"nasion": [0, 0.02, 0.1], "menton": [0, 0.05, 0.08]}"#));
    assert!(!in_space(r#"{"nasion": [0, 0.02, 0.1], "menton": [9, 0.05, 0.08]}"#));
    assert!(!in_space(r#"{"nasion": [0, 0.02, 0.1]}"#));
}

#[test]
fn every_bad_file_is_refused_with_its_name_and_a_reason() {
    let mrk = |inside: &str| format!(r#"{{"markups": [{{"type": "Fiducial"{inside}}}]}}"#);
    let fcsv = |rest: &str| format!("# Markups fiducial file version = 4.13\n{rest}");
    let native = |inside: &str| format!("{{\"landmarks\": [{{\"name\": \"a\"{inside}}}]}}");
    #[rustfmt::skip]
    let table: Vec<(&str, String, &[&str])> = vec![
        ("space.mrk.json", mrk(r#", "coordinateSystem": "IJK""#), &["LPS or RAS", "IJK"]),
        ("unit.mrk.json", mrk(r#", "coordinateUnits": "inch""#), &["mm or um", "inch"]),
        ("none.mrk.json", r#"{"markups": []}"#.into(), &["markup", "none"]),
        ("position.mrk.json", mrk(r#", "controlPoints": [{"label": "F-1", "position": [1, 2]}]"#), &["F-1", "[1, 2]"]),
        ("twice.mrk.json", mrk(r#", "controlPoints": [{"label": "F", "position": [1, 2, 3]}, {"label": "F", "position": [1, 2, 4]}]"#), &["once", "\"F\" twice"]),
        ("space.fcsv", fcsv("# CoordinateSystem = 7\n"), &["line 2", "LPS"]),
        ("silent.fcsv", fcsv("1,2,3,4\n"), &["line 2", "CoordinateSystem"]),
        ("short.fcsv", fcsv("# CoordinateSystem = LPS\n1,2,3\n"), &["line 3", "columns"]),
        ("word.fcsv", fcsv("# CoordinateSystem = LPS\n1,2,x,3,0,0,0,1,1,1,0,F,,\n"), &["line 3", "coordinate", "\"x\""]),
        ("nan.fcsv", fcsv("# CoordinateSystem = LPS\n1,2,nan,3,0,0,0,1,1,1,0,F,,\n"), &["line 3", "finite"]),
        ("empty.pp", String::new(), &["<PickedPoints>", "nothing"]),
        ("other.pp", "<html>\n</html>".into(), &["<PickedPoints>"]),
        ("open.pp", "<PickedPoints>\n<point name=\"a\"".into(), &["line 2", "end of an element"]),
        ("quote.pp", "<PickedPoints>\n<point name=a x=\"1\"/>".into(), &["line 2", "key=\"value\""]),
        ("name.pp", "<PickedPoints>\n\n<point x=\"1\" y=\"1\" z=\"1\"/>".into(), &["line 3", "name"]),
        ("z.pp", "<PickedPoints><point name=\"a\" x=\"1\" y=\"1\"/>".into(), &["line 1", "coordinate z", "\"a\"", "none"]),
        ("inf.pp", "<PickedPoints><point name=\"a\" x=\"inf\" y=\"1\" z=\"1\"/>".into(), &["finite", "inf"]),
        ("empty.pts", String::new(), &["version: 1"]),
        ("version.pts", "version: 2\n".into(), &["line 1", "version: 1"]),
        ("count.pts", "version: 1\nn_points: many\n".into(), &["line 2", "n_points"]),
        ("huge.pts", "version: 1\nn_points: 1000000000000\n{\n1 2 3\n}\n".into(), &["line 5", "1000000000000 points", "found 1"]),
        ("flat.pts", "version: 1\nn_points: 1\n{\n1 2\n}\n".into(), &["line 4", "picture"]),
        ("open.pts", "version: 1\nn_points: 1\n{\n1 2 3\n".into(), &["`}`", "end of the file"]),
        ("huge_idav.pts", "Version 1.0\n1000000000000\na 1 2 3\n".into(), &["line 3", "1000000000000", "found 1"]),
        ("huge.lm3", "1000000000000 Landmarks:\nNose\n1 2 3\n".into(), &["point 2 of 1000000000000", "end of the file"]),
        ("more.lm3", "1 Landmarks:\nNose\n1 2 3\nChin\n".into(), &["line 4", "after 1 points"]),
        ("first.lm3", "Landmarks\n".into(), &["line 1", "N Landmarks"]),
        ("half.lm3", "1 Landmarks:\nNose\n1 2\n".into(), &["line 3", "three coordinates", "found 2"]),
        ("version.ljson", r#"{"version": 9, "groups": {}}"#.into(), &["version 1, 2 or 3", "9"]),
        ("groups.ljson", r#"{"version": 3, "groups": {"a": {}, "b": {}}}"#.into(), &["one group", "a, b"]),
        ("points.ljson", r#"{"version": 2, "landmarks": {}}"#.into(), &["points"]),
        ("flat.ljson", r#"{"version": 2, "landmarks": {"points": [[1, 2]]}}"#.into(), &["two coordinates"]),
        ("word.csv", "a,1,2,3\nb,1,two,3\n".into(), &["line 2", "two"]),
        ("short.csv", "a,1,2\n".into(), &["line 1", "3 fields"]),
        ("commas.csv", "a,1,5,2,5,3,5\n".into(), &["line 1", "at most 4 fields", "decimals", "7 fields"]),
        ("header.csv", "label,x,y,z,sigma\na,1,2,3,4\nb,1,5,2,5,3,5\n".into(), &["line 3", "at most 5 fields", "7 fields"]),
        (
            "commas.fcsv",
            fcsv("# CoordinateSystem = LPS\n1,2,5,3,5,4,5,0,0,0,1,1,1,0,F,,,2,0\n"),
            &["line 3", "at most 16 fields", "19 fields"],
        ),
        ("commas.txt", "a,1,5,2,5,3,5\n".into(), &["line 1", "7 fields"]),
        ("commas.pts", "version: 1\nn_points: 1\n{\n1,5 2,5 3,5\n}\n".into(), &["line 4", "coordinate", "1,5"]),
        ("twice.csv", "a,1,2,3\na,4,5,6\n".into(), &["once", "\"a\" twice"]),
        ("short.txt", "7 1 2\n".into(), &["line 1", "3 fields"]),
        ("inf.txt", "7 1 2 1e999\n".into(), &["line 1", "finite"]),
        ("id.json", r#"[{"coordinates": [1, 2, 3]}]"#.into(), &["\"id\"", "\"0\""]),
        ("coordinates.json", r#"[{"id": "a"}]"#.into(), &["coordinates", "\"a\"", "null"]),
        ("stddevs.json", r#"[{"id": "a", "coordinates": [1, 2, 3], "uncertainty": {"stddevs": [0, 0, 0]}}]"#.into(), &["stddevs", "\"a\""]),
        ("unit.json", r#"{"unit": "inch", "landmarks": []}"#.into(), &["mm, cm or m", "inch"]),
        ("noname.json", r#"{"landmarks": [{"vertex": 1}]}"#.into(), &["name", "\"0\""]),
        ("noplace.json", native(""), &["\"vertex\"", "\"a\""]),
        ("places.json", native(r#", "vertex": 1, "position": [1, 2, 3]"#), &["one of", "\"a\""]),
        ("weights.json", native(r#", "face": 1, "barycentric": [0.5, 0.5, 0.5]"#), &["sum 1", "\"a\""]),
        ("minus.json", native(r#", "face": -1, "barycentric": [1, 0, 0]"#), &["triangle index", "-1"]),
        ("sigma.json", native(r#", "vertex": 1, "sigma": 0"#), &["sigma", "\"a\""]),
        ("deep.ljson", "[".repeat(100_000), &["JSON"]),
        ("unknown.xyz", "hello".into(), &["JSON"]),
    ];
    for (name, text, hints) in table {
        let message = parse_landmark_set(text.as_bytes(), Path::new(name)).expect_err(name).to_string();
        for hint in [&name].into_iter().chain(hints) {
            assert!(message.contains(hint), "{name}: {message:?} lacks {hint:?}");
        }
        assert!(message.len() < 400, "{name}: {message}");
    }
    let binary = parse_landmark_set(&[b'a', 0xff, 0xfe], Path::new("a.pp")).unwrap_err().to_string();
    assert!(binary.contains("byte 1") && binary.contains("UTF-8"), "{binary}");
}

#[test]
fn names_that_a_format_would_change_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, format, file) in [
        ("Nose", LandmarkFormat::Lm3, "a.lm3"),
        ("nose tip", LandmarkFormat::Text, "a.txt"),
        ("#nose", LandmarkFormat::Csv, "a.csv"),
    ] {
        let path = folder.path().join(file);
        let set = parse("a.json", &format!("{{\"{name}\": [1.5, 2, 3]}}"));
        let message = write_landmark_set(&path, &set, format).unwrap_err().to_string();
        assert!(message.contains(file) && !path.exists(), "{message}");
    }
}

/// Where looking each thing up among all others would take minutes.
#[test]
fn many_columns_and_many_points_take_no_time() {
    let columns = (0..200_000).map(|i| format!(",c{i}")).collect::<String>();
    let points = (0..100_000).map(|i| format!("{i},2,3\n")).collect::<String>();
    let set = parse("a.fcsv", &format!("# CoordinateSystem = LPS\n# columns = x,y,z{columns}\n{points}"));
    assert_eq!(set.landmarks.len(), 100_000);
    let same = (0..50_000).map(|i| format!("p{i},0,0,0\n")).collect::<String>();
    let set = parse("a.csv", &same);
    let check = LandmarkCheck::new(&set, &vec![Vec3::zeros(); 50_000], &quad(), 1.0).unwrap();
    assert_eq!((check.duplicates.len(), check.duplicates[0].join(" ")), (49_999, "p0 p1".to_owned()));
}
