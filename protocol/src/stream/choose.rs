//! Which saying will serve a body best: for how long, and for how many bits.
//!
//! Only the publisher chooses, so that nothing here is normative: any choice keeps the promise, a good one keeps it
//! with fewer bytes. How long a saying holds is judged by what the same law would have made of the last two ticks, or,
//! with hindsight, by what the body did.

mod pushing;
mod trial;

use glam::DVec3;
use rhumb_reckoning::{
    Divergence, HORIZON, Metres, Motion, Pose, Predictor, Tick, Ticks, Tolerance, Track, Twist,
    carried, seen_from,
};

use super::features::Features;
use super::tracks::{Slot, Tracks};
use crate::packet::{Age, Course, Saying, Tongue};
use pushing::PUSHES;
use trial::{Best, Trial};

/// What is known of a body that is to be spoken of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    /// Its index.
    pub(crate) index: u32,
    /// Its place in the table.
    pub(crate) slot: &'a Slot,
    /// The tick that is spoken of.
    pub(crate) tick: Tick,
    /// What it does then, and what is believed of it.
    pub(crate) truth: Motion,
    pub(crate) believed: Motion,
    /// What it did one and two ticks before.
    pub(crate) past: [Option<Motion>; 2],
    /// What it will do, as far as hindsight knows.
    pub(crate) ahead: &'a [Motion],
    /// Whether it is known that nothing is seen of it after that.
    pub(crate) ends: bool,
    /// What could hold it.
    pub(crate) holder: Option<Holder<'a>>,
}

/// A body that another may be held by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Holder<'a> {
    /// Its index.
    pub(crate) index: u32,
    /// Its place in the table.
    pub(crate) slot: &'a Slot,
    /// What it does at the tick that is spoken of.
    pub(crate) truth: Motion,
    /// What it did one and two ticks before.
    pub(crate) past: [Option<Motion>; 2],
    /// What it will do.
    pub(crate) ahead: &'a [Motion],
}

/// Courses that are tried: rest, a law that falls, one that does not, being held, and being pushed.
const WAYS: usize = 4 + PUSHES;
/// Places that a still body is put on: where it is, and the middle of its way in one, two, four and six ticks.
const AIMS: usize = 5;
/// Steps are rounded to the nearest.
const NEAREST: [f64; 2] = [0.5; 2];
/// What the ticks of a track's whole life add to the expected error of the next, as a share of the tolerance …
const DOUBT_OF_A_LIFE: f64 = 0.1;
/// … and each tick, at least and at most.
const DOUBT: [f64; 2] = [0.001, 0.05];
/// What an update costs beside its saying: its place in the packet, in 1/256 bits.
pub(super) const OVERHEAD: u32 = 4 * 256;
/// The ticks at which an expected error is looked at.
const LOOKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];
/// How many ticks more a push is expected to last.
const PUSH_LASTS: f64 = 16.0;
/// How far a still body is put ahead of its course, as a share of the tolerance.
const AIM_MOST: f64 = 0.5;

/// A saying that keeps the promise, the track it leads to, and what it is worth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Choice {
    pub(crate) saying: Saying,
    pub(crate) track: Track,
}

/// Chooses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chooser<'a> {
    pub(crate) tracks: &'a Tracks,
    /// What a packet expects at its beginning.
    pub(crate) tongue: &'a Tongue,
    pub(crate) features: Features,
    /// Factor on the tolerances by which lives are judged: more than one where a budget does not suffice, less for
    /// bodies that hold others.
    pub(crate) slack: f64,
}

/// How a body strays from a law, by ticks: α·h + β·h², of position (m) and of turn (rad).
#[derive(Clone, Copy, Debug, Default)]
struct Stray {
    linear: [DVec3; 2],
    angular: [DVec3; 2],
}

impl Stray {
    /// From how far it strayed in one tick and in two.
    fn moving(one: [DVec3; 2], two: [DVec3; 2]) -> Self {
        let fit = |f1: DVec3, f2: DVec3| {
            let square = (f2 - f1 * 2.0) * 0.5;
            [f1 - square, square]
        };
        Self {
            linear: fit(one[0], two[0]),
            angular: fit(one[1], two[1]),
        }
    }

    /// Of a body that is said to be still, from how far it moved in its last tick and in its last two.
    fn still(one: [DVec3; 2], two: [DVec3; 2]) -> Self {
        let fit = |f1: DVec3, f2: DVec3| {
            let square = (f1 * 2.0 - f2) * 0.5;
            [f1 + square, square]
        };
        Self {
            linear: fit(one[0], two[0]),
            angular: fit(one[1], two[1]),
        }
    }

    fn after(&self, ticks: f64) -> [DVec3; 2] {
        let at = |[rate, square]: [DVec3; 2]| rate * ticks + square * (ticks * ticks);
        [at(self.linear), at(self.angular)]
    }
}

