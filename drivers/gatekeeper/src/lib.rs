//! Trigger controller with our own firmware: watchdog, longest on-time, gates low at reset.
