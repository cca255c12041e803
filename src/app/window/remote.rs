//! The instrument of another process, as the window sees it.
//!
//! In: looks of the window, commands. Out: the newest status and pictures that have arrived, messages on the wire,
//! STOP on a line of its own.
//! Never: lets the window wait for pixels. Fails: [`Refused`] when too much is under way; an instrument that is
//! gone closes the window.

use super::save::keep_picture;
use super::wire::{FromWindow, Judged, Known, receive, send};
use crate::app::AppError;
use crate::pipeline::{Stage, spawn};
use crate::viewer::AsSeen;
use crate::viewer::bench::{Bench, BenchCommand, BenchStatus, Gravity, Pictures, PlanEstimate, Refused};
use arc_swap::ArcSwap;
use crossbeam_channel::{Receiver, Sender, bounded};
use std::io::{BufReader, Result, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Messages that may wait for the wire.
const WAITING: usize = 16;
/// A plan is judged in milliseconds.
const PATIENCE: Duration = Duration::from_secs(3);

/// A handle on the instrument.
#[derive(Clone)]
pub(super) struct RemoteBench {
    shown: Arc<Shown>,
    /// Messages, with the way of their answers.
    messages: Sender<(FromWindow, Option<Sender<Judged>>)>,
    stop: Arc<UnixStream>,
}

/// What has arrived.
#[derive(Default)]
struct Shown {
    newest: ArcSwap<(Arc<BenchStatus>, bool, Pictures)>,
    /// Whether a look is on its way.
    is_asked: AtomicBool,
    is_gone: AtomicBool,
    context: OnceLock<egui::Context>,
}

impl RemoteBench {
    /// Starts the thread that writes and reads; it ends with the farewell or with the instrument.
    ///
    /// # Errors
    /// [`AppError::Device`] when there is no thread to be had.
    pub(super) fn start(
        wire: UnixStream,
        stop: UnixStream,
    ) -> std::result::Result<(Self, Stage<()>), AppError> {
        let (messages, to_send) = bounded(WAITING);
        let shown = Arc::new(Shown::default());
        let owned = Arc::clone(&shown);
        let work = move || {
            if let Err(error) = exchange(&owned, &wire, &to_send) {
                tracing::debug!("the instrument is gone: {error}");
                owned.is_gone.store(true, Ordering::SeqCst);
                owned.wake();
            }
        };
        let wire = spawn("window-wire", work)
            .map_err(|error| AppError::Device(format!("no thread for the window: {error}")))?;
        Ok((Self { shown, messages, stop: Arc::new(stop) }, wire))
    }

    /// From now on the window looks again as soon as something has happened.
    pub(super) fn wake(&self, context: egui::Context) {
        // Set once: there is one window.
        let _ = self.shown.context.set(context);
    }

    /// Whether the instrument has ended.
    pub(super) fn is_gone(&self) -> bool {
        self.shown.is_gone.load(Ordering::SeqCst)
    }

    /// Tells the person something.
    pub(super) fn tell(&self, gravity: Gravity, text: impl Into<String>) {
        if self.say(FromWindow::Tell(gravity, text.into())).is_err() {
            tracing::warn!("the instrument is busy: a note of the window is lost");
        }
    }

    /// Says why there is no window any more, as the last thing.
    pub(super) fn leave(&self, farewell: FromWindow) {
        // Waits for its turn; an instrument that is gone needs no farewell.
        let _ = self.messages.send((farewell, None));
    }

    fn say(&self, message: FromWindow) -> std::result::Result<(), Refused> {
        self.messages.try_send((message, None)).map_err(|_| Refused)
    }
}

impl Bench for RemoteBench {
    /// Looking is what asks for the next look.
    fn status(&self) -> Arc<BenchStatus> {
        if !self.shown.is_asked.swap(true, Ordering::SeqCst) && self.say(FromWindow::Look).is_err() {
            self.shown.is_asked.store(false, Ordering::SeqCst);
        }
        Arc::clone(&self.shown.newest.load().0)
    }

    fn pictures(&self) -> Pictures {
        self.shown.newest.load().2.clone()
    }

    fn ask(&self, command: BenchCommand) -> std::result::Result<(), Refused> {
        self.say(FromWindow::Ask(command))
    }

    fn stop(&self) {
        // One byte always finds room: the instrument reads them at once.
        if let Err(error) = (&*self.stop).write_all(&[1]) {
            tracing::error!("STOP did not reach the instrument: {error}; its guard makes the lasers dark");
        }
    }

    fn keep_picture(&self, picture: AsSeen) -> std::result::Result<(), Refused> {
        let (bench, is_simulated) = (self.clone(), self.shown.newest.load().1);
        let keep = move || match keep_picture(&picture, is_simulated) {
            Ok(()) => bench.tell(Gravity::Note, format!("saved: {}", picture.path.display())),
            Err(error) => bench.tell(Gravity::Error, error.to_string()),
        };
        match spawn("picture", keep) {
            Ok(_) => Ok(()),
            Err(error) => {
                self.tell(Gravity::Error, format!("no thread to save the picture: {error}"));
                Err(Refused)
            }
        }
    }

    fn judge_plan(&self, text: &str) -> std::result::Result<PlanEstimate, String> {
        let (answer, judged) = bounded(1);
        let asked = self.messages.try_send((FromWindow::Judge(text.to_owned()), Some(answer)));
        asked.map_err(|_| Refused.to_string())?;
        judged.recv_timeout(PATIENCE).map_err(|_| Refused.to_string())?
    }
}

impl Shown {
    fn wake(&self) {
        if let Some(context) = self.context.get() {
            context.request_repaint();
        }
    }

    /// Shows what has arrived; the window is woken where waiting would be noticed.
    fn show(&self, arrived: (Arc<BenchStatus>, bool, Pictures)) {
        let before = self.newest.load().0.clone();
        let has_happened =
            before.activity != arrived.0.activity || before.events.last() != arrived.0.events.last();
        self.newest.store(Arc::new(arrived));
        self.is_asked.store(false, Ordering::SeqCst);
        if has_happened {
            self.wake();
        }
    }
}

fn exchange(
    shown: &Shown,
    wire: &UnixStream,
    messages: &Receiver<(FromWindow, Option<Sender<Judged>>)>,
) -> Result<()> {
    let (mut to, mut from, mut known) = (wire, BufReader::new(wire), Known::default());
    for (message, answer) in messages {
        send(&mut to, &message)?;
        if message == FromWindow::Look {
            shown.show(known.receive(&mut from)?);
        }
        if matches!(message, FromWindow::Closed | FromWindow::Failed(_)) {
            return Ok(());
        }
        if let Some(answer) = answer {
            // The window may have lost its patience.
            let _ = answer.send(receive(&mut from)?);
        }
    }
    Ok(())
}
