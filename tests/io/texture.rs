//! Textures of scans, baked into the template's texture coordinates.

use std::io::Cursor;
use std::path::Path;

use crate::sheets::sheet;
use crate::support::{Bench, Run, glb_parts};
use crate::threads::on_threads;
use image::{DynamicImage, ImageBuffer, ImageFormat, Rgb};
use nonrigid::io::{
    Material, MaterialFiles, Paint, PlyOptions, Wrap, files_of_painted_mesh, read_painted_scan, read_polygon_mesh,
    write_obj, write_ply, write_polygon_mesh,
};
use nonrigid::mesh::srgb::{from_light, to_light};
use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, TriangleMesh, Vec3};
use nonrigid::registration::ScanFacing;
use nonrigid::texture::{BakeError, BakeInput, BakeOptions, Baked, Painter, bake};

/// From the front: where on the image a point of the subject lies, 240 mm being its side, and back.
const SIDE: f64 = 240.0;

fn place(p: &Vec3) -> [f64; 2] {
    [p.x / SIDE + 0.5, p.y / SIDE + 0.5]
}

/// Light as a function of the place: red tells x, green tells y, blue is a pattern of 12 mm.
fn light([u, v]: [f64; 2]) -> Vec3 {
    let wave = |x: f64| (x * SIDE * std::f64::consts::TAU / 12.0).sin();
    Vec3::new(0.1 + 0.8 * u, 0.1 + 0.8 * v, 0.5 + 0.3 * wave(u) * wave(v))
}

