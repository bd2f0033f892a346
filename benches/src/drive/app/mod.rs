//! The paper's protocol as a mode: its client and the measurement of it.

mod messages;
mod polled;
mod remote;
mod replica;
mod sockets;

pub use messages::{AppError, Unsupported};
pub(super) use remote::{AppRemote, AppSetup};
pub use replica::{Defect, Defects};
