//! Help of every command ends with examples, and the examples work.

use std::process::Command;

use data_gen::{FaceOptions, FaceRig, ScanOptions, Subject, simulate_scan, write_case, write_population, write_rig};

#[test]
fn every_help_ends_with_examples_that_parse() {
    let faults = crate::help::faults(&nonrigid::cli::command());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_reference_of_options_is_that_of_the_code() {
    let repository = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    crate::generated_page::check(repository, "nonrigid.md", &crate::command_page::page(&nonrigid::cli::command()));
    crate::generated_page::check(repository, "data_gen.md", &crate::command_page::page(&data_gen::command::command()));
}

/// Commands of a page's fenced `sh` blocks, continued lines joined.
fn commands(page: &str) -> Vec<String> {
    let blocks = page.split("```").skip(1).step_by(2).filter_map(|b| b.strip_prefix("sh\n"));
    let lines = |block: &str| block.replace("\\\n", " ").lines().map(|l| l.trim().to_owned()).collect::<Vec<_>>();
    blocks.flat_map(lines).filter(|l| l.starts_with("nonrigid ") && !l.contains('$')).collect()
}

#[test]
fn commands_of_the_book_parse() {
    let repository = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = vec![repository.join("README.md"), repository.join("docs/src/install.md")];
    for folder in ["tutorials", "howto", "reference", "explanation"] {
        let files = std::fs::read_dir(repository.join("docs/src").join(folder)).unwrap();
        pages.extend(files.map(|f| f.unwrap().path()));
    }
    let mut count = 0;
    for page in pages {
        for line in commands(&std::fs::read_to_string(&page).unwrap()) {
            count += 1;
            if let Err(e) = nonrigid::cli::command().try_get_matches_from(crate::help::words(&line)) {
                panic!("{}: {line}\n{e}", page.display());
            }
        }
    }
    assert!(count > 50, "{count}");
}

#[test]
fn the_reader_of_examples_sees_what_is_wrong() {
    let text = "Usage\n\nExamples, of two commands:\n  a b \\\n      --c\n  a d > e  # f\n";
    assert_eq!(crate::help::examples(text), ["a b        --c", "a d > e  # f"]);
    assert!(crate::help::examples("Examples:\n  a\n\nExit codes: 0").is_empty());
    let command = |text: &'static str| clap::Command::new("a").arg(clap::Arg::new("b").long("b")).after_help(text);
    let count = |text| crate::help::faults(&command(text)).len();
    assert_eq!(["Example:\n  a --b 1", "Example:\n  a --c 1", "Example:\n  x", ""].map(count), [0, 1, 1, 1]);
}

/// In a folder with what `data-gen` makes, and the files that examples call one's own, every example runs as it stands.
#[cfg(unix)]
#[test]
fn every_example_works_in_a_shell() {
    let bench = crate::support::Bench::new();
    let rig = FaceRig::generate(&FaceOptions { vertices: 1000, ..FaceOptions::default() });
    for folder in ["out/data/rig", "rig"] {
        write_rig(&bench.path(folder), &rig).unwrap();
    }
    write_population(&bench.path("out/data/population"), &rig, 50, 7).unwrap();
    for (name, expression, subject) in [("same_open", 0.6, None), ("new_neutral", 0.0, Some(Subject::new(&rig)))] {
        let expressions = Some(vec![("jawOpen".to_owned(), expression)]);
        let options = ScanOptions { triangles: 8000, expressions, ..ScanOptions::default() };
        let case = simulate_scan(&rig, &options, 7).unwrap();
        let subject = subject.unwrap_or_else(|| Subject::same(&rig, &case));
        write_case(&bench.path(&format!("out/data/cases/{name}")), &rig, &case, &subject, 7).unwrap();
    }
    for (own, file) in [
        ("face.obj", "out/data/rig/template.obj"),
        ("scan.ply", "out/data/cases/same_open/scan.ply"),
        ("landmarks.json", "out/data/cases/same_open/landmarks.json"),
        ("registered/one.obj", "out/data/population/person_0000.obj"),
        ("registered/two.obj", "out/data/population/person_0001.obj"),
    ] {
        bench.write(own, bench.read(file));
    }
    bench.write("scans.csv", "target,landmarks\nscan.ply,landmarks.json\n");
    // Families print what their members do too: once is enough, in the order of the commands.
    let mut done: Vec<String> = Vec::new();
    let program = std::path::Path::new(env!("CARGO_BIN_EXE_nonrigid")).parent().unwrap().display().to_string();
    let path = format!("{program}:{}", std::env::var("PATH").unwrap());
    let mut helps = crate::help::helps(&nonrigid::cli::command());
    helps.rotate_left(1); // the root's examples are of all commands
    for (name, text) in helps {
        for line in crate::help::examples(&text) {
            if done.contains(&line) {
                continue;
            }
            let output = Command::new("sh")
                .args(["-c", &line])
                .env("PATH", &path)
                .env("HOME", bench.path(""))
                .current_dir(bench.path(""))
                .output()
                .unwrap();
            assert!(output.status.success(), "{name}: {line}\n{}", String::from_utf8_lossy(&output.stderr));
            done.push(line);
        }
    }
    assert!(done.len() > 20, "{done:?}");
    assert!(bench.read("weights.csv").starts_with(b"frame,rms_mm,max_mm,"));
}
