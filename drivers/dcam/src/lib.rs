//! Hamamatsu ORCA-Flash4.0 through DCAM-API, opened at run time.
