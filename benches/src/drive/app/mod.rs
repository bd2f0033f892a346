//! The paper's protocol as a mode: its client, beside the others.
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
