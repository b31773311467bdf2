//! Real files, when they lie beside the checkout or where `NONRIGID_DATA` points; skipped otherwise.

use nonrigid::evaluation::TruthErrors;
use nonrigid::io::{read_npy_mask, read_npy_points, read_polygon_mesh, read_scan, write_obj};
use nonrigid::landmark::{TemplatePoint, read_landmarks};
use nonrigid::mesh::Vec3;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::geodesic::{WeightedGraph, distances, farthest_point_sampling, nearest_sources, share_nodes};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::rig::{Rig, RigReadOptions, ShapeSelection};

use crate::real_data::real_data;

#[test]
fn the_face_rig() {
    let Some(folder) = real_data("ict-facekit/narrow") else { return };
    let options = RigReadOptions { identity_modes: 40, kind: None };
    let (rig, warnings) = Rig::read(&folder, &options).unwrap();
    assert_eq!(rig.neutral().len(), 6706);
    assert_eq!(rig.mesh().unwrap().polygon_count(), 6560);
    assert_eq!(rig.landmarks().unwrap().len(), 68);
    let dropped: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert!(dropped.iter().any(|w| w.contains("PupilDilate_L")), "{dropped:?}");
    assert_eq!(rig.shapes().len() + dropped.len(), 57 + 40);
    let selected = rig.select(ShapeSelection { identity_modes: 40, ..ShapeSelection::default() }).unwrap();
    let jaw = rig.find("jawOpen").unwrap();
    let column = selected.shapes().iter().position(|s| s.name == "jawOpen").unwrap();
    for (row, delta) in rig.deltas(jaw).iter().enumerate() {
        assert_eq!(selected.displacement(row / 3, column)[row % 3], f64::from(*delta));
    }
    assert!(rig.info()[jaw].max_displacement > 5.0);

    let template = rig.mesh().unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("template.obj");
    write_obj(&path, template).unwrap();
    assert_eq!(&read_polygon_mesh(&path).unwrap(), template);
}

#[test]
fn nodes_and_labels_on_the_face() {
    let Some(path) = real_data("ict-facekit/narrow/template.obj") else { return };
    let mesh = read_polygon_mesh(&path).unwrap().into_triangles();
    let graph = EdgeGraph::of(&mesh);
    let components = graph.components();
    let weighted = WeightedGraph::euclidean(&graph, &mesh.positions).unwrap();
    let counts = share_nodes(&components.sizes(), 400);
    let sampling = farthest_point_sampling(&weighted, &components, &counts);
    assert_eq!(sampling.nodes.len(), 400);
    let labels = nearest_sources(&weighted, &sampling.nodes, 5);
    let tables: Vec<_> = sampling.nodes.iter().map(|&s| distances(&weighted, &[s], f64::INFINITY)).collect();
    for v in (0..mesh.positions.len()).step_by(7) {
        let mut all: Vec<(f64, u32)> = tables.iter().enumerate().map(|(s, d)| (d[v], s as u32)).collect();
        all.retain(|(d, _)| d.is_finite());
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(5);
        let found: Vec<(f64, u32)> = labels.of(v).map(|(s, d)| (d, s)).collect();
        assert_eq!(found, all, "vertex {v}");
    }
}

#[test]
fn the_benchmark_scans() {
    for case in ["same_open", "same_smile", "same_pucker", "new_open", "new_asym", "new_frame"] {
        let Some(folder) = real_data(&format!("scanner-bench/{case}")) else { return };
        let scan = read_scan(&folder.join("scan.ply")).unwrap();
        assert!(scan.mesh.triangles.len() > 50_000);
        let truth = read_npy_points(&folder.join("truth.npy")).unwrap();
        let observed = read_npy_mask(&folder.join("observed.npy"), Some(truth.len())).unwrap();
        let Some(template) = real_data("ict-facekit/narrow/template.obj") else { return };
        let template = read_polygon_mesh(&template).unwrap();
        let landmarks = read_landmarks(&folder.join("landmarks.json"), None, &template, Some(&scan.mesh)).unwrap();
        assert!(landmarks.len() > 20);
        for landmark in &landmarks {
            let TemplatePoint::Vertex(v) = landmark.template else { panic!("a vertex") };
            assert!((truth[v as usize] - landmark.target).norm() < 8.0);
        }
        let tree = ClosestPoint::new(&scan.mesh).unwrap();
        let seen: Vec<_> = truth.iter().zip(&observed).filter(|(_, o)| **o).map(|(p, _)| p).collect();
        let near = seen.iter().filter(|p| tree.query_within(p, 4.0).is_some()).count();
        assert!(near * 100 > seen.len() * 95, "{case}: {near} of {}", seen.len());
        let normals = vertex_normals(&scan.mesh.positions, &scan.mesh.triangles, NormalWeighting::Angle);
        assert!(normals.iter().all(|n| n.iter().all(|x| x.is_finite())));
    }
}

