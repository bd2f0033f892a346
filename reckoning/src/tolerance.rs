//! Tolerance: the greatest error of a copy.
//!
//! One bound per stream (a tier): a length for any point of a body, or a length and an angle on their own. `quantiser`
//! derives the grids from it. All bounds are whole numbers: the wire carries them exactly. A body's factor on them is a
//! power of two that is sent once, with its description.

use core::f64::consts::FRAC_PI_2;
use core::fmt;
use core::str::FromStr;

use crate::exact::sin_cos;
use crate::motion::Divergence;
use crate::units::{Metres, Radians};

/// Error bound of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Tolerance {
    /// Bound on the error of every point of a body: [`Divergence::surface_error`].
    Surface(LengthBound),
    /// Separate bounds on the centre of mass and on the rotation, whatever the size of the body.
    Parts {
        /// Bound on the centre of mass.
        position: LengthBound,
        /// Bound on the shortest turn from one rotation to the other.
        turn: TurnBound,
    },
}

/// A length of at least 1 mm and at most 10 m, in whole micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LengthBound {
    micrometres: u32,
}

/// An angle of at least 0.0001 rad and at most a half turn, in whole microradians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TurnBound {
    microradians: u32,
}

impl LengthBound {
    /// The smallest: below it, f32 engines disagree with themselves at a kilometre from the origin.
    pub const LEAST: Self = Self { micrometres: 1_000 };
    /// The largest.
    pub const MOST: Self = Self {
        micrometres: 10_000_000,
    };

    /// A bound in whole micrometres.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Length`] outside [`Self::LEAST`] to [`Self::MOST`].
    pub const fn from_micrometres(micrometres: u32) -> Result<Self, InvalidTolerance> {
        if micrometres < Self::LEAST.micrometres || micrometres > Self::MOST.micrometres {
            return Err(InvalidTolerance::Length(micrometres as f64 / 1e6));
        }
        Ok(Self { micrometres })
    }

    /// The bound nearest to a length.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Length`] if it is NaN or outside [`Self::LEAST`] to [`Self::MOST`].
    pub fn from_metres(length: Metres) -> Result<Self, InvalidTolerance> {
        let wrong = InvalidTolerance::Length(length.metres());
        let micrometres = millionths(length.metres()).ok_or(wrong)?;
        Self::from_micrometres(micrometres).map_err(|_| wrong)
    }

    /// The bound in micrometres, as the wire has it.
    #[must_use]
    pub const fn micrometres(self) -> u32 {
        self.micrometres
    }

    /// As a length: micrometres divided by a million (RECKONING 4.1).
    #[must_use]
    pub fn metres(self) -> Metres {
        Metres::new(f64::from(self.micrometres) / 1e6)
    }
}

impl TurnBound {
    /// The smallest: ten times the error of a packed rotation.
    pub const LEAST: Self = Self { microradians: 100 };
    /// The largest, a half turn rounded up: it allows any rotation.
    pub const ANY: Self = Self {
        microradians: 3_141_593,
    };

    /// A bound in whole microradians.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Turn`] outside [`Self::LEAST`] to [`Self::ANY`].
    pub const fn from_microradians(microradians: u32) -> Result<Self, InvalidTolerance> {
        if microradians < Self::LEAST.microradians || microradians > Self::ANY.microradians {
            return Err(InvalidTolerance::Turn(microradians as f64 / 1e6));
        }
        Ok(Self { microradians })
    }

    /// The bound nearest to an angle.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Turn`] if it is NaN or outside [`Self::LEAST`] to [`Self::ANY`].
    pub fn from_radians(angle: Radians) -> Result<Self, InvalidTolerance> {
        let wrong = InvalidTolerance::Turn(angle.radians());
        let microradians = millionths(angle.radians()).ok_or(wrong)?;
        Self::from_microradians(microradians).map_err(|_| wrong)
    }

    /// The bound in microradians, as the wire has it.
    #[must_use]
    pub const fn microradians(self) -> u32 {
        self.microradians
    }

    /// As an angle: microradians divided by a million (RECKONING 4.1).
    #[must_use]
    pub fn radians(self) -> Radians {
        Radians::new(f64::from(self.microradians) / 1e6)
    }
}