/// The image of [`light`], of 16 bits.
fn image(side: u32) -> ImageBuffer<Rgb<u16>, Vec<u16>> {
    let encoded = |c: f64| {
        let c = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (c * 65535.0).round() as u16
    };
    ImageBuffer::from_fn(side, side, |x, y| {
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(side);
        Rgb(<[f64; 3]>::from(light([at(x), 1.0 - at(y)])).map(encoded))
    })
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn png(image: &ImageBuffer<Rgb<u16>, Vec<u16>>) -> Vec<u8> {
    encoded(&DynamicImage::from(image.clone()), ImageFormat::Png)
}

/// Writes `scan.obj`, `scan.mtl` and `skin.png`, the scan of the bench with a texture that is [`light`] in the subject's frame.
fn write_textured_scan(bench: &Bench, pixels: u32) {
    let back = |p: &Vec3| bench.case.pose.apply_inverse(*p);
    let scan = &bench.case.scan;
    let mut mesh = PolygonMesh::from(scan.clone());
    mesh.metadata = ObjMetadata {
        uvs: scan.positions.iter().map(|p| place(&back(p))).collect(),
        corner_uvs: mesh.corners.clone(),
        material_libraries: vec!["scan.mtl".into()],
        statements: vec![(0, ObjStatement::Material("my skin".into()))],
        ..ObjMetadata::default()
    };
    write_obj(&bench.path("scan.obj"), &mesh).unwrap();
    bench.write("scan.mtl", "newmtl my skin\nKd 0 0 0\nmap_Kd skin.png\n");
    bench.write("skin.png", png(&image(pixels)));
}

/// What a texture says at texture coordinates, linear between texels.
fn sampled<const N: usize>(baked: &[[f32; N]], side: usize, uv: [f64; 2]) -> [f64; N] {
    let [x, y] = [uv[0], 1.0 - uv[1]].map(|c| (c * side as f64 - 0.5).clamp(0.0, side as f64 - 1.0));
    let (column, row) = (x as usize, y as usize);
    let mut sum = [0.0; N];
    for (row, t) in [(row, 1.0 - y.fract()), ((row + 1).min(side - 1), y.fract())] {
        for (column, s) in [(column, 1.0 - x.fract()), ((column + 1).min(side - 1), x.fract())] {
            (0..N).for_each(|k| sum[k] += s * t * f64::from(baked[row * side + column][k]));
        }
    }
    sum
}

/// The middle of every triangle: its texture coordinates, its position by each list, and whether its texel is seen.
fn middles<'a>(mesh: &'a PolygonMesh, positions: &'a [Vec3]) -> impl Iterator<Item = ([f64; 2], Vec3)> + 'a {
    let fan = |f: usize| {
        let (first, end) = (mesh.starts[f] as usize, mesh.starts[f + 1] as usize);
        (first + 1..end - 1).map(move |c| [first, c, c + 1])
    };
    (0..mesh.polygon_count()).flat_map(fan).map(|corners| {
        let uvs = corners.map(|c| mesh.metadata.uvs[mesh.metadata.corner_uvs[c] as usize]);
        let middle = corners.iter().map(|&c| positions[mesh.corners[c] as usize]).sum::<Vec3>() / 3.0;
        ([0, 1].map(|k| uvs.iter().map(|uv| uv[k]).sum::<f64>() / 3.0), middle)
    })
}

fn is_seen(baked: &Baked, uv: [f64; 2]) -> bool {
    let [x, y] = [uv[0], 1.0 - uv[1]].map(|c| ((c * baked.side as f64) as usize).min(baked.side - 1));
    baked.seen[y * baked.side + x]
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn on_the_true_surface_colours_stay_where_they_are() {
    let bench = Bench::of_size(5000, 60_000);
    write_textured_scan(&bench, 2048);
    let (scan, paint) = read_painted_scan(&bench.path("scan.obj")).unwrap();
    let painter = Painter::new(&scan.mesh, paint.as_ref(), None).unwrap().unwrap();
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap().with_positions(bench.case.truth.clone());
    let input = BakeInput { painter: Some(&painter), ..BakeInput::new(&template, &scan.mesh) };
    let options = BakeOptions { side: 1024, shape: true, ..BakeOptions::default() };
    let baked = bake(&input, &options).unwrap();
    assert!(baked.seen_share() > 0.7 && baked.sixteen_bits && baked.shared < 0.001, "{}", baked.seen_share());
    assert!(baked.by_closest < 0.1, "{}", baked.by_closest);

    let back = |p: &Vec3| bench.case.pose.apply_inverse(*p);
    let subject: Vec<Vec3> = template.positions.iter().map(back).collect();
    let (mut slide, mut off) = (Vec::new(), Vec::new());
    for (uv, p) in middles(&template, &subject).filter(|(uv, _)| is_seen(&baked, *uv)) {
        let [r, g, b] = sampled(baked.light.as_ref().unwrap(), 1024, uv);
        let found = [r, g].map(|c| (c - 0.1) / 0.8);
        let expected = place(&p);
        // what is in front of the template moves across the image as well: along the normal is not along the surface
        slide.push(SIDE * (found[0] - expected[0]).hypot(found[1] - expected[1]));
        off.push((Vec3::new(r, g, b) - light(expected)).amax());
    }
    assert!(slide.len() > 5000);
    println!("slide {:.4} mm, light {:.5} on average", mean(&slide), mean(&off));
    // the scan has noise of 0.1 mm, and the template's triangles cut through what is curved
    assert!(mean(&slide) < 0.1, "{} mm", mean(&slide));
    assert!(mean(&off) < 0.02, "{} of light", mean(&off));
    let same = |threads: usize| {
        on_threads(threads, || bake(&input, &BakeOptions { side: 300, supersampling: 3, ..options.clone() }).unwrap())
    };
    assert!(same(1) == same(2), "the texture depends on the threads");
}

/// A square of 20 mm at the height `z`, facing z, with texture coordinates from 0 to 1.
fn square(z: f64) -> PolygonMesh {
    PolygonMesh {
        positions: [[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]].map(|[x, y]| Vec3::new(x, y, z)).to_vec(),
        starts: vec![0, 4],
        corners: vec![0, 1, 2, 3],
        metadata: ObjMetadata {
            uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            corner_uvs: vec![0, 1, 2, 3],
            ..ObjMetadata::default()
        },
    }
}

/// A hilly sheet above the square, larger than it on all sides; at each place its height and its unit normal are known.
fn hills() -> TriangleMesh {
    sheet(241, 241, |c, r| {
        let (x, y) = (c * 0.1 - 2.0, r * 0.1 - 2.0);
        Vec3::new(x, y, height(x, y))
    })
}

fn height(x: f64, y: f64) -> f64 {
    0.5 * (x / 2.0).sin() + 0.3 * (y / 1.5).cos()
}

fn hill_normal(x: f64, y: f64) -> Vec3 {
    Vec3::new(-0.25 * (x / 2.0).cos(), 0.2 * (y / 1.5).sin(), 1.0).normalize()
}

#[test]
fn the_shape_that_the_template_is_too_coarse_for_is_in_its_maps() {
    let scan = hills();
    for mirrored in [false, true] {
        let mut template = square(0.0);
        if mirrored {
            template.metadata.uvs.iter_mut().for_each(|uv| uv[0] = 1.0 - uv[0]);
        }
        let input = BakeInput::new(&template, &scan);
        let baked = bake(&input, &BakeOptions { side: 128, shape: true, ..BakeOptions::default() }).unwrap();
        assert!(baked.light.is_none() && baked.seen.iter().all(|s| *s));
        for (i, texel) in baked.shape.unwrap().iter().enumerate() {
            let [u, v] = [(i % 128) as f64 + 0.5, 128.0 - (i / 128) as f64 - 0.5].map(|c| c / 128.0);
            let (x, y) = (20.0 * if mirrored { 1.0 - u } else { u }, 20.0 * v);
            // u grows against x in the mirror, v upwards along y
            let n = hill_normal(x, y);
            let expected = [if mirrored { -n.x } else { n.x }, n.y, n.z, height(x, y)];
            for k in 0..4 {
                assert!(
                    (f64::from(texel[k]) - expected[k]).abs() < 0.01,
                    "{k} at {x:.2} {y:.2}: {texel:?} {expected:?}"
                );
            }
        }
    }
}

#[test]
fn what_the_scan_does_not_show_is_not_seen() {
    let template = square(0.0);
    let colored = |scan: &TriangleMesh| {
        let colors: Vec<[u8; 3]> = scan.positions.iter().map(|p| from_light(Vec3::repeat(0.03 * p.x + 0.1))).collect();
        Painter::new(scan, None, Some(&colors)).unwrap().unwrap()
    };
    let options = BakeOptions { side: 64, ..BakeOptions::default() };
    let seen = |scan: &TriangleMesh, mask: Option<&[f64]>| {
        let painter = colored(scan);
        let input = BakeInput { mask, painter: Some(&painter), ..BakeInput::new(&template, scan) };
        bake(&input, &options).unwrap()
    };
    let front = square(1.0).triangulate();
    let whole = seen(&front, None);
    assert!(whole.seen_share() == 1.0 && !whole.is_of_one_colour());
    // linear in x, and so on the texture; what is filled goes on in the same range
    for (i, texel) in whole.light.unwrap().iter().enumerate() {
        let x = 20.0 * ((i % 64) as f64 + 0.5) / 64.0;
        assert!((f64::from(texel[0]) - (0.03 * x + 0.1)).abs() < 0.006, "{x}: {texel:?}");
    }
    let mut back = front.clone();
    back.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    assert_eq!(seen(&back, None).seen_share(), 0.0);
    let mut far = front.clone();
    far.positions.iter_mut().for_each(|p| p.z = 3.1);
    assert_eq!(seen(&far, None).seen_share(), 0.0);
    let half = TriangleMesh { triangles: front.triangles[..1].to_vec(), ..front.clone() };
    let share = seen(&half, None).seen_share();
    assert!((share - 0.5).abs() < 0.02, "{share}"); // texels on its border count
    let baked = seen(&half, None);
    assert!(baked.light.unwrap().iter().all(|c| c.iter().all(|x| (0.09..0.71).contains(x))));
    let masked = seen(&front, Some(&[1.0, 1.0, 0.0, 0.0])).seen_share();
    assert!((masked - 0.5).abs() < 0.02, "{masked}");
    let black = Painter::new(&front, None, Some(&[[0; 3]; 4])).unwrap().unwrap();
    let input = BakeInput { painter: Some(&black), ..BakeInput::new(&template, &front) };
    assert!(bake(&input, &options).unwrap().is_of_one_colour());
    // turned over by somebody else: the same colours
    let painter = colored(&back);
    let input = BakeInput { painter: Some(&painter), ..BakeInput::new(&template, &front) };
    assert_eq!(bake(&input, &options).unwrap(), seen(&front, None));
}

#[test]
fn coordinates_outside_the_tile_repeat_and_odd_ones_are_counted() {
    let scan = square(0.5).triangulate();
    let colors = vec![[10, 20, 30], [200, 20, 30], [200, 220, 30], [10, 220, 250]];
    let painter = Painter::new(&scan, None, Some(&colors)).unwrap().unwrap();
    let options = BakeOptions { side: 32, ..BakeOptions::default() };
    let baked = |template: &PolygonMesh| {
        let input = BakeInput { painter: Some(&painter), ..BakeInput::new(template, &scan) };
        bake(&input, &options)
    };
    let plain = baked(&square(0.0)).unwrap();
    let mut moved = square(0.0);
    moved.metadata.uvs.iter_mut().for_each(|uv| *uv = [uv[0] + 2.0, uv[1] + 1.0]);
    let there = baked(&moved).unwrap();
    assert_eq!((&there.light, &there.tiles[..], &plain.tiles[..]), (&plain.light, &[1013][..], &[1001][..]));

    let mut two = square(0.0);
    two.starts.push(8);
    two.corners.extend([0, 1, 2, 3]);
    two.metadata.corner_uvs.extend([0, 1, 2, 3]);
    let stacked = baked(&two).unwrap();
    assert!(stacked.shared > 0.9 && stacked.light == plain.light, "{}", stacked.shared);
    two.metadata.corner_uvs[4..].copy_from_slice(&[0, 0, 1, 1]);
    assert_eq!(baked(&two).unwrap().flat, 2);
    two.metadata.corner_uvs[4..].fill(u32::MAX);
    assert_eq!(baked(&two).unwrap().unplaced, 1);
    two.metadata.corner_uvs.fill(0);
    assert_eq!(baked(&two).unwrap_err(), BakeError::FlatUvs);
    two.metadata = ObjMetadata::default();
    assert_eq!(baked(&two).unwrap_err(), BakeError::NoUvs);
    let mut cloud = scan.clone();
    cloud.triangles.clear();
    let template = square(0.0);
    let input = BakeInput::new(&template, &cloud);
    assert_eq!(bake(&input, &options).unwrap_err(), BakeError::NoSurface);
    for side in [0, 15, 8193, 1_000_000] {
        let input = BakeInput::new(&template, &scan);
        let refused = bake(&input, &BakeOptions { side, ..options.clone() }).unwrap_err();
        assert_eq!(refused, BakeError::Size(side));
    }
}

/// Writes a square scan of 20 mm with this library beside it, reads it, and gives the light in its middle.
fn middle_of(folder: &Path, library: &str) -> Result<Vec3, String> {
    let mut mesh = square(0.0);
    mesh.metadata.material_libraries = vec!["a.mtl".into()];
    mesh.metadata.statements = vec![(0, ObjStatement::Material("skin".into()))];
    let path = folder.join("a.obj");
    write_obj(&path, &mesh).unwrap();
    std::fs::write(folder.join("a.mtl"), library).unwrap();
    let (scan, paint) = read_painted_scan(&path).map_err(|e| e.to_string())?;
    light_in_the_middle(&scan.mesh, paint.as_ref())
}

fn light_in_the_middle(scan: &TriangleMesh, paint: Option<&Paint>) -> Result<Vec3, String> {
    let painter = Painter::new(scan, paint, None).map_err(|e| e.to_string())?.ok_or("no paint")?;
    let template = square(0.0);
    let input = BakeInput { painter: Some(&painter), ..BakeInput::new(&template, scan) };
    let baked = bake(&input, &BakeOptions { side: 17, ..BakeOptions::default() }).unwrap();
    Ok(Vec3::from(baked.light.unwrap()[8 * 17 + 8].map(f64::from)))
}

/// The baked light of a scan is that of its file's triangles, also where some were left out, joined or turned before it was registered.
#[test]
fn triangles_that_are_left_out_leave_their_neighbours_their_colours() {
    let template = square(0.0);
    let plain = template.triangulate();
    let light = |scan: &TriangleMesh, facing: ScanFacing| {
        // Material k of triangle k: red tells which.
        let reds: Vec<f64> = (0..scan.triangles.len()).map(|k| 0.1 + 0.2 * k as f64).collect();
        let material = |&red: &f64| Material {
            name: String::new(),
            light: Vec3::new(red, 0.0, 0.0),
            image: None,
            wrap: [Wrap::Repeat; 2],
        };
        let paint = Paint {
            materials: reds.iter().map(material).collect(),
            material_of: (0..scan.triangles.len() as u32).collect(),
            uvs: vec![[[f32::NAN; 2]; 3]; scan.triangles.len()],
            images: Vec::new(),
        };
        let painter = Painter::new(scan, Some(&paint), None).unwrap().unwrap();
        let (faced, _) = facing.apply(scan, None);
        let sources = facing.sources(scan);
        let painter = Some(&painter);
        let input = BakeInput { painter, sources: sources.as_deref(), ..BakeInput::new(&template, &faced) };
        let baked = bake(&input, &BakeOptions { side: 17, ..BakeOptions::default() }).unwrap();
        baked.light.unwrap().iter().map(|light| light[0]).collect::<Vec<f32>>()
    };
    let [first, second] = [plain.triangles[0], plain.triangles[1]];
    let of_two = light(&plain, ScanFacing::default());
    let near = |red: f32| of_two.iter().any(|r| (r - red).abs() < 1e-5);
    assert!(near(0.1) && near(0.3), "{of_two:?}");
    // The first again, and one with two corners at one place, before the second.
    let [a, b, _] = first;
    let faulty = TriangleMesh { triangles: vec![first, first, [a, a, b], second], ..plain.clone() };
    let facing = ScanFacing { repeated: 1, collapsed: 1, ..ScanFacing::default() };
    // The second is at 0.7 now; texels between the two are mixed.
    for (red, found) in of_two.iter().zip(light(&faulty, facing)) {
        assert!((0.1 + 3.0 * (red - 0.1) - found).abs() < 1e-5, "{red} {found}");
    }
}

#[test]
fn images_of_every_kind_are_read_and_others_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let plain = DynamicImage::ImageRgb8(image::RgbImage::from_pixel(8, 8, image::Rgb([200, 100, 50])));
    let expected = to_light([200, 100, 50]);
    let near = |found: Result<Vec3, String>, tolerance: f64| {
        let found = found.unwrap();
        assert!((found - expected).amax() < tolerance, "{found:?}");
    };
    std::fs::create_dir(at("my images")).unwrap();
    std::fs::write(at("my images/a skin.png"), encoded(&plain, ImageFormat::Png)).unwrap();
    std::fs::write(at("a.jpeg"), encoded(&plain, ImageFormat::Jpeg)).unwrap();
    std::fs::write(at("sixteen.png"), encoded(&DynamicImage::from(plain.to_rgb16()), ImageFormat::Png)).unwrap();
    std::fs::write(at("grey.png"), encoded(&DynamicImage::from(plain.to_luma8()), ImageFormat::Png)).unwrap();
    for name in ["my images/a skin.png", "my images\\a skin.png", "sixteen.png", "-s 3 3 -o 0.2 0.7 sixteen.png"] {
        near(middle_of(folder.path(), &format!("newmtl skin\nKd 0 0 0\nmap_Kd {name}\n")), 1e-5);
    }
    near(middle_of(folder.path(), "newmtl skin\nmap_Kd C:\\Users\\me\\a.jpeg\n"), 0.02);
    let grey = middle_of(folder.path(), "newmtl skin\nmap_Kd grey.png\n").unwrap();
    assert!(grey.x == grey.y && grey.y == grey.z && grey.x > 0.1, "{grey:?}");
    near(
        middle_of(folder.path(), &format!("newmtl skin\nKd {} {} {}\n", 200.0 / 255.0, 100.0 / 255.0, 50.0 / 255.0)),
        1e-5,
    );

    // half of it is transparent, and the rest the colour
    let mut holes = plain.to_rgba8();
    (0..8).for_each(|y| (0..3).for_each(|x| holes.put_pixel(x, y, image::Rgba([0, 0, 0, 0]))));
    std::fs::write(at("holes.png"), encoded(&DynamicImage::from(holes), ImageFormat::Png)).unwrap();
    near(middle_of(folder.path(), "newmtl skin\nmap_Kd holes.png\n"), 1e-5);

    std::fs::write(at("text.png"), "no image").unwrap();
    let cut = encoded(&plain, ImageFormat::Png);
    std::fs::write(at("cut.png"), &cut[..cut.len() / 2]).unwrap();
    std::fs::write(at("bomb.png"), bomb()).unwrap();
    for (library, expected) in [
        ("newmtl skin\nmap_Kd none.png\n", ["none.png", "map_Kd in line 2 of", "a.mtl"]),
        ("newmtl skin\nmap_Kd text.png\n", ["text.png", "PNG or JPEG", "map_Kd in line 2 of"]),
        ("newmtl skin\nmap_Kd cut.png\n", ["cut.png", "PNG or JPEG", "map_Kd"]),
        ("newmtl skin\nmap_Kd bomb.png\n", ["bomb.png", "60000 x 60000", "map_Kd"]),
        ("newmtl skin\nmap_Kd my images\n", ["my images", "a folder", "map_Kd"]),
        ("newmtl skin\nmap_Kd a.<UDIM>.png\n", ["a.mtl: line 2", "<UDIM>", "material of its own"]),
        ("newmtl skin\nmap_Ke sixteen.png\n", ["no paint"; 3]),
        ("newmtl other\n", ["a.obj", "\"skin\"", "[\"other\"]"]),
    ] {
        let error = middle_of(folder.path(), library).unwrap_err();
        assert!(expected.iter().all(|e| error.contains(e)), "{expected:?}: {error}");
    }
    std::fs::remove_file(at("a.mtl")).unwrap();
    let error = read_painted_scan(&at("a.obj")).unwrap_err().to_string();
    assert!(error.contains("a.mtl") && error.contains("mtllib of") && error.contains("a.obj"), "{error}");
}

#[test]
fn a_ply_file_is_painted_by_the_image_it_names() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let pixels = image::RgbImage::from_fn(8, 8, |x, y| image::Rgb([30 * x as u8, 30 * y as u8, 90]));
    std::fs::write(at("my skin.png"), encoded(&DynamicImage::from(pixels), ImageFormat::Png)).unwrap();
    let expected = middle_of(folder.path(), "newmtl skin\nmap_Kd my skin.png\n").unwrap();
    write_polygon_mesh(&at("plain.ply"), &square(0.0)).unwrap();
    let plain = std::fs::read(at("plain.ply")).unwrap();
    let named = |comments: &str| -> Result<Vec3, String> {
        let (first, rest) = plain.split_at(plain.iter().position(|b| *b == b'\n').unwrap() + 1);
        std::fs::write(at("named.ply"), [first, comments.as_bytes(), rest].concat()).unwrap();
        let (scan, paint) = read_painted_scan(&at("named.ply")).map_err(|e| e.to_string())?;
        light_in_the_middle(&scan.mesh, paint.as_ref())
    };
    assert_eq!(named("comment TextureFile my skin.png\n").unwrap(), expected);
    assert_eq!(named("comment TextureFiles are none\n").unwrap_err(), "no paint");
    let files = files_of_painted_mesh(&at("named.ply"));
    assert_eq!(files, [at("named.ply")]);
    let missing = named("comment made by hand\ncomment TextureFile none.png\n").unwrap_err();
    assert!(missing.contains("none.png") && missing.contains("TextureFile in line 3"), "{missing}");
    assert_eq!(files_of_painted_mesh(&at("named.ply")), [at("named.ply"), at("none.png")]);
    let two = named("comment TextureFile my skin.png\ncomment TextureFile b.png\n").unwrap_err();
    assert!(two.contains("line 3") && two.contains("one TextureFile"), "{two}");
}

