//! Plans as data, and the one hand that carries them out.
//!
//! In: plans, commands, devices behind their contracts. Out: events, actions in the right order, how a run ended.
//! Never: reads a clock of its own, sleeps, looks at pixels, knows which device stands behind a contract.
//! Fails: faults of plans all at once; a run that fails ends like any other, with its reason.

pub mod contracts;
pub mod focus_lock;
pub mod plan;
pub mod preflight;
pub mod run_state;
pub mod sequencer;
pub mod stop_rule;
