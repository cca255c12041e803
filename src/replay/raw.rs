//! Bare pixels with a header beside them: `name.toml` says what is in `name.raw`.
//!
//! In: either path. Out: frame `k` as exposure `k`. Never: guesses what the header does not say.
//! Fails: [`ReplayError::Header`] with every fault of the header at once.
//!
//! | key | holds |
//! |---|---|
//! | `width`, `height` | pixels of a frame |
//! | `frames` | frames in the file |
//! | `bits` | 8 or 16, bits of a count in the file |
//! | `byte_order` | `"little"` or `"big"`; needed for 16 bits |
//! | `offset_bytes` | bytes before the first frame; 0 if absent |
//! | `period_ms` | time from frame to frame in ms; optional |
//! | `pixel_size_nm` | side of a pixel in the sample in nm; optional |

use super::ReplayError;
use super::source::{
    FrameSource, MAX_EXPOSURES, MAX_PIXELS, MAX_SIDE, Numbering, Opened, SourceFile, SourceFrame, check_read,
    widen,
};
use super::stack::{Even, PERIOD_UNKNOWN};
use std::path::Path;
use std::time::Duration;
use toml::{Table, Value};

const KEYS: [&str; 8] =
    ["width", "height", "frames", "bits", "byte_order", "offset_bytes", "period_ms", "pixel_size_nm"];
const MAX_HEADER_BYTES: u64 = 64 << 10;

/// Size of a count in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sample {
    Byte,
    Little,
    Big,
}

#[derive(Debug, Clone, Copy)]
struct Header {
    width: u64,
    height: u64,
    frames: u64,
    offset: u64,
    sample: Sample,
    period: Option<Duration>,
    pixel_size_nm: Option<f64>,
}

#[derive(Debug)]
struct RawFrames {
    file: SourceFile,
    header: Header,
    even: Even,
}

/// Opens pixels and header; `path` is either.
pub(super) fn open(path: &Path, period: Option<Duration>) -> Result<Opened, ReplayError> {
    let header_path = path.with_extension("toml");
    let text = SourceFile::open(&header_path)?.text(MAX_HEADER_BYTES)?;
    let header =
        Header::parse(&text).map_err(|faults| ReplayError::Header { path: header_path.clone(), faults })?;
    let file = SourceFile::open(&path.with_extension("raw"))?;
    let held = file.length.saturating_sub(header.offset) / header.frame_bytes();
    if held < header.frames {
        let detail = format!("{} where {} holds {held}", header.frames, file.path.display());
        return Err(ReplayError::damaged(&header_path, "frames", detail));
    }
    let known = period.or(header.period);
    let even = Even { period: known.unwrap_or(PERIOD_UNKNOWN) };
    Ok(Opened {
        path: file.path.clone(),
        height: header.height as u32,
        width: header.width as u32,
        exposures: header.frames,
        numbering: Numbering::Counted,
        period: known,
        pixel_size_nm: header.pixel_size_nm,
        saturation_counts: if header.sample == Sample::Byte { 255 } else { u16::MAX },
        simulated: false,
        kind: "raw",
        source: Box::new(RawFrames { file, header, even }),
    })
}

impl Header {
    fn frame_bytes(&self) -> u64 {
        let bytes = if self.sample == Sample::Byte { 1 } else { 2 };
        self.width * self.height * bytes
    }

    /// Reads a header, or says all that is wrong with it.
    fn parse(text: &str) -> Result<Self, Vec<String>> {
        let table: Table = text.parse().map_err(|error: toml::de::Error| {
            vec![error.to_string().trim().lines().collect::<Vec<_>>().join(" ")]
        })?;
        let mut faults = Vec::new();
        for key in table.keys().filter(|key| !KEYS.contains(&key.as_str())) {
            let known = KEYS.join("`, `");
            faults.push(format!("`{}` is no key; the keys are `{known}`", key.escape_debug()));
        }
        let side = 1..=MAX_SIDE as i64;
        let width = integer(&table, "width", side.clone(), None, &mut faults);
        let height = integer(&table, "height", side, None, &mut faults);
        let frames = integer(&table, "frames", 1..=MAX_EXPOSURES as i64, None, &mut faults);
        let offset = integer(&table, "offset_bytes", 0..=1 << 40, Some(0), &mut faults);
        let bits = integer(&table, "bits", 8..=16, None, &mut faults);
        let sample = match (bits, table.get("byte_order").map(Value::as_str)) {
            (8, None | Some(Some("little" | "big"))) => Sample::Byte,
            (_, Some(Some("little"))) => Sample::Little,
            (_, Some(Some("big"))) => Sample::Big,
            _ => {
                faults.push("`byte_order` must be \"little\" or \"big\"".to_owned());
                Sample::Little
            }
        };
        if bits != 8 && bits != 16 && bits != 0 {
            faults.push(format!("`bits` is {bits}; it must be 8 or 16"));
        }
        if width * height > MAX_PIXELS {
            faults.push(format!("`width` x `height` is more than {MAX_PIXELS} pixels"));
        }
        let period_ms = number(&table, "period_ms", 1e-3..=3.6e6, &mut faults);
        let pixel_size_nm = number(&table, "pixel_size_nm", 1e-3..=1e9, &mut faults);
        if !faults.is_empty() {
            return Err(faults);
        }
        let period = period_ms.map(|period_ms| Duration::from_secs_f64(period_ms * 1e-3));
        Ok(Self { width, height, frames, offset, sample, period, pixel_size_nm })
    }
}

