//! Regions, textures and blurs: areas in closed form, plain quadratic references, files, bad input.

use std::f64::consts::PI;

use crate::threads::on_threads;
use image::{DynamicImage, GrayImage, RgbImage, RgbaImage};
use nonrigid::morph::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn area(region: &Region, width: usize, height: usize) -> f64 {
    region.rasterize(width, height, Coordinates::Pixels).unwrap().grey().iter().sum()
}

fn circle(x: f64, y: f64, radius: f64) -> Region {
    Shape::Circle { centre: [x, y], radius }.into()
}

fn polygon(rings: &[&[[f64; 2]]]) -> Region {
    Shape::Polygon { rings: rings.iter().map(|ring| ring.to_vec()).collect() }.into()
}

fn sector(inner: f64, outer: f64, start: f64, sweep: f64) -> Region {
    Shape::Sector { centre: [100.3, 99.1], inner, outer, start, sweep }.into()
}

fn random_texture(width: usize, height: usize, seed: u64) -> Texture {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Some values twice, some blank: what sorting has to cope with.
    let grey = (0..width * height).map(|_| (rng.random_range(-0.2f64..1.0).max(0.0) * 50.0).round() / 50.0);
    Texture::new(width, height, grey.collect()).unwrap()
}

#[test]
fn areas_are_those_of_geometry() {
    let ellipse = |angle| Region::from(Shape::Ellipse { centre: [101.0, 97.5], radii: [80.2, 31.7], angle });
    let star: Vec<[f64; 2]> =
        (0..5).map(|i| f64::from(i) * 0.8 * PI).map(|t| [100. + 90. * t.sin(), 100. - 90. * t.cos()]).collect();
    // A pentagram of circumradius 1 without the pentagon in its middle, which it winds round twice.
    let [sin18, sin36, sin54, sin72] = [0.1, 0.2, 0.3, 0.4].map(|turn| (turn * PI).sin());
    let inner = sin18 / sin54;
    let arms = 5.0 * inner * sin36 - 2.5 * inner * inner * sin72;
    for (name, region, expected) in [
        ("circle", circle(100.3, 99.1, 77.7), PI * 77.7 * 77.7),
        ("ellipse", ellipse(0.0), PI * 80.2 * 31.7),
        ("turned ellipse", ellipse(37.0), PI * 80.2 * 31.7),
        ("sector", sector(0.0, 80.0, 20.0, 75.0), PI * 6400.0 * 75.0 / 360.0),
        ("blunt sector", sector(0.0, 80.0, -120.0, 235.0), PI * 6400.0 * 235.0 / 360.0),
        ("half disc", sector(0.0, 80.0, 90.0, 180.0), PI * 3200.0),
        ("annular sector", sector(30.0, 80.0, 300.0, 120.0), PI * 5500.0 / 3.0),
        ("ring", sector(30.0, 80.0, 0.0, 360.0), PI * 5500.0),
        ("triangle", polygon(&[&[[10.0, 20.0], [150.5, 33.0], [70.0, 180.25]]]), 0.5 * (140.5 * 160.25 - 13.0 * 60.0)),
        ("star", polygon(&[&star]), 8100.0 * arms),
    ] {
        let found = area(&region, 200, 200);
        assert!((found / expected - 1.0).abs() < 2e-4, "{name}: {found}, expected {expected}");
    }
}

#[test]
fn rectangles_cover_pixels_by_their_share() {
    let rectangle = |x0: f64, y0: f64, x1: f64, y1: f64| polygon(&[&[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]]);
    let texture = rectangle(1.25, 0.5, 3.5, 2.0).rasterize(5, 3, Coordinates::Pixels).unwrap();
    let row = [0.0, 0.75, 1.0, 0.5, 0.0];
    let expected: Vec<f64> = [0.5, 1.0, 0.0].iter().flat_map(|share| row.map(|r| r * share)).collect();
    for (found, expected) in texture.grey().iter().zip(&expected) {
        assert!((found - expected).abs() < 1e-14, "{:?}", texture.grey());
    }
    // The same in texture coordinates and in a box: y up.
    let unit = rectangle(0.25, 1.0 / 3.0, 0.7, 5.0 / 6.0).rasterize(5, 3, Coordinates::Unit).unwrap();
    let low = [-10.0, 4.0];
    let framed = rectangle(-7.5, 5.0, -3.0, 6.5).rasterize(5, 3, Coordinates::Box { low, high: [0.0, 7.0] }).unwrap();
    for ((a, b), c) in texture.grey().iter().zip(unit.grey()).zip(framed.grey()) {
        assert!((a - b).abs() < 0.02 && (a - c).abs() < 1e-12, "{a} {b} {c}");
    }
}

