//! Hamamatsu `.dcimg` files, both layouts.
//!
//! In: a path. Out: frames under the camera's own numbers and times.
//! Never: reads the whole file when it is opened. Fails: [`ReplayError`] with file, frame and field.
//!
//! The format has no public description; these facts are those that the open readers agree upon
//! (`lens-biophotonics/dcimg`, Bio-Formats' `DCIMGReader`, `python-microscopy`). Numbers are little-endian.
//!
//! | file header at 0 | bytes |
//! |---|---|
//! | `DCIMG` | 0..5 |
//! | version: 7 (old layout), `0x1000000`, `0x1050000`, `0x2000000` (new layout) | 8..12 |
//! | frames | 36..40 |
//! | offset `H` of the session header | 40..44 |
//!
//! | session header at `H` | old | new |
//! |---|---|---|
//! | frames | 32..36 | 60..64 |
//! | bytes of a pixel, 1 or 2 | 36..40 | 64..68 |
//! | columns | 44..48 | 72..76 |
//! | bytes of a row | 48..52 | 80..84 |
//! | rows | 52..56 | 76..80 |
//! | bytes of a frame | 56..60 | 84..88 |
//! | offset of the frames from `H` | 68..72 | 96..104 |
//! | offset `F` of the footer from `H` | 72..80 | |
//! | bytes of the footer of each frame | | 124..128 |
//! | first column, columns, first row, rows on the sensor, 16 bit each | | 712..720 |
//!
//! The old layout has the numbers of all frames at 272 in the footer, behind them all times (seconds and
//! microseconds, 32 bit each), and the lost pixels where the second part of the footer says.
//! The new layout has a footer behind each frame: number, seconds, microseconds, 8 bytes of lost pixels.
//!
//! The camera interface overwrites the first 8 bytes of one row of each frame with marks; the lost pixels belong there.

use super::ReplayError;
use super::source::{
    FrameSource, MAX_EXPOSURES, Numbering, Opened, SourceFile, SourceFrame, check_frames, check_read,
    check_size, widen,
};
use sofiscope_hal::{BlockId, DeviceTime, Epoch, ExposureIndex, FrameStatus, HostTime};
use std::path::Path;
use std::time::Duration;

/// How the file begins.
pub(super) const MAGIC: &[u8; 6] = b"DCIMG\0";
const FILE_HEADER_BYTES: usize = 72;
const SESSION_HEADER_BYTES: usize = 128;
const CROP_AT: u64 = 712;
/// Where the numbers of the frames begin in the footer of the old layout.
const STAMPS_AT: u64 = 272;
/// Bytes of a frame that are overwritten.
const LOST_BYTES: usize = 8;
/// The row of the full sensor that is overwritten in the first files of the new layout.
const MARKED_ROW: u64 = 1023;
/// Bytes of one frame's footer in the new layout where it has lost pixels; larger ones have them from 512 bytes on.
const FOOTER_WITH_PIXELS: u64 = 32;

/// Where everything is.
#[derive(Debug, Clone, Copy)]
struct Layout {
    frames: u64,
    height: u64,
    width: u64,
    bytes_per_pixel: u64,
    row_bytes: u64,
    frame_bytes: u64,
    /// Offset of the first frame, and from frame to frame.
    pixels: (u64, u64),
    /// Offset of the first number, and from number to number.
    stamps: (u64, u64),
    /// Offset of the first time, and from time to time.
    times: (u64, u64),
    lost: Option<LostPixels>,
}

/// The pixels that lie elsewhere.
#[derive(Debug, Clone, Copy)]
struct LostPixels {
    row: u64,
    offset: u64,
    stride: u64,
}

#[derive(Debug)]
struct DcimgFrames {
    file: SourceFile,
    layout: Layout,
    /// Memory for rows with padding.
    rows: Vec<u8>,
    first: Stamp,
    last: Stamp,
    is_stamped: bool,
    period_ns: u64,
}

/// Number and time of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    number: u64,
    time_ns: u64,
}

