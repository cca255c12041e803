//! What every camera driver must pass, whatever stands behind it.
