//! What befalls a program from outside: full disks, folders that cannot be written, Ctrl-C, a kill in the middle of a write.
#![cfg(unix)]

use std::fs;
use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::closed_stdout::closed_pipe;
use crate::skip::skipped;
use crate::support::{Bench, endless_schedule, files_in};
use nonrigid::io::{read_polygon_mesh, sha256, write_atomically};
use serde_json::Value;

const FIT: &str = "register --template rig/template.obj --neutral case/neutral.npy --rig rig --target case/scan.ply \
                   --landmarks case/landmarks.json";

fn start(bench: &Bench, arguments: &str) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
    command.args(arguments.split_whitespace()).current_dir(bench.path(""));
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Waits until a program has a handler of SIGTERM, as `register` has from its first step on; where the system does not say, some time.
fn await_handler(child: &Child) {
    let catches = || {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        caught.is_some_and(|mask| u64::from_str_radix(mask.trim(), 16).unwrap() & 1 << 14 != 0)
    };
    let begin = Instant::now();
    while !catches() && begin.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The end of a program that was told to end, within a minute.
fn ended(mut child: Child) -> Output {
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(begin.elapsed() < Duration::from_secs(60), "it does not end");
        std::thread::sleep(Duration::from_millis(10));
    }
    child.wait_with_output().unwrap()
}

#[test]
fn ctrl_c_ends_a_registration_at_the_next_step_with_what_it_has() {
    let bench = Bench::new();
    bench.write("endless.toml", endless_schedule());
    let child = start(&bench, &format!("{FIT} --config endless.toml --out r.obj --report r.json --picture r.png"));
    await_handler(&child);
    signal(&child, "-INT");
    let output = ended(child);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    let warnings: Vec<&str> = said.lines().filter(|l| l.starts_with("warning: interrupted: r.obj holds")).collect();
    assert!(warnings.len() == 1 && !said.contains("error"), "{said}");
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let result = read_polygon_mesh(&bench.path("r.obj")).unwrap();
    let mut template = template.with_positions(result.positions.clone());
    template.metadata.material_libraries = vec!["r.mtl".into()];
    assert!(template == result);
    let report = bench.json("r.json");
    assert_eq!(report["stop"], "stopped_by_observer");
    let steps = report["history"].as_array().unwrap().len();
    assert!((1..1_000_000).contains(&steps), "{steps}");
    assert!(text(&output.stdout).contains(&format!("hybrid: {steps} steps")), "{}", text(&output.stdout));
    assert!(bench.read("r.png").len() > 1000);
}

/// A registration that does not end by itself and has read everything: its landmarks, which come last, are a pipe.
fn start_endless(bench: &Bench, outputs: &str) -> Child {
    bench.write("endless.toml", endless_schedule());
    let (path, landmarks) = (bench.path("case/landmarks.json"), bench.read("case/landmarks.json"));
    fs::remove_file(&path).unwrap();
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    let child = start(bench, &format!("{FIT} --config endless.toml {outputs}"));
    // opens when the other side does
    fs::OpenOptions::new().write(true).open(&path).unwrap().write_all(&landmarks).unwrap();
    fs::remove_file(&path).unwrap();
    bench.write("case/landmarks.json", landmarks);
    await_handler(&child);
    child
}

#[test]
fn one_signal_ends_what_waits_for_an_input() {
    let bench = Bench::new();
    fs::remove_file(bench.path("case/scan.ply")).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("case/scan.ply")).status().unwrap().success());
    for (name, number) in [("-TERM", 15), ("-INT", 2)] {
        let before = files_in(&bench.path(""));
        let child = start(&bench, &format!("{FIT} --out r.obj --report r.json"));
        std::thread::sleep(Duration::from_millis(500));
        signal(&child, name);
        let output = ended(child);
        assert_eq!(output.status.signal(), Some(number), "{}", text(&output.stderr));
        assert_eq!(files_in(&bench.path("")), before);
    }
}

#[test]
fn sigterm_is_as_ctrl_c() {
    let bench = Bench::new();
    let child = start_endless(&bench, "--out r.obj --report r.json");
    signal(&child, "-TERM");
    let output = ended(child);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(143), "{said}");
    assert!(said.contains("warning: interrupted: r.obj holds") && !said.contains("error"), "{said}");
    let report = bench.json("r.json");
    assert_eq!(report["stop"], "stopped_by_observer");

    let child = start_endless(&bench, "--out s.obj");
    ["-STOP", "-INT", "-CONT", "-TERM"].into_iter().for_each(|name| signal(&child, name));
    let output = ended(child);
    // the second one ends it at once, unless the first has done so already
    assert!([Some(143), Some(130)].contains(&output.status.code()), "{}", text(&output.stderr));
}

