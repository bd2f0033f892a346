//! The laws that a body may follow, and for how long each holds.
//!
//! Every judgement here is by the normative prediction against the recording.

use std::num::NonZeroU32;

use glam::DVec3;
use rhumb_reckoning::{
    Conditions, Cursor, Divergence, FlowTable, HORIZON, Integrator, Metres, Motion, Pose,
    Predictor, Push, Rate, Ticks, Tolerance, Twist, carried, seen_from,
};

use super::path::Path;

/// A law of the closed list, in the world or in the frame of a body that holds. Bodies that tumble do so by either of the
/// moving ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Law {
    Rest,
    Held,
    Uniform,
    Ballistic,
    Pushed,
}

impl Law {
    /// Cheapest first: where two hold equally long, the first is taken.
    pub(super) const ALL: [Self; 5] = [
        Self::Rest,
        Self::Held,
        Self::Uniform,
        Self::Ballistic,
        Self::Pushed,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Held => "held",
            Self::Uniform => "uniform",
            Self::Ballistic => "ballistic",
            Self::Pushed => "pushed",
        }
    }

    /// As it is for a body that tumbles, or does not, and is pushed so, if it is.
    const fn predictor(self, tumbles: bool, push: Option<Push>) -> Predictor {
        if let Some(push) = push {
            return Predictor::Pushed(push);
        }
        match self {
            Self::Rest | Self::Held => Predictor::Rest,
            Self::Uniform | Self::Pushed if tumbles => Predictor::Tumbling,
            Self::Uniform | Self::Pushed => Predictor::Uniform,
            Self::Ballistic if tumbles => Predictor::Thrown,
            Self::Ballistic => Predictor::Ballistic,
        }
    }

    pub(super) const fn moves(self) -> bool {
        matches!(self, Self::Uniform | Self::Ballistic | Self::Pushed)
    }
}

/// A body that may hold others, and where it is believed to be at each frame of its own.
#[derive(Clone, Debug)]
pub(super) struct Holder {
    pub(super) radius: Metres,
    pub(super) first: usize,
    pub(super) believed: Vec<Motion>,
}

impl Holder {
    pub(super) fn at(&self, frame: usize) -> Option<&Motion> {
        self.believed.get(frame.checked_sub(self.first)?)
    }
}

/// A motion from which a body goes on by a law.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saying {
    pub(super) law: Law,
    /// The frame at which the motion holds.
    pub(super) frame: usize,
    /// In the world, or as the holder sees it.
    pub(super) motion: Motion,
    /// Place of the holder.
    pub(super) holder: Option<usize>,
    /// What pushes it, by that law and no other.
    pub(super) push: Option<Push>,
}

/// What motions of one kind of damping become, by ticks: `p = p₀ + reach·v₀ + fall·g`, or `p₀ + reach·v₀ + pushed·a` for a push of
/// the acceleration a, and the angle for each rad/s.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    pub(super) flow: FlowTable,
    pub(super) reach: Vec<f64>,
    pub(super) fall: Vec<f64>,
    pub(super) pushed: Vec<f64>,
    pub(super) turn: Vec<f64>,
}

/// A spin so slow that the angle is as good as proportional to it, rad/s.
const SLOW: f64 = 1e-3;

impl Basis {
    /// Read off the normative prediction itself.
    pub(super) fn new(integrator: Integrator, path: &Path) -> Self {
        let mut flow = FlowTable::new(integrator, path.damping);
        flow.extend_to(HORIZON);
        let start = Motion::new(
            Pose::IDENTITY,
            Twist {
                linear: DVec3::X,
                angular: DVec3::Z * SLOW,
            },
        )
        .expect("these numbers are finite");
        let conditions = Conditions {
            gravity: DVec3::Y,
            flow: &flow,
            inertia: None,
        };
        let after = |law: Predictor| {
            let ticks = 0..=HORIZON.count();
            let ends = ticks.map(|ticks| law.predict(&start, Ticks::new(ticks), &conditions));
            ends.collect::<Vec<_>>()
        };
        let ends = after(Predictor::Ballistic);
        let position = |end: &Motion| end.pose().position;
        let by = Push::SAMPLE.acceleration().y;
        let pushed = after(Predictor::Pushed(Push::SAMPLE));
        Self {
            reach: ends.iter().map(|end| position(end).x).collect(),
            fall: ends.iter().map(|end| position(end).y).collect(),
            pushed: pushed.iter().map(|end| position(end).y / by).collect(),
            turn: ends
                .iter()
                .map(|end| 2.0 * end.pose().rotation.z.asin() / SLOW)
                .collect(),
            flow,
        }
    }
}

