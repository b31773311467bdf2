//! Round trips of the mesh, array and landmark files, and the same mesh in all three PLY encodings.

use std::path::Path;

use crate::bad_input::npy_with;
use nonrigid::io::{
    NpyArray, Npz, PlyOptions, PlyPrecision, parse_obj, parse_ply, read_mesh_file, read_npy_mask, read_npy_points,
    read_polygon_mesh, read_scan, write_npy, write_npy_points, write_obj, write_ply, write_ply_polygons,
    write_polygon_mesh,
};
use nonrigid::landmark::{TemplatePoint, read_landmarks};
use nonrigid::mesh::{ObjStatement, PolygonMesh, TriangleMesh, Vec3};

/// A strip of quads and a pentagon with a UV seam, groups, materials, smoothing, and a loose vertex.
const TEMPLATE: &str = "# strip\nmtllib skin.mtl\nmtllib eye lids.mtl\no head\n\
    v 0 0 0\nv 1 0 0.1\nv 2 0 -1e-7\nv 0 1 0\nv 1 1 0.30000000000000004\nv 2 1 0\nv 1 2 0\nv 9 9 9\n\
    vt 0 0\nvt .5 0\nvt 1 0\nvt 0 1\nvt 0.5 1\nvt 1 1\nvt 0.25 0.75\n\
    g face cheek\nusemtl skin\ns 1\nf 1/1 2/2 5/5 4/4\nusemtl lip\nf -7/2/ -6/-5 6/6 5/7\ng\ns off\nf 4 5 6 7 1\no nothing after\n";

fn template() -> PolygonMesh {
    parse_obj(TEMPLATE.as_bytes(), Path::new("template.obj")).unwrap()
}

#[test]
fn obj_keeps_everything_but_comments() {
    let mesh = template();
    assert_eq!(mesh.polygon_count(), 3);
    assert_eq!(mesh.polygon(1), [1, 2, 5, 4]);
    assert_eq!(mesh.metadata.corner_uvs[4..8], [1, 2, 5, 6]);
    assert_eq!(mesh.metadata.corner_uvs[8..], [u32::MAX; 5]);
    assert_eq!(mesh.metadata.material_libraries, ["skin.mtl", "eye lids.mtl"]);
    assert_eq!(mesh.metadata.statements[4], (1, ObjStatement::Material("lip".into())));
    assert_eq!(mesh.metadata.statements.last().unwrap(), &(3, ObjStatement::Object("nothing after".into())));

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.obj");
    write_obj(&path, &mesh).unwrap();
    assert_eq!(read_polygon_mesh(&path).unwrap(), mesh);
    // and again: the text is a fixed point
    let text = std::fs::read(&path).unwrap();
    write_obj(&path, &read_polygon_mesh(&path).unwrap()).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), text);
}

/// Two quads that meet in a hard edge, the second of which has been turned up since the file was made.
#[test]
fn hard_edges_stay_hard_on_another_shape() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nv 3 0 0\nv 3 1 0\nvn 0 0 1\nvn 0.6 0 0.8\n\
        f 1//1 2//1 3//1 4//1\nf 2//2 5//2 6//2 3//2\nf 5//2 7//2 8//2 6//2\nf 1 2 3\n";
    let mesh = parse_obj(text.as_bytes(), Path::new("edge.obj")).unwrap();
    let mut positions = mesh.positions.clone();
    (4..8).for_each(|v| positions[v].z = 1.0);
    let bent = mesh.with_positions(positions);
    let (normals, of_corner) = bent.corner_normals();
    let at = |c: usize| normals[of_corner[c] as usize];
    let (flat, slope) = (Vec3::z(), Vec3::new(-1.0, 0.0, 1.0).normalize());
    assert!((at(1) - flat).norm() < 1e-12 && (at(4) - slope).norm() < 1e-12, "one place, two normals");
    assert!((at(5) - (slope * 2.0f64.sqrt() + flat).normalize()).norm() < 1e-12 && of_corner[5] == of_corner[8]);
    assert_eq!(of_corner[12..], [u32::MAX; 3]);

    let folder = tempfile::tempdir().unwrap();
    let [first, again] = ["first.obj", "again.obj"].map(|name| folder.path().join(name));
    write_obj(&first, &bent).unwrap();
    let read = read_polygon_mesh(&first).unwrap();
    assert_eq!(
        (read.corner_normals(), read.metadata.corner_normals.clone()),
        ((normals, of_corner.clone()), of_corner)
    );
    write_obj(&again, &read).unwrap();
    assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&again).unwrap());
}

