//! `nonrigid animate`: one file of the frames of a sequence.

use crate::support::{Bench, farthest, glb_parts};
use nonrigid::io::{read_gltf, read_polygon_mesh, write_obj, write_polygon_mesh};
use nonrigid::mesh::{Pose, Vec3};
use serde_json::Value;

/// Three frames: the rig's template, with its first shape at a half and turned, and pulled where no shape goes.
fn frames(bench: &Bench) -> Vec<Vec<Vec3>> {
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    bench.done("rig convert --rig rig --out rig.glb");
    let targets = read_gltf(&bench.path("rig.glb")).unwrap();
    let shape = &targets.target_deltas[..3 * template.positions.len()];
    let turn = Pose::rigid(Vec3::new(0.1, 0.2, -0.1), Vec3::new(5.0, -3.0, 2.0));
    let half = |(p, d): (&Vec3, &[f32])| turn.apply(p + Vec3::new(d[0].into(), d[1].into(), d[2].into()) * 0.5);
    let second: Vec<Vec3> = template.positions.iter().zip(shape.chunks_exact(3)).map(half).collect();
    let third = second.iter().map(|p| p + Vec3::new(0.0, 0.2 * (0.1 * p.x).sin(), 0.0)).collect();
    let frames = vec![template.positions.clone(), second, third];
    std::fs::create_dir(bench.path("frames")).unwrap();
    for (k, frame) in frames.iter().enumerate() {
        write_obj(&bench.path(&format!("frames/f{k}.obj")), &template.with_positions(frame.clone())).unwrap();
    }
    frames
}

#[test]
fn a_point_cache_has_every_frame() {
    let bench = Bench::new();
    let frames = frames(&bench);
    let printed = bench.done("animate --meshes frames --out face.pc2");
    assert!(printed.starts_with("3 frames of "), "{printed}");
    let bytes = bench.read("face.pc2");
    assert_eq!(&bytes[..12], b"POINTCACHE2\0");
    let word = |k: usize| i32::from_le_bytes(bytes[12 + 4 * k..16 + 4 * k].try_into().unwrap());
    assert_eq!((word(0), word(1) as usize, word(4)), (1, frames[0].len(), 3));
    let values: Vec<f64> =
        bytes[32..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()).into()).collect();
    let points: Vec<Vec3> = values.chunks_exact(3).map(Vec3::from_column_slice).collect();
    for (k, frame) in frames.iter().enumerate() {
        assert!(farthest(&points[k * frame.len()..(k + 1) * frame.len()], frame) < 1e-4);
    }
}

#[test]
fn a_stage_has_every_frame_and_what_the_mesh_has() {
    let bench = Bench::new();
    let frames = frames(&bench);
    bench.done("animate --meshes frames --fps 25 --out face.usda");
    let text = bench.text("face.usda");
    for part in [
        "endTimeCode = 2",
        "timeCodesPerSecond = 25",
        "metersPerUnit = 0.001",
        "upAxis = \"Y\"",
        "primvars:st:indices",
        "GeomSubset",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let points = &text[text.find("points.timeSamples").unwrap()..];
    for (k, frame) in frames.iter().enumerate() {
        let line = points.lines().find(|l| l.trim_start().starts_with(&format!("{k}: "))).unwrap();
        let numbers: Vec<f64> = line[line.find('[').unwrap()..]
            .split(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c)))
            .filter_map(|n| n.parse().ok())
            .collect();
        let found: Vec<Vec3> = numbers.chunks_exact(3).map(Vec3::from_column_slice).collect();
        assert!(farthest(&found, frame) < 1e-4, "frame {k}");
    }
}

/// The numbers of an accessor of 32 bit floats.
fn floats(document: &Value, binary: &[u8], accessor: &Value) -> Vec<f64> {
    let accessor = &document["accessors"][accessor.as_u64().unwrap() as usize];
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let (start, length) =
        (view["byteOffset"].as_u64().unwrap() as usize, view["byteLength"].as_u64().unwrap() as usize);
    binary[start..start + length].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()).into()).collect()
}

