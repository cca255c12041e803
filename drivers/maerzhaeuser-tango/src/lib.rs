//! Märzhäuser TANGO stage controllers over a serial line.
