//! Image stacks read frame by frame: TIFF, BigTIFF, OME-TIFF and ImageJ hyperstacks.
//!
//! In: a path, then memory of the caller, one frame at a time. Out: camera counts or float32 values in this computer's byte order.
//! Never: holds more than one row beside the caller's frame, walks the page list twice, scales or inverts values.
//! Fails: [`FileError`] naming file, page and field, before memory is asked for in vain.

mod decompress;
mod directory;
mod info;
mod metadata;
mod open;
mod page;
mod pixels;
mod source;

use std::path::Path;

use self::page::{Geometry, Page};
use self::source::Source;
use super::FileError;

pub use self::info::{FrameBuffer, SampleType, StackInfo, first_not_finite};
pub use self::metadata::Dialect;

/// An open stack of frames of equal size and type.
#[derive(Debug)]
pub struct ImageStack {
    source: Source,
    pages: Pages,
    geometry: Geometry,
    info: StackInfo,
    /// Consecutive pages of one channel before the next channel comes.
    run: usize,
    channel: usize,
    next_frame: usize,
    last_page: usize,
}

/// Where the planes of a stack are.
#[derive(Debug)]
enum Pages {
    /// Each has its own directory.
    Listed(Vec<Page>),
    /// One directory, all pixels in one piece: ImageJ beyond 4 GB.
    Contiguous { first: Page, offset: u64 },
}

impl ImageStack {
    /// Opens a stack and walks its page list once; no pixel is read.
    ///
    /// # Errors
    /// Every [`FileError`] about reading: missing, not a file, not TIFF, damaged or unsupported.
    pub fn open(path: &Path) -> Result<ImageStack, FileError> {
        open::open(path)
    }

    /// Size, type, channels and calibration.
    pub fn info(&self) -> &StackInfo {
        &self.info
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    /// The frame that is read next, from 0; equal to the number of frames at the end.
    pub fn next_frame(&self) -> usize {
        self.next_frame
    }

    /// Chooses the frame that is read next, from 0; the number of frames itself is the end.
    ///
    /// # Errors
    /// [`FileError::OutOfRange`] beyond the end.
    pub fn seek(&mut self, frame: usize) -> Result<(), FileError> {
        if frame > self.info.frames {
            return Err(self.out_of_range("frame", frame, self.info.frames));
        }
        self.next_frame = frame;
        Ok(())
    }

    /// Chooses the channel that is read from now on, from 0; channel 0 at first.
    ///
    /// # Errors
    /// [`FileError::OutOfRange`] when the stack has no such channel.
    pub fn select_channel(&mut self, channel: usize) -> Result<(), FileError> {
        if channel >= self.info.channels {
            return Err(self.out_of_range("channel", channel, self.info.channels));
        }
        self.channel = channel;
        Ok(())
    }

    /// Reads the next frame of an integer stack into `counts`, row by row (`height * width`); 8-bit counts are widened.
    /// Returns `false` after the last frame and leaves `counts` alone then.
    ///
    /// # Errors
    /// [`FileError::WrongBuffer`] when length or type do not fit, [`FileError::Damaged`] and its kin.
    pub fn read_counts(&mut self, counts: &mut [u16]) -> Result<bool, FileError> {
        let is_integer = self.info.sample != SampleType::Float32;
        self.ensure_fits(is_integer, counts.len(), "uint16")?;
        if self.next_frame >= self.info.frames {
            return Ok(false);
        }
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(counts);
        match self.info.sample {
            SampleType::Uint8 => {
                let half = bytes.len() / 2;
                self.read_next(&mut bytes[half..])?;
                widen(bytes);
            }
            _ => self.read_next(bytes)?,
        }
        Ok(true)
    }

    /// Reads the next frame of a float32 stack into `values`, row by row (`height * width`); NaN and infinities pass.
    /// Returns `false` after the last frame and leaves `values` alone then.
    ///
    /// # Errors
    /// As [`read_counts`](ImageStack::read_counts).
    pub fn read_values(&mut self, values: &mut [f32]) -> Result<bool, FileError> {
        let is_float = self.info.sample == SampleType::Float32;
        self.ensure_fits(is_float, values.len(), "float32")?;
        if self.next_frame >= self.info.frames {
            return Ok(false);
        }
        self.read_next(bytemuck::cast_slice_mut(values))?;
        Ok(true)
    }

    /// Reads the next frame into memory made by [`StackInfo::buffer`]; otherwise as the two functions above.
    ///
    /// # Errors
    /// As [`read_counts`](ImageStack::read_counts).
    pub fn read(&mut self, frame: &mut FrameBuffer) -> Result<bool, FileError> {
        match frame {
            FrameBuffer::Counts(counts) => self.read_counts(counts),
            FrameBuffer::Values(values) => self.read_values(values),
        }
    }

    /// Refuses `values`, the frame read last, when one of them is NaN or infinite.
    ///
    /// # Errors
    /// [`FileError::NotFinite`] with page, row and column of the first such pixel.
    pub fn check_finite(&self, values: &[f32]) -> Result<(), FileError> {
        match first_not_finite(values, self.info.width) {
            None => Ok(()),
            Some((y, x)) => Err(FileError::NotFinite {
                path: self.source.path.clone(),
                page: self.last_page + 1,
                y,
                x,
                value: values[y * self.info.width + x],
            }),
        }
    }

    fn read_next(&mut self, frame: &mut [u8]) -> Result<(), FileError> {
        let plane = self.plane(self.next_frame);
        match &self.pages {
            Pages::Listed(pages) => {
                pixels::read_page(&self.source, &pages[plane], self.geometry, frame)?;
            }
            Pages::Contiguous { first, offset } => {
                let offset = offset + plane as u64 * self.geometry.frame_bytes() as u64;
                pixels::read_plain(&self.source, first, self.geometry, offset, frame)?;
            }
        }
        self.last_page = plane;
        self.next_frame += 1;
        Ok(())
    }

    /// Index of the plane that holds `frame` of the chosen channel.
    fn plane(&self, frame: usize) -> usize {
        (frame / self.run * self.info.channels + self.channel) * self.run + frame % self.run
    }

    fn ensure_fits(&self, is_type: bool, len: usize, given: &str) -> Result<(), FileError> {
        let expected = self.info.height * self.info.width;
        if is_type && len == expected {
            return Ok(());
        }
        Err(FileError::WrongBuffer {
            path: self.source.path.clone(),
            expected,
            sample: self.info.sample.name(),
            given: format!("{len} of type {given}"),
        })
    }

    fn out_of_range(&self, noun: &'static str, index: usize, count: usize) -> FileError {
        FileError::OutOfRange { path: self.source.path.clone(), noun, index, count }
    }
}

/// Spreads the bytes in the second half over all as 16-bit numbers; each is read before its place is written.
fn widen(bytes: &mut [u8]) {
    let num_samples = bytes.len() / 2;
    for index in 0..num_samples {
        let count = u16::from(bytes[num_samples + index]);
        bytes[2 * index..2 * index + 2].copy_from_slice(&count.to_ne_bytes());
    }
}
