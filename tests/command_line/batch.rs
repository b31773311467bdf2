//! `nonrigid batch`: what fails stays alone, what is done stays done, and nothing depends on who does it.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::support::{Bench, endless_schedule, files_in, glb_parts, landmarks_json};
use data_gen::{Motion, ScanOptions, Subject, simulate_scan, write_case};
use nonrigid::io::{PlyOptions, read_npy_points, read_polygon_mesh, read_scan, sha256, write_ply, write_polygon_mesh};
use nonrigid::mesh::{Pose, Vec3};
use serde_json::Value;

const OPTIONS: &str = "--template rig/template.obj --rig rig --identity-modes 5";

/// A bench with a sequence of frames `f0/` to `f3/` besides its case.
fn bench() -> Bench {
    let bench = Bench::new();
    let options = ScanOptions { triangles: 8000, ..ScanOptions::default() };
    let motion = Motion::new(&bench.rig, &options, 1.0, 3).unwrap();
    for frame in 0..4 {
        let options = motion.options(f64::from(frame) / 15.0);
        let case = simulate_scan(&bench.rig, &options, 3).unwrap();
        write_case(&bench.path(&format!("f{frame}")), &bench.rig, &case, &Subject::same(&bench.rig, &case), 3).unwrap();
    }
    bench
}

fn list(bench: &Bench, rows: &[&str]) {
    bench.write("scans.csv", format!("target,landmarks,sequence,name,model\n{}\n", rows.join("\n")));
}

const FRAMES: [&str; 4] = [
    "f0/scan.ply,f0/landmarks.json,walk,,",
    "f1/scan.ply,f1/landmarks.json,walk,,",
    "f2/scan.ply,f2/landmarks.json,walk,,",
    "f3/scan.ply,f3/landmarks.json,walk,,",
];

/// Rows of summary.csv by name: status and start.
fn summary(bench: &Bench, folder: &str) -> BTreeMap<String, (String, String)> {
    let text = bench.text(&format!("{folder}/summary.csv"));
    let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
    text.lines().skip(1).map(cells).map(|c| (c[0].clone(), (c[1].clone(), c[2].clone()))).collect()
}

/// Everything that a batch left but times and logs, which hold times.
fn left(bench: &Bench, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let mut left = BTreeMap::new();
    for sub in
        ["", "log/", "state/", "sequences/"].into_iter().filter(|sub| bench.path(&format!("{folder}/{sub}")).is_dir())
    {
        let folder = format!("{folder}/{sub}");
        for name in files_in(&bench.path(&folder)) {
            let times = name.ends_with(".timing.json") || name.ends_with(".txt");
            if !times && bench.path(&format!("{folder}{name}")).is_file() {
                left.insert(format!("{sub}{name}"), bench.read(&format!("{folder}{name}")));
            }
        }
    }
    left
}

fn steps(bench: &Bench, report: &str) -> usize {
    let report = bench.json(report);
    report["history"].as_array().unwrap().len()
}

#[test]
fn one_failing_scan_never_stops_the_rest() {
    let bench = bench();
    bench.write("empty.ply", "");
    let mut rows = vec!["missing.ply,,,,", "case/scan.ply,case/landmarks.json,,person,", "empty.ply,,walk,,"];
    rows.extend(FRAMES);
    rows.extend(["case/scan.ply,,,clay,clay", "case/scan.ply,case/landmarks.json,,-stiff,rigid"]);
    list(&bench, &rows);
    let run = bench.run(&format!("batch scans.csv --out out {OPTIONS} --pictures"));
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(run.stderr.lines().last().unwrap().starts_with("error: 3 of 9 scans failed; "), "{}", run.stderr);
    assert!(run.stderr.contains("[9/9] ") && run.stderr.contains(" left"), "{}", run.stderr);
    assert!(run.stdout.contains("9 scans in ") && run.stdout.contains("scans per core-minute"), "{}", run.stdout);
    let summary = summary(&bench, "out");
    for (name, status, start) in [
        ("missing", "failed", "cold"),
        ("person", "done", "cold"),
        ("empty", "failed", "cold"),
        ("f0_scan", "done", "cold"), // the frame before it has failed
        ("f1_scan", "done", "warm"),
        ("f3_scan", "done", "warm"),
        ("clay", "failed", "cold"),
        ("'-stiff", "doubtful", "cold"), // a smile, whose name is no formula
    ] {
        assert_eq!(summary[name], (status.to_owned(), start.to_owned()), "{name}");
    }
    let text = bench.text("out/summary.csv");
    let note = |name: &str| text.lines().find(|l| l.starts_with(&format!("{name},"))).unwrap().to_owned();
    assert!(note("missing").contains("missing.ply: cannot be read") && note("clay").contains("unknown model 'clay'"));
    assert!(note("empty").contains("empty.ply"));
    for name in ["missing", "empty", "clay"] {
        assert!(!bench.path(&format!("out/{name}.obj")).exists() && !bench.path(&format!("out/{name}.json")).exists());
    }
    let page = bench.text("out/index.html");
    assert!(page.contains("<td>person</td>") && page.contains("src=\"f2_scan.png\"") && !page.contains("clay.png"));

    // each is what `register` makes of it
    bench.done(&format!(
        "register {OPTIONS} --target case/scan.ply --landmarks case/landmarks.json --model rigid --out ./-stiff.obj --report ./-stiff.json"
    ));
    for name in ["-stiff.obj", "-stiff.json"] {
        assert!(bench.read(name) == bench.read(&format!("out/{name}")), "{name}");
    }
    // Two steps of each of four levels at most; a cold start takes what it needs.
    let [cold, warm] = ["f0", "f2"].map(|frame| steps(&bench, &format!("out/{frame}_scan.json")));
    assert!(warm <= 8 && warm < cold, "{warm}, {cold}");
}