/// One body's way, and what may be said of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course<'a> {
    pub(super) path: &'a Path,
    pub(super) basis: &'a Basis,
    pub(super) holders: &'a [Holder],
    pub(super) tolerance: Tolerance,
    pub(super) rate: Rate,
    pub(super) every: NonZeroU32,
}

impl Course<'_> {
    /// Ticks from one frame to a later one, as far as a prediction reaches.
    pub(super) fn ticks(&self, from: usize, to: usize) -> Ticks {
        let ticks = (to - from) as u64 * u64::from(self.every.get());
        Ticks::new(ticks.min(u64::from(HORIZON.count())) as u32)
    }

    /// The frame after the last at which a law that is said now may still hold.
    pub(super) fn horizon(&self, law: Law, from: usize) -> usize {
        if law.moves() {
            let frames = HORIZON.count() / self.every.get();
            self.path.end().min(from + frames as usize + 1)
        } else {
            self.path.end()
        }
    }

    /// Where the body is, as the holder sees it if there is one; none when the holder is gone.
    pub(super) fn target(&self, frame: usize, holder: Option<usize>) -> Option<Motion> {
        let truth = self.path.at(frame);
        let Some(holder) = holder else {
            return Some(*truth);
        };
        let by = self.holders[holder].at(frame)?;
        Some(seen_from(&by.pose(), &truth.pose()))
    }

    /// How a saying goes on for this body.
    pub(super) const fn predictor(&self, saying: &Saying) -> Predictor {
        saying
            .law
            .predictor(self.path.inertia.is_some(), saying.push)
    }

    /// What a saying makes of a frame, in its own frame of reference.
    pub(super) fn predicted(&self, saying: &Saying, frame: usize, cursor: &mut Cursor) -> Motion {
        let conditions = Conditions {
            gravity: self.path.gravity,
            flow: &self.basis.flow,
            inertia: self.path.inertia.as_ref(),
        };
        let ticks = self.ticks(saying.frame, frame);
        let law = self.predictor(saying);
        law.predict_with(&saying.motion, ticks, &conditions, cursor)
    }

    /// The same in the world; none when the holder is gone.
    pub(super) fn believed(
        &self,
        saying: &Saying,
        frame: usize,
        cursor: &mut Cursor,
    ) -> Option<Motion> {
        let predicted = self.predicted(saying, frame, cursor);
        match saying.holder {
            None => Some(predicted),
            Some(holder) => {
                let by = self.holders[holder].at(frame)?;
                Some(carried(by, &predicted.pose()))
            }
        }
    }

    /// How far off a saying is at a frame.
    pub(super) fn apart(
        &self,
        saying: &Saying,
        frame: usize,
        cursor: &mut Cursor,
    ) -> Option<Divergence> {
        let believed = self.believed(saying, frame, cursor)?;
        Some(Divergence::between(
            &self.path.at(frame).pose(),
            &believed.pose(),
        ))
    }

    /// The frame after the last to which a saying keeps the promise without a gap.
    pub(super) fn holds_until(&self, saying: &Saying) -> usize {
        let end = self.horizon(saying.law, saying.frame);
        let mut cursor = Cursor::default();
        for frame in saying.frame..end {
            // What lies still in truth and belief is no farther off than before.
            let still = saying.law == Law::Rest && frame > saying.frame && self.path.is_same(frame);
            if still {
                continue;
            }
            let within = self
                .apart(saying, frame, &mut cursor)
                .is_some_and(|apart| self.tolerance.share(&apart, self.path.radius) <= 1.0);
            if !within {
                return frame;
            }
        }
        end
    }
}
