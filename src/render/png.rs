//! Writing pictures so that a reader never sees half a file.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, RgbImage};

/// Why a picture was not written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file system refused.
    #[error("cannot write the picture {}: {source}; check that its folder exists and can be written to", path.display())]
    Write {
        /// The file that was to be written.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The encoder refused, for instance an image without pixels.
    #[error("cannot encode the picture {} ({width} x {height} pixels) as PNG: {source}", path.display())]
    Encode {
        /// The file that was to be written.
        path: PathBuf,
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// What the encoder said.
        source: image::ImageError,
    },
}

/// Writes `image` to `path` as PNG: first to a temporary file beside it, then renamed over it.
///
/// # Errors
/// When the folder cannot be written to or the image has no pixels. An existing file at `path` is then left as it was.
pub fn save_png(image: &RgbImage, path: impl AsRef<Path>) -> Result<(), PictureError> {
    let path = path.as_ref();
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.tmp", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = write(image, path, &temporary);
    if written.is_err() {
        // The first error is the one to report; the temporary file may not even exist.
        let _ = fs::remove_file(&temporary);
    }
    written
}

/// `image` as the bytes of a PNG file.
///
/// # Errors
/// When the image has no pixels.
pub fn encode_png(image: &RgbImage) -> Result<Vec<u8>, image::ImageError> {
    let (width, height) = image.dimensions();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(image.as_raw(), width, height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

fn write(image: &RgbImage, path: &Path, temporary: &Path) -> Result<(), PictureError> {
    let refused = |source| PictureError::Write { path: path.into(), source };
    let (width, height) = image.dimensions();
    let bytes =
        encode_png(image).map_err(|source| PictureError::Encode { path: path.into(), width, height, source })?;
    let mut file = BufWriter::new(File::create(temporary).map_err(refused)?);
    file.write_all(&bytes).and_then(|()| file.flush()).map_err(refused)?;
    drop(file);
    fs::rename(temporary, path).map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writes_what_was_given_and_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let picture = RgbImage::from_fn(5, 4, |x, y| image::Rgb([x as u8, y as u8, 9]));
        save_png(&picture, &path).unwrap();
        assert_eq!(image::open(&path).unwrap().to_rgb8(), picture);
        assert!(save_png(&RgbImage::new(0, 0), &path).is_err());
        assert_eq!(image::open(&path).unwrap().to_rgb8(), picture, "a failed write keeps the old file");
        let error = save_png(&picture, folder.path().join("none/a.png")).unwrap_err().to_string();
        assert!(error.contains("a.png") && error.contains("folder"), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
