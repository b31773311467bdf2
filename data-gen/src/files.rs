//! Rigs and scan cases as folders of files, in the layout that `nonrigid` and `scan-bench` read.
//!
//! | rig | case |
//! |---|---|
//! | `template.obj`, `face.mtl`, `neutral.npy` (V, 3) | `scan.ply` |
//! | `expression_deltas.npy` (K, V, 3), `expression_names.json` | `truth.npy` (V, 3), `observed.npy` (V) |
//! | `identity_deltas.npy`, `identity_names.json` | `landmarks.json`: template vertex -> point of the scan |
//! | `landmarks_multipie68.json`: 68 vertices; `landmarks.json`: name -> vertex; `landmarks_anthropometric.json`: the names of `nonrigid measure` -> vertex | `case.json`: what a fit may use, and what was drawn |
//! | `regions.json`: name -> vertices; `eyeballs.json`: spheres | `neutral.npy` (V, 3), where the subject's own neutral is known |
//!
//! Arrays hold 32 bits, coordinates in text files all digits. Every rig, case and population is written whole or not at all.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use nonrigid::io::{
    PlyOptions, WriteError, write_atomically, write_folder, write_json, write_npy, write_obj, write_ply,
};
use nonrigid::mesh::Vec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::{Map, Value, json};

use crate::{FaceRig, ScanCase};

/// The template's materials.
pub(crate) const LIBRARY: &str = "face.mtl";
const MATERIALS: &str = "newmtl skin\nKd 0.86 0.68 0.58\nKs 0.04 0.04 0.04\nNs 12\n
newmtl lips\nKd 0.76 0.42 0.40\nKs 0.10 0.10 0.10\nNs 30\n";

/// How much of the scanned person a fit knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Subject {
    /// The person's own neutral face, but not these expressions of the rig.
    Same {
        /// Full names of expressions.
        withheld: Vec<String>,
    },
    /// Nothing: it starts from the template with all expressions and the first identity modes.
    New {
        /// How many identity modes a fit may use.
        identity_modes: usize,
    },
}

impl Subject {
    /// A known person of whose expressions the weakest one that the scan shows is withheld.
    #[must_use]
    pub fn same(rig: &FaceRig, case: &ScanCase) -> Self {
        let shown = rig.expressions.iter().zip(&case.expression_weights).filter(|(_, w)| **w != 0.0);
        let weakest = shown.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        Self::Same { withheld: weakest.map(|(e, _)| e.0.clone()).into_iter().collect() }
    }

    /// An unknown person, with two fifths of the rig's identity modes: the first 40 of 100.
    #[must_use]
    pub fn new(rig: &FaceRig) -> Self {
        Self::New { identity_modes: rig.identities.len() * 2 / 5 }
    }
}

/// [`write_folder`], with the folders above.
fn write_deep_folder(folder: &Path, fill: impl FnOnce(&Path) -> Result<(), WriteError>) -> Result<(), WriteError> {
    if let Some(parent) = folder.parent() {
        fs::create_dir_all(parent).map_err(|source| WriteError::Io { path: parent.to_owned(), source })?;
    }
    write_folder(folder, fill)
}

/// Writes a rig; makes the folder if it is not there.
///
/// # Errors
/// When a file cannot be written, or the folder has shapes of a family that this rig has none of: nothing has changed then.
pub fn write_rig(folder: &Path, rig: &FaceRig) -> Result<(), WriteError> {
    for family in absent_families(rig) {
        let [deltas, _] = shape_files(folder, family);
        if deltas.exists() {
            return Err(WriteError::data(&deltas, "no shapes of another rig here", "them: move them away"));
        }
    }
    write_deep_folder(folder, |aside| write_rig_into(aside, rig))
}

/// Takes away, of a rig that is this program's own to replace, the shapes of families that `rig` has none of.
pub(crate) fn forget_shapes(folder: &Path, rig: &FaceRig) -> Result<(), WriteError> {
    for family in absent_families(rig) {
        for path in shape_files(folder, family) {
            match fs::remove_file(&path) {
                Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                    return Err(WriteError::Io { path, source });
                }
                _ => {}
            }
        }
    }
    Ok(())
}

