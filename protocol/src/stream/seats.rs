//! Which body sits where: small numbers for those that are much spoken of.
//!
//! Both ends keep seatings. The publisher decides, and says each seating; a listener that missed one finds the seat
//! empty or its body's track of another age, and never takes one body for another (PROTOCOL 6.13). While something is
//! missing it remembers who sat where, within a bound beyond which it knows of nobody.

use alloc::collections::{BTreeSet, BinaryHeap};
use alloc::vec::Vec;
use core::cmp::Reverse;
use core::num::NonZeroU32;

use rhumb_reckoning::Tick;

use crate::limits::SEATINGS_KEPT;
use crate::room::grow_to;

/// Who sits where, and of each seat something more.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seating<T> {
    /// By seat, one more than the index of its body.
    seats: Vec<(Option<NonZeroU32>, T)>,
    /// By index, one more than the seat; 0 for none.
    of_body: Vec<u32>,
}

impl<T: Clone + Default> Seating<T> {
    /// The body in a seat.
    pub(crate) fn body(&self, seat: u32) -> Option<u32> {
        let (body, _) = self.seats.get(seat as usize)?;
        Some((*body)?.get() - 1)
    }

    /// The seat of a body.
    pub(crate) fn of(&self, body: u32) -> Option<u32> {
        self.of_body.get(body as usize)?.checked_sub(1)
    }

    /// A body takes a seat; who sat there stands.
    fn put(&mut self, seat: u32, body: u32, more: T) {
        let place = seat as usize;
        grow_to(&mut self.seats, place + 1, || (None, T::default()));
        grow_to(&mut self.of_body, body as usize + 1, || 0);
        self.leave(body);
        if let Some(before) = self.body(seat) {
            self.of_body[before as usize] = 0;
        }
        self.seats[place] = (NonZeroU32::new(body + 1), more);
        self.of_body[body as usize] = seat + 1;
    }

    /// Who sits there stands, and nobody takes the seat.
    fn empty(&mut self, seat: u32, more: T) {
        let place = seat as usize;
        grow_to(&mut self.seats, place + 1, || (None, T::default()));
        if let Some(before) = self.body(seat) {
            self.of_body[before as usize] = 0;
        }
        self.seats[place] = (None, more);
    }

    /// A body leaves its seat, if it has one; returns which.
    pub(crate) fn leave(&mut self, body: u32) -> Option<u32> {
        let seat = self.of(body)?;
        self.of_body[body as usize] = 0;
        self.seats[seat as usize].0 = None;
        Some(seat)
    }
}

/// A tick in two words: in one it would make room for nothing beside it.
#[derive(Clone, Copy, Debug, Default)]
struct Since([u32; 2]);

impl Since {
    const fn of(tick: Tick) -> Self {
        Self([tick.value() as u32, (tick.value() >> 32) as u32])
    }

    const fn tick(self) -> Tick {
        let Self([low, high]) = self;
        Tick::new(low as u64 | (high as u64) << 32)
    }
}

/// What is known of a body that is said to sit somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sitter {
    /// Nothing that is newer.
    AsSaid,
    /// It was heard of since, or is not there any more.
    GoneOn,
}

/// From this tick on a body sat in a seat, or nobody that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Change {
    seat: u32,
    body: Option<u32>,
    since: Tick,
}

/// The seats as a listener knows them: with when each was said.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seats {
    now: Seating<Since>,
    /// Who sat where while packets are missing that may name them so, as it was heard: of one tick the last counts.
    changes: Vec<Change>,
    remembers: bool,
    /// More was heard than is kept, so that nothing is known of before.
    overflowed: bool,
    /// The newest tick of which a repair told: who sat where before it may have been said in what it stands for.
    repaired: Tick,
}

impl Seats {
    /// The body that sits in a seat since a tick or earlier, if that is known.
    pub(crate) fn body_since(&self, seat: u32, tick: Tick) -> Option<u32> {
        self.now.body(seat).filter(|_| self.since(seat) <= tick)
    }