pub(super) fn open(path: &Path, period: Option<Duration>) -> Result<Opened, ReplayError> {
    let file = SourceFile::open(path)?;
    let layout = Layout::read(&file)?;
    let first = layout.stamp(&file, 0)?;
    let last = layout.stamp(&file, layout.frames - 1)?;
    let frames = layout.frames;
    let is_stamped = last.number != first.number;
    let span = if is_stamped { last.number.wrapping_sub(first.number) } else { frames - 1 };
    if span < frames - 1 || span >= MAX_EXPOSURES {
        let detail = format!("{frames} frames have the numbers {} to {}", first.number, last.number);
        return Err(ReplayError::damaged(path, "frame numbers", detail));
    }
    let Some(span_ns) = last.time_ns.checked_sub(first.time_ns) else {
        return Err(ReplayError::damaged(path, "times", "the last frame is earlier than the first"));
    };
    let measured = Duration::from_nanos(span_ns.checked_div(span).unwrap_or(0));
    let known = period.or(Some(measured)
        .filter(|measured| (Duration::from_micros(1)..Duration::from_secs(3600)).contains(measured)));
    let period_ns = known.unwrap_or(super::stack::PERIOD_UNKNOWN).as_nanos() as u64;
    let exposures = if is_stamped { last.number + 1 } else { frames };
    let rows = if layout.row_bytes == layout.width * layout.bytes_per_pixel {
        Vec::new()
    } else {
        vec![0; layout.row_bytes as usize]
    };
    Ok(Opened {
        path: path.to_path_buf(),
        height: layout.height as u32,
        width: layout.width as u32,
        exposures,
        numbering: if is_stamped { Numbering::Stamped(first.number) } else { Numbering::Counted },
        period: known,
        pixel_size_nm: None,
        saturation_counts: if layout.bytes_per_pixel == 1 { 255 } else { u16::MAX },
        simulated: false,
        kind: "dcimg",
        source: Box::new(DcimgFrames { file, layout, rows, first, last, is_stamped, period_ns }),
    })
}

fn short(bytes: &[u8], at: usize) -> u64 {
    u64::from(u16::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte])))
}

fn word(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte])))
}

fn long(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte]))
}

impl Layout {
    fn read(file: &SourceFile) -> Result<Self, ReplayError> {
        let mut header = [0; FILE_HEADER_BYTES];
        file.read(&mut header, 0, "file header")?;
        let (version, session_at) = (word(&header, 8), word(&header, 40));
        let mut session = [0; SESSION_HEADER_BYTES];
        file.read(&mut session, session_at, "session header")?;
        let layout = match version {
            7 => Self::old(file, session_at, &session)?,
            0x100_0000 | 0x105_0000 | 0x200_0000 => Self::new(file, version, session_at, &session)?,
            _ => {
                let remedy = "Export the frames as TIFF";
                return Err(ReplayError::unsupported(
                    file.path.as_path(),
                    "version",
                    format!("{version:#x}"),
                    remedy,
                ));
            }
        };
        layout.check_inside(file)?;
        Ok(layout)
    }

    /// What both layouts have, in other places.
    fn sizes(
        file: &SourceFile,
        [frames, bytes_per_pixel, width, height, row_bytes, frame_bytes]: [u64; 6],
    ) -> Result<Self, ReplayError> {
        check_size(&file.path, "rows and columns", height, width)?;
        check_frames(&file.path, "frames", frames)?;
        if !matches!(bytes_per_pixel, 1 | 2) {
            return Err(ReplayError::damaged(&file.path, "bytes of a pixel", bytes_per_pixel.to_string()));
        }
        if row_bytes < width * bytes_per_pixel || row_bytes > 1 << 20 {
            let detail = format!("{row_bytes} for {width} pixels of {bytes_per_pixel}");
            return Err(ReplayError::damaged(&file.path, "bytes of a row", detail));
        }
        if frame_bytes != row_bytes * height {
            let detail = format!("{frame_bytes} for {height} rows of {row_bytes}");
            return Err(ReplayError::damaged(&file.path, "bytes of a frame", detail));
        }
        let nowhere = (0, 0);
        Ok(Self {
            frames,
            height,
            width,
            bytes_per_pixel,
            row_bytes,
            frame_bytes,
            pixels: nowhere,
            stamps: nowhere,
            times: nowhere,
            lost: None,
        })
    }