#[test]
fn the_other_scans_and_their_landmarks() {
    let Some(folder) = real_data("scans") else { return };
    let Some(rig) = real_data("ict-facekit/narrow") else { return };
    let template = read_polygon_mesh(&rig.join("template.obj")).unwrap();
    let names = rig.join("landmarks_multipie68.json");
    for name in ["lps-head/lps_head_full.ply", "lps-head/lps_head_neckcut.ply", "standardcyborg-sven/frame_050.ply"] {
        let scan = read_scan(&folder.join(name)).unwrap();
        assert_eq!(scan.colors.is_some(), name.starts_with("standardcyborg"));
        ClosestPoint::new(&scan.mesh).unwrap();
    }
    let james = folder.join("menpo3d-james");
    let scan = read_scan(&james.join("james.ply")).unwrap();
    let tree = ClosestPoint::new(&scan.mesh).unwrap();
    let file = james.join("james_landmarks_multipie68.json");
    let landmarks = read_landmarks(&file, Some(&names), &template, Some(&scan.mesh)).unwrap();
    assert_eq!(landmarks.len(), 68);
    assert_eq!(landmarks[0].template, TemplatePoint::Vertex(1225));
    assert!(landmarks.iter().filter(|l| tree.query_within(&l.target, 25.0).is_some()).count() > 50);

    let head = folder.join("lps-head");
    let scan = read_scan(&head.join("lps_head_full.ply")).unwrap();
    let tree = ClosestPoint::new(&scan.mesh).unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let names = temporary.path().join("names.json");
    std::fs::write(&names, r#"{"00": 1, "01": 2, "02": 3, "03": 4, "04": 5, "05": 6, "06": 7}"#).unwrap();
    let wrap = head.join("wrap_landmarks.json");
    let landmarks = read_landmarks(&wrap, Some(&names), &template, Some(&scan.mesh)).unwrap();
    assert_eq!(landmarks.len(), 7);
    assert!(landmarks.iter().all(|l| tree.query_within(&l.target, 1e-6).is_some()));
    // names such as "00" are no vertex indices
    assert!(read_landmarks(&wrap, None, &template, Some(&scan.mesh)).is_err());
}

/// What numpy makes of the same perturbation of two simulated scans' truth (4 decimals):
/// `truth + a_i sin((0.7 i, 1.3 i + 1, 0.11 i + 2))`, a_i = 3 mm for every 50th vertex and 0.4 mm for the others.
#[test]
fn errors_agree_with_the_reference_scorer() {
    let reference = [
        ("same_open", [0.7106, 0.4926, 0.6514, 5.0714, 0.4274, 0.5677, 0.7289], 425),
        ("new_asym", [0.7066, 0.4922, 0.6508, 5.0714, 0.4171, 0.5703, 0.751], 410),
    ];
    for (case, expected, flipped) in reference {
        let Some(template) = real_data("ict-facekit/narrow/template.obj") else { return };
        let Some(folder) = real_data(&format!("scanner-bench/{case}")) else { return };
        let triangles = read_polygon_mesh(&template).unwrap().into_triangles().triangles;
        let truth = read_npy_points(&folder.join("truth.npy")).unwrap();
        let observed = read_npy_mask(&folder.join("observed.npy"), None).unwrap();
        let perturbed = |(i, t): (usize, &Vec3)| {
            let (amplitude, i) = (if i % 50 == 0 { 3.0 } else { 0.4 }, i as f64);
            t + Vec3::new((0.7 * i).sin(), (1.3 * i + 1.0).sin(), (0.11 * i + 2.0).sin()) * amplitude
        };
        let result: Vec<Vec3> = truth.iter().enumerate().map(perturbed).collect();
        let (e, _) = TruthErrors::new(&result, &truth, &observed, &triangles).unwrap();
        for (ours, theirs) in
            [e.rmse, e.median, e.p95, e.max, e.normal, e.tangential, e.unobserved.unwrap()].iter().zip(expected)
        {
            assert!((ours - theirs).abs() < 5.1e-5, "{case}: {e:?}");
        }
        assert_eq!(e.flipped, flipped, "{case}");
    }
}
