//! The golden vectors: the files, the codec's side of a message, and streams replayed.

mod golden;
mod replay;
mod sender;

pub use golden::golden;
pub use replay::{deliver, greeted, known, replayed};
pub use sender::{Decoded, Sender, error_json, framed_bytes};
