//! What an update says of a body: a correction of a prediction, or a track.
//!
//! Numbers are said by the range coder, as likely as the packet so far makes them. Nothing here looks at a track, so
//! that a packet can be read to its end by who lacks some of them (PROTOCOL 5.6).

use rhumb_reckoning::{HORIZON, Predictor, Residual, Ticks, VelocityResidual};

use super::model::{Model, symbol_cost};
use super::tables::{MODES, contexts};
use super::walk::{Walk, numbers};
use super::whole::TrackSaying;
use crate::limits::INDICES_MAX;
use crate::wire::Malformed;
use crate::wire::range::{RangeReader, RangeWriter, TOTAL_BITS};

/// What an update says of a body, at the tick of its packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Saying {
    /// A correction of what the last track predicts; readable only by who has that track.
    Residual {
        /// How the body goes on.
        course: Course,
        /// Ticks since the origin of the track that this builds on: names its revision.
        age: Ticks,
        /// The correction, in the frame that the body goes on in.
        residual: Residual,
    },
    /// A whole motion, readable by all.
    Whole(TrackSaying),
}

impl Saying {
    /// Whether it can only be read by who has another body's track too.
    #[must_use]
    pub const fn names_carrier(&self) -> bool {
        matches!(
            self,
            Self::Residual {
                course: Course::Held { .. }
                    | Course::World {
                        carrier_age: Some(_),
                        ..
                    },
                ..
            }
        )
    }
}

/// How a body goes on after a correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// By the law and in the frame that it had.
    Same,
    /// In the world, by this law.
    World {
        /// The law.
        predictor: Predictor,
        /// If another body held it so far: ticks since the origin of that body's track.
        carrier_age: Option<Ticks>,
    },
    /// Held by another body.
    Held {
        /// Its index; it is held by none itself.
        carrier: u32,
        /// Ticks since the origin of that body's track.
        carrier_age: Ticks,
    },
}

/// The forms of an update: what its first symbol says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// [`Course::Same`], with velocities or without.
    Same { moved: bool },
    /// [`Course::World`], likewise.
    World { predictor: Predictor, moved: bool },
    /// [`Course::Held`].
    Held,
    /// [`Saying::Whole`].
    Whole,
}

impl Mode {
    /// In the order of their codes.
    const ALL: [Self; MODE_COUNT] = {
        const fn world(predictor: Predictor, moved: bool) -> Mode {
            Mode::World { predictor, moved }
        }
        [
            Self::Same { moved: false },
            Self::Same { moved: true },
            world(Predictor::Rest, false),
            world(Predictor::Uniform, false),
            world(Predictor::Uniform, true),
            world(Predictor::Ballistic, false),
            world(Predictor::Ballistic, true),
            world(Predictor::Tumbling, false),
            world(Predictor::Tumbling, true),
            world(Predictor::Thrown, false),
            world(Predictor::Thrown, true),
            Self::Held,
            Self::Whole,
        ]
    };

    const fn of(saying: &Saying) -> Self {
        match saying {
            Saying::Whole(_) => Self::Whole,
            Saying::Residual {
                course, residual, ..
            } => {
                let moved = residual.velocity.is_some();
                match *course {
                    Course::Same => Self::Same { moved },
                    Course::Held { .. } => Self::Held,
                    Course::World { predictor, .. } => Self::World { predictor, moved },
                }
            }
        }
    }

    const fn code(self) -> usize {
        match self {
            Self::Same { moved } => moved as usize,
            Self::World { predictor, moved } => match predictor {
                Predictor::Rest => 2,
                Predictor::Uniform => 3 + moved as usize,
                Predictor::Ballistic => 5 + moved as usize,
                Predictor::Tumbling => 7 + moved as usize,
                Predictor::Thrown => 9 + moved as usize,
            },
            Self::Held => 11,
            Self::Whole => 12,
        }
    }

    const fn moved(self) -> bool {
        matches!(
            self,
            Self::Same { moved: true } | Self::World { moved: true, .. }
        )
    }

    /// Forms whose numbers are alike: of the same course or of another, with velocities or without.
    const fn kind(self) -> usize {
        let same = matches!(self, Self::Same { .. });
        (!same as usize) * 2 + self.moved() as usize
    }
}

