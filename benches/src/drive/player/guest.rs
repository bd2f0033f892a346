//! A server process and its client by the paper's protocol.

use rhumb_protocol::scene::Command;

use super::processor::work_ns;
use super::{Account, Billing, Player, Stages, Took, Traffic, Troupe};
use crate::drive::DriveError;
use crate::drive::app::{AppRemote, AppSetup};
use crate::drive::remote::Keep;
use crate::record::Mode;

/// A client that leads a scene of a server that steps for it alone.
struct Guest {
    remote: AppRemote,
    traffic: Traffic,
}

/// Plays at a server of its own, by the paper's protocol.
pub(super) struct OverApp;

impl Troupe for OverApp {
    fn start(&self, billing: &Billing, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let remote = AppRemote::start(&AppSetup {
            mode,
            losses: billing.losses,
            terms: billing.terms,
            beside: None,
            housing: billing.housing.clone(),
            keep: Keep::Costs,
        })?;
        Ok(Box::new(Guest {
            remote,
            traffic: Traffic::default(),
        }))
    }
}

impl Player for Guest {
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.remote.prepare(commands)
    }

    fn frame(&mut self, commands: &[Command]) -> Result<Took, DriveError> {
        let work = work_ns();
        self.remote.frame(commands)?;
        let work_ns = work_ns().zip(work).map(|(after, before)| after - before);
        let frame = self.remote.take_frame().unwrap_or_default();
        self.traffic.add(&frame);
        Ok(Took {
            wall_ns: frame.frame_ns,
            work_ns,
        })
    }

    fn account(&mut self) -> Result<Account, DriveError> {
        let (traffic, ends_lost) = (self.traffic, self.remote.ends_lost());
        // Its scene begins with its first frame.
        if self.remote.ticks() == 0 {
            return Ok(Account {
                traffic,
                ..Account::default()
            });
        }
        let inspection = self.remote.inspect()?;
        Ok(Account {
            tick: inspection.tick,
            truth: inspection.truth,
            awake: inspection.awake,
            stages: Stages::of(&inspection.times),
            traffic,
            ends_lost,
        })
    }
}