#[test]
fn obj_coordinates_survive_to_the_last_bit() {
    let values = [1.0 / 3.0, 1e-310, f64::MAX, -0.0, 5e-324, 123_456_789.123_456_79, -2.5e17];
    let positions = values.iter().map(|&x| Vec3::new(x, -x, x * 0.1)).collect();
    let mesh = PolygonMesh { positions, starts: vec![0], ..PolygonMesh::default() };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.obj");
    write_obj(&path, &mesh).unwrap();
    let read = parse_obj(&std::fs::read(&path).unwrap(), &path).unwrap(); // beyond what a mesh file may have
    for (a, b) in mesh.positions.iter().zip(read.positions) {
        assert_eq!(a.map(f64::to_bits), b.map(f64::to_bits));
    }
}

/// The rows of one mesh: positions, normals, colours, faces.
fn ply_text() -> String {
    "ply\r\nformat ascii 1.0\ncomment made by hand\nobj_info too\nelement camera 1\nproperty float fov\n\
     element vertex 5\nproperty double x\nproperty float nx\nproperty float ny\nproperty float nz\nproperty double y\nproperty double z\n\
     property uchar red\nproperty uchar green\nproperty uchar blue\nproperty list ushort short extra\n\
     element face 2\nproperty uchar flags\nproperty list int uint vertex_index\nproperty float quality\nelement edge 0\nproperty int a\nend_header\n\
     60\n0 0 0 1 0 0 255 0 1 0\n1 0 1 0 0 0.5 254 2 3 2 7 -8\n\n2 1 0 0 1 0 253 4 5 0\n0.25 0 0 -1 1 0 252 6 7 1 9\n9 nan 0 0 9 9 0 0 0 0\n\
     1 3 0 1 2 0.5\n0 4 0 1 2 3 1e3"
        .to_owned()
}

fn ply_binary(big: bool) -> Vec<u8> {
    let text = ply_text();
    let end = text.find("end_header\n").unwrap() + 11;
    let name = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = text[..end].replace("ascii", name).into_bytes();
    let mut put = |b: &[u8]| {
        let mut b = b.to_vec();
        if big {
            b.reverse();
        }
        bytes.extend(b);
    };
    put(&60f32.to_le_bytes());
    for line in text[end..].lines().skip(1).filter(|l| !l.is_empty()).take(5) {
        let words: Vec<&str> = line.split(' ').collect();
        let (double, float) = (|w: &str| w.parse::<f64>().unwrap(), |w: &str| w.parse::<f32>().unwrap());
        put(&double(words[0]).to_le_bytes());
        words[1..4].iter().for_each(|w| put(&float(w).to_le_bytes()));
        words[4..6].iter().for_each(|w| put(&double(w).to_le_bytes()));
        words[6..9].iter().for_each(|w| put(&[w.parse::<u8>().unwrap()]));
        put(&words[9].parse::<u16>().unwrap().to_le_bytes());
        words[10..].iter().for_each(|w| put(&w.parse::<i16>().unwrap().to_le_bytes()));
    }
    for (flags, face, quality) in [(1u8, &[0u32, 1, 2][..], 0.5f32), (0, &[0, 1, 2, 3], 1e3)] {
        put(&[flags]);
        put(&(face.len() as i32).to_le_bytes());
        face.iter().for_each(|v| put(&v.to_le_bytes()));
        put(&quality.to_le_bytes());
    }
    bytes
}

