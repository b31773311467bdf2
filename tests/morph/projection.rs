//! Projected masks and the paper's morph: hand-computed points, invariances, brute-force visibility, bad input.

use std::f64::consts::PI;

use crate::threads::on_threads;
use nalgebra::{Matrix4, Rotation3};
use nonrigid::mesh::{MeshError, MirrorPlane, ObjMetadata, PolygonMesh, TriangleMesh, Vec3};
use nonrigid::morph::*;
use nonrigid::render::{Camera, Projection};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PERSPECTIVE: Projection = Projection::Perspective { vertical_fov: 30.0 };
const VISIBLE: Visibility = Visibility::Visible { tolerance: 0.001 };

/// A head: an ellipsoid of `rows` circles of 2 `half` vertices and two poles, which is its own mirror image in x to the bit.
fn head(rows: usize, half: usize) -> TriangleMesh {
    let columns = 2 * half;
    let mut positions = vec![Vec3::new(0.0, -110.0, 0.0)];
    for row in 1..=rows {
        let polar = PI * row as f64 / (rows + 1) as f64;
        for column in 0..columns {
            // From the front, (0, 0, +z), to the back along +x and back along -x.
            let (k, side) = if column <= half { (column, 1.0) } else { (columns - column, -1.0) };
            let (s, c) = if k == half { (0.0, -1.0) } else { (PI * k as f64 / half as f64).sin_cos() };
            positions.push(Vec3::new(75.0 * s * side * polar.sin(), -110.0 * polar.cos(), 90.0 * c * polar.sin()));
        }
    }
    positions.push(Vec3::new(0.0, 110.0, 0.0));
    let at = |row: usize, column: usize| (1 + row * columns + column % columns) as u32;
    let top = positions.len() as u32 - 1;
    let mut triangles = Vec::new();
    for column in 0..columns {
        triangles.push([0, at(0, column + 1), at(0, column)]);
        triangles.push([top, at(rows - 1, column), at(rows - 1, column + 1)]);
        for row in 0..rows - 1 {
            let (a, b, c, d) = (at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column));
            triangles.extend(if column < half { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
        }
    }
    TriangleMesh { positions, triangles }
}

/// The vertex at the mirror image of each vertex.
fn twins(mesh: &TriangleMesh) -> Vec<usize> {
    let key = |p: &Vec3, sign: f64| [p.x * sign + 0.0, p.y, p.z].map(f64::to_bits);
    let places: std::collections::HashMap<_, _> =
        mesh.positions.iter().enumerate().map(|(i, p)| (key(p, 1.0), i)).collect();
    mesh.positions.iter().map(|p| places[&key(p, -1.0)]).collect()
}

fn soft_circle(size: usize, x: f64, y: f64, radius: f64) -> Texture {
    let drawn = Region::from(Shape::Circle { centre: [x, y], radius }).rasterize(size, size, Coordinates::Pixels);
    Blur { kernel: 5, iterations: 3, ..Blur::default() }.apply(&drawn.unwrap()).unwrap()
}

fn front() -> Projector {
    Projector::look(Vec3::new(0.0, 0.0, 700.0), Vec3::zeros(), Vec3::y(), PERSPECTIVE, 1.0).unwrap()
}

#[test]
fn the_perspective_divide_is_done() {
    // Depth 5, tangent of half the angle 1, aspect 2: ndc = (3 / (5 * 2), 2 / 5).
    let right_angle = Projection::Perspective { vertical_fov: 90.0 };
    let projector = Projector::look(Vec3::new(0., 0., 10.), Vec3::zeros(), Vec3::y(), right_angle, 2.0).unwrap();
    let [u, v] = projector.uv(Vec3::new(3.0, 2.0, 5.0)).unwrap();
    assert!((u - 0.65).abs() < 1e-15 && (v - 0.7).abs() < 1e-15, "{u} {v}");
    assert_eq!(projector.uv(Vec3::new(0.0, 0.0, 10.0)), None);
    assert_eq!(projector.uv(Vec3::new(0.0, 0.0, 11.0)), None);
    let parallel = Projection::Orthographic { height: 20.0 };
    let projector = Projector::look(Vec3::new(0., 0., 10.), Vec3::zeros(), Vec3::y(), parallel, 2.0).unwrap();
    let [u, v] = projector.uv(Vec3::new(3.0, 2.0, 5.0)).unwrap();
    assert!((u - 0.575).abs() < 1e-15 && (v - 0.6).abs() < 1e-15, "{u} {v}");
}

#[test]
fn masks_lie_where_the_renderer_draws() {
    let (eye, target, up, size) =
        (Vec3::new(200., 90., 300.), Vec3::new(10., -5., 3.), Vec3::new(0.1, 1.0, 0.2), [640, 480]);
    for projection in [PERSPECTIVE, Projection::Orthographic { height: 170.0 }] {
        let camera = Camera::look(eye, target, up, projection).unwrap();
        let projector = Projector::look(eye, target, up, projection, 640.0 / 480.0).unwrap();
        for p in [Vec3::zeros(), Vec3::new(50., 20., -30.), Vec3::new(-40., 60., 80.)] {
            let [x, y, _] = camera.project(p, size).unwrap();
            let [u, v] = projector.uv(p).unwrap();
            assert!((u * 640.0 - x).abs() < 1e-10 && ((1.0 - v) * 480.0 - y).abs() < 1e-10);
        }
    }
}

#[test]
fn the_matrices_of_equation_1_are_multiplied_in_its_order() {
    let model = Matrix4::new_translation(&Vec3::new(0.0, 1.0, 0.0));
    let view = Matrix4::new_translation(&Vec3::new(0.0, 0.0, -10.0));
    let clip = Matrix4::new_perspective(2.0, PI / 2.0, 0.1, 1000.0);
    let projector = Projector::new(&model, &view, &clip).unwrap();
    let [u, v] = projector.uv(Vec3::new(3.0, 1.0, 5.0)).unwrap();
    assert!((u - 0.65).abs() < 1e-14 && (v - 0.7).abs() < 1e-14);
    let singular = Matrix4::new_nonuniform_scaling(&Vec3::new(1.0, 0.0, 1.0));
    assert!(matches!(Projector::new(&singular, &view, &clip), Err(MorphError::Matrix(_))));
    assert!(matches!(Projector::new(&model, &(view * f64::NAN), &clip), Err(MorphError::Matrix(_))));
}

#[test]
fn low_points_read_the_bottom_row() {
    let texture = Texture::new(1, 2, vec![0.25, 0.75]).unwrap();
    let positions = vec![Vec3::new(0.0, -100.0, 0.0), Vec3::new(0.0, 100.0, 0.0)];
    let weights = front().weights(&TriangleMesh { positions, triangles: vec![] }, &texture, Sampling::Nearest, VISIBLE);
    assert_eq!(weights.unwrap().values(), [0.75, 0.25]);
}

#[test]
fn turning_head_and_camera_together_changes_nothing() {
    let (mesh, texture) = (head(60, 40), soft_circle(256, 150.0, 120.0, 60.0));
    let (turn, shift) = (Rotation3::new(Vec3::new(0.4, -1.1, 0.7)), Vec3::new(30.0, -70.0, 11.0));
    let turned = TriangleMesh { positions: mesh.positions.iter().map(|p| turn * p + shift).collect(), ..mesh.clone() };
    let eye = Vec3::new(80.0, 50.0, 700.0);
    for projection in [PERSPECTIVE, Projection::Orthographic { height: 300.0 }] {
        let fixed = Projector::look(eye, Vec3::zeros(), Vec3::y(), projection, 1.0).unwrap();
        let moved = Projector::look(turn * eye + shift, shift, turn * Vec3::y(), projection, 1.0).unwrap();
        for visibility in [Visibility::Through, VISIBLE] {
            let a = fixed.weights(&mesh, &texture, Sampling::Bilinear, visibility).unwrap();
            let b = moved.weights(&turned, &texture, Sampling::Bilinear, visibility).unwrap();
            assert!(a.values().iter().filter(|w| **w > 0.5).count() > 200);
            for (a, b) in a.values().iter().zip(b.values()) {
                assert!((0.0..=1.0).contains(a) && (a - b).abs() < 1e-12, "{a} {b}");
            }
        }
    }
}

#[test]
fn the_back_of_the_head_moves_only_when_the_mask_goes_through() {
    // The size of a real template.
    let mesh = head(130, 103);
    assert!(mesh.positions.len() > 26_000);
    let texture = soft_circle(1024, 512.0, 512.0, 150.0);
    let weights = |visibility| front().weights(&mesh, &texture, Sampling::Bilinear, visibility).unwrap();
    let (seen, all) = (weights(VISIBLE), weights(Visibility::Through));
    let step = |weights: &Weights| {
        let pairs = vec![MaskedDisplacement { weights: weights.clone(), displacement: Vec3::new(0.0, 1.0, 4.0) }];
        MorphStep { pairs, ..MorphStep::default() }.apply(&mesh.positions).unwrap()
    };
    let (seen_moved, all_moved) = (step(&seen), step(&all));
    let moved = |positions: &[Vec3], side: f64| {
        positions.iter().zip(&mesh.positions).filter(|(a, b)| a != b && b.z * side > 0.0).count()
    };
    assert_eq!(moved(&seen_moved, -1.0), 0);
    assert!(moved(&all_moved, -1.0) > 1000);
    assert_eq!(moved(&seen_moved, 1.0), moved(&all_moved, 1.0), "the whole front under the mask is seen");
    // Front or back decides on a convex head: the plane at each vertex has the eye before or behind it.
    let visible = front().visible(&mesh, 0.001).unwrap();
    for (p, visible) in mesh.positions.iter().zip(visible) {
        let normal = Vec3::new(p.x / 75.0f64.powi(2), p.y / 110.0f64.powi(2), p.z / 90.0f64.powi(2));
        let facing = normal.normalize().dot(&(Vec3::new(0.0, 0.0, 700.0) - p).normalize());
        assert!(facing.abs() < 0.03 || visible == (facing > 0.0), "{p:?}");
    }
}

/// Is the segment from `p` to `eye` (or, without one, the ray along +z) cut by the triangle more than `margin` from its ends and edges?
/// `None` when it is too close to tell.
fn cuts(p: Vec3, to: Vec3, triangle: [Vec3; 3]) -> Option<bool> {
    let [a, b, c] = triangle;
    let (e, f) = (b - a, c - a);
    let h = to.cross(&f);
    let determinant = e.dot(&h);
    let s = p - a;
    let q = s.cross(&e);
    let (u, v, t) = (s.dot(&h) / determinant, to.dot(&q) / determinant, f.dot(&q) / determinant);
    let inside = u.min(v).min(1.0 - u - v).min(t);
    if inside.abs() < 1e-7 || (t < 1e-4 && t > -1e-4 && inside > -1e-4) { None } else { Some(inside > 0.0 && t < 1.0) }
}

#[test]
fn visibility_is_that_of_rays() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut any = |size: f64| Vec3::from_fn(|_, _| rng.random_range(-size..size));
    // A soup of triangles round the camera too, so that some reach behind it, and points.
    let mut mesh = TriangleMesh::default();
    for i in 0..150u32 {
        let (centre, size) = (any(60.0), if i < 20 { 80.0 } else { 12.0 });
        mesh.positions.extend([centre + any(size), centre + any(size), centre + any(size)]);
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    mesh.positions.extend((0..800).map(|_| any(90.0)));
    let eye = Vec3::new(5.0, 8.0, 70.0);
    let (mut hidden, mut open) = (0, 0);
    for perspective in [true, false] {
        let projection = if perspective { PERSPECTIVE } else { Projection::Orthographic { height: 100.0 } };
        let target = Vec3::new(3.0, 1.0, -4.0);
        let projector = Projector::look(eye, target, Vec3::y(), projection, 1.3).unwrap();
        let visible = projector.visible(&mesh, 0.0).unwrap();
        for (vertex, p) in mesh.positions.iter().enumerate() {
            if projector.uv(*p).is_none() {
                assert!(!visible[vertex]);
                continue;
            }
            let to = if perspective { eye - p } else { (eye - target).normalize() * 1e4 };
            let others = mesh.triangles.iter().filter(|t| !t.contains(&(vertex as u32)));
            let answers: Vec<Option<bool>> =
                others.map(|t| cuts(*p, to, t.map(|v| mesh.positions[v as usize]))).collect();
            if answers.contains(&None) && !answers.contains(&Some(true)) {
                continue;
            }
            let blocked = answers.contains(&Some(true));
            assert_eq!(visible[vertex], !blocked, "vertex {vertex}, perspective {perspective}");
            if blocked { hidden += 1 } else { open += 1 }
        }
    }
    assert!(hidden > 300 && open > 300, "{hidden} {open}");
}

#[test]
fn crowded_vertices_are_told_apart() {
    // A fine sheet of a hundredth of the picture's width before another, in a coarse mesh: all in a few cells of any even grid.
    let sheet = |step: f64, z: f64| {
        (0..2500).map(move |i| Vec3::new(f64::from(i % 50), f64::from(i / 50), 0.0) * step + Vec3::z() * z)
    };
    let cells = (0..2401u32).map(|c| c / 49 * 50 + c % 49);
    let faces = |first: u32| {
        cells.clone().flat_map(move |a| [[a, a + 1, a + 51], [a, a + 51, a + 50]].map(|t| t.map(|v| v + first)))
    };
    let mesh = TriangleMesh {
        positions: sheet(0.02, 0.0)
            .chain(sheet(0.019, -2.0))
            .chain([Vec3::repeat(-90.0), Vec3::new(90.0, 90.0, -90.0)])
            .collect(),
        triangles: faces(0).chain(faces(2500)).collect(),
    };
    let parallel = Projection::Orthographic { height: 250.0 };
    let projector = Projector::look(Vec3::z() * 50.0, Vec3::zeros(), Vec3::y(), parallel, 1.0).unwrap();
    let visible = projector.visible(&mesh, 0.001).unwrap();
    assert_eq!(visible, (0..5002).map(|i| !(2500..5000).contains(&i)).collect::<Vec<_>>());
}

#[test]
fn two_sheets_on_one_grid_leave_no_gap() {
    // Each vertex of the back sheet lies exactly behind one of the front sheet, on its edges and corners.
    let sheet = |z: f64| (0..81).map(move |i| Vec3::new(f64::from(i % 9), f64::from(i / 9), z));
    let cells = (0..64u32).map(|c| c / 8 * 9 + c % 8);
    let mesh = TriangleMesh {
        positions: sheet(0.0).chain(sheet(-5.0)).collect(),
        triangles: cells.flat_map(|a| [[a, a + 1, a + 10], [a, a + 10, a + 9]]).collect(),
    };
    let parallel = Projection::Orthographic { height: 20.0 };
    let projector = Projector::look(Vec3::new(4., 4., 50.), Vec3::new(4., 4., 0.), Vec3::y(), parallel, 1.0).unwrap();
    let visible = projector.visible(&mesh, 0.001).unwrap();
    assert_eq!(visible, (0..162).map(|i| i < 81).collect::<Vec<_>>());
    assert_eq!(projector.visible(&mesh, 5.5).unwrap(), vec![true; 162], "within the tolerance");
}

#[test]
fn masks_in_texture_coordinates() {
    let texture = Texture::new(2, 1, vec![0.25, 0.75]).unwrap();
    let mut mesh = PolygonMesh {
        positions: vec![Vec3::zeros(); 6],
        starts: vec![0, 3, 6],
        corners: vec![0, 1, 2, 0, 2, 3],
        metadata: ObjMetadata {
            uvs: vec![[0.1, 0.5], [0.9, 0.5], [1.5, 0.5]],
            corner_uvs: vec![0, 1, 2, 1, u32::MAX, 0],
            ..ObjMetadata::default()
        },
    };
    let weights = |mesh: &PolygonMesh| uv_weights(mesh, &texture, Sampling::Nearest);
    assert_eq!(weights(&mesh).unwrap().values(), [0.75, 0.75, 0.0, 0.25, 0.0, 0.0]);
    mesh.metadata.corner_uvs[4] = 3;
    assert_eq!(weights(&mesh), Err(MorphError::TextureCoordinate { corner: 4, index: 3, count: 3 }));
    mesh.metadata.corner_uvs.clear();
    assert_eq!(weights(&mesh), Err(MorphError::NoTextureCoordinates));
}

fn landmarks() -> Vec<(String, Vec3)> {
    [("0", [-30., 40., 60.]), ("1", [30., 40., 60.]), ("nose", [0., 0., 95.]), ("chin", [0., -80., 70.])]
        .map(|(name, p)| (name.to_owned(), Vec3::from(p)))
        .to_vec()
}

fn spec() -> FrameSpec {
    let pair = |a: &str, b: &str| [a.to_owned(), b.to_owned()];
    FrameSpec { origin: vec!["0".into(), "1".into()], right: pair("0", "1"), up: pair("chin", "nose"), scale: None }
}

#[test]
fn masks_in_landmark_coordinates_follow_the_face() {
    let mesh = head(60, 40);
    let (low, high) = ([-50.0, -40.0], [50.0, 60.0]);
    let drawn = Region::from(Shape::Circle { centre: [20.0, -10.0], radius: 25.0 });
    let texture = drawn.rasterize(200, 200, Coordinates::Box { low, high }).unwrap();
    let scaled =
        FrameSpec { scale: Some(FrameScale { between: ["0".into(), "1".into()], millimetres: 60.0 }), ..spec() };
    let weights = |spec: &FrameSpec, mesh: &TriangleMesh, landmarks: &[(String, Vec3)]| {
        let frame = LandmarkFrame::new(spec, landmarks).unwrap();
        frame.projector(low, high).unwrap().weights(mesh, &texture, Sampling::Bilinear, VISIBLE).unwrap()
    };
    let rest = weights(&spec(), &mesh, &landmarks());
    let frame = LandmarkFrame::new(&spec(), &landmarks()).unwrap();
    assert!((frame.point([1.0, 0.0, 0.0]) - Vec3::new(1.0, 40.0, 60.0)).norm() < 1e-12);
    for (p, w) in mesh.positions.iter().zip(rest.values()) {
        let d = p - frame.origin();
        let distance = (d.dot(&frame.axes()[0]) - 20.0).hypot(d.dot(&frame.axes()[1]) + 10.0);
        assert!(
            d.dot(&frame.axes()[2]) < 0.0
                || (distance - 25.0).abs() < 1.0
                || *w == f64::from(u8::from(distance < 25.0))
        );
    }
    assert!(rest.values().iter().filter(|w| **w == 1.0).count() > 50);
    // Another pose, and with the scale set by two landmarks another size.
    let turn = Rotation3::new(Vec3::new(-0.8, 0.3, 2.0));
    let place = |p: &Vec3| turn * p * 1.4 + Vec3::new(5.0, -6.0, 7.0);
    let moved = TriangleMesh { positions: mesh.positions.iter().map(place).collect(), ..mesh.clone() };
    let moved_landmarks: Vec<_> = landmarks().iter().map(|(n, p)| (n.clone(), place(p))).collect();
    let same = weights(&scaled, &moved, &moved_landmarks);
    for (a, b) in rest.values().iter().zip(same.values()) {
        assert!((a - b).abs() < 1e-11);
    }
    let frame = LandmarkFrame::new(&scaled, &moved_landmarks).unwrap();
    let up = turn * LandmarkFrame::new(&spec(), &landmarks()).unwrap().vector([0.0, 2.0, 0.0]) * 1.4;
    assert!((frame.vector([0.0, 2.0, 0.0]) - up).norm() < 1e-12);
}

#[test]
fn wrong_frames_are_named() {
    let frame = |spec: &FrameSpec| LandmarkFrame::new(spec, &landmarks()).unwrap_err().to_string();
    let missing = frame(&FrameSpec { origin: vec!["noose".into()], ..spec() });
    assert!(missing.contains("noose") && missing.contains("0, 1, nose, chin"), "{missing}");
    assert!(frame(&FrameSpec { origin: vec![], ..spec() }).contains("origin"));
    assert!(frame(&FrameSpec { right: ["0".into(), "0".into()], ..spec() }).contains("coincide"));
    assert!(frame(&FrameSpec { up: spec().right, ..spec() }).contains("along x"));
    let scale = |a: &str, millimetres| Some(FrameScale { between: [a.into(), "1".into()], millimetres });
    assert!(frame(&FrameSpec { scale: scale("1", 60.0), ..spec() }).contains("coincide"));
    assert!(frame(&FrameSpec { scale: scale("0", 0.0), ..spec() }).contains("millimetres"));
    let right = LandmarkFrame::new(&spec(), &landmarks()).unwrap();
    assert!(matches!(right.projector([0.0, 0.0], [1.0, f64::NAN]), Err(MorphError::Covered { .. })));
    let scaled = LandmarkFrame::new(&FrameSpec { scale: scale("0", 7.0), ..spec() }, &landmarks()).unwrap();
    let message = scaled.projector([2.0, 0.0], [1.0, 3.0]).unwrap_err().to_string();
    assert!(message.contains("[2.0, 0.0] to [1.0, 3.0]"), "as it was asked for: {message}");
    assert!(MirrorPlane::new(Vec3::zeros(), Vec3::zeros()).is_none());
}

#[test]
fn mirrored_pairs_are_mirror_images() {
    let mesh = head(60, 40);
    let twins = twins(&mesh);
    let plane = LandmarkFrame::new(&spec(), &landmarks()).unwrap().mirror_plane();
    let texture = soft_circle(512, 190.0, 200.0, 70.0);
    let displacement = Vec3::new(3.0, -2.0, 5.0);
    let step = |pairs| MorphStep { pairs, ..MorphStep::default() }.apply(&mesh.positions).unwrap();
    for visibility in [Visibility::Through, VISIBLE] {
        let eye = Projector::look(Vec3::new(150., 60., 700.), Vec3::zeros(), Vec3::y(), PERSPECTIVE, 1.0).unwrap();
        let weights = |p: &Projector| p.weights(&mesh, &texture, Sampling::Bilinear, visibility).unwrap();
        let pair = MaskedDisplacement { weights: weights(&eye), displacement };
        let painted = pair.mirrored(&mesh, &plane).unwrap();
        let projected = MaskedDisplacement {
            weights: weights(&eye.mirrored(&plane)),
            displacement: plane.reflect_direction(displacement),
        };
        assert_eq!(painted.displacement, Vec3::new(-3.0, -2.0, 5.0));
        let one = step(vec![pair.clone()]);
        for other in [painted, projected] {
            let two = step(vec![other.clone()]);
            let both = step(vec![pair.clone(), other]);
            let mut unlike = 0;
            for (v, &twin) in twins.iter().enumerate() {
                assert!((plane.reflect(one[v]) - two[twin]).norm() < 1e-11, "vertex {v}");
                assert!((plane.reflect(both[v]) - both[twin]).norm() < 1e-11, "vertex {v}");
                unlike += usize::from((one[v] - two[v]).norm() > 0.1);
            }
            assert!(unlike > 100, "a mask off the middle");
        }
    }
}

#[test]
fn vertices_move_by_weight_above_the_threshold() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let positions: Vec<Vec3> = (0..5000).map(|_| Vec3::from_fn(|_, _| rng.random_range(-90.0..90.0))).collect();
    let mut grey: Vec<f64> = (0..5000).map(|_| rng.random_range(0.0..0.02)).collect();
    (grey[0], grey[1], grey[4999]) = (1.0 / 255.0, 1.0, 0.5);
    let weights = Weights::new(grey.clone()).unwrap();
    let d = Vec3::new(1.0, -2.0, 0.5);
    let pair = |displacement| MaskedDisplacement { weights: weights.clone(), displacement };
    let step = |pairs| MorphStep { pairs, ..MorphStep::default() };
    let moved = step(vec![pair(d)]).apply(&positions).unwrap();
    let moves = step(vec![pair(d)]).moves(5000).unwrap();
    for i in 0..5000 {
        assert_eq!(moves[i], grey[i] > 1.0 / 255.0);
        let expected = if moves[i] { positions[i] + d * grey[i] } else { positions[i] };
        assert_eq!(moved[i].as_slice(), expected.as_slice());
    }
    assert!(moves.iter().filter(|m| **m).count() > 3000 && !moves[0]);
    let bits = |p: &[Vec3]| p.iter().flat_map(|p| [p.x, p.y, p.z].map(f64::to_bits)).collect::<Vec<_>>();
    let mut zeros = positions.clone();
    zeros[1] = Vec3::new(-0.0, 0.0, -0.0);
    assert_eq!(bits(&step(vec![pair(Vec3::zeros())]).apply(&zeros).unwrap()), bits(&zeros));
    assert_eq!(bits(&step(vec![]).apply(&zeros).unwrap()), bits(&zeros));
    // Pairs add up on the positions before the step.
    let twice = step(vec![pair(d), pair(Vec3::new(0.0, 9.0, 0.0))]).apply(&positions).unwrap();
    assert!((twice[1] - positions[1] - Vec3::new(1.0, 7.0, 0.5)).norm() < 1e-13);
    let all = MorphStep { pairs: vec![pair(d)], threshold: 0.0 }.apply(&positions).unwrap();
    assert!(all.iter().zip(&positions).zip(&grey).all(|((a, b), g)| (a - b - d * *g).norm() < 1e-13));
}

