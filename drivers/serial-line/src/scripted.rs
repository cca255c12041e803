//! A port that wants exactly these bytes and answers exactly those: for byte-exact tests of single commands.

use std::collections::VecDeque;
use std::io;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::port::Port;

#[derive(Debug, Default)]
struct Script {
    steps: VecDeque<(Vec<u8>, Vec<u8>)>,
    sent: Vec<u8>,
    answers: VecDeque<u8>,
    wrong: Option<String>,
}

/// A port that follows a script.
#[derive(Debug, Clone, Default)]
pub struct ScriptedPort(Arc<Mutex<Script>>);

impl ScriptedPort {
    /// A port without a script: it wants nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Then wants `command` and answers `answer`; an empty answer is silence.
    #[must_use]
    pub fn expect(self, command: impl AsRef<[u8]>, answer: impl AsRef<[u8]>) -> Self {
        self.script().steps.push_back((command.as_ref().to_vec(), answer.as_ref().to_vec()));
        self
    }

    /// Checks that every command of the script came, and nothing else.
    ///
    /// # Panics
    /// With the first difference.
    pub fn assert_finished(&self) {
        let script = self.script();
        assert!(script.wrong.is_none(), "{}", script.wrong.as_deref().unwrap_or_default());
        assert!(script.sent.is_empty(), "left over: \"{}\"", script.sent.escape_ascii());
        if let Some((command, _)) = script.steps.front() {
            panic!("never sent: \"{}\"", command.escape_ascii());
        }
    }

    fn script(&self) -> std::sync::MutexGuard<'_, Script> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Port for ScriptedPort {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], _within: Duration) -> io::Result<usize> {
        let answers = &mut self.script().answers;
        let num_bytes = bytes.len().min(answers.len());
        for (place, byte) in bytes.iter_mut().zip(answers.drain(..num_bytes)) {
            *place = byte;
        }
        Ok(num_bytes)
    }

    fn forget_received(&mut self) -> io::Result<()> {
        self.script().answers.clear();
        Ok(())
    }

    fn sender(&self) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(self.clone()))
    }
}

impl Write for ScriptedPort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut script = self.script();
        script.sent.extend_from_slice(bytes);
        while let Some((command, _)) = script.steps.front() {
            let compared = command.len().min(script.sent.len());
            if script.sent[..compared] != command[..compared] {
                let (expected, sent) =
                    (command.escape_ascii().to_string(), script.sent.escape_ascii().to_string());
                script.wrong.get_or_insert(format!("expected \"{expected}\", sent \"{sent}\""));
                return Err(io::Error::other("not in the script"));
            }
            if compared < command.len() {
                return Ok(bytes.len());
            }
            let (_, answer) = script.steps.pop_front().unwrap_or_default();
            script.sent.drain(..compared);
            script.answers.extend(answer);
        }
        if !script.sent.is_empty() {
            let sent = script.sent.escape_ascii().to_string();
            script.wrong.get_or_insert(format!("expected nothing, sent \"{sent}\""));
            return Err(io::Error::other("not in the script"));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Line;

    #[test]
    fn the_script_answers_what_it_wants() {
        let port = ScriptedPort::new().expect("?a\r", "1\r").expect("!b\r", "");
        let mut line = Line::new(Box::new(port.clone()), "scripted");
        line.send(b"?a\r").unwrap();
        assert_eq!(line.receive_until(b"\r", Duration::from_secs(1)).unwrap(), b"1");
        line.send(b"!b\r").unwrap();
        port.assert_finished();
    }

    #[test]
    #[should_panic(expected = "expected \"?a\\r\", sent \"?b\\r\"")]
    fn other_bytes_are_told() {
        let port = ScriptedPort::new().expect("?a\r", "1\r");
        let mut line = Line::new(Box::new(port.clone()), "scripted");
        assert!(line.send(b"?b\r").is_err());
        port.assert_finished();
    }
}
