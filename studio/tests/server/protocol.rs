//! What messages come to, friendly and hostile.

use serde_json::{Value, json};
use studio::case::FileRef;
use studio::session::MOST_UPLOADS;
use zip::ZipArchive;

use crate::client::{Page, Running, edit, no_file, scaled_sheet, sheet};

#[test]
fn a_page_is_greeted_and_shown_the_case() {
    let server = Running::start();
    let id = server.add_sheet();
    let mut page = server.page();
    let case = page.wait("case");
    assert_eq!(case["id"], id);
    let template = page.numbers("template");
    assert_eq!((&template["vertices"], &template["triangles"]), (&json!(441), &json!(800)));
    assert_eq!(page.numbers("scan")["triangles"], 800);
    assert_eq!(page.numbers("face")["lines"], 840);
}

#[test]
fn a_client_without_a_face_has_a_plan_of_its_own() {
    let (_server, _, mut page) = Running::with_sheet();
    page.send(&edit(json!({ "edit": "add_step", "step": bump(false) })));
    while page.wait("plan")["steps"].as_array().unwrap().is_empty() {}
    page.send(&json!({ "type": "new_case", "name": "Second" }));
    while page.wait("case")["case"]["name"] != "Second" {}
    let plan = page.wait("plan");
    assert_eq!((&plan["steps"], &plan["command"], &plan["preview"]), (&json!([]), &json!(""), &json!(false)));
    // what is planned before there is a face is listed
    page.send(&edit(json!({ "edit": "set_preset", "preset": "nose-tip", "amount": 2.0, "side": "both" })));
    assert_eq!(page.wait("plan")["steps"][0]["amount"], 2.0);
}

#[test]
fn a_page_that_comes_again_is_shown_its_own_client() {
    let server = Running::start();
    let [first, second] = [server.add_sheet(), server.add_sheet()];
    let mut other = server.page();
    other.send(&json!({ "type": "open_case", "id": second }));
    while other.wait("case")["id"] != second {}
    assert_eq!(server.page().wait("case")["id"], second);
    assert_eq!(server.page_of(&format!("?client={first}")).wait("case")["id"], first);
    // never another one in its place
    other.send(&json!({ "type": "delete_case", "id": first }));
    assert_eq!(other.wait("note")["text"], "Unnamed is deleted.");
    let mut gone = server.page_of(&format!("?client={first}"));
    assert_eq!(gone.next()["type"], "no_case");
    assert!(gone.wait("error")["text"].as_str().unwrap().contains("not there any more"));
    assert!(other.refused(&json!({ "type": "delete_case", "id": first })).contains("not there any more"));
}