/// What the updates of one packet are said by, one after another.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tongue {
    model: Model,
    /// Which expectation of the next update's form holds: by the form of the last one.
    last: usize,
    /// Whether an update was said, and the body that the last held one is held by.
    begun: bool,
    carrier: Option<u32>,
}

impl Tongue {
    /// Says an update: how many seats lie between its body's and the last one's, which body takes the seat if that is
    /// to be said, then what is said of it.
    ///
    /// # Panics
    ///
    /// When a whole track names no body.
    pub(crate) fn write(
        &mut self,
        gap: u32,
        body: Option<u32>,
        saying: &Saying,
        to: &mut RangeWriter,
    ) {
        self.model.write(contexts::gap(self.begun), gap, to);
        let mode = Mode::of(saying);
        if let Some(body) = body.filter(|_| mode != Mode::Whole) {
            self.write_code(SEATING, to);
            to.raw(body, INDEX_BITS);
        }
        self.write_code(mode.code(), to);
        match saying {
            Saying::Whole(whole) => {
                to.raw(body.expect("a whole track names its body"), INDEX_BITS);
                whole.encode(to);
            }
            Saying::Residual {
                course,
                age,
                residual,
            } => {
                let kind = mode.kind();
                self.model.write(contexts::age(kind), age.count() - 1, to);
                self.write_carrier(course, to);
                numbers(kind, *age, residual, |context, number| {
                    self.model.write(context, number.unsigned_abs(), to);
                    if number != 0 {
                        to.raw(u32::from(number < 0), 1);
                    }
                });
            }
        }
        self.went_on(mode);
    }

    fn write_code(&self, code: usize, to: &mut RangeWriter) {
        let starts = &MODES[self.last];
        let size = starts[code + 1] - starts[code];
        to.symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
    }

    fn read_code(&self, from: &mut RangeReader<'_>) -> Result<usize, Malformed> {
        let starts = &MODES[self.last];
        let part = from.part(TOTAL_BITS)? as u16;
        let mut code = 0;
        while starts[code + 1] <= part {
            code += 1;
        }
        let size = starts[code + 1] - starts[code];
        from.symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
        Ok(code)
    }

    fn write_carrier(&mut self, course: &Course, to: &mut RangeWriter) {
        let age = match *course {
            Course::Same => return,
            Course::World { carrier_age, .. } => {
                to.raw(u32::from(carrier_age.is_some()), 1);
                carrier_age
            }
            Course::Held {
                carrier,
                carrier_age,
            } => {
                let again = self.carrier == Some(carrier);
                if self.carrier.is_some() {
                    to.raw(u32::from(again), 1);
                }
                if !again {
                    to.raw(carrier, INDEX_BITS);
                }
                self.carrier = Some(carrier);
                Some(carrier_age)
            }
        };
        if let Some(age) = age {
            self.model.write(contexts::CARRIER_AGE, age.count(), to);
        }
    }

    /// Reads an update: the gap, the body if it is named, then what is said of it.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for what is no saying within the limits.
    pub(crate) fn read(
        &mut self,
        from: &mut RangeReader<'_>,
    ) -> Result<(u32, Option<u32>, Saying), Malformed> {
        let gap = self.model.read(contexts::gap(self.begun), from)?;
        let mut code = self.read_code(from)?;
        let mut body = None;
        if code == SEATING {
            body = Some(from.raw(INDEX_BITS)?);
            code = self.read_code(from)?;
        }
        let mode = *Mode::ALL.get(code).ok_or(Malformed::NotCanonical)?;
        let saying = if mode == Mode::Whole {
            if body.is_some() {
                return Err(Malformed::NotCanonical);
            }
            body = Some(from.raw(INDEX_BITS)?);
            Saying::Whole(TrackSaying::decode(from)?)
        } else {
            let kind = mode.kind();
            let age = self.model.read(contexts::age(kind), from)?;
            if age >= HORIZON.count() {
                return Err(Malformed::OutOfRange);
            }
            let age = Ticks::new(age + 1);
            let course = self.read_course(mode, from)?;
            let residual = self.read_residual(kind, age, from)?;
            Saying::Residual {
                course,
                age,
                residual,
            }
        };
        self.went_on(mode);
        Ok((gap, body, saying))
    }

