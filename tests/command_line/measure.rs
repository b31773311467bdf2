//! `nonrigid measure` on generated data: what it prints and writes.

use crate::support::{Bench, files_in};
use nonrigid::io::{read_polygon_mesh, write_npy, write_obj, write_polygon_mesh};
use nonrigid::mesh::{Pose, Vec3};

const MEASURE: &str = "measure --mesh rig/template.obj --landmarks rig/landmarks_anthropometric.json";

#[test]
fn numbers_are_the_same_in_the_table_the_json_and_the_csv() {
    let bench = Bench::new();
    let printed = bench.done(&format!("{MEASURE} --after case/truth.npy --rig rig --json m.json --csv m.csv"));
    let json = bench.json("m.json");
    let csv = bench.text("m.csv");
    assert_eq!(json["units"]["volume"], "mm^3");
    let measurements = json["measurements"].as_array().unwrap();
    assert!(measurements.len() > 50);
    for m in measurements.iter().filter(|m| m["name"].as_str().is_some_and(|n| !n.ends_with("e_line"))) {
        let (name, number) = (m["name"].as_str().unwrap(), |key: &str| m[key].as_f64().unwrap());
        assert!((number("after") - number("before") - number("difference")).abs() < 1e-9, "{name}");
        let group = m["group"].as_str().unwrap();
        let row = csv.lines().find(|l| l.starts_with(&format!("{group},{name},"))).unwrap();
        let cells: Vec<&str> = row.split(',').collect();
        let written: f64 = cells[3].parse().unwrap();
        assert!((written - number("before")).abs() <= 1e-12 * written.abs(), "{row}");
        let line = printed.lines().find(|l| l.starts_with(&format!("{}  ", name.replace('_', " "))));
        let line = line.unwrap_or_else(|| panic!("no line {name} in\n{printed}"));
        let shown = format!("{:.2}", number("before"));
        assert!(line.contains(shown.trim_start_matches('-')), "{line}: {shown}");
    }
    let regions = json["regions"].as_array().unwrap();
    assert_eq!(regions.len(), 1 + bench.rig.regions.len());
    let volume = |k: usize| regions[k]["change"]["volume"].as_f64().unwrap();
    let sum: f64 = (1..regions.len()).map(volume).sum();
    assert!((sum - volume(0)).abs() < 1e-6 * volume(0).abs().max(1.0), "{sum} {}", volume(0));
    let lines = csv.lines().map(|l| l.matches(',').count());
    assert!(lines.clone().count() > measurements.len() + 8 * regions.len() && lines.into_iter().all(|n| n >= 6));
}

