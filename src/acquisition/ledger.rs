//! The ledger: one row per exposure of each camera, as text.
//!
//! In: rows. Out: lines of comma-separated values and back.
//! Never: repairs a line; a torn last line is the reader's to drop. Fails: [`LedgerError`] with the field.

use super::{Conditions, Light, Loss};
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
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// What surrounded the frame, if it came.
    pub conditions: Conditions,
}

/// The columns of one ledger, told by its header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LedgerColumns(usize);

/// Why a line is no row.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LedgerError {
    /// A line with more or fewer fields.
    #[error("{found} fields where a row has {expected}")]
    Fields {
        /// Fields of a row.
        expected: usize,
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
    pub const COLUMNS: [&'static str; 16] = [
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
        "focus_nm",
        "x_um",
        "y_um",
        "light",
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
            "{},{},{state},{},{},{},{},{},{},{},{pair},{analysis},{},{},{},{}",
            self.exposure.0,
            self.channel.letter(),
            Shown(reason),
            Shown(page),
            Shown(crc.map(Hexadecimal)),
            Shown(self.id.map(|(id, _)| id.0)),
            Shown(self.id.map(|(_, epoch)| epoch.0)),
            Shown(self.device_time.map(|time| time.0)),
            Shown(self.host_time.map(|time| time.0)),
            Shown(self.conditions.focus_nm),
            Shown(self.conditions.x_um),
            Shown(self.conditions.y_um),
            self.conditions.light,
        );
    }

    /// Reads one line with all columns, without its line end.
    ///
    /// # Errors
    /// [`LedgerError`] with the field that cannot be read.
    pub fn parse(line: &str) -> Result<Self, LedgerError> {
        LedgerColumns::default().parse(line)
    }

    fn of_fields(fields: &[&str; 16]) -> Result<Self, LedgerError> {
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
            conditions: Conditions {
                focus_nm: at(12).optional(Field::finite)?,
                x_um: at(13).optional(Field::finite)?,
                y_um: at(14).optional(Field::finite)?,
                light: Light::parse(fields[15]).ok_or_else(|| at(15).error())?,
            },
        })
    }
}

/// Those that this program writes.
impl Default for LedgerColumns {
    fn default() -> Self {
        Self(LedgerRow::COLUMNS.len())
    }
}

impl LedgerColumns {
    /// Columns of ledgers that were written before conditions were: the others are empty there.
    const WITHOUT_CONDITIONS: usize = 12;

    /// The columns that a header names, without its line end; `None` where it is not the header of a ledger.
    #[must_use]
    pub fn of_header(header: &str) -> Option<Self> {
        let known = [LedgerRow::COLUMNS.len(), Self::WITHOUT_CONDITIONS];
        known.into_iter().find(|&columns| header == LedgerRow::COLUMNS[..columns].join(",")).map(Self)
    }

    /// Reads one line without its line end.
    ///
    /// # Errors
    /// [`LedgerError`] with the field that cannot be read.
    pub fn parse(self, line: &str) -> Result<LedgerRow, LedgerError> {
        let mut fields: Vec<&str> = line.split(',').collect();
        let error = LedgerError::Fields { expected: self.0, found: fields.len() };
        if fields.len() != self.0 {
            return Err(error);
        }
        fields.resize(LedgerRow::COLUMNS.len(), "");
        LedgerRow::of_fields(&fields.try_into().map_err(|_| error)?)
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

    fn finite(self) -> Result<f64, LedgerError> {
        self.number().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| self.error())
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
            conditions: Conditions {
                focus_nm: Some(-12.25),
                x_um: Some(1500.0),
                y_um: Some(-0.1),
                light: Light::of([(488, 10.0), (561, 20.0)]).unwrap(),
            },
        };
        let lost = LedgerRow {
            state: RowState::Lost(Loss::UpstreamGap),
            id: None,
            device_time: None,
            host_time: None,
            pair: PairState::Not(Loss::Unpaired),
            analysis: Analysis::None,
            conditions: Conditions::default(),
            ..recorded
        };
        let shed = LedgerRow {
            channel: Channel::Reflected,
            state: RowState::Unrecorded,
            analysis: Analysis::LeftOut(Loss::OutOfFocus),
            conditions: Conditions { focus_nm: None, ..recorded.conditions },
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
        assert_eq!(
            line,
            "17,T,recorded,,16,00abcdef,65417,1,340000000,341000000,paired,analyzed,-12.25,1500,-0.1,488=10;561=20\n"
        );
        let fields = LedgerError::Fields { expected: 16, found: 3 };
        assert_eq!(LedgerRow::parse("17,T,rec"), Err(fields));
        for (field, wrong) in [("-12.25", "NaN"), ("1500", "inf"), ("-0.1", "-0.1.2"), ("561=20", "561")] {
            assert!(LedgerRow::parse(&line.trim().replace(field, wrong)).is_err(), "{wrong}");
        }
        let said = LedgerRow::parse(&line.trim().replace("recorded", "eaten")).unwrap_err().to_string();
        assert_eq!(said, "state: \"eaten\" cannot be read");
    }

    #[test]
    fn ledgers_of_before_are_read_by_their_header() {
        let old = "exposure,camera,state,reason,page,crc32c,block_id,epoch,device_time_ns,host_time_ns,pair,analysis";
        let columns = LedgerColumns::of_header(old).unwrap();
        let line = "17,T,recorded,,16,00abcdef,65417,1,340000000,341000000,paired,analyzed";
        let expected = LedgerRow { conditions: Conditions::default(), ..rows()[0] };
        assert_eq!(columns.parse(line), Ok(expected));
        assert!(LedgerRow::parse(line).is_err(), "a line without conditions in a ledger with them is torn");
        let mut new = String::new();
        rows()[0].write_to(&mut new);
        assert!(columns.parse(new.trim()).is_err());
        let columns = LedgerColumns::of_header(&LedgerRow::header()).unwrap();
        assert_eq!(columns.parse(new.trim()), Ok(rows()[0]));
        assert_eq!(LedgerColumns::of_header("exposure,camera"), None);
    }
}
