//! PC2 point caches: the vertices of every frame, for a mesh that stands beside it. Blender's Mesh Cache modifier, Maya, 3ds Max and
//! Houdini read them.

use std::io::Write;
use std::path::Path;

use super::{WriteError, write_atomically};
use crate::mesh::Vec3;

/// Writes the positions of every frame, millimetres, in 32 bits.
///
/// # Errors
/// When the file cannot be written, there is no frame, frames have different numbers of vertices, or a coordinate is not finite in 32
/// bits.
pub fn write_pc2(path: &Path, frames: &[Vec<Vec3>]) -> Result<(), WriteError> {
    check_frames(path, frames)?;
    write_atomically(path, |w| {
        w.write_all(b"POINTCACHE2\0")?;
        w.write_all(&1i32.to_le_bytes())?;
        w.write_all(&(frames[0].len() as i32).to_le_bytes())?;
        w.write_all(&0f32.to_le_bytes())?; // first frame
        w.write_all(&1f32.to_le_bytes())?; // frames to a sample
        w.write_all(&(frames.len() as i32).to_le_bytes())?;
        for x in frames.iter().flatten().flat_map(|p| [p.x, p.y, p.z]) {
            w.write_all(&(x as f32).to_le_bytes())?;
        }
        Ok(())
    })
}

/// Refuses what no format of animations can hold.
pub(super) fn check_frames(path: &Path, frames: &[Vec<Vec3>]) -> Result<(), WriteError> {
    let fail = |expected: String, found: String| Err(WriteError::data(path, expected, found));
    let Some(first) = frames.first() else { return fail("at least one frame".into(), "none".into()) };
    if i32::try_from(first.len().max(frames.len())).is_err() {
        return fail("fewer than 2^31 frames and vertices".into(), first.len().max(frames.len()).to_string());
    }
    for (k, frame) in frames.iter().enumerate() {
        if frame.len() != first.len() {
            return fail(format!("{} vertices in frame {k}, as in the first", first.len()), frame.len().to_string());
        }
        if let Some(v) = frame.iter().position(|p| !p.iter().all(|x| (*x as f32).is_finite())) {
            let at = frame[v].as_slice();
            return fail(format!("coordinates within 32 bits in frame {k}"), format!("{at:?} at vertex {v}"));
        }
    }
    Ok(())
}