/// Name and hash of what a report says was read in this role.
fn read_as(bench: &Bench, report: &str, role: &str) -> Vec<(String, String)> {
    let report = bench.json(report);
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let of_role = report["inputs"].as_array().unwrap().iter().filter(|input| input["role"] == role);
    of_role.map(|input| (text(&input["name"]), text(&input["sha256"]))).collect()
}

#[test]
fn what_becomes_of_inputs_during_a_run_changes_nothing() {
    let bench = Bench::new();
    let hashes = ["scan.ply", "landmarks.json", "neutral.npy"].map(|name| sha256(&bench.read(&format!("case/{name}"))));
    let child = start_endless(&bench, "--out r.obj --report r.json");
    fs::remove_file(bench.path("case/scan.ply")).unwrap();
    bench.write("case/landmarks.json", "{}");
    fs::remove_file(bench.path("case/neutral.npy")).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("case/neutral.npy")).status().unwrap().success());
    fs::rename(bench.path("rig"), bench.path("elsewhere")).unwrap();
    signal(&child, "-INT");
    let output = ended(child);
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    assert!(read_polygon_mesh(&bench.path("r.obj")).is_ok());
    let [scan, landmarks, neutral] = hashes;
    assert_eq!(read_as(&bench, "r.json", "target"), [("scan.ply".to_owned(), scan)]);
    assert_eq!(read_as(&bench, "r.json", "landmarks"), [("landmarks.json".to_owned(), landmarks)]);
    assert_eq!(read_as(&bench, "r.json", "neutral"), [("neutral.npy".to_owned(), neutral)]);
    let rig = read_as(&bench, "r.json", "rig");
    assert!(rig.len() > 4, "{rig:?}");
    for (name, hash) in rig {
        assert_eq!(hash, sha256(&bench.read(&format!("elsewhere/{name}"))), "{name}");
    }
}

#[test]
fn a_pipe_is_read_once() {
    let bench = Bench::new();
    let line = format!("{FIT} --model rigid --out r.obj --report r.json");
    bench.done(&line);
    let (result, report) = (bench.read("r.obj"), bench.read("r.json"));
    let names = ["case/scan.ply", "case/neutral.npy", "case/landmarks.json"];
    let contents = names.map(|name| bench.read(name));
    for name in names {
        fs::remove_file(bench.path(name)).unwrap();
        assert!(Command::new("mkfifo").arg(bench.path(name)).status().unwrap().success());
    }
    let child = start(&bench, &line);
    for (name, content) in names.iter().zip(&contents) {
        let (path, content) = (bench.path(name), content.clone());
        // opens when the other side does
        std::thread::spawn(move || fs::OpenOptions::new().write(true).open(path).unwrap().write_all(&content).unwrap());
    }
    let output = ended(child);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(bench.read("r.obj") == result && bench.read("r.json") == report);
    // a buffer that a file names may not be one: whoever sent the file would decide for how long we wait
    assert!(Command::new("mkfifo").arg(bench.path("b.bin")).status().unwrap().success());
    bench
        .write("b.gltf", "{\"asset\": {\"version\": \"2.0\"}, \"buffers\": [{\"uri\": \"b.bin\", \"byteLength\": 4}]}");
    let output = ended(start(&bench, "register --template rig/template.obj --target b.gltf --out s.obj"));
    assert!(output.status.code() == Some(4) && text(&output.stderr).contains("b.bin"), "{}", text(&output.stderr));
}

#[test]
fn a_name_that_is_too_long_is_found_before_the_work() {
    let bench = Bench::new();
    let name = "n".repeat(249);
    bench.done(&format!("{FIT} --model rigid --out {name}.obj"));
    for (option, file) in [("--report", format!("{name}.json")), ("--state", format!("{name}xx.json"))] {
        let before = files_in(&bench.path(""));
        unwritten(&bench, &format!("{FIT} --out r.obj {option} {file}"), &[&name, option, "give a shorter name"]);
        assert_eq!(files_in(&bench.path("")), before);
    }
}

/// How many shapes a rig has, if it can be read.
fn shapes(bench: &Bench, rig: &str) -> Option<usize> {
    let run = bench.run(&format!("rig info {rig} --json"));
    let info: Value = serde_json::from_str(&run.stdout).ok()?;
    assert_eq!(run.code, 0);
    Some(info.as_array().unwrap().len())
}