#[test]
fn set_operations_agree_pixel_by_pixel() {
    let (a, b) = (circle(40.0, 50.0, 33.3), sector(20.0, 90.0, 170.0, 200.0));
    let grey = |r: &Region| r.rasterize(120, 110, Coordinates::Pixels).unwrap().into_grey();
    let both = grey(&a.clone().intersect(b.clone()));
    let (either, first) = (grey(&a.clone().union(b.clone())), grey(&a.clone().subtract(b.clone())));
    let (a, b) = (grey(&a), grey(&b));
    assert!(both.iter().sum::<f64>() > 100.0 && first.iter().sum::<f64>() > 100.0);
    for i in 0..a.len() {
        assert!((both[i] + first[i] - a[i]).abs() < 1e-12);
        assert!((either[i] - first[i] - b[i]).abs() < 1e-12);
    }
    let hole = polygon(&[&[[5., 5.], [90., 7.], [60., 95.]], &[[40., 20.], [60., 25.], [50., 50.]]]);
    let solid = polygon(&[&[[5., 5.], [90., 7.], [60., 95.]]]);
    let cut = solid.subtract(polygon(&[&[[40., 20.], [60., 25.], [50., 50.]]]));
    for (h, c) in grey(&hole).iter().zip(grey(&cut)) {
        assert!((h - c).abs() < 1e-12);
    }
}

#[test]
fn wrong_regions_are_named() {
    let message = |region: Region| region.rasterize(20, 20, Coordinates::Pixels).unwrap_err().to_string();
    for (region, words) in [
        (circle(1.0, 2.0, 0.0), "circle: the radius is 0"),
        (circle(1.0, 2.0, f64::INFINITY), "inf"),
        (circle(f64::NAN, 2.0, 1.0), "centre is NaN"),
        (Shape::Ellipse { centre: [0.0; 2], radii: [1.0, -1.0], angle: 0.0 }.into(), "second radius is -1"),
        (Shape::Ellipse { centre: [0.0; 2], radii: [1.0, 1.0], angle: f64::NAN }.into(), "angle is NaN"),
        (sector(5.0, 5.0, 0.0, 10.0), "inner radius is 5"),
        (sector(0.0, 5.0, 0.0, 0.0), "sweep is 0"),
        (sector(0.0, 5.0, 0.0, 361.0), "sweep is 361"),
        (polygon(&[]), "polygon: ring 0 has 0 points"),
        (polygon(&[&[[0., 0.], [9., 0.], [5., 5.]], &[]]), "ring 1 has 0 points"),
        (polygon(&[&[[0., 0.], [1., 1.], [2., 2.], [5., 5.]]]), "not on one line"),
        (polygon(&[&[[0., 0.], [f64::NAN, 1.], [2., 5.]]]), "NaN"),
        (circle(5.0, 5.0, 2.0).subtract(circle(1.0, 1.0, -3.0)), "radius is -3"),
    ] {
        assert!(message(region).contains(words), "{words}");
    }
    let fine = circle(5.0, 5.0, 2.0);
    assert!(matches!(fine.rasterize(0, 5, Coordinates::Pixels), Err(MorphError::TextureSize { .. })));
    assert!(matches!(fine.rasterize(5, 1 << 20, Coordinates::Pixels), Err(MorphError::TextureSize { .. })));
    assert!(matches!(fine.rasterize(1 << 15, 1 << 15, Coordinates::Pixels), Err(MorphError::TextureSize { .. })));
    assert!(matches!(fine.rasterize_with(5, 5, Coordinates::Unit, 0), Err(MorphError::SubRows { found: 0 })));
    let covered = Coordinates::Box { low: [0.0, 1.0], high: [1.0, 1.0] };
    assert!(matches!(fine.rasterize(5, 5, covered), Err(MorphError::Covered { .. })));
    // Far outside: nothing, without an error.
    assert_eq!(area(&circle(-1e9, 1e9, 1e8), 30, 30), 0.0);
    assert_eq!(area(&circle(0.0, 0.0, 1e9), 30, 30), 900.0);
}

