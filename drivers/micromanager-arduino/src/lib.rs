//! Trigger controllers that speak the Arduino protocol of Micro-Manager.
