//! What each frame carries with it in the image file: enough to write its row of the ledger again.
//!
//! In: a row with a recorded frame. Out: 47 bytes, and the row back.
//! Never: stands for a lost frame, holds what is the same in the whole recording: place and light. Fails: `None` for bytes that no row gives.
//!
//! | bytes | holds, little-endian |
//! |---|---|
//! | 0..8 | exposure |
//! | 8..16 | block id |
//! | 16..24 | device time in ns |
//! | 24..32 | host time in ns |
//! | 32..36 | epoch |
//! | 36..40 | CRC-32C of the pixels |
//! | 40 | pair: 0 paired, else 1 + place of the reason in [`Loss::ALL`] |
//! | 41 | analysis: 0 analyzed, 255 none, else 1 + place of the reason |
//! | 42..44 | low half of the CRC-32C of the bytes before and of the focus error, 1 where that is 0; 0 where it was not written |
//! | 44..47 | focus error in 0.01 nm, plus 2²³; 0 for none, and where the check leaves it out |
//!
//! Recordings of before have the first 44 bytes only.

use crate::acquisition::{Analysis, Conditions, FOCUS_STEPS_PER_NM, LedgerRow, Loss, PairState, RowState};
use sofiscope_hal::{BlockId, Channel, DeviceTime, Epoch, ExposureIndex, HostTime};

/// Bytes of the facts of one frame.
pub(super) const FACTS_BYTES: usize = 47;

/// Bytes of the facts in recordings of before; the others are 0 then.
pub(super) const FIRST_FACTS_BYTES: usize = 44;

/// What stands for a focus error of 0.
const FOCUS_ZERO: i32 = 1 << 23;

/// Where the check of the other bytes stands.
const CHECK_AT: usize = 42;

/// Facts of one frame as they lie in the file.
pub(super) type FactsBytes = [u8; FACTS_BYTES];

/// The facts of a row whose frame is recorded.
pub(super) fn encode(row: &LedgerRow) -> Option<FactsBytes> {
    let RowState::Recorded { crc32c, .. } = row.state else { return None };
    let (block, epoch) = row.id?;
    let mut bytes = [0; FACTS_BYTES];
    bytes[0..8].copy_from_slice(&row.exposure.0.to_le_bytes());
    bytes[8..16].copy_from_slice(&block.0.to_le_bytes());
    bytes[16..24].copy_from_slice(&row.device_time?.0.to_le_bytes());
    bytes[24..32].copy_from_slice(&row.host_time?.0.to_le_bytes());
    bytes[32..36].copy_from_slice(&epoch.0.to_le_bytes());
    bytes[36..40].copy_from_slice(&crc32c.to_le_bytes());
    bytes[40] = match row.pair {
        PairState::Paired => 0,
        PairState::Not(loss) => code(loss),
    };
    bytes[41] = match row.analysis {
        Analysis::Analyzed => 0,
        Analysis::None => u8::MAX,
        Analysis::LeftOut(loss) => code(loss),
    };
    bytes[FIRST_FACTS_BYTES..].copy_from_slice(&focus_bytes(row.conditions.focus_nm));
    let check = check(&bytes);
    bytes[CHECK_AT..FIRST_FACTS_BYTES].copy_from_slice(&check.to_le_bytes());
    Some(bytes)
}

/// The row of the frame at `page`; `None` if these bytes are no facts.
pub(super) fn decode(bytes: &FactsBytes, channel: Channel, page: u64) -> Option<LedgerRow> {
    let long = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte]));
    let short = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte]));
    let stored = u16::from_le_bytes([bytes[CHECK_AT], bytes[CHECK_AT + 1]]);
    if stored != 0 && stored != check(bytes) {
        return None;
    }
    let loss = |code: u8| Loss::ALL.get(usize::from(code).checked_sub(1)?).copied();
    Some(LedgerRow {
        exposure: ExposureIndex(long(0)),
        channel,
        state: RowState::Recorded { page, crc32c: short(36) },
        id: Some((BlockId(long(8)), Epoch(short(32)))),
        device_time: Some(DeviceTime(long(16))),
        host_time: Some(HostTime(long(24))),
        pair: if bytes[40] == 0 { PairState::Paired } else { PairState::Not(loss(bytes[40])?) },
        analysis: match bytes[41] {
            0 => Analysis::Analyzed,
            u8::MAX => Analysis::None,
            code => Analysis::LeftOut(loss(code)?),
        },
        conditions: Conditions { focus_nm: focus_of(bytes), ..Conditions::default() },
    })
}