#[test]
fn ply_keeps_texture_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("textured.ply");
    let mesh = template();
    write_polygon_mesh(&path, &mesh).unwrap();
    let read = read_mesh_file(&path).unwrap().mesh;
    let of = |mesh: &PolygonMesh| -> Vec<Option<[f32; 2]>> {
        let PolygonMesh { metadata, .. } = mesh;
        metadata.corner_uvs.iter().map(|&c| metadata.uvs.get(c as usize).map(|uv| uv.map(|x| x as f32))).collect()
    };
    assert_eq!((&read.positions, &read.corners, of(&read)), (&mesh.positions, &mesh.corners, of(&mesh)));
    assert_eq!(read.metadata.uvs.len(), 7, "each once");
    // of vertices, as Blender writes them
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float s\n\
        property float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 2 0 1\n";
    let mesh = parse_ply(text.as_bytes(), Path::new("b.ply")).unwrap().mesh;
    assert_eq!((mesh.metadata.uvs[1], &mesh.metadata.corner_uvs[..]), ([1.0, 0.0], &[2, 0, 1][..]));
}

#[test]
fn all_ply_encodings_say_the_same() {
    let ascii = parse_ply(ply_text().as_bytes(), Path::new("a.ply")).unwrap();
    assert_eq!(ascii.mesh.positions[1], Vec3::new(1.0, 0.0, 0.5));
    assert_eq!(ascii.mesh.corners, [0, 1, 2, 0, 1, 2, 3]);
    assert_eq!(ascii.mesh.starts, [0, 3, 7]);
    assert_eq!(ascii.normals.as_ref().unwrap()[3], Vec3::new(0.0, 0.0, -1.0));
    assert_eq!(ascii.normals.as_ref().unwrap()[4], Vec3::zeros());
    assert_eq!(ascii.colors.as_ref().unwrap()[2], [253, 4, 5]);
    for big in [false, true] {
        assert_eq!(parse_ply(&ply_binary(big), Path::new("b.ply")).unwrap(), ascii);
    }
}

#[test]
fn cutting_a_ply_anywhere_is_an_error() {
    for whole in [ply_text().into_bytes(), ply_binary(false), ply_binary(true)] {
        for length in 0..whole.len() {
            // an ascii number may be cut and still be one
            if let Ok(ply) = parse_ply(&whole[..length], Path::new("cut.ply")) {
                assert!(whole.len() - length <= 3, "{length} of {}: {ply:?}", whole.len());
            }
        }
    }
}

#[test]
fn ply_round_trips() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    let mesh = PolygonMesh { metadata: Default::default(), ..template() };
    let normals: Vec<Vec3> = mesh.positions.iter().map(|p| p.cross(&Vec3::new(0.3, 0.1, 2.0))).collect();
    let colors: Vec<[u8; 3]> = (0..8).map(|i| [i, 2 * i, 255 - i]).collect();
    let options = PlyOptions { normals: Some(&normals), colors: Some(&colors), precision: PlyPrecision::Double };
    write_ply_polygons(&path, &mesh, options).unwrap();
    let ply = read_mesh_file(&path).unwrap();
    assert_eq!((&ply.mesh, ply.normals.as_ref(), ply.colors.as_ref()), (&mesh, Some(&normals), Some(&colors)));

    let triangles = mesh.triangulate();
    write_ply(&path, &triangles, PlyOptions::default()).unwrap();
    let scan = read_scan(&path).unwrap();
    assert_eq!(scan.mesh.triangles, triangles.triangles);
    assert_eq!((scan.normals, scan.colors), (None, None));
    let worst = scan.mesh.positions.iter().zip(&triangles.positions).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(worst < 1e-6);

    let cloud = TriangleMesh { triangles: vec![], ..triangles };
    write_ply(&path, &cloud, PlyOptions { precision: PlyPrecision::Double, ..PlyOptions::default() }).unwrap();
    assert_eq!(read_scan(&path).unwrap().mesh, cloud);
    // a face of more corners than a byte counts
    let n = 300;
    let positions = (0..n).map(|i| Vec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.0)).collect();
    let wheel = PolygonMesh { positions, starts: vec![0, n], corners: (0..n).collect(), metadata: Default::default() };
    write_polygon_mesh(&path, &wheel).unwrap();
    assert_eq!(read_polygon_mesh(&path).unwrap(), wheel);
    assert!(write_ply(&path, &cloud, PlyOptions { colors: Some(&colors[..3]), ..PlyOptions::default() }).is_err());
    let mut broken = cloud.clone();
    broken.positions[2].y = f64::INFINITY;
    let refused = write_ply(&path, &broken, PlyOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("expected finite coordinates, found") && refused.ends_with("at vertex 2"), "{refused}");
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["mesh.ply"]);
}

fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let fortran = if fortran { "True" } else { "False" };
    npy_with(&format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n"), data)
}

#[test]
fn npy_types_orders_and_prefixes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let values = [1.0, -2.0, 3.0, 100.0, -5.0, 6.0];
    let little = |f: &dyn Fn(f64) -> Vec<u8>| values.iter().flat_map(|&v| f(v)).collect::<Vec<u8>>();
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("<f4", little(&|v| (v as f32).to_le_bytes().to_vec())),
        (">f4", little(&|v| (v as f32).to_be_bytes().to_vec())),
        ("<f8", little(&|v| v.to_le_bytes().to_vec())),
        (">f8", little(&|v| v.to_be_bytes().to_vec())),
        ("<i4", little(&|v| (v as i32).to_le_bytes().to_vec())),
        (">i8", little(&|v| (v as i64).to_be_bytes().to_vec())),
        ("|i1", little(&|v| vec![(v as i8) as u8])),
        ("<i2", little(&|v| (v as i16).to_le_bytes().to_vec())),
    ];
    for (descr, data) in cases {
        std::fs::write(&path, npy(descr, false, "(2, 3)", &data)).unwrap();
        assert_eq!(NpyArray::open(&path).unwrap().read_f64().unwrap(), values, "{descr}");
        let points = read_npy_points(&path).unwrap();
        assert_eq!(points, [Vec3::new(1.0, -2.0, 3.0), Vec3::new(100.0, -5.0, 6.0)]);
        let array = NpyArray::open(&path).unwrap();
        assert_eq!(array.shape(), [2, 3]);
        assert_eq!(array.read_f32_rows(1).unwrap(), [1.0, -2.0, 3.0]);
        std::fs::write(&path, npy(descr, true, "(3, 2)", &data)).unwrap();
        assert_eq!(NpyArray::open(&path).unwrap().read_f64().unwrap(), [1.0, 100.0, -2.0, -5.0, 3.0, 6.0]);
        assert_eq!(NpyArray::open(&path).unwrap().read_f32_rows(2).unwrap(), [1.0, 100.0, -2.0, -5.0]);
    }
    let message = read_npy_mask(&path, Some(6)).unwrap_err().to_string();
    assert!(message.contains("expected an array 6, found 3 x 2"), "{message}");

    write_npy(&path, &[2], &[true, false]).unwrap();
    assert_eq!(read_npy_mask(&path, Some(2)).unwrap(), [true, false]);
    write_npy(&path, &[2, 1, 2], &[0.1f32, 0.2, 0.3, 0.4]).unwrap();
    assert_eq!(NpyArray::open(&path).unwrap().read_f32_rows(usize::MAX).unwrap(), [0.1, 0.2, 0.3, 0.4]);
    assert_eq!(std::fs::metadata(&path).unwrap().len(), 128 + 16);
    write_npy_points(&path, &[Vec3::new(0.1, 0.2, 0.3)]).unwrap();
    assert_eq!(read_npy_points(&path).unwrap(), [Vec3::new(0.1, 0.2, 0.3)]);
    assert!(write_npy(&path, &[5], &[1.0]).is_err());
}