fn absent_families(rig: &FaceRig) -> impl Iterator<Item = &'static str> {
    let families = [("expression", rig.expressions.is_empty()), ("identity", rig.identities.is_empty())];
    families.into_iter().filter(|(_, none)| *none).map(|(family, _)| family)
}

fn write_materials(folder: &Path) -> Result<(), WriteError> {
    write_atomically(&folder.join(LIBRARY), |file| file.write_all(MATERIALS.as_bytes()))
}

fn write_rig_into(folder: &Path, rig: &FaceRig) -> Result<(), WriteError> {
    write_obj(&folder.join("template.obj"), &rig.mesh)?;
    write_materials(folder)?;
    write_points(&folder.join("neutral.npy"), &rig.neutral)?;
    let (names, deltas): (Vec<&str>, Vec<&[Vec3]>) = rig.expressions.iter().map(|e| (&*e.0, &*e.1)).unzip();
    write_shapes(folder, "expression", &names, &deltas)?;
    let names: Vec<String> = (0..rig.identities.len()).map(|k| format!("identity{k:03}")).collect();
    let deltas: Vec<&[Vec3]> = rig.identities.iter().map(Vec::as_slice).collect();
    write_shapes(folder, "identity", &names, &deltas)?;
    for (file, landmarks) in [("landmarks", &rig.landmarks), ("landmarks_anthropometric", &rig.anthropometric)] {
        let named: Map<String, Value> = landmarks.iter().map(|l| (l.name.clone(), l.vertex.into())).collect();
        write_json(&folder.join(format!("{file}.json")), &named)?;
    }
    let landmarks: Vec<u32> = rig.landmarks.iter().map(|l| l.vertex).collect();
    write_json(&folder.join("landmarks_multipie68.json"), &landmarks)?;
    let regions: Map<String, Value> =
        rig.regions.iter().map(|(name, vertices)| (name.clone(), json!(vertices))).collect();
    write_json(&folder.join("regions.json"), &regions)?;
    let Some(eyeballs) = rig.eyeballs(&[]) else { return Ok(()) };
    let [left, right] = eyeballs.map(|e| json!({ "centre": [e.centre.x, e.centre.y, e.centre.z], "radius": e.radius }));
    write_json(&folder.join("eyeballs.json"), &json!({ "left": left, "right": right }))
}

/// Writes `people` random neutral faces, `person_0000.obj` and so on, drawn from N(0, 1) per identity mode, and their materials, if
/// they are those of a generated rig.
///
/// # Errors
/// When a file cannot be written.
pub fn write_population(folder: &Path, rig: &FaceRig, people: usize, seed: u64) -> Result<(), WriteError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut mesh = rig.mesh.clone();
    mesh.metadata.material_libraries.retain(|name| name == LIBRARY);
    write_deep_folder(folder, |aside| {
        if !mesh.metadata.material_libraries.is_empty() {
            write_materials(aside)?;
        }
        for k in 0..people {
            let weights: Vec<f64> = rig.identities.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
            write_obj(&aside.join(format!("person_{k:04}.obj")), &mesh.with_positions(rig.pose(&[], &weights)))?;
        }
        Ok(())
    })
}

/// Writes a case; makes the folder if it is not there. `seed` is what the scan was simulated from.
///
/// # Errors
/// When a file cannot be written.
pub fn write_case(
    folder: &Path,
    rig: &FaceRig,
    case: &ScanCase,
    subject: &Subject,
    seed: u64,
) -> Result<(), WriteError> {
    write_deep_folder(folder, |aside| write_case_into(aside, rig, case, subject, seed))
}