    fn read_course(&mut self, mode: Mode, from: &mut RangeReader<'_>) -> Result<Course, Malformed> {
        match mode {
            Mode::Same { .. } | Mode::Whole => Ok(Course::Same),
            Mode::World { predictor, .. } => {
                let held = from.raw(1)? == 1;
                let carrier_age = if held {
                    Some(self.read_carrier_age(from)?)
                } else {
                    None
                };
                Ok(Course::World {
                    predictor,
                    carrier_age,
                })
            }
            Mode::Held => {
                let again = match self.carrier {
                    Some(carrier) if from.raw(1)? == 1 => Some(carrier),
                    _ => None,
                };
                let carrier = match again {
                    Some(carrier) => carrier,
                    None => from.raw(INDEX_BITS)?,
                };
                if again.is_none() && self.carrier == Some(carrier) {
                    return Err(Malformed::NotCanonical);
                }
                self.carrier = Some(carrier);
                let carrier_age = self.read_carrier_age(from)?;
                Ok(Course::Held {
                    carrier,
                    carrier_age,
                })
            }
        }
    }

    fn read_carrier_age(&mut self, from: &mut RangeReader<'_>) -> Result<Ticks, Malformed> {
        let age = self.model.read(contexts::CARRIER_AGE, from)?;
        if age > CARRIER_AGE_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(Ticks::new(age))
    }

    fn read_residual(
        &mut self,
        kind: usize,
        age: Ticks,
        from: &mut RangeReader<'_>,
    ) -> Result<Residual, Malformed> {
        let moved = kind % 2 == 1;
        let mut residual = Residual {
            velocity: moved.then(VelocityResidual::default),
            ..Residual::default()
        };
        let mut walk = Walk::new(kind, age);
        while let Some(context) = walk.context() {
            let size = self.model.read(context, from)?;
            let size = i32::try_from(size).map_err(|_| Malformed::OutOfRange)?;
            let negative = size != 0 && from.raw(1)? == 1;
            *walk.place(&mut residual) = if negative { -size } else { size };
            walk.step(size.unsigned_abs());
        }
        if !residual.is_within_limits() {
            return Err(Malformed::OutOfRange);
        }
        Ok(residual)
    }

    fn went_on(&mut self, mode: Mode) {
        self.begun = true;
        self.last = contexts::after(mode.code());
    }

    /// What saying this next would cost, its gap aside, in 1/256 bits.
    pub(crate) fn cost(&self, saying: &Saying) -> u32 {
        let mode = Mode::of(saying);
        let starts = &MODES[self.last];
        let code = mode.code();
        let mut cost = symbol_cost(u32::from(starts[code + 1] - starts[code]));
        match saying {
            Saying::Whole(whole) => cost += (whole.bit_len() as u32 + INDEX_BITS) * 256,
            Saying::Residual {
                course,
                age,
                residual,
            } => {
                let kind = mode.kind();
                cost += self.model.cost(contexts::age(kind), age.count() - 1);
                cost += match course {
                    Course::Same => 0,
                    Course::World { carrier_age, .. } => {
                        256 + carrier_age.map_or(0, |_| CARRIER_AGE_COST)
                    }
                    Course::Held { carrier, .. } if self.carrier == Some(*carrier) => {
                        256 + CARRIER_AGE_COST
                    }
                    Course::Held { .. } => INDEX_BITS * 256 + CARRIER_AGE_COST,
                };
                numbers(kind, *age, residual, |context, number| {
                    cost += self.model.cost(context, number.unsigned_abs());
                    cost += u32::from(number != 0) * 256;
                });
            }
        }
        cost
    }
}

/// Bits of a body's index.
const INDEX_BITS: u32 = INDICES_MAX.ilog2();
/// A body that holds others is spoken of at least this often, or said to rest.
const CARRIER_AGE_MAX: u32 = 1 << 30;
/// About what an age costs, to choose by.
const CARRIER_AGE_COST: u32 = 4 * 256;

