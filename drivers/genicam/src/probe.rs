//! Asks a GigE Vision camera, on a socket of its own, who has control of it.
//!
//! Reading registers needs no control (GigE Vision 1.2, section 9.6), so this neither disturbs the control channel of
//! Aravis nor waits for it.

use std::io;
use std::net::{Ipv4Addr, UdpSocket};

use crate::watchdog::Answer;

const PORT: u16 = 3956;
const READ_REGISTER: [u8; 6] = [0x42, 0x01, 0x00, 0x80, 0x00, 0x04];
const CONTROL_PRIVILEGE: [u8; 4] = [0x00, 0x00, 0x0A, 0x00];
/// Number of the acknowledgement.
const ACKNOWLEDGED: [u8; 2] = [0x00, 0x81];

#[derive(Debug)]
pub(crate) struct Probe {
    socket: UdpSocket,
    request: u16,
}

impl Probe {
    pub(crate) fn open(camera: Ipv4Addr) -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.connect((camera, PORT))?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, request: 0 })
    }

    /// Asks; an answer comes later or never.
    pub(crate) fn ask(&mut self) {
        self.request = self.request.checked_add(1).unwrap_or(1);
        let question = [&READ_REGISTER[..], &self.request.to_be_bytes(), &CONTROL_PRIVILEGE].concat();
        // A camera that is gone refuses; that is no answer either.
        let _refused = self.socket.send(&question);
    }

    /// The newest answer, if any came since the last look.
    pub(crate) fn answer(&mut self) -> Option<Answer> {
        let mut answer = None;
        let mut datagram = [0; 64];
        for _ in 0..16 {
            match self.socket.recv(&mut datagram) {
                Ok(length) => answer = meaning(&datagram[..length]).or(answer),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(_refused) => {}
            }
        }
        answer
    }
}

/// A refusal to read is an answer as well: somebody has exclusive control.
fn meaning(datagram: &[u8]) -> Option<Answer> {
    if datagram.get(2..4)? != ACKNOWLEDGED {
        return None;
    }
    let is_success = datagram.get(..2)? == [0, 0];
    let privilege = datagram.get(8..12).unwrap_or(&[1]);
    let is_free = is_success && privilege.iter().all(|&byte| byte == 0);
    Some(if is_free { Answer::Uncontrolled } else { Answer::Controlled })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_say_who_has_control() {
        let answer = |status, privilege| [status, 0, 0, 0x81, 0, 4, 0, 1, 0, 0, 0, privilege];
        assert_eq!(meaning(&answer(0, 2)), Some(Answer::Controlled));
        assert_eq!(meaning(&answer(0, 0)), Some(Answer::Uncontrolled));
        assert_eq!(meaning(&answer(0x80, 0)), Some(Answer::Controlled), "refused");
        assert_eq!(meaning(&answer(0, 0)[..3]), None);
        assert_eq!(meaning(&[0; 12]), None, "an answer to another question");
    }
}