#[test]
fn shapes_a_pose_and_what_is_left_give_every_frame() {
    let bench = Bench::new();
    let frames = frames(&bench);
    for rig in ["", "--rig rig"] {
        bench.done(&format!("animate --meshes frames --fps 10 {rig} --out face.glb"));
        let mesh = read_gltf(&bench.path("face.glb")).unwrap();
        let bytes = bench.read("face.glb");
        let (document, binary) = glb_parts(&bytes);
        let animation = &document["animations"][0];
        let track = |path: &str| {
            let channel =
                animation["channels"].as_array().unwrap().iter().find(|c| c["target"]["path"] == path).unwrap();
            let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
            (floats(&document, binary, &sampler["input"]), floats(&document, binary, &sampler["output"]))
        };
        let (times, weights) = track("weights");
        assert!(farthest(&[Vec3::from_column_slice(&times)], &[Vec3::new(0.0, 0.1, 0.2)]) < 1e-7);
        let (translations, turns) = (track("translation").1, track("rotation").1);
        let targets = weights.len() / 3;
        if !rig.is_empty() {
            assert!(
                (weights[targets] - 0.5).abs() < 0.02,
                "the first shape explains the second frame: {}",
                weights[targets]
            );
        }
        for (k, frame) in frames.iter().enumerate() {
            let q = nalgebra::Quaternion::from_vector(nalgebra::Vector4::from_column_slice(&turns[4 * k..4 * k + 4]));
            let q = nalgebra::UnitQuaternion::from_quaternion(q);
            let t = Vec3::from_column_slice(&translations[3 * k..3 * k + 3]) * 1000.0;
            let count = frame.len();
            let at = |v: usize| {
                let moved = |j: usize| {
                    let d = &mesh.target_deltas[3 * (j * count + v)..][..3];
                    Vec3::new(d[0].into(), d[1].into(), d[2].into()) * weights[k * targets + j]
                };
                q * (mesh.mesh.positions[v] + (0..targets).map(moved).sum::<Vec3>()) + t
            };
            let found: Vec<Vec3> = (0..count).map(at).collect();
            assert!(farthest(&found, frame) < 2e-3, "{rig} frame {k}: {}", farthest(&found, frame));
        }
    }
}

#[test]
fn frames_may_be_packed_or_glb() {
    let bench = Bench::new();
    frames(&bench);
    bench.done("animate --meshes frames --out face.pc2");
    for folder in ["packed", "glb"] {
        std::fs::create_dir(bench.path(folder)).unwrap();
    }
    for k in 0..3 {
        let mesh = read_polygon_mesh(&bench.path(&format!("frames/f{k}.obj"))).unwrap();
        write_polygon_mesh(&bench.path(&format!("glb/f{k}.glb")), &mesh).unwrap();
        let text = bench.read(&format!("frames/f{k}.obj"));
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut packer, &text).unwrap();
        bench.write(&format!("packed/f{k}.obj.gz"), packer.finish().unwrap());
    }
    for folder in ["packed", "glb"] {
        bench.done(&format!("animate --meshes {folder} --out {folder}.pc2"));
        assert_eq!(bench.read(&format!("{folder}.pc2")).len(), bench.read("face.pc2").len(), "{folder}");
    }
    assert!(bench.read("packed.pc2") == bench.read("face.pc2"));
}

#[test]
fn a_result_that_would_be_a_frame_is_refused() {
    let bench = Bench::new();
    frames(&bench);
    // frames are not .glb while there are .obj
    bench.done("animate --meshes frames --out frames/ann.glb");
    bench.done("animate --meshes frames --out frames/ann.glb");
    std::fs::create_dir(bench.path("glb")).unwrap();
    let mesh = read_polygon_mesh(&bench.path("frames/f0.obj")).unwrap();
    write_polygon_mesh(&bench.path("glb/f0.glb"), &mesh).unwrap();
    let run = bench.run("animate --meshes glb --out ./glb/ann.glb");
    assert!(run.code == 1 && run.stderr.contains("would be one of the frames"), "{}", run.stderr);
    assert!(!bench.path("glb/ann.glb").exists());
    bench.done("animate --meshes glb --out glb/ann.usda");
    bench.write("list.txt", "f0.glb\n");
    bench.done("animate --meshes glb --list list.txt --out glb/ann.glb");
}

#[test]
fn frames_a_second_may_be_those_of_video_and_what_has_no_effect_is_said() {
    let bench = Bench::new();
    frames(&bench);
    let report = || bench.json("face.json");
    for (asked, found) in [("23.976", serde_json::json!(23.976)), ("60", 60.into()), ("25.0", 25.into())] {
        let plain = asked.trim_end_matches(".0");
        let said = bench.done(&format!("animate --meshes frames --fps {asked} --out face.usda --report face.json"));
        assert!(said.contains(&format!(" vertices, {plain} a second")), "{said}");
        assert_eq!(report()["frames_per_second"], found);
        let stage = bench.text("face.usda");
        assert!(stage.contains(&format!("timeCodesPerSecond = {plain}\n")), "{asked}");
    }
    for asked in ["0", "0.9", "1000.5", "NaN", "fast"] {
        let run = bench.run(&format!("animate --meshes frames --fps {asked} --out none.usda"));
        assert!(run.code == 1 && run.stderr.contains("no number from 1 to 1000"), "{}", run.stderr);
    }
    for (options, says) in [
        ("--fps 8 --smooth 4 --out face.usda", "--smooth 4: nothing is smoothed, as that is half of --fps 8 or more"),
        ("--fps 30 --out face.pc2", "--fps: has no effect on a .pc2 with --smooth none"),
        ("--fps 8.1 --smooth 4 --out face.usda", ""),
        ("--fps 30 --smooth 4 --out face.pc2", ""),
    ] {
        let run = bench.run(&format!("animate --meshes frames {options}"));
        let warned = run.stderr.contains("effect") || run.stderr.contains("nothing is smoothed");
        assert!(run.code == 0 && run.stderr.contains(says) && warned != says.is_empty(), "{options}: {}", run.stderr);
    }
}

