//! Modes that step in turn and record only their cost.
//!
//! A frame covers the steps between two published ticks. A player keeps only the cost of a frame, neither poses nor
//! packets, so memory does not grow with the length of a run.

mod app_player;
mod interface;
mod local;
mod remote_player;

use super::error::DriveError;
use crate::record::Mode;

use app_player::OverApp;
use interface::PlayerFactory;
pub use interface::{FrameCost, Player, PlayerSetup, PlayerTotals, Stages, Traffic};
use local::InThread;
use remote_player::OverRhumb;
pub use remote_player::remote_player_at;

/// A playable mode and its factory.
pub struct Playable {
    /// The mode.
    pub mode: Mode,
    player_factory: &'static (dyn PlayerFactory + Sync),
}

/// All playable modes in the order of reports; adding a mode takes one entry.
const PLAYABLE: &[Playable] = &[
    Playable {
        mode: Mode::Integrated,
        player_factory: &InThread,
    },
    Playable {
        mode: Mode::AppAll,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::AppActive,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::AppPacked,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::Naive,
        player_factory: &OverRhumb,
    },
    Playable {
        mode: Mode::Rhumb,
        player_factory: &OverRhumb,
    },
    Playable {
        mode: Mode::RhumbPipelined,
        player_factory: &OverRhumb,
    },
];

/// The playable modes, in the order of reports.
pub fn playable() -> impl Iterator<Item = Mode> {
    PLAYABLE.iter().map(|playable| playable.mode)
}

/// Starts a mode; `None` if it is not playable.
pub fn start(
    mode: Mode,
    player_setup: &PlayerSetup,
) -> Option<Result<Box<dyn Player>, DriveError>> {
    let playable = PLAYABLE.iter().find(|playable| playable.mode == mode)?;
    Some(playable.player_factory.start(player_setup, mode))
}
