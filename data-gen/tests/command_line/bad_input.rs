//! What people get wrong with `data-gen`.

use std::process::Command;

use nonrigid::io::write_npy;

use crate::refusal::{ARGUMENTS, COMPUTATION, LOADING, WRITING, all_hold, refuses};

/// One row: options besides `--out data`, exit code, words of the message.
type Row = (&'static str, i32, &'static [&'static str]);

#[rustfmt::skip]
const ROWS: &[Row] = &[
    // the rig
    ("--vertices 999", ARGUMENTS, &["--vertices", "1000 to 500000"]),
    ("--vertices 500001", ARGUMENTS, &["--vertices", "1000 to 500000"]),
    ("--vertices 99999999999999999999", ARGUMENTS, &["--vertices", "1000 to 500000"]),
    ("--vertices -5000", ARGUMENTS, &["--vertices", "1000 to 500000"]),
    ("--identity-modes 201", ARGUMENTS, &["--identity-modes", "0 to 200"]),
    ("--seed -1", ARGUMENTS, &["--seed", "-1"]),
    ("--seed one", ARGUMENTS, &["--seed", "one"]),
    ("--threads 0", ARGUMENTS, &["--threads", "0"]),
    ("--threads 1025", ARGUMENTS, &["--threads", "1025"]),
    ("--rig nowhere --scanner frame", LOADING, &["nowhere"]),
    ("--rig file --scanner frame", LOADING, &["file"]),
    ("--rig points --scanner frame", LOADING, &["points", "no triangles"]),
    ("--rig rig --scanner frame --vertices 1000", ARGUMENTS, &["cannot be used with"]),
    ("--rig rig --scanner frame --no-eyeballs", ARGUMENTS, &["cannot be used with"]),
    ("--rig rig --scanner frame --wrinkles 2,1,1,1", ARGUMENTS, &["--wrinkles", "1,1,1,S"]),
    ("--rig rig --scanner frame --cases 1 --manner 0.5", ARGUMENTS, &["--manner", "no effect"]),
    ("--rig rig --cases 1", ARGUMENTS, &["net", "frame and fused"]),
    ("--rig rig --scanner frame", ARGUMENTS, &["mouthStretch", "there are none"]),
    // cases
    ("--case ../x", ARGUMENTS, &["--case", "../x", "folder"]),
    ("--case .hidden", ARGUMENTS, &["--case", ".hidden"]),
    ("--case a --case a", ARGUMENTS, &["--case \"a\" twice"]),
    ("--cases 100001", ARGUMENTS, &["--cases", "0 to 100000"]),
    ("--cases 2 --case a", ARGUMENTS, &["cannot be used with"]),
    ("--frames 0", ARGUMENTS, &["--frames", "1 to 100000"]),
    ("--frames 2 --case same_open", ARGUMENTS, &["cannot be used with"]),
    ("--frames 2 --cases 2", ARGUMENTS, &["cannot be used with"]),
    ("--population 0", ARGUMENTS, &["--population", "1 to 100000"]),
    ("--fps 20", ARGUMENTS, &["--frames"]),
    ("--fps 20 --cases 2", ARGUMENTS, &["cannot be used with"]),
    ("--fps 20 --case a", ARGUMENTS, &["cannot be used with"]),
    ("--fps 0 --frames 2", ARGUMENTS, &["--fps", "0.001"]),
    ("--fps NaN --frames 2", ARGUMENTS, &["--fps", "NaN"]),
    ("--expression jawOpen", ARGUMENTS, &["--expression", "NAME=WEIGHT"]),
    ("--expression jawOpen=wide", ARGUMENTS, &["--expression", "NAME=WEIGHT"]),
    ("--vertices 1000 --expression jawOpne=1", ARGUMENTS, &["jawOpne", "jawOpen"]),
    ("--vertices 1000 --expression jawOpen=NaN", ARGUMENTS, &["weight", "NaN"]),
    ("--vertices 1000 --expression jawOpen=101", ARGUMENTS, &["weight", "101"]),
    ("--preset grin", ARGUMENTS, &["--preset", "grin", "smile"]),
    ("--preset smile --expression jawOpen=1", ARGUMENTS, &["cannot be used with"]),
    ("--identity 1,x", ARGUMENTS, &["--identity", "x"]),
    ("--vertices 1000 --identity 1,inf", ARGUMENTS, &["weight", "inf"]),
    ("--vertices 1000 --identity-modes 2 --identity 1,2,3", ARGUMENTS, &["identity", "3 weights", "of 2 modes"]),
    ("--vertices 1000 --identity-sigma -1", ARGUMENTS, &["identity sigma", "-1"]),
    ("--vertices 1000 --rotation 181", ARGUMENTS, &["rotation", "181"]),
    ("--vertices 1000 --translation inf", ARGUMENTS, &["translation", "inf"]),
    ("--vertices 1000 --manner 2", ARGUMENTS, &["manner", "0 to 1"]),
    ("--vertices 1000 --cases 2 --preset neutral --manner 0.5", ARGUMENTS, &["--manner", "no effect", "--expression"]),
    ("--vertices 1000 --cases 2 --expression jawOpen=0 --manner 0.5", ARGUMENTS, &["--manner", "no effect"]),
    ("--identity 1,2 --identity-sigma 0.5", ARGUMENTS, &["cannot be used with"]),
    ("--rig rig --cases 1 --scanner frame --bend a,b=30", ARGUMENTS, &["bend", "\"a\"", "there are none"]),
    ("--bend a=30", ARGUMENTS, &["--bend", "TIP,JOINT=DEGREES"]),
    ("--bend a,b=wide", ARGUMENTS, &["--bend", "TIP,JOINT=DEGREES"]),
    ("--vertices 1000 --bend a,b=181", ARGUMENTS, &["angle of a bend", "181"]),
    ("--vertices 1000 --bend a,b=30", ARGUMENTS, &["bend", "generated face"]),
    ("--vertices 1000 --field 1", ARGUMENTS, &["field", "generated face"]),
    ("--vertices 1000 --field -1", ARGUMENTS, &["field", "-1"]),
    // the scanner
    ("--triangles 4999", ARGUMENTS, &["--triangles", "5000 to 5000000"]),
    ("--triangles 5000001", ARGUMENTS, &["--triangles", "5000 to 5000000"]),
    ("--camera 0", ARGUMENTS, &["--camera", "azimuth"]),
    ("--camera 0,NaN", ARGUMENTS, &["--camera", "azimuth"]),
    ("--vertices 1000 --camera 0,90", ARGUMENTS, &["camera", "elevation"]),
    ("--vertices 1000 --camera 0,0,10", ARGUMENTS, &["distance of a camera", "250"]),
    ("--camera-at 1,2", ARGUMENTS, &["--camera-at", "3 numbers"]),
    ("--vertices 1000 --camera-at 1e9,0,0", ARGUMENTS, &["camera", "100,000 mm"]),
    ("--scanner laser", ARGUMENTS, &["--scanner", "net, frame, fused"]),
    ("--scanner fused --see-all", ARGUMENTS, &["--see-all", "depth camera"]),
    ("--vertices 1000 --scanner frame --camera 0,0 --camera 30,0", ARGUMENTS, &["frame has one camera", "fused"]),
    ("--vertices 1000 --triangles 5000 --case same_open --scanner fused --camera 180,0", COMPUTATION, &["camera"]),
    ("--see-all --camera 0,0", ARGUMENTS, &["cannot be used with"]),
    ("--see-all --grazing 60", ARGUMENTS, &["cannot be used with"]),
    ("--see-all --grazing-noise 1", ARGUMENTS, &["cannot be used with"]),
    ("--detail 0 --wrinkles 1,2,1,1", ARGUMENTS, &["--wrinkles", "--detail 0"]),
    ("--vertices 1000 --grazing 91", ARGUMENTS, &["grazing angle", "91"]),
    ("--vertices 1000 --detail 6", ARGUMENTS, &["detail", "0 to 5"]),
    ("--wrinkles 1,1,1", ARGUMENTS, &["--wrinkles", "4 numbers"]),
    ("--vertices 1000 --wrinkles 1,1,1,11", ARGUMENTS, &["skin structure", "11"]),
    ("--vertices 1000 --triangles 5000 --case same_open --camera 180,0", COMPUTATION, &["camera"]),
    // its faults
    ("--vertices 1000 --noise -1", ARGUMENTS, &["noise", "-1"]),
    ("--vertices 1000 --noise=-1", ARGUMENTS, &["noise", "-1"]),
    ("--vertices 1000 --noise NaN", ARGUMENTS, &["noise", "NaN"]),
    ("--noise much", ARGUMENTS, &["--noise", "much"]),
    ("--vertices 1000 --holes 1001", ARGUMENTS, &["holes", "1001"]),
    ("--hole-radius 4", ARGUMENTS, &["--hole-radius", "2 numbers"]),
    ("--vertices 1000 --hole-radius 9,4", ARGUMENTS, &["hole radius", "9"]),
    ("--holes 0 --hole-radius 4,5", ARGUMENTS, &["--hole-radius", "--holes 0"]),
    ("--spikes 0 --spike-height 4,5", ARGUMENTS, &["--spike-height", "--spikes 0"]),
    ("--noise 0 --grazing-noise 1", ARGUMENTS, &["--grazing-noise", "--noise 0"]),
    ("--vertices 1000 --keep 0", ARGUMENTS, &["share to keep", "0.05 to 1"]),
    ("--vertices 1000 --keep NaN", ARGUMENTS, &["share to keep", "NaN"]),
    ("--vertices 1000 --spikes 1.5", ARGUMENTS, &["spikes", "1.5"]),
    ("--vertices 1000 --outliers 0.6", ARGUMENTS, &["outliers", "0.6"]),
    ("--vertices 1000 --landmark-noise -0.1", ARGUMENTS, &["landmark noise", "-0.1"]),
    // the folder
    ("--out file", WRITING, &["file: cannot be written: it is a file, not a folder"]),
    ("--out file/below", WRITING, &["file/below: cannot be written: file is a file, not a folder"]),
    ("--out /dev/full", WRITING, &["/dev/full: cannot be written: it is a file, not a folder"]),
    ("--vertices 1000 --cases 0 --out yours/1", WRITING, &["yours/1/rig", "no data-gen.json lists it", "move it away"]),
    ("--vertices 1000 --triangles 5000 --cases 1 --out yours/2", WRITING, &["yours/2/cases/same_0000", "move it away"]),
    ("--vertices 1000 --cases 0 --population 1 --out yours/3", WRITING, &["yours/3/population/person_0000.obj", "move it away"]),
    ("--vertices 1000 --cases 0 --population 1 --out yours/4", WRITING, &["yours/4/population/face.mtl", "move it away"]),
    ("--vertices 1000 --cases 0 --contact-sheet --out yours/5", WRITING, &["yours/5/contact_sheet.png", "move it away"]),
    ("--vertices 1000 --triangles 5000 --frames 1 --out yours/6", WRITING, &["yours/6/sequence/weights.csv", "move it away"]),
    ("--vertices 1000 --cases 0 --out yours/7", WRITING, &["yours/7/data-gen.json", "no record"]),
    ("--vertices 1000 --cases 0 --out yours/8", WRITING, &["yours/8/data-gen.json", "a regular file", "a pipe", "move it away"]),
    ("--vertices 1000 --triangles 5000 --frames 2 --out left", WRITING, &["left/sequence/frame_0002", "of another run"]),
    ("--vertices 1000 --cases 0 --population 2 --out left", WRITING, &["left/population/person_0002.obj", "of another run"]),
    ("--vertices 1000 --triangles 5000 --cases 1 --out left", WRITING, &["left/cases/new_0001", "of another run"]),
    ("--nosuch", ARGUMENTS, &["--nosuch"]),
    ("stray", ARGUMENTS, &["stray"]),
];

#[test]
fn every_row_is_one_clear_error_and_leaves_no_trace() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    for yours in [
        "yours/1/rig/template.obj",
        "yours/2/cases/same_0000/scan.ply",
        "yours/3/population/person_0000.obj",
        "yours/4/population/face.mtl",
        "yours/5/contact_sheet.png",
        "yours/6/sequence/weights.csv",
        "yours/7/data-gen.json",
        "left/sequence/frame_0002/scan.ply",
        "left/population/person_0002.obj",
        "left/cases/new_0001/scan.ply",
    ] {
        let path = folder.path().join(yours);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "mine").unwrap();
    }
    std::fs::create_dir(folder.path().join("yours/8")).unwrap();
    assert!(Command::new("mkfifo").arg(folder.path().join("yours/8/data-gen.json")).status().unwrap().success());
    // A rig of one quad without shapes, and one that is points alone.
    for rig in ["rig", "points"] {
        std::fs::create_dir(folder.path().join(rig)).unwrap();
        let corners = [0.0f32, 0.0, 0.0, 90.0, 0.0, 0.0, 90.0, 90.0, 0.0, 0.0, 90.0, 0.0];
        write_npy(&folder.path().join(rig).join("neutral.npy"), &[4, 3], &corners).unwrap();
    }
    std::fs::write(folder.path().join("rig/template.obj"), "v 0 0 0\nv 90 0 0\nv 90 90 0\nv 0 90 0\nf 1 2 3 4\n")
        .unwrap();
    let check =
        |options: &str, code, words| refuses(env!("CARGO_BIN_EXE_data-gen"), folder.path(), options, code, words).err();
    let mut faults: Vec<String> = check("", ARGUMENTS, &["--out"]).into_iter().collect();
    faults.extend(ROWS.iter().filter_map(|&(options, code, words)| {
        let out = if options.contains("--out ") { "" } else { "--out data " };
        check(&format!("{out}{options}"), code, words)
    }));
    all_hold(ROWS.len() + 1, &faults);
}
