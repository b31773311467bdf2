//! The demo: a generated rig, two scans of people that it does not know, and a client, all from seed 7.

use data_gen::{FaceOptions, FaceRig, STANDARD_CASES, ScanOptions, simulate_scan, write_rig};
use nonrigid::io::{PlyOptions, write_ply};

use crate::case::{Case, Edit, FileRef, Side, Source, Unit};
use crate::error::{Problem, problem};
use crate::vault::Vault;

/// Everything is drawn from it.
const SEED: u64 = 7;
/// Triangles of a scan.
const TRIANGLES: usize = 40_000;

/// Adds the demo's case: its number.
///
/// # Errors
/// When the vault cannot be written.
pub fn add(vault: &Vault) -> Result<u32, Problem> {
    let rig = FaceRig::generate(&FaceOptions::default());
    let incoming = vault.incoming()?;
    write_rig(&incoming.folder, &rig)?;
    let asset = vault.take(&incoming)?;
    let file = |file: &str| FileRef { asset: asset.clone(), file: file.to_owned() };
    let mut case = Case {
        name: "Demo".to_owned(),
        notes: "A generated face, not a person. Wrap the template onto the scan, then plan a change.".to_owned(),
        template: Some(Source { at: file("template.obj"), name: "template.obj".to_owned(), unit: Unit::Mm }),
        rig: Some(Source { at: file(""), name: "generated rig".to_owned(), unit: Unit::Mm }),
        scan: Some(0),
        ..Case::default()
    };
    for wanted in ["new_neutral", "new_open"] {
        let at = STANDARD_CASES.iter().position(|c| c.name == wanted).unwrap_or_default();
        let expressions = Some(STANDARD_CASES[at].expressions());
        let options = ScanOptions { expressions, triangles: TRIANGLES, ..ScanOptions::default() };
        let scan = simulate_scan(&rig, &options, SEED + at as u64).map_err(problem)?.scan;
        let name = format!("{wanted}.ply");
        let at = vault.add_file(&name, |path| Ok(write_ply(path, &scan, PlyOptions::default())?))?;
        case.scans.push(Source { at, name, unit: Unit::Mm });
    }
    for (preset, amount) in [("nose-bridge", 1.5), ("chin-forward", 2.0)] {
        case.apply(&Edit::SetPreset { preset: preset.to_owned(), amount, side: Side::Both })?;
    }
    vault.add_case(&case)
}
