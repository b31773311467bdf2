//! Fine sculpting while a handle is dragged: each frame goes on from the one before, and letting go replays the plan.

use std::time::Instant;

use data_gen::{FaceOptions, FaceRig, write_rig};
use serde_json::{Value, json};
use studio::case::{Case, FileRef, Source, Unit};

use crate::client::{Page, Running, edit};

/// A case of a generated face with a rig, shown on a page.
fn face_shown(vertices: usize) -> (Running, Page) {
    let server = Running::start();
    let vault = &server.hub.vault;
    let incoming = vault.incoming().unwrap();
    write_rig(&incoming.folder, &FaceRig::generate(&FaceOptions { vertices, identity_modes: 20 })).unwrap();
    let asset = vault.take(&incoming).unwrap();
    let source = |file: &str| {
        let at = FileRef { asset: asset.clone(), file: file.to_owned() };
        Some(Source { at, name: "face".to_owned(), unit: Unit::Mm })
    };
    let case = Case { template: source("template.obj"), rig: source(""), ..Case::default() };
    vault.add_case(&case).unwrap();
    let mut page = server.page_of_case();
    page.wait("plan");
    (server, page)
}

/// A step that moves a disc of the face outwards by so much.
fn step(model: &str, radius: f64, by: f64) -> Value {
    let drawing = json!({ "circle": { "centre": [0.0, 0.0], "radius": radius } });
    json!({
        "name": "disc", "model": model, "soft": 4.0, "displacement": [0.0, 0.0, by], "mirror": false, "through": true,
        "protect": [], "pins": [],
        "mask": { "drawn": { "from": { "frame": { "yaw": 0.0, "pitch": 0.0 } }, "drawing": drawing } },
    })
}

fn add(step: Value) -> Value {
    json!({ "edit": "add_step", "step": step })
}

/// The plan as it is after this edit is tried: its message.
fn preview(page: &mut Page, edit: &Value) -> Value {
    page.send(&json!({ "type": "preview", "edit": edit }));
    let plan = page.wait("plan");
    assert_eq!((&plan["preview"], &plan["error"]), (&json!(true), &Value::Null), "{plan}");
    plan
}

/// Milliseconds of the first preview of a drag, and the mean of those after it, as the page sees them; and how many vertices move.
fn drag(page: &mut Page, model: &str, radius: f64) -> (f64, f64, u64, u64) {
    let mut times = Vec::new();
    let (mut moving, mut iterations) = (0, 0);
    for k in 0..11 {
        let clock = Instant::now();
        let plan = preview(page, &add(step(model, radius, 1.0 + 0.2 * f64::from(k))));
        page.numbers("plan");
        times.push(1e3 * clock.elapsed().as_secs_f64());
        moving = plan["results"][0]["moving"].as_u64().unwrap();
        iterations = plan["results"][0]["iterations"].as_u64().unwrap();
    }
    (times[0], times[1..].iter().sum::<f64>() / 10.0, moving, iterations)
}

#[test]
fn a_drag_goes_on_from_frame_to_frame_and_letting_go_replays_the_plan() {
    let (_server, mut page) = face_shown(6000);
    for model in ["direct", "free", "arap", "graph", "hybrid"] {
        let (_, _, moving, iterations) = drag(&mut page, model, 45.0);
        assert!(moving > 1000 && iterations <= 2, "{model}: {moving} vertices move, {iterations} iterations");
        // a frame goes on from the one before: where nothing changes any more, nothing is left to do
        let ends: Vec<Value> = (0..12)
            .map(|_| preview(&mut page, &add(step(model, 45.0, 3.0)))["results"][0]["iterations"].take())
            .collect();
        let last = ends[11].as_u64().unwrap();
        assert!(last <= u64::from(model != "direct"), "{model}: {ends:?}");
        // what is let go does not depend on how it was dragged
        let reached = |page: &mut Page| {
            page.send(&edit(add(step(model, 45.0, 3.0))));
            let mut plan = page.wait("plan");
            plan["milliseconds"].take();
            page.send(&json!({ "type": "undo" }));
            page.wait("plan");
            plan
        };
        let dragged = reached(&mut page);
        preview(&mut page, &add(step(model, 20.0, 1.0)));
        assert_eq!(reached(&mut page), dragged, "{model}");
    }
}

/// Prints the table of the README.
#[test]
#[ignore = "a measurement: cargo test --release -p studio --test server sculpting -- --ignored --nocapture"]
fn milliseconds_at_ten_thousand_moving_vertices() {
    let (_server, mut page) = face_shown(15_000);
    for model in ["direct", "free", "arap", "graph", "hybrid"] {
        let (first, later, moving, iterations) = drag(&mut page, model, 60.0);
        println!(
            "{model}: {moving} of 15000 vertices move; first {first:.0} ms, then {later:.0} ms a frame, {iterations} iterations"
        );
    }
}
