//! The images that the window shows, as files.
//!
//! In: the newest look at the running result. Out: a directory of float32 OME-TIFFs and the composite.
//! Never: writes over anything, changes a value. Fails: [`AppError`] with the file and what the disk said.

use crate::app::AppError;
use crate::app::results::overlay;
use crate::display::PngNotes;
use crate::files::{OutputDirectory, ResultHeader, write_result};
use crate::reconstruction::{SofiLook, SofiStage};
use crate::viewer::AsSeen;
use crate::viewer::as_seen::draw;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Writes every step that there are images of.
///
/// # Errors
/// [`AppError`]: an existing directory, a full disk.
pub(super) fn save_look(look: &SofiLook, simulated: bool, directory: &Path) -> Result<PathBuf, AppError> {
    let out = OutputDirectory::create(directory)?;
    for stage in SofiStage::ALL {
        let images: Vec<_> = look.stage(stage).collect();
        let Some(first) = images.first() else { continue };
        let header = ResultHeader {
            name: stage.name().to_owned(),
            channels: images.iter().map(|image| image.name.clone()).collect(),
            height: first.image.nrows(),
            width: first.image.ncols(),
            pixel_size_nm: Some(first.pixel_pitch_nm),
            settings: vec![
                ("exposures".to_owned(), look.samples.to_string()),
                ("state".to_owned(), look.label.clone()),
                ("simulated".to_owned(), simulated.to_string()),
            ],
            ..ResultHeader::default()
        };
        let planes: Vec<Vec<f32>> =
            images.iter().map(|image| image.image.iter().copied().collect()).collect();
        let planes: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
        write_result(&out.file(&format!("{}.ome.tif", stage.name())), &header, &planes)?;
    }
    if let Some(last) = look.last_stage() {
        let images: Vec<_> = look.stage(last).collect();
        let planes: Vec<_> = images.iter().map(|image| image.image.as_ref().clone()).collect();
        let mut picture = overlay(&planes).map_err(AppError::data)?;
        let pitch_nm = images.first().map(|image| image.pixel_pitch_nm);
        if let Some(pitch_nm) = pitch_nm {
            picture.draw_scale_bar(pitch_nm);
        }
        let mark = if simulated { "SIMULATED: " } else { "" };
        let notes = PngNotes { title: Some(format!("{mark}{}", look.label)), pixel_pitch_nm: pitch_nm };
        picture.write_png(&out.file("composite.png"), &notes).map_err(AppError::data)?;
    }
    Ok(out.commit()?)
}

/// Draws a pane as it is seen and writes it into a file that must not exist yet.
///
/// # Errors
/// [`AppError`]: a file that is there already, a full disk, a pane without pixels.
pub(super) fn keep_picture(picture: &AsSeen, simulated: bool) -> Result<(), AppError> {
    let failed =
        |error: &dyn std::fmt::Display| AppError::Data(format!("{}: {error}", picture.path.display()));
    let (image, notes) = draw(picture, simulated).map_err(AppError::data)?;
    let bytes = image.to_png(&notes).map_err(AppError::data)?;
    let file = std::fs::OpenOptions::new().write(true).create_new(true).open(&picture.path);
    let mut file = file.map_err(|error| failed(&error))?;
    file.write_all(&bytes).and_then(|()| file.sync_all()).map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::ImageStack;
    use crate::reconstruction::StageImage;
    use ndarray::Array2;
    use std::sync::Arc;

    #[test]
    fn a_pane_is_written_once_and_says_that_it_is_simulated() {
        use crate::display::{Colormap, Contrast};
        use crate::viewer::plane::{Layer, Paint, Pixels};
        let layer = Layer {
            name: "camera R".to_owned(),
            pixels: Pixels::Counts { counts: Arc::new(vec![7; 64 * 48]), width: 64, saturation: None },
            pixel_pitch_nm: 100.0,
            paint: Paint::Map(Colormap::Gray),
            warp: None,
        };
        let request = crate::viewer::renderer::Request {
            key: 1,
            layers: vec![layer],
            split: None,
            contrast: Contrast::default(),
            part_um: [0.0, 0.0, 6.4, 4.8],
            size: [400, 300],
            pace: std::time::Duration::ZERO,
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        let picture = AsSeen { request, label: "exposure 7".to_owned(), path: path.clone() };
        keep_picture(&picture, true).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!((reader.info().width, reader.info().height), (800, 600));
        let title = bytes.windows(20).any(|part| part == b"SIMULATED: exposure ");
        assert!(title, "the title says what it is");
        assert!(keep_picture(&picture, true).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "nothing is written over");
    }

    #[test]
    fn what_is_shown_is_what_is_written() {
        let image = Array2::from_shape_fn((12, 16), |(y, x)| (y * 16 + x) as f32);
        let look = SofiLook {
            samples: 100,
            images: vec![StageImage {
                stage: SofiStage::Unmixed,
                name: "dye".to_owned(),
                image: Arc::new(image.clone()),
                pixel_pitch_nm: 54.0,
            }],
            ..SofiLook::default()
        };
        let folder = tempfile::tempdir().unwrap();
        let saved = save_look(&look, true, &folder.path().join("shown")).unwrap();
        let mut stack = ImageStack::open(&saved.join("unmixed.ome.tif")).unwrap();
        let mut page = vec![0.0; 12 * 16];
        assert!(stack.read_values(&mut page).unwrap());
        assert_eq!(page, image.iter().copied().collect::<Vec<f32>>());
        assert!(saved.join("composite.png").exists());
        assert!(save_look(&look, true, &saved).is_err(), "nothing is written over");
    }
}
