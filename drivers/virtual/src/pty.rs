//! A model behind a pseudo-terminal, in real time.

use std::fs::{File, OpenOptions};
use std::io;
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::fs::OFlags;
use serialport::{SerialPort, TTYPort};
use sofiscope_serial_line::LineModel;

use crate::monotonic;

/// Longest wait for bytes; also how soon a raised flag is seen.
const LONGEST_WAIT: Duration = Duration::from_millis(20);

/// A pseudo-terminal with a name that stays, whatever number the system gives it.
#[derive(Debug)]
pub struct Terminal {
    ours: TTYPort,
    /// Held open so that its settings stay, and that reading from our end does not fail between two programs.
    _theirs: File,
    link: PathBuf,
}

impl Terminal {
    /// Opens a pseudo-terminal that others open by the name `link`.
    ///
    /// # Errors
    /// When the system gives none, or the name is taken.
    pub fn open(link: &Path) -> io::Result<Self> {
        let (ours, locked) = TTYPort::pair()?;
        let name = locked.name().ok_or_else(|| io::Error::other("a pseudo-terminal without a name"))?;
        let no_control = i32::try_from(OFlags::NOCTTY.bits()).unwrap_or(0);
        let theirs = OpenOptions::new().read(true).write(true).custom_flags(no_control).open(&name)?;
        // Only now: without any open handle the terminal would forget that it is raw.
        drop(locked);
        // A link that a killed device has left behind leads nowhere and is nobody's.
        if link.is_symlink() && !link.exists() {
            std::fs::remove_file(link)?;
        }
        std::os::unix::fs::symlink(name, link)?;
        Ok(Self { ours, _theirs: theirs, link: link.to_owned() })
    }

    /// Lets the model live at this terminal until `over` is raised or the model is unplugged.
    ///
    /// # Errors
    /// When the terminal fails.
    pub fn serve(self, model: &mut dyn LineModel, over: &AtomicBool) -> io::Result<()> {
        self.serve_since(monotonic(), model, over)
    }

    /// The same for a model whose time was zero at `base`, a time of [`monotonic`]: what it notes in a log is then
    /// not early by the moment that passed until its terminal was served.
    ///
    /// # Errors
    /// When the terminal fails.
    pub fn serve_since(
        mut self,
        base: Duration,
        model: &mut dyn LineModel,
        over: &AtomicBool,
    ) -> io::Result<()> {
        let mut bytes = [0; 256];
        let mut out = Vec::new();
        while !over.load(Ordering::Relaxed) && model.plugged() {
            let now = monotonic().saturating_sub(base);
            let next = model.advance(now, &mut out);
            if !out.is_empty() {
                self.ours.write_all(&out)?;
                out.clear();
            }
            let wait = next.map_or(LONGEST_WAIT, |next| next.saturating_sub(now)).min(LONGEST_WAIT);
            self.ours.set_timeout(wait.max(Duration::from_micros(1)))?;
            match self.ours.read(&mut bytes) {
                Ok(num_bytes) => model.receive(&bytes[..num_bytes], monotonic().saturating_sub(base)),
                Err(error)
                    if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // The name is ours; without it nobody finds a terminal that is gone.
        let _gone = std::fs::remove_file(&self.link);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sofiscope_serial_line::{Line, LineSettings};

    /// Answers every line with itself in capitals.
    #[derive(Default)]
    struct Shouting(Vec<u8>);

    impl LineModel for Shouting {
        fn receive(&mut self, bytes: &[u8], _now: Duration) {
            self.0.extend(bytes.iter().map(u8::to_ascii_uppercase));
        }

        fn advance(&mut self, _now: Duration, out: &mut Vec<u8>) -> Option<Duration> {
            out.append(&mut self.0);
            None
        }
    }

    /// Opens the terminal anew, says `text` and returns what comes back.
    fn shouted(link: &Path, text: &str) -> Result<Vec<u8>, String> {
        let mut line =
            Line::open(link, LineSettings::new(9600), "shouting").map_err(|error| error.to_string())?;
        line.send(format!("{text}\r").as_bytes()).map_err(|error| error.to_string())?;
        line.receive_until(b"\r", Duration::from_secs(10)).map_err(|error| error.to_string())
    }

    #[test]
    fn a_driver_talks_to_a_model_over_a_terminal() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("stage0");
        let terminal = Terminal::open(&link).unwrap();
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| terminal.serve(&mut Shouting::default(), &over).unwrap());
            let answers = ["hello", "again"].map(|text| shouted(&link, text));
            over.store(true, Ordering::Relaxed);
            assert_eq!(answers.map(Result::unwrap), [b"HELLO", b"AGAIN"]);
        });
        assert!(!link.is_symlink());
    }

    #[test]
    fn a_device_that_is_gone_is_lost_to_its_driver() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("laser0");
        let terminal = Terminal::open(&link).unwrap();
        let mut line = Line::open(&link, LineSettings::new(9600), "laser").unwrap();
        drop(terminal);
        let error = line.receive_exactly(1, Duration::from_secs(10)).unwrap_err();
        assert_eq!(line.error(&error, "reading").kind(), sofiscope_hal::ErrorKind::Lost);
    }
}
