//! Settings as typed become settings that can be believed.
