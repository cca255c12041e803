//! Named threads that report their end.
//!
//! In: a name and the work. Out: what the work returns. Never: lets a panic pass unsaid.
//! Fails: [`StagePanicked`] with the name and the message.

use std::any::Any;
use std::thread::{Builder, JoinHandle};

/// A running thread.
#[derive(Debug)]
pub struct Stage<T> {
    name: &'static str,
    handle: JoinHandle<T>,
}

/// The thread ended by a panic, which is a defect of the program.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the thread {stage} stopped by a defect in the program: {message}")]
pub struct StagePanicked {
    /// Name of the thread.
    pub stage: &'static str,
    /// The panic's message.
    pub message: String,
}

/// Starts a thread with a name of at most 15 characters, which is what the system shows.
///
/// # Errors
/// What the system says when it has no more threads.
pub fn spawn<T: Send + 'static>(
    name: &'static str,
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<Stage<T>> {
    let handle = Builder::new().name(name.to_owned()).spawn(work)?;
    Ok(Stage { name, handle })
}

impl<T> Stage<T> {
    /// Whether the work is over.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.handle.is_finished()
    }

    /// Waits for the end of the work.
    ///
    /// # Errors
    /// [`StagePanicked`] instead of the result.
    pub fn join(self) -> Result<T, StagePanicked> {
        let Self { name, handle } = self;
        handle.join().map_err(|panic| StagePanicked { stage: name, message: message_of(panic.as_ref()) })
    }
}

fn message_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no message").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_the_name_of_the_thread() {
        let stage = spawn("grab-r", || -> u32 { panic!("lens {} fell off", 3) }).unwrap();
        let error = stage.join().unwrap_err();
        assert_eq!((error.stage, error.message.as_str()), ("grab-r", "lens 3 fell off"));
        assert_eq!(spawn("grab-t", || 7).unwrap().join(), Ok(7));
    }
}