#[test]
fn textures_refuse_what_is_no_grey() {
    assert!(matches!(Texture::new(2, 2, vec![0.0; 5]), Err(MorphError::TextureLength { found: 5, .. })));
    for value in [f64::NAN, -0.1, 1.1] {
        match Texture::new(2, 2, vec![0.0, 1.0, value, 0.0]) {
            Err(MorphError::GreyValue { x: 0, y: 1, .. }) => {}
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn pictures_become_textures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mask.png");
    let read = |picture: DynamicImage, weights| {
        picture.save(&path).unwrap();
        Texture::read_png(&path, weights).unwrap()
    };
    let grey = read(GrayImage::from_fn(3, 2, |x, y| image::Luma([(x * 100 + y) as u8])).into(), GreyWeights::AsPrinted);
    assert_eq!((grey.width(), grey.height()), (3, 2));
    assert_eq!(grey.grey(), [0.0, 100. / 255., 200. / 255., 1. / 255., 101. / 255., 201. / 255.]);
    let colours = RgbImage::from_fn(2, 1, |x, _| image::Rgb(if x == 0 { [255; 3] } else { [10, 100, 200] }));
    for (weights, white) in [(GreyWeights::Rec601, 1.0), (GreyWeights::AsPrinted, 0.93)] {
        let texture = read(colours.clone().into(), weights);
        let [r, g, b] = weights.vector();
        assert!((texture.grey()[0] - white).abs() < 1e-15);
        assert!((texture.grey()[1] - (r * 10.0 + g * 100.0 + b * 200.0) / 255.0).abs() < 1e-15);
    }
    let clear = read(RgbaImage::from_pixel(1, 1, image::Rgba([255, 255, 255, 51])).into(), GreyWeights::Rec601);
    assert!((clear.grey()[0] - 0.2).abs() < 1e-15);

    let texture = random_texture(19, 23, 4);
    texture.write_png(&path).unwrap();
    let back = Texture::read_png(&path, GreyWeights::Rec601).unwrap();
    for (a, b) in texture.grey().iter().zip(back.grey()) {
        assert!((a - b).abs() <= 0.5 / 65535.0 + 1e-15);
    }
    std::fs::write(&path, b"no picture").unwrap();
    assert!(Texture::read_png(&path, GreyWeights::Rec601).unwrap_err().to_string().contains("mask.png"));
    assert!(Texture::read_png(&folder.path().join("none.png"), GreyWeights::Rec601).is_err());
    assert!(texture.write_png(&folder.path().join("none/a.png")).is_err());
}

#[test]
fn v_is_zero_at_the_bottom_row() {
    let texture = Texture::new(3, 2, vec![0.1, 0.2, 0.3, 0.7, 0.8, 0.9]).unwrap();
    for sampling in [Sampling::Nearest, Sampling::Bilinear] {
        for (uv, grey) in
            [([0.0, 0.0], 0.7), ([1.0, 0.0], 0.9), ([0.5, 0.1], 0.8), ([0.0, 1.0], 0.1), ([1.0, 1.0], 0.3)]
        {
            assert!((texture.sample(uv, sampling) - grey).abs() < 1e-15, "{uv:?}");
        }
        for uv in [[-1e-9, 0.5], [0.5, 1.000001], [f64::NAN, 0.5], [0.5, f64::NAN], [f64::INFINITY, 0.0]] {
            assert_eq!(texture.sample(uv, sampling), 0.0);
        }
    }
    assert_eq!(texture.sample([0.49, 0.49], Sampling::Nearest), 0.8);
    // Half-way between two centres, and in the middle of four.
    assert!((texture.sample([1.0 / 3.0, 0.25], Sampling::Bilinear) - 0.75).abs() < 1e-15);
    assert!((texture.sample([2.0 / 3.0, 0.5], Sampling::Bilinear) - 0.55).abs() < 1e-15);
}

#[test]
fn an_overlay_mixes_by_grey() {
    let texture = Texture::new(3, 1, vec![0.0, 0.5, 1.0]).unwrap();
    let picture = RgbImage::from_pixel(3, 1, image::Rgb([10, 20, 31]));
    let mixed = texture.overlay(&picture, [255, 0, 0]).unwrap();
    assert_eq!(mixed.as_raw()[..], [10, 20, 31, 133, 10, 16, 255, 0, 0]);
    let error = texture.overlay(&RgbImage::new(3, 2), [0; 3]).unwrap_err();
    assert_eq!(error, MorphError::OverlaySize { picture: [3, 2], mask: [3, 1] });
}

/// Index of the pixel that stands for `i`, by the rule's own words.
fn place(i: isize, n: usize, border: Border) -> Option<usize> {
    let n = n as isize;
    let mut i = i;
    match border {
        Border::Zero => {}
        Border::Replicate => i = i.max(0).min(n - 1),
        Border::Reflect101 => {
            while n > 1 && !(0..n).contains(&i) {
                i = if i < 0 { -i } else { 2 * (n - 1) - i };
            }
            i = i.min(n - 1).max(0);
        }
    }
    (0..n).contains(&i).then_some(i as usize)
}

/// The blur by its definition: k x k pixels each, one time after the other.
fn reference(texture: &Texture, blur: &Blur) -> Vec<f64> {
    let (w, h, r) = (texture.width(), texture.height(), (blur.kernel / 2) as isize);
    let mut grey = texture.grey().to_vec();
    for _ in 0..blur.iterations {
        let mut next = Vec::new();
        for y in 0..h as isize {
            for x in 0..w as isize {
                let mut window = Vec::new();
                for dy in -r..=r {
                    for dx in -r..=r {
                        let at = place(x + dx, w, blur.border).zip(place(y + dy, h, blur.border));
                        let weight = match blur.kind {
                            BlurKind::Gaussian { sigma } => {
                                let sigma = sigma.unwrap_or(Blur::sigma_of(blur.kernel));
                                (-((dx * dx + dy * dy) as f64) / (2.0 * sigma * sigma)).exp()
                            }
                            _ => 1.0,
                        };
                        window.push((at.map_or(0.0, |(x, y)| grey[y * w + x]), weight));
                    }
                }
                next.push(if blur.kind == BlurKind::Median {
                    window.sort_by(|a, b| a.0.total_cmp(&b.0));
                    window[window.len() / 2].0
                } else {
                    window.iter().map(|(g, w)| g * w).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>()
                });
            }
        }
        grey = next;
    }
    grey
}

const KINDS: [BlurKind; 4] =
    [BlurKind::Mean, BlurKind::Gaussian { sigma: None }, BlurKind::Gaussian { sigma: Some(1.1) }, BlurKind::Median];

#[test]
fn blurs_are_what_their_definition_says() {
    for (width, height) in [(23, 17), (1, 9), (70, 66), (8, 1)] {
        let texture = random_texture(width, height, 7);
        for kind in KINDS {
            for border in [Border::Replicate, Border::Reflect101, Border::Zero] {
                let cases = if width < 50 { &[(1, 3), (3, 3), (13, 2), (41, 1)][..] } else { &[(5, 2)] };
                for &(kernel, iterations) in cases {
                    let blur = Blur { kind, kernel, iterations, border };
                    let found = blur.apply(&texture).unwrap();
                    for (a, b) in found.grey().iter().zip(reference(&texture, &blur)) {
                        let bound = if kind == BlurKind::Median { 0.0 } else { 1e-12 };
                        assert!((a - b).abs() <= bound, "{blur:?} of {width} x {height}: {a} {b}");
                    }
                }
            }
        }
    }
}

#[test]
fn mean_and_gaussian_keep_the_mean_and_constants() {
    let mask = circle(150.0, 140.0, 31.0).rasterize(300, 280, Coordinates::Pixels).unwrap();
    let sum = |t: &Texture| t.grey().iter().sum::<f64>();
    for kind in [BlurKind::Mean, BlurKind::Gaussian { sigma: None }] {
        let blurred = Blur { kind, kernel: 13, iterations: 16, ..Blur::default() }.apply(&mask).unwrap();
        assert!((sum(&blurred) / sum(&mask) - 1.0).abs() < 1e-11, "{kind:?}");
        assert!(blurred.grey().iter().all(|g| (0.0..=1.0).contains(g)));
        assert_eq!(blurred.grey()[0], 0.0, "what no kernel reaches stays blank to the bit");
    }
    for value in [1.0, 0.25, 0.7] {
        let flat = Texture::new(40, 30, vec![value; 1200]).unwrap();
        for border in [Border::Replicate, Border::Reflect101] {
            let blurred = Blur { iterations: 40, border, ..Blur::default() }.apply(&flat).unwrap();
            let first = blurred.grey()[0];
            assert!((first - value).abs() < 4e-15 && blurred.grey().iter().all(|g| *g == first));
        }
    }
    // A mirrored texture gives the mirrored blur to the bit.
    let texture = random_texture(61, 40, 3);
    let flip = |t: &Texture| {
        Texture::new(61, 40, t.grey().chunks(61).flat_map(|r| r.iter().rev().copied()).collect()).unwrap()
    };
    for kind in KINDS {
        let blur = Blur { kind, iterations: 5, ..Blur::default() };
        assert_eq!(flip(&blur.apply(&texture).unwrap()), blur.apply(&flip(&texture)).unwrap(), "{kind:?}");
    }
}

#[test]
fn no_iterations_change_nothing_and_wrong_blurs_are_named() {
    let texture = random_texture(9, 9, 1);
    assert_eq!(Blur { iterations: 0, ..Blur::default() }.apply(&texture).unwrap(), texture);
    for kernel in [0, 2, 14, MAX_KERNEL + 2, usize::MAX] {
        let error = Blur { kernel, iterations: 0, ..Blur::default() }.apply(&texture).unwrap_err();
        assert_eq!(error, MorphError::Kernel { size: kernel });
    }
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let blur = Blur { kind: BlurKind::Gaussian { sigma: Some(sigma) }, ..Blur::default() };
        assert!(matches!(blur.apply(&texture), Err(MorphError::Sigma { .. })));
    }
    assert!((Blur::sigma_of(13) - 2.3).abs() < 1e-15);
}

#[test]
fn masks_have_the_same_bits_at_any_number_of_threads() {
    let work = || {
        let region = circle(150.0, 90.0, 60.0).subtract(sector(10.0, 50.0, 33.0, 99.0));
        let texture = region.rasterize(301, 203, Coordinates::Pixels).unwrap();
        let noise = random_texture(301, 203, 9);
        KINDS.map(|kind| [&texture, &noise].map(|t| Blur { kind, iterations: 3, ..Blur::default() }.apply(t).unwrap()))
    };
    let [one, two, four] = [1, 2, 4].map(|threads| on_threads(threads, work));
    assert!(one == two && one == four);
}

#[test]
fn recipes_may_hold_regions_and_blurs() {
    let region = circle(1.0, 2.0, 3.0).subtract(polygon(&[&[[0., 0.], [1., 0.], [0., 1.]]]));
    let text = serde_json::to_string(&region).unwrap();
    assert_eq!(serde_json::from_str::<Region>(&text).unwrap(), region);
    let three = r#"{"union": [{"circle": {"centre": [1, 2], "radius": 3}}, {"circle": {"centre": [9, 2], "radius": 3}},
                   {"ellipse": {"centre": [4, 8], "radii": [2, 1]}}]}"#;
    let three: Region = serde_json::from_str(three).unwrap();
    assert_eq!(three.bounds(), [[-2.0, -1.0], [12.0, 10.0]]);
    assert!(matches!(three, Region::Union(..)));
    // A long list is no deep tree.
    let one = r#"{"circle": {"centre": [1, 2], "radius": 3}}"#;
    let many = format!("{{\"subtract\": [{}]}}", vec![one; 100_000].join(", "));
    assert_eq!(serde_json::from_str::<Region>(&many).unwrap().bounds(), [[-2.0, -1.0], [4.0, 5.0]]);
    for (wrong, said) in [
        (r#"{"circle": {"centre": [1, 2], "radios": 3}}"#, "radios"),
        (r#"{"circel": {"centre": [1, 2], "radius": 3}}"#, "unknown variant `circel`"),
        (r#"{"union": []}"#, "'union' of no regions"),
        (r#"{"union": [], "subtract": []}"#, "both 'union' and 'subtract'"),
        ("{}", "without a shape"),
        ("3", "expected a shape"),
    ] {
        let error = serde_json::from_str::<Region>(wrong).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
    assert_eq!(
        serde_json::from_str::<Blur>("{\"iterations\": 40}").unwrap(),
        Blur { iterations: 40, ..Blur::default() }
    );
}
