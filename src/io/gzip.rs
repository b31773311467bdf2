//! Files that may be packed by gzip (RFC 1952), such as `scan.ply.gz`.

use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;

use super::error::{extension, read_file};
use super::{Place, ReadError};

/// What unpacks to more is refused: more than any mesh.
const MOST: u64 = 1 << 32;
/// The same for each byte of the packed file. The format goes up to a thousand, for one byte over and over; meshes as text
/// come to 3 to 10, a flat grid as ascii STL to 46.
const MOST_PER_BYTE: u64 = 200;
/// What any file may unpack to, however short.
const ALWAYS: u64 = 1 << 24;

/// The extension in lower case: of what is inside if the file ends in `.gz`.
pub(super) fn inner_extension(path: &Path) -> String {
    extension(&unpacked_name(path))
}

/// The path without `.gz`.
pub(crate) fn unpacked_name(path: &Path) -> PathBuf {
    if is_packed(path) { path.with_extension("") } else { path.to_owned() }
}

/// The content of a file, unpacked if it ends in `.gz`.
pub(super) fn read_unpacked(path: &Path) -> Result<Vec<u8>, ReadError> {
    let bytes = read_file(path)?;
    if is_packed(path) { unpack(&bytes, path, most_unpacked(bytes.len() as u64)) } else { Ok(bytes) }
}

pub(super) fn is_packed(path: &Path) -> bool {
    extension(path) == "gz"
}

/// What so many bytes may unpack to.
pub(super) fn most_unpacked(packed: u64) -> u64 {
    packed.saturating_mul(MOST_PER_BYTE).clamp(ALWAYS, MOST)
}

fn unpack(bytes: &[u8], path: &Path, most: u64) -> Result<Vec<u8>, ReadError> {
    let mut unpacked = Vec::new();
    let read = MultiGzDecoder::new(bytes).take(most + 1).read_to_end(&mut unpacked);
    if let Err(error) = read {
        return Err(ReadError::malformed(path, Place::File, "a whole gzip file", error.to_string()));
    }
    if unpacked.len() as u64 > most {
        return Err(ReadError::malformed(path, Place::File, format!("at most {most} bytes unpacked"), "more"));
    }
    Ok(unpacked)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn what_unpacks_to_too_much_is_refused() {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        packer.write_all(&[0; 100_000]).unwrap();
        let packed = packer.finish().unwrap();
        let path = Path::new("a.obj.gz");
        assert_eq!(unpack(&packed, path, 100_000).unwrap().len(), 100_000);
        let message = unpack(&packed, path, 99_999).unwrap_err().to_string();
        assert!(message.contains("a.obj.gz") && message.contains("at most 99999 bytes"), "{message}");
        assert!(unpack(&packed[..packed.len() - 5], path, 100_000).is_err());
    }
}
