//! One end of a serial line.

use std::io;
use std::io::{Read, Write};
use std::path::Path;
use std::time::Duration;

use serialport::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, StopBits};

/// How long a command may wait for room in the system's queue. With no time at all, a terminal that is short of room
/// for a moment would refuse it, and a STOP would be lost.
const ROOM_WITHIN: Duration = Duration::from_millis(100);

/// One end of a serial line, owned by one thread.
pub trait Port: Send {
    /// Sends all bytes.
    ///
    /// # Errors
    /// When the line is gone, or does not take them.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits until bytes are there or the time is over, and takes what is there: 0 bytes after the time.
    ///
    /// # Errors
    /// [`UnexpectedEof`](io::ErrorKind::UnexpectedEof) when the line is gone.
    fn receive(&mut self, bytes: &mut [u8], within: Duration) -> io::Result<usize>;

    /// Forgets what has come and was not read.
    ///
    /// # Errors
    /// When the line is gone.
    fn forget_received(&mut self) -> io::Result<()>;

    /// A second handle that only sends: for the one command that must overtake all others.
    ///
    /// # Errors
    /// When the system gives no second handle.
    fn sender(&self) -> io::Result<Box<dyn Write + Send>>;
}

/// How the bytes stand on the wire; 8 data bits and no handshake, as every device here has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineSettings {
    /// Bits per second.
    pub baud: u32,
    /// Whether there are two stop bits instead of one.
    pub two_stop_bits: bool,
}

impl LineSettings {
    /// 8N1 at this rate.
    #[must_use]
    pub fn new(baud: u32) -> Self {
        Self { baud, two_stop_bits: false }
    }

    /// 8N2 at this rate.
    #[must_use]
    pub fn with_two_stop_bits(baud: u32) -> Self {
        Self { baud, two_stop_bits: true }
    }

    /// Time that one byte takes on the wire.
    #[must_use]
    pub fn time_per_byte(self) -> Duration {
        let bits = if self.two_stop_bits { 11 } else { 10 };
        Duration::from_nanos(bits * 1_000_000_000 / u64::from(self.baud.max(1)))
    }
}

/// Opens a port by its path, for this process alone, without touching DTR.
///
/// # Errors
/// When there is no such port, it is in use, or may not be opened; the message says which.
pub fn open(path: &Path, settings: LineSettings) -> io::Result<Box<dyn Port>> {
    let stop_bits = if settings.two_stop_bits { StopBits::Two } else { StopBits::One };
    let port = serialport::new(path.to_string_lossy(), settings.baud)
        .data_bits(DataBits::Eight)
        .parity(Parity::None)
        .stop_bits(stop_bits)
        .flow_control(FlowControl::None)
        .open()
        .map_err(|error| io::Error::new(io::Error::from(error.clone()).kind(), refusal(path, &error)))?;
    Ok(Box::new(Tty(port)))
}

fn refusal(path: &Path, error: &serialport::Error) -> String {
    let path = path.display();
    match error.kind() {
        serialport::ErrorKind::Io(io::ErrorKind::NotFound) => {
            format!(
                "cannot open {path}: no such port; check the cable, and the path with `ls /dev/serial/by-id`"
            )
        }
        serialport::ErrorKind::NoDevice => {
            format!("cannot open {path}: no such port, or another program has it ({error})")
        }
        serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
            format!("cannot open {path}: not allowed; add yourself to the group 'dialout' and log in again")
        }
        _ => format!("cannot open {path}: {error}"),
    }
}

struct Tty(Box<dyn SerialPort>);

impl Port for Tty {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.0.timeout() != ROOM_WITHIN {
            self.0.set_timeout(ROOM_WITHIN)?;
        }
        self.0.write_all(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], within: Duration) -> io::Result<usize> {
        if self.0.timeout() != within {
            self.0.set_timeout(within)?;
        }
        loop {
            return match self.0.read(bytes) {
                Ok(0) => Err(gone()),
                Ok(num_bytes) => Ok(num_bytes),
                Err(error) if error.kind() == io::ErrorKind::TimedOut => Ok(0),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(_) => Err(gone()),
            };
        }
    }

    fn forget_received(&mut self) -> io::Result<()> {
        Ok(self.0.clear(ClearBuffer::Input)?)
    }

    fn sender(&self) -> io::Result<Box<dyn Write + Send>> {
        let mut port = self.0.try_clone()?;
        port.set_timeout(ROOM_WITHIN)?;
        Ok(Box::new(Sender(port)))
    }
}

struct Sender(Box<dyn SerialPort>);

impl Write for Sender {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// What a vanished line looks like to everybody.
pub(crate) fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::UnexpectedEof, "the line is gone")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_takes_ten_or_eleven_bits() {
        assert_eq!(LineSettings::with_two_stop_bits(57_600).time_per_byte().as_micros(), 190);
        assert_eq!(LineSettings::new(9600).time_per_byte().as_micros(), 1041);
    }

    #[test]
    fn a_port_that_is_not_there_is_named() {
        let error = open(Path::new("/dev/no-such-port"), LineSettings::new(9600)).err().unwrap();
        assert!(error.to_string().contains("/dev/no-such-port"), "{error}");
    }
}
