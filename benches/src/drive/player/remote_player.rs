//! Player of one remote mode: a server process and its client.

use rhumb_client::{PipelineDepth, StreamChoice};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::scene::Command;
use rhumb_reckoning::Ticks;

use super::interface::{FrameCost, Player, PlayerFactory, PlayerSetup, PlayerTotals, Traffic};
use crate::drive::error::DriveError;
use crate::drive::remote::{Remote, Retention, Setup};
use crate::record::Mode;

/// A client of a server that steps for it alone.
struct RemotePlayer {
    remote: Remote,
    traffic: Traffic,
}

/// Factory of players that use the Rhumb protocol.
pub(super) struct OverRhumb;

impl PlayerFactory for OverRhumb {
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let depth = if mode.is_ahead() {
            PipelineDepth::PIPELINED
        } else {
            PipelineDepth::LOCKSTEP
        };
        let stream = match mode {
            Mode::Naive => StreamChoice::Full,
            _ => StreamChoice::Within(player_setup.tolerance),
        };
        begin(player_setup, stream, depth)
    }
}

/// Player of the predicted stream at any pipeline depth.
pub fn remote_player_at(
    player_setup: &PlayerSetup,
    depth: PipelineDepth,
) -> Result<Box<dyn Player>, DriveError> {
    begin(
        player_setup,
        StreamChoice::Within(player_setup.tolerance),
        depth,
    )
}

fn begin(
    player_setup: &PlayerSetup,
    stream: StreamChoice,
    depth: PipelineDepth,
) -> Result<Box<dyn Player>, DriveError> {
    let remote = Remote::start(&Setup {
        stream,
        depth,
        delay: Ticks::ZERO,
        config: player_setup.config,
        controller_script: None,
        cpu: player_setup.cpu.clone(),
        link: &LinkConfig::PERFECT,
        seed: player_setup.seed,
        bodies: player_setup.bodies,
        keep: Retention::Costs,
    })?;
    Ok(Box::new(RemotePlayer {
        remote,
        traffic: Traffic::default(),
    }))
}

impl Player for RemotePlayer {
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.remote.prepare(commands)
    }

    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError> {
        let run = || {
            self.remote.frame(commands)?;
            Ok(self.remote.take_frame().unwrap_or_default())
        };
        FrameCost::of(run, &mut self.traffic)
    }

    fn totals(&mut self) -> Result<PlayerTotals, DriveError> {
        self.remote.client().wait(PipelineDepth::LOCKSTEP)?;
        Ok(PlayerTotals::of(&self.remote.inspect()?, self.traffic))
    }
}
