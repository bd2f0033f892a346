//! The courses that a body may take.
//!
//! In the world, or held by another body. Which of them serves best is not decided here.

use core::ops::Range;

use glam::DVec3;
use rhumb_reckoning::{Motion, Predictor, Push, seen_from};

use super::pushing::PUSHES;
use super::straying::{Drift, Stray};
use super::{Chooser, Holder, Subject, apart};
use crate::packet::{Age, Course};

/// Courses that are tried: rest, a law that falls, one that does not, being held, and being pushed.
const WAYS: usize = 4 + PUSHES;
/// How many ticks more a push is expected to last.
const PUSH_LASTS: f64 = 16.0;

/// What courses in one frame have to bring together.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame<'a> {
    /// Whose frame it is; none for the world.
    pub(crate) holder: Option<&'a Holder<'a>>,
    /// Where the body is, and where it was predicted.
    pub(crate) truth: Motion,
    pub(crate) predicted: Motion,
}

/// The frames of a body's courses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frames<'a> {
    pub(super) free: Frame<'a>,
    pub(super) held: Option<Held<'a>>,
}

/// How a body may be held.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held<'a> {
    pub(super) frame: Frame<'a>,
    course: Course,
    stray: Stray,
}

/// A course, and what is expected of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way<'a> {
    pub(crate) course: Course,
    pub(crate) predictor: Predictor,
    pub(crate) frame: &'a Frame<'a>,
    pub(super) stray: Stray,
    /// For how many ticks it may go on at most, beyond those that are known.
    pub(crate) lasts: f64,
}

/// The courses that a body may take, each made when it is asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ways<'f> {
    chooser: &'f Chooser<'f>,
    subject: &'f Subject<'f>,
    frames: &'f Frames<'f>,
    /// Of the body that holds it now.
    carrier_age: Option<Age>,
    /// A body whose carrier is gone can only be said anew.
    orphaned: bool,
    floating: Predictor,
    falling: Predictor,
    drift: Drift,
    /// What it may fall by, m/s².
    gravity: Option<DVec3>,
    pushes: [Option<Push>; PUSHES],
}

impl<'f> Ways<'f> {
    /// The numbers that there may be courses of.
    pub(crate) const fn numbers(&self) -> Range<usize> {
        0..if self.orphaned { 0 } else { WAYS }
    }

    /// One of them, if there is such a one.
    #[inline]
    pub(crate) fn way(&self, number: usize) -> Option<Way<'f>> {
        let (drift, endless) = (&self.drift, f64::INFINITY);
        let way = match number {
            0 => {
                if !self.chooser.features.resting {
                    return None;
                }
                let stray = self.chooser.stray_of_rest(self.subject);
                self.free(Predictor::Rest, stray, endless)
            }
            1 => self.free(self.floating, drift.stray(None), endless),
            2 => self.free(self.falling, drift.stray(Some(self.gravity?)), endless),
            3 => {
                let held = self.frames.held.as_ref()?;
                Way {
                    course: held.course,
                    predictor: Predictor::Rest,
                    frame: &held.frame,
                    stray: held.stray,
                    lasts: endless,
                }
            }
            _ => {
                let push = (*self.pushes.get(number - 4)?)?;
                let stray = drift.stray(Some(push.acceleration()));
                self.free(Predictor::Pushed(push), stray, PUSH_LASTS)
            }
        };
        Some(way)
    }

    /// A course in the world.
    #[inline]
    fn free(&self, predictor: Predictor, stray: Stray, lasts: f64) -> Way<'f> {
        let now = self.subject.track;
        Way {
            course: if now.carrier.is_none() && now.predictor == predictor {
                Course::Same
            } else {
                Course::World {
                    predictor,
                    carrier_age: self.carrier_age,
                }
            },
            predictor,
            frame: &self.frames.free,
            stray,
            lasts,
        }
    }
}

impl Way<'_> {
    /// Whether another body holds the body.
    pub(super) const fn is_held(&self) -> bool {
        self.frame.holder.is_some()
    }
}

impl Chooser<'_> {
    /// The frames of the courses that a body may take.
    pub(crate) fn frames<'s>(&self, subject: &'s Subject<'_>) -> Frames<'s> {
        let holder = subject.holder.as_ref().filter(|_| self.features.held);
        Frames {
            free: Frame {
                holder: None,
                truth: subject.truth,
                predicted: subject.believed,
            },
            held: holder.and_then(|holder| self.held(subject, holder)),
        }
    }

    /// The courses that a body may take.
    pub(crate) fn ways<'f>(&'f self, subject: &'f Subject<'_>, frames: &'f Frames<'_>) -> Ways<'f> {
        let now = subject.track;
        let carrier = self.tracks.carrier(now);
        let carrier_age =
            carrier.and_then(|(_, slot)| self.tracks.age(&slot.track(), subject.tick));
        let tumbles = subject.slot.tumbles() && self.features.tumbling;
        let (floating, falling) = if tumbles {
            (Predictor::Tumbling, Predictor::Thrown)
        } else {
            (Predictor::Uniform, Predictor::Ballistic)
        };
        let gravity = self.tracks.gravity(subject.slot, subject.tick);
        Ways {
            chooser: self,
            subject,
            frames,
            carrier_age,
            orphaned: now.carrier.is_some() && carrier.is_none(),
            floating,
            falling,
            drift: self.drift(subject, floating),
            gravity: Some(gravity).filter(|by| self.features.ballistic && *by != DVec3::ZERO),
            pushes: self.pushes(subject),
        }
    }

    /// The course of being held by another body.
    fn held<'s>(&self, subject: &Subject<'_>, holder: &'s Holder<'s>) -> Option<Held<'s>> {
        let track = subject.track;
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
            seen_from(&believed.pose(), &subject.believed.pose())
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
        Some(Held {
            course,
            frame: Frame {
                holder: Some(holder),
                truth: seen_from(&believed.pose(), &subject.truth.pose()),
                predicted,
            },
            stray: Stray::still(one, two).by_ticks(subject.stride),
        })
    }
}