#[test]
fn the_summary_says_what_the_registration_says_of_left_and_right() {
    let bench = Bench::new();
    bench.write("scans.csv", "target,name\ncase/scan.ply,person\n");
    bench.done("batch scans.csv --out out --template rig/template.obj --model rigid");
    for file in ["summary.csv", "index.html"] {
        assert!(bench.text(&format!("out/{file}")).contains("left and right: nothing tells them apart here"), "{file}");
    }
}

#[test]
fn what_is_done_is_known_and_a_change_goes_through_a_sequence() {
    let bench = bench();
    let mut rows = FRAMES.to_vec();
    rows.push("case/scan.ply,case/landmarks.json,,person,");
    list(&bench, &rows);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    // What was done, by name, in the order of the names.
    let ran = |command: &str| -> Vec<String> {
        let stderr = bench.ends(command, 0);
        let line = |line: &str| {
            Some(line.split_once("] ")?.1.split_once(": ")?)
                .filter(|l| !l.1.starts_with("done before"))
                .map(|l| l.0.to_owned())
        };
        let mut names: Vec<String> = stderr.lines().filter_map(line).collect();
        names.sort();
        names
    };
    assert_eq!(ran(&command), ["f0_scan", "f1_scan", "f2_scan", "f3_scan", "person"]);
    let first = left(&bench, "out");
    assert_eq!(ran(&command), [""; 0]);
    assert!(left(&bench, "out") == first);
    // in another folder, in another order, another way of saying the same
    fs::rename(bench.path("case"), bench.path("moved")).unwrap();
    rows[4] = "moved/scan.ply,moved/landmarks.json,,person,";
    rows.rotate_right(1);
    list(&bench, &rows);
    assert_eq!(ran(&format!("{command} --jobs 1 --threads 1")), [""; 0]);
    // an output that is gone
    fs::remove_file(bench.path("out/person.obj")).unwrap();
    fs::remove_file(bench.path("out/f3_scan.json")).unwrap();
    assert_eq!(ran(&command), ["f3_scan", "person"]);
    let mut again = left(&bench, "out");
    for name in ["summary.csv", "index.html"] {
        again.remove(name); // in the order of the manifest
    }
    assert!(again.iter().all(|(name, bytes)| first[name] == *bytes) && again.len() + 2 == first.len());
    // another frame: those after it follow
    fs::copy(bench.path("f3/scan.ply"), bench.path("f1/scan.ply")).unwrap();
    assert_eq!(ran(&command), ["f1_scan", "f2_scan", "f3_scan"]);
    assert_eq!(ran(&format!("{command} --again")).len(), 5);
    assert_eq!(ran(&format!("{command} --identity-bounds=-2,2")).len(), 5);
    // the template decides everything
    bench.write("rig/regions.json", "{}");
    assert_eq!(ran(&format!("{command} --identity-bounds=-2,2")).len(), 5);
}

