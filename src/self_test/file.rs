//! A file in the system's temporary folder.

use std::error::Error;
use std::path::Path;

use super::face::Face;
use super::{Check, largest};
use crate::mesh::PolygonMesh;
use crate::mesh::io;

/// Every digit that is needed is written: what is read has the same bits.
pub const ROUND_TRIP: Check = Check {
    what: "a mesh written to the temporary folder and read: largest difference / mm",
    expected: 0.0,
    tolerance: 0.0,
    compute: round_trip,
};

fn round_trip() -> Result<f64, Box<dyn Error>> {
    let mesh = Face::new().template;
    let path = std::env::temp_dir().join(format!("nonrigid-self-test-{}.obj", std::process::id()));
    let read = written_and_read(&mesh, &path);
    let _ = std::fs::remove_file(&path); // if it was not written, the error says so
    let read = read?;
    if (&read.starts, &read.corners, read.positions.len()) != (&mesh.starts, &mesh.corners, mesh.positions.len()) {
        return Err(format!("{}: other polygons than were written", path.display()).into());
    }
    let coordinates = read.positions.iter().flatten().zip(mesh.positions.iter().flatten());
    Ok(largest(coordinates.map(|(a, b)| a - b)))
}

fn written_and_read(mesh: &PolygonMesh, path: &Path) -> Result<PolygonMesh, Box<dyn Error>> {
    io::write_polygon_mesh(path, mesh)?;
    Ok(io::read_polygon_mesh(path)?)
}
