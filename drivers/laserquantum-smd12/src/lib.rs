//! Laser Quantum gem lasers on an SMD12 supply over a serial line.
