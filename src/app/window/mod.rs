//! `live`: the window, and the session with the instrument behind it.

pub(super) mod board;
