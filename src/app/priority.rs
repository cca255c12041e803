//! Processes that must not wait for others: the laser guard, and virtual devices that stand in for hardware.
//!
//! In: nothing. Out: this process is scheduled before ordinary ones. Never: takes more than a system grants.
//! Fails: never; where the system grants nothing, the process runs as any other and a warning says so.

/// Nice value, from -20 to 19; beneath what keeps the system itself alive.
const AHEAD: i32 = -15;

/// Where Linux shares its processors among sessions first, and only then among the processes of each.
const SHARE_OF_SESSION: &str = "/proc/self/autogroup";

/// Schedules this process before ordinary ones; threads that it starts afterwards inherit it.
pub(super) fn go_ahead(process: &str) {
    // In a session of its own its share is not spent by a program that computes, and no terminal can end it.
    // Refused to the leader of a session, which has one already.
    let _led = rustix::process::setsid();
    // Absent on other systems.
    let _shared = std::fs::write(SHARE_OF_SESSION, AHEAD.to_string());
    if let Err(error) = rustix::process::setpriority_process(None, AHEAD) {
        tracing::warn!("{process} runs at ordinary priority ({error}): a busy computer can delay it");
    }
}
