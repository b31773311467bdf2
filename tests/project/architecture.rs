//! Folders of `src/` are floors, and nothing imports upwards.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Each floor and what it may import of the crate besides itself.
const FLOORS: &[(&str, &[&str])] = &[
    ("guide", &[]),
    ("nlls", &[]),
    ("text", &[]),
    ("mesh", &[]),
    ("page", &["text"]),
    ("io", &["mesh", "text"]),
    ("landmark", &["io", "mesh", "text"]),
    ("console", &["io", "text"]),
    ("rig", &["io", "landmark", "mesh", "nlls", "text"]),
    ("correspondence", &["mesh", "nlls"]),
    ("energy", &["mesh", "nlls", "text"]),
    ("model", &["energy", "mesh", "nlls", "rig"]),
    ("term", &["correspondence", "energy", "mesh", "nlls"]),
    ("evaluation", &["io", "landmark", "mesh"]),
    ("render", &["io", "mesh"]),
    ("texture", &["io", "mesh"]),
    (
        "registration",
        &[
            "correspondence",
            "energy",
            "evaluation",
            "io",
            "landmark",
            "mesh",
            "model",
            "nlls",
            "render",
            "rig",
            "term",
            "text",
        ],
    ),
    ("morph", &["energy", "evaluation", "io", "landmark", "mesh", "model", "nlls", "render", "rig", "term"]),
    ("measurement", &["evaluation", "io", "landmark", "mesh", "page", "render", "text"]),
    ("motion", &["mesh"]),
    ("batch", &["io", "page", "text"]),
    ("self_test", &["evaluation", "landmark", "mesh", "nlls", "registration", "rig"]),
    (
        "cli",
        &[
            "batch",
            "console",
            "correspondence",
            "energy",
            "evaluation",
            "io",
            "landmark",
            "measurement",
            "mesh",
            "model",
            "morph",
            "motion",
            "nlls",
            "page",
            "registration",
            "render",
            "rig",
            "self_test",
            "term",
            "text",
            "texture",
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

/// The module of a file, as the segments of its path below the crate's root.
fn module_of(inside: &Path) -> Vec<String> {
    let mut path: Vec<String> =
        inside.with_extension("").components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    path.pop_if(|last| last == "mod");
    path
}

/// Modules that `text` names by paths through `super::` or `crate::`, its own and those around it left out. What a folder's `mod.rs`
/// passes on counts as the folder's.
fn modules_named(text: &str, module: &[String], all: &BTreeSet<Vec<String>>) -> BTreeSet<Vec<String>> {
    let code = code(text);
    let code = code.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let roots = (0..=module.len()).map(|up| match up {
        0 => ("crate::".to_owned(), Vec::new()),
        _ => ("super::".repeat(up), module[..module.len() - up].to_vec()),
    });
    let mut named = BTreeSet::new();
    for (prefix, around) in roots {
        // Deeper and deeper into the folders that are named.
        let mut open = vec![(prefix, around)];
        while let Some((prefix, around)) = open.pop() {
            for segment in after(code, &prefix) {
                let found: Vec<String> = around.iter().cloned().chain([segment.clone()]).collect();
                if all.contains(&found) && !module.starts_with(&found) {
                    open.push((format!("{prefix}{segment}::"), found.clone()));
                    named.insert(found);
                }
            }
        }
    }
    named
}

#[test]
fn no_two_files_import_each_other_through_any_number_of_others() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let texts: BTreeMap<Vec<String>, String> = files
        .iter()
        .map(|file| (module_of(file.strip_prefix(&root).unwrap()), fs::read_to_string(file).unwrap()))
        .filter(|(module, _)| !matches!(module[0].as_str(), "lib" | "main"))
        .collect();
    let all: BTreeSet<Vec<String>> = texts.keys().cloned().collect();
    let mut left: BTreeMap<&Vec<String>, BTreeSet<Vec<String>>> =
        texts.iter().map(|(module, text)| (module, modules_named(text, module, &all))).collect();
    assert!(left.values().map(BTreeSet::len).sum::<usize>() > 300, "the reader of imports must be blind");
    // Take out what imports nothing that is left, until nothing more goes: circles stay.
    loop {
        let before = left.len();
        let names: BTreeSet<Vec<String>> = left.keys().map(|m| (*m).clone()).collect();
        left.retain(|_, imports| imports.iter().any(|i| names.contains(i)));
        if left.len() == before {
            break;
        }
    }
    let circle: Vec<String> = left.keys().map(|module| module.join("::")).collect();
    assert!(circle.is_empty(), "in a circle, or importing from one: {}", circle.join(", "));
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
