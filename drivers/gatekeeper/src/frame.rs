//! Frames of the gatekeeper, as `firmware/PROTOCOL.md` has them.
//!
//! In: lines from the board. Out: [`Reply`], or nothing for what is no whole frame. Never: guesses.

/// Statuses of an answer.
pub(crate) mod status {
    pub(crate) const DONE: u8 = 0;
    pub(crate) const RANGE: u8 = 3;
    pub(crate) const NOT_ARMED: u8 = 4;
    pub(crate) const INTERLOCK_OPEN: u8 = 5;
    pub(crate) const BUSY: u8 = 6;
    pub(crate) const NUMBER: u8 = 7;
    pub(crate) const EPOCH: u8 = 8;
    pub(crate) const CONTENT: u8 = 9;
}

/// Commands.
pub(crate) mod command {
    pub(crate) const HELLO: u8 = 0x01;
    pub(crate) const ARM: u8 = 0x02;
    pub(crate) const DISARM: u8 = 0x03;
    pub(crate) const HEARTBEAT: u8 = 0x04;
    pub(crate) const GATES: u8 = 0x05;
    pub(crate) const LEVEL: u8 = 0x06;
    pub(crate) const LIMIT: u8 = 0x07;
    pub(crate) const LOAD: u8 = 0x08;
    pub(crate) const BEGIN: u8 = 0x09;
    pub(crate) const END: u8 = 0x0A;
    pub(crate) const TRAIN: u8 = 0x0B;
    pub(crate) const STOP_TRAIN: u8 = 0x0C;
    pub(crate) const STATE: u8 = 0x0D;
}

/// Patterns that fit into one frame beside their place.
pub(crate) const PATTERNS_PER_FRAME: usize = 18;

/// CRC-16/CCITT-FALSE.
pub(crate) fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(
            crc ^ u16::from(*byte) << 8,
            |crc, _| {
                if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 }
            },
        )
    })
}

/// A command as it goes over the line.
pub(crate) fn written(number: u16, command: u8, epoch: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(7 + payload.len());
    bytes.extend(number.to_be_bytes());
    bytes.push(command);
    bytes.extend(epoch.to_be_bytes());
    bytes.extend(payload);
    bytes.extend(crc(&bytes).to_be_bytes());
    let digit = |value: u8| b"0123456789ABCDEF"[usize::from(value & 15)];
    let digits = bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(*byte)]);
    [b':'].into_iter().chain(digits).chain([b'\n']).collect()
}

/// What a board says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Greeting {
    pub(crate) protocol: u8,
    pub(crate) firmware: u8,
    pub(crate) serial: u32,
    pub(crate) gates: u8,
    pub(crate) levels: u8,
    pub(crate) sequence: u16,
    pub(crate) watchdog_ms: u16,
    pub(crate) is_simulated: bool,
}

/// What a board says of its outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Report {
    pub(crate) open: u8,
    pub(crate) is_armed: bool,
    pub(crate) interlock_open: bool,
    pub(crate) trip: u8,
    pub(crate) config: u16,
    pub(crate) pulses: u32,
    pub(crate) exposures: u16,
    pub(crate) faulty: u16,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Content {
    Greeting(Greeting),
    Report(Report),
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reply {
    pub(crate) number: u16,
    /// The command that is answered.
    pub(crate) command: u8,
    pub(crate) epoch: u16,
    pub(crate) status: u8,
    pub(crate) content: Content,
}

/// Reads a line without its end; what comes before the last `:` is the rest of another one.
pub(crate) fn read(line: &[u8]) -> Option<Reply> {
    let begin = line.iter().rposition(|byte| *byte == b':')?;
    let digits = &line[begin + 1..];
    if !digits.len().is_multiple_of(2) {
        return None;
    }
    let bytes: Vec<u8> = digits
        .chunks_exact(2)
        .map(|pair| Some(value(pair[0])? << 4 | value(pair[1])?))
        .collect::<Option<_>>()?;
    let (bytes, check) = bytes.split_last_chunk::<2>()?;
    if crc(bytes).to_be_bytes() != *check {
        return None;
    }
    let (&[n1, n0, command, e1, e0, status], payload) = bytes.split_first_chunk::<6>()?;
    Some(Reply {
        number: u16::from_be_bytes([n1, n0]),
        command: command.checked_sub(0x80)?,
        epoch: u16::from_be_bytes([e1, e0]),
        status,
        content: content(payload)?,
    })
}

/// Only capitals: every frame has one spelling.
fn value(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        _ => None,
    }
}

fn content(payload: &[u8]) -> Option<Content> {
    match *payload {
        [b'G', b'K', protocol, firmware, a, b, c, d, gates, levels, s1, s0, w1, w0, flags, _, _] => {
            Some(Content::Greeting(Greeting {
                protocol,
                firmware,
                serial: u32::from_be_bytes([a, b, c, d]),
                gates,
                levels,
                sequence: u16::from_be_bytes([s1, s0]),
                watchdog_ms: u16::from_be_bytes([w1, w0]),
                is_simulated: flags & 1 != 0,
            }))
        }
        [open, flags, trip, c1, c0, a, b, c, d, x1, x0, f1, f0] => Some(Content::Report(Report {
            open,
            is_armed: flags & 1 != 0,
            interlock_open: flags & 2 != 0,
            trip,
            config: u16::from_be_bytes([c1, c0]),
            pulses: u32::from_be_bytes([a, b, c, d]),
            exposures: u16::from_be_bytes([x1, x0]),
            faulty: u16::from_be_bytes([f1, f0]),
        })),
        _ => None,
    }
}