/// The nearest count of millionths; `None` outside the range of u32.
fn millionths(value: f64) -> Option<u32> {
    let count = libm::round(value * 1e6);
    (0.0..=f64::from(u32::MAX))
        .contains(&count)
        .then_some(count as u32)
}

impl Tolerance {
    /// 5 mm for any point of a body.
    pub const EXACT: Self = Self::surface_of(5_000);
    /// 2 cm.
    pub const FINE: Self = Self::surface_of(20_000);
    /// 5 cm.
    pub const NORMAL: Self = Self::surface_of(50_000);
    /// 20 cm.
    pub const COARSE: Self = Self::surface_of(200_000);
    /// The smallest for any point of a body.
    pub const LEAST: Self = Self::Surface(LengthBound::LEAST);
    /// The largest for any point of a body.
    pub const MOST: Self = Self::Surface(LengthBound::MOST);

    const fn surface_of(micrometres: u32) -> Self {
        Self::Surface(LengthBound { micrometres })
    }

    /// A length in whole micrometres for any point of a body.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Length`] outside [`Self::LEAST`] to [`Self::MOST`].
    pub const fn from_micrometres(micrometres: u32) -> Result<Self, InvalidTolerance> {
        match LengthBound::from_micrometres(micrometres) {
            Ok(length) => Ok(Self::Surface(length)),
            Err(error) => Err(error),
        }
    }

    /// A length for any point of a body, to the nearest micrometre.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance::Length`] if it is NaN or outside [`Self::LEAST`] to [`Self::MOST`].
    pub fn from_metres(length: Metres) -> Result<Self, InvalidTolerance> {
        LengthBound::from_metres(length).map(Self::Surface)
    }

    /// A length for the centre of mass and an angle for the rotation, each to the nearest millionth.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance`] names the bound that is NaN or out of range.
    pub fn parts(position: Metres, turn: Radians) -> Result<Self, InvalidTolerance> {
        Ok(Self::Parts {
            position: LengthBound::from_metres(position)?,
            turn: TurnBound::from_radians(turn)?,
        })
    }

    /// The tolerance for a body of this scale: each bound times that power of two, rounded down and clamped to the
    /// range of tolerances (RECKONING 4.1).
    #[must_use]
    pub fn scaled(self, tolerance_scale: ToleranceScale) -> Self {
        let length = |bound: LengthBound| LengthBound {
            micrometres: tolerance_scale.scale(
                bound.micrometres,
                LengthBound::LEAST.micrometres,
                LengthBound::MOST.micrometres,
            ),
        };
        let angle = |bound: TurnBound| TurnBound {
            microradians: tolerance_scale.scale(
                bound.microradians,
                TurnBound::LEAST.microradians,
                TurnBound::ANY.microradians,
            ),
        };
        match self {
            Self::Surface(bound) => Self::Surface(length(bound)),
            Self::Parts { position, turn } => Self::Parts {
                position: length(position),
                turn: angle(turn),
            },
        }
    }

    /// Share of this tolerance that an error uses, of a body of this bounding radius: within tolerance up to 1.
    ///
    /// Not negative. Publishers and checks of their copies use this one judgement (RECKONING 5.1).
    #[must_use]
    #[inline]
    pub fn share(&self, apart: &Divergence, radius: Metres) -> f64 {
        match self {
            Self::Surface(length) => {
                apart.surface_error(radius).metres() / length.metres().metres()
            }
            Self::Parts { position, turn } => {
                let of_position = apart.position.metres() / position.metres().metres();
                of_position.max(apart.turn().radians() / turn.radians().radians())
            }
        }
    }

    /// The greatest surface error of a copy within this tolerance, of a body of this bounding radius.
    #[must_use]
    pub fn reach(&self, radius: Metres) -> Metres {
        match self {
            Self::Surface(length) => length.metres(),
            Self::Parts { position, turn } => {
                let half_turn = (turn.radians().radians() * 0.5).min(FRAC_PI_2);
                let chord = 2.0 * radius.metres() * sin_cos(half_turn).0;
                Metres::new(position.metres().metres() + chord)
            }
        }
    }