    /// The body that sat in a seat at a tick and does no more, if that is known. It is not while anything is missing that was
    /// said before that tick.
    pub(crate) fn body_then(&self, seat: u32, tick: Tick) -> Option<u32> {
        if tick < self.repaired || self.overflowed {
            return None;
        }
        let by_then = || self.changes.iter().filter(|change| change.since <= tick);
        let here = by_then().filter(|change| change.seat == seat);
        let last = here.max_by_key(|change| change.since)?;
        let went = |other: &Change| other.body == last.body && other.since > last.since;
        last.body.filter(|_| !by_then().any(went))
    }

    /// Something is missing: who sits where is remembered from now on.
    pub(crate) const fn remember(&mut self) {
        self.remembers = true;
    }

    /// Nothing is missing any more.
    pub(crate) fn forget(&mut self) {
        self.changes.clear();
        (self.remembers, self.overflowed) = (false, false);
    }

    /// Something was made good by what its bodies do at this tick.
    pub(crate) fn repair(&mut self, as_of: Tick) {
        self.repaired = self.repaired.max(as_of);
    }

    fn note(&mut self, seat: u32, body: Option<u32>, since: Tick) {
        if !self.remembers || self.overflowed {
            return;
        }
        // What was noted last of its seat and tick is not noted again (PROTOCOL 6.13-15).
        let mut newest_first = self.changes.iter().rev();
        let last = newest_first.find(|change| change.seat == seat && change.since == since);
        if last.is_some_and(|change| change.body == body) {
            return;
        }
        if self.changes.len() < SEATINGS_KEPT {
            self.changes.push(Change { seat, body, since });
        } else {
            self.overflowed = true;
        }
    }

    /// Who sits in a seat will do so no longer.
    fn note_sitter(&mut self, seat: u32) {
        if let Some(body) = self.now.body(seat) {
            self.note(seat, Some(body), self.since(seat));
        }
    }

    /// A body takes a seat; who sat there stands. What was said later of either stays.
    ///
    /// Who has gone on since takes none: where it sits now was said with what was heard later. Then who sits there is not
    /// known, unless it is this body still.
    pub(crate) fn take(&mut self, seat: u32, body: u32, tick: Tick, sitter: Sitter) {
        let later = |seat: u32| self.since(seat) > tick;
        let (gone_on, had) = (sitter == Sitter::GoneOn, self.now.of(body));
        let (taken, moved) = (later(seat), had.is_some_and(later));
        self.note(seat, Some(body), tick);
        if taken || (gone_on && had == Some(seat)) {
            return;
        }
        self.note_sitter(seat);
        if gone_on || moved {
            self.now.empty(seat, Since::of(tick));
        } else {
            if let Some(had) = had {
                self.note_sitter(had);
            }
            self.now.put(seat, body, Since::of(tick));
        }
    }

    /// A body leaves its seat after this tick, if it has one.
    pub(crate) fn leave(&mut self, body: u32, tick: Tick) {
        if let Some(seat) = self.now.of(body) {
            self.note_sitter(seat);
            self.note(seat, None, tick.next());
            self.now.leave(body);
        }
    }

    /// A body is another one now, or another one than was believed: where it sat is not known.
    pub(crate) fn dismiss(&mut self, body: u32) {
        self.now.leave(body);
        for change in &mut self.changes {
            change.body = change.body.filter(|other| *other != body);
        }
    }

    /// A body had no seat at a tick; one that it took later stays.
    pub(crate) fn leave_by(&mut self, body: u32, tick: Tick) {
        if let Some(seat) = self.now.of(body)
            && self.since(seat) <= tick
        {
            self.note_sitter(seat);
            self.note(seat, None, tick);
            self.now.leave(body);
        }
    }

    /// When a seat was taken last.
    fn since(&self, seat: u32) -> Tick {
        let seat = self.now.seats.get(seat as usize);
        seat.map_or(Tick::ZERO, |(_, since)| since.tick())
    }
}

/// Gives seats out: the lowest that is free.
///
/// Seats that were left cost nothing, however many were taken once: it is looked where somebody sits.
#[derive(Clone, Debug, Default)]
pub(crate) struct Usher {
    /// With the low bits of the tick at which its body was last spoken of.
    seats: Seating<u32>,
    free: BinaryHeap<Reverse<u32>>,
    /// Left since the last sweep: not given out before the next, so that no two bodies sit there in one tick.
    left: Vec<u32>,
    /// Seats from here on were never taken.
    end: u32,
    /// Where it is looked for who is silent: blocks of seats in which somebody sits, or sat at the last look.
    blocks: BTreeSet<u32>,
    swept: Tick,
}

