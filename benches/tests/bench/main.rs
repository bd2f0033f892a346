//! The tasks of `rhumb-bench`, and what they write.
//!
//! One executable holds all tests: each further one would link the engine again.

mod bounce;
mod evaluate;
mod limit;
mod own_recording;
mod own_scenes;
mod replay;
mod report;
mod summary;
mod support;
mod tasks;
mod trace;
