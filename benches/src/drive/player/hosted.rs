//! A server process and the client of one mode.

use rhumb_client::{Depth, StreamChoice};
use rhumb_protocol::scene::Command;
use rhumb_reckoning::Ticks;
use rhumb_transport::LinkTerms;

use super::processor::work_ns;
use super::{Account, Billing, Player, Stages, Took, Traffic, Troupe};
use crate::drive::DriveError;
use crate::drive::remote::{Keep, Remote, Setup};
use crate::record::Mode;

/// A client of a server that steps for it alone.
struct Hosted {
    remote: Remote,
    traffic: Traffic,
}

/// Plays at a server of its own, by this protocol.
pub(super) struct OverRhumb;

impl Troupe for OverRhumb {
    fn start(&self, billing: &Billing, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let depth = if mode.is_ahead() {
            Depth::PIPELINED
        } else {
            Depth::LOCKSTEP
        };
        let stream = match mode {
            Mode::Naive => StreamChoice::Full,
            _ => StreamChoice::Within(billing.tolerance),
        };
        begin(billing, stream, depth)
    }
}

/// The reckoned stream at any depth.
pub(crate) fn hosted_at(billing: &Billing, depth: Depth) -> Result<Box<dyn Player>, DriveError> {
    begin(billing, StreamChoice::Within(billing.tolerance), depth)
}

fn begin(
    billing: &Billing,
    stream: StreamChoice,
    depth: Depth,
) -> Result<Box<dyn Player>, DriveError> {
    let remote = Remote::start(&Setup {
        stream,
        depth,
        delay: Ticks::ZERO,
        terms: billing.terms,
        beside: None,
        housing: billing.housing.clone(),
        link: &LinkTerms::PERFECT,
        seed: billing.seed,
        bodies: billing.bodies,
        keep: Keep::Costs,
    })?;
    Ok(Box::new(Hosted {
        remote,
        traffic: Traffic::default(),
    }))
}

impl Player for Hosted {
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
        self.remote.client().wait(Depth::LOCKSTEP)?;
        let inspection = self.remote.inspect()?;
        Ok(Account {
            tick: inspection.tick,
            truth: inspection.truth,
            awake: inspection.awake,
            stages: Stages::of(&inspection.times),
            traffic: self.traffic,
            ends_lost: 0,
        })
    }
}