#[test]
fn what_somebody_has_changed_stays() {
    let bench = bench();
    list(&bench, &["case/scan.ply,case/landmarks.json,,person,", "f0/scan.ply,f0/landmarks.json,,other,"]);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    bench.done(&command);
    let (made, record) = (bench.read("out/person.obj"), bench.read("out/log/person.json"));
    bench.write("out/person.obj", "retouched");
    let stderr = bench.ends(&command, 0);
    assert!(stderr.contains("person: done before; person.obj was changed since, and stays"), "{stderr}");
    for option in ["--again", "--identity-bounds=-2,2"] {
        let stderr = bench.ends(&format!("{command} {option}"), 2);
        assert!(stderr.contains("person.obj: was changed since it was made, and stays"), "{stderr}");
        assert!(!stderr.contains("other: failed"), "{stderr}");
        assert_eq!(bench.read("out/person.obj"), b"retouched");
    }
    fs::remove_file(bench.path("out/person.obj")).unwrap();
    bench.done(&command);
    assert!(bench.read("out/person.obj") == made);

    // A run that ends between its record and its results leaves those of the run before: they are nobody's work.
    let mut ended: Value = serde_json::from_slice(&record).unwrap();
    ended["replaced"] = serde_json::json!({ "person.obj": ended["outputs"]["person.obj"] });
    ended["outputs"]["person.obj"] = "another".into();
    bench.write("out/log/person.json", ended.to_string());
    let stderr = bench.ends(&command, 0);
    assert!(!stderr.contains("person: done before"), "{stderr}");
    assert!(bench.read("out/person.obj") == made);
}

#[test]
fn what_a_power_cut_leaves_is_done_again_and_concerns_its_scan_alone() {
    let bench = bench();
    list(&bench, &["case/scan.ply,case/landmarks.json,,person,rigid", "f0/scan.ply,f0/landmarks.json,,other,rigid"]);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    let run = bench.run(&format!("{command} --fps 30 --smooth none"));
    assert!(
        run.stderr.contains("--fps, --smooth: no effect, as no row of the manifest has a sequence"),
        "{}",
        run.stderr
    );
    let made = left(&bench, "out");
    for (file, blank) in [("person.obj", ""), ("other.json", "\0\0\0\0"), ("state/other.json", "")] {
        bench.write(&format!("out/{file}"), blank);
        let run = bench.run(&command);
        assert!(run.code == 0 && run.stderr.matches("done before").count() == 1, "{file}: {}", run.stderr);
        assert!(left(&bench, "out") == made, "{file}");
    }
    // half a report is not known to be nobody's
    bench.write("out/other.json", "{ \"doubts\": [");
    let run = bench.run(&command);
    assert!(run.stderr.contains("other: done before; other.json was changed since, and stays"), "{}", run.stderr);
    assert_eq!(summary(&bench, "out")["other"].0, "doubtful");
    assert!(bench.text("out/summary.csv").contains("other.json, its report, cannot be read"));
    fs::remove_file(bench.path("out/other.json")).unwrap();
    // a record that broke
    for broken in ["", "{ \"key\": "] {
        bench.write("out/log/person.json", broken);
        let run = bench.run(&command);
        assert!(run.code == 2 && !run.stderr.contains("other: failed"), "{}", run.stderr);
        assert!(run.stderr.contains("person: failed: out/log/person.json: is no record"), "{}", run.stderr);
        assert_eq!(bench.read("out/person.obj"), made["person.obj"]);
    }
    for file in "person.obj person.mtl person.json person.timing.json state/person.json log/person.txt".split(' ') {
        fs::remove_file(bench.path(&format!("out/{file}"))).unwrap();
    }
    bench.done(&command);
    assert!(left(&bench, "out") == made);
    // nor does it take a link that leads nowhere for a folder
    std::os::unix::fs::symlink("nowhere", bench.path("link")).unwrap();
    let run = bench.run(&command.replace("--out out", "--out link"));
    assert!(
        run.code == 3 && run.stderr.contains("link: cannot be written: it is a link that leads nowhere"),
        "{}",
        run.stderr
    );
}

#[test]
fn parts_give_what_the_whole_gives_also_by_the_recipe_for_gnu_parallel() {
    let bench = bench();
    let mut rows = FRAMES.to_vec();
    rows.extend(["case/scan.ply,case/landmarks.json,,a,rigid", "case/scan.ply,case/landmarks.json,,b,graph"]);
    list(&bench, &rows);
    bench.done(&format!("batch scans.csv --out whole {OPTIONS} --jobs 1 --threads 2"));
    let whole = left(&bench, "whole");
    for part in 1..=3 {
        bench.done(&format!("batch scans.csv --out parts {OPTIONS} --shard {part}/3"));
    }
    assert!(bench.path("parts/summary.2-of-3.timing.json").exists());
    assert!(left(&bench, "parts") == whole, "the last part wrote the summary of all");

    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src/howto/batches.md")).unwrap();
    let recipe = page.split("### GNU parallel").nth(1).unwrap().split("```").nth(1).unwrap().trim_start_matches("sh\n");
    let recipe = recipe.replace("--template face.obj --rig rig", OPTIONS).replace("--out wrapped", "--out by_parallel");
    assert!(recipe.matches(OPTIONS).count() == 2 && recipe.contains("::: 1 2 3 4"), "{recipe}");
    if Command::new("parallel").arg("--version").output().map_or(true, |o| !o.stdout.starts_with(b"GNU parallel")) {
        return crate::skip::skipped("GNU parallel is not installed");
    }
    let program = Path::new(env!("CARGO_BIN_EXE_nonrigid")).parent().unwrap();
    let path = std::env::join_paths(
        [program.to_owned()].into_iter().chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let mut shell = Command::new("bash");
    shell
        .args(["-euc", &recipe])
        .current_dir(bench.path(""))
        .env("PATH", path.unwrap())
        .env("PARALLEL_HOME", bench.path(""));
    let output = shell.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("done before"), "{said}");
    assert!(left(&bench, "by_parallel") == whole);
}

