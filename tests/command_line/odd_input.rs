//! What looks odd in a scan or a template and must work all the same.

use crate::broken::{broken, command_line};
use crate::support::Bench;
use nonrigid::io::{PlyOptions, read_polygon_mesh, write_obj, write_ply};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};

/// Runs a registration that must work and returns the positions, finite all of them.
fn works(bench: &Bench, changes: &str) -> PolygonMesh {
    let line = command_line("register", changes).replace("OUT", "new");
    bench.done(&line);
    let result = read_polygon_mesh(&bench.path("new/r.obj")).unwrap();
    assert!(result.positions.iter().all(|p| p.iter().all(|c| c.is_finite())), "{line}");
    result
}

fn near_truth(bench: &Bench, positions: &[Vec3]) -> f64 {
    let pairs = positions.iter().zip(&bench.case.truth).zip(&bench.case.observed).filter(|(_, o)| **o);
    let squares: Vec<f64> = pairs.map(|((a, b), _)| (a - b).norm_squared()).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn flaws_of_real_scans_change_nothing_or_little() {
    let bench = broken();
    let expected = near_truth(&bench, &works(&bench, "--config -").positions);
    let scan = &bench.case.scan;
    let with = |positions: &[Vec3], triangles: &[[u32; 3]]| -> TriangleMesh {
        let mut flawed = scan.clone();
        flawed.positions.extend(positions);
        flawed.triangles.extend(triangles);
        flawed
    };
    let repeated: Vec<[u32; 3]> = scan.triangles.iter().step_by(50).copied().collect();
    let flat: Vec<[u32; 3]> = scan.triangles.iter().step_by(40).map(|t| [t[0], t[1], t[1]]).collect();
    for (what, flawed) in [
        ("unreferenced vertices", with(&[Vec3::zeros(), Vec3::repeat(1e4), Vec3::repeat(-50.0)], &[])),
        ("triangles without area", with(&[], &flat)),
        ("duplicate triangles", with(&[], &repeated)),
    ] {
        write_ply(&bench.path("flawed.ply"), &flawed, PlyOptions::default()).unwrap();
        let found = near_truth(&bench, &works(&bench, "--config - --target flawed.ply").positions);
        assert!(found < 1.1 * expected + 0.05, "{what}: {found} mm, without {expected} mm");
    }
}

#[test]
fn templates_with_loose_vertices_or_several_parts_work_with_every_model() {
    let bench = broken();
    let template = &bench.rig.mesh;
    let mut loose = template.clone();
    loose.positions.push(Vec3::new(0.0, 0.0, 90.0));
    // A second part: a small quad in front of the forehead.
    let mut parts = template.clone();
    let first = parts.positions.len() as u32;
    parts
        .positions
        .extend([[-5.0, 0.0], [5.0, 0.0], [5.0, 8.0], [-5.0, 8.0]].map(|[x, y]| Vec3::new(x, 60.0 + y, 80.0)));
    parts.corners.extend([first, first + 1, first + 2, first + 3]);
    parts.starts.push(parts.corners.len() as u32);
    parts.metadata.corner_uvs.extend([u32::MAX; 4]);
    for (name, mesh) in [("loose", &loose), ("parts", &parts)] {
        write_obj(&bench.path(&format!("{name}.obj")), mesh).unwrap();
        for model in ["hybrid", "graph", "rigid", "similarity"] {
            // The bench's schedule is a graph's.
            let config = if model == "hybrid" || model == "graph" { "" } else { "--config -" };
            let changes = format!("--template {name}.obj --rig - --neutral - --model {model} {config}");
            let result = works(&bench, &changes);
            assert_eq!(PolygonMesh { positions: mesh.positions.clone(), ..result.clone() }, *mesh, "{name} {model}");
            // Nobody is left behind or thrown away: the pieces stay near each other.
            let far =
                result.positions[first as usize..].iter().map(|p| (p - result.positions[0]).norm()).fold(0.0, f64::max);
            assert!(far < 400.0, "{name} {model}: {far}");
        }
    }
}

#[test]
fn a_result_in_another_order_is_measured_and_said() {
    let bench = broken();
    let mut positions = bench.case.truth.clone();
    write_obj(&bench.path("right.obj"), &bench.rig.mesh.with_positions(positions.clone())).unwrap();
    positions.reverse();
    write_obj(&bench.path("reversed.obj"), &bench.rig.mesh.with_positions(positions)).unwrap();
    for (result, said) in [("right.obj", false), ("reversed.obj", true)] {
        let run = bench.run(&command_line("eval", &format!("--result {result}")).replace("OUT", "new"));
        assert_eq!((run.code, run.stderr.contains("in the template's order")), (0, said), "{}", run.stderr);
        assert!(!run.stderr.contains("the rig") && !run.stderr.contains("this rig"), "there is none: {}", run.stderr);
    }
}

#[test]
fn a_template_of_one_triangle_works_or_says_why_not() {
    let bench = broken();
    // On the scan: it has a surface to lie on.
    let [a, b, c] = bench.case.scan.triangles[0].map(|v| bench.case.scan.positions[v as usize]);
    bench.write(
        "on_scan.obj",
        format!("v {} {} {}\nv {} {} {}\nv {} {} {}\nf 1 2 3\n", a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z),
    );
    let run = bench.run(
        &command_line("register", "--template on_scan.obj --rig - --neutral - --landmarks - --model graph")
            .replace("OUT", "new"),
    );
    match run.code {
        0 => {
            assert!(read_polygon_mesh(&bench.path("new/r.obj")).unwrap().positions.iter().all(|p| p.norm().is_finite()))
        }
        2 | 4 => assert!(run.stderr.starts_with("error: ") && run.stdout.is_empty(), "{}", run.stderr),
        code => panic!("exit code {code}: {}", run.stderr),
    }
}