#[test]
fn a_report_holds_everything_and_threads_change_nothing() {
    let bench = Bench::new();
    let vertices = bench.rig.neutral.len();
    write_npy(&bench.path("mask.npy"), &[vertices], &vec![0.5f64; vertices]).unwrap();
    let options = "--after case/truth.npy --mask mask.npy --landmarks rig/landmarks_multipie68.json";
    for threads in [1, 2] {
        bench.done(&format!("{MEASURE} {options} --threads {threads} --report page{threads} --json {threads}.json"));
    }
    let names = ["index.html", "measurements.csv", "measurements.json", "pictures.png", "symmetry.png"];
    assert_eq!(files_in(&bench.path("page1")), names);
    for name in names {
        assert!(bench.read(&format!("page1/{name}")) == bench.read(&format!("page2/{name}")), "{name}");
    }
    assert!(bench.read("1.json") == bench.read("page2/measurements.json"));
    let page = bench.text("page1/index.html");
    for part in
        ["template.obj", "mask.npy", "<h2>angles</h2>", "<h2>symmetry</h2>", "<h2>change</h2>", "canthal tilt left"]
    {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn a_moved_head_is_brought_back() {
    let bench = Bench::new();
    let pose = Pose::rigid(Vec3::new(0.1, -0.4, 0.2), Vec3::new(30.0, 5.0, -12.0));
    let moved: Vec<Vec3> = bench.rig.neutral.iter().map(|p| pose.apply(*p)).collect();
    write_obj(&bench.path("moved.obj"), &bench.rig.mesh.with_positions(moved)).unwrap();
    let change = |options: &str| -> f64 {
        bench.done(&format!("{MEASURE} --after moved.obj {options} --json m.json"));
        let json = bench.json("m.json");
        json["regions"][0]["change"]["displacement_max"].as_f64().unwrap()
    };
    assert!(change("") > 20.0 && change("--align") < 1e-9);
}

#[test]
fn a_change_is_the_same_however_the_head_has_moved() {
    let bench = Bench::new();
    bench.done("morph --mesh rig/template.obj --rig rig --preset nose-tip=2 --out plan.obj");
    let plan = read_polygon_mesh(&bench.path("plan.obj")).unwrap();
    let pose = Pose::rigid(Vec3::new(0.0, 0.1, 0.0), Vec3::new(0.0, 5.0, 0.0));
    let moved: Vec<Vec3> = plan.positions.iter().map(|p| pose.apply(*p)).collect();
    write_obj(&bench.path("moved.obj"), &plan.with_positions(moved)).unwrap();
    let changes = |options: &str| -> (Vec<f64>, String) {
        let stderr = bench.ends(&format!("{MEASURE} --rig rig {options} --json m.json"), 0);
        let regions = bench.json("m.json")["regions"].take();
        (regions.as_array().unwrap().iter().map(|r| r["change"]["volume"].as_f64().unwrap()).collect(), stderr)
    };
    let (volumes, silent) = changes("--after plan.obj");
    assert!(volumes[0] > 100.0 && !silent.contains("moved"), "{volumes:?} {silent}");
    for after in ["plan.obj", "moved.obj"] {
        let (aligned, silent) = changes(&format!("--after {after} --align"));
        let off = volumes.iter().zip(&aligned).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-2 && !silent.contains("moved"), "{after}: {off} {silent}");
    }
    let (_, said) = changes("--after moved.obj");
    assert!(said.contains("moved.obj: the head moved by 5.7° and ") && said.contains("--align takes it out"), "{said}");
}

#[test]
fn millimetres_in_a_format_of_metres_are_said() {
    let bench = Bench::new();
    let large = bench.rig.neutral.iter().map(|p| p * 1000.0).collect();
    write_polygon_mesh(&bench.path("in_mm.glb"), &bench.rig.mesh.with_positions(large)).unwrap();
    bench.done("landmarks convert rig/landmarks_anthropometric.json points.csv --as position --mesh rig/template.obj");
    let measure = |options: &str| {
        bench.ends(
            &format!("measure --mesh in_mm.glb --landmarks points.csv --unit landmarks=mm{options} --json m.json"),
            0,
        )
    };
    let said = measure(",mesh=mm");
    assert!(!said.contains("across in"), "{said}");
    let run = bench.run("measure --mesh in_mm.glb --landmarks points.csv");
    assert!(run.stderr.contains("in_mm.glb: ") && run.stderr.contains("say --unit mesh=mm"), "{}", run.stderr);
}

#[test]
fn one_shape_and_some_landmarks_are_enough() {
    let bench = Bench::new();
    let printed = bench.done("measure --mesh rig/template.obj --landmarks rig/landmarks_multipie68.json");
    assert!(printed.contains("not given: trichion") && !printed.contains("difference"), "{printed}");
    assert!(printed.lines().any(|l| l.starts_with("nose ")), "the groups of the mesh are regions:\n{printed}");
    let list = bench.done("measure --list");
    assert!(list.contains("at nasion between glabella and pronasale, in the mid-sagittal plane"), "{list}");
    assert!(list.contains("62 and 66") && list.contains("hairline"), "{list}");
}

#[test]
fn a_rig_gives_its_landmarks_and_the_client_heads_the_page() {
    let bench = Bench::new();
    let measure = "measure --mesh rig/template.obj --rig rig";
    let both = "--landmarks rig/landmarks_multipie68.json --landmarks rig/landmarks_anthropometric.json";
    bench.done(&format!("{measure} --csv found.csv --report page --client O'Neil<b> --date 2026-11-22"));
    bench.done(&format!("{measure} {both} --csv given.csv"));
    assert!(bench.read("found.csv") == bench.read("given.csv"));
    let page = bench.text("page/index.html");
    assert!(page.contains("O&#39;Neil&lt;b&gt;") || page.contains("O'Neil&lt;b&gt;"), "{page:.2000}");
    assert!(page.contains("2026-11-22") && page.contains("@media print"));

    // vertices in another order would carry landmarks and regions anywhere
    let mut turned = bench.rig.mesh.clone();
    turned.positions.reverse();
    let last = turned.positions.len() as u32 - 1;
    turned.corners.iter_mut().for_each(|v| *v = last - *v);
    write_obj(&bench.path("reversed.obj"), &turned).unwrap();
    let stderr = bench.ends("measure --mesh reversed.obj --rig rig", 4);
    assert!(stderr.contains("in the rig's order"), "{stderr}");
    let stderr = bench.ends(&format!("{measure} --after reversed.obj"), 4);
    assert!(stderr.contains("reversed.obj: "), "{stderr}");
}

#[test]
fn a_rig_in_a_file_gives_its_landmarks_and_one_without_regions_the_groups() {
    let bench = Bench::new();
    let (measure, morph) = ("measure --mesh rig/template.obj", "morph --mesh rig/template.obj --preset chin-forward=2");
    bench.done(&format!("{measure} --landmarks rig/landmarks_multipie68.json --json given.json"));
    bench.done(&format!("{morph} --landmarks rig/landmarks_multipie68.json --out given.obj"));
    let measurements = |name: &str| bench.json(name)["measurements"].take();
    for rig in ["rig.npz", "rig.glb"] {
        bench.done(&format!("rig convert --rig rig --out {rig}"));
        let stderr = bench.ends(&format!("{measure} --rig {rig} --json found.json"), 0);
        assert!(
            stderr.contains(&format!("warning: {rig}: a rig in one file has the 68 numbered landmarks alone")),
            "{stderr}"
        );
        assert_eq!(measurements("found.json"), measurements("given.json"), "{rig}");
        bench.done(&format!("{morph} --rig {rig} --out found.obj"));
        let [found, given] =
            ["found.obj", "given.obj"].map(|name| read_polygon_mesh(&bench.path(name)).unwrap().positions);
        assert!(found == given, "{rig}");
    }
    std::fs::remove_file(bench.path("rig/regions.json")).unwrap();
    bench.done(&format!("{measure} --rig rig --landmarks rig/landmarks_multipie68.json --json rig.json"));
    let regions = |name: &str| bench.json(name)["regions"].take();
    assert_eq!(regions("rig.json"), regions("given.json"));
    std::fs::remove_file(bench.path("rig/landmarks_multipie68.json")).unwrap();
    std::fs::remove_file(bench.path("rig/landmarks_anthropometric.json")).unwrap();
    let stderr = bench.ends(&format!("{measure} --rig rig"), 4);
    assert!(stderr.contains("rig: the rig has no landmarks; give --landmarks"));
}

#[test]
fn landmarks_off_the_mesh_are_said() {
    let bench = Bench::new();
    let off = |by: f64| {
        let positions = bench.rig.anthropometric.iter().map(|l| {
            let p = bench.rig.neutral[l.vertex as usize] + Vec3::new(0.0, 0.0, by);
            format!("\"{}\": {:?}", l.name, p.as_slice())
        });
        bench.write("points.json", format!("{{{}}}", positions.collect::<Vec<_>>().join(", ")));
        bench.ends("measure --mesh rig/template.obj --landmarks points.json", 0)
    };
    assert!(!off(0.0).contains("off the mesh"));
    let said = off(5.0);
    assert!(said.contains("landmarks lie off the mesh, ") && said.contains(" by 5.0 mm: the closest point"), "{said}");
    let plain = bench.run("morph --mesh rig/template.obj --landmarks points.json --preset nose-tip --out m.obj");
    assert!(plain.stderr.contains(" by 5.0 mm: the closest point"), "{}", plain.stderr);
}

#[test]
fn a_pair_with_left_and_right_swapped_is_said() {
    let bench = Bench::new();
    let swapped = |name: &str| match name {
        "exocanthion_right" => "exocanthion_left".to_owned(),
        "exocanthion_left" => "exocanthion_right".to_owned(),
        name => name.to_owned(),
    };
    let vertices = bench.rig.anthropometric.iter().map(|l| format!("\"{}\": {}", swapped(&l.name), l.vertex));
    bench.write("swapped.json", format!("{{{}}}", vertices.collect::<Vec<_>>().join(", ")));
    let words = "pairs of landmarks: exocanthion_right and exocanthion_left";
    for command in ["measure", "morph --preset nose-tip --out m.obj"] {
        let run = bench.run(&format!("{command} --mesh rig/template.obj --landmarks swapped.json"));
        assert!(run.stderr.contains(words), "{command}: {}", run.stderr);
    }
    let stderr = bench.ends("measure --mesh rig/template.obj --rig rig", 0);
    assert!(!stderr.contains("swapped"), "{stderr}");
}

#[test]
fn several_plans_stand_beside_each_other() {
    let bench = Bench::new();
    let other: Vec<Vec3> = bench.rig.neutral.iter().map(|p| p * 1.01).collect();
    write_obj(&bench.path("larger.obj"), &bench.rig.mesh.with_positions(other)).unwrap();
    let plans = "--after case/truth.npy --after larger.obj";
    let printed = bench.done(&format!("{MEASURE} {plans} --rig rig --csv m.csv --json m.json --report page"));
    let header = printed.lines().find(|l| l.starts_with("profile ")).unwrap();
    let words: Vec<&str> = header.split_whitespace().collect();
    assert_eq!(words, ["profile", "unit", "before", "truth", "difference", "larger", "difference", "remark"]);
    let row = printed.lines().find(|l| l.starts_with("lower lip to E-line")).unwrap();
    let at = |k: usize| -> f64 { row.split_whitespace().nth(k).unwrap().parse().unwrap() };
    assert!((at(8) - 1.01 * at(5)).abs() < 0.02, "{row}");
    let json = bench.json("m.json");
    assert_eq!((&json[0]["name"], &json[1]["name"]), (&"truth".into(), &"larger".into()));
    // Each is what it is alone.
    bench.done(&format!("{MEASURE} --after larger.obj --rig rig --json alone.json"));
    let alone = bench.json("alone.json");
    assert_eq!(json[1]["measurements"], alone["measurements"]);
    let page = bench.text("page/index.html");
    assert!(page.contains("<th>truth</th>") && page.contains("change: larger"));
    let doubled = bench.done(&format!("{MEASURE} --after larger.obj --after ./larger.obj --rig rig"));
    assert!(doubled.lines().any(|l| l.contains("./larger.obj")), "files of one name are told apart:\n{doubled}");
}
