//! The golden vectors: files, messages as the codec reads them, replays.

mod golden;
mod replay;
mod sender;
mod upstream;

pub use golden::golden;
pub use replay::{agrees, deliver, greeted, known, replayed};
pub use sender::{Decoded, Sender, error_json, framed_bytes, in_pieces};
pub use upstream::upstream_states;