#[test]
fn a_rig_is_whole_or_none_on_a_full_disk_and_after_a_kill() {
    let bench = Bench::new();
    bench.done("rig convert --rig rig --format shapes --out whole");
    let whole = shapes(&bench, "rig").unwrap();
    assert_eq!(shapes(&bench, "whole"), Some(whole));
    for format in ["npy", "shapes"] {
        let line = format!("rig convert --rig rig --format {format} --out");
        let begin = Instant::now();
        bench.done(&format!("{line} made"));
        let time = begin.elapsed();
        let mut found = [0, 0];
        for k in 0..24u32 {
            // into nothing, and into a rig that is there
            if k % 2 == 0 {
                fs::remove_dir_all(bench.path("made")).unwrap_or(());
            }
            let mut child = start(&bench, &format!("{line} made"));
            std::thread::sleep(time.mul_f64(f64::from(k) / 22.0));
            // The last one may end, however busy the machine is.
            if k < 23 {
                let _ = child.kill(); // it may have ended
            }
            child.wait().unwrap();
            let read = shapes(&bench, "made");
            assert!(read.is_none_or(|n| n == whole), "{format}: {read:?} of {whole} after {k} of 22 parts of {time:?}");
            found[usize::from(read.is_some())] += 1;
        }
        assert!(found[0] > 0 && found[1] > 0, "{found:?}: killed too late or too early every time");
        fs::remove_dir_all(bench.path("made")).unwrap_or(());
    }
    let disk = bench.path("disk");
    let Some(_disk) = SmallDisk::mount(&disk, "size=400k") else { return skipped(NO_DISK) };
    for format in ["npy", "shapes"] {
        let line = format!("rig convert --rig rig --format {format} --out disk/rig");
        unwritten(&bench, &line, &["disk/rig/", "No space left"]);
        assert!(files_in(&disk).is_empty(), "{format}: {:?}", files_in(&disk));
    }
    let small = "rig convert --rig small --format shapes --out disk/rig";
    for name in ["neutral", "smile", "frown"] {
        bench.write(&format!("small/{name}.obj"), format!("v 0 0 0\nv 200 0 0\nv 0 {} 0\nf 1 2 3\n", 200 + name.len()));
    }
    bench.done(small);
    bench.write("disk/rig/notes.txt", "mine");
    let before = files_in(&bench.path("disk/rig"));
    let masks = "rig convert --rig rig --out disk/rig";
    assert_eq!(bench.run(masks).code, 3);
    assert_eq!(files_in(&bench.path("disk/rig")), before);
    assert_eq!(shapes(&bench, "disk/rig"), shapes(&bench, "small"));
}

#[test]
fn a_second_ctrl_c_ends_it_there_and_then() {
    let bench = Bench::new();
    bench.write("endless.toml", endless_schedule());
    bench.write("r.obj", "from last week");
    // Stopped, it cannot take the step that the first one waits for.
    let child = start(&bench, &format!("{FIT} --config endless.toml --out r.obj"));
    await_handler(&child);
    signal(&child, "-STOP");
    signal(&child, "-INT");
    signal(&child, "-CONT");
    signal(&child, "-INT");
    let output = ended(child);
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    // Whole, whichever it is.
    let old = bench.read("r.obj") == b"from last week";
    assert!(old || read_polygon_mesh(&bench.path("r.obj")).unwrap().positions.len() == bench.rig.neutral.len());
}

#[test]
fn a_kill_at_any_time_leaves_the_old_file_or_the_new_one() {
    let bench = Bench::new();
    let line = format!("{FIT} --model rigid --out r.obj --report r.json --picture r.png");
    let begin = Instant::now();
    bench.done(&line);
    let whole = begin.elapsed();
    let names = ["r.obj", "r.json", "r.png"];
    let new = names.map(|name| bench.read(name));
    let mut found = [0, 0];
    for k in 0..40u32 {
        names.iter().for_each(|name| bench.write(name, "from last week"));
        let mut child = start(&bench, &line);
        std::thread::sleep(whole.mul_f64(f64::from(k) / 36.0));
        let _ = child.kill(); // it may have ended
        child.wait().unwrap();
        for (name, new) in names.iter().zip(&new) {
            let content = bench.read(name);
            assert!(content == *new || content == b"from last week", "{name} after {k} of 36 parts of {whole:?}");
            found[usize::from(content == *new)] += 1;
        }
    }
    assert!(found[0] > 0 && found[1] > 0, "{found:?}: killed too late or too early every time");
}

/// The part of [`a_kill_in_mid_write_leaves_the_old_file`] that is killed: writes half of a file, says so, and waits.
#[test]
#[ignore = "runs in a process of its own"]
fn half_a_file() {
    let Some(path) = std::env::var_os("NONRIGID_HALF_A_FILE") else { return };
    let written = write_atomically(Path::new(&path), |out| {
        out.write_all(&[b'x'; 1 << 20])?;
        println!("half");
        std::thread::sleep(Duration::from_secs(60));
        out.write_all(&[b'x'; 1 << 20])
    });
    written.unwrap();
}

