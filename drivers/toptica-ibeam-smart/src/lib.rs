//! Toptica iBEAM smart diode lasers over a serial line.
