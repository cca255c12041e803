//! The control protocol (GVCP): commands in, acknowledgements out; all numbers big-endian.
//!
//! Numbers of commands and statuses as in GigE Vision 1.2, found again in `arvgvcpprivate.h` of Aravis 0.8.26.

/// Port of every GigE Vision camera.
pub(super) const PORT: u16 = 3956;
/// First byte of a command.
const COMMAND: u8 = 0x42;
/// Flag of a command that wants an acknowledgement.
const WANTS_ACK: u8 = 0x01;
/// Most bytes of one reading of memory, by the standard.
const MOST_BYTES: usize = 536;

/// What the other side wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Command<'a> {
    Discover,
    /// Addresses of registers, four bytes each.
    ReadRegisters(&'a [u8]),
    /// Pairs of address and value, eight bytes each.
    WriteRegisters(&'a [u8]),
    ReadMemory {
        address: u32,
        num_bytes: usize,
    },
    WriteMemory {
        address: u32,
        bytes: &'a [u8],
    },
    /// The packets `first` to `last` of one frame again; nobody acknowledges this.
    Resend {
        block_id: u16,
        first: u32,
        last: u32,
    },
    Unknown(u16),
}

/// A command with the number that its answer carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Request<'a> {
    pub(super) command: Command<'a>,
    pub(super) id: u16,
    pub(super) wants_ack: bool,
}

/// How a command went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub(super) enum Status {
    Success = 0,
    NotImplemented = 0x8001,
    InvalidParameter = 0x8002,
    InvalidAddress = 0x8003,
    WriteProtect = 0x8004,
    BadAlignment = 0x8005,
    AccessDenied = 0x8006,
}

/// Reads a datagram; `None` for what is no command.
pub(super) fn request(datagram: &[u8]) -> Option<Request<'_>> {
    let (header, rest) = datagram.split_at_checked(8)?;
    let length = usize::from(half(&header[4..])?);
    if header[0] != COMMAND || rest.len() < length {
        return None;
    }
    let payload = &rest[..length];
    let command = match half(&header[2..])? {
        0x0002 => Command::Discover,
        0x0040 => Command::Resend {
            block_id: half(payload.get(2..)?)?,
            first: word(payload.get(4..)?)? & 0x00FF_FFFF,
            last: word(payload.get(8..)?)? & 0x00FF_FFFF,
        },
        0x0080 if !length.is_multiple_of(4) => return None,
        0x0080 => Command::ReadRegisters(payload),
        0x0082 if !length.is_multiple_of(8) => return None,
        0x0082 => Command::WriteRegisters(payload),
        0x0084 => Command::ReadMemory {
            address: word(payload)?,
            num_bytes: usize::from(half(payload.get(6..)?)?).min(MOST_BYTES),
        },
        0x0086 => Command::WriteMemory { address: word(payload)?, bytes: payload.get(4..)? },
        other => Command::Unknown(other),
    };
    Some(Request { command, id: half(&header[6..])?, wants_ack: header[1] & WANTS_ACK != 0 })
}

/// The answer to a command.
pub(super) fn acknowledgement(request: &Request<'_>, status: Status, payload: &[u8]) -> Vec<u8> {
    let number = match request.command {
        Command::Discover => 0x0003,
        Command::ReadRegisters(_) => 0x0081,
        Command::WriteRegisters(_) => 0x0083,
        Command::ReadMemory { .. } => 0x0085,
        Command::WriteMemory { .. } => 0x0087,
        Command::Resend { .. } => 0x0041,
        Command::Unknown(command) => command | 1,
    };
    let mut datagram = Vec::with_capacity(8 + payload.len());
    datagram.extend((status as u16).to_be_bytes());
    datagram.extend(u16::to_be_bytes(number));
    datagram.extend(u16::try_from(payload.len()).unwrap_or(0).to_be_bytes());
    datagram.extend(request.id.to_be_bytes());
    datagram.extend(payload);
    datagram
}

/// Two bytes as a number.
fn half(bytes: &[u8]) -> Option<u16> {
    Some(u16::from_be_bytes(*bytes.first_chunk()?))
}

/// Four bytes as a number.
pub(super) fn word(bytes: &[u8]) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_and_answered() {
        let read = [0x42, 1, 0, 0x84, 0, 8, 0x12, 0x34, 0, 0, 2, 0, 0, 0, 0, 16];
        let found = request(&read).unwrap();
        assert_eq!(found.command, Command::ReadMemory { address: 0x200, num_bytes: 16 });
        let answer = acknowledgement(&found, Status::AccessDenied, &[7]);
        assert_eq!(answer, [0x80, 0x06, 0, 0x85, 0, 1, 0x12, 0x34, 7]);
        let resend = [0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0, 0xFF, 0xFE, 0, 0, 0, 3, 0, 0, 0, 5];
        let found = request(&resend).unwrap();
        assert_eq!(found.command, Command::Resend { block_id: 65_534, first: 3, last: 5 });
        assert!(!found.wants_ack);
    }

    #[test]
    fn cut_and_foreign_datagrams_are_no_commands() {
        let read = [0x42, 1, 0, 0x84, 0, 8, 0x12, 0x34, 0, 0, 2, 0, 0, 0, 0, 16];
        assert!((0..read.len()).all(|length| request(&read[..length]).is_none()));
        assert!(request(&[0x41; 16]).is_none());
    }
}