#[test]
fn malformed_messages_are_answered_and_end_nothing() {
    let (_server, _, mut page) = Running::with_sheet();
    let deep = "[".repeat(100_000);
    for text in [
        "",
        "{",
        "null",
        "[]",
        "{\"type\":\"fly\"}",
        "{\"type\":\"edit\"}",
        &deep,
        "{\"type\":\"place\",\"name\":null,\"side\":\"scan\",\"point\":[1,2]}",
    ] {
        page.text(text);
        // nor with what a parser says of it
        let answer = page.wait("error")["text"].clone();
        assert_eq!(answer, "the page sent what the server does not understand: reload the page", "{text:.40}");
    }
    page.bytes(&[0; 64]);
    page.wait("error");
    let hostile = [
        json!({ "type": "open_case", "id": 4_000_000_000u32 }),
        json!({ "type": "delete_case", "id": 99 }),
        json!({ "type": "undo" }),
        json!({ "type": "redo" }),
        json!({ "type": "place", "name": null, "side": "scan", "point": [1e300, 0.0, 0.0] }),
        json!({ "type": "paint_mask", "weights": [0.5, 2.0] }),
        json!({ "type": "blend", "from": null, "to": 77, "share": 0.5, "difference": true }),
        json!({ "type": "blend", "from": null, "to": 1, "share": 7.0, "difference": true }),
        json!({ "type": "analyse", "plans": [1, 2, 3, 4, 5, 6, 7, 8, 9] }),
        json!({ "type": "export", "what": { "export": "face", "format": "../../x" } }),
        json!({ "type": "export", "what": { "export": "wrapped", "format": "obj" } }),
        json!({ "type": "add", "role": "scan", "files": [], "unit": null }),
        json!({ "type": "add", "role": "scan", "files": [{ "id": "../../etc", "name": "passwd" }], "unit": null }),
        json!({ "type": "add", "role": "rig", "files": [{ "id": "x", "name": "../../../etc/passwd" }], "unit": null }),
        json!({ "type": "compare", "models": [] }),
        edit(json!({ "edit": "use_scan", "index": 9 })),
        edit(json!({ "edit": "use_plan", "id": 9 })),
        edit(json!({ "edit": "remove_plan", "id": 1 })),
        edit(json!({ "edit": "rename_pair", "name": "a", "to": "b" })),
        edit(json!({ "edit": "set_preset", "preset": "no such", "amount": 1.0, "side": "both" })),
        edit(json!({ "edit": "move_step", "from": 3, "to": 4_000_000_000u32 })),
        edit(json!({ "edit": "set_recipe", "recipe": "step = 7" })),
        edit(
            json!({ "edit": "set_recipe", "recipe": "[[step]]\n[[step.mask]]\npng = '/etc/passwd'\ndisplacement = [0, 0, 1]" }),
        ),
        edit(json!({ "edit": "describe", "name": " ", "date": "", "notes": "" })),
        edit(json!({ "edit": "describe", "name": "x", "date": "", "notes": "x".repeat(200_000) })),
    ];
    for message in hostile {
        println!("{message:.200}");
        let text = page.refused(&message);
        assert!(
            text.len() > 10 && !text.contains("panicked") && !text.contains("something went wrong inside"),
            "{message}: {text}"
        );
    }
    // and the window still works, with nothing changed
    page.send(&json!({ "type": "place", "name": "nose", "side": "template", "point": [51.0, 70.0, 5.0] }));
    let case = page.wait("case");
    assert_eq!((&case["revision"], &case["case"]["wrap"]["pairs"][0]["vertex"]), (&json!(2), &json!(220)));
}

#[test]
fn landmarks_stay_on_a_scan_whose_unit_is_corrected() {
    let (_server, _, mut page) = Running::with_sheet();
    page.send(&json!({ "type": "place", "name": "nose", "side": "scan", "point": [51.0, 70.0, 5.0] }));
    let place = |case: &Value| -> Vec<f64> {
        serde_json::from_value(case["case"]["wrap"]["pairs"][0]["target"].clone()).unwrap()
    };
    let placed = page.wait("case");
    page.send(&edit(json!({ "edit": "set_unit", "which": "scan", "unit": "cm" })));
    let other = page.wait("case");
    assert_eq!(place(&other), place(&placed).iter().map(|x| 10.0 * x).collect::<Vec<_>>());
    // that of the template is no matter of places on the scan
    page.send(&edit(json!({ "edit": "set_unit", "which": "template", "unit": "cm" })));
    assert_eq!(place(&page.wait("case")), place(&other));
    page.send(&json!({ "type": "undo" }));
    page.wait("case");
    page.send(&json!({ "type": "undo" }));
    let back = page.wait("case");
    assert_eq!((place(&back), &back["case"]["scans"][0]["unit"]), (place(&placed), &json!("mm")));
}

/// A step that was drawn on the sheet by a camera.
fn bump(mirror: bool) -> Value {
    json!({
        "name": "bump", "model": "direct", "soft": 3.0, "displacement": [0.0, 0.0, 2.0], "mirror": mirror, "through": true,
        "protect": [], "pins": [],
        "mask": { "drawn": { "from": { "camera": { "eye": [50.0, 70.0, 500.0], "target": [50.0, 70.0, 0.0], "up": [0.0, 1.0, 0.0], "height": 200.0, "size": [400, 400] } },
            "drawing": { "circle": { "centre": [200.0, 200.0], "radius": 60.0 } } } },
    })
}