    fn old(file: &SourceFile, at: u64, session: &[u8]) -> Result<Self, ReplayError> {
        let places = [32, 36, 44, 52, 48, 56];
        let sizes = Self::sizes(file, places.map(|place| word(session, place)))?;
        let damaged = |field: &str| ReplayError::damaged(&file.path, field, "the offset is beyond any file");
        let footer = at.checked_add(long(session, 72)).ok_or_else(|| damaged("footer"))?;
        let stamps = footer.checked_add(STAMPS_AT).ok_or_else(|| damaged("footer"))?;
        let times = stamps.checked_add(4 * sizes.frames).ok_or_else(|| damaged("footer"))?;
        let mut found = [0; 48];
        file.read(&mut found, footer, "footer")?;
        let second =
            footer.checked_add(long(&found, 8)).ok_or_else(|| damaged("second part of the footer"))?;
        let mut parts = [0; 112];
        file.read(&mut parts, second, "second part of the footer")?;
        let (footer_bytes, lost_at) = (word(&found, 40), long(&parts, 88));
        // The pixels are there when nothing but them is between their offset and the end of the footer.
        let has_lost = lost_at.checked_add(LOST_BYTES as u64 * sizes.frames) == Some(footer_bytes);
        let offset = footer.checked_add(lost_at).filter(|_| has_lost);
        let lost = offset.map(|offset| LostPixels {
            row: word(&parts, 100) / sizes.row_bytes,
            offset,
            stride: LOST_BYTES as u64,
        });
        Ok(Self {
            pixels: (at + word(session, 68), sizes.frame_bytes),
            stamps: (stamps, 4),
            times: (times, 8),
            lost,
            ..sizes
        }
        .with_lost_inside())
    }

    fn new(file: &SourceFile, version: u64, at: u64, session: &[u8]) -> Result<Self, ReplayError> {
        let places = [60, 64, 72, 76, 80, 84];
        let sizes = Self::sizes(file, places.map(|place| word(session, place)))?;
        let first = at.checked_add(long(session, 96)).filter(|first| *first <= file.length);
        let Some(first) = first else {
            return Err(ReplayError::damaged(
                &file.path,
                "offset of the frames",
                "it is beyond the end of the file",
            ));
        };
        let footer_bytes = word(session, 124);
        if footer_bytes < 12 {
            let detail = format!("{footer_bytes} where number and time take 12");
            return Err(ReplayError::damaged(&file.path, "bytes of a frame's footer", detail));
        }
        let stride = sizes.frame_bytes + footer_bytes;
        let footer = first + sizes.frame_bytes;
        let row = if version == 0x200_0000 { Some(0) } else { Self::marked_row(file, at, sizes)? };
        let has_lost = footer_bytes == FOOTER_WITH_PIXELS || footer_bytes >= 512;
        let lost = row.filter(|_| has_lost).map(|row| LostPixels { row, offset: footer + 12, stride });
        Ok(Self {
            pixels: (first, stride),
            stamps: (footer, stride),
            times: (footer + 4, stride),
            lost,
            ..sizes
        }
        .with_lost_inside())
    }

    /// The row of the frame that is row 1023 of the sensor, if it was read.
    fn marked_row(file: &SourceFile, at: u64, sizes: Self) -> Result<Option<u64>, ReplayError> {
        let mut crop = [0; 8];
        file.read(&mut crop, at.saturating_add(CROP_AT), "region on the sensor")?;
        let [_, columns, top, rows] = [0, 2, 4, 6].map(|place| short(&crop, place));
        let binning = [columns / sizes.width, rows / sizes.height];
        if binning[0] != binning[1] {
            let detail = format!("{} x {} pixels as {} x {}", rows, columns, sizes.height, sizes.width);
            return Err(ReplayError::damaged(&file.path, "region on the sensor", detail));
        }
        Ok(MARKED_ROW.checked_sub(top).map(|row| row / binning[0].max(1)))
    }

    /// Leaves lost pixels out that belong to no row of the frame.
    fn with_lost_inside(mut self) -> Self {
        let fits =
            self.row_bytes >= LOST_BYTES as u64 && self.width * self.bytes_per_pixel >= LOST_BYTES as u64;
        self.lost = self.lost.filter(|lost| lost.row < self.height && fits);
        self
    }

    /// Proves that every frame and all that belongs to it is in the file.
    fn check_inside(&self, file: &SourceFile) -> Result<(), ReplayError> {
        let last = self.frames - 1;
        let sections = [
            ("frames", self.pixels, self.frame_bytes),
            ("frame numbers", self.stamps, 4),
            ("times", self.times, 8),
            ("lost pixels", self.lost.map_or((0, 0), |lost| (lost.offset, lost.stride)), LOST_BYTES as u64),
        ];
        for (field, (offset, stride), bytes) in sections {
            let end = stride.checked_mul(last).and_then(|ahead| offset.checked_add(ahead));
            file.check_inside(end.unwrap_or(u64::MAX), bytes, field)?;
        }
        Ok(())
    }

