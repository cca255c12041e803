//! What instrument and window say to each other: messages, and pixels behind them.
//!
//! ```text
//! message  = length of the text (4 bytes) + text (postcard)
//! Look     = message + pixels of every picture that it announces, in its order
//! ```
//!
//! Both are the same program on the same computer, so that numbers are in its own order of bytes and there are no
//! versions. The window asks, the instrument answers: nothing waits for a window that does not ask.
//!
//! In: the statuses and pictures of a bench. Out: the same in another process, bit for bit.
//! Never: sends a picture twice. Fails: [`Error`] when the other side is gone.

use crate::reconstruction::{CameraLook, OneCamera, PixelMap, SofiLook, SofiStage, StageImage};
use crate::viewer::bench::{BenchCommand, BenchStatus, Gravity, Pictures, PlanEstimate};
use bytemuck::Pod;
use ndarray::Array2;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{Error, Read, Result, Write};
use std::sync::Arc;

/// What the window says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum FromWindow {
    /// How do things stand? Answered by a [`Look`].
    Look,
    /// Something is wanted.
    Ask(BenchCommand),
    /// What is to be said of a plan? Answered by [`Judged`].
    Judge(String),
    /// People are to know something.
    Tell(Gravity, String),
    /// The person has closed the window.
    Closed,
    /// There is no window to be had: why.
    Failed(String),
}

/// The answer to [`FromWindow::Judge`].
pub(super) type Judged = std::result::Result<PlanEstimate, String>;

/// How things stand.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Look {
    pub(super) status: Option<BenchStatus>,
    /// Whether no hardware is behind the pictures.
    pub(super) is_simulated: bool,
    cameras: News<CamerasOutline>,
    sofi: News<SofiOutline>,
}

/// What became of a picture since the last look.
#[derive(Debug, Default, Serialize, Deserialize)]
enum News<T> {
    #[default]
    Same,
    Gone,
    New(T),
}

#[derive(Debug, Serialize, Deserialize)]
struct CamerasOutline {
    exposure: u64,
    width: usize,
    height: usize,
    cameras: [CameraOutline; 2],
    pixel_pitch_nm: f64,
    transmitted_from_reflected: Option<PixelMap>,
}

#[derive(Debug, Serialize, Deserialize)]
struct CameraOutline {
    pixels: usize,
    histogram: Arc<Vec<u32>>,
    bin_counts: u32,
    saturated: u64,
    range: (u16, f64, u16),
    saturation_counts: u16,
}

#[derive(Debug, Serialize, Deserialize)]
struct SofiOutline {
    samples: u64,
    open_samples: u64,
    label: String,
    images: Vec<ImageOutline>,
    trouble: Option<String>,
}

#[derive(Debug, Serialize, Deserialize)]
struct ImageOutline {
    stage: SofiStage,
    name: String,
    /// Rows and columns.
    size: (usize, usize),
    pixel_pitch_nm: f64,
}

/// Sends one message.
///
/// # Errors
/// What the system says when the other side is gone.
pub(super) fn send(to: &mut impl Write, message: &impl Serialize) -> Result<()> {
    let mut text = vec![0; size_of::<u32>()];
    postcard::to_io(message, &mut text).map_err(Error::other)?;
    let length = u32::try_from(text.len() - size_of::<u32>()).map_err(Error::other)?;
    text[..size_of::<u32>()].copy_from_slice(&length.to_ne_bytes());
    to.write_all(&text)
}

/// Waits for one message.
///
/// # Errors
/// What the system says when the other side is gone; a message that is none.
pub(super) fn receive<T: DeserializeOwned>(from: &mut impl Read) -> Result<T> {
    let mut length = [0; size_of::<u32>()];
    from.read_exact(&mut length)?;
    let mut text = vec![0; u32::from_ne_bytes(length) as usize];
    from.read_exact(&mut text)?;
    postcard::from_bytes(&text).map_err(Error::other)
}

/// What the other side has of how things stand.
#[derive(Debug, Default)]
pub(super) struct Known {
    status: Option<Arc<BenchStatus>>,
    pictures: Pictures,
}

impl Known {
    /// Sends what the other side does not have yet.
    ///
    /// # Errors
    /// What the system says when the other side is gone.
    pub(super) fn send(
        &mut self,
        to: &mut impl Write,
        (status, is_simulated): (Arc<BenchStatus>, bool),
        pictures: Pictures,
    ) -> Result<()> {
        let news = self.status.as_deref() != Some(status.as_ref());
        let look = Look {
            status: news.then(|| status.as_ref().clone()),
            is_simulated,
            cameras: since(self.pictures.cameras.as_ref(), pictures.cameras.as_ref(), cameras_outline),
            sofi: since(self.pictures.sofi.as_ref(), pictures.sofi.as_ref(), sofi_outline),
        };
        send(to, &look)?;
        if let (News::New(_), Some(cameras)) = (&look.cameras, &pictures.cameras) {
            for camera in &cameras.cameras {
                to.write_all(bytemuck::cast_slice(&camera.counts))?;
            }
        }
        if let (News::New(_), Some(sofi)) = (&look.sofi, &pictures.sofi) {
            for image in &sofi.images {
                let rows = image.image.as_standard_layout();
                to.write_all(bytemuck::cast_slice(rows.as_slice().unwrap_or_default()))?;
            }
        }
        (self.status, self.pictures) = (Some(status), pictures);
        Ok(())
    }