fn write_case_into(
    folder: &Path,
    rig: &FaceRig,
    case: &ScanCase,
    subject: &Subject,
    seed: u64,
) -> Result<(), WriteError> {
    write_ply(&folder.join("scan.ply"), &case.scan, PlyOptions::default())?;
    write_points(&folder.join("truth.npy"), &case.truth)?;
    write_npy(&folder.join("observed.npy"), &[case.observed.len()], &case.observed)?;
    let landmarks: Map<String, Value> =
        case.landmarks.iter().map(|(v, p)| (v.to_string(), json!([p.x, p.y, p.z]))).collect();
    write_json(&folder.join("landmarks.json"), &landmarks)?;

    let neutral = rig.pose(&[], &case.identity_weights);
    let (same, withheld, identity_modes): (_, &[String], _) = match subject {
        Subject::Same { withheld } => (true, withheld, 0),
        Subject::New { identity_modes } => (false, &[], *identity_modes),
    };
    if same {
        write_points(&folder.join("neutral.npy"), &neutral)?;
    }
    let names = rig.expressions.iter().map(|e| &e.0);
    let drawn: Map<String, Value> = names
        .clone()
        .zip(&case.expression_weights)
        .filter(|(_, w)| **w != 0.0)
        .map(|(name, w)| (name.clone(), (*w).into()))
        .collect();
    let offered = names.filter(|name| !withheld.contains(name));
    let description = json!({
        "seed": seed,
        "same_subject": same,
        "expression": drawn,
        "identity_sigma": case.identity_sigma,
        "identity": case.identity_weights,
        "pose": case.pose,
        "withhold": withheld,
        "rig_expressions": offered.collect::<Vec<_>>(),
        "rig_identity_modes": identity_modes,
        "vertices": case.scan.positions.len(),
        "triangles": case.scan.triangles.len(),
        "observed": case.observed.iter().filter(|o| **o).count(),
        "start_rmse_mm": start_rmse(case, &neutral),
    });
    write_json(&folder.join("case.json"), &description)
}

/// What a perfect rigid registration of the subject's own neutral leaves, over the observed vertices.
fn start_rmse(case: &ScanCase, neutral: &[Vec3]) -> f64 {
    let observed = case.truth.iter().zip(neutral).zip(&case.observed).filter(|(_, o)| **o);
    let errors: Vec<f64> = observed.map(|((t, n), _)| (t - case.pose.apply(*n)).norm_squared()).collect();
    (errors.iter().sum::<f64>() / errors.len().max(1) as f64).sqrt()
}

/// Deltas and names of a family.
fn shape_files(folder: &Path, family: &str) -> [PathBuf; 2] {
    ["deltas.npy", "names.json"].map(|ending| folder.join(format!("{family}_{ending}")))
}

/// Deltas and names of a family; without shapes no files.
fn write_shapes(folder: &Path, family: &str, names: &[impl AsRef<str>], deltas: &[&[Vec3]]) -> Result<(), WriteError> {
    let [deltas_path, names_path] = shape_files(folder, family);
    let Some(vertices) = deltas.first().map(|d| d.len()) else { return Ok(()) };
    let items: Vec<f32> =
        deltas.iter().flat_map(|d| d.iter().flat_map(|p| [p.x, p.y, p.z])).map(|x| x as f32).collect();
    write_npy(&deltas_path, &[names.len(), vertices, 3], &items)?;
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    write_json(&names_path, &names)
}

