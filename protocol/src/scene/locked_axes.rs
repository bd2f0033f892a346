//! Set of axes along or about which a body or a joint does not move.

use core::ops::BitOr;

use crate::wire::Malformed;
use crate::wire::Wire;
use crate::wire::bytes::{Reader, Writer};

/// Axes without motion: translations along x, y and z, then rotations about x, y and z.
///
/// The axes of a body's set are those of the world, the axes of a joint's set those of its first frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LockedAxes(u8);

impl LockedAxes {
    /// Every motion is free.
    pub const NONE: Self = Self(0);
    /// No rotation.
    pub const ROTATIONS: Self = Self(0b11_1000);
    /// No translation.
    pub const TRANSLATIONS: Self = Self(0b00_0111);
    /// Each axis, in order.
    pub const EACH: [Self; 6] = [
        Self(1),
        Self(1 << 1),
        Self(1 << 2),
        Self(1 << 3),
        Self(1 << 4),
        Self(1 << 5),
    ];

    /// The set of these bits, one per axis in order; `None` beyond six bits.
    #[must_use]
    pub const fn new(bits: u8) -> Option<Self> {
        if bits < 1 << 6 {
            Some(Self(bits))
        } else {
            None
        }
    }

    /// One bit per axis, in order.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// True if no axis is locked.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// True if the axis of this number, below six, is locked.
    #[must_use]
    pub const fn locks(self, axis: usize) -> bool {
        self.0 & (1 << axis) != 0
    }
}

impl BitOr for LockedAxes {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Wire for LockedAxes {
    fn encode(&self, to: &mut Writer) {
        to.u8(self.0);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.u8()?).ok_or(Malformed::UnknownCode)
    }
}