#[test]
fn wrong_steps_and_projections_are_named() {
    let positions = vec![Vec3::zeros(); 3];
    let weights = Weights::new(vec![0.0, 0.5, 1.0]).unwrap();
    let pair = |displacement| MaskedDisplacement { weights: weights.clone(), displacement };
    let step = MorphStep { pairs: vec![pair(Vec3::x())], ..MorphStep::default() };
    assert_eq!(step.apply(&positions[..2]), Err(MorphError::WeightCount { found: 3, vertices: 2 }));
    assert_eq!(step.moves(4), Err(MorphError::WeightCount { found: 3, vertices: 4 }));
    let short = step.apply_into(&positions, &mut [Vec3::zeros(); 2]);
    assert_eq!(short, Err(MorphError::BufferLength { found: 2, vertices: 3 }));
    for threshold in [f64::NAN, -0.1, 1.5] {
        assert!(matches!(MorphStep { threshold, ..step.clone() }.apply(&positions), Err(MorphError::Option { .. })));
    }
    let wild = MorphStep { pairs: vec![pair(Vec3::x()), pair(Vec3::new(0.0, f64::NAN, 0.0))], ..MorphStep::default() };
    assert!(matches!(wild.apply(&positions), Err(MorphError::Displacement { index: 1, .. })));
    let nan = [Vec3::zeros(), Vec3::new(0.0, f64::NAN, 0.0), Vec3::zeros()];
    assert!(matches!(step.apply(&nan), Err(MorphError::Mesh(MeshError::NotFinite { vertex: 1, .. }))));
    for value in [f64::NAN, -1e-9, 1.1] {
        assert!(matches!(Weights::new(vec![0.0, value]), Err(MorphError::WeightValue { vertex: 1, .. })));
    }
    let mesh = |positions: &[Vec3], triangles| TriangleMesh { positions: positions.to_vec(), triangles };
    let plane = MirrorPlane::new(Vec3::zeros(), Vec3::x()).unwrap();
    assert_eq!(weights.mirrored(&mesh(&positions, vec![]), &plane), Err(MorphError::NoSurface));

    let texture = Texture::new(1, 1, vec![1.0]).unwrap();
    let project = |mesh: &TriangleMesh, visibility| front().weights(mesh, &texture, Sampling::Bilinear, visibility);
    let error = project(&mesh(&nan, vec![]), Visibility::Through).unwrap_err();
    assert!(matches!(error, MorphError::Mesh(MeshError::NotFinite { vertex: 1, .. })));
    let error = project(&mesh(&positions, vec![[0, 1, 2], [0, 1, 3]]), VISIBLE).unwrap_err();
    assert_eq!(error, MeshError::IndexOutOfRange { triangle: 1, index: 3, count: 3 }.into());
    for tolerance in [-1.0, f64::NAN] {
        assert!(project(&mesh(&positions, vec![]), Visibility::Visible { tolerance }).is_err());
        assert!(front().visible(&mesh(&positions, vec![]), tolerance).is_err());
    }
    let look = |eye, up, projection, aspect| Projector::look(eye, Vec3::zeros(), up, projection, aspect);
    assert!(look(Vec3::zeros(), Vec3::y(), PERSPECTIVE, 1.0).is_err());
    assert!(look(Vec3::y(), Vec3::y(), PERSPECTIVE, 1.0).is_err());
    assert!(look(Vec3::z(), Vec3::zeros(), PERSPECTIVE, 1.0).is_err());
    assert!(look(Vec3::z(), Vec3::y(), PERSPECTIVE, 0.0).is_err());
    assert!(look(Vec3::z() * f64::NAN, Vec3::y(), PERSPECTIVE, 1.0).is_err());
    assert!(look(Vec3::z(), Vec3::y(), Projection::Perspective { vertical_fov: 180.0 }, 1.0).is_err());
    assert!(look(Vec3::z(), Vec3::y(), Projection::Orthographic { height: 0.0 }, 1.0).is_err());
    // No vertices and no triangles are no error.
    assert!(project(&TriangleMesh::default(), VISIBLE).unwrap().values().is_empty());
}

