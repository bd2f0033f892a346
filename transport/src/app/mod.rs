//! TCP and UDP for clients of the paper's protocol.
//!
//! Understands nothing of what it carries. Every queue is bounded; connections that say nothing are ended.

mod door;
mod endpoint;
mod io;
mod lanes;
mod line;
mod pace;
mod post;

pub use door::{AppBindError, AppListen};
pub(crate) use door::{AppDoor, AppHooks};
pub use endpoint::{AppEndpoint, AppTransmit};
pub(crate) use line::AppInput;
