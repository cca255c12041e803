//! The ledger: one row per exposure of each camera, as text.
//!
//! In: rows. Out: lines of comma-separated values and back.
//! Never: repairs a line; a torn last line is the reader's to drop. Fails: [`LedgerError`] with the field.

use super::Loss;
use sofiscope_hal::{BlockId, Channel, DeviceTime, Epoch, ExposureIndex, HostTime};

/// What the recording has of an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowState {
    /// The frame is in the file.
    Recorded {
        /// Place among the recorded frames of this camera, from 0.
        page: u64,
        /// CRC-32C of its pixels as they lie in the file (little-endian).
        crc32c: u32,
    },
    /// The frame was received, but nothing is recorded in this run.
    Unrecorded,
    /// There is no frame.
    Lost(Loss),
}

/// Whether both cameras' frames make a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairState {
    /// Both frames are there and their times agree.
    Paired,
    /// They do not make a pair.
    Not(Loss),
}

/// What the live analysis has of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Analysis {
    /// The pair was analyzed.
    Analyzed,
    /// The pair was left out, and why.
    LeftOut(Loss),
    /// There was no pair to analyze, or no analysis in this run.
    None,
}

/// One line of the ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LedgerRow {
    /// The exposure.
    pub exposure: ExposureIndex,
    /// The camera.
    pub channel: Channel,
    /// What the recording has.
    pub state: RowState,
    /// The camera's own counter and epoch, if the frame came.
    pub id: Option<(BlockId, Epoch)>,
    /// Begin of the exposure on the camera's clock, if the frame came.
    pub device_time: Option<DeviceTime>,
    /// When the frame was received.
    pub host_time: Option<HostTime>,
    /// Whether it is part of a pair.
    pub pair: PairState,
    /// What the live analysis has.
    pub analysis: Analysis,
}

/// Why a line is no row.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LedgerError {
    /// A line with more or fewer fields.
    #[error("{found} fields where a row has {}", LedgerRow::COLUMNS.len())]
    Fields {
        /// Fields found.
        found: usize,
    },
    /// A field with a value that it cannot have.
    #[error("{column}: {text:?} cannot be read")]
    Field {
        /// The column.
        column: &'static str,
        /// What stands there.
        text: String,
    },
}

impl LedgerRow {
    /// Names of the columns, in order.
    pub const COLUMNS: [&'static str; 12] = [
        "exposure",
        "camera",
        "state",
        "reason",
        "page",
        "crc32c",
        "block_id",
        "epoch",
        "device_time_ns",
        "host_time_ns",
        "pair",
        "analysis",
    ];

    /// The first line of a ledger, without line end.
    #[must_use]
    pub fn header() -> String {
        Self::COLUMNS.join(",")
    }

    /// Appends the row as one line, with line end.
    pub fn write_to(&self, line: &mut String) {
        use std::fmt::Write;
        let (state, reason, page, crc) = match self.state {
            RowState::Recorded { page, crc32c } => ("recorded", None, Some(page), Some(crc32c)),
            RowState::Unrecorded => ("unrecorded", None, None, None),
            RowState::Lost(loss) => ("lost", Some(loss), None, None),
        };
        let pair = match self.pair {
            PairState::Paired => "paired",
            PairState::Not(loss) => loss.name(),
        };
        let analysis = match self.analysis {
            Analysis::Analyzed => "analyzed",
            Analysis::LeftOut(loss) => loss.name(),
            Analysis::None => "",
        };
        let _ = writeln!(
            line,
            "{},{},{state},{},{},{},{},{},{},{},{pair},{analysis}",
            self.exposure.0,
            self.channel.letter(),
            Shown(reason),
            Shown(page),
            Shown(crc.map(Hexadecimal)),
            Shown(self.id.map(|(id, _)| id.0)),
            Shown(self.id.map(|(_, epoch)| epoch.0)),
            Shown(self.device_time.map(|time| time.0)),
            Shown(self.host_time.map(|time| time.0)),
        );
    }

