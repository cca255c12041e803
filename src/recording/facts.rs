//! What each frame carries with it in the image file: enough to write its row of the ledger again.
//!
//! In: a row with a recorded frame. Out: 44 bytes, and the row back.
//! Never: stands for a lost frame. Fails: `None` for bytes that no row gives.
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
//! | 42..44 | low half of the CRC-32C of the bytes before, 1 where that is 0; 0 where it was not written |

use crate::acquisition::{Analysis, LedgerRow, Loss, PairState, RowState};
use sofiscope_hal::{BlockId, Channel, DeviceTime, Epoch, ExposureIndex, HostTime};

/// Bytes of the facts of one frame.
pub(super) const FACTS_BYTES: usize = 44;

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
    let check = check(&bytes);
    bytes[CHECK_AT..].copy_from_slice(&check.to_le_bytes());
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
    })
}

/// Tells facts of which a loss of power has taken a part.
fn check(bytes: &FactsBytes) -> u16 {
    (crc32c::crc32c(&bytes[..CHECK_AT]) as u16).max(1)
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
        let mut torn = encode(&row(PairState::Paired, Analysis::Analyzed)).unwrap();
        torn[..20].fill(0);
        assert_eq!(decode(&torn, Channel::Transmitted, 7), None);
        assert_eq!(decode(&[200; FACTS_BYTES], Channel::Reflected, 0), None);
    }
}