    fn stamp(&self, file: &SourceFile, frame: u64) -> Result<Stamp, ReplayError> {
        let (mut number, mut time) = ([0; 4], [0; 8]);
        file.read(&mut number, self.stamps.0 + frame * self.stamps.1, "frame numbers")?;
        file.read(&mut time, self.times.0 + frame * self.times.1, "times")?;
        let (seconds, microseconds) = (word(&time, 0), word(&time, 4));
        if microseconds >= 1_000_000 {
            let detail = format!("{microseconds} microseconds in a second");
            return Err(ReplayError::damaged(&file.path, format!("frame {frame}, time"), detail));
        }
        let time_ns = seconds * 1_000_000_000 + microseconds * 1000;
        Ok(Stamp { number: word(&number, 0), time_ns })
    }
}

impl DcimgFrames {
    /// Refuses a number that is not above that of the frame before.
    fn check_rise(&self, frame: u64, number: u64) -> Result<(), ReplayError> {
        let Some(before) = frame.checked_sub(1) else { return Ok(()) };
        let earlier = self.layout.stamp(&self.file, before)?.number;
        if earlier < number {
            return Ok(());
        }
        let detail = format!("{number} after {earlier}");
        Err(ReplayError::damaged(&self.file.path, format!("frame {frame}, number"), detail))
    }
}

impl FrameSource for DcimgFrames {
    fn frames(&self) -> u64 {
        self.layout.frames
    }

    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError> {
        check_read(&self.file.path, (frame, self.layout.frames), (0, 0))?;
        let stamp = self.layout.stamp(&self.file, frame)?;
        let last = self.layout.frames - 1;
        let (number, first, last) = if self.is_stamped {
            self.check_rise(frame, stamp.number)?;
            (stamp.number, self.first.number, self.last.number)
        } else {
            (frame, 0, last)
        };
        // Numbers that rise leave room for the frames before and behind.
        if number < first + frame || number + (self.layout.frames - 1 - frame) > last {
            let detail = format!("{number} where the numbers rise from {first} to {last}");
            return Err(ReplayError::damaged(&self.file.path, format!("frame {frame}, number"), detail));
        }
        let since_ns = stamp.time_ns.saturating_sub(self.first.time_ns);
        // Cameras of one start have one beginning, whichever frame came first.
        let begin_ns = first.saturating_mul(self.period_ns);
        Ok(SourceFrame {
            exposure: ExposureIndex(number),
            block_id: BlockId(stamp.number),
            epoch: Epoch(0),
            device_time: DeviceTime(stamp.time_ns),
            received: HostTime(begin_ns.saturating_add(since_ns)),
            status: FrameStatus::Complete,
        })
    }

    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError> {
        let layout = self.layout;
        let expected = (layout.width * layout.height) as usize;
        check_read(&self.file.path, (frame, layout.frames), (counts.len(), expected))?;
        let offset = layout.pixels.0 + frame * layout.pixels.1;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(counts);
        let begin = if layout.bytes_per_pixel == 1 { bytes.len() / 2 } else { 0 };
        let pixels = &mut bytes[begin..];
        let packed = (layout.width * layout.bytes_per_pixel) as usize;
        if self.rows.is_empty() {
            self.file.read(pixels, offset, "pixels")?;
        } else {
            for (row, pixels) in (0..).zip(pixels.chunks_exact_mut(packed)) {
                self.file.read(&mut self.rows, offset + row * layout.row_bytes, "pixels")?;
                pixels.copy_from_slice(&self.rows[..packed]);
            }
        }
        if let Some(lost) = layout.lost {
            let at = lost.row as usize * packed;
            let place = &mut pixels[at..at + LOST_BYTES];
            self.file.read(place, lost.offset + frame * lost.stride, "lost pixels")?;
        }
        if layout.bytes_per_pixel == 1 {
            widen(bytes);
        } else {
            counts.iter_mut().for_each(|count| *count = u16::from_le(*count));
        }
        Ok(())
    }
}
