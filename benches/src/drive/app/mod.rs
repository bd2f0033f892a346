//! The paper's protocol as a mode: its client and the measurement of it.
mod defects;
mod error;
mod messages;
mod polled;
mod remote;
mod replica;
mod sockets;
mod wire;

pub use defects::{Defect, Defects};
pub use error::AppError;
pub use messages::Unsupported;
pub(super) use remote::{AppRemote, AppSetup};