#[test]
fn lost_frames_are_named_and_bridged() {
    let bench = Bench::new();
    let template = read_polygon_mesh(&bench.path("rig/template.obj")).unwrap();
    let at = |k: usize| Vec3::new(0.5 * k as f64, (0.3 * k as f64).sin(), 0.0);
    std::fs::create_dir(bench.path("frames")).unwrap();
    let mut list = String::new();
    for k in 0..12 {
        let off = Vec3::y() * if k == 5 { 40.0 } else { 0.0 };
        let positions = template.positions.iter().map(|p| p + at(k) + off).collect();
        if k == 8 {
            list += "- walk8\n";
        } else {
            write_obj(&bench.path(&format!("frames/walk{k}.obj")), &template.with_positions(positions)).unwrap();
            list += &format!("walk{k}.obj\n");
        }
    }
    bench.write("list.txt", &list);
    let command = "animate --meshes frames --list list.txt --unit meshes=mm --report walk.json --fps 30";
    for (format, smooth) in [("usda", "--smooth 4"), ("glb", ""), ("pc2", "--smooth 4")] {
        let stderr = bench.ends(&format!("{command} {smooth} --out walk.{format}"), 0);
        for frame in ["\"walk5\" is lost: it jumps 4", "\"walk8\" is lost: there is none"] {
            assert!(stderr.contains(frame), "{stderr}");
        }
        let report = bench.json("walk.json");
        let lost: Vec<usize> = (0..12).filter(|&k| !report["frames"][k]["lost"].is_null()).collect();
        assert_eq!(lost, [5, 8], "{report}");
        let [before, after] = [0, 1].map(|k| report["second_difference_mm"][k].as_f64().unwrap());
        assert!(before > 20.0 && (after < 0.2) == smooth.contains("4"), "{report}");
    }
    let text = bench.text("walk.usda");
    assert!(text.contains("int[] lostFrames = [5, 8]"));
    let bytes = bench.read("walk.glb");
    let (document, _) = glb_parts(&bytes);
    assert_eq!(document["animations"][0]["extras"]["lostFrames"], serde_json::json!([5, 8]));
    // the cache has the frames that are bridged where the others lead
    let bytes = bench.read("walk.pc2");
    for k in [5, 8] {
        let start = 32 + 12 * k * template.positions.len();
        let y = f32::from_le_bytes(bytes[start + 4..start + 8].try_into().unwrap());
        assert!((f64::from(y) - template.positions[0].y - at(k).y).abs() < 0.1, "frame {k}");
    }
}

#[test]
fn frames_that_are_no_sequence_are_refused() {
    let bench = Bench::new();
    frames(&bench);
    let fails = |line: &str, code: i32, says: &str| {
        let stderr = bench.ends(line, code);
        assert!(stderr.contains(says), "{line}: {stderr}");
    };
    fails("animate --meshes frames --rig rig --out a.usda", 1, "only .glb has weights");
    fails("animate --meshes frames --out a.obj", 1, ".usda");
    fails("animate --meshes frames --fps 0 --out a.usda", 1, "fps");
    fails("animate --meshes case/none --out a.usda", 4, "none");
    fails("animate --meshes frames --smooth fast --out a.usda", 1, "neither a frequency");
    bench.write("list.txt", "- f0\n");
    fails("animate --meshes frames --list list.txt --out a.usda", 4, "names no frame that is there");
    std::fs::copy(bench.path("frames/f1.obj"), bench.path("frames/-f1.obj")).unwrap();
    bench.write("list.txt", "# take one\nf0.obj\n- f9\n./-f1.obj\n");
    bench.done("animate --meshes frames --list list.txt --out a.usda --report a.json");
    let report: Value = serde_json::from_slice(&bench.read("a.json")).unwrap();
    let names = report["frames"].as_array().unwrap().iter().map(|frame| frame["name"].as_str().unwrap());
    assert!(names.eq(["f0", "f9", "-f1"]), "{report}");
    bench.write("list.txt", "f0.obj\nf9.obj\n");
    fails("animate --meshes frames --list list.txt --out a.usda", 4, "f9.obj");
    fails("animate --meshes frames --report frames/f0.obj --out a.usda", 1, "f0.obj");
    std::fs::copy(bench.path("frames/f1.obj"), bench.path("frames/f1.ply")).unwrap();
    fails("animate --meshes frames --out a.usda", 4, "one file called \"f1\"");
    std::fs::remove_file(bench.path("frames/f1.ply")).unwrap();
    std::fs::create_dir(bench.path("empty")).unwrap();
    fails("animate --meshes empty --out a.usda", 4, "found no .obj, .ply or .glb");
    bench.write("frames/z.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    fails("animate --meshes frames --unit mm --out a.pc2", 4, "z.obj: has other vertices");
    assert!(!bench.path("a.pc2").exists());
}
