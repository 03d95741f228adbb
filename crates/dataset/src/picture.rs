//! Pictures as a person sees them: whatever reads one, for training, inference or a report, reads the same pixels.
use crate::DatasetError;
use image::{DynamicImage, ImageDecoder, ImageReader, RgbImage, metadata::Orientation};
use std::path::Path;

/// Reads a picture: its EXIF orientation applied, any colour type turned into RGB, the format told by its first bytes.
///
/// # Errors
/// If it cannot be read or has no pixels.
pub fn read(path: impl AsRef<Path>) -> Result<RgbImage, DatasetError> {
    let path = path.as_ref();
    let mut decoder = open(path)?;
    let orientation = decoder.orientation().map_err(|e| broken(path, e))?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(|e| broken(path, e))?;
    image.apply_orientation(orientation);
    let image = image.into_rgb8();
    if image.width() == 0 || image.height() == 0 { Err(broken(path, "no pixels")) } else { Ok(image) }
}

/// Width and height of what [`read`] gives, from the file's head alone.
///
/// # Errors
/// If there is no such file, or it is no picture.
pub fn dimensions(path: impl AsRef<Path>) -> Result<(u32, u32), DatasetError> {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    let path = path.as_ref();
    let mut decoder = open(path)?;
    let (width, height) = decoder.dimensions();
    let lies = matches!(decoder.orientation().map_err(|e| broken(path, e))?, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH);
    Ok(if lies { (height, width) } else { (width, height) })
}

fn open(path: &Path) -> Result<impl ImageDecoder + use<>, DatasetError> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(|e| DatasetError::io(path, e))?;
    reader.into_decoder().map_err(|e| broken(path, e))
}

fn broken(path: &Path, message: impl ToString) -> DatasetError {
    DatasetError::Image { path: path.to_owned(), message: message.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A JPEG with an EXIF block that says "turn me by 90 degrees".
    #[test]
    fn a_turned_photo_is_seen_upright() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lying.jpg");
        let picture = RgbImage::from_fn(32, 16, |x, _| if x < 16 { [250, 250, 250].into() } else { [5, 5, 5].into() });
        picture.save(&path).unwrap();
        let plain = std::fs::read(&path).unwrap();
        let exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let mut turned = plain[..2].to_vec();
        turned.extend([0xff, 0xe1]);
        turned.extend((exif.len() as u16 + 2).to_be_bytes());
        turned.extend(exif);
        turned.extend(&plain[2..]);
        std::fs::write(&path, turned).unwrap();
        assert_eq!(dimensions(&path).unwrap(), (16, 32));
        let seen = read(&path).unwrap();
        assert_eq!(seen.dimensions(), (16, 32));
        // Turned clockwise, the left half comes to lie above.
        assert!(seen.get_pixel(8, 4)[0] > 200 && seen.get_pixel(8, 28)[0] < 50);
    }

    #[test]
    fn what_is_no_picture_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("text.png");
        std::fs::write(&path, "no picture").unwrap();
        for message in [read(&path).unwrap_err().to_string(), dimensions(&path).unwrap_err().to_string()] {
            assert!(message.contains("text.png"), "{message}");
        }
        assert!(read(dir.path().join("none.png")).is_err());
    }
}
