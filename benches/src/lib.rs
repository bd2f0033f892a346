//! Runs scenes in every mode, measures each frame, and writes it all down.
//!
//! A run leaves a [`record::Experiment`] behind. From it alone come the figures ([`summary`]), the file that holds
//! every one of them again ([`trace`]) and the page that draws them ([`report`]).
#![forbid(unsafe_code)]

pub mod cost;
pub mod drive;
pub mod evaluate;
pub mod fit;
pub mod limit;
mod machine;
mod output;
pub mod paper;
pub mod record;
pub mod recording;
pub mod replay;
pub mod report;
pub mod scene_file;
pub mod summary;
pub mod trace;

mod quantile;
