//! Writing pictures so that a reader never sees half a file.

use std::io::Write;
use std::path::{Path, PathBuf};

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, RgbImage};

use crate::io::{WriteError, write_atomically};

/// Why a picture was not written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file system refused.
    #[error(transparent)]
    Write(#[from] WriteError),
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

/// Writes `image` to `path` as PNG, by [`write_atomically`].
///
/// # Errors
/// When the folder cannot be written to or the image has no pixels. An existing file at `path` is then left as it was.
pub fn save_png(image: &RgbImage, path: impl AsRef<Path>) -> Result<(), PictureError> {
    let path = path.as_ref();
    let (width, height) = image.dimensions();
    let bytes =
        encode_png(image).map_err(|source| PictureError::Encode { path: path.into(), width, height, source })?;
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
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
        assert!(error.contains("a.png") && error.contains("cannot be written"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
