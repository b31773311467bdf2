//! A folder of generated inputs, and the built program run in it.
#![allow(dead_code)] // every test binary uses its own part of this

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use data_gen::{FaceOptions, FaceRig, ScanCase, ScanOptions, Subject, simulate_scan, write_case, write_rig};
use nonrigid::mesh::Vec3;
use serde_json::Value;

/// A temporary folder with `rig/` and `case/` (a person whose neutral is known), removed with this value.
pub struct Bench {
    folder: tempfile::TempDir,
    pub rig: FaceRig,
    pub case: ScanCase,
}

/// What the program did.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Bench {
    pub fn new() -> Self {
        Self::of_size(1000, 8000)
    }

    /// About so many vertices of the template and triangles of the scan.
    pub fn of_size(vertices: usize, triangles: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: 8 });
        let case = simulate_scan(&rig, &ScanOptions { triangles, ..ScanOptions::default() }, 7).unwrap();
        write_rig(&folder.path().join("rig"), &rig).unwrap();
        write_case(&folder.path().join("case"), &rig, &case, &Subject::same(&rig, &case), 7).unwrap();
        Self { folder, rig, case }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.read(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Runs the program in the folder with arguments separated by spaces.
    pub fn run(&self, arguments: &str) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_nonrigid"))
            .args(arguments.split_whitespace())
            .current_dir(self.folder.path())
            .output()
            .unwrap();
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        let code = output.status.code().unwrap_or_else(|| panic!("{arguments}: killed by a signal"));
        Run { code, stdout: text(&output.stdout), stderr: text(&output.stderr) }
    }

    /// As [`Self::run`], and it has to succeed.
    pub fn done(&self, arguments: &str) -> String {
        let run = self.run(arguments);
        assert_eq!(run.code, 0, "{arguments}\n{}", run.stderr);
        run.stdout
    }

    /// As [`Self::run`], and it has to end with this code; what it says on stderr.
    pub fn ends(&self, arguments: &str, code: i32) -> String {
        let run = self.run(arguments);
        assert_eq!(run.code, code, "{arguments}\n{}", run.stderr);
        run.stderr
    }
}

/// A schedule that does not end while a test runs.
pub fn endless_schedule() -> String {
    let level = |lambda: f64| {
        format!(
            "[[level]]\nsteps = 1000000\nmodel = {{ lambda_graph = {lambda:.1} }}\nterms.landmarks = {{ weight = 1.0 }}\n\
             kernel = \"none\"\ndistance_cap = 25.0\nnormal_angle = 60.0\n"
        )
    };
    // A level may end where no bit moves any more; one that pulls another way moves again.
    let levels = (level(1.0) + &level(1000.0)).repeat(2500);
    "reference_size = 67.0\nreference_vertices = 6706\nstop = { energy = 0.0, motion = 0.0 }\n[model]\nnodes = 60\n"
        .to_owned()
        + &levels
}

/// Landmarks as (template vertex, point), in the form of a case's `landmarks.json`.
pub fn landmarks_json(landmarks: &[(u32, Vec3)]) -> String {
    let entries: Vec<String> =
        landmarks.iter().map(|(v, p)| format!("\"{v}\": [{:?}, {:?}, {:?}]", p.x, p.y, p.z)).collect();
    format!("{{{}}}", entries.join(", "))
}

/// Document and buffer of a glTF file that is one.
pub fn glb_parts(bytes: &[u8]) -> (Value, &[u8]) {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..20 + length]).unwrap(), &bytes[28 + length..])
}

/// Largest distance between two lists of points.
pub fn farthest(a: &[Vec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// Names of the files in a folder, sorted.
pub fn files_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
