//! Flight recorders: the last moments of each scene, written after a fault.
//!
//! Each scene keeps its commands, steps and packet heads in bounded memory. After a fault, a thread of its own writes
//! them to a file that `rhumb-server flight FILE` prints. Invariants: a scene never waits for the disk; memory, the
//! number of files and their rate are bounded.

mod command;
mod file;
mod recorder;
mod ring;
mod writer;

pub(crate) use self::file::FlightCause;
pub(crate) use command::run;
pub(crate) use recorder::{FlightRecorder, FlightRecorders, ForwardedFlight};
pub(crate) use writer::FlightWriter;