#[test]
fn an_interrupted_batch_goes_on_to_the_same_end() {
    let bench = bench();
    list(&bench, &FRAMES);
    bench.done(&format!("batch scans.csv --out whole {OPTIONS}"));
    for signal in ["INT", "KILL"] {
        let folder = format!("by_{signal}");
        let mut child = Command::new(env!("CARGO_BIN_EXE_nonrigid"))
            .args(format!("batch scans.csv --out {folder} {OPTIONS}").split_whitespace())
            .current_dir(bench.path(""))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        while !bench.path(&format!("{folder}/log/f0_scan.json")).exists() {
            assert!(child.try_wait().unwrap().is_none(), "it ended before anything was done");
            std::thread::sleep(Duration::from_millis(2));
        }
        Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status().unwrap();
        let status = child.wait().unwrap();
        if signal == "INT" {
            assert_eq!(status.code(), Some(130));
            let summary = summary(&bench, &folder);
            assert_eq!((&summary["f0_scan"].0[..], &summary["f3_scan"].0[..]), ("done", "pending"));
        }
        std::thread::sleep(Duration::from_millis(500)); // what a killed batch had started, ends
        bench.done(&format!("batch scans.csv --out {folder} {OPTIONS}"));
        assert!(left(&bench, &folder) == left(&bench, "whole"), "{signal}");
    }
}

