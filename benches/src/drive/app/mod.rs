//! The paper's protocol as a mode: its client and the measurement of it.
mod defects;
mod messages;
mod polled;
mod remote;
mod replica;
mod sockets;
mod wire;

pub use defects::{Defect, Defects};
pub use messages::Unsupported;
pub use remote::AppError;
pub(super) use remote::{AppRemote, AppSetup};