    /// The length of a surface tolerance; `None` otherwise.
    #[must_use]
    pub fn length(&self) -> Option<Metres> {
        match self {
            Self::Surface(length) => Some(length.metres()),
            Self::Parts { .. } => None,
        }
    }
}

impl fmt::Display for Tolerance {
    /// In the form that [`FromStr`] takes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Surface(length) => write!(f, "{}", length.metres().metres()),
            Self::Parts { position, turn } => {
                let (position, turn) = (position.metres().metres(), turn.radians().radians());
                write!(f, "{position}:{turn}")
            }
        }
    }
}

impl FromStr for Tolerance {
    type Err = InvalidTolerance;

    /// Metres for any point (`0.05`), or metres for the centre and radians for the rotation (`0.01:0.002`).
    fn from_str(text: &str) -> Result<Self, InvalidTolerance> {
        let length = |text: &str| text.parse().map_err(|_| InvalidTolerance::Text);
        match text.split_once(':') {
            None => Self::from_metres(Metres::new(length(text)?)),
            Some((position, turn)) => {
                let turn = turn.parse().map_err(|_| InvalidTolerance::Text)?;
                Self::parts(Metres::new(length(position)?), Radians::new(turn))
            }
        }
    }
}

/// A tolerance that no stream can have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidTolerance {
    /// This length, metres, is NaN or outside its range.
    Length(f64),
    /// This angle, radians, is NaN or outside its range.
    Turn(f64),
    /// The text is no tolerance.
    Text,
}

impl fmt::Display for InvalidTolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(metres) => write!(
                f,
                "a tolerance of {metres} m is not allowed; it must be 0.001 m to 10 m"
            ),
            Self::Turn(radians) => write!(
                f,
                "a tolerance of {radians} rad is not allowed; it must be 0.0001 rad to 3.141593 rad"
            ),
            Self::Text => f.write_str(
                "a tolerance is written in metres for any point of a body, as 0.05, or in metres for its centre and radians for its rotation, as 0.01:0.002",
            ),
        }
    }
}

impl core::error::Error for InvalidTolerance {}

/// Power of two by which the tolerance of a body differs from that of its stream.
///
/// A body in focus (an avatar) deserves a finer copy, a body that lies about (debris) a coarser one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ToleranceScale {
    exponent: i8,
}

impl ToleranceScale {
    /// Half of the stream's tolerance.
    pub const AVATAR: Self = Self { exponent: -1 };
    /// The stream's own tolerance.
    pub const USUAL: Self = Self { exponent: 0 };
    /// Twice the stream's tolerance.
    pub const DEBRIS: Self = Self { exponent: 1 };
    /// An eighth of the stream's tolerance.
    pub const FINEST: Self = Self { exponent: -3 };
    /// Eight times the stream's tolerance.
    pub const COARSEST: Self = Self { exponent: 3 };

    /// The scale two to the power of `exponent`; `None` outside [`Self::FINEST`] to [`Self::COARSEST`].
    #[must_use]
    pub const fn new(exponent: i8) -> Option<Self> {
        if exponent < Self::FINEST.exponent || exponent > Self::COARSEST.exponent {
            return None;
        }
        Some(Self { exponent })
    }

    /// The power of two.
    #[must_use]
    pub const fn exponent(self) -> i8 {
        self.exponent
    }

