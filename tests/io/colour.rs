//! The colour of scans: on the vertices of registered templates, and in files.

use std::path::Path;

use crate::sheets::sheet;
use crate::support::Bench;
use nonrigid::correspondence::{ScanOptions, ScanSurface};
use nonrigid::io::{
    PlyOptions, parse_gltf, read_mesh_file, read_polygon_mesh, read_scan, write_colored_mesh, write_obj, write_ply,
};
use nonrigid::mesh::normals::{NormalWeighting, vertex_normals};
use nonrigid::mesh::srgb::{from_light, to_light};
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::{RegistrationError, RegistrationInput, UNSEEN_COLOR, VertexColors, scan_colors};
use serde_json::json;

/// A grid of `side` x `side` vertices over 40 mm x 40 mm from `first` on, at the height `z`.
fn grid(side: usize, first: f64, z: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    let step = 40.0 / (side - 1) as f64;
    sheet(side, side, |c, r| {
        let (x, y) = (first + step * c, first + step * r);
        Vec3::new(x, y, z(x, y))
    })
}

fn hill(x: f64, y: f64) -> f64 {
    4.0 * (x / 9.0).sin() * (y / 11.0).cos()
}

/// Light with second derivatives of at most 0.3 / 16 per square millimetre in any direction along x and y.
fn light(p: &Vec3) -> Vec3 {
    Vec3::new(0.5 + 0.3 * (p.x / 4.0).sin(), 0.4 + 0.3 * (p.y / 4.0).cos(), 0.4 + 0.15 * ((p.x + p.y) / 4.0).sin())
}

fn colors(points: &[Vec3]) -> Vec<[u8; 3]> {
    points.iter().map(|p| from_light(light(p))).collect()
}

fn colored(
    input: &RegistrationInput<'_>,
    colors: &[[u8; 3]],
    positions: &[Vec3],
) -> Result<VertexColors, RegistrationError> {
    let surface = ScanSurface::new(input.scan.clone(), input.scan_normals, &ScanOptions::default()).unwrap();
    scan_colors(input, &surface, colors, positions)
}

/// Largest difference in light at the observed vertices from what the formula says.
fn error(found: &VertexColors, positions: &[Vec3]) -> f64 {
    let off = |((c, p), _): ((&[u8; 3], &Vec3), &bool)| (to_light(*c) - light(p)).amax();
    let all = found.colors.iter().zip(positions).zip(&found.observed);
    all.filter(|(_, observed)| **observed).map(off).fold(0.0, f64::max)
}

/// Half a step of 8 bits is at most this much light, once on the scan and once on the template.
const ROUNDING: f64 = 2.0 * 0.5 / 255.0 * 2.28;

#[test]
fn a_formula_on_a_surface_arrives_as_exactly_as_triangles_and_points_interpolate() {
    let template = PolygonMesh::from(grid(60, 0.31, hill));
    for side in [41, 81, 161] {
        let mut scan = grid(side, 0.0, hill);
        let colors = colors(&scan.positions);
        let step = 40.0 / (side - 1) as f64;
        let normals = vertex_normals(&scan.positions, &scan.triangles, NormalWeighting::Area);
        let found = colored(&RegistrationInput::new(&template, &scan), &colors, &template.positions).unwrap();
        // Linear interpolation: an eighth of the squared longest edge times the second derivative along it.
        let bound = 2.0 * step * step / 8.0 * 2.0 * 0.3 / 16.0 + ROUNDING;
        let off = error(&found, &template.positions);
        println!("{side}: {off:.5} of {bound:.5}, {} observed", found.observed_count());
        assert!(off < bound, "{side}: {off} {bound}");
        // All but the rows past the scan's edge.
        assert!(found.observed_count() >= 58 * 58, "{}", found.observed_count());
        scan.triangles.clear();
        let input = RegistrationInput { scan_normals: Some(&normals), ..RegistrationInput::new(&template, &scan) };
        let found = colored(&input, &colors, &template.positions).unwrap();
        let off = error(&found, &template.positions);
        // The mean of points is exact to first order only where they lie evenly: half a step times the slope.
        let bound = 0.5 * step * 0.3 / 4.0 + ROUNDING;
        println!("{side} as points: {off:.5} of {bound:.5}, {} observed", found.observed_count());
        assert!(off < bound && found.observed_count() >= 56 * 56, "{side}: {off} {bound}");
    }
}