    /// Reads one line without its line end.
    ///
    /// # Errors
    /// [`LedgerError`] with the field that cannot be read.
    pub fn parse(line: &str) -> Result<Self, LedgerError> {
        let fields: Vec<&str> = line.split(',').collect();
        let found = fields.len();
        let fields: [&str; 12] = fields.try_into().map_err(|_| LedgerError::Fields { found })?;
        let at = |column: usize| Field { column: Self::COLUMNS[column], text: fields[column] };
        let state = match fields[2] {
            "recorded" => RowState::Recorded { page: at(4).number()?, crc32c: at(5).hexadecimal()? },
            "unrecorded" => RowState::Unrecorded,
            "lost" => RowState::Lost(at(3).loss()?),
            _ => return Err(at(2).error()),
        };
        let channel = match fields[1] {
            "R" => Channel::Reflected,
            "T" => Channel::Transmitted,
            _ => return Err(at(1).error()),
        };
        let id = at(6).optional(Field::number)?.zip(at(7).optional(Field::number)?);
        Ok(Self {
            exposure: ExposureIndex(at(0).number()?),
            channel,
            state,
            id: id.map(|(id, epoch)| (BlockId(id), Epoch(epoch))),
            device_time: at(8).optional(Field::number)?.map(DeviceTime),
            host_time: at(9).optional(Field::number)?.map(HostTime),
            pair: if fields[10] == "paired" { PairState::Paired } else { PairState::Not(at(10).loss()?) },
            analysis: match fields[11] {
                "analyzed" => Analysis::Analyzed,
                "" => Analysis::None,
                _ => Analysis::LeftOut(at(11).loss()?),
            },
        })
    }
}

/// A value, or nothing between two commas.
struct Shown<T>(Option<T>);

impl<T: std::fmt::Display> std::fmt::Display for Shown<T> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.as_ref().map_or(Ok(()), |value| value.fmt(formatter))
    }
}

struct Hexadecimal(u32);

impl std::fmt::Display for Hexadecimal {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{:08x}", self.0)
    }
}

/// One field of a line.
#[derive(Clone, Copy)]
struct Field<'a> {
    column: &'static str,
    text: &'a str,
}

impl Field<'_> {
    fn error(self) -> LedgerError {
        LedgerError::Field { column: self.column, text: self.text.chars().take(40).collect() }
    }

    fn number<N: std::str::FromStr>(self) -> Result<N, LedgerError> {
        self.text.parse().map_err(|_| self.error())
    }

    fn hexadecimal(self) -> Result<u32, LedgerError> {
        u32::from_str_radix(self.text, 16).map_err(|_| self.error())
    }

    fn loss(self) -> Result<Loss, LedgerError> {
        Loss::named(self.text).ok_or_else(|| self.error())
    }

    fn optional<N>(self, read: impl Fn(Self) -> Result<N, LedgerError>) -> Result<Option<N>, LedgerError> {
        if self.text.is_empty() { Ok(None) } else { read(self).map(Some) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> [LedgerRow; 3] {
        let recorded = LedgerRow {
            exposure: ExposureIndex(17),
            channel: Channel::Transmitted,
            state: RowState::Recorded { page: 16, crc32c: 0x00ab_cdef },
            id: Some((BlockId(65_417), Epoch(1))),
            device_time: Some(DeviceTime(340_000_000)),
            host_time: Some(HostTime(341_000_000)),
            pair: PairState::Paired,
            analysis: Analysis::Analyzed,
        };
        let lost = LedgerRow {
            state: RowState::Lost(Loss::UpstreamGap),
            id: None,
            device_time: None,
            host_time: None,
            pair: PairState::Not(Loss::Unpaired),
            analysis: Analysis::None,
            ..recorded
        };
        let shed = LedgerRow {
            channel: Channel::Reflected,
            state: RowState::Unrecorded,
            analysis: Analysis::LeftOut(Loss::ShedByPolicy),
            ..recorded
        };
        [recorded, lost, shed]
    }

    #[test]
    fn rows_are_read_back() {
        for row in rows() {
            let mut line = String::new();
            row.write_to(&mut line);
            assert_eq!(LedgerRow::parse(line.trim_end_matches('\n')), Ok(row), "{line}");
        }
    }

    #[test]
    fn a_torn_or_damaged_line_names_its_field() {
        let mut line = String::new();
        rows()[0].write_to(&mut line);
        assert_eq!(line, "17,T,recorded,,16,00abcdef,65417,1,340000000,341000000,paired,analyzed\n");
        assert_eq!(LedgerRow::parse("17,T,rec"), Err(LedgerError::Fields { found: 3 }));
        let said = LedgerRow::parse(&line.trim().replace("recorded", "eaten")).unwrap_err().to_string();
        assert_eq!(said, "state: \"eaten\" cannot be read");
    }
}