/// Tells facts of which a loss of power has taken a part.
fn check(bytes: &FactsBytes) -> u16 {
    let first = crc32c::crc32c(&bytes[..CHECK_AT]);
    let focus = &bytes[FIRST_FACTS_BYTES..];
    let all = if *focus == [0; 3] { first } else { crc32c::crc32c_append(first, focus) };
    (all as u16).max(1)
}

/// A focus error of more than 80 µm is none.
fn focus_bytes(error_nm: Option<f64>) -> [u8; 3] {
    let steps = error_nm.map(|error_nm| (error_nm * FOCUS_STEPS_PER_NM).round());
    let steps = steps
        .filter(|steps| steps.abs() < f64::from(FOCUS_ZERO))
        .map_or(0, |steps| steps as i32 + FOCUS_ZERO);
    let [low, middle, high, _] = steps.to_le_bytes();
    [low, middle, high]
}

fn focus_of(bytes: &FactsBytes) -> Option<f64> {
    let steps = i32::from_le_bytes([bytes[44], bytes[45], bytes[46], 0]);
    (steps != 0).then(|| f64::from(steps - FOCUS_ZERO) / FOCUS_STEPS_PER_NM)
}

fn code(loss: Loss) -> u8 {
    let place = Loss::ALL.iter().position(|known| *known == loss).unwrap_or(0);
    u8::try_from(place + 1).unwrap_or(u8::MAX - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(pair: PairState, analysis: Analysis) -> LedgerRow {
        LedgerRow {
            exposure: ExposureIndex(1 << 40),
            channel: Channel::Transmitted,
            state: RowState::Recorded { page: 7, crc32c: 0xdead_beef },
            id: Some((BlockId(65_535), Epoch(2))),
            device_time: Some(DeviceTime(u64::MAX)),
            host_time: Some(HostTime(5)),
            pair,
            analysis,
            conditions: Conditions::default(),
        }
    }

    #[test]
    fn every_kind_of_row_comes_back() {
        let pairs = Loss::ALL.map(PairState::Not).into_iter().chain([PairState::Paired]);
        for pair in pairs {
            for analysis in [Analysis::Analyzed, Analysis::None, Analysis::LeftOut(Loss::ShedByPolicy)] {
                let row = row(pair, analysis);
                assert_eq!(decode(&encode(&row).unwrap(), Channel::Transmitted, 7), Some(row));
            }
        }
        for focus_nm in [0.0, -0.01, 0.01, 12.34, -1999.99, 83_886.07] {
            let conditions = Conditions { focus_nm: Some(focus_nm), ..Conditions::default() };
            let row = LedgerRow { conditions, ..row(PairState::Paired, Analysis::Analyzed) };
            let bytes = encode(&row).unwrap();
            assert_eq!(decode(&bytes, Channel::Transmitted, 7), Some(row));
            let torn = std::array::from_fn(|at| if at < FIRST_FACTS_BYTES { bytes[at] } else { 0 });
            assert_eq!(decode(&torn, Channel::Transmitted, 7), None, "{focus_nm} nm is missed");
        }
        let mut torn = encode(&row(PairState::Paired, Analysis::Analyzed)).unwrap();
        torn[..20].fill(0);
        assert_eq!(decode(&torn, Channel::Transmitted, 7), None);
        assert_eq!(decode(&[200; FACTS_BYTES], Channel::Reflected, 0), None);
    }
}
