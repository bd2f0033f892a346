//! What updates would take from an ideal coder that learns as it goes.
//!
//! No packet is written. Each choice costs the logarithm of how likely those before made it (Krichevsky and Trofimov,
//! 1981), so that what a coder has to learn is paid for. Contexts are simple: laws, axes, and how long a body was
//! silent.

use std::collections::BTreeMap;

use super::course::Law;
use super::segments::Update;

/// What the parts of the updates take, bits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Bits {
    /// Which bodies are spoken of in each frame.
    pub(super) naming: f64,
    /// By which law each goes on.
    pub(super) laws: f64,
    /// Positions and turns.
    pub(super) poses: f64,
    /// Velocities.
    pub(super) velocities: f64,
}

impl Bits {
    pub(super) fn sum(&self) -> f64 {
        self.naming + self.laws + self.poses + self.velocities
    }
}

/// Where a choice stands; choices in one place are alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Named { silent: u32, still: bool },
    Law { last: Law },
    OtherHolder,
    OtherPush { last: Law },
    Implied { laws: [Law; 2] },
    Zero(Number),
    Sign(Number),
    Longer(Number, u32),
    Second(Number),
}

/// Which number of an update: its laws, its kind and its axis.
type Number = ([Law; 2], Kind, u8);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Position,
    Turn,
    Linear,
    Angular,
    Push,
}

/// How often each alternative was taken.
#[derive(Debug, Default)]
struct Learnt {
    counts: BTreeMap<Place, [f64; Law::ALL.len()]>,
}

impl Learnt {
    /// Bits of one of `of` alternatives.
    fn choose(&mut self, place: Place, taken: usize, of: usize) -> f64 {
        let counts = self.counts.entry(place).or_insert([0.5; Law::ALL.len()]);
        let all: f64 = counts[..of].iter().sum();
        let bits = -(counts[taken] / all).log2();
        counts[taken] += 1.0;
        bits
    }

    fn decide(&mut self, place: Place, yes: bool) -> f64 {
        self.choose(place, usize::from(yes), 2)
    }

    /// Zero or not, sign, length of the size in binary, its second digit; those below are taken as chance.
    fn number(&mut self, number: Number, value: i32) -> f64 {
        let mut bits = self.decide(Place::Zero(number), value == 0);
        if value == 0 {
            return bits;
        }
        bits += self.decide(Place::Sign(number), value < 0);
        let size = value.unsigned_abs();
        let length = size.ilog2();
        for digit in 0..=length {
            bits += self.decide(Place::Longer(number, digit), digit < length);
        }
        if length > 0 {
            let second = size >> (length - 1) & 1 == 1;
            bits += self.decide(Place::Second(number), second) + f64::from(length - 1);
        }
        bits
    }

    fn numbers(&mut self, laws: [Law; 2], kind: Kind, values: [i32; 3]) -> f64 {
        let axes = values.into_iter().zip(0..);
        axes.map(|(value, axis)| self.number((laws, kind, axis), value))
            .sum()
    }

    fn update(&mut self, update: &Update, bits: &mut Bits) {
        let laws = update.laws;
        let [last, next] = laws;
        bits.laws += self.choose(Place::Law { last }, next as usize, Law::ALL.len());
        if next == Law::Held {
            bits.laws += self.decide(Place::OtherHolder, update.changes_holder);
        }
        if next == Law::Pushed {
            bits.laws += self.decide(Place::OtherPush { last }, update.push.is_some());
        }
        if let Some(push) = update.push {
            bits.laws += self.numbers(laws, Kind::Push, push.steps().map(i32::from));
            bits.laws += self.number((laws, Kind::Push, 3), i32::from(push.doublings()));
        }
        let residual = &update.residual;
        bits.poses += self.numbers(laws, Kind::Position, residual.position);
        bits.poses += self.numbers(laws, Kind::Turn, residual.turn);
        if next.moves() {
            let implied = residual.velocity.is_none();
            bits.velocities += self.decide(Place::Implied { laws }, implied);
        }
        if let Some(velocity) = residual.velocity {
            bits.velocities += self.numbers(laws, Kind::Linear, velocity.linear);
            bits.velocities += self.numbers(laws, Kind::Angular, velocity.angular);
        }
    }
}

/// A body's silence, by powers of two of frames; a body that is not there is spoken of by nobody.
#[derive(Clone, Copy, Debug)]
struct Silence {
    since: usize,
    until: usize,
    law: Law,
}

/// Bits of all updates, which come in order of frames and bodies; `present`: from which frame until which each body is
/// there, and by which law it begins.
pub(super) fn bits(updates: &[Update], present: &[(usize, usize, Law)], frames: usize) -> Bits {
    let mut silences: Vec<_> = present
        .iter()
        .map(|&(since, until, law)| Silence { since, until, law })
        .collect();
    let mut learnt = Learnt::default();
    let mut bits = Bits::default();
    let mut updates = updates.iter().peekable();
    for frame in 0..frames {
        for (body, silence) in silences.iter_mut().enumerate() {
            if frame <= silence.since || frame >= silence.until {
                continue;
            }
            let spoken = updates.next_if(|update| update.frame == frame && update.body == body);
            let place = Place::Named {
                silent: (frame - silence.since).ilog2(),
                still: silence.law == Law::Rest,
            };
            bits.naming += learnt.decide(place, spoken.is_some());
            if let Some(update) = spoken {
                learnt.update(update, &mut bits);
                (silence.since, silence.law) = (frame, update.laws[1]);
            }
        }
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::Residual;

    fn update(frame: usize, body: usize, x: i32) -> Update {
        Update {
            frame,
            body,
            laws: [Law::Rest; 2],
            changes_holder: false,
            push: None,
            residual: Residual {
                position: [x, 0, 0],
                ..Residual::default()
            },
        }
    }

    #[test]
    fn what_is_always_so_costs_next_to_nothing() {
        let present = vec![(0, 1_001, Law::Rest); 1];
        let updates: Vec<_> = (1..=1_000).map(|frame| update(frame, 0, 0)).collect();
        let bits = bits(&updates, &present, 1_001);
        assert!(bits.sum() < 100.0, "{bits:?}");
    }

    #[test]
    fn what_is_left_to_chance_costs_what_chance_costs() {
        // Positions of two digits, as likely as each other.
        let present = vec![(0, 4_001, Law::Rest); 1];
        let value = |frame: usize| [-3, -2, 2, 3][((frame * 2_654_435_761) >> 7) & 3];
        let updates: Vec<_> = (1..=4_000).map(|f| update(f, 0, value(f))).collect();
        let bits = bits(&updates, &present, 4_001);
        let each = bits.poses / 4_000.0;
        assert!((each - 2.0).abs() < 0.05, "{each}");
    }
}
