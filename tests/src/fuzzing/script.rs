//! Interprets a fuzzer's bytes as a sequence of choices and numbers.
//!
//! It never fails: after the end of the bytes, each choice is the first and each number is zero.

use arbitrary::{Arbitrary, Unstructured};
use glam::{Quat, Vec3};

/// The remaining bytes.
pub(super) struct Script<'a>(Unstructured<'a>);

impl<'a> Script<'a> {
    pub(super) fn new(data: &'a [u8]) -> Self {
        Self(Unstructured::new(data))
    }

    /// True if bytes are left.
    pub(super) fn goes_on(&self) -> bool {
        !self.0.is_empty()
    }

    /// Any value.
    pub(super) fn any<T: Arbitrary<'a> + Default>(&mut self) -> T {
        self.0.arbitrary().unwrap_or_default()
    }

    /// A number below `most`, which must be positive.
    pub(super) fn below(&mut self, most: usize) -> usize {
        self.0.int_in_range(0..=most - 1).unwrap_or(0)
    }

    /// One of these elements; there must be at least one.
    pub(super) fn one_of<T: Clone>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())].clone()
    }

    /// At most this many bytes.
    pub(super) fn bytes(&mut self, most: usize) -> &'a [u8] {
        let length = self.below(most + 1).min(self.0.len());
        self.0.bytes(length).unwrap_or_default()
    }

    /// All remaining bytes.
    pub(super) fn rest(self) -> &'a [u8] {
        self.0.take_rest()
    }

    /// A finite number whose absolute value is at most `most`.
    pub(super) fn sane(&mut self, most: f32) -> f32 {
        f32::from(self.any::<i16>()) / 32_768.0 * most
    }

    /// A number of about this size, or rarely an invalid one such as NaN.
    pub(super) fn number(&mut self, most: f32) -> f32 {
        match self.below(12) {
            0 => f32::from_bits(self.any()),
            1 => most,
            2 => most * 1.001,
            3 => self.one_of(&[f32::NAN, f32::INFINITY, 0.0, -0.0, f32::MIN_POSITIVE, 1e-30]),
            _ => self.sane(most),
        }
    }

    /// A vector of such numbers.
    pub(super) fn vector(&mut self, most: f32) -> Vec3 {
        Vec3::new(self.number(most), self.number(most), self.number(most))
    }

    /// A vector of finite numbers.
    pub(super) fn sane_vector(&mut self, most: f32) -> Vec3 {
        Vec3::new(self.sane(most), self.sane(most), self.sane(most))
    }

    /// A rotation, which is rarely invalid.
    pub(super) fn rotation(&mut self) -> Quat {
        match self.below(8) {
            0 => Quat::from_xyzw(
                self.number(1.0),
                self.number(1.0),
                self.number(1.0),
                self.number(1.0),
            ),
            1..4 => Quat::IDENTITY,
            _ => Quat::from_scaled_axis(self.sane_vector(4.0)),
        }
    }
}
