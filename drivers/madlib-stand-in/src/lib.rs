//! A library with the functions of Madlib and a simulated piezo behind them.