#[test]
fn a_preview_keeps_nothing() {
    let (server, id, mut page) = Running::with_sheet();
    let step = json!({ "edit": "add_step", "step": bump(false) });
    page.wait("plan");
    page.send(&json!({ "type": "preview", "edit": step }));
    let plan = page.wait("plan");
    assert_eq!((&plan["preview"], &plan["error"]), (&json!(true), &Value::Null), "{plan}");
    assert!(plan["results"][0]["reached"].as_f64().unwrap() > 1.9, "{plan}");
    assert_eq!(server.hub.vault.case(id).unwrap().revision, 1);
    page.send(&edit(step));
    let plan = page.wait("plan");
    assert_eq!(plan["preview"], false);
    assert!(plan["command"].as_str().unwrap().starts_with("nonrigid morph --mesh "), "{plan}");
    assert_eq!(server.hub.vault.case(id).unwrap().revision, 2);
}

#[test]
fn a_face_without_left_and_right_has_no_sides() {
    let (server, id, mut page) = Running::with_sheet();
    let preset =
        |side: &str| edit(json!({ "edit": "set_preset", "preset": "nose-bridge", "amount": 1.0, "side": side }));
    for message in [preset("left"), edit(json!({ "edit": "add_step", "step": bump(true) }))] {
        let text = page.refused(&message);
        assert!(text.contains("left from its right") && text.contains("add a rig with 68 landmarks"), "{text}");
    }
    page.send(&edit(json!({ "edit": "add_step", "step": bump(false) })));
    page.wait("case");
    for change in [json!({ "mirror": true }), json!({ "side": "right" })] {
        let text = page.refused(&edit(json!({ "edit": "change_step", "index": 0, "change": change })));
        assert!(text.contains("draw the step again"), "{text}");
    }
    // nor has a step that another recipe states in a frame of landmarks that are not there
    let framed = "[frame]\norigin = ['a']\nright = ['a', 'b']\nup = ['a', 'c']\n[[step]]\n[[step.mask]]\nparts = ['lips']\ndisplacement = [0, 0, 1]\n";
    page.send(&edit(json!({ "edit": "set_recipe", "recipe": framed })));
    page.wait("case");
    let text = page.refused(&edit(json!({ "edit": "change_step", "index": 0, "change": { "side": "right" } })));
    assert!(text.contains("left from its right"), "{text}");
    assert_eq!(server.hub.vault.case(id).unwrap().revision, 3);
}

#[test]
fn an_edit_of_what_another_window_has_changed_is_refused() {
    let server = Running::start();
    let id = server.add_sheet();
    let [mut one, mut two] = [server.page_of_case(), server.page_of_case()];
    let rename = |name: &str| edit(json!({ "edit": "rename_plan", "name": name }));
    let names =
        || -> Vec<String> { server.hub.vault.case(id).unwrap().case.plans.into_iter().map(|p| p.name).collect() };
    // one's plan is not in work any more, which it has not seen
    two.send(&edit(json!({ "edit": "new_plan", "name": "theirs", "copy_of": null })));
    assert_eq!(two.wait("case")["case"]["plan"], 2);
    let text = one.refused(&rename("mine"));
    assert!(text.contains("in another window") && text.contains("nothing was done"), "{text}");
    assert_eq!(names(), ["Plan A", "theirs"]);
    // by now it has, and may; several in a row need not wait for each other
    one.send(&rename("x"));
    one.send(&rename("y"));
    one.send(&rename("z"));
    while names() != ["Plan A", "z"] {
        assert_eq!(one.wait("case")["type"], "case");
    }
    // the same number of revisions, but others
    two.send(&json!({ "type": "undo" }));
    while two.wait("case")["redo"] != "plan's name z" {}
    two.send(&rename("w"));
    two.wait("case");
    one.refused(&rename("v"));
    assert_eq!(names(), ["Plan A", "w"]);
}

#[test]
fn a_failing_job_ends_alone() {
    let server = Running::start();
    server.add_sheet();
    let [mut one, mut two] = [server.page_of_case(), server.page_of_case()];
    // blendshapes without a rig
    let mut settings = serde_json::to_value(studio::case::WrapSettings::default()).unwrap();
    settings["model"] = "blendshape".into();
    one.send(&edit(json!({ "edit": "set_wrap", "settings": settings })));
    one.wait("case");
    two.wait("case");
    let text = one.refused(&json!({ "type": "run", "warm": false }));
    assert!(text.contains("add a rig"), "{text}");
    one.wait("idle");
    two.send(&json!({ "type": "compare", "models": ["rigid", "blendshape", "free"] }));
    let rows: Vec<Value> = (0..3).map(|_| two.wait("compared")["row"].clone()).collect();
    assert!(rows[0]["summary"]["within"].as_f64().unwrap() > 0.99, "{rows:?}");
    assert!(rows[1]["error"].as_str().unwrap().contains("add a rig"), "{rows:?}");
    assert!(rows[2]["summary"].is_object(), "{rows:?}");
    two.wait("idle");
}

