//! What is known about a stack once it is open, and memory that fits its frames.
//!
//! In: nothing but the facts. Out: [`StackInfo`], [`FrameBuffer`].
//! Never: reads. Fails: not at all.

use std::time::Duration;

use super::metadata::Dialect;

/// Type of the samples in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    /// Unsigned, 8 bits; read as [`u16`].
    Uint8,
    /// Unsigned, 16 bits.
    Uint16,
    /// IEEE floating point, 32 bits.
    Float32,
}

impl SampleType {
    /// Bytes of one sample in the file.
    pub fn bytes(self) -> usize {
        match self {
            SampleType::Uint8 => 1,
            SampleType::Uint16 => 2,
            SampleType::Float32 => 4,
        }
    }

    /// Name as in NumPy.
    pub fn name(self) -> &'static str {
        match self {
            SampleType::Uint8 => "uint8",
            SampleType::Uint16 => "uint16",
            SampleType::Float32 => "float32",
        }
    }
}

/// Facts about an open stack.
#[derive(Clone, Debug, PartialEq)]
pub struct StackInfo {
    /// Frames of each channel; time points and z positions count alike, in the order of the file.
    pub frames: usize,
    /// Channels, at least 1.
    pub channels: usize,
    /// Rows of a frame, in pixels.
    pub height: usize,
    /// Columns of a frame, in pixels.
    pub width: usize,
    /// Type of the samples in the file.
    pub sample: SampleType,
    /// Which description the file has.
    pub dialect: Dialect,
    /// Names of the channels, one for each, empty where unnamed.
    pub channel_names: Vec<String>,
    /// Width and height of a pixel in the sample, in nanometers, if the file says.
    pub pixel_size_nm: Option<[f64; 2]>,
    /// Time from frame to frame, if the file says.
    pub frame_interval: Option<Duration>,
}

impl StackInfo {
    /// Whether the file says that its frames come from no physical camera.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.channel_names.iter().any(|name| name.contains("simulated"))
    }
}

impl StackInfo {
    /// Memory for one frame, filled with zeros.
    pub fn buffer(&self) -> FrameBuffer {
        let len = self.height * self.width;
        match self.sample {
            SampleType::Uint8 | SampleType::Uint16 => FrameBuffer::Counts(vec![0; len]),
            SampleType::Float32 => FrameBuffer::Values(vec![0.0; len]),
        }
    }
}

/// One frame of either kind, row by row.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameBuffer {
    /// Of a uint8 or uint16 stack.
    Counts(Vec<u16>),
    /// Of a float32 stack.
    Values(Vec<f32>),
}

/// Row and column of the first NaN or infinity in a frame of `width` columns.
pub fn first_not_finite(values: &[f32], width: usize) -> Option<(usize, usize)> {
    let index = values.iter().position(|value| !value.is_finite())?;
    Some((index / width.max(1), index % width.max(1)))
}
