//! The owner's end of a fed scene: what is checked before it is handed over.
//!
//! Invariant: what is wrong is refused before any of it is handed over.

use rhumb_protocol::limits::{ANGULAR_MAX, COORDINATE_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{Command, CommandError, SceneName};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::{AnsweredBefore, FedRequest, FedVelocities, Feed, TICKS_APART_MAX};

use crate::error::{FedQuantity, FeedError, OutOfRange};

/// A scene that its client feeds.
pub(crate) struct Feeding {
    feed: Feed,
    /// Wakes the scene for the changes that were handed over.
    wake: Box<dyn Fn(&Feed) + Send>,
    bodies: FedBodies,
}

/// The bodies that may be fed. By index: one more than the generation of the body that is there, or zero.
#[derive(Default)]
struct FedBodies {
    there: Vec<u32>,
    /// Bodies of the present states, where these are not in the order of ids.
    seen: Vec<bool>,
}

impl FedBodies {
    fn add(&mut self, id: BodyId) {
        let place = id.index() as usize;
        if place >= self.there.len() {
            self.there.resize(place + 1, 0);
        }
        self.there[place] = u32::from(id.generation()) + 1;
    }

    fn remove(&mut self, id: BodyId) {
        if self.has(id) {
            self.there[id.index() as usize] = 0;
        }
    }

    fn has(&self, id: BodyId) -> bool {
        let there = self.there.get(id.index() as usize);
        there.is_some_and(|there| *there == u32::from(id.generation()) + 1)
    }

    /// Checks that each state is of a body that may be fed, and of one that no other is of.
    fn check(&mut self, states: &[(BodyId, BodyState)]) -> Result<(), FeedError> {
        for (place, (body, state)) in states.iter().enumerate() {
            if !self.has(*body) {
                return Err(FeedError::UnknownBody { place, body: *body });
            }
            check_state(place, *body, state)?;
        }
        if states.is_sorted_by(|(one, _), (other, _)| one < other) {
            return Ok(());
        }
        self.seen.clear();
        self.seen.resize(self.there.len(), false);
        for (id, _) in states {
            if core::mem::replace(&mut self.seen[id.index() as usize], true) {
                return Err(FeedError::Twice(*id));
            }
        }
        Ok(())
    }
}

/// Checks the numbers of a state against the limits of commands.
fn check_state(place: usize, body: BodyId, state: &BodyState) -> Result<(), FeedError> {
    let parts = state.parts();
    let ranges = [
        (0..3, COORDINATE_MAX, FedQuantity::Position),
        (7..10, LINEAR_MAX, FedQuantity::Linear),
        (10..13, ANGULAR_MAX, FedQuantity::Angular),
    ];
    for (range, most, quantity) in ranges {
        let mut values = parts[range].iter().copied();
        if let Some(value) = values.find(|value| value.abs() > most) {
            return Err(FeedError::OutOfRange(OutOfRange {
                state: (place, body),
                quantity,
                value,
                most,
            }));
        }
    }
    Ok(())
}

impl Feeding {
    /// `wake` has the scene look at what was handed over.
    pub(crate) fn new(feed: Feed, wake: impl Fn(&Feed) + Send + 'static) -> Self {
        Self {
            feed,
            wake: Box::new(wake),
            bodies: FedBodies::default(),
        }
    }

    /// Checks the name of the scene that its client joins.
    pub(crate) fn check_join(&self, scene: &SceneName) -> Result<(), FeedError> {
        let fed = self.feed.name();
        match fed == scene {
            true => Ok(()),
            false => Err(FeedError::OtherScene(fed.clone())),
        }
    }

    /// The tick of the newest states that were handed over.
    pub(crate) const fn newest(&self) -> Tick {
        self.feed.newest()
    }

    /// Notes a body that is in the scene, or comes by a command.
    pub(crate) fn add(&mut self, id: BodyId) {
        self.bodies.add(id);
    }

    /// Notes a body that is gone.
    pub(crate) fn remove(&mut self, id: BodyId) {
        self.bodies.remove(id);
    }

    /// Checks states before they are handed over; the error names the first wrong one.
    pub(crate) fn check(
        &mut self,
        tick: Tick,
        states: &[(BodyId, BodyState)],
    ) -> Result<(), FeedError> {
        let (newest, most) = (self.feed.newest(), TICKS_APART_MAX);
        match tick.value().saturating_sub(newest.value()) {
            0 => return Err(FeedError::TickNotLater { tick, newest }),
            apart if apart > most => return Err(FeedError::TicksApart { tick, newest, most }),
            _ => {}
        }
        self.bodies.check(states)
    }

    /// True if as many ticks wait for the scene as may.
    pub(crate) fn is_full(&self) -> bool {
        self.feed.is_full()
    }

    /// Hands checked states over; `commands`: the number of commands that were sent before.
    pub(crate) fn push(
        &mut self,
        (tick, commands): (Tick, u64),
        states: &[(BodyId, BodyState)],
        velocities: FedVelocities,
    ) {
        self.feed.push(tick, states, velocities, commands);
        self.wake();
    }

    /// The oldest unread request of another member.
    pub(crate) fn poll_request(&self) -> Option<FedRequest> {
        self.feed.poll_request()
    }

    /// Answers a request.
    pub(crate) fn answer(
        &self,
        request: FedRequest,
        refused: Option<CommandError>,
    ) -> Result<(), FeedError> {
        let answered = match refused {
            None => self.feed.accept(request),
            Some(error) => self.feed.refuse(request, error),
        };
        answered.map_err(|AnsweredBefore| FeedError::Answered)?;
        self.wake();
        Ok(())
    }

    /// The oldest request that was accepted and that the scene refused. A body that it would have added is no longer
    /// fed, and one that it would have removed is fed again.
    pub(crate) fn poll_failure(&mut self) -> Option<(FedRequest, CommandError)> {
        let (request, error) = self.feed.poll_failure()?;
        match (change_of(&request.command), error) {
            (FedChange::Adds(_), CommandError::BodyIdTaken(_))
            | (FedChange::Removes(_), CommandError::UnknownBody(_))
            | (FedChange::None, _) => {}
            (FedChange::Adds(id), _) => self.bodies.remove(id),
            (FedChange::Removes(id), _) => self.bodies.add(id),
        }
        Some((request, error))
    }

    fn wake(&self) {
        (self.wake)(&self.feed);
    }
}

/// Effect of a command on the bodies that may be fed.
pub(crate) enum FedChange {
    None,
    Adds(BodyId),
    Removes(BodyId),
}

/// The effect of a command.
pub(crate) const fn change_of(command: &Command) -> FedChange {
    match command {
        Command::AddBody { desc, .. } => FedChange::Adds(desc.id),
        Command::RemoveBody { id } => FedChange::Removes(*id),
        _ => FedChange::None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f32) -> BodyState {
        BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap()
    }

    #[test]
    fn a_wrong_state_is_named_with_its_value_its_limit_and_what_to_do() {
        let mut bodies = FedBodies::default();
        let body = |index| BodyId::new(index, 0);
        (0..3).for_each(|index| bodies.add(body(index)));
        let mut error = |states: &[(BodyId, BodyState)]| {
            let checked = bodies.check(states);
            checked.map_or_else(|error| error.to_string(), |()| String::new())
        };
        assert_eq!(error(&[(body(2), at(1.0)), (body(0), at(2.0))]), "");
        let unknown = error(&[(body(0), at(0.0)), (body(3), at(0.0))]);
        assert!(
            unknown.contains("state 1") && unknown.contains("add it first"),
            "{unknown}"
        );
        let twice = error(&[(body(1), at(0.0)), (body(0), at(0.0)), (body(1), at(0.0))]);
        assert!(twice.contains("two states"), "{twice}");
        let far = error(&[(body(0), at(2e5))]);
        assert!(
            far.contains("200000 m") && far.contains("100000 m"),
            "{far}"
        );
        let fast = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0, -150.0, 0.0]);
        let fast = error(&[(body(0), fast.unwrap())]);
        assert!(
            fast.contains("-150 rad/s") && fast.contains("leave velocities out"),
            "{fast}"
        );
    }

    #[test]
    fn a_body_that_was_removed_is_unknown_and_so_is_one_of_another_generation() {
        let mut bodies = FedBodies::default();
        let (first, next) = (BodyId::new(4, 0), BodyId::new(4, 1));
        bodies.add(first);
        assert!(bodies.has(first) && !bodies.has(next));
        bodies.remove(first);
        assert!(!bodies.has(first));
        bodies.add(next);
        bodies.remove(first);
        assert!(bodies.has(next));
    }
}
