//! Jobs that run while the user goes on: what they show, and what is kept of them.

use serde_json::{Value, json};
use studio::case::Case;

use crate::client::{Page, Running, edit};

/// A grid of so many points each way, 100 mm wide, whose bumps have this height.
fn grid(n: usize, height: f64) -> String {
    let step = 100.0 / (n - 1) as f64;
    let place = |k: usize| ((k % n) as f64 * step, (k / n) as f64 * step);
    let vertices = (0..n * n).map(place).map(|(x, y)| {
        let z = height * (x / 17.0).sin() * (y / 23.0).cos();
        format!("v {x} {y} {z}\n")
    });
    let corners = (0..n - 1).flat_map(|r| (1..n).map(move |c| r * n + c));
    let faces = corners.map(|a| format!("f {} {} {} {}\n", a, a + 1, a + n + 1, a + n));
    vertices.chain(faces).collect()
}

/// A case that takes a second or so to wrap, with two scans.
fn add_case(server: &Running, name: &str) -> u32 {
    let template = Some(server.source("flat.obj", &grid(71, 2.0)));
    let scans = vec![server.source("bumpy.obj", &grid(91, 8.0)), server.source("other.obj", &grid(81, 6.0))];
    let case = Case { name: name.to_owned(), template, scans, scan: Some(0), ..Case::default() };
    server.hub.vault.add_case(&case).unwrap()
}

const WRAP: fn() -> Value = || json!({ "type": "run", "warm": false });

/// All that the page is sent until nothing runs any more.
fn until_idle(page: &mut Page) -> Vec<(Value, Vec<u8>)> {
    let mut heard = Vec::new();
    loop {
        let message = page.anything();
        let ends = message.0["type"] == "idle";
        heard.push(message);
        if ends {
            return heard;
        }
    }
}

/// The positions that the page shows at the end as the result.
fn shown(heard: &[(Value, Vec<u8>)]) -> Option<Vec<u8>> {
    let of_result = |header: &Value| header["slot"] == "wrapped" && header["numbers"] != "values";
    let (header, bytes) = heard.iter().rev().find(|(header, _)| of_result(header))?;
    (header["numbers"] == "positions").then(|| bytes.clone())
}

fn error(heard: &[(Value, Vec<u8>)]) -> Option<&str> {
    heard.iter().find(|(message, _)| message["type"] == "error")?.0["text"].as_str()
}

#[test]
fn one_client_s_job_is_not_shown_in_another_one_s_case() {
    let server = Running::start();
    let (ben, anna) = (add_case(&server, "Ben"), add_case(&server, "Anna"));
    let mut page = server.page();
    assert_eq!(page.wait("case")["id"], anna);
    page.send(&WRAP());
    page.wait("step");
    page.send(&json!({ "type": "open_case", "id": ben }));
    while page.wait("case")["id"] != ben {}
    let heard = until_idle(&mut page);
    assert_eq!(shown(&heard), None);
    assert!(!heard.iter().any(|(message, _)| message["type"] == "step"));
    let whose = heard.iter().filter(|(message, _)| message["type"] == "progress").skip(1);
    assert!(whose.clone().count() > 0 && whose.clone().all(|m| m.0["what"].as_str().unwrap().starts_with("Anna: ")));
    // it is Anna's all the same
    let wrapped = |id| server.hub.vault.case(id).unwrap().case.wrapped.is_some();
    assert_eq!((wrapped(anna), wrapped(ben)), (true, false));
}

#[test]
fn after_a_cancelled_run_the_result_that_is_kept_is_shown() {
    let server = Running::start();
    add_case(&server, "Anna");
    let mut page = server.page_of_case();
    let cancelled = |page: &mut Page| {
        page.send(&WRAP());
        while page.numbers("wrapped")["numbers"] != "positions" {}
        page.send(&json!({ "type": "cancel" }));
        let heard = until_idle(page);
        assert!(error(&heard).unwrap().contains("cancelled"));
        heard
    };
    // without a result there is none
    assert!(cancelled(&mut page).iter().any(|(m, _)| m["numbers"] == "clear" && m["slot"] == "wrapped"));
    page.send(&WRAP());
    let kept = shown(&until_idle(&mut page)).unwrap();
    assert!(shown(&cancelled(&mut page)).unwrap() == kept);
    // the same wrap again changes nothing of the case, but on the way to it other positions were shown
    page.send(&WRAP());
    assert!(shown(&until_idle(&mut page)).unwrap() == kept);
}