/// A PNG that says that it has 60000 x 60000 pixels.
fn bomb() -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        bytes.extend((data.len() as u32).to_be_bytes());
        let body = [kind, data].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&body);
        bytes.extend(&body);
        bytes.extend(crc.sum().to_be_bytes());
    };
    let side = 60_000u32.to_be_bytes();
    chunk(b"IHDR", &[&side[..], &side[..], &[8, 2, 0, 0, 0]].concat());
    chunk(b"IDAT", &[0x78, 0x9c, 0x03, 0x00, 0x00, 0x00, 0x00, 0x01]);
    chunk(b"IEND", &[]);
    bytes
}

#[test]
fn gltf_is_painted_by_its_base_colours() {
    use base64::Engine as _;
    let folder = tempfile::tempdir().unwrap();
    let engine = base64::engine::general_purpose::STANDARD;
    // left half one colour, right half another; v downwards
    let halves = image::RgbImage::from_fn(64, 64, |x, _| Rgb(if x < 32 { [200, 100, 50] } else { [10, 220, 30] }));
    let png = encoded(&DynamicImage::from(halves), ImageFormat::Png);
    let mut bytes: Vec<u8> = Vec::new();
    for p in [[0.0f32, 0.0], [0.02, 0.0], [0.02, 0.02], [0.0, 0.02]] {
        [p[0], p[1], 0.0].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    for uv in [[0.0f32, 1.0], [0.4, 1.0], [0.4, 0.0], [0.0, 0.0]] {
        uv.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    [0u16, 1, 2, 0, 2, 3].iter().for_each(|i| bytes.extend(i.to_le_bytes()));
    let start = bytes.len();
    bytes.extend(&png);
    let document = |image: serde_json::Value, texture: serde_json::Value| {
        serde_json::json!({
            "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }] }],
            "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 1, 1, 1], "baseColorTexture": texture } }],
            "textures": [{ "source": 0 }], "images": [image],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4 },
                { "bufferView": 1, "componentType": 5126, "type": "VEC2", "count": 4 },
                { "bufferView": 2, "componentType": 5123, "type": "SCALAR", "count": 6 },
            ],
            "bufferViews": [
                { "buffer": 0, "byteLength": 48 }, { "buffer": 0, "byteOffset": 48, "byteLength": 32 },
                { "buffer": 0, "byteOffset": 80, "byteLength": 12 },
                { "buffer": 0, "byteOffset": start, "byteLength": png.len() },
            ],
            "buffers": [{ "byteLength": bytes.len(), "uri": format!("data:application/octet-stream;base64,{}", engine.encode(&bytes)) }],
        })
    };
    let path = folder.path().join("a.gltf");
    let middle = |image: serde_json::Value, texture: serde_json::Value| {
        std::fs::write(&path, document(image, texture).to_string()).unwrap();
        let (scan, paint) = read_painted_scan(&path).map_err(|e| e.to_string())?;
        light_in_the_middle(&scan.mesh, paint.as_ref())
    };
    let half_red = |c: [u8; 3]| to_light(c).component_mul(&Vec3::new(0.5, 1.0, 1.0));
    let inside = serde_json::json!({ "bufferView": 3, "mimeType": "image/png" });
    let plain = serde_json::json!({ "index": 0 });
    let near = |found: Result<Vec3, String>, expected: [u8; 3]| {
        let found = found.unwrap();
        assert!((found - half_red(expected)).amax() < 1e-4, "{found:?} {expected:?}");
    };
    near(middle(inside.clone(), plain.clone()), [200, 100, 50]);
    std::fs::write(folder.path().join("my skin.png"), &png).unwrap();
    near(middle(serde_json::json!({ "uri": "my%20skin.png" }), plain.clone()), [200, 100, 50]);
    let moved = serde_json::json!({ "index": 0, "extensions": { "KHR_texture_transform": { "offset": [0.5, 0.0] } } });
    near(middle(inside.clone(), moved), [10, 220, 30]);
    // a quarter turn: u' = v, v' = -u
    let turned = serde_json::json!({
        "index": 0,
        "extensions": { "KHR_texture_transform": { "rotation": std::f64::consts::FRAC_PI_2, "scale": [1.0, 0.5] } },
    });
    near(middle(inside.clone(), turned), [200, 100, 50]);
    for (image, texture, expected) in [
        (serde_json::json!({ "uri": "none.png" }), plain.clone(), "none.png"),
        (serde_json::json!({ "bufferView": 0 }), plain.clone(), "PNG or JPEG (image 0 of"),
        (inside.clone(), serde_json::json!({ "index": 7 }), "textures"),
        (
            inside,
            serde_json::json!({ "index": 0, "texCoord": 1 }),
            "export again with these as the first set, found TEXCOORD_1",
        ),
    ] {
        let error = middle(image, texture).unwrap_err();
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

const FIT: &str =
    "register --template rig/template.obj --neutral case/neutral.npy --rig rig --landmarks case/landmarks.json";

#[test]
fn the_command_writes_a_texture_that_its_result_shows() {
    let bench = Bench::of_size(2000, 20_000);
    write_textured_scan(&bench, 512);
    let before = bench.read("scan.mtl");
    let said = bench.done(&format!(
        "{FIT} --target scan.obj --out r.obj --report r.json --bake-texture 256 --bake normal,displacement"
    ));
    assert!(said.contains("texture: 256 x 256") && said.contains("r_seen.png"), "{said}");
    assert_eq!(bench.read("scan.mtl"), before);
    // what a run of ours baked is known when its result was deleted, unless somebody has worked on it
    let made = ["r.mtl", "r_color.png", "r_seen.png", "r_normal.png", "r_displacement.png"];
    let foreign = |name: &str| MaterialFiles::default().is_foreign(&bench.path("r.obj"), &bench.path(name));
    std::fs::rename(bench.path("r.obj"), bench.path("kept.obj")).unwrap();
    assert_eq!(made.map(foreign), [false; 5]);
    for name in made {
        let bytes = bench.read(name);
        let (mut painted, last) = (bytes.clone(), bytes.len() - 120);
        painted[last] ^= 1;
        for other in [&painted[..], &bytes[..last], b"mine"] {
            bench.write(name, other);
            assert!(foreign(name), "{name}");
        }
        bench.write(name, bytes);
    }
    std::fs::rename(bench.path("kept.obj"), bench.path("r.obj")).unwrap();
    let report = bench.json("r.json");
    assert!(report["texture_seen"].as_f64().unwrap() > 0.6);
    let targets = report["inputs"].as_array().unwrap().iter().filter(|i| i["role"] == "target");
    let mut files: Vec<&str> = targets.map(|i| i["name"].as_str().unwrap()).collect();
    files.sort_unstable();
    assert_eq!(files, ["scan.mtl", "scan.obj", "skin.png"]);
    let open = |name: &str| image::load_from_memory(&bench.read(name)).unwrap();
    assert!(matches!(open("r_color.png"), DynamicImage::ImageRgb16(_)));
    assert!(matches!(open("r_normal.png"), DynamicImage::ImageRgb8(_)));
    assert!(matches!(open("r_displacement.png"), DynamicImage::ImageLuma16(_)));
    let mask = open("r_seen.png").into_luma8();
    assert!([0, 128, 255].iter().all(|grey| mask.pixels().any(|p| p.0[0] == *grey)));

    // the result is a textured scan itself, on which every point has the colour that the formula says of the true one
    let (result, paint) = read_painted_scan(&bench.path("r.obj")).unwrap();
    let paint = paint.unwrap();
    assert_eq!((paint.images.len(), paint.images[0].path.ends_with("r_color.png")), (1, true));
    let texture = open("r_color.png").into_rgb16();
    let lights: Vec<[f32; 3]> = texture
        .pixels()
        .map(|p| {
            p.0.map(|c| {
                let c = f64::from(c) / 65535.0;
                (if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
            })
        })
        .collect();
    let mesh = read_polygon_mesh(&bench.path("r.obj")).unwrap();
    assert_eq!(mesh.metadata.material_libraries, ["r.mtl"]);
    let back = |p: &Vec3| bench.case.pose.apply_inverse(*p);
    let subject: Vec<Vec3> = bench.case.truth.iter().map(back).collect();
    let mut slide: Vec<f64> = Vec::new();
    for (uv, p) in middles(&mesh, &subject) {
        let [x, y] = [uv[0], 1.0 - uv[1]].map(|c| (c * 256.0) as u32);
        if mask.get_pixel(x.min(255), y.min(255)).0 == [255] {
            let [r, g, _] = sampled(&lights, 256, uv);
            let expected = place(&p);
            slide.push(SIDE * ((r - 0.1) / 0.8 - expected[0]).hypot((g - 0.1) / 0.8 - expected[1]));
        }
    }
    println!("slide of a registered texture {:.3} mm on average", mean(&slide));
    assert!(slide.len() > 1000 && mean(&slide) < 1.5, "{} mm", mean(&slide));
    drop(result);

    // inside of glTF, and of colours at vertices alone
    let tint = |p: &Vec3| from_light(light(place(&back(p))));
    let colors: Vec<[u8; 3]> = bench.case.scan.positions.iter().map(tint).collect();
    write_ply(
        &bench.path("colored.ply"),
        &bench.case.scan,
        PlyOptions { colors: Some(&colors), ..PlyOptions::default() },
    )
    .unwrap();
    let baked = format!("{FIT} --target colored.ply --out c.glb --bake-texture 128");
    bench.done(&baked);
    std::fs::remove_file(bench.path("c.glb")).unwrap();
    bench.done(&baked);
    std::fs::rename(bench.path("c.glb"), bench.path("kept.glb")).unwrap();
    let ours = bench.read("c_seen.png");
    bench.write("c_seen.png", "mine");
    let said = bench.run(&baked);
    assert!(said.code == 3 && said.stderr.contains("c_seen.png: is there already"), "{}", said.stderr);
    assert!(said.stderr.contains("move it away") && bench.read("c_seen.png") == b"mine");
    bench.write("c_seen.png", ours);
    std::fs::rename(bench.path("kept.glb"), bench.path("c.glb")).unwrap();
    let (scan, paint) = read_painted_scan(&bench.path("c.glb")).unwrap();
    assert_eq!(paint.unwrap().images[0].bytes, bench.read("c_color.png"));
    assert!(scan.colors.is_none() && !bench.path("c.mtl").exists() && !bench.path("c_normal.png").exists());
    let kept = read_polygon_mesh(&bench.path("c.glb")).unwrap().metadata;
    assert_eq!(kept.statements, read_polygon_mesh(&bench.path("rig/template.obj")).unwrap().metadata.statements);
}

#[test]
fn materials_of_the_template_go_along_and_what_a_format_does_not_hold_is_said() {
    let bench = Bench::of_size(1000, 8000);
    let library = bench.text("rig/face.mtl");
    bench.write("rig/face.mtl", format!("{library}map_Kd my skin.png\nbump none.png\n"));
    let mut png = Vec::new();
    image::RgbImage::from_pixel(4, 4, image::Rgb([200, 150, 130]))
        .write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)
        .unwrap();
    bench.write("rig/my skin.png", &png);
    // tiles beyond the first
    let mut template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    template.metadata.uvs.iter_mut().for_each(|uv| uv[0] += 2.0);
    // every quad is flat by itself
    template.metadata.corner_normals = (0..template.corners.len() as u32).map(|c| c / 4).collect();
    write_obj(&bench.path("rig/template.obj"), &template).unwrap();
    let fit =
        "register --template rig/template.obj --target case/scan.ply --landmarks case/landmarks.json --model rigid";
    let stderr = bench.ends(&format!("{fit} --out a face.obj").replace("a face", "a_face"), 0);
    assert!(stderr.contains("none.png"), "{stderr}");
    let names_of = |path: &str| read_polygon_mesh(&bench.path(path)).unwrap().metadata.material_libraries;
    assert_eq!(names_of("a_face.obj"), ["a_face.mtl"]);
    let of_corner = read_polygon_mesh(&bench.path("a_face.obj")).unwrap().metadata.corner_normals;
    assert!(of_corner.iter().enumerate().all(|(c, n)| *n as usize == c), "each corner a normal of its own");
    assert_eq!(bench.read("a_face_my_skin.png"), png);
    let copied = bench.text("a_face.mtl");
    assert!(copied.ends_with("map_Kd a_face_my_skin.png\nbump none.png\n"), "{copied}");
    let (_, paint) = read_painted_scan(&bench.path("a_face.obj")).unwrap();
    assert_eq!(paint.unwrap().images[0].bytes, png);
    // what would be written over what is read is refused
    bench.write("rig/a_face.mtl", "newmtl x");
    template.metadata.material_libraries = vec!["face.mtl".into(), "a_face.mtl".into()];
    write_obj(&bench.path("rig/two.obj"), &template).unwrap();
    let run = bench.run(&format!("{fit} --out rig/a_face.obj").replace("rig/template.obj", "rig/two.obj"));
    assert!(run.code == 1 && run.stderr.contains("a_face.mtl"), "{}", run.stderr);

    for format in ["usda", "glb", "ply"] {
        let run = bench.run(&format!("{fit} --out f.{format}"));
        let said = [
            "PLY holds no groups, materials, smoothing groups, hard edges",
            "groups, smoothing groups, hard edges are in a note",
        ];
        let said = said.map(|words| run.stderr.contains(words));
        assert!(run.code == 0 && said == [format == "ply", format == "glb"], "{format}: {}", run.stderr);
    }
    let kept = read_polygon_mesh(&bench.path("f.glb")).unwrap().metadata;
    assert!(kept.statements == template.metadata.statements && kept.corner_normals == of_corner);
    let uvs = read_polygon_mesh(&bench.path("f.glb")).unwrap().metadata.uvs;
    assert!(uvs.iter().all(|uv| uv[0] >= 2.0) && !uvs.is_empty());
    let bytes = bench.read("f.glb");
    let (document, _) = glb_parts(&bytes);
    let mut names: Vec<&str> =
        document["materials"].as_array().unwrap().iter().map(|m| m["name"].as_str().unwrap()).collect();
    names.sort_unstable();
    assert_eq!(names, ["lips", "skin"]);
    let text = bench.text("f.usda");
    for part in [
        "normal3f[] normals = [",
        "familyName = \"materialBind\"",
        "rel material:binding = </Subject/Materials/material_",
        "def Material \"",
    ] {
        assert!(text.contains(part), "{part}");
    }

    // a rig names what is beside it
    for format in ["npy", "shapes"] {
        bench.done(&format!("rig convert --rig rig --format {format} --out {format}"));
        let name = if format == "npy" { "template" } else { "neutral" };
        assert_eq!(names_of(&format!("{format}/{name}.obj")), [format!("{name}.mtl")]);
        assert_eq!(bench.read(&format!("{format}/{name}_my_skin.png")), png);
    }
    bench.done("rig convert --rig rig --out rig.glb");
    bench.done("rig convert --rig rig.glb --out bare");
    assert!(names_of("bare/template.obj").is_empty());

    // and a batch leaves all of it
    bench.write("scans.csv", "target,landmarks\ncase/scan.ply,case/landmarks.json\n");
    bench.done("batch scans.csv --out out --template rig/template.obj --model rigid");
    assert_eq!(bench.read("out/scan_my_skin.png"), png);
    write_textured_scan(&bench, 64);
    bench.write("scans.csv", "target,landmarks,bake-texture\nscan.obj,case/landmarks.json,64\n");
    bench.done("batch scans.csv --out out --template rig/template.obj --model rigid --bake displacement");
    for name in ["scan_color.png", "scan_seen.png", "scan_displacement.png", "scan.mtl"] {
        assert!(bench.path(&format!("out/{name}")).exists(), "{name}");
    }
    assert!(!bench.path("out/scan_my_skin.png").exists());
    let run = bench.run("batch scans.csv --out out --template rig/template.obj --model rigid --bake displacement");
    assert!(run.stderr.contains("done before"), "{}", run.stderr);
}

#[test]
fn bad_arguments_and_inputs_are_refused_before_the_work() {
    let bench = Bench::of_size(1000, 8000);
    write_textured_scan(&bench, 64);
    let refused = |arguments: &str, code: i32, words: &[&str]| {
        let Run { code: found, stderr, .. } = bench.run(arguments);
        assert_eq!(found, code, "{arguments}\n{stderr}");
        assert!(words.iter().all(|w| stderr.contains(w)), "{words:?}: {stderr}");
        assert!(!bench.path("r.obj").exists() && !bench.path("r_color.png").exists());
    };
    let fit = format!("{FIT} --target scan.obj --out r.obj");
    refused(&format!("{fit} --bake-texture 0"), 1, &["16..=8192"]);
    refused(&format!("{fit} --bake-texture 1000000"), 1, &["16..=8192"]);
    refused(&format!("{fit} --bake normal"), 1, &["--bake-texture"]);
    refused(
        &format!("{FIT} --target scan.obj --out scan.ply --picture scan_color.png --bake-texture 64"),
        1,
        &["scan_color.png"],
    );
    refused(
        &format!("{FIT} --target case/scan.ply --out r.obj --bake-texture 64"),
        4,
        &["case/scan.ply", "normal,displacement"],
    );
    // NAME.mtl of the result is that of the scan
    bench.write("sub/keep", "");
    refused(&format!("{FIT} --target scan.obj --out scan.obj --bake-texture 64"), 1, &["scan.obj", "read"]);
    std::fs::copy(bench.path("scan.obj"), bench.path("other.obj")).unwrap();
    refused(&format!("{FIT} --target other.obj --out scan.obj --bake-texture 64"), 1, &["scan.mtl", "would overwrite"]);
    let mut bare = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    bare.metadata = ObjMetadata::default();
    write_obj(&bench.path("bare.obj"), &bare).unwrap();
    refused(
        "register --template bare.obj --target scan.obj --landmarks case/landmarks.json --model rigid --out r.obj --bake-texture 64",
        4,
        &["bare.obj", "UVs", "Smart UV"],
    );
    std::fs::remove_file(bench.path("skin.png")).unwrap();
    refused(&format!("{fit} --bake-texture 64"), 4, &["skin.png", "map_Kd in line 3 of scan.mtl"]);
    // nothing of that matters without a texture
    let stderr = bench.ends(&format!("{fit} --model rigid"), 0);
    assert!(stderr.contains("--bake-texture 2048"), "{stderr}");
}
