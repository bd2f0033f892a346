//! Player of the paper's protocol: a server process and its client.

use rhumb_protocol::scene::Command;

use super::interface::{FrameCost, Player, PlayerFactory, PlayerSetup, PlayerTotals, Traffic};
use crate::drive::app::{AppRemote, AppSetup};
use crate::drive::error::DriveError;
use crate::drive::remote::Retention;
use crate::record::Mode;

/// A client that leads a scene on a server of its own.
struct AppPlayer {
    remote: AppRemote,
    traffic: Traffic,
}

/// Factory of players that use the paper's protocol.
pub(super) struct OverApp;

impl PlayerFactory for OverApp {
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let remote = AppRemote::start(&AppSetup {
            mode,
            defects: player_setup.defects,
            config: player_setup.config,
            controller_script: None,
            cpu: player_setup.cpu.clone(),
            keep: Retention::Costs,
        })?;
        Ok(Box::new(AppPlayer {
            remote,
            traffic: Traffic::default(),
        }))
    }
}

impl Player for AppPlayer {
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
        let (traffic, ends_lost) = (self.traffic, self.remote.ends_lost());
        // The scene starts with its first frame.
        if self.remote.ticks() == 0 {
            return Ok(PlayerTotals {
                traffic,
                ..PlayerTotals::default()
            });
        }
        Ok(PlayerTotals {
            ends_lost,
            ..PlayerTotals::of(&self.remote.inspect()?, traffic)
        })
    }
}
