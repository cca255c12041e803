//! Sensors of the focus error: a spot on a camera, a quadrant detector.
