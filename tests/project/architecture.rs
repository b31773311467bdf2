//! Folders of `src/` are floors, and nothing imports upwards.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Each floor and what it may import of the crate besides itself.
const FLOORS: &[(&str, &[&str])] = &[
    ("guide", &[]),
    ("nlls", &[]),
    ("text", &[]),
    ("mesh", &["text"]),
    ("page", &["text"]),
    ("console", &["mesh", "text"]),
    ("rig", &["mesh", "nlls", "text"]),
    ("energy", &["mesh", "nlls"]),
    ("model", &["energy", "mesh", "nlls", "rig"]),
    ("term", &["energy", "mesh", "nlls"]),
    ("evaluation", &["mesh"]),
    ("render", &["mesh"]),
    ("registration", &["energy", "evaluation", "mesh", "model", "nlls", "render", "rig", "term", "text"]),
    ("morph", &["energy", "evaluation", "mesh", "model", "nlls", "render", "rig", "term"]),
    ("measurement", &["evaluation", "mesh", "page", "render", "text"]),
    ("batch", &["mesh", "page", "text"]),
    ("self_test", &["evaluation", "mesh", "nlls", "registration", "rig"]),
    (
        "cli",
        &[
            "batch",
            "console",
            "energy",
            "evaluation",
            "measurement",
            "mesh",
            "model",
            "morph",
            "nlls",
            "page",
            "registration",
            "render",
            "rig",
            "self_test",
            "term",
            "text",
        ],
    ),
];

/// Source text without comments.
fn code(text: &str) -> String {
    let line = |line: &str| line.find("//").map_or(line, |at| &line[..at]).to_owned();
    text.lines().map(line).collect::<Vec<_>>().join("\n")
}

/// The identifier that `text` starts with.
fn word(text: &str) -> &str {
    &text[..text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len())]
}

/// First path segments after `prefix`, groups in braces included.
fn after(code: &str, prefix: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (at, _) in code.match_indices(prefix) {
        // `super::super::super::` holds `super::super::` too, and `mycrate::` ends like `crate::`.
        let before = &code[..at];
        if before.ends_with("::") || before.ends_with(|c: char| c.is_alphanumeric() || c == '_') {
            continue;
        }
        let rest = code[at + prefix.len()..].trim_start();
        let Some(group) = rest.strip_prefix('{') else {
            found.insert(word(rest).to_owned());
            continue;
        };
        let (mut depth, mut start) = (0, true);
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                c if start && depth == 0 && !c.is_whitespace() => {
                    found.insert(word(&group[i..]).to_owned());
                    start = false;
                }
                _ => {}
            }
        }
    }
    found
}

/// What a file `depth` modules below the crate's root imports from the root: by `crate::`, or by climbing there.
fn imports(text: &str, depth: usize) -> BTreeSet<String> {
    let code = code(text);
    let mut found = after(&code, "crate::");
    found.extend(after(&code, &"super::".repeat(depth)));
    // A test module inside the file lies one deeper.
    found.extend(after(&code, &"super::".repeat(depth + 1)));
    found
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn the_reader_of_imports_sees_every_form() {
    let text = "use crate::{mesh::{io, Vec3}, nlls,\n  term::Landmarks as L};\n//! crate::cli\nfn f() { crate::rig::g(); mycrate::render() }\n\
                use super::super::energy::Samples;";
    let expected = ["energy", "mesh", "nlls", "rig", "term"];
    assert_eq!(imports(text, 2).into_iter().collect::<Vec<_>>(), expected);
    assert!(!imports(text, 4).contains("energy"));
}

#[test]
fn nothing_imports_upwards() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let floors: BTreeMap<&str, &[&str]> = FLOORS.iter().copied().collect();
    let mut files = Vec::new();
    sources(&root, &mut files);
    files.sort();
    let mut wrong = Vec::new();
    let mut counted = 0;
    for file in &files {
        let inside = file.strip_prefix(&root).unwrap();
        let parts: Vec<String> = inside.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
        if parts.len() == 1 && (parts[0] == "lib.rs" || parts[0] == "main.rs") {
            continue;
        }
        let floor = parts[0].trim_end_matches(".rs");
        let Some(allowed) = floors.get(floor) else {
            wrong.push(format!("{}: give floor {floor:?} a row in this test", inside.display()));
            continue;
        };
        let depth = parts.len() - usize::from(parts.last().is_some_and(|name| name == "mod.rs"));
        for import in imports(&fs::read_to_string(file).unwrap(), depth) {
            if floors.contains_key(import.as_str()) && import != floor {
                counted += 1;
                if !allowed.contains(&import.as_str()) {
                    wrong.push(format!("{}: {floor} may not import {import}", inside.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(counted > 40, "only {counted} imports between floors found: the reader of imports must be blind");
}

#[test]
fn the_table_goes_from_the_ground_up() {
    for (i, (floor, allowed)) in FLOORS.iter().enumerate() {
        for import in *allowed {
            assert!(FLOORS[..i].iter().any(|f| f.0 == *import), "{floor} stands on {import}, which comes later");
        }
    }
}

/// Unsafe code is where a profile asked for it, and nowhere else.
#[test]
fn unsafe_code_is_in_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["src", "data-gen/src", "experiments/src"] {
        sources(&root.join(folder), &mut files);
    }
    let unsafe_code = |file: &PathBuf| code(&fs::read_to_string(file).unwrap()).contains("unsafe {");
    let found: Vec<_> = files.iter().filter(|f| unsafe_code(f)).map(|f| f.strip_prefix(root).unwrap()).collect();
    assert_eq!(found, [Path::new("src/nlls/dense_kernels.rs")]);
}