/// Who was silent for so many ticks loses its seat when others need one.
const SILENT_TICKS: u64 = 60;
/// Seats are looked at by so many: a list of them takes little room beside them.
const BLOCK: u32 = 64;

impl Usher {
    /// The seats as they are.
    pub(crate) const fn seats(&self) -> &Seating<u32> {
        &self.seats
    }

    /// The seat of a body that is spoken of, and whether it takes it now.
    pub(crate) fn seat(&mut self, body: u32, tick: Tick) -> (u32, bool) {
        if let Some(seat) = self.seats.of(body) {
            self.seats.seats[seat as usize].1 = tick.value() as u32;
            return (seat, false);
        }
        let seat = self.free.pop().map_or_else(
            || {
                self.end += 1;
                self.end - 1
            },
            |Reverse(seat)| seat,
        );
        self.blocks.insert(seat / BLOCK);
        self.seats.put(seat, body, tick.value() as u32);
        (seat, true)
    }

    /// A body comes to rest or goes; its seat is free from the next tick on.
    pub(crate) fn leave(&mut self, body: u32) {
        if let Some(seat) = self.seats.leave(body) {
            self.left.push(seat);
        }
    }

    /// Frees the seats of those who were silent for long; to be called once a tick, before anybody speaks. Returns how many
    /// seats it looked at.
    pub(crate) fn sweep(&mut self, tick: Tick) -> u64 {
        let mut looked = 0;
        if tick.value() >= self.swept.value() + SILENT_TICKS {
            self.swept = tick;
            looked = self.leave_the_silent(tick);
        }
        self.free.extend(self.left.drain(..).map(Reverse));
        looked
    }