#[test]
fn files_join_a_case_under_their_names_and_broken_ones_are_named() {
    let server = Running::start();
    let mut page = server.page();
    page.send(&json!({ "type": "new_case", "name": "<img src=x onerror=alert(1)>" }));
    assert_eq!(page.wait("case")["case"]["name"], "<img src=x onerror=alert(1)>");
    page.send(&server.adding("template", &[("face.obj", sheet().as_bytes())], None));
    assert_eq!(page.wait("case")["case"]["template"]["name"], "face.obj");
    // a size that is no face's in any unit is asked for
    let mut tiny = server.adding("scan", &[("tiny.obj", scaled_sheet(1e-9).as_bytes())], None);
    page.send(&tiny);
    let wanted = page.wait("unit_wanted");
    assert!(wanted["units"].as_array().unwrap().len() >= 2, "{wanted}");
    page.wait("idle");
    assert_eq!(server.waiting(), 1);
    tiny["unit"] = "mm".into();
    page.send(&tiny);
    assert_eq!(page.wait("case")["case"]["scans"][0]["unit"], "mm");
    for (name, bytes) in [
        ("bad.ply", &b"ply\nformat ascii 1.0\nelement vertex -3\n"[..]),
        ("bad.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff"),
        ("bad.stl", b"solid"),
        ("bad.obj.gz", b"\x1f\x8b\x08"),
        (
            "outside.gltf",
            br#"{"asset":{"version":"2.0"},"buffers":[{"uri":"../../../../../../etc/passwd","byteLength":12}]}"#,
        ),
    ] {
        let text = page.refused(&server.adding("scan", &[(name, bytes)], Some("mm")));
        assert!(text.contains(name) && !text.contains("incoming"), "{name}: {text}");
        assert_eq!(server.waiting(), 0, "{name} is refused and stays");
    }
}

#[test]
fn what_cannot_join_is_named_without_the_server_s_folders() {
    let (server, _, mut page) = Running::with_sheet();
    let mut refused = |role: &str, files: &[(&str, &[u8])]| {
        let text = page.refused(&server.adding(role, files, Some("mm")));
        assert!(!text.contains("incoming") && !text.contains(server.folder.path().to_str().unwrap()), "{text}");
        text
    };
    for role in ["scan_landmarks", "template_landmarks", "recipe", "scan", "template", "rig"] {
        let text = refused(role, &[("garbage.json", b"\xff\x00{")]);
        assert!(text.contains("garbage.json"), "{role}: {text}");
    }
    assert!(refused("photo", &[("x.png", b"no picture at all")]).contains("x.png is no picture"));
    let text = refused("rig", &[("template.obj", sheet().as_bytes()), ("template.obj", b"v 0 0 0"), ("a.obj", b"")]);
    assert!(text.contains("two files are called template.obj"), "{text}");
}

#[test]
fn materials_come_and_go_with_a_mesh_or_are_missed() {
    let (server, mut page) = Running::with_empty_case();
    let text = format!("mtllib face.mtl\nusemtl skin\n{}", sheet());
    let mut add = |files: &[(&str, &[u8])]| {
        page.send(&server.adding("template", files, Some("mm")));
        let mut notes = Vec::new();
        loop {
            let message = page.next();
            match message["type"].as_str().unwrap() {
                "note" => notes.push(message["text"].as_str().unwrap().to_owned()),
                "idle" => return notes,
                _ => {}
            }
        }
    };
    let face = ("face.obj", text.as_bytes());
    let [note] = &add(&[face])[..] else { panic!("one note") };
    assert!(note.starts_with("face.obj names face.mtl, which did not come with it"), "{note}");
    assert!(add(&[face, ("face.mtl", b"newmtl skin\nmap_Kd skin.png\n"), ("skin.png", b"\x89PNG")]).is_empty());

    page.send(&edit(json!({ "edit": "add_step", "step": bump(false) })));
    page.wait("case");
    let mut saved = |format: &str| {
        page.send(&json!({ "type": "export", "what": { "export": "face", "format": format } }));
        let at: FileRef = serde_json::from_value(page.wait("exported")["at"].clone()).unwrap();
        at
    };
    let at = saved("obj");
    assert_eq!(at.file, "morphed.zip");
    let zip = ZipArchive::new(std::fs::File::open(server.hub.vault.path(&at).unwrap()).unwrap()).unwrap();
    let mut names: Vec<&str> = zip.file_names().collect();
    names.sort_unstable();
    assert_eq!(names, ["morphed.mtl", "morphed.obj", "morphed_skin.png"]);
    assert_eq!(saved("ply").file, "morphed.ply");
}

