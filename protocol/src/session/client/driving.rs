//! How a member drives bodies of its scene: what it asked for, and its stream.
//!
//! Packets go as datagrams where the server's clock leads, and on the control stream, before the advance that they are
//! for, where members do.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, Tick, Tolerance, Verbatim};

use super::ClientSession;
use crate::limits::DRIVEN_MAX;
use crate::message::{ClientMessage, Drive, DriveError, Driving};
use crate::scene::{Command, Pace};
use crate::session::driver::{Driver, Told};
use crate::session::event::Event;
use crate::session::misuse::Misuse;
use crate::stream::{Manner, PublisherStatistics};
use crate::time::Instant;

/// What a member drives.
#[derive(Debug)]
pub(super) struct Wheel {
    driver: Option<Driver>,
    /// What was asked for and is not answered yet.
    wished: Option<Drive>,
    /// What was granted last.
    granted: Option<Drive>,
}

impl Wheel {
    pub(super) const fn new() -> Self {
        Self {
            driver: None,
            wished: None,
            granted: None,
        }
    }

    /// A body has left the scene.
    pub(super) fn remove(&mut self, id: BodyId) {
        for drive in [&mut self.wished, &mut self.granted].into_iter().flatten() {
            drive.bodies.retain(|body| *body != id);
        }
        if let Some(driver) = &mut self.driver {
            driver.remove(id);
        }
    }

    fn wishes(&self, id: BodyId) -> bool {
        let drives = [&self.wished, &self.granted].into_iter().flatten();
        drives.into_iter().any(|drive| drive.bodies.contains(&id))
    }
}

impl ClientSession {
    /// Drives these kinematic bodies from now on, in place of those that it drove before; none ends it. Answered by
    /// `Driving` or `NotDriving`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], while an earlier wish is not answered, and [`Misuse::TooManyDriven`].
    pub fn drive(&mut self, tolerance: Tolerance, bodies: &[BodyId]) -> Result<(), Misuse> {
        let mut bodies = bodies.to_vec();
        bodies.sort_unstable();
        bodies.dedup();
        if bodies.len() > DRIVEN_MAX {
            return Err(Misuse::TooManyDriven(bodies.len()));
        }
        if self.wheel.wished.is_some() {
            return Err(Misuse::NotNow);
        }
        let drive = Drive { tolerance, bodies };
        self.as_member(&ClientMessage::Drive(drive.clone()))?;
        self.wheel.wished = Some(drive);
        Ok(())
    }

    /// Says how the driven bodies move at a tick, as far as the server does not predict it; those that are not named stand
    /// still where they were named last. Returns whether the tick was taken: not before the wish to drive is granted, nor
    /// if one as new was taken before.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NotDriven`], and [`Misuse::Invalid`] for a number that no engine should be given;
    /// nothing is said then.
    pub fn publish(&mut self, tick: Tick, motions: &[(BodyId, Verbatim)]) -> Result<bool, Misuse> {
        self.must_be(super::State::Member)?;
        for (id, motion) in motions {
            if !self.wheel.wishes(*id) {
                return Err(Misuse::NotDriven(*id));
            }
            Command::check_motion(motion).map_err(Misuse::Invalid)?;
        }
        let Some(driver) = &mut self.wheel.driver else {
            return Ok(false);
        };
        let mut packets = Vec::new();
        match driver.publish(tick, motions, &mut packets) {
            Told::Yes => {}
            Told::Before => return Ok(false),
            Told::TooFar => {
                self.ask_again();
                return Ok(false);
            }
        }
        self.send_upstream(packets);
        Ok(true)
    }

    /// The bodies that it drives, in rising order.
    pub fn driven(&self) -> impl Iterator<Item = BodyId> {
        self.wheel.driver.iter().flat_map(Driver::bodies)
    }

    /// What it said of the bodies that it drives, since they were granted.
    #[must_use]
    pub fn upstream(&self) -> Option<PublisherStatistics> {
        self.wheel.driver.as_ref().map(Driver::statistics)
    }

    fn send_upstream(&mut self, packets: Vec<Bytes>) {
        let led = self.terms.is_some_and(|terms| terms.pace == Pace::Lockstep);
        if !led {
            return self.send_states(packets);
        }
        for packet in packets {
            self.say(&ClientMessage::Upstream(packet.to_vec()));
        }
    }

    /// A stream that goes on no more begins anew; what is asked for already will do that too.
    fn ask_again(&mut self) {
        self.wheel.driver = None;
        if self.wheel.wished.is_some() {
            return;
        }
        let granted = self.wheel.granted.take();
        if let Some(drive) = granted.filter(|drive| !drive.bodies.is_empty()) {
            self.say(&ClientMessage::Drive(drive.clone()));
            self.wheel.wished = Some(drive);
        }
    }

    pub(super) fn hear_driving(&mut self, driving: &Driving) {
        let (Some(wished), Some(terms)) = (self.wheel.wished.take(), self.terms) else {
            return;
        };
        let copy = self.copies.shown();
        let manner = |id: BodyId| {
            let body = copy?.body(id)?;
            let shape = copy?.shape(body.shape)?;
            Some(Manner::of(&body, shape, terms.damping, None))
        };
        let driver = Driver::new(driving, wished.tolerance, terms.integrator, manner);
        let bodies: Vec<BodyId> = driver.bodies().collect();
        self.wheel.driver = (!bodies.is_empty()).then_some(driver);
        self.wheel.granted = Some(wished);
        self.events.push_back(Event::Driving(bodies));
    }

    pub(super) fn hear_not_driving(&mut self, error: DriveError) {
        if error == DriveError::LostTouch {
            return self.ask_again();
        }
        self.wheel.wished = None;
        self.events.push_back(Event::NotDriving(error));
        if self.wheel.driver.is_none() {
            self.ask_again();
        }
    }

    /// Whether a datagram is about the stream of what is driven; if so, answers it.
    pub(super) fn hear_of_upstream(&mut self, now: Instant, datagram: &[u8]) -> bool {
        let Some(driver) = self
            .wheel
            .driver
            .as_mut()
            .filter(|driver| driver.is_about(datagram))
        else {
            return false;
        };
        let mut answers = Vec::new();
        driver.handle_datagram(now, self.round_trip, datagram, &mut answers);
        self.send_upstream(answers);
        true
    }
}