/// A course, and what it has to bring together.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way<'a> {
    pub(super) course: Course,
    pub(super) predictor: Predictor,
    pub(super) holder: Option<Holder<'a>>,
    /// Where the body is, and where it was predicted, in the frame of the course.
    pub(super) truth: Motion,
    pub(super) predicted: Motion,
    stray: Stray,
    /// For how many ticks it may go on at most, beyond those that are known.
    pub(super) lasts: f64,
}

/// Where to put a body beside where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Aim {
    /// Metres, and a rotation vector in radians.
    pose: [DVec3; 2],
}

impl Aim {
    /// Nothing beside the truth.
    const AT_TRUTH: Self = Self {
        pose: [DVec3::ZERO; 2],
    };
}

impl Chooser<'_> {
    /// The best saying among those that keep the promise, or `None` when no correction does.
    pub(crate) fn choose(&self, subject: &Subject<'_>) -> Option<Choice> {
        let track = &subject.slot.track();
        let ticks = subject.tick.since(track.origin)?;
        let aged = ticks > HORIZON && track.predictor != Predictor::Rest;
        let age = self.tracks.age(track, subject.tick)?;
        if age == Age::new(0) || aged || !self.features.residuals {
            return None;
        }
        let grid = self.tracks.grid(subject.slot);
        let case = Trial {
            chooser: self,
            subject,
            grid: &grid,
            age,
            over: track.predictor.astray(ticks, self.tracks.integrator().rate),
            allowance: self.allowance(subject),
        };
        let ways = self.ways(subject);
        // Free bodies are put on the same place whatever their law.
        let free = case.footing(&subject.believed, &subject.truth);
        let mut nearest = None;
        let mut best: Option<Best<'_, '_>> = None;
        for way in ways.iter().flatten() {
            let footing = match way.holder {
                None => free,
                Some(_) => case.footing(&way.predicted, &way.truth),
            };
            for aim in self.aims(subject, way).into_iter().flatten() {
                let mut place = if way.holder.is_some() || aim != Aim::AT_TRUTH {
                    case.place(way, &footing, aim, NEAREST)
                } else {
                    *nearest.get_or_insert_with(|| case.place(way, &footing, aim, NEAREST))
                };
                if let Some(place) = &mut place {
                    case.try_all(way, (&footing, aim), place, &mut best);
                }
            }
        }
        let mut best = best?;
        if self.features.sparse {
            case.make_sparser(&mut best);
        }
        Some(best.choice(&case))
    }

    /// The courses that a body may take.
    pub(super) fn ways<'s>(&self, subject: &Subject<'s>) -> [Option<Way<'s>>; WAYS] {
        let slot = subject.slot;
        let tumbles = slot.tumbles() && self.features.tumbling;
        let falls =
            self.features.ballistic && self.tracks.gravity(slot, subject.tick) != DVec3::ZERO;
        let now = &slot.track();
        let carrier = self.tracks.carrier(now);
        let carrier_age =
            carrier.and_then(|(_, slot)| self.tracks.age(&slot.track(), subject.tick));
        // A body whose carrier is gone can only be said anew.
        if now.carrier.is_some() && carrier.is_none() {
            return [None; WAYS];
        }
        let predicted = subject.believed;
        let way = |predictor, stray| Way {
            course: if now.carrier.is_none() && now.predictor == predictor {
                Course::Same
            } else {
                Course::World {
                    predictor,
                    carrier_age,
                }
            },
            predictor,
            holder: None,
            truth: subject.truth,
            predicted,
            stray,
            lasts: f64::INFINITY,
        };
        let (floating, falling) = if tumbles {
            (Predictor::Tumbling, Predictor::Thrown)
        } else {
            (Predictor::Uniform, Predictor::Ballistic)
        };
        let [drift, fall] = self.strays(subject, floating);
        let holder = subject.holder.filter(|_| self.features.held);
        let mut ways = [None; WAYS];
        ways[0] = Some(way(Predictor::Rest, self.stray_of_rest(subject)));
        ways[1] = Some(way(floating, drift));
        ways[2] = falls.then(|| way(falling, fall));
        ways[3] = holder.and_then(|holder| self.held(subject, holder, &predicted));
        let pushes = self.pushes(subject).map(|law| {
            let law = law?;
            let [stray, _] = self.strays(subject, law);
            Some(Way {
                lasts: PUSH_LASTS,
                ..way(law, stray)
            })
        });
        ways[4..].copy_from_slice(&pushes);
        ways
    }

    /// The course of being held by another body.
    fn held<'s>(
        &self,
        subject: &Subject<'_>,
        holder: Holder<'s>,
        predicted: &Motion,
    ) -> Option<Way<'s>> {
        let track = &subject.slot.track();
        let holding = holder.slot.track();
        let believed = self
            .tracks
            .framed((holder.index, holder.slot), &holding, subject.tick);
        let held_already = track.carrier == Some(holder.slot.id(holder.index));
        let course = if held_already {
            Course::Same
        } else if track.carrier.is_none()
            && holding.carrier.is_none()
            && holder.index != subject.index
        {
            Course::Held {
                carrier: holder.index,
                carrier_age: self.tracks.age(&holding, subject.tick)?,
            }
        } else {
            return None;
        };
        let predicted = if held_already {
            self.tracks
                .framed((subject.index, subject.slot), track, subject.tick)
        } else {
            seen_from(&believed.pose(), &predicted.pose())
        };
        let seen =
            |of: Option<Motion>, by: Option<Motion>| Some(seen_from(&by?.pose(), &of?.pose()));
        let now = seen_from(&holder.truth.pose(), &subject.truth.pose());
        let [one, two] = [0, 1].map(|i| {
            seen(subject.past[i], holder.past[i]).map(|then| apart(&now.pose(), &then.pose()))
        });
        // Of a body that was not seen before nothing says that it is held.
        let one = one?;
        let two = two.unwrap_or([one[0] * 2.0, one[1] * 2.0]);
        Some(Way {
            course,
            predictor: Predictor::Rest,
            holder: Some(holder),
            truth: seen_from(&believed.pose(), &subject.truth.pose()),
            predicted,
            stray: Stray::still(one, two),
            lasts: f64::INFINITY,
        })
    }

    /// How far a body moved in its last two ticks.
    fn stray_of_rest(&self, subject: &Subject<'_>) -> Stray {
        let now = &subject.truth;
        let Twist { linear, angular } = now.twist();
        let step = self.tracks.integrator().rate.step().seconds();
        let steady = |ticks: f64| [linear * (ticks * step), angular * (ticks * step)];
        let moved = |i: usize, ticks: f64| match subject.past[i] {
            Some(past) => apart(&now.pose(), &past.pose()),
            None => steady(ticks),
        };
        Stray::still(moved(0, 1.0), moved(1, 2.0))
    }

    /// How the last two ticks strayed from a law in the world that does not fall, and from the same that does.
    fn strays(&self, subject: &Subject<'_>, predictor: Predictor) -> [Stray; 2] {
        let now = subject.truth.pose();
        let strayed = |i: usize| {
            let (start, ticks) = (subject.past[i]?, Ticks::new(i as u32 + 1));
            let slot = subject.slot;
            let (expected, fall) =
                self.tracks
                    .continued(slot, predictor, &start, subject.tick, ticks);
            let expected = expected.pose();
            let fallen = Pose {
                position: expected.position + fall,
                ..expected
            };
            Some([expected, fallen].map(|expected| apart(&now, &expected)))
        };
        let (one, two) = (strayed(0), strayed(1));
        [0, 1].map(|law| match (one, two) {
            (Some(one), Some(two)) => Stray::moving(one[law], two[law]),
            (Some(one), None) => Stray::moving(one[law], one[law].map(|by| by * 4.0)),
            (None, _) => Stray::default(),
        })
    }

    /// Where to aim beside the truth: with hindsight, a still body is put in the middle of what it will do.
    fn aims(&self, subject: &Subject<'_>, way: &Way<'_>) -> [Option<Aim>; AIMS] {
        let mut aims = [None; AIMS];
        aims[0] = Some(Aim::AT_TRUTH);
        if way.predictor != Predictor::Rest {
            return aims;
        }
        let allowance = self.allowance(subject);
        for (place, ticks) in (1..).zip([1_usize, 2, 4, 6]) {
            let Some(then) = subject.ahead.get(ticks - 1) else {
                break;
            };
            let [mut p, mut q] = match way.holder {
                None => apart(&then.pose(), &subject.truth.pose()),
                Some(holder) => {
                    let Some(by) = holder.ahead.get(ticks - 1) else {
                        break;
                    };
                    let now = seen_from(&holder.truth.pose(), &subject.truth.pose());
                    apart(&seen_from(&by.pose(), &then.pose()).pose(), &now.pose())
                }
            };
            let share = allowance.share(p.length() * 0.5, q.length() * 0.5);
            let scale = 0.5 * (AIM_MOST / share).min(1.0);
            (p, q) = (p * scale, q * scale);
            aims[place] = Some(Aim { pose: [p, q] });
        }
        aims
    }

    /// How much of the tolerance the beginning of a track uses, as a listener would measure it.
    pub(super) fn exact_share(&self, subject: &Subject<'_>, way: &Way<'_>, begun: &Pose) -> f64 {
        let world = match way.holder {
            None => *begun,
            Some(Holder { index, slot, .. }) => {
                let track = slot.track();
                let by = self.tracks.framed((index, slot), &track, subject.tick);
                carried(&by, begun).pose()
            }
        };
        share(
            &subject.truth.pose(),
            &world,
            self.tracks.tolerance_of(subject.slot),
            self.tracks.radius(subject.slot),
        )
    }

    /// What may be expected of a body.
    pub(super) fn allowance(&self, subject: &Subject<'_>) -> Allowance {
        let tolerance = self.tracks.tolerance_of(subject.slot);
        Allowance::of(tolerance, self.tracks.radius(subject.slot)).loosened(self.slack)
    }

    /// For how many ticks a track that begins so will hold.
    fn life(
        &self,
        subject: &Subject<'_>,
        way: &Way<'_>,
        begun: &Motion,
        off: [DVec3; 2],
        allowance: Allowance,
    ) -> f64 {
        let mut held = 0.0;
        for (then, ticks) in subject.ahead.iter().zip(1..) {
            let (slot, ticks_on) = (subject.slot, Ticks::new(ticks));
            let mut motion =
                self.tracks
                    .foreseen(slot, way.predictor, begun, subject.tick, ticks_on);
            if let Some(holder) = way.holder
                && let Some(by) = holder.ahead.get(ticks as usize - 1)
            {
                motion = carried(by, &motion.pose());
            }
            let share = share(
                &then.pose(),
                &motion.pose(),
                self.tracks.tolerance_of(subject.slot),
                self.tracks.radius(subject.slot),
            );
            let share = share / self.slack;
            if share > 1.0 {
                return held + 1.0 - (share - 1.0).min(1.0) * 0.5;
            }
            held += 1.0;
        }
        let step = self.tracks.integrator().rate.step().seconds();
        let mut stray = way.stray;
        if way.predictor != Predictor::Rest {
            let (truth, said) = (way.truth.twist(), begun.twist());
            stray.linear[0] += (truth.linear - said.linear) * step;
            stray.angular[0] += (truth.angular - said.angular) * step;
        }
        let doubt = doubt(subject);
        let (mut at, mut before) = (0.0, allowance.share(off[0].length(), off[1].length()));
        for look in LOOKS {
            let [p, q] = stray.after(look);
            let share =
                allowance.share((p - off[0]).length(), (q - off[1]).length()) + doubt * look;
            if share > 1.0 {
                let part = ((1.0 - before) / (share - before)).clamp(0.0, 1.0);
                at += part * (look - at);
                break;
            }
            (at, before) = (look, share);
        }
        f64::max(at.min(way.lasts), held) + 1.0
    }
}