#[test]
fn a_face_without_a_rig_is_measured_by_those_landmarks_that_have_a_name_for_it() {
    let (_server, _, mut page) = Running::with_sheet();
    for (name, y) in [(json!("nasion"), 90.0), (json!("menton"), 10.0), (Value::Null, 50.0)] {
        page.send(&json!({ "type": "place", "name": name, "side": "template", "point": [51.0, y, 5.0] }));
        page.wait("case");
    }
    page.send(&json!({ "type": "analyse", "plans": [] }));
    let answer = loop {
        let message = page.next();
        if ["analysis", "error"].contains(&message["type"].as_str().unwrap()) {
            break message;
        }
    };
    assert_eq!(answer["type"], "analysis", "{answer}");
    assert!(answer["analysis"]["rows"].as_array().unwrap().iter().any(|row| row["values"][0].is_number()));
}

#[test]
fn landmarks_and_mask_go_with_a_template_of_other_vertices() {
    let (server, _, mut page) = Running::with_sheet();
    page.send(&json!({ "type": "place", "name": "nose", "side": "template", "point": [51.0, 70.0, 5.0] }));
    page.wait("case");
    let mut pinned = bump(false);
    (pinned["model"], pinned["pins"]) = (json!("arap"), json!([7]));
    for step in [pinned, bump(false)] {
        page.send(&edit(json!({ "edit": "add_step", "step": step })));
        page.wait("case");
    }
    page.send(&json!({ "type": "paint_mask", "weights": vec![0.5; 441] }));
    assert!(page.wait("case")["case"]["wrap"]["mask"].is_object());
    let mut replaced = |text: &str| {
        page.send(&server.adding("template", &[("new.obj", text.as_bytes())], Some("mm")));
        let case = page.wait("case")["case"].clone();
        let wrap = &case["wrap"];
        let steps = case["plans"][0]["recipe"].as_str().unwrap().matches("[[step]]").count();
        (wrap["pairs"][0]["vertex"].clone(), wrap["mask"].is_object(), steps)
    };
    // another shape of the same vertices keeps both
    assert_eq!(replaced(&sheet().replace("v 0 0 0\n", "v 0 0 1\n")), (json!(220), true, 2));
    // the same shape with the vertices in another order does not
    let (vertices, faces): (Vec<_>, Vec<_>) =
        sheet().lines().map(str::to_owned).partition(|line| line.starts_with('v'));
    let turned = |face: &String| {
        let corners = face.split(' ').skip(1).map(|v| (442 - v.parse::<u32>().unwrap()).to_string());
        format!("f {}", corners.collect::<Vec<_>>().join(" "))
    };
    let lines: Vec<String> = vertices.into_iter().rev().chain(faces.iter().map(turned)).collect();
    assert_eq!(replaced(&lines.join("\n")), (Value::Null, false, 1));
    let note = page.wait("note")["text"].clone();
    assert!(note.as_str().unwrap().contains("undo brings them back: bump (Plan A)"), "{note}");
}

#[test]
fn a_landmark_s_number_is_a_vertex_where_the_template_has_it() {
    let (server, _, mut page) = Running::with_sheet();
    let text = r#"{ "7": [10.0, 10.0, 5.0], "99999": [20.0, 20.0, 5.0] }"#;
    page.send(&server.adding("scan_landmarks", &[("marks.json", text.as_bytes())], None));
    let pairs = page.wait("case")["case"]["wrap"]["pairs"].clone();
    let vertex = |name: &str| pairs.as_array().unwrap().iter().find(|p| p["name"] == name).unwrap()["vertex"].clone();
    assert_eq!((vertex("7"), vertex("99999")), (json!(7), Value::Null));
}

