//! A library with the functions of DCAM-API and simulated cameras behind them.