/// An integer within limits; 0 and a fault otherwise.
fn integer(
    table: &Table,
    key: &str,
    limits: std::ops::RangeInclusive<i64>,
    absent: Option<u64>,
    faults: &mut Vec<String>,
) -> u64 {
    match (table.get(key), absent) {
        (None, Some(absent)) => absent,
        (None, None) => {
            faults.push(format!("`{key}` is missing"));
            0
        }
        (Some(Value::Integer(value)), _) if limits.contains(value) => value.unsigned_abs(),
        (Some(Value::Integer(value)), _) => {
            faults.push(format!("`{key}` is {value}; it must be {} to {}", limits.start(), limits.end()));
            0
        }
        (Some(value), _) => {
            faults.push(format!("`{key}` is a {}; it must be a whole number", value.type_str()));
            0
        }
    }
}

/// A number within limits, if there is one.
fn number(
    table: &Table,
    key: &str,
    limits: std::ops::RangeInclusive<f64>,
    faults: &mut Vec<String>,
) -> Option<f64> {
    let value = table.get(key)?;
    let number = value.as_float().or(value.as_integer().map(|whole| whole as f64));
    if number.is_none_or(|number| !limits.contains(&number)) {
        let shown = number.map_or(format!("a {}", value.type_str()), |number| number.to_string());
        faults.push(format!("`{key}` is {shown}; it must be {} to {}", limits.start(), limits.end()));
    }
    number
}

impl FrameSource for RawFrames {
    fn frames(&self) -> u64 {
        self.header.frames
    }

    fn frame(&mut self, frame: u64) -> Result<SourceFrame, ReplayError> {
        Ok(self.even.frame(frame))
    }

    fn read(&mut self, frame: u64, counts: &mut [u16]) -> Result<(), ReplayError> {
        let Header { width, height, frames, offset, sample, .. } = self.header;
        check_read(&self.file.path, (frame, frames), (counts.len(), (width * height) as usize))?;
        let offset = offset + frame * self.header.frame_bytes();
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(counts);
        match sample {
            Sample::Byte => {
                let half = bytes.len() / 2;
                self.file.read(&mut bytes[half..], offset, "pixels")?;
                widen(bytes);
            }
            Sample::Little | Sample::Big => {
                self.file.read(bytes, offset, "pixels")?;
                for count in counts {
                    *count = if sample == Sample::Big { u16::from_be(*count) } else { u16::from_le(*count) };
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_of_a_header_is_said_at_once() {
        let text = "width = 0\nheight = 1e3\nframes = -1\nbits = 12\nperiod_ms = nan\ncolour = 1\noffset_bytes = '2'";
        let faults = Header::parse(text).unwrap_err();
        for key in [
            "`width`",
            "`height`",
            "`frames`",
            "`bits`",
            "`period_ms`",
            "`colour`",
            "`offset_bytes`",
            "`byte_order`",
        ] {
            assert!(faults.iter().any(|fault| fault.starts_with(key)), "{key}: {faults:?}");
        }
        assert_eq!(faults.len(), 8, "{faults:?}");
        assert!(Header::parse("width = ").unwrap_err()[0].contains("line 1"));
    }

    #[test]
    fn a_header_of_bytes_needs_no_byte_order() {
        let header = Header::parse("width = 3\nheight = 2\nframes = 1\nbits = 8\nperiod_ms = 20").unwrap();
        assert_eq!((header.sample, header.offset, header.frame_bytes()), (Sample::Byte, 0, 6));
        assert_eq!(header.period, Some(Duration::from_millis(20)));
    }
}