/// What each tick adds to the expected error of a body, as a share of the tolerance: less of one whose last track held for
/// long, as of what flies freely.
pub(super) fn doubt(subject: &Subject<'_>) -> f64 {
    let age = subject.tick.since(subject.slot.origin());
    let [least, most] = DOUBT;
    (DOUBT_OF_A_LIFE / f64::from(age.unwrap_or_default().count())).clamp(least, most)
}

/// What a tolerance allows a body, to reckon expected errors by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    position: f64,
    turn: f64,
    /// Whether both share one bound.
    shared: bool,
}

impl Allowance {
    pub(super) fn of(tolerance: Tolerance, radius: Metres) -> Self {
        match tolerance {
            Tolerance::Surface(length) => {
                let length = length.metres().metres();
                Self {
                    position: length,
                    turn: length / radius.metres(),
                    shared: true,
                }
            }
            Tolerance::Parts { position, turn } => Self {
                position: position.metres().metres(),
                turn: turn.radians().radians(),
                shared: false,
            },
        }
    }

    /// The same for tolerances so many times as wide.
    fn loosened(self, factor: f64) -> Self {
        Self {
            position: self.position * factor,
            turn: self.turn * factor,
            ..self
        }
    }

    /// Of an error in metres and one in radians.
    pub(super) fn share(&self, position: f64, turn: f64) -> f64 {
        let (position, turn) = (position / self.position, turn / self.turn);
        if self.shared {
            position + turn
        } else {
            position.max(turn)
        }
    }
}

/// How much of the tolerance lies between two poses of a body.
pub(crate) fn share(truth: &Pose, believed: &Pose, tolerance: Tolerance, radius: Metres) -> f64 {
    tolerance.share(&Divergence::between(truth, believed), radius)
}

/// How far one pose is from another, metres, and turned from it, as a rotation vector in radians.
pub(super) fn apart(to: &Pose, from: &Pose) -> [DVec3; 2] {
    let turn = to.rotation * from.rotation.conjugate();
    let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
    // Twice the sine of half the angle: near enough to the angle for what is within tolerance.
    let turn = DVec3::new(turn.x, turn.y, turn.z) * sign;
    [to.position - from.position, turn]
}
