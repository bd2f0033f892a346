//! The paper's protocol as a mode: its client, beside the others.
mod copy;
mod line;
mod losses;
mod polled;
mod remote;
mod wire;
mod words;

pub use losses::{Loss, Losses};
pub use remote::AppError;
pub(super) use remote::{AppRemote, AppSetup};
pub use words::Unsaid;
