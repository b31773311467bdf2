//! Registers files, as a program in Rust does: `register_files TEMPLATE RIG MODES SCAN LANDMARKS OUT.obj`. The tests of the Python package
//! compare its results.

use std::error::Error;
use std::path::PathBuf;

use nonrigid::io;
use nonrigid::registration::Registration;
use nonrigid::rig::{Rig, RigReadOptions, ShapeSelection};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [template, rig, modes, scan, landmarks, out] = &arguments[..] else {
        return Err("give template, rig, identity modes, scan, landmarks and output".into());
    };
    let modes = modes.to_str().and_then(|m| m.parse().ok()).ok_or("identity modes: a number")?;
    let (rig, _) = Rig::read(rig, &RigReadOptions { identity_modes: modes, ..RigReadOptions::default() })?;
    let shapes = rig.select(ShapeSelection { identity_modes: modes, ..ShapeSelection::default() })?;
    let mut template = io::read_polygon_mesh(template)?;
    template.metadata.material_libraries.clear(); // they are not beside the result
    let scan = io::read_scan(scan)?.mesh;
    let landmarks = nonrigid::landmark::read_landmarks(landmarks, None, &template, Some(&scan))?;
    let result = Registration::new(&template, &scan).shapes(&shapes).landmarks(&landmarks).run()?;
    Ok(io::write_obj(out, &template.with_positions(result.positions))?)
}
