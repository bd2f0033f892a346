//! Bits of updates under an ideal adaptive coder.
//!
//! No packet is written. Each choice costs the logarithm of its frequency among earlier choices (Krichevsky and
//! Trofimov, 1981), so the cost of learning is included. Contexts are simple: predictors, axes, and time since a
//! body's last update.

use std::collections::BTreeMap;

use super::context::PredictorKind;
use super::segments::SegmentUpdate;

/// Bits of the parts of the updates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Bits {
    /// Ids of the bodies updated in each frame.
    pub(super) body_ids: f64,
    /// Choice of predictors.
    pub(super) predictors: f64,
    /// Positions and rotations.
    pub(super) poses: f64,
    /// Velocities.
    pub(super) velocities: f64,
}

impl Bits {
    pub(super) fn sum(&self) -> f64 {
        self.body_ids + self.predictors + self.poses + self.velocities
    }
}

/// Context of a choice; choices in one context share statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Decision {
    Named { silent: u32, still: bool },
    PredictorKind { last: PredictorKind },
    OtherParent,
    OtherAcceleration { last: PredictorKind },
    Implied { predictors: [PredictorKind; 2] },
    Zero(Number),
    Sign(Number),
    Longer(Number, u32),
    Second(Number),
}

/// Context of a number in an update: predictors, quantity and axis.
type Number = ([PredictorKind; 2], CodedQuantity, u8);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CodedQuantity {
    Position,
    Turn,
    Linear,
    Angular,
    ConstantAcceleration,
}

/// Counts of each alternative per context.
#[derive(Debug, Default)]
struct AdaptiveModel {
    counts: BTreeMap<Decision, [f64; PredictorKind::ALL.len()]>,
}

impl AdaptiveModel {
    /// Bits of one of `of` alternatives.
    fn choose(&mut self, place: Decision, chosen: usize, of: usize) -> f64 {
        let counts = self
            .counts
            .entry(place)
            .or_insert([0.5; PredictorKind::ALL.len()]);
        let all: f64 = counts[..of].iter().sum();
        let bits = -(counts[chosen] / all).log2();
        counts[chosen] += 1.0;
        bits
    }

    fn decide(&mut self, place: Decision, yes: bool) -> f64 {
        self.choose(place, usize::from(yes), 2)
    }

    /// Zero flag, sign, binary length and second digit; lower digits count as random.
    fn number(&mut self, number: Number, value: i32) -> f64 {
        let mut bits = self.decide(Decision::Zero(number), value == 0);
        if value == 0 {
            return bits;
        }
        bits += self.decide(Decision::Sign(number), value < 0);
        let size = value.unsigned_abs();
        let length = size.ilog2();
        for digit in 0..=length {
            bits += self.decide(Decision::Longer(number, digit), digit < length);
        }
        if length > 0 {
            let second = size >> (length - 1) & 1 == 1;
            bits += self.decide(Decision::Second(number), second) + f64::from(length - 1);
        }
        bits
    }

    fn numbers(
        &mut self,
        predictors: [PredictorKind; 2],
        kind: CodedQuantity,
        values: [i32; 3],
    ) -> f64 {
        let axes = values.into_iter().zip(0..);
        axes.map(|(value, axis)| self.number((predictors, kind, axis), value))
            .sum()
    }

    fn update(&mut self, update: &SegmentUpdate, bits: &mut Bits) {
        let predictors = update.predictors;
        let [last, next] = predictors;
        bits.predictors += self.choose(
            Decision::PredictorKind { last },
            next as usize,
            PredictorKind::ALL.len(),
        );
        if next == PredictorKind::Attached {
            bits.predictors += self.decide(Decision::OtherParent, update.changes_parent);
        }
        if next == PredictorKind::ConstantAcceleration {
            bits.predictors += self.decide(
                Decision::OtherAcceleration { last },
                update.constant_acceleration.is_some(),
            );
        }
        if let Some(constant_acceleration) = update.constant_acceleration {
            bits.predictors += self.numbers(
                predictors,
                CodedQuantity::ConstantAcceleration,
                constant_acceleration.steps().map(i32::from),
            );
            bits.predictors += self.number(
                (predictors, CodedQuantity::ConstantAcceleration, 3),
                i32::from(constant_acceleration.exponent()),
            );
        }
        let residual = &update.residual;
        bits.poses += self.numbers(predictors, CodedQuantity::Position, residual.position);
        bits.poses += self.numbers(predictors, CodedQuantity::Turn, residual.turn);
        if next.moves() {
            let implied = residual.velocity.is_none();
            bits.velocities += self.decide(Decision::Implied { predictors }, implied);
        }
        if let Some(velocity) = residual.velocity {
            bits.velocities += self.numbers(predictors, CodedQuantity::Linear, velocity.linear);
            bits.velocities += self.numbers(predictors, CodedQuantity::Angular, velocity.angular);
        }
    }
}

/// Frames since a body's last update, by powers of two; not counted while the body is absent.
#[derive(Clone, Copy, Debug)]
struct SilentSpan {
    since: usize,
    until: usize,
    predictor: PredictorKind,
}

/// Bits of all updates, sorted by frame and body. `present` gives each body's first frame, end frame and first
/// predictor.
pub(super) fn bits(
    updates: &[SegmentUpdate],
    present: &[(usize, usize, PredictorKind)],
    frames: usize,
) -> Bits {
    let mut silences: Vec<_> = present
        .iter()
        .map(|&(since, until, predictor)| SilentSpan {
            since,
            until,
            predictor,
        })
        .collect();
    let mut model = AdaptiveModel::default();
    let mut bits = Bits::default();
    let mut updates = updates.iter().peekable();
    for frame in 0..frames {
        for (body, silence) in silences.iter_mut().enumerate() {
            if frame <= silence.since || frame >= silence.until {
                continue;
            }
            let updated = updates.next_if(|update| update.frame == frame && update.body == body);
            let place = Decision::Named {
                silent: (frame - silence.since).ilog2(),
                still: silence.predictor == PredictorKind::Rest,
            };
            bits.body_ids += model.decide(place, updated.is_some());
            if let Some(update) = updated {
                model.update(update, &mut bits);
                (silence.since, silence.predictor) = (frame, update.predictors[1]);
            }
        }
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::Residual;

    fn update(frame: usize, body: usize, x: i32) -> SegmentUpdate {
        SegmentUpdate {
            frame,
            body,
            predictors: [PredictorKind::Rest; 2],
            changes_parent: false,
            constant_acceleration: None,
            residual: Residual {
                position: [x, 0, 0],
                ..Residual::default()
            },
        }
    }

    #[test]
    fn a_constant_value_costs_almost_nothing() {
        let present = vec![(0, 1_001, PredictorKind::Rest); 1];
        let updates: Vec<_> = (1..=1_000).map(|frame| update(frame, 0, 0)).collect();
        let bits = bits(&updates, &present, 1_001);
        assert!(bits.sum() < 100.0, "{bits:?}");
    }

    #[test]
    fn a_random_value_costs_its_entropy() {
        // Two-digit positions, all equally likely.
        let present = vec![(0, 4_001, PredictorKind::Rest); 1];
        let value = |frame: usize| [-3, -2, 2, 3][((frame * 2_654_435_761) >> 7) & 3];
        let updates: Vec<_> = (1..=4_000).map(|f| update(f, 0, value(f))).collect();
        let bits = bits(&updates, &present, 4_001);
        let each = bits.poses / 4_000.0;
        assert!((each - 2.0).abs() < 0.05, "{each}");
    }
}
