//! Real files, which lie in `shared/data` beside the checkout or where `NONRIGID_DATA` points.

use std::path::{Path, PathBuf};

use crate::skip::skipped;

/// The file or folder of that name, if it is there; notes that something is skipped if it is not.
pub fn real_data(name: &str) -> Option<PathBuf> {
    let folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|folder| folder.join("shared/data"));
    let path = match std::env::var_os("NONRIGID_DATA") {
        Some(folder) => Some(PathBuf::from(folder).join(name)).filter(|path| path.exists()),
        None => folders.map(|folder| folder.join(name)).find(|path| path.exists()),
    };
    if path.is_none() {
        skipped(format!("{name} is absent (set NONRIGID_DATA)"));
    }
    path
}
