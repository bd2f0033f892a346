//! Scenes as scripts: commands before each tick, and a seed.
//!
//! Knows neither engine nor network, so that one script runs in one process or remote.
#![forbid(unsafe_code)]
