//! Pictures become PNG files.
//!
//! In: a picture and what should be said about it. Out: 8-bit RGB PNG bytes or a file.
//! Never: writes a physical pixel size in the `pHYs` chunk (text processors would show the field of view
//! micrometers small); the pixel pitch goes into a text entry instead.
//! Fails: [`DisplayError::Encode`], [`DisplayError::Write`].

use std::path::Path;

use super::error::DisplayError;
use super::picture::RgbImage;

/// Text entries of the PNG file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PngNotes {
    /// Entry `Title`, e.g. what the picture shows.
    pub title: Option<String>,
    /// Entry `Pixel pitch (nm)`: size of one picture pixel in the sample, in nanometers.
    pub pixel_pitch_nm: Option<f64>,
}

impl RgbImage {
    /// The picture as the bytes of a PNG file with the entry `Software`.
    ///
    /// # Errors
    /// [`DisplayError::Encode`] if the encoder refuses.
    pub fn to_png(&self, notes: &PngNotes) -> Result<Vec<u8>, DisplayError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, side(self.width())?, side(self.height())?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        encoder.add_itxt_chunk("Software".to_owned(), software())?;
        if let Some(title) = &notes.title {
            encoder.add_itxt_chunk("Title".to_owned(), title.clone())?;
        }
        if let Some(pitch) = notes.pixel_pitch_nm {
            encoder.add_itxt_chunk("Pixel pitch (nm)".to_owned(), format!("{pitch}"))?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.bytes())?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Writes the picture as a PNG file.
    ///
    /// # Errors
    /// [`DisplayError::Encode`] if the encoder refuses, [`DisplayError::Write`] if the file cannot be written.
    pub fn write_png(&self, path: &Path, notes: &PngNotes) -> Result<(), DisplayError> {
        let bytes = self.to_png(notes)?;
        std::fs::write(path, bytes).map_err(|source| DisplayError::Write { path: path.to_owned(), source })
    }
}

fn software() -> String {
    format!("{} {}", env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"))
}

fn side(pixels: usize) -> Result<u32, DisplayError> {
    u32::try_from(pixels).map_err(|_| DisplayError::Size { height: pixels, width: pixels })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_notes_come_back() {
        let image = RgbImage::from_fn(4, 6, |y, x| [y as u8, x as u8, 200]).unwrap();
        let notes = PngNotes { title: Some("κ₂ of α".to_owned()), pixel_pitch_nm: Some(54.0) };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        image.write_png(&path, &notes).unwrap();

        let bytes = std::fs::read(&path).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, image.bytes());
        let entries = &reader.info().utf8_text;
        let text = |key: &str| entries.iter().find(|e| e.keyword == key).unwrap().get_text().unwrap();
        assert!(text("Software").starts_with("sofiscope "));
        assert_eq!(text("Title"), "κ₂ of α");
        assert_eq!(text("Pixel pitch (nm)"), "54");
    }

    #[test]
    fn a_missing_folder_is_named() {
        let image = RgbImage::from_fn(1, 1, |_, _| [0; 3]).unwrap();
        let error = image.write_png(Path::new("/no/such/folder/a.png"), &PngNotes::default()).unwrap_err();
        assert!(error.to_string().contains("/no/such/folder/a.png"));
    }
}
