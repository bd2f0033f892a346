//! The commands that a free-running scene takes between two of its steps.
//!
//! Commands and steps share the thread of a scene. On a scene that is late, commands get as much time as its ticks: without
//! that, a scene that is filled takes one turn of commands for each tick, however long the tick is. A body makes the next
//! step longer by more than its command takes, the more so if many stand on one: so the bodies that are added between two
//! steps are bounded by how long the steps before were. A snapshot has the same time, since it leaves in pieces as its
//! link takes them; that slows a scene on time, too, if its ticks fill more than half of their time. Reads no clock. A
//! driver that does not report what links take, as in a simulated network, has no bound.

use std::collections::BTreeSet;

use rhumb_protocol::{Instant, Peer, Span};

/// The commands since the last step, and how many may follow before the next.
#[derive(Debug)]
pub(crate) struct CommandPace {
    commands: usize,
    /// True if a snapshot was begun or continued.
    is_sending: bool,
    bodies: usize,
    /// The members that added them.
    adders: BTreeSet<Peer>,
    bodies_max: usize,
    /// Snapshots have this time, and commands if they are many.
    until: Instant,
}

/// Commands since a step from which on they are many: a turn of one connection.
const MANY: usize = 512;
/// Bodies that may always be added between two steps: some 0.4 s of a step if 80,000 stand on one.
const BODIES_LEAST: usize = 512;
/// Bodies that may be added between two steps at most: the record of a scene keeps their commands beside those before.
const BODIES_MOST: usize = 16_384;
/// A tick below this time lets twice as many bodies follow.
const SHORT: Span = Span::from_millis(250);
/// A tick beyond this time, half of the one after which a scene is stuck, lets half as many follow.
const LONG: Span = Span::from_millis(1_000);
/// Time of commands for one tick at most.
const SHARE_MAX: Span = Span::from_millis(250);

impl CommandPace {
    /// The pace of a scene that has not stepped.
    pub(crate) const fn new() -> Self {
        Self {
            commands: 0,
            is_sending: false,
            bodies: 0,
            adders: BTreeSet::new(),
            bodies_max: BODIES_LEAST,
            until: Instant::ZERO,
        }
    }

    /// Counts a command, whether it is applied or refused.
    pub(crate) const fn note_command(&mut self) {
        self.commands += 1;
    }

    /// The snapshot of a member begins, or its link took a piece of it.
    pub(crate) const fn note_snapshot(&mut self) {
        self.is_sending = true;
    }

    /// A member added a body.
    pub(crate) fn note_body(&mut self, peer: Peer) {
        self.bodies += 1;
        self.adders.insert(peer);
    }

    /// A tick that began at this moment took so long.
    pub(crate) fn note_tick(&mut self, now: Instant, took: Span) {
        let most = self.bodies_max;
        let was_needed = self.bodies >= most;
        self.bodies_max = match took {
            took if took > LONG || !was_needed => most / 2,
            took if took < SHORT => most * 2,
            _ => most,
        };
        self.bodies_max = self.bodies_max.clamp(BODIES_LEAST, BODIES_MOST);
        self.until = now + took + took.min(SHARE_MAX);
        (self.commands, self.bodies, self.is_sending) = (0, 0, false);
        self.adders.clear();
    }

    /// The moment before which no step begins: that at which snapshots have had their time, and commands if they are many.
    pub(crate) const fn next_step(&self) -> Instant {
        match self.commands >= MANY || self.is_sending {
            true => self.until,
            false => Instant::ZERO,
        }
    }

    /// True if the messages of a member wait for the next step: it adds bodies, and so many were added as may be.
    pub(crate) fn holds_back(&self, peer: Peer) -> bool {
        self.bodies >= self.bodies_max && self.adders.contains(&peer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADDER: Peer = Peer(1);
    const OTHER: Peer = Peer(2);

    /// Bodies that one member may add before the next step.
    fn fill(pace: &mut CommandPace) -> usize {
        let mut bodies = 0;
        while !pace.holds_back(ADDER) {
            pace.note_body(ADDER);
            bodies += 1;
        }
        bodies
    }

    #[test]
    fn twice_as_many_bodies_follow_short_ticks_and_half_as_many_a_long_one() {
        let mut pace = CommandPace::new();
        let mut filled = Vec::new();
        for took in [1, 10, 200, 400, 1_100, 1_100, 1] {
            filled.push(fill(&mut pace));
            pace.note_tick(Instant::ZERO, Span::from_millis(took));
        }
        assert_eq!(filled, [512, 1_024, 2_048, 4_096, 4_096, 2_048, 1_024]);
    }

    #[test]
    fn what_was_not_used_is_lost_and_the_most_is_bounded() {
        let mut pace = CommandPace::new();
        for _ in 0..10 {
            fill(&mut pace);
            pace.note_tick(Instant::ZERO, Span::ZERO);
        }
        assert_eq!(fill(&mut pace), BODIES_MOST);
        for _ in 0..10 {
            pace.note_tick(Instant::ZERO, Span::ZERO);
        }
        assert_eq!(fill(&mut pace), BODIES_LEAST);
    }

    #[test]
    fn only_members_that_add_bodies_wait() {
        let mut pace = CommandPace::new();
        fill(&mut pace);
        assert!(pace.holds_back(ADDER) && !pace.holds_back(OTHER));
        pace.note_tick(Instant::ZERO, Span::ZERO);
        assert!(!pace.holds_back(ADDER));
    }

    #[test]
    fn many_commands_have_as_much_time_as_the_tick_and_no_more_than_their_share() {
        let at = |ms| Instant::ZERO + Span::from_millis(ms);
        let mut pace = CommandPace::new();
        pace.note_tick(at(100), Span::from_millis(40));
        assert_eq!(pace.next_step(), Instant::ZERO, "there are none");
        (0..MANY).for_each(|_| pace.note_command());
        assert_eq!(pace.next_step(), at(180));
        pace.note_tick(at(180), Span::from_millis(40));
        pace.note_snapshot();
        assert_eq!(pace.next_step(), at(260), "a snapshot has it, too");
        pace.note_tick(at(180), Span::from_millis(1_000));
        (0..MANY).for_each(|_| pace.note_command());
        assert_eq!(pace.next_step(), at(1_430));
    }
}
