//! `scaling` on the command line: its lines, tables and plots, and what it says of options that make no sense.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use experiments::plots::PowerLaw;
use serde_json::Value;

fn scaling(out: &Path, options: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiments"));
    command.arg("scaling").arg("--out").arg(out).args(options).output().unwrap()
}

#[test]
fn a_small_study_leaves_lines_tables_and_plots() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scaling");
    let solvers = ["auto", "bordered", "block-jacobi"];
    let options = [
        ["--sizes", "1000,2000"],
        ["--shapes", "5"],
        ["--nodes", "50,60"],
        ["--threads", "1,2"],
        ["--linear-solver", &solvers.join(",")],
        ["--linearisation", "structured,reference"],
        ["--iterations", "2"],
        ["--repeats", "2"],
        ["--scan-triangles", "2000,4000"],
        ["--scan-template", "1000"],
    ];
    let run = scaling(&out, &options.concat());
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let text = String::from_utf8(run.stdout).unwrap();
    let rows: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(rows.len(), 2 * 2 * solvers.len() * 2 + 2 * 2);

    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
    let solves: Vec<&Value> = rows.iter().filter(|r| r["study"] == "solver").collect();
    for row in &solves {
        for key in ["linearise_seconds", "solve_seconds", "energy_seconds", "iteration_seconds"] {
            let [min, median, max] = ["min", "median", "max"].map(|k| number(&row[key], k));
            assert!(0.0 < min && min <= median && median <= max, "{key}: {row}");
        }
        let nodes = if number(row, "vertices") < 1500.0 { 50.0 } else { 60.0 };
        assert!(number(row, "nodes") == nodes && number(row, "unknowns") == 6.0 * nodes + 5.0, "{row}");
        assert!(number(row, "final_energy") < 0.5 * number(row, "initial_energy"), "{row}");
        let iterates = row["linear_solver"] == "block_jacobi";
        assert_eq!(number(row, "linear_iterations") > 0.0, iterates, "{row}");
        assert_eq!(row["solved_by"].as_str().unwrap().contains("conjugate"), iterates, "{row}");
        if cfg!(target_os = "linux") {
            assert!(number(row, "peak_bytes") > 1e6, "{row}");
        }
        // Whatever solves, however it is differentiated and on however many threads: the same energies.
        let same = solves.iter().find(|r| r["vertices"] == row["vertices"]).unwrap();
        let ratio = number(row, "final_energy") / number(same, "final_energy");
        assert!((ratio - 1.0).abs() < 1e-8, "{row}\n{same}");
    }
    for row in rows.iter().filter(|r| r["study"] == "registration") {
        let parts: f64 =
            ["setup_seconds", "steps_seconds", "finish_seconds"].iter().map(|k| number(&row[k], "min")).sum();
        assert!(0.0 < parts && parts <= number(&row["registration_seconds"], "max") * (1.0 + 1e-9), "{row}");
        assert!(number(row, "steps") > 5.0, "{row}");
    }

    for (file, lines) in [("solver.csv", 1 + solves.len()), ("registration.csv", 1 + 4)] {
        let table = fs::read_to_string(out.join(file)).unwrap();
        assert_eq!(table.lines().count(), lines, "{file}");
        let columns = table.lines().next().unwrap().split(',').count();
        assert!(columns > 20 && table.lines().all(|l| l.split(',').count() == columns), "{file}: {table}");
    }
    // Two sizes make no exponent: any two points lie on a power law.
    let of_auto = |r: &&&Value| r["linear_solver"] == "auto" && r["reference"] == false && r["threads"] == 1;
    let points: Vec<[f64; 2]> = solves
        .iter()
        .filter(of_auto)
        .map(|r| [number(r, "vertices"), number(&r["iteration_seconds"], "median")])
        .collect();
    assert!(points.len() == 2 && PowerLaw::fit(&points).is_none());
    assert_eq!(fs::read_to_string(out.join("exponents.csv")).unwrap().lines().count(), 1);
    for plot in ["solver-iteration", "solver-solve", "solver-graph", "registration-registration"] {
        let svg = fs::read_to_string(out.join(format!("{plot}.svg"))).unwrap();
        assert!(!svg.contains("exponent") && svg.contains("seconds") && svg.contains("threads 2"), "{plot}");
    }
}