#[test]
fn npz_arrays_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    for (name, scale, method) in
        [("vertices", 1.0, zip::CompressionMethod::Stored), ("shapes", 2.0, zip::CompressionMethod::Deflated)]
    {
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        archive.start_file(format!("{name}.npy"), options).unwrap();
        let data: Vec<u8> = (0..6).flat_map(|i| (scale * f64::from(i)).to_le_bytes()).collect();
        std::io::Write::write_all(&mut archive, &npy("<f8", false, "(2, 3)", &data)).unwrap();
    }
    archive.finish().unwrap();
    let mut npz = Npz::open(&path).unwrap();
    assert_eq!(npz.names(), ["shapes", "vertices"]);
    assert_eq!(npz.points("vertices").unwrap()[1], Vec3::new(3.0, 4.0, 5.0));
    assert_eq!(npz.array("shapes").unwrap().read_f64().unwrap()[5], 10.0);
    let message = npz.array("eyes").unwrap_err().to_string();
    assert!(message.contains("a.npz") && message.contains("shapes, vertices"), "{message}");

    for shape in ["(0, 99999999999, 99999999999)", "(99999999999, 0, 99999999999)"] {
        std::fs::write(&path, npy("<f4", true, shape, &[])).unwrap();
        assert!(NpyArray::open(&path).unwrap().read_f32_rows(usize::MAX).unwrap().is_empty());
    }
}

#[test]
fn landmarks_in_every_form() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let template = template();
    let scan = template.triangulate();
    let (a, b) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.5));
    let vertex = TemplatePoint::Vertex;

    // vertex indices, in the order of the file
    let indices = file("indices.json", r#"{"4": [1, 2, 3], "0": [4, 5, 6.5]}"#);
    let found = read_landmarks(&indices, None, &template, None).unwrap();
    assert_eq!(found.iter().map(|l| l.template).collect::<Vec<_>>(), [vertex(4), vertex(0)]);
    assert_eq!((found[0].target, found[1].target), (a, b));

    // names through a template file: vertex, triangle (the fan of quad 0 is triangles 0 and 1), nearest vertex
    let targets = file("targets.json", r#"{"00": [1, 2, 3], "tip": [4, 5, 6.5]}"#);
    let names = file("names.json", r#"{"tip": [1, 0.25, 0.5], "00": 6, "unused": 0}"#);
    let found = read_landmarks(&targets, Some(&names), &template, None).unwrap();
    assert_eq!((found[0].name.as_str(), found[0].template), ("00", vertex(6)));
    assert_eq!(found[1].template, TemplatePoint::Face { corners: [0, 4, 3], weights: [0.25, 0.5, 0.25] });
    let at = found[1].template.position(&template.positions);
    assert!((at - (template.positions[4] * 0.5 + template.positions[3] * 0.25)).norm() < 1e-15);
    let snapped = file("snapped.json", r#"{"tip": [1.9, 0.8, 0.1], "00": 6}"#);
    assert_eq!(read_landmarks(&targets, Some(&snapped), &template, None).unwrap()[1].template, vertex(5));

    // lists
    let list = file("list.json", "[3, 1]");
    for text in ["[[1, 2, 3], [4, 5, 6.5]]", r#"{"order": "mine", "points_mm": [[1, 2, 3], [4, 5, 6.5]]}"#] {
        let found = read_landmarks(&file("points.json", text), Some(&list), &template, None).unwrap();
        assert_eq!((found[0].template, found[1].template), (vertex(3), vertex(1)));
        assert_eq!((found[0].target, found[1].target), (a, b));
    }

    // on the scan's triangles
    let wrap = file("wrap.json", r#"{"0": [0, 0.5, 0.25], "1": [2, 1, 0]}"#);
    let found = read_landmarks(&wrap, Some(&list), &template, Some(&scan)).unwrap();
    let p = &template.positions;
    assert!((found[0].target - (p[0] * 0.5 + p[1] * 0.25 + p[4] * 0.25)).norm() < 1e-15);
    assert_eq!(found[1].target, p[1]);
}