/// How many forms there are.
pub(super) const MODE_COUNT: usize = 13;
/// The code, behind those of the forms, that says that a body takes a seat; the form follows.
const SEATING: usize = MODE_COUNT;

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::packet::whole::tests::{steps, whole};
    use alloc::vec::Vec;
    use proptest::prelude::*;
    use rhumb_reckoning::{RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT};

    fn course() -> impl Strategy<Value = Course> {
        let carrier_age = || (0_u32..2_000).prop_map(Ticks::new);
        prop_oneof![
            3 => Just(Course::Same),
            2 => (
                prop::sample::select(&Predictor::ALL[..]),
                proptest::option::of(carrier_age())
            )
                .prop_map(|(predictor, carrier_age)| Course::World {
                    predictor,
                    carrier_age
                }),
            1 => (prop_oneof![0..INDICES_MAX, Just(5)], carrier_age()).prop_map(
                |(carrier, carrier_age)| Course::Held {
                    carrier,
                    carrier_age
                }
            ),
        ]
    }

    pub(crate) fn saying() -> impl Strategy<Value = Saying> {
        let velocity = (steps(VELOCITY_LIMIT), steps(VELOCITY_LIMIT))
            .prop_map(|(linear, angular)| VelocityResidual { linear, angular });
        let residual = (
            steps(RESIDUAL_LIMIT),
            steps(TURN_LIMIT),
            proptest::option::of(velocity),
        );
        prop_oneof![
            whole().prop_map(Saying::Whole),
            (course(), 1_u32..=HORIZON.count(), residual).prop_map(
                |(course, age, (position, turn, velocity))| {
                    let still = matches!(
                        course,
                        Course::Held { .. }
                            | Course::World {
                                predictor: Predictor::Rest,
                                ..
                            }
                    );
                    Saying::Residual {
                        course,
                        age: Ticks::new(age),
                        residual: Residual {
                            position,
                            turn,
                            velocity: velocity.filter(|_| !still),
                        },
                    }
                }
            ),
        ]
    }

    fn seated() -> impl Strategy<Value = (u32, Option<u32>, Saying)> {
        let body = prop_oneof![Just(None), (0..INDICES_MAX).prop_map(Some)];
        (0_u32..5_000, body, saying()).prop_map(|(gap, body, saying)| {
            let whole = matches!(saying, Saying::Whole(_));
            (gap, body.or(whole.then_some(7)), saying)
        })
    }

    proptest! {
        #[test]
        fn sayings_come_back_at_about_their_cost(sayings in proptest::collection::vec(seated(), 0..20)) {
            let (mut tongue, mut writer, mut cost) = (Tongue::default(), RangeWriter::default(), 0);
            for (gap, body, saying) in &sayings {
                cost += tongue.cost(saying) + 64 * 256;
                tongue.write(*gap, *body, saying, &mut writer);
            }
            let bytes = writer.into_bytes();
            prop_assert!(bytes.len() * 8 * 256 <= cost as usize + cost as usize / 8 + 16 * 256);
            let (mut tongue, mut reader) = (Tongue::default(), RangeReader::new(&bytes));
            let mut read = Vec::new();
            for _ in &sayings {
                read.push(tongue.read(&mut reader).unwrap());
            }
            prop_assert_eq!(read, sayings);
            prop_assert_eq!(reader.finish(), Ok(()));
        }

        #[test]
        fn what_is_read_is_written_alike(bytes in proptest::collection::vec(any::<u8>(), 0..64), count in 0_usize..8) {
            let (mut tongue, mut reader) = (Tongue::default(), RangeReader::new(&bytes));
            let read: Result<Vec<_>, _> = (0..count).map(|_| tongue.read(&mut reader)).collect();
            if let Ok(read) = read && reader.finish().is_ok() {
                let (mut tongue, mut writer) = (Tongue::default(), RangeWriter::default());
                for (gap, body, saying) in &read {
                    tongue.write(*gap, *body, saying, &mut writer);
                }
                prop_assert_eq!(writer.into_bytes(), bytes);
            }
        }
    }

    #[test]
    fn every_form_has_its_code() {
        for (code, mode) in Mode::ALL.into_iter().enumerate() {
            assert_eq!(mode.code(), code);
        }
    }
}