#[test]
fn a_sequence_becomes_one_file_that_names_the_frames_it_has_lost() {
    let bench = bench();
    bench.write("empty.ply", "");
    let rows = [FRAMES[0], FRAMES[1], "empty.ply,f2/landmarks.json,walk,,", FRAMES[2], FRAMES[3]];
    list(&bench, &rows);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    bench.ends(&format!("{command} --animation glb --fps 15"), 2);
    let text = bench.text("out/summary.csv");
    let empty = text.lines().find(|line| line.starts_with("empty,failed")).unwrap();
    assert!(empty.contains("lost in \"\"walk\"\": there is none; the motion of those round it"), "{text}");
    let report = bench.json("out/sequences/walk.json");
    let names: Vec<&str> = report["frames"].as_array().unwrap().iter().map(|f| f["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["f0_scan", "f1_scan", "empty", "f2_scan", "f3_scan"]);
    assert_eq!((report["frames_per_second"].as_u64(), report["smooth_hz"].as_f64()), (Some(15), Some(4.0)));
    let first = bench.read("out/sequences/walk.glb");
    // the same again is there already
    let made = |name: &str| fs::metadata(bench.path(name)).unwrap().modified().unwrap();
    let when = made("out/sequences/walk.glb");
    bench.run(&format!("{command} --animation glb --fps 15"));
    assert!(made("out/sequences/walk.glb") == when && bench.read("out/sequences/walk.glb") == first);
    // without the empty frame, and in another format: the earlier file, which it would be taken for, goes
    list(&bench, &FRAMES);
    bench.done(&command);
    assert!(bench.path("out/sequences/walk.usda").exists() && !bench.path("out/sequences/walk.glb").exists());
    assert!(!bench.text("out/summary.csv").contains("lost"));
    // and without one, all that was made of the sequence; what somebody has changed stays
    let there = |name: &str| bench.path(&format!("out/{name}")).exists();
    bench.done(&format!("{command} --animation none"));
    for gone in ["sequences/walk.usda", "sequences/walk.json", "log/walk.sequence.txt", "log/walk.sequence.json"] {
        assert!(!there(gone), "{gone}");
    }
    bench.done(&format!("{command} --fps 23.976"));
    assert!(bench.text("out/sequences/walk.usda").contains("PerSecond = 23.976\n"));
    bench.write("out/sequences/walk.usda", "retouched");
    for _ in 0..2 {
        let run = bench.run(&format!("{command} --animation none --fps 30"));
        assert!(run.code == 0 && run.stderr.contains("walk.usda: was changed since it was made"), "{}", run.stderr);
        assert!(run.stderr.contains("--fps: no effect with --animation none"), "{}", run.stderr);
        assert!(bench.read("out/sequences/walk.usda") == b"retouched" && there("sequences/walk.json"));
    }
    // it is what was asked for, until something else is
    bench.done(&format!("{command} --fps 23.976"));
    assert!(bench.read("out/sequences/walk.usda") == b"retouched");
    let run = bench.run(&command);
    assert!(run.code == 2 && run.stderr.contains("walk.usda: was changed since it was made"), "{}", run.stderr);

    // names may begin as other lines of a list of frames do
    let odd = ["f0/scan.ply,f0/landmarks.json,odd,-first,rigid", "f1/scan.ply,f1/landmarks.json,odd,#second,rigid"];
    list(&bench, &odd);
    bench.done(&format!("batch scans.csv --out odd {OPTIONS}"));
    let report: Value = serde_json::from_slice(&bench.read("odd/sequences/odd.json")).unwrap();
    let lost = ["-first", "#second"].map(|name| serde_json::json!({ "name": name, "lost": null }));
    assert_eq!(report["frames"], serde_json::json!(lost));
    list(&bench, &FRAMES);

    // nobody's file stays, and another template in the middle is no sequence
    bench.write("other/sequences/walk.usda", "mine");
    let run = bench.run(&format!("batch scans.csv --out other {OPTIONS}"));
    assert_eq!((run.code, bench.read("other/sequences/walk.usda")), (3, b"mine".to_vec()), "{}", run.stderr);
    // nothing is there of what all frames have failed of
    list(&bench, &["empty.ply,f2/landmarks.json,gone,,"]);
    let run = bench.run(&format!("batch scans.csv --out gone {OPTIONS} --fps 8"));
    assert!(run.code == 2 && run.stderr.contains("--smooth 4: nothing is smoothed"), "{}", run.stderr);
    let text = bench.text("gone/summary.csv");
    assert!(text.contains("no animated file of \"\"gone\"\": none of its frames is there"), "{text}");
    let mut rows = FRAMES.map(str::to_owned);
    let template = fs::read_to_string(bench.path("rig/template.obj")).unwrap();
    let last = template.trim_end().rfind('\n').unwrap();
    bench.write("cut.obj", &template[..last]);
    bench.write(
        "scans.csv",
        format!(
            "target,landmarks,sequence,template,rig,model\n{},rig/template.obj,rig,\n{},cut.obj,,rigid\n",
            rows[0].trim_end_matches(",,"),
            rows[1].trim_end_matches(",,")
        ),
    );
    let stderr = bench.ends("batch scans.csv --out odd", 2);
    assert!(stderr.contains("no animated file of sequence \"walk\"") && stderr.contains("other vertices"), "{stderr}");

    // what could not be animated when all is done does not begin
    let refused = |rows: &str, options: &str, says: &str| {
        bench.write("scans.csv", rows);
        let stderr = bench.ends(&format!("batch scans.csv --out fine {OPTIONS} {options}"), 1);
        assert!(stderr.contains(says) && !bench.path("fine").exists(), "{stderr}");
    };
    let frames = format!("target,landmarks,sequence,name,model\n{}\n", FRAMES.join("\n"));
    refused(&frames, "--animation glb --subdivide 1", "write --animation usda or pc2");
    let unlike = "target,sequence,subdivide\nf0/scan.ply,walk,\nf1/scan.ply,walk,1\n";
    refused(unlike, "", "frame \"f1_scan\" is subdivided 1 times, those before it 0");

    rows[0] = rows[0].replace("walk", "a/b");
    bench.write("scans.csv", format!("target,landmarks,sequence,name,model\n{}\n", rows[0]));
    let stderr = bench.ends(&format!("batch scans.csv --out none {OPTIONS}"), 4);
    assert!(stderr.contains("a sequence's name"), "{stderr}");
}

#[test]
fn warm_frames_are_as_good_as_cold_ones() {
    let bench = bench();
    let rms = |folder: &str| -> f64 {
        let of_frame = |frame: usize| {
            let truth = read_npy_points(&bench.path(&format!("f{frame}/truth.npy"))).unwrap();
            let result = read_polygon_mesh(&bench.path(&format!("{folder}/f{frame}_scan.obj"))).unwrap().positions;
            truth.iter().zip(&result).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / truth.len() as f64
        };
        ((1..4).map(of_frame).sum::<f64>() / 3.0).sqrt()
    };
    list(&bench, &FRAMES);
    bench.done(&format!("batch scans.csv --out warm {OPTIONS}"));
    list(&bench, &FRAMES.map(|row| row.replace("walk", "")).each_ref().map(String::as_str));
    bench.done(&format!("batch scans.csv --out cold {OPTIONS}"));
    let (warm, cold) = (rms("warm"), rms("cold"));
    assert!(warm < 1.05 * cold && cold < 3.0, "{warm} {cold}");
}

#[test]
fn a_frame_that_cannot_go_on_starts_cold() {
    let bench = bench();
    // a cut: the head is elsewhere and looks away, and nobody has set landmarks
    let turn = Pose::rigid(Vec3::new(0.2, 1.2, -0.1), Vec3::new(200.0, 50.0, -80.0));
    let mut scan = read_scan(&bench.path("f1/scan.ply")).unwrap().mesh;
    scan.positions.iter_mut().for_each(|p| *p = turn.apply(*p));
    write_ply(&bench.path("far.ply"), &scan, PlyOptions::default()).unwrap();
    let rows = [
        FRAMES[0],
        "far.ply,,walk,,",
        "f2/scan.ply,far_marks.json,walk,,",
        "f3/scan.ply,f3/landmarks.json,walk,,graph",
    ];
    list(&bench, &rows);
    let text = bench.json("f2/landmarks.json");
    let marks: Vec<(u32, Vec3)> = text
        .as_object()
        .unwrap()
        .iter()
        .map(|(v, p)| (v.parse().unwrap(), Vec3::from_fn(|i, _| p[i].as_f64().unwrap())))
        .collect();
    bench.write("far_marks.json", landmarks_json(&marks));
    bench.run(&format!("batch scans.csv --out out {OPTIONS}"));
    let summary = summary(&bench, "out");
    assert_eq!(summary["far"].1, "cold", "{summary:?}");
    // the end of another model is no start
    assert_eq!(summary["f3_scan"], ("done".to_owned(), "cold again".to_owned()), "{summary:?}");
    // landmarks carry the warm start over the way back
    assert_eq!(summary["f2_scan"], ("done".to_owned(), "warm".to_owned()), "{summary:?}");
    let truth = read_npy_points(&bench.path("f2/truth.npy")).unwrap();
    let result = read_polygon_mesh(&bench.path("out/f2_scan.obj")).unwrap().positions;
    let rms = (truth.iter().zip(&result).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / truth.len() as f64).sqrt();
    assert!(rms < 3.0, "{rms}");
}

/// What `batch` says of each scan, by name.
fn said(stderr: &str) -> BTreeMap<String, String> {
    let line =
        |line: &str| line.split_once("] ")?.1.split_once(": ").map(|(name, what)| (name.to_owned(), what.to_owned()));
    stderr.lines().filter_map(line).collect()
}

#[test]
fn what_is_finished_stays_whatever_goes_wrong_the_next_time() {
    let bench = bench();
    let rows = [FRAMES[0], FRAMES[1], "case/scan.ply,case/landmarks.json,,person,"];
    list(&bench, &rows);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    bench.done(&format!("{command} --pictures"));
    let results = |folder: &str| -> BTreeMap<String, Vec<u8>> {
        let ours = |name: &String| {
            !name.starts_with("log/")
                && !name.starts_with("sequences/")
                && !["summary.csv", "index.html"].contains(&name.as_str())
        };
        left(&bench, folder).into_iter().filter(|(name, _)| ours(name)).collect()
    };
    let finished = results("out");
    assert_eq!(finished.len(), 3 * 5, "{:?}", finished.keys());
    let all_done = || {
        let stderr = bench.ends(&format!("{command} --pictures"), 0);
        assert!(said(&stderr).values().all(|what| what.starts_with("done before")), "{stderr}");
        assert!(results("out") == finished);
        assert!(summary(&bench, "out").values().all(|row| row.0 != "failed"));
    };
    let in_the_way = |from: &str| {
        let hidden = format!("{from}_hidden");
        fs::rename(bench.path(from), bench.path(&hidden)).unwrap();
        let stderr = bench.ends(&format!("{command} --pictures"), 2);
        assert!(stderr.contains("cannot be read"), "{stderr}");
        let text = bench.text("out/summary.csv");
        assert!(text.contains("is still there"), "{text}");
        assert!(results("out") == finished, "{from} cannot be reached");
        fs::rename(bench.path(&hidden), bench.path(from)).unwrap();
        all_done();
    };
    ["rig", "case", "f0", "f1/landmarks.json"].into_iter().for_each(in_the_way);
    for option in ["--model clay", "--identity-modes 99", "--again --identity-modes 99", "--regions nosee"] {
        bench.ends(&format!("{} --pictures", command.replace("--identity-modes 5", option)), 2);
        assert!(results("out") == finished, "{option}");
        all_done();
    }
    // another format takes the place of what it replaces, and of nothing else
    bench.write("out/notes.txt", "mine");
    bench.write("out/f0_scan.obj", "changed by hand");
    bench.done(&format!("{command} --format ply"));
    let names: Vec<String> =
        files_in(&bench.path("out")).into_iter().filter(|n| !n.contains("summary") && n.contains('.')).collect();
    assert_eq!(
        names,
        [
            ".nonrigid",
            "f0_scan.json",
            "f0_scan.obj",
            "f0_scan.ply",
            "f0_scan.timing.json",
            "f1_scan.json",
            "f1_scan.ply",
            "f1_scan.timing.json",
            "index.html",
            "notes.txt",
            "person.json",
            "person.ply",
            "person.timing.json"
        ]
    );
    assert_eq!(bench.read("out/f0_scan.obj"), b"changed by hand");
}

#[test]
fn what_is_no_result_is_not_replaced() {
    let bench = bench();
    list(&bench, &["f0/scan.ply,f0/landmarks.json,,f0_scan,"]);
    let command = format!("batch scans.csv --out out {OPTIONS}");
    for name in [
        "f0_scan.obj",
        "f0_scan.timing.json",
        "log/f0_scan.txt",
        "log/f0_scan.json",
        "state/f0_scan.json",
        "index.html",
    ] {
        bench.write(&format!("out/{name}"), "mine");
        let stderr = bench.ends(&command, 3);
        let words = format!("out/{name}: is there, and no record of an earlier batch lists it");
        assert!(stderr.contains(&words), "{stderr}");
        assert_eq!(bench.read(&format!("out/{name}")), b"mine");
        fs::remove_dir_all(bench.path("out")).unwrap();
    }
    // beside the scans, which have other names
    bench.write("f0/scans.csv", "target,landmarks,name\nscan.ply,landmarks.json,wrapped\n");
    let before = bench.read("f0/scan.ply");
    bench.done(&format!("batch f0/scans.csv --out f0 {OPTIONS}"));
    bench.done(&format!("batch f0/scans.csv --out f0 {OPTIONS} --again"));
    assert!(bench.read("f0/scan.ply") == before && bench.path("f0/wrapped.obj").exists());
    // a result that is the template of the next batch is none of its outputs
    bench.write("next.csv", "target,name\nf1/scan.ply,wrapped\n");
    let stderr = bench.ends("batch next.csv --out f0 --template f0/wrapped.obj", 1);
    assert!(stderr.contains("f0/wrapped.obj: would overwrite a file that is read (template of"), "{stderr}");
    let stderr = bench.ends("batch next.csv --out f0 --template f0/wrapped.obj --format ply", 1);
    assert!(stderr.contains("f0/wrapped.obj: would overwrite a file that is read"), "{stderr}");
}

/// Processes that a process has started and that run.
fn children(pid: u32) -> Vec<String> {
    let found = Command::new("pgrep").args(["-P", &pid.to_string()]).output().unwrap().stdout;
    String::from_utf8(found).unwrap().split_whitespace().map(str::to_owned).collect()
}

#[test]
fn a_folder_has_one_batch_and_survives_its_end() {
    let bench = bench();
    list(&bench, &["f0/scan.ply,f0/landmarks.json,,f0_scan,"]);
    bench.write("endless.toml", endless_schedule());
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
        command.args(format!("batch scans.csv --out out {OPTIONS} --config endless.toml").split_whitespace());
        let said = fs::File::create(bench.path("said.txt")).unwrap();
        command.current_dir(bench.path("")).stdout(Stdio::null()).stderr(said);
        let mut child = command.spawn().unwrap();
        while children(child.id()).is_empty() {
            let ended = child.try_wait().unwrap();
            assert!(ended.is_none(), "{ended:?} before it began: {}", String::from_utf8_lossy(&bench.read("said.txt")));
            std::thread::sleep(Duration::from_millis(2));
        }
        child
    };
    let mut child = start();
    let second = format!("batch scans.csv --out out {OPTIONS} --model rigid");
    let stderr = bench.ends(&second, 3);
    let words = format!("out: another batch writes here, process {} on ", child.id());
    assert!(stderr.contains(&words), "{stderr}");
    assert!(!bench.path("out/f0_scan.obj").exists());
    child.kill().unwrap();
    child.wait().unwrap();
    let stderr = bench.ends(&second, 0);
    let words = format!("warning: out: taken over from process {} on ", child.id());
    assert!(stderr.contains(&words), "{stderr}");
    let hidden = files_in(&bench.path("out/.nonrigid"));
    assert_eq!(hidden, ["wrote-1-of-1.json"], "nothing of either stays");
    let result = bench.read("out/f0_scan.obj");
    // SIGTERM, as Slurm sends it, to all processes
    let mut child = start();
    let all = [child.id().to_string()].into_iter().chain(children(child.id()));
    Command::new("kill").arg("-TERM").args(all).status().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(143));
    assert!(bench.read("out/f0_scan.obj") == result, "an interrupted scan leaves the earlier result");
    assert!(bench.run(&second).stderr.contains("done before"));
}