    /// Waits for what is not here yet; pictures that are the same stay the same `Arc`s.
    ///
    /// # Errors
    /// What the system says when the other side is gone; a message that is none.
    pub(super) fn receive(&mut self, from: &mut impl Read) -> Result<(Arc<BenchStatus>, bool, Pictures)> {
        let look: Look = receive(from)?;
        if let Some(status) = look.status {
            self.status = Some(Arc::new(status));
        }
        match look.cameras {
            News::Same => {}
            News::Gone => self.pictures.cameras = None,
            News::New(outline) => self.pictures.cameras = Some(Arc::new(cameras(outline, from)?)),
        }
        match look.sofi {
            News::Same => {}
            News::Gone => self.pictures.sofi = None,
            News::New(outline) => self.pictures.sofi = Some(Arc::new(sofi(outline, from)?)),
        }
        Ok((self.status.clone().unwrap_or_default(), look.is_simulated, self.pictures.clone()))
    }
}

fn since<T, O>(before: Option<&Arc<T>>, now: Option<&Arc<T>>, outline: impl Fn(&T) -> O) -> News<O> {
    match (before, now) {
        (None, None) => News::Same,
        (Some(before), Some(now)) if Arc::ptr_eq(before, now) => News::Same,
        (_, None) => News::Gone,
        (_, Some(now)) => News::New(outline(now)),
    }
}

fn cameras_outline(look: &CameraLook) -> CamerasOutline {
    CamerasOutline {
        exposure: look.exposure,
        width: look.width,
        height: look.height,
        cameras: look.cameras.each_ref().map(|camera| CameraOutline {
            pixels: camera.counts.len(),
            histogram: Arc::clone(&camera.histogram),
            bin_counts: camera.bin_counts,
            saturated: camera.saturated,
            range: camera.range,
            saturation_counts: camera.saturation_counts,
        }),
        pixel_pitch_nm: look.pixel_pitch_nm,
        transmitted_from_reflected: look.transmitted_from_reflected,
    }
}

fn cameras(outline: CamerasOutline, from: &mut impl Read) -> Result<CameraLook> {
    let mut camera = |outline: CameraOutline| -> Result<OneCamera> {
        Ok(OneCamera {
            counts: Arc::new(numbers(outline.pixels, from)?),
            histogram: outline.histogram,
            bin_counts: outline.bin_counts,
            saturated: outline.saturated,
            range: outline.range,
            saturation_counts: outline.saturation_counts,
        })
    };
    let [reflected, transmitted] = outline.cameras;
    Ok(CameraLook {
        exposure: outline.exposure,
        width: outline.width,
        height: outline.height,
        cameras: [camera(reflected)?, camera(transmitted)?],
        pixel_pitch_nm: outline.pixel_pitch_nm,
        transmitted_from_reflected: outline.transmitted_from_reflected,
    })
}

fn sofi_outline(look: &SofiLook) -> SofiOutline {
    let outline = |image: &StageImage| ImageOutline {
        stage: image.stage,
        name: image.name.clone(),
        size: image.image.dim(),
        pixel_pitch_nm: image.pixel_pitch_nm,
    };
    SofiOutline {
        samples: look.samples,
        open_samples: look.open_samples,
        label: look.label.clone(),
        images: look.images.iter().map(outline).collect(),
        trouble: look.trouble.clone(),
    }
}

fn sofi(outline: SofiOutline, from: &mut impl Read) -> Result<SofiLook> {
    let image = |ImageOutline { stage, name, size, pixel_pitch_nm }: ImageOutline| {
        let image = Array2::from_shape_vec(size, numbers(size.0 * size.1, from)?).map_err(Error::other)?;
        Ok(StageImage { stage, name, image: Arc::new(image), pixel_pitch_nm })
    };
    Ok(SofiLook {
        samples: outline.samples,
        open_samples: outline.open_samples,
        label: outline.label,
        images: outline.images.into_iter().map(image).collect::<Result<_>>()?,
        trouble: outline.trouble,
    })
}

fn numbers<T: Pod>(number: usize, from: &mut impl Read) -> Result<Vec<T>> {
    let mut numbers = vec![T::zeroed(); number];
    from.read_exact(bytemuck::cast_slice_mut(&mut numbers))?;
    Ok(numbers)
}
