//! C interface of the Rhumb client: functions, flat structs, opaque handles.
//!
//! `include/rhumb.h` is generated from this crate, and is its documentation. Rules of every function:
//!
//! - A handle is a number. After it is closed, each call with it is the error `RHUMB_CODE_CLOSED`, for ever.
//! - A panic does not cross the border: it is `RHUMB_CODE_FAULT`.
//! - A null pointer, a wrong size, a text that is not UTF-8 or an unknown kind is an error, and nothing is done.
//! - A pointer that is not null must point to what the function says. No library can check that.
#![deny(unsafe_op_in_unsafe_fn)]
#![warn(clippy::undocumented_unsafe_blocks)]

mod answers;
mod border;
mod cells;
mod commands;
mod connection;
mod descriptions;
mod feeding;
mod files;
mod generated;
mod kinds;
mod scene;

pub use answers::*;
pub use border::*;
pub use cells::*;
pub use commands::*;
pub use connection::*;
pub use descriptions::*;
pub use feeding::*;
pub use files::*;
pub use generated::*;
pub use kinds::*;
pub use scene::*;
