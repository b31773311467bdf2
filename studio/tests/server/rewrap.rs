//! A landmark is corrected after a wrap, and the wrap follows.

use std::time::Instant;

use serde_json::{Value, json};

use crate::client::{Page, Running};

/// Seconds until the wrap is shown and kept, by where it starts; and the case then.
fn run(page: &mut Page, warm: bool) -> (f64, Value) {
    let clock = Instant::now();
    page.send(&json!({ "type": "run", "warm": warm }));
    let mut parts = Vec::new();
    let case = loop {
        let message = page.next();
        let what = message["type"].as_str().unwrap().to_owned();
        let what = if what == "progress" { message["what"].as_str().unwrap().to_owned() } else { what };
        if parts.last().is_none_or(|(last, _): &(String, f64)| *last != what) {
            parts.push((what.clone(), clock.elapsed().as_secs_f64()));
        }
        if what == "case" {
            break message["case"].clone();
        }
    };
    let seconds = clock.elapsed().as_secs_f64();
    page.wait("idle");
    let parts: Vec<String> = parts.iter().map(|(what, at)| format!("{what} {at:.2}")).collect();
    println!("{}", parts.join(", "));
    (seconds, case)
}

/// Puts a landmark a few millimetres beside where it is; where it is then, by name.
fn correct(page: &mut Page, case: &Value, pair: usize, by: f64) {
    let pair = &case["wrap"]["pairs"][pair];
    let at: Vec<f64> = (0..3).map(|k| pair["target"][k].as_f64().unwrap()).collect();
    page.send(
        &json!({ "type": "place", "name": pair["name"], "side": "scan", "point": [at[0] + by, at[1] + by, at[2]] }),
    );
    page.wait("case");
}

fn demo() -> (Running, Page, Value) {
    let server = Running::start();
    studio::demo::add(&server.hub.vault).unwrap();
    let mut page = server.page_of_case();
    page.send(&json!({ "type": "suggest" }));
    page.wait("case");
    page.wait("idle");
    let (seconds, case) = run(&mut page, false);
    println!("cold: {seconds:.2} s, {} steps", case["wrapped"]["summary"]["steps"]);
    (server, page, case)
}

#[test]
#[ignore = "a measurement: cargo test --release -p studio --test server rewrap -- --ignored --nocapture"]
fn seconds_after_a_landmark_was_corrected() {
    let (_server, mut page, mut case) = demo();
    for k in 0..6 {
        correct(&mut page, &case, 5 + 7 * k, 1.0);
        let seconds;
        (seconds, case) = run(&mut page, true);
        println!("warm: {seconds:.2} s, {} steps", case["wrapped"]["summary"]["steps"]);
    }
}
