//! Benchmarks: run scenes in every mode, measure frames, write results.
//!
//! A run produces a [`record::Experiment`]. Everything else derives from it: the figures ([`summary`]), the trace file
//! ([`trace`]) and the report page ([`report`]).
#![forbid(unsafe_code)]

pub mod ablate;
pub mod cells;
pub mod cost;
pub mod dis;
pub mod drive;
pub mod evaluate;
pub mod fit;
pub mod import;
pub mod limit;
pub mod load;
pub mod machine;
pub mod numbers;
pub mod output;
pub mod plan;
pub mod record;
pub mod recording;
pub mod replay;
pub mod report;
pub mod scripts;
pub mod setup;
pub mod summary;
pub mod trace;