#[test]
fn what_is_no_json_or_zip_is_said_without_its_parser_s_words() {
    let (server, _, mut page) = Running::with_sheet();
    for (role, name, text, said) in [
        ("scan_landmarks", "x.json", "hello", "x.json: line 1: expected JSON, found other text in column 1"),
        ("scan_landmarks", "x.json", "{\n", "x.json: line 2: expected JSON, found its end"),
        ("scan", "x.gltf", "[", "x.gltf: line 1: expected a glTF 2.0 file: glTF and version 2, or JSON, found its end"),
        ("rig", "x.npz", "hello", "x.npz: expected an NPZ (zip) archive, found another file, or a part of one"),
    ] {
        assert_eq!(page.refused(&server.adding(role, &[(name, text.as_bytes())], None)), said);
    }
}

#[test]
fn uploads_that_nobody_uses_make_room_for_new_ones() {
    let (server, mut page) = Running::with_empty_case();
    let first = server.adding("photo", &[("a.png", b"\x89PNG\r\n\x1a\n 1")], None);
    for _ in 0..MOST_UPLOADS - 1 {
        server.hub.keep_upload(server.hub.vault.incoming().unwrap());
    }
    let last = server.adding("photo", &[("a.png", b"\x89PNG\r\n\x1a\n 2")], None);
    assert_eq!(server.waiting(), MOST_UPLOADS);
    assert!(page.refused(&first).contains("add it again"));
    page.send(&last);
    assert_eq!(page.wait("case")["case"]["photos"][0]["name"], "a.png");
}

#[test]
fn a_case_whose_file_is_gone_says_so() {
    let server = Running::start();
    let mut case = studio::case::Case::default();
    case.template = Some(studio::case::Source { at: no_file(), name: "gone".to_owned(), unit: studio::case::Unit::Mm });
    // the rest is shown, and nothing stays of a scan that another one took the place of
    let there = server.source("sheet.obj", &sheet());
    let gone = server.source("gone.obj", &scaled_sheet(2.0));
    std::fs::remove_dir_all(server.folder.path().join("assets").join(&gone.at.asset)).unwrap();
    (case.scans, case.scan) = (vec![there, gone.clone()], Some(0));
    server.hub.vault.add_case(&case).unwrap();
    let mut page = server.page();
    page.wait("case");
    let shown = |page: &mut Page, slot: &str| while page.numbers(slot)["numbers"] != "mesh" {};
    shown(&mut page, "scan");
    assert!(page.wait("error")["text"].as_str().unwrap().contains("add it again"));
    page.send(&edit(json!({ "edit": "use_scan", "index": 1 })));
    assert_eq!(page.numbers("scan")["numbers"], "clear");
    assert!(page.wait("error")["text"].as_str().unwrap().contains("no file \"gone.obj\" any more; add it again"));
    // added again, it is there
    page.send(&server.adding("scan", &[("gone.obj", scaled_sheet(2.0).as_bytes())], None));
    assert_eq!(page.wait("case")["case"]["scans"][2]["at"]["asset"], gone.at.asset.as_str());
    shown(&mut page, "scan");
}

#[test]
fn landmarks_that_come_with_their_mesh_are_its_own() {
    let (server, page) = Running::with_empty_case();
    let mut page = page;
    let marks = r#"{"landmarks": [{"name": "a", "position": [5, 7, 0]}]}"#.as_bytes();
    let on_template = r#"{"landmarks": [{"name": "a", "vertex": 7}]}"#.as_bytes();
    page.send(&server.adding("template", &[("a.json", on_template), ("face.obj", sheet().as_bytes())], Some("mm")));
    while page.wait("case")["case"]["wrap"]["pairs"] == json!([]) {}
    page.send(&server.adding("scan", &[("a.obj", scaled_sheet(0.1).as_bytes()), ("A.JSON", marks)], Some("cm")));
    let pair = loop {
        let pair = page.wait("case")["case"]["wrap"]["pairs"][0].clone();
        if !pair["target"].is_null() {
            break pair;
        }
    };
    // in the scan's unit
    assert_eq!((&pair["vertex"], &pair["target"][0]), (&json!(7), &json!(50.0)));
    page.wait("idle");
    // they wait with their scan for its unit, and what is wrong with them leaves the scan there
    let files: [(&str, &[u8]); 2] =
        [("b.obj", scaled_sheet(1e-9).into_bytes().leak()), ("b.json", b"{\"landmarks\": \"x\"}")];
    page.send(&server.adding("scan", &files, None));
    let wanted = page.wait("unit_wanted");
    assert_eq!(wanted["files"].as_array().unwrap().len(), 2);
    let again = json!({ "type": "add", "role": "scan", "files": wanted["files"], "unit": "mm" });
    assert!(page.refused(&again).starts_with("b.json"));
    assert_eq!(server.hub.vault.cases("").unwrap()[0].scans, 2);
    assert_eq!(server.waiting(), 0);
}

