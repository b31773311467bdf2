//! `consistency` on people of another topology than the rig's: what it says of a result that is the population's own, the same of a
//! folder and of stacked vertices, and how models compare.

use std::fs;
use std::path::Path;
use std::process::Command;

use data_gen::{FaceOptions, FaceRig, write_rig};
use nonrigid::io::{write_npy, write_polygon_mesh};
use serde_json::Value;

/// Rows by model.
fn consistency(folder: &Path, options: &[&str], out: &str) -> Vec<Value> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_experiments"));
    command.args(["consistency", "--rig", "rig", "--out", out]).args(options).current_dir(folder);
    let run = command.output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let json: Value = serde_json::from_slice(&fs::read(folder.join(out).join("consistency.json")).unwrap()).unwrap();
    json["rows"].as_array().unwrap().clone()
}

#[test]
fn a_population_says_how_consistent_models_are_and_a_folder_says_the_same_as_one_array() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let face = |vertices| FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() });
    write_rig(&at("rig"), &face(1000)).unwrap();
    let other = face(1500);
    fs::create_dir(at("faces")).unwrap();
    let mut stacked = Vec::new();
    for (i, weights) in [[1.0, -0.5], [-1.0, 0.8], [0.2, 1.2]].iter().enumerate() {
        let positions = other.pose(&[], weights);
        stacked.extend(positions.iter().flat_map(|p| [p.x, p.y, p.z]));
        write_polygon_mesh(&at(&format!("faces/{i}.obj")), &other.mesh.with_positions(positions)).unwrap();
    }
    write_npy(&at("faces.npy"), &[3, other.neutral.len(), 3], &stacked).unwrap();
    write_polygon_mesh(&at("face.obj"), &other.mesh).unwrap();

    let models = ["--models", "rigid,blendshape", "--threads"];
    let rows = consistency(folder.path(), &[&["--population", "faces", "--meshes"], &models[..], &["1"]].concat(), "a");
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"));
    for row in &rows {
        assert_eq!(row["faces"], serde_json::json!([3, 3]), "{row}");
        assert!(number(row, "median") <= number(row, "worst") && number(row, "rms") <= number(row, "worst"), "{row}");
    }
    // The rig spans these people: its shapes find them, a rigid template cannot.
    let [rigid, blendshape] = [&rows[0], &rows[1]];
    assert!(number(blendshape, "rms") < 0.5 * number(rigid, "rms"), "{rigid} {blendshape}");
    assert!(number(blendshape, "distance") < 0.2 && number(blendshape, "counted") > 0.8, "{blendshape}");
    for file in ["consistency.csv", "consistency.png", "rigid_00.obj", "blendshape_02.obj"] {
        assert!(at("a").join(file).metadata().unwrap().len() > 100, "{file}");
    }

    let array = ["--population", "faces.npy", "--template-of-population", "face.obj"];
    let again = consistency(folder.path(), &[&array, &models[..], &["2"]].concat(), "b");
    for (one, other) in rows.iter().zip(&again) {
        for key in ["rms", "median", "worst", "counted", "distance"] {
            let [one, other] = [one, other].map(|row| number(row, key)); // an .obj has fewer digits than an .npy
            assert!((one - other).abs() < 1e-3, "{key}: {one} {other}");
        }
    }
}