    fn leave_the_silent(&mut self, tick: Tick) -> u64 {
        let mut looked = 0;
        let mut blocks = core::mem::take(&mut self.blocks);
        blocks.retain(|block| {
            let mut taken = false;
            for seat in block * BLOCK..self.end.min((block + 1) * BLOCK) {
                looked += 1;
                let (_, spoken) = self.seats.seats[seat as usize];
                let silent = (tick.value() as u32).wrapping_sub(spoken);
                let Some(body) = self.seats.body(seat) else {
                    continue;
                };
                if u64::from(silent) >= SILENT_TICKS {
                    self.leave(body);
                } else {
                    taken = true;
                }
            }
            taken
        });
        self.blocks = blocks;
        looked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_free_seat_is_given_and_silence_loses_it() {
        let mut usher = Usher::default();
        for (body, seat) in [(70, 0), (3, 1), (900, 2)] {
            assert_eq!(usher.seat(body, Tick::new(1)), (seat, true));
        }
        usher.leave(3);
        assert_eq!(usher.seat(8, Tick::new(1)), (3, true));
        usher.sweep(Tick::new(2));
        assert_eq!(usher.seat(70, Tick::new(50)), (0, false));
        assert_eq!(usher.seat(4, Tick::new(50)), (1, true));
        usher.sweep(Tick::new(70));
        assert_eq!(usher.seats().of(900), None);
        assert_eq!(usher.seat(5, Tick::new(70)), (2, true));
        assert_eq!(usher.seat(6, Tick::new(70)), (3, true));
    }

    #[test]
    fn what_was_said_later_stays() {
        let mut seats = Seats::default();
        seats.take(4, 9, Tick::new(10), Sitter::AsSaid);
        seats.take(4, 7, Tick::new(8), Sitter::AsSaid);
        assert_eq!(
            (seats.now.body(4), seats.now.of(9), seats.now.of(7)),
            (Some(9), Some(4), None)
        );
        seats.take(2, 9, Tick::new(11), Sitter::AsSaid);
        assert_eq!((seats.now.body(4), seats.now.body(2)), (None, Some(9)));
        seats.take(2, 7, Tick::new(12), Sitter::AsSaid);
        assert_eq!((seats.now.of(9), seats.now.of(7)), (None, Some(2)));
        seats.take(5, 7, Tick::new(11), Sitter::AsSaid);
        assert_eq!((seats.now.body(5), seats.now.of(7)), (None, Some(2)));
    }

    #[test]
    fn what_is_said_again_takes_no_room() {
        let mut seats = left_at_twelve();
        for _ in 0..=SEATINGS_KEPT {
            seats.take(4, 9, Tick::new(10), Sitter::GoneOn);
        }
        assert_eq!(seats.body_then(4, Tick::new(11)), Some(9));
        for since in 0..=SEATINGS_KEPT as u64 {
            seats.take(5, 8, Tick::new(since), Sitter::GoneOn);
        }
        assert_eq!(seats.body_then(4, Tick::new(11)), None);
    }

    /// Seats that remember, in which body 9 sat in seat 4 from tick 10 on and came to rest at tick 12.
    fn left_at_twelve() -> Seats {
        let mut seats = Seats::default();
        seats.remember();
        seats.take(4, 9, Tick::new(10), Sitter::AsSaid);
        seats.leave(9, Tick::new(12));
        seats
    }

    #[test]
    fn who_left_while_something_is_missing_is_known_to_have_sat_there() {
        let mut seats = left_at_twelve();
        let sitters = |seats: &Seats, seat| {
            [9, 10, 12, 13, 15].map(|tick| {
                let tick = Tick::new(tick);
                let now = seats.body_since(seat, tick);
                now.or_else(|| seats.body_then(seat, tick))
            })
        };
        assert_eq!(sitters(&seats, 4), [None, Some(9), Some(9), None, None]);
        seats.take(4, 7, Tick::new(15), Sitter::AsSaid);
        assert_eq!(sitters(&seats, 4), [None, Some(9), Some(9), None, Some(7)]);
        // Heard late: another one took it between the two.
        seats.take(4, 6, Tick::new(13), Sitter::GoneOn);
        assert_eq!(
            sitters(&seats, 4),
            [None, Some(9), Some(9), Some(6), Some(7)]
        );
        // Heard later still: body 9 had gone elsewhere before.
        seats.take(5, 9, Tick::new(11), Sitter::AsSaid);
        assert_eq!(sitters(&seats, 4), [None, Some(9), None, Some(6), Some(7)]);
        seats.repair(Tick::new(13));
        assert_eq!(sitters(&seats, 4), [None, None, None, Some(6), Some(7)]);
        seats.forget();
        assert_eq!(sitters(&seats, 4), [None, None, None, None, Some(7)]);
    }

    #[test]
    fn where_one_sat_who_was_removed_nobody_is_known_nor_who_sat_there_before() {
        let mut seats = left_at_twelve();
        seats.take(4, 7, Tick::new(8), Sitter::AsSaid);
        seats.dismiss(9);
        let then = [8, 9, 10, 11].map(|tick| seats.body_then(4, Tick::new(tick)));
        assert_eq!(then, [Some(7), Some(7), None, None]);
    }

    #[test]
    fn who_would_have_to_remember_too_much_knows_nobody() {
        let mut seats = left_at_twelve();
        for body in 0..SEATINGS_KEPT as u32 {
            seats.take(5, 100 + body, Tick::new(20), Sitter::AsSaid);
        }
        assert_eq!(seats.body_then(4, Tick::new(11)), None);
        seats.forget();
        assert_eq!(
            seats.body_since(5, Tick::new(20)),
            Some(99 + SEATINGS_KEPT as u32)
        );
    }

    #[test]
    fn who_was_heard_of_since_takes_no_seat_of_before() {
        let mut seats = Seats::default();
        seats.take(4, 9, Tick::new(10), Sitter::AsSaid);
        seats.take(4, 7, Tick::new(12), Sitter::GoneOn);
        assert_eq!((seats.now.body(4), seats.now.of(9)), (None, None));
        seats.take(4, 9, Tick::new(11), Sitter::AsSaid);
        assert_eq!(seats.now.of(9), None);
        seats.take(4, 9, Tick::new(13), Sitter::AsSaid);
        seats.take(4, 9, Tick::new(14), Sitter::GoneOn);
        assert_eq!(seats.body_since(4, Tick::new(13)), Some(9));
    }
}