#[test]
fn keys_of_a_schedule_without_effect_are_said() {
    let (server, _, mut page) = Running::with_sheet();
    let mut settings = serde_json::to_value(studio::case::WrapSettings::default()).unwrap();
    settings["model"] = "sumner".into();
    page.send(&edit(json!({ "edit": "set_wrap", "settings": settings })));
    page.wait("case");
    let own = include_str!("../../../src/model/schedules/sumner.toml").replace("coarse = true, ", "");
    let said = "mine.toml: model: coarse_nodes has no effect: no level is coarse";
    page.send(&server.adding("schedule", &[("mine.toml", own.as_bytes())], None));
    assert_eq!(page.wait("note")["text"], said);
    page.send(&json!({ "type": "run", "warm": false }));
    assert_eq!(page.wait("note")["text"], said);
    page.wait("idle");
}

#[test]
fn a_schedule_of_ones_own_is_checked_kept_and_part_of_the_command() {
    let (server, _, mut page) = Running::with_sheet();
    let mut settings = serde_json::to_value(studio::case::WrapSettings::default()).unwrap();
    settings["model"] = "arap".into();
    let set = |settings: &Value| edit(json!({ "edit": "set_wrap", "settings": settings }));
    page.send(&set(&settings));
    page.wait("case");
    let add = |name: &str, bytes: &[u8]| server.adding("schedule", &[(name, bytes)], None);
    let own = include_str!("../../../src/model/schedules/arap.toml");
    for (name, text) in [
        ("empty.toml", ""),
        ("odd.toml", "levels = 3\n"),
        ("blendshape.toml", include_str!("../../../src/model/schedules/blendshape.toml")),
        ("recipe.toml", "[[step]]\nname = 'x'\n"),
        ("binary.toml", "\u{0}\u{1}"),
    ] {
        let text = page.refused(&add(name, text.as_bytes()));
        assert!(text.starts_with(name) && text.contains("no schedule for the model 'arap'"), "{name}: {text}");
        assert!(!text.contains("incoming"), "{text}");
    }
    page.send(&add("mine.toml", own.as_bytes()));
    let case = page.wait("case")["case"].clone();
    let schedule = case["wrap"]["schedule"].clone();
    assert_eq!(schedule["file"], "mine.toml");
    page.send(&json!({ "type": "run", "warm": false }));
    let command = loop {
        if let Some(command) = page.wait("case")["command"].as_str() {
            break command.to_owned();
        }
    };
    assert!(command.contains("--config ") && command.contains("/mine.toml"), "{command}");
    page.wait("idle");
    // a message names no file of the vault: what is there stays
    settings["model"] = "rigid".into();
    settings["schedule"] = json!({ "asset": "../..", "file": "passwd" });
    settings["mask"] = json!({ "asset": "0".repeat(64), "file": "../../x.npy" });
    page.send(&set(&settings));
    let case = page.wait("case")["case"].clone();
    assert_eq!((&case["wrap"]["schedule"], &case["wrap"]["mask"]), (&schedule, &Value::Null));
    let text = page.refused(&json!({ "type": "run", "warm": false }));
    assert!(text.contains("mine.toml is no schedule for the model 'rigid'"), "{text}");
    page.wait("idle");
    settings["schedule"] = Value::Null;
    page.send(&set(&settings));
    assert_eq!(page.wait("case")["case"]["wrap"]["schedule"], Value::Null);
}
