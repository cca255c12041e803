//! The longest on-time of the board: a gate that somebody holds open, and who never closes it.

use crate::bench::{Bench, GATES, LASER_GATE, dark_since, wait};
use crate::trials::Closed;
use sofiscope_gatekeeper::{Gatekeeper, GatekeeperSettings, Step};
use sofiscope_hal::{DeviceError, GateController, GatePattern, GateTrip, Volts};
use sofiscope_serial_line::Line;
use std::time::Duration;

const LONGEST: Duration = Duration::from_millis(70);

/// Opens the gate past the guard and gives heartbeats as if all were well; the time counts from the limit.
pub(crate) fn try_out() -> Result<Closed, String> {
    let bench = Bench::new(Duration::from_millis(20));
    let mut board = connect(&bench).map_err(|error| error.to_string())?;
    let mut held = board.arm().and_then(|()| board.set_gates(GatePattern(LASER_GATE)));
    for _ in 0..20 {
        // Refused from the moment on at which the board has tripped.
        held = held.and_then(|()| board.heartbeat());
        wait(Duration::from_millis(40));
    }
    let state = board.state().map_err(|error| error.to_string())?;
    if state.trip != Some(GateTrip::OnTime) {
        return Err(format!("{GATES} tripped by {:?}, not by the longest on-time", state.trip));
    }
    let gates = bench.gates();
    let opened = gates.first().ok_or("the gate was never open")?.at;
    let closed = dark_since(&gates).ok_or("the gate stays open")?;
    Ok(Closed { gates: closed.saturating_sub(opened + LONGEST), laser: None })
}

fn connect(bench: &Bench) -> Result<Gatekeeper, DeviceError> {
    let line = Line::open(&bench.path("controller"), Gatekeeper::line_settings(), "gatekeeper")?;
    let settings = GatekeeperSettings {
        serial: None,
        longest_on_time: vec![LONGEST; 4],
        full_scale: Volts::new(5.0).unwrap(),
        pulse_width: Duration::from_millis(1),
        step: Step::CameraExposure,
    };
    Gatekeeper::connect(line, settings)
}
