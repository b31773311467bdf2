//! What people get wrong with `experiments`, over all its subcommands.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::refusal::{ARGUMENTS, LOADING, WRITING, all_hold, refuses};
use experiments::generated::write_standard_cases;

/// One row: command line, exit code, words of the message.
type Row = (&'static str, i32, &'static [&'static str]);

#[rustfmt::skip]
const ROWS: &[Row] = &[
    // the report
    ("--only fig9", ARGUMENTS, &["--only fig9", "sweeps"]),
    ("--only real", ARGUMENTS, &["--only real", "--scans"]),
    ("--only inputs,fig9", ARGUMENTS, &["--only fig9", "inputs"]),
    ("--quick --full", ARGUMENTS, &["--full"]),
    ("--rig rig", ARGUMENTS, &["--scans"]),
    ("--scans cases", ARGUMENTS, &["--rig"]),
    ("--threads 0", ARGUMENTS, &["--threads", "0"]),
    ("--seed -1", ARGUMENTS, &["-1"]),
    ("--seed 1 scan-bench cases --rig rig", ARGUMENTS, &["--seed"]),
    ("--quick --only inputs --out file/below", WRITING, &["file/below"]),
    ("--only inputs --rig nowhere --scans nowhere", LOADING, &["nowhere"]),
    ("--only inputs --rig rig --scans empty --out old", WRITING, &["old/claims.json", "move it away"]),
    ("--only inputs --out old", WRITING, &["old/claims.json", "no experiments.json", "move it away"]),
    ("--only inputs --out piped", WRITING, &["piped/experiments.json", "a regular file", "a pipe", "move it away"]),
    ("--only inputs --rig rig --scans plain", ARGUMENTS, &["--scans", "case.json", "real"]),
    ("--only inputs --peers cargo", ARGUMENTS, &["--peers", "--only"]),
    ("--only peers --peers nowhere/python", ARGUMENTS, &["--peers nowhere/python", "cannot be started"]),
    ("--only inputs --rig empty --scans cases --out fresh", LOADING, &["empty", "neutral"]),
    ("regsiter", ARGUMENTS, &["regsiter"]),
    // scan-bench
    ("scan-bench", ARGUMENTS, &["--rig"]),
    ("scan-bench cases", ARGUMENTS, &["--rig"]),
    ("scan-bench nowhere --rig rig", LOADING, &["nowhere"]),
    ("scan-bench empty --rig rig", LOADING, &["empty", "case.json"]),
    ("scan-bench cases --rig nowhere", LOADING, &["nowhere"]),
    ("scan-bench cases --rig empty", LOADING, &["empty", "neutral"]),
    ("scan-bench bad_case --rig rig", LOADING, &["bad_case/one/case.json", "rig_identity_modes"]),
    ("scan-bench no_truth --rig rig", LOADING, &["no_truth/one/truth.npy"]),
    ("scan-bench short_truth --rig rig", LOADING, &["short_truth/one/truth.npy", "2 points", "template has"]),
    ("scan-bench odd_shape --rig rig", LOADING, &["odd_shape/one/case.json", "jawOpne"]),
    ("scan-bench cases --rig rig --models magic", ARGUMENTS, &["magic", "hybrid"]),
    ("scan-bench cases --rig rig --landmarks 2", ARGUMENTS, &["--landmarks", "at least 3"]),
    ("scan-bench cases --rig rig --landmarks 1000", ARGUMENTS, &["--landmarks 1000", "same_smile has"]),
    ("scan-bench cases --rig rig --landmarks some", ARGUMENTS, &["--landmarks", "some", "align"]),
    ("scan-bench cases --rig rig --turn NaN", ARGUMENTS, &["--turn", "finite"]),
    ("scan-bench cases --rig rig --turn far", ARGUMENTS, &["--turn", "finite"]),
    ("scan-bench cases --rig rig --shift inf", ARGUMENTS, &["--shift", "finite"]),
    ("scan-bench cases --rig rig --config nowhere.toml", LOADING, &["nowhere.toml"]),
    ("scan-bench cases --rig rig --config bad.toml", LOADING, &["bad.toml", "stepps"]),
    ("scan-bench cases --rig rig --models rigid --out file", WRITING, &["file"]),
    ("scan-bench cases --rig rig --threads 0", ARGUMENTS, &["--threads", "0"]),
    ("scan-bench cases --rig in_metres", LOADING, &["in_metres", "millimetres", "a face in m"]),
    ("scan-bench twins --rig rig --models rigid", LOADING, &["two cases are called \"one\""]),
    ("scan-bench cases --rig rig --models none --kernels --config bad.toml", ARGUMENTS, &["--config", "no effect"]),
    ("scan-bench cases --rig rig --models rigid --out old", WRITING, &["old/claims.json", "move it away"]),
    ("scan-bench truth_in_metres --rig rig", LOADING, &["truth_in_metres/one/truth.npy", "a face in m"]),
    ("scan-bench cases --rig rig --models rigid --out mine", WRITING, &["mine/same_smile/rigid.obj", "move it away"]),
    ("--quick --only extreme --out of_report", WRITING, &["of_report/extreme/hybrid.obj", "move it away"]),
    ("--quick --only inputs --out of_data", WRITING, &["of_data/data/quick/rig/template.obj", "move it away"]),
    ("--quick --only inputs --out of_paper", WRITING, &["of_paper/inputs.tex", "move it away"]),
    ("scan-bench cases --rig rig --models none", ARGUMENTS, &["leaves nothing to run"]),
    ("scan-bench cases --rig rig --models rigid,rigid", ARGUMENTS, &["--models names rigid twice"]),
    ("scan-bench cases --rig rig --external empty", ARGUMENTS, &["\"empty\" is not NAME=DIR"]),
    ("scan-bench cases --rig rig --external a=empty --external a=cases", ARGUMENTS, &["--external names a twice"]),
    ("scan-bench cases --rig rig --external a=nowhere", LOADING, &["--external a=nowhere: there is no such folder"]),
    ("scan-bench cases --rig rig --external a=empty", LOADING, &["--external a=empty: no result of any case; looked for same_smile.obj"]),
    ("scan-bench --run {}", ARGUMENTS, &["--run"]),
    ("scan-bench scan_in_metres --rig rig", LOADING, &["scan_in_metres/one/scan.ply", "a face in m"]),
    ("--only peers", ARGUMENTS, &["--only peers", "--peers"]),
    // peers
    ("peers cases", ARGUMENTS, &["--rig"]),
    ("peers nowhere --rig rig", LOADING, &["nowhere"]),
    ("peers cases --rig rig --methods magic", ARGUMENTS, &["magic", "scipy-map"]),
    ("peers cases --rig rig --models rigid --methods scipy-map --python nowhere/python", ARGUMENTS, &["--python nowhere/python"]),
    ("peers cases --rig rig --methods scipy-map,scipy-map", ARGUMENTS, &["--methods names scipy-map twice"]),
    ("peers cases --rig rig --timeout 0", ARGUMENTS, &["--timeout", "0"]),
    ("peers cases --rig rig --models rigid --out file", WRITING, &["file: cannot be written: it is a file, not a folder"]),
    ("peers cases --rig rig --models rigid --python cargo --out mine", WRITING, &["mine/same_smile/rigid.obj", "move it away"]),
    // consistency
    ("consistency --rig rig", ARGUMENTS, &["--population"]),
    ("consistency --population nowhere --rig rig", LOADING, &["nowhere"]),
    ("consistency --population empty --rig rig", LOADING, &["empty", "at least 2"]),
    ("consistency --population faces.npy --rig rig", ARGUMENTS, &["--template-of-population"]),
    ("consistency --population nowhere.npy --template-of-population rig/template.obj --rig rig", LOADING, &["nowhere.npy"]),
    ("consistency --population rig/neutral.npy --template-of-population rig/template.obj --rig rig", LOADING, &["neutral.npy"]),
    ("consistency --population cases --template-of-population rig/template.obj --rig rig", ARGUMENTS, &["--template-of-population"]),
    ("consistency --population empty --rig rig --models magic", ARGUMENTS, &["magic", "klimov2020"]),
    ("consistency --population empty --rig rig --count 1", ARGUMENTS, &["--count", "1"]),
    ("consistency --population empty --rig rig --within 0", ARGUMENTS, &["--within", "positive"]),
    ("consistency --population empty --rig rig --identity-modes 1000", ARGUMENTS, &["--identity-modes", "the rig has"]),
    // ceres
    ("ceres --program nowhere", ARGUMENTS, &["--program nowhere", "experiments ceres --help"]),
    ("ceres --program empty", ARGUMENTS, &["--program empty", "cannot be started"]),
    ("ceres --program cargo --nonrigid nowhere", ARGUMENTS, &["--nonrigid nowhere", "cannot be started"]),
    ("ceres --program cargo --nonrigid cargo --out file", WRITING, &["file"]),
    ("ceres --seed one", ARGUMENTS, &["--seed", "one"]),
    // start-bench
    ("dev start-bench --rig rig", ARGUMENTS, &["DIR_OR_SCAN"]),
    ("dev start-bench cases", ARGUMENTS, &["--rig"]),
    ("dev start-bench cases --rig nowhere", LOADING, &["nowhere"]),
    ("dev start-bench empty --rig rig", LOADING, &["empty", "case.json"]),
    ("dev start-bench nowhere.ply --rig rig", LOADING, &["nowhere.ply"]),
    ("dev start-bench garbage.ply --rig rig", LOADING, &["garbage.ply", "line 1"]),
    ("dev start-bench cases --rig rig --turns 0,NaN", ARGUMENTS, &["--turns", "NaN"]),
    ("dev start-bench cases --rig rig --turns 0;90", ARGUMENTS, &["--turns", "0;90"]),
    ("dev start-bench cases --rig rig --shift inf", ARGUMENTS, &["--shift", "inf"]),
    ("dev start-bench scan_in_metres/one/scan.ply --rig rig", LOADING, &["scan.ply", "a face in m"]),
    ("dev start-bench scan_in_metres/one/scan.ply --rig rig --kinds all", ARGUMENTS, &["scan.ply", "--kinds", "folder"]),
    ("dev start-bench cases --rig rig --kinds turned,turned", ARGUMENTS, &["--kinds names turned twice"]),
    ("dev start-bench cases --rig rig --kinds all --turns 90", ARGUMENTS, &["cannot be used with"]),
    ("dev start-bench cases --rig rig --vertical --shift 10", ARGUMENTS, &["cannot be used with"]),
    // real-scans
    ("real-scans --rig rig", ARGUMENTS, &["--scans"]),
    ("real-scans --scans cases", ARGUMENTS, &["--rig"]),
    ("real-scans --rig rig --scans nowhere", LOADING, &["nowhere", "--scans"]),
    ("real-scans --rig rig --scans empty", LOADING, &["empty", "no mesh", ".ply"]),
    ("real-scans --rig rig --scans scan_in_metres", LOADING, &["none of the scans", "a face in m"]),
    ("real-scans --rig nowhere --scans cases", LOADING, &["--rig", "nowhere"]),
    ("real-scans --rig rig --scans cases --models magic", ARGUMENTS, &["magic", "hybrid"]),
    ("real-scans --rig rig --scans cases --identity-modes many", ARGUMENTS, &["--identity-modes", "many"]),
    ("real-scans --rig rig --scans cases --identity-modes 1000", ARGUMENTS, &["--identity-modes: 1000", "the rig has"]),
    ("real-scans --rig rig --scans cases --models rigid,rigid", ARGUMENTS, &["--models names rigid twice"]),
    ("real-scans --rig rig --scans cases --models rigid --out old", WRITING, &["old/claims.json", "move it away"]),
    ("real-scans --rig rig --scans cases --models rigid --out mine", WRITING, &["mine/scan/rigid.obj", "move it away"]),
    // unseen
    ("unseen cases", ARGUMENTS, &["--rig"]),
    ("unseen nowhere --rig rig", LOADING, &["nowhere"]),
    ("unseen cases --rig nowhere", LOADING, &["nowhere"]),
    ("unseen twins --rig rig", LOADING, &["two cases are called \"one\""]),
    ("unseen cases --rig rig --views top", ARGUMENTS, &["top", "half"]),
    ("unseen cases --rig rig --views half,half", ARGUMENTS, &["--views names half twice"]),
    ("unseen cases --rig rig --models rigid,rigid", ARGUMENTS, &["--models names rigid twice"]),
    ("unseen cases --rig rig --out rig", ARGUMENTS, &["--out rig", "is read (--rig)"]),
    ("unseen cases --rig rig --out cases", ARGUMENTS, &["--out cases", "is read (DIR)"]),
    ("unseen cases --rig rig --out old", WRITING, &["old/claims.json", "move it away"]),
    // flicker
    ("flicker --seeds 7,7", ARGUMENTS, &["--seeds names 7 twice"]),
    ("flicker --rates 10 --seconds 0.2", ARGUMENTS, &["--seconds 0.2", "2 frames", "--rates 10"]),
    ("flicker --rates 60,15 --cutoffs 5,50", ARGUMENTS, &["--cutoffs 50", "half of --rates 60"]),
    ("flicker --rates 60,10 --cutoffs 5,6", ARGUMENTS, &["--cutoffs 6", "half of --rates 10"]),
    ("flicker --seconds 0", ARGUMENTS, &["--seconds", "above 0"]),
    // silence
    ("silence --rig rig", ARGUMENTS, &["--cases"]),
    ("silence --case-runs 3", ARGUMENTS, &["--cases"]),
    ("silence --kinds noise;noise", ARGUMENTS, &["--kinds names noise twice"]),
    ("silence --cases cases --rig rig --out cases", ARGUMENTS, &["--out cases", "is read (--cases)"]),
    ("silence --kinds magic", ARGUMENTS, &["magic", "inside out"]),
    ("silence --runs 0", ARGUMENTS, &["--runs", "0"]),
    ("silence --vertices 999", ARGUMENTS, &["--vertices", "999"]),
    ("silence --out file/below", WRITING, &["file/below: cannot be written: file is a file, not a folder"]),
    ("silence --calibrate new.toml", ARGUMENTS, &["--calibrate", "--set design"]),
    ("silence --set design --runs 1 --calibrate new.toml", ARGUMENTS, &["--calibrate", "20 bad results and 20 others"]),
    ("silence --set design --runs 1000 --calibrate nowhere/new.toml", WRITING, &["--calibrate", "no folder nowhere"]),
    ("silence --set design --runs 1000 --calibrate bad.toml", WRITING, &["--calibrate bad.toml", "is there"]),
    ("silence --set design --runs 1000 --config bad.toml --calibrate bad.toml", ARGUMENTS, &["--calibrate bad.toml", "is read (--config)"]),
    ("silence --set design --runs 1000 --out empty --calibrate empty/silence.csv", ARGUMENTS, &["--calibrate empty/silence.csv", "--out writes"]),
    ("silence --set design --runs 1000 --calibrate empty", WRITING, &["empty", "a folder"]),
    // search-schedules
    ("dev search-schedules --models magic", ARGUMENTS, &["magic", "hybrid"]),
    ("dev search-schedules --models rigid,rigid", ARGUMENTS, &["--models names rigid twice"]),
    ("dev search-schedules --seeds 1,1", ARGUMENTS, &["--seeds names 1 twice"]),
    ("dev search-schedules --vertices 999", ARGUMENTS, &["--vertices", "999"]),
    ("dev search-schedules --budget 0", ARGUMENTS, &["--budget", "0"]),
    ("dev search-schedules --seeds one", ARGUMENTS, &["--seeds", "one"]),
    ("dev search-schedules --models rigid --vertices 1000 --budget 1 --out file", WRITING, &["file"]),
    // solver-case
    ("dev solver-case", ARGUMENTS, &["CASE.npz"]),
    ("dev solver-case nowhere.npz", LOADING, &["nowhere.npz"]),
    ("dev solver-case garbage.npz", LOADING, &["garbage.npz", "NPZ"]),
    ("dev solver-case empty", LOADING, &["empty"]),
    ("dev solver-case garbage.npz --linear-solver magic", ARGUMENTS, &["magic"]),
    ("dev solver-case garbage.npz --algorithm magic", ARGUMENTS, &["--algorithm", "dogleg"]),
    ("dev solver-case garbage.npz --max-iterations 0", ARGUMENTS, &["--max-iterations"]),
    ("dev solver-case garbage.npz --json --report", ARGUMENTS, &["--report"]),
    // scaling
    ("scaling --sizes 5000,999", ARGUMENTS, &["--sizes: 999, expected 1000 to 500000"]),
    ("scaling --sizes 1000,1000", ARGUMENTS, &["--sizes names 1000 twice"]),
    ("scaling --sizes 1000 --threads 1,1", ARGUMENTS, &["--threads names 1 twice"]),
    ("scaling --sizes 1000 --linear-solver auto,auto", ARGUMENTS, &["--linear-solver names auto twice"]),
    ("scaling --sizes 1000 --linearisation reference,reference", ARGUMENTS, &["--linearisation names reference twice"]),
    ("scaling --sizes 1000 --threads 1 --out old", WRITING, &["old/claims.json", "move it away"]),
    ("scaling --sizes none", ARGUMENTS, &["leave nothing to run"]),
    ("scaling --sizes ten", ARGUMENTS, &["--sizes", "ten"]),
    ("scaling --sizes 1000,2000 --nodes 50", ARGUMENTS, &["--nodes: 1 numbers for 2 --sizes"]),
    ("scaling --sizes 1000 --nodes 1001", ARGUMENTS, &["--nodes: 1001, expected 1 to 1000"]),
    ("scaling --threads 0", ARGUMENTS, &["--threads: 0"]),
    ("scaling --shapes 100000", ARGUMENTS, &["--shapes: 100000"]),
    ("scaling --scan-triangles 10", ARGUMENTS, &["--scan-triangles: 10"]),
    ("scaling --scan-template 10", ARGUMENTS, &["--scan-template: 10"]),
    ("scaling --iterations 0", ARGUMENTS, &["--iterations"]),
    ("scaling --linear-solver magic", ARGUMENTS, &["no linear solver is called \"magic\""]),
    ("scaling --linear-solver auto,dense", ARGUMENTS, &["--linear-solver dense with 5000 nodes: 30050 unknowns, a square of 7.2 GB"]),
    ("scaling --sizes 1000 --threads 1 --out file", WRITING, &["file"]),
    ("scaling --run {}", ARGUMENTS, &["--run"]),
    // compare-rigs
    ("compare-rigs", ARGUMENTS, &["DIR"]),
    ("compare-rigs rig nowhere", LOADING, &["nowhere"]),
    ("compare-rigs empty", LOADING, &["empty", "neutral"]),
    ("compare-rigs in_metres", LOADING, &["in_metres", "a face in m"]),
    // nist and more-garbow-hillstrom
    ("dev nist --data nowhere", LOADING, &["nowhere"]),
    ("dev nist --data empty", LOADING, &["empty"]),
    ("dev nist --data bad_nist", LOADING, &["bad_nist"]),
    ("dev more-garbow-hillstrom --problem 1", ARGUMENTS, &["--problem"]),
];

/// A rig, a case, and cases and files that are broken.
fn data(folder: &Path) {
    write_standard_cases(folder, 1000, 5000, &["same_smile"], 7).unwrap();
    let case = folder.join("cases/same_smile");
    let copy = |to: &str| {
        let to = folder.join(to);
        fs::create_dir_all(&to).unwrap();
        for file in fs::read_dir(&case).unwrap().map(|entry| entry.unwrap().path()) {
            fs::copy(&file, to.join(file.file_name().unwrap())).unwrap();
        }
        to
    };
    fs::write(copy("bad_case/one").join("case.json"), "{\"rig_expressions\": []}").unwrap();
    fs::write(
        copy("odd_shape/one").join("case.json"),
        "{\"rig_expressions\": [\"jawOpne\"], \"rig_identity_modes\": 0}",
    )
    .unwrap();
    fs::remove_file(copy("no_truth/one").join("truth.npy")).unwrap();
    let points = [nonrigid::mesh::Vec3::zeros(); 2];
    nonrigid::io::write_npy_points(&copy("short_truth/one").join("truth.npy"), &points).unwrap();
    let path = copy("truth_in_metres/one").join("truth.npy");
    let truth: Vec<_> = nonrigid::io::read_npy_points(&path).unwrap().iter().map(|p| p * 1e-3).collect();
    nonrigid::io::write_npy_points(&path, &truth).unwrap();
    fs::remove_file(copy("plain").join("case.json")).unwrap();
    let path = copy("scan_in_metres/one").join("scan.ply");
    let mut scan = nonrigid::io::read_scan(&path).unwrap().mesh;
    scan.positions.iter_mut().for_each(|p| *p *= 1e-3);
    nonrigid::io::write_ply(&path, &scan, nonrigid::io::PlyOptions::default()).unwrap();
    let (mut rig, _) =
        nonrigid::rig::Rig::read(&folder.join("rig"), &nonrigid::rig::RigReadOptions::default()).unwrap();
    rig.scale(1e-3);
    fs::create_dir_all(folder.join("in_metres")).unwrap();
    rig.write(&folder.join("in_metres")).unwrap();
    copy("twins/one");
    copy("twins/again/one");
    let write = |name: &str, text: &[u8]| {
        fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
        fs::write(folder.join(name), text).unwrap();
    };
    write("file", b"");
    fs::create_dir(folder.join("piped")).unwrap();
    assert!(Command::new("mkfifo").arg(folder.join("piped/experiments.json")).status().unwrap().success());
    write("empty/readme.txt", b"nothing here");
    write("garbage.ply", &[0, 159, 146, 150, 10, 255]);
    write("garbage.npz", b"PK\x03\x04 and no more");
    write("bad.toml", b"stepps = 3\n");
    write("bad_nist/Misra1a.dat", b"NIST/ITL StRD\nDataset Name:  Misra1a\n");
    let mine = [
        "mine/same_smile/rigid.obj",
        "mine/scan/rigid.obj",
        "of_report/extreme/hybrid.obj",
        "of_data/data/quick/rig/template.obj",
    ];
    let old = ["old/index.html", "old/extreme.csv", "old/claims.json", "of_paper/inputs.tex"];
    for name in old.into_iter().chain(mine) {
        write(name, b"from last week");
    }
}

#[test]
fn every_row_is_one_clear_error_and_leaves_no_trace() {
    let folder = tempfile::tempdir().unwrap();
    data(folder.path());
    let check =
        |&(line, code, words): &Row| refuses(env!("CARGO_BIN_EXE_experiments"), folder.path(), line, code, words).err();
    all_hold(ROWS.len(), &ROWS.iter().filter_map(check).collect::<Vec<_>>());
}