#[test]
fn what_the_scan_does_not_show_is_harmonic() {
    let linear = |p: &Vec3| Vec3::new(0.1 + 0.02 * p.x, 0.9 - 0.02 * p.y, 0.2 + 0.01 * (p.x + p.y));
    let mut scan = grid(81, 0.0, |_, _| 0.0);
    let inside = |p: &Vec3| (p.x - 20.0).abs().max((p.y - 20.0).abs()) < 9.0;
    scan.triangles.retain(|t| !t.iter().any(|&v| inside(&scan.positions[v as usize])));
    let colors: Vec<[u8; 3]> = scan.positions.iter().map(|p| from_light(linear(p))).collect();
    let mut template = PolygonMesh::from(grid(41, 0.0, |_, _| 0.2));
    // A second part that the scan does not show.
    let first = template.positions.len() as u32;
    template.positions.extend([Vec3::new(0.0, 0.0, 90.0), Vec3::new(1.0, 0.0, 90.0), Vec3::new(0.0, 1.0, 90.0)]);
    template.corners.extend([first, first + 1, first + 2]);
    template.starts.push(template.corners.len() as u32);
    let found = colored(&RegistrationInput::new(&template, &scan), &colors, &template.positions).unwrap();
    let (mut hidden, mut worst) = (0, 0.0_f64);
    for (v, p) in template.positions.iter().enumerate().take(first as usize) {
        if inside(p) {
            assert!(!found.observed[v]);
            hidden += 1;
            // Linear functions are harmonic on this grid.
            worst = worst.max((to_light(found.colors[v]) - linear(p)).amax());
        }
    }
    assert!(hidden > 250 && worst < 2.0 * ROUNDING, "{hidden} {worst}");
    assert_eq!(found.colors[first as usize..], [UNSEEN_COLOR; 3]);
    assert_eq!(found.observed[first as usize..], [false; 3]);
}

#[test]
fn only_what_is_near_faces_the_same_way_and_is_not_masked_is_observed() {
    let scan = grid(41, 0.0, |_, _| 0.0);
    let colors = vec![[200, 100, 50]; scan.positions.len()];
    let observed = |height: f64, turned: bool, mask: Option<&[f64]>| {
        let mut mesh = grid(11, 0.0, |_, _| height);
        mesh.positions.iter_mut().for_each(|p| *p = *p * 0.5 + Vec3::new(10.0, 10.0, 0.5 * height));
        if turned {
            mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let template = PolygonMesh::from(mesh);
        let input = RegistrationInput { mask, ..RegistrationInput::new(&template, &scan) };
        let found = colored(&input, &colors, &template.positions).unwrap();
        assert!(
            found.colors.iter().all(|c| *c == if found.observed_count() > 0 { [200, 100, 50] } else { UNSEEN_COLOR })
        );
        found.observed_count()
    };
    assert_eq!(observed(2.9, false, None), 121);
    assert_eq!(observed(3.1, false, None), 0);
    assert_eq!(observed(1.0, true, None), 0);
    let mut mask = vec![0.0; 121];
    mask[..20].fill(0.3);
    assert_eq!(observed(1.0, false, Some(&mask)), 20);
    let template = PolygonMesh::from(grid(11, 0.0, |_, _| 0.0));
    let input = RegistrationInput::new(&template, &scan);
    let refused = colored(&input, &colors[1..], &template.positions);
    assert!(matches!(refused, Err(RegistrationError::Scan(message)) if message.contains("1680 colours for 1681")));
    let refused = scan_colors(&input, &ScanSurface::default(), &colors, &template.positions);
    assert!(matches!(refused, Err(RegistrationError::Scan(message)) if message.contains("another scan")));
}

#[test]
fn files_give_every_colour_back() {
    let folder = tempfile::tempdir().unwrap();
    // Two triangles with a seam of texture coordinates between them, so that a .glb has copies of vertices.
    let text =
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0\nf 1/1 2/2 3/3\nf 1/5 3/4 4/1\n";
    std::fs::write(folder.path().join("a.obj"), text).unwrap();
    let mesh = read_polygon_mesh(&folder.path().join("a.obj")).unwrap();
    for start in 0..64u8 {
        let colors: Vec<[u8; 3]> = (0..4).map(|v| [4 * start + v, 255 - 4 * start - v, 7]).collect();
        for name in ["r.ply", "r.obj", "r.glb"] {
            let path = folder.path().join(name);
            write_colored_mesh(&path, &mesh, Some(&colors)).unwrap();
            assert_eq!(read_scan(&path).unwrap().colors.as_ref(), Some(&colors), "{name}");
            let refused = write_colored_mesh(&path, &mesh, Some(&colors[1..])).unwrap_err().to_string();
            assert!(refused.contains("colours for each of 4 vertices"), "{refused}");
            write_colored_mesh(&path, &mesh, None).unwrap();
            assert_eq!(read_scan(&path).unwrap().colors, None, "{name}");
        }
    }
    write_obj(&folder.path().join("plain.obj"), &mesh).unwrap();
    write_colored_mesh(&folder.path().join("none.obj"), &mesh, None).unwrap();
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("plain.obj"), read("none.obj"));
}