#[test]
fn a_result_of_what_was_replaced_meanwhile_is_not_kept() {
    let server = Running::start();
    let id = add_case(&server, "Anna");
    let mut page = server.page_of_case();
    let kept = || server.hub.vault.case(id).unwrap().case.wrapped.is_some();
    let unit = |which: &str, unit: &str| edit(json!({ "edit": "set_unit", "which": which, "unit": unit }));
    for (what, which) in [("the template", "template"), ("the scan", "scan")] {
        page.send(&WRAP());
        page.wait("step");
        page.send(&unit(which, "cm"));
        let heard = until_idle(&mut page);
        let text = error(&heard).unwrap();
        assert!(text.contains(what) && text.contains("start it again"), "{text}");
        assert!(!kept(), "{what}");
        page.send(&unit(which, "mm"));
        page.wait("case");
    }
    // the choice of another scan replaces nothing: the result is there when the first one is chosen again
    page.send(&WRAP());
    page.wait("step");
    page.send(&edit(json!({ "edit": "use_scan", "index": 1 })));
    page.wait("case");
    let heard = until_idle(&mut page);
    assert_eq!((error(&heard), kept()), (None, true));
    assert!(!heard.iter().any(|(message, _)| message["type"] == "step"));
}

#[test]
fn a_comparison_ends_when_another_client_is_opened() {
    let server = Running::start();
    let (ben, _) = (add_case(&server, "Ben"), add_case(&server, "Anna"));
    let mut page = server.page_of_case();
    page.send(&json!({ "type": "compare", "models": ["arap", "graph", "free"] }));
    page.wait("step");
    page.send(&json!({ "type": "open_case", "id": ben }));
    while page.wait("case")["id"] != ben {}
    let heard = until_idle(&mut page);
    assert!(!heard.iter().any(|(message, _)| message["type"] == "compared" || message["slot"] == "compare/arap"));
    assert!(error(&heard).unwrap().starts_with("Anna: the comparison has ended"));
}

#[test]
fn landmarks_found_on_a_scan_do_not_go_onto_another_one() {
    let server = Running::start();
    let id = studio::demo::add(&server.hub.vault).unwrap();
    let mut page = server.page_of_case();
    page.send(&json!({ "type": "suggest" }));
    page.wait("progress");
    page.send(&edit(json!({ "edit": "use_scan", "index": 1 })));
    let heard = until_idle(&mut page);
    assert!(error(&heard).unwrap().contains("the scan"), "{:?}", error(&heard));
    assert!(server.hub.vault.case(id).unwrap().case.wrap.pairs.iter().all(|pair| pair.target.is_none()));
}

#[test]
fn what_was_meant_for_another_client_is_not_done() {
    let server = Running::start();
    let (anna, ben) = (server.add_sheet(), server.add_sheet());
    let mut page = server.page();
    assert_eq!(page.wait("case")["id"], ben);
    let add = server.adding("photo", &[("a.png", b"\x89PNG\r\n\x1a\n")], None);
    let name = json!({ "edit": "describe", "name": "x", "date": "", "notes": "" });
    for message in
        [add, json!({ "type": "edit", "plan": 1, "revision": 1, "edit": name }), json!({ "type": "suggest" })]
    {
        let mut message = message;
        message["case"] = anna.into();
        page.text(&message.to_string());
        let error = page.wait("error")["text"].as_str().unwrap().to_owned();
        assert!(error.contains("not open any more"), "{message}: {error}");
    }
    assert_eq!((server.waiting(), server.hub.vault.case(ben).unwrap().revision), (0, 1));
}
