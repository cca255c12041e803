//! Processes that must not wait for others: the laser guard, and virtual devices that stand in for hardware.
//!
//! In: nothing. Out: this process is scheduled before ordinary ones. Never: takes more than a system grants.
//! Fails: never; where the system grants nothing, the process runs as any other and a warning says so.

/// Nice value, from -20 to 19; beneath what keeps the system itself alive.
const AHEAD: i32 = -15;

/// Schedules this process before ordinary ones; threads that it starts afterwards inherit it.
pub(super) fn go_ahead(process: &str) {
    if let Err(error) = rustix::process::setpriority_process(None, AHEAD) {
        tracing::warn!("{process} runs at ordinary priority ({error}): a busy computer can delay it");
    }
}