    /// Scales a whole number of millionths, rounds down, and clamps to the bounds (RECKONING 4.1).
    fn scale(self, millionths: u32, least: u32, most: u32) -> u32 {
        let wide = u64::from(millionths);
        let scaled = if self.exponent < 0 {
            wide >> self.exponent.unsigned_abs()
        } else {
            wide << self.exponent.unsigned_abs()
        };
        scaled.clamp(u64::from(least), u64::from(most)) as u32
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString;

    use super::*;

    #[test]
    fn a_tolerance_is_whole_micrometres_within_bounds() {
        assert_eq!(
            Tolerance::from_metres(Metres::new(0.05)),
            Ok(Tolerance::NORMAL)
        );
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 11.0, 0.0004] {
            let refused = Tolerance::from_metres(Metres::new(wrong));
            let text = refused.unwrap_err().to_string();
            let value = alloc::format!("a tolerance of {wrong} m is");
            assert!(
                text.contains(&value) && text.contains("0.001 m to 10 m"),
                "{text}"
            );
        }
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 3.2, 0.00009] {
            let refused = Tolerance::parts(Metres::new(0.01), Radians::new(wrong));
            let text = refused.unwrap_err().to_string();
            let value = alloc::format!("a tolerance of {wrong} rad is");
            assert!(
                text.contains(&value) && text.contains("0.0001 rad to"),
                "{text}"
            );
        }
    }

    #[test]
    fn a_tolerance_parses_as_it_is_displayed() {
        let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002)).unwrap();
        for (tolerance, text) in [(Tolerance::NORMAL, "0.05"), (parts, "0.01:0.002")] {
            assert_eq!(tolerance.to_string(), text);
            assert_eq!(text.parse(), Ok(tolerance));
        }
        for (text, wrong) in [
            ("", InvalidTolerance::Text),
            ("five", InvalidTolerance::Text),
            ("0.01:", InvalidTolerance::Text),
            (":0.1", InvalidTolerance::Text),
            ("50", InvalidTolerance::Length(50.0)),
            ("0.01:4", InvalidTolerance::Turn(4.0)),
        ] {
            assert_eq!(text.parse::<Tolerance>(), Err(wrong), "{text}");
        }
    }

    #[test]
    fn a_share_is_one_at_the_bound() {
        let apart = |position, turn: f64| Divergence {
            position: Metres::new(position),
            half_chord: libm::sin(turn / 2.0),
        };
        let radius = Metres::new(10.0);
        let surface = Tolerance::NORMAL;
        assert_eq!(surface.share(&apart(0.05, 0.0), radius), 1.0);
        assert!((surface.share(&apart(0.02, 0.001), radius) - 0.6).abs() < 1e-6);
        let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002)).unwrap();
        assert_eq!(parts.share(&apart(0.01, 0.001), radius), 1.0);
        assert!((parts.share(&apart(0.001, 0.003), radius) - 1.5).abs() < 1e-9);
        // This bound allows any rotation, even the opposite one.
        let anyhow = Tolerance::Parts {
            position: LengthBound::LEAST,
            turn: TurnBound::ANY,
        };
        assert!(anyhow.share(&apart(0.0, core::f64::consts::PI), radius) <= 1.0);
    }

    #[test]
    fn share_at_most_one_is_within_reach() {
        let radius = Metres::new(2.0);
        assert_eq!(Tolerance::FINE.reach(radius), Metres::new(0.02));
        let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002)).unwrap();
        let worst = Divergence {
            position: Metres::new(0.01),
            half_chord: libm::sin(0.001),
        };
        let reach = parts.reach(radius).metres();
        assert!((reach - worst.surface_error(radius).metres()).abs() < 1e-12);
        let anyhow = Tolerance::Parts {
            position: LengthBound::from_micrometres(10_000).unwrap(),
            turn: TurnBound::ANY,
        };
        assert!((anyhow.reach(radius).metres() - 4.01).abs() < 1e-12);
    }

    #[test]
    fn scales_are_the_powers_of_two_from_an_eighth_to_eight() {
        for exponent in i8::MIN..=i8::MAX {
            let tolerance_scale = ToleranceScale::new(exponent);
            assert_eq!(tolerance_scale.is_some(), (-3..=3).contains(&exponent));
            assert!(
                tolerance_scale
                    .is_none_or(|tolerance_scale| tolerance_scale.exponent() == exponent)
            );
        }
        assert_eq!(ToleranceScale::default(), ToleranceScale::USUAL);
    }

    #[test]
    fn scaling_rounds_down_and_clamps() {
        assert_eq!(
            ToleranceScale::AVATAR.scale(50_001, 1_000, 10_000_000),
            25_000
        );
        assert_eq!(
            ToleranceScale::DEBRIS.scale(50_001, 1_000, 10_000_000),
            100_002
        );
        assert_eq!(
            ToleranceScale::AVATAR.scale(1_500, 1_000, 10_000_000),
            1_000
        );
        assert_eq!(
            ToleranceScale::COARSEST.scale(u32::MAX, 1_000, 10_000_000),
            10_000_000
        );
    }
}