#[test]
fn a_kill_in_mid_write_leaves_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.txt");
    fs::write(&path, "from last week").unwrap();
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "faults::half_a_file", "--ignored", "--nocapture"]).env("NONRIGID_HALF_A_FILE", &path);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    assert!(lines.any(|line| line.unwrap().contains("half")));
    child.kill().unwrap();
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    assert_eq!(fs::read(&path).unwrap(), b"from last week");
    // What it had written stays behind under a name that nobody reads.
    let names = files_in(folder.path());
    assert!(names.len() == 2 && names[0].starts_with(".old.txt.") && names[0].ends_with(".tmp"), "{names:?}");
    // And the next writer does not mind.
    write_atomically(&path, |out| out.write_all(b"new")).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"new");
}

const NO_DISK: &str = "this process may not mount a disk";

/// A small disk of its own, if this process may have one.
struct SmallDisk<'a>(&'a Path);

impl<'a> SmallDisk<'a> {
    fn mount(folder: &'a Path, options: &str) -> Option<Self> {
        fs::create_dir_all(folder).unwrap();
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(folder).output();
        if !mount.is_ok_and(|m| m.status.success()) {
            return None;
        }
        Some(Self(folder))
    }
}

impl Drop for SmallDisk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).status(); // a test that fails has already said why
    }
}

/// One clear error of writing.
fn unwritten(bench: &Bench, line: &str, words: &[&str]) {
    let stderr = bench.ends(line, 3);
    assert_eq!(stderr.lines().filter(|l| l.starts_with("error: ")).count(), 1, "{line}\n{stderr}");
    for word in words {
        assert!(stderr.contains(word), "{line}\n{stderr}\nlacks {word:?}");
    }
}

#[test]
fn a_full_disk_is_an_error_of_writing_and_leaves_old_files_whole() {
    let bench = Bench::new();
    let disk = bench.path("disk");
    let Some(_disk) = SmallDisk::mount(&disk, "size=32k") else { return skipped(NO_DISK) };
    for name in ["r.obj", "r.json", "h.png"] {
        bench.write(&format!("disk/{name}"), "from last week");
    }
    unwritten(&bench, &format!("{FIT} --model rigid --out disk/r.obj"), &["disk/r.obj", "No space left"]);
    unwritten(&bench, &format!("{FIT} --out r.obj --report disk/r.json"), &["disk/r.json", "No space left"]);
    let eval = "eval --result case/truth.npy --template rig/template.obj --truth case/truth.npy --heatmap disk/h.png";
    unwritten(&bench, eval, &["disk/h.png", "No space left"]);
    for k in 0..4 {
        let weight = 0.1 * f64::from(k * k);
        bench.write(
            &format!("people/{k}.obj"),
            (0..900).map(|i| format!("v {} {} {}\n", i % 30, i / 30, weight * f64::from(i % 7))).collect::<String>()
                + "f 1 2 32 31\n",
        );
    }
    unwritten(
        &bench,
        "rig pca --meshes people --components 1 --align none --out disk/rig",
        &["disk/rig/", "No space left"],
    );
    for name in ["r.obj", "r.json", "h.png"] {
        assert_eq!(bench.read(&format!("disk/{name}")), b"from last week", "{name}");
    }
    let others: Vec<String> = files_in(&disk).into_iter().filter(|n| n != "rig").collect();
    assert_eq!(others, ["h.png", "r.json", "r.obj"], "nothing half is left");
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_of_writing() {
    let bench = Bench::new();
    let folder = bench.path("closed");
    // The permissions of a folder stop everybody but root, a disk that is mounted read-only stops root too.
    let _disk = SmallDisk::mount(&folder, "ro");
    fs::create_dir_all(&folder).unwrap();
    let mut permissions = fs::metadata(&folder).unwrap().permissions();
    permissions.set_readonly(true);
    let _ = fs::set_permissions(&folder, permissions); // a read-only disk needs none
    if fs::write(folder.join("probe"), "").is_ok() {
        return skipped("nothing is closed to this process");
    }
    unwritten(&bench, &format!("{FIT} --model rigid --out closed/r.obj"), &["closed/r.", "cannot be written"]);
    unwritten(&bench, &format!("{FIT} --out r.obj --picture closed/r.png"), &["closed/r.png", "cannot be written"]);
    assert!(files_in(&folder).is_empty());
}

#[test]
fn nobody_reads_what_is_said() {
    let bench = Bench::new();
    for (line, code) in [
        ("rig info rig", 0),
        ("rig info missing", 4),
        ("regsiter", 1),
        (
            "register --template rig/template.obj --target case/scan.ply --model graph --landmarks case/landmarks.json --out r.obj",
            0,
        ),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nonrigid"));
        command.args(line.split_whitespace()).current_dir(bench.path("")).stdout(closed_pipe()).stderr(closed_pipe());
        assert_eq!(command.status().unwrap().code(), Some(code), "{line}");
    }
    assert!(read_polygon_mesh(&bench.path("r.obj")).is_ok());
}
