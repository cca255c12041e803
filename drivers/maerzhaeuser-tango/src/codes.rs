//! Errors of the controller in words, and what the caller can do about them (codes of the TANGO instruction set).

use sofiscope_hal::{DeviceError, ErrorKind};

/// An error code of the controller as an answer to `command`.
pub(crate) fn refusal(device: &str, command: &str, code: u16) -> DeviceError {
    let message = format!("'{command}' was refused with error {code}: {}; {}", meaning(code), next(code));
    DeviceError::new(kind(code), device, message)
}

/// What a code means.
pub(crate) fn meaning(code: u16) -> &'static str {
    match code {
        0 => "no error",
        1 => "no valid axis name",
        2 => "no executable instruction",
        3 => "too many characters in the command",
        4 => "invalid instruction",
        5 => "number outside of the allowed range",
        6 => "wrong number of parameters",
        7 => "'!' or '?' missing or not allowed",
        8 | 9 => "not possible while the axis is active",
        10 => "function not configured",
        11 => "no move while the joystick is on",
        12 => "limit switch actuated",
        13 => "not executable, encoder detected",
        14 => "calibration: limit switch not released",
        15 => "opposing limit switch hit while homing",
        20 => "relay defective",
        21 => "multi-axis move forbidden",
        22 => "door open or not initialized",
        23..=26 => "security error of an axis",
        27 => "emergency stop active",
        28 => "fault in the door circuit",
        29 => "power amplifiers disabled",
        30 => "safety circuit error",
        31 => "joystick cannot be switched on during a move",
        32 => "target outside of the limits, move discarded",
        70..=74 => "controller hardware or closed loop",
        75..=81 => "axis correction, extension or module",
        82..=88 => "supply overload or brake voltage",
        89 => "not executable in standby",
        90 => "temperature",
        91 => "encoder error",
        _ => "not in the manual",
    }
}

/// What the caller can do about a code.
pub(crate) fn kind(code: u16) -> ErrorKind {
    match code {
        5 | 32 => ErrorKind::OutOfRange,
        8 | 9 | 11 | 31 | 89 => ErrorKind::Busy,
        1..=4 | 6 | 7 => ErrorKind::Protocol,
        _ => ErrorKind::Fault,
    }
}

/// What the person does next.
pub(crate) fn next(code: u16) -> &'static str {
    match code {
        5 | 32 => "choose another value",
        8 | 9 | 31 => "wait for the end of the move, or stop it",
        11 => "switch the property 'joy' off",
        12 | 14 | 15 => "look at the stage, then home it",
        22 | 28 => "close the door",
        27 => "release the emergency stop, then home the stage",
        29 => "switch the amplifiers on at the controller, then home the stage",
        82..=88 => "switch the controller off and look for a short circuit",
        90 => "let the controller cool down",
        _ => "look at the controller, then connect again",
    }
}