#[test]
fn the_end_of_one_process_alone_is_a_failure_of_its_scan() {
    let bench = bench();
    list(&bench, &["f0/scan.ply,f0/landmarks.json,,,", "f1/scan.ply,f1/landmarks.json,,,"]);
    // `register` is asked to end by a signal that does not reach the batch
    let mut child = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
    let line = format!("batch scans.csv --out out {OPTIONS} --jobs 1");
    let mut child = child
        .args(line.split_whitespace())
        .current_dir(bench.path(""))
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    loop {
        if let Some(pid) = children(child.id()).first() {
            Command::new("kill").args(["-TERM", pid]).status().unwrap();
            break;
        }
        assert!(child.try_wait().unwrap().is_none(), "it ended before it began");
    }
    assert_eq!(child.wait().unwrap().code(), Some(2));
    let summary = summary(&bench, "out");
    assert_eq!((&summary["f0_scan"].0[..], &summary["f1_scan"].0[..]), ("failed", "done"));
    assert!(bench.text("out/summary.csv").contains("told to end from outside"));
}

#[test]
fn buffers_of_gltf_belong_to_what_is_read() {
    let bench = bench();
    let scan = read_polygon_mesh(&bench.path("f0/scan.ply")).unwrap();
    write_polygon_mesh(&bench.path("scan.glb"), &scan).unwrap();
    let glb = bench.read("scan.glb");
    let (mut json, buffer) = glb_parts(&glb);
    json["buffers"][0]["uri"] = "points%20of.bin".into();
    bench.write("scan.gltf", json.to_string());
    bench.write("points of.bin", buffer);
    list(&bench, &["scan.gltf,f0/landmarks.json,,,rigid"]);
    let command = format!("batch scans.csv --out out {OPTIONS} --unit landmarks=mm");
    let done_before = |is: bool| {
        let run = bench.run(&command);
        assert_eq!(said(&run.stderr)["scan"].starts_with("done before"), is, "{}", run.stderr);
    };
    done_before(false);
    done_before(true);
    let report = bench.json("out/scan.json");
    let inputs: Vec<(&str, &str)> = report["inputs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|i| (i["name"].as_str().unwrap(), i["sha256"].as_str().unwrap()))
        .collect();
    assert!(inputs.contains(&("points of.bin", &sha256(buffer))), "{inputs:?}");
    let mut other = buffer.to_vec();
    other.push(0);
    bench.write("points of.bin", &other);
    done_before(false);
    bench.write("points of.bin", buffer);
    done_before(false);
    done_before(true);
}

#[test]
fn a_pipe_is_no_scan_of_a_batch_and_no_name_is_too_long_for_its_files() {
    let bench = bench();
    assert!(Command::new("mkfifo").arg(bench.path("pipe.ply")).status().unwrap().success());
    list(&bench, &["pipe.ply,,,,", "case/scan.ply,case/landmarks.json,,person,rigid"]);
    let said = said(&bench.ends(&format!("batch scans.csv --out out {OPTIONS}"), 2));
    assert!(said["pipe"].contains("pipe.ply: cannot be read: it is no regular file"), "{said:?}");
    assert!(!said["person"].contains("failed"), "{said:?}");
    // nor is one in the place of what a batch writes, or has written, opened
    list(&bench, &["case/scan.ply,case/landmarks.json,,person,rigid"]);
    let cases = [
        ("log/person.json", 2, "is no file, so nothing can be noted there"),
        ("person.json", 3, "is there, and no record"),
        ("summary.csv", 3, "is there, and no record"),
        (".nonrigid/wrote-1-of-1.json", 3, "is there, and no record"),
        (".nonrigid/1-far-0.lock", 3, "another batch writes here"),
    ];
    for (name, code, words) in cases {
        bench.done(&format!("batch scans.csv --out piped {OPTIONS}"));
        let path = bench.path(&format!("piped/{name}"));
        let _ = fs::remove_file(&path); // there is no lock
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        let stderr = bench.ends(&format!("batch scans.csv --out piped {OPTIONS}"), code);
        assert!(stderr.contains(words), "{name}: {stderr}");
        fs::remove_dir_all(bench.path("piped")).unwrap();
    }
    let name = "n".repeat(249);
    list(&bench, &[&format!("case/scan.ply,case/landmarks.json,,{name},rigid")]);
    let stderr = bench.ends(&format!("batch scans.csv --out long {OPTIONS}"), 3);
    assert!(stderr.contains(&name) && stderr.contains("give a shorter name"), "{stderr}");
    assert!(!bench.path("long").exists());
}
