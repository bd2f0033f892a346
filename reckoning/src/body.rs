//! The name of a body in a scene.
//!
//! Carries no property of the body; see the protocol's `BodyDesc`.

use core::fmt;

/// Names one body of one scene for all of the body's life, and no other body before or after it.
///
/// An index may be used again after its body was removed; the generation then grows by one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BodyId {
    index: u32,
    generation: u16,
    spare: Spare,
}

impl BodyId {
    /// The `generation`-th body to use `index`.
    #[must_use]
    pub const fn new(index: u32, generation: u16) -> Self {
        Self {
            index,
            generation,
            spare: Spare::Nothing,
        }
    }

    /// Place in dense arrays.
    #[must_use]
    pub const fn index(self) -> u32 {
        self.index
    }

    /// The number of bodies that used this index before.
    #[must_use]
    pub const fn generation(self) -> u16 {
        self.generation
    }
}

/// A byte with one value: an `Option` or `enum` around its type uses the other values and needs no byte of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub(crate) enum Spare {
    #[default]
    Nothing,
}

impl fmt::Display for BodyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "body {}.{}", self.index, self.generation)
    }
}
