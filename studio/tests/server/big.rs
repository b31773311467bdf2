//! Big scans: shown thinned out, worked on whole.

use std::time::Instant;

use nonrigid::io::{PlyOptions, write_ply};
use nonrigid::mesh::{TriangleMesh, Vec3};
use serde_json::{Value, json};
use studio::case::{Case, Source, Unit};

use crate::client::{Page, Running};

/// How far the scan was moved.
const MOVED: [f64; 3] = [3.0, 2.0, 5.0];

/// A hill of 200 mm. Every other point of the finest grid lies 0.06 mm higher: what is thinned out has lost that.
fn hill(n: u32, ripple: f64) -> TriangleMesh {
    let at = |c: u32, r: u32| {
        let (x, y) = (200.0 * f64::from(c) / f64::from(n - 1), 200.0 * f64::from(r) / f64::from(n - 1));
        let z = 40.0 * (-((x - 80.0) / 50.0).powi(2) - ((y - 110.0) / 70.0).powi(2)).exp() + 0.05 * x;
        Vec3::new(x, y, z + ripple * f64::from((c + r) % 2))
    };
    let positions = (0..n * n).map(|k| at(k % n, k / n)).collect();
    let quads = (0..n - 1).flat_map(|r| (0..n - 1).map(move |c| r * n + c));
    let triangles = quads.flat_map(|a| [[a, a + 1, a + n], [a + 1, a + n + 1, a + n]]).collect();
    TriangleMesh { positions, triangles }
}

fn add(server: &Running, n: u32) -> TriangleMesh {
    let vault = &server.hub.vault;
    let mut scan = hill(n, 0.06);
    scan.positions.iter_mut().for_each(|p| *p += Vec3::from(MOVED));
    let source = |name: &str, mesh: &TriangleMesh| {
        let at = vault.add_file(name, |path| Ok(write_ply(path, mesh, PlyOptions::default())?)).unwrap();
        Source { at, name: name.to_owned(), unit: Unit::Mm }
    };
    let template = Some(source("template.ply", &hill(41, 0.0)));
    let case = Case { template, scans: vec![source("scan.ply", &scan)], scan: Some(0), ..Case::default() };
    vault.add_case(&case).unwrap();
    scan
}

/// Shown, picked and wrapped; seconds until it is shown, of a pick, and of the wrap.
fn work_on(n: u32) -> (Value, [f64; 3]) {
    let server = Running::start();
    let scan = add(&server, n);
    let clock = Instant::now();
    let mut page = server.page_of_case();
    let shown = page.numbers("scan");
    let opened = clock.elapsed().as_secs_f64();
    let all = scan.triangles.len() as u64;
    assert_eq!(shown["of"], all);
    assert!((50_000..=400_000).contains(&shown["triangles"].as_u64().unwrap()), "{shown}");

    let mut picked = 0.0;
    for (k, share) in [0.23, 0.41, 0.58, 0.77].into_iter().enumerate() {
        // a point of the whole scan is found as it is, whatever is shown
        let (c, r) = ((share * f64::from(n)) as u32 + 30, ((1.0 - share) * f64::from(n)) as u32);
        let (c, r) = (c.min(n - 2), r.min(n - 2));
        let vertex = scan.positions[(r * n + c) as usize];
        let place = |page: &mut Page, side: &str, p: Vec3| {
            let point: [f64; 3] = p.into();
            page.send(&json!({ "type": "place", "name": format!("p{k}"), "side": side, "point": point }));
            page.wait("case")
        };
        place(&mut page, "template", vertex - Vec3::from(MOVED));
        let clock = Instant::now();
        let case = place(&mut page, "scan", vertex);
        picked = clock.elapsed().as_secs_f64();
        let pairs = case["case"]["wrap"]["pairs"].as_array().unwrap();
        let found = pairs.iter().find(|p| p["name"] == format!("p{k}")).unwrap();
        let found = Vec3::from_fn(|axis, _| found["target"][axis].as_f64().unwrap());
        assert!((found - vertex).norm() < 1e-4, "{found} {vertex}");
    }
    let mut settings = serde_json::to_value(studio::case::WrapSettings::default()).unwrap();
    settings["model"] = "rigid".into();
    page.send(&json!({ "type": "edit", "edit": { "edit": "set_wrap", "settings": settings } }));
    page.wait("case");
    let clock = Instant::now();
    page.send(&json!({ "type": "run", "warm": false }));
    let case = page.wait("case");
    let wrapped = clock.elapsed().as_secs_f64();
    (case["case"]["wrapped"]["summary"].clone(), [opened, picked, wrapped])
}

#[test]
fn a_scan_of_half_a_million_triangles_is_shown_thinned_out_and_worked_on_whole() {
    let (summary, _) = work_on(501);
    assert!(summary["within"].as_f64().unwrap() > 0.98, "{summary}");
    assert!(summary["median"].as_f64().unwrap() < 0.1, "{summary}");
}

#[test]
#[ignore = "a measurement: cargo test --release -p studio --test server five_million -- --ignored --nocapture"]
fn five_million_triangles() {
    let (summary, [opened, picked, wrapped]) = work_on(1582);
    println!("shown after {opened:.1} s, a pick takes {picked:.2} s, a rigid wrap {wrapped:.1} s: {summary}");
}