#[test]
fn colours_of_others_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let obj = |text: &str| {
        let path = folder.path().join("a.obj");
        std::fs::write(&path, format!("{text}f 1 2 3\n")).unwrap();
        read_mesh_file(&path).unwrap().colors
    };
    let expected = Some(vec![[255, 0, 128], [0, 255, 3], [1, 2, 3]]);
    assert_eq!(obj("v 0 0 0 1 0 .5\nv 1 0 0 0 1 0.011\nv 0 1 0 0.004 0.008 0.012\n"), expected);
    assert_eq!(obj("v 0 0 0 255 0 128\nv 1 0 0 0 255 3\nv 0 1 0 1 2 3\n"), expected);
    // a light brighter than white
    assert_eq!(obj("v 0 0 0 7 0 .5\nv 1 0 0 0 1.0001 0.011\nv 0 1 0 0.004 0.008 0.012\n"), expected);
    assert_eq!(obj("v 0 0 0 1 0 .5\nv 1 0 0\nv 0 1 0 0.004 0.008 0.012\n"), None);
    assert_eq!(obj("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\n"), None);
    assert_eq!(obj("v 0 0 0 1 0 x\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0\n"), None);

    // COLOR_0 as four normalised bytes of light: 55 / 255 is sRGB's 128.
    let mut bytes: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend([55u8, 255, 0, 255, 0, 0, 55, 255, 255, 55, 255, 255]);
    let uri = {
        use base64::Engine as _;
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(&bytes))
    };
    let document = |kind: &str, count: usize| {
        json!({
            "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "COLOR_0": 1 } }] }],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3 },
                { "bufferView": 1, "componentType": 5121, "normalized": true, "type": kind, "count": count },
            ],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }, { "buffer": 0, "byteOffset": 36, "byteLength": 12 }],
            "buffers": [{ "byteLength": 48, "uri": uri }],
        })
        .to_string()
    };
    let parse = |text: String| parse_gltf(text.as_bytes(), Path::new("a.gltf")).map_err(|e| e.to_string());
    let middle = from_light(Vec3::repeat(55.0 / 255.0))[0];
    assert_eq!(middle, 128);
    let expected = vec![[middle, 255, 0], [0, 0, middle], [255, middle, 255]];
    assert_eq!(parse(document("VEC4", 3)).unwrap().colors, Some(expected));
    assert!(parse(document("VEC4", 2)).unwrap_err().contains("colours for each of 3 vertices"));
    assert!(parse(document("VEC2", 3)).unwrap_err().contains("COLOR_0"));
    assert!(parse(document("VEC4", 3).replace("\"COLOR_0\":1", "\"COLOR_0\":9")).is_err());
}

#[test]
fn the_command_colours_its_result_in_every_format() {
    let bench = Bench::of_size(1000, 8000);
    let scan = &bench.case.scan;
    let tint = |p: &Vec3| from_light(Vec3::new(0.5 + 0.005 * p.x, 0.5 + 0.004 * p.y, 0.3));
    let colors: Vec<[u8; 3]> = scan.positions.iter().map(tint).collect();
    let options = PlyOptions { colors: Some(&colors), ..PlyOptions::default() };
    write_ply(&bench.path("scan.ply"), scan, options).unwrap();
    for format in ["obj", "ply", "glb"] {
        let said = bench.done(&format!(
            "register --template rig/template.obj --target scan.ply --model graph --landmarks case/landmarks.json --threads 2 \
             --out r.{format} --report r.json"
        ));
        let report = bench.json("r.json");
        let seen = report["colors_observed"].as_u64().unwrap();
        let result = read_scan(&bench.path(&format!("r.{format}"))).unwrap();
        assert!(seen > 500 && said.contains(&format!("colour: {seen} of {} vertices", result.mesh.positions.len())));
        let off = |(c, p): (&[u8; 3], &Vec3)| (to_light(*c) - to_light(tint(p))).amax();
        let mut off: Vec<f64> = result.colors.unwrap().iter().zip(&result.mesh.positions).map(off).collect();
        off.sort_by(f64::total_cmp);
        assert!(off[seen as usize - 1] < 0.03, "{format}: {}", off[seen as usize - 1]);
    }
    let said = bench.done(
        "register --template rig/template.obj --target case/scan.ply --model rigid --landmarks case/landmarks.json --out r.obj \
         --report r.json",
    );
    let report = bench.json("r.json");
    assert!(report["colors_observed"].is_null() && !said.contains("colour"));
    assert_eq!(read_mesh_file(&bench.path("r.obj")).unwrap().colors, None);
}