#[test]
fn weights_survive_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.npy");
    let weights = Weights::new(vec![0.0, 0.1, 1.0]).unwrap();
    weights.write_npy(&path).unwrap();
    assert_eq!(Weights::read_npy(&path, 3).unwrap(), weights);
    assert!(Weights::read_npy(&path, 4).is_err());
    nonrigid::io::write_npy(&path, &[2], &[0.5, f64::NAN]).unwrap();
    let message = Weights::read_npy(&path, 2).unwrap_err().to_string();
    assert!(message.contains("weights.npy") && message.contains("vertex 1") && message.contains("NaN"), "{message}");
}

#[test]
fn weights_have_the_same_bits_at_any_number_of_threads() {
    let (mesh, texture) = (head(130, 100), soft_circle(256, 150.0, 120.0, 60.0));
    let plane = MirrorPlane::new(Vec3::zeros(), Vec3::x()).unwrap();
    let work = || {
        let weights = front().weights(&mesh, &texture, Sampling::Bilinear, VISIBLE).unwrap();
        let pair = MaskedDisplacement { weights, displacement: Vec3::new(1.0, 0.3, 2.0) };
        let pairs = vec![pair.mirrored(&mesh, &plane).unwrap(), pair];
        MorphStep { pairs, ..MorphStep::default() }.apply(&mesh.positions).unwrap()
    };
    let [one, two, four] = [1, 2, 4].map(|threads| on_threads(threads, work));
    assert!(one == two && one == four);
}