fn write_points(path: &Path, points: &[Vec3]) -> Result<(), WriteError> {
    let items: Vec<f32> = points.iter().flat_map(|p| [p.x, p.y, p.z]).map(|x| x as f32).collect();
    write_npy(path, &[points.len(), 3], &items)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FaceOptions, ScanOptions, simulate_scan};
    use nonrigid::io::{read_npy_mask, read_npy_points, read_scan};
    use nonrigid::landmark::{read_landmarks, read_template_landmarks};
    use nonrigid::rig::{Family, Rig, RigReadOptions};

    #[test]
    fn the_library_reads_back_the_rig() {
        let (folder, rig) =
            (tempfile::tempdir().unwrap(), FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 9 }));
        write_rig(folder.path(), &rig).unwrap();
        let (read, warnings) = Rig::read(folder.path(), &RigReadOptions::default()).unwrap();
        assert_eq!(warnings, []);
        assert_eq!(read.mesh(), Some(&rig.mesh));
        let names: Vec<&str> = read.shapes().iter().map(|s| s.name.as_str()).collect();
        let count = rig.expressions.len();
        assert_eq!(names[..count], rig.expressions.iter().map(|e| &*e.0).collect::<Vec<_>>());
        assert!(read.shapes()[count..].iter().all(|s| s.family == Family::Identity) && names.len() == count + 9);
        let shapes = rig.expressions.iter().map(|e| &e.1).chain(&rig.identities);
        for (k, shape) in shapes.enumerate() {
            let expected: Vec<f32> = shape.iter().flat_map(|p| [p.x, p.y, p.z]).map(|x| x as f32).collect();
            assert_eq!(read.deltas(k), expected, "{}", names[k]);
        }
        let landmarks = read_template_landmarks(&folder.path().join("landmarks.json"), &rig.mesh).unwrap();
        assert_eq!(landmarks.len(), rig.landmarks.len());
        let numbers: Vec<u32> = rig.landmarks.iter().map(|l| l.vertex).collect();
        assert_eq!((numbers.len(), read.landmarks()), (68, Some(&*numbers)));
        let json =
            |name: &str| -> Value { serde_json::from_slice(&fs::read(folder.path().join(name)).unwrap()).unwrap() };
        let in_regions: usize =
            json("regions.json").as_object().unwrap().values().map(|r| r.as_array().unwrap().len()).sum();
        assert_eq!(rig.neutral.len(), in_regions);
        assert!(json("eyeballs.json")["left"]["centre"][0].as_f64().unwrap() > 20.0);
        let materials = fs::read_to_string(folder.path().join("face.mtl")).unwrap();
        assert!(materials.contains("newmtl skin\n") && materials.contains("newmtl lips\n"));
    }

    #[test]
    fn the_library_reads_back_cases_of_both_kinds() {
        let (folder, rig) =
            (tempfile::tempdir().unwrap(), FaceRig::generate(&FaceOptions { vertices: 1000, identity_modes: 9 }));
        let case = simulate_scan(&rig, &ScanOptions { triangles: 5000, ..ScanOptions::default() }, 5).unwrap();
        let (same, new) = (folder.path().join("same"), folder.path().join("new"));
        write_case(&same, &rig, &case, &Subject::same(&rig, &case), 5).unwrap();
        write_case(&new, &rig, &case, &Subject::new(&rig), 5).unwrap();
        let near = |a: &[Vec3], b: &[Vec3]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).norm() < 1e-6 * b.norm().max(1.0))
        };
        for folder in [&same, &new] {
            let scan = read_scan(&folder.join("scan.ply")).unwrap().mesh;
            assert!(scan.triangles == case.scan.triangles && near(&scan.positions, &case.scan.positions));
            assert!(near(&read_npy_points(&folder.join("truth.npy")).unwrap(), &case.truth));
            assert_eq!(read_npy_mask(&folder.join("observed.npy"), None).unwrap(), case.observed);
            let landmarks = read_landmarks(&folder.join("landmarks.json"), None, &rig.mesh, None).unwrap();
            assert_eq!(landmarks.len(), case.landmarks.len());
            for landmark in landmarks {
                let vertex: u32 = landmark.name.parse().unwrap();
                let written = case.landmarks.iter().find(|l| l.0 == vertex).unwrap().1;
                assert!((landmark.target - written).norm() < 1e-12);
            }
        }
        assert!(near(&read_npy_points(&same.join("neutral.npy")).unwrap(), &rig.pose(&[], &case.identity_weights)));
        assert!(!new.join("neutral.npy").exists());
        let description =
            |folder: &Path| -> Value { serde_json::from_slice(&fs::read(folder.join("case.json")).unwrap()).unwrap() };
        let (same, new) = (description(&same), description(&new));
        let count = rig.expressions.iter().filter(|e| e.0 != "mouthClose").count();
        assert_eq!(same["rig_expressions"].as_array().unwrap().len(), count - 1);
        assert_eq!((&same["rig_identity_modes"], &new["rig_identity_modes"]), (&json!(0), &json!(3)));
        assert_eq!(new["rig_expressions"].as_array().unwrap().len(), count);
        assert!(same["start_rmse_mm"].as_f64().unwrap() > 0.5 && same["start_rmse_mm"] == new["start_rmse_mm"]);
        let withheld = same["withhold"][0].as_str().unwrap();
        assert!(same["expression"][withheld].as_f64().unwrap() > 0.0);
    }
}
