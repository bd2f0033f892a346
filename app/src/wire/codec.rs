//! Big-endian numbers and fields.
//!
//! Decoding checks every length and never asserts: any peer may be the sender.

use glam::{Quat, Vec3};

use super::malformed::MalformedMessage;

/// Takes values off the front of a slice.
#[derive(Clone, Debug)]
pub(crate) struct FieldReader<'a> {
    rest: &'a [u8],
}

impl<'a> FieldReader<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub(crate) const fn left(&self) -> usize {
        self.rest.len()
    }

    pub(crate) fn raw(&mut self, count: usize) -> Result<&'a [u8], MalformedMessage> {
        let split = self.rest.split_at_checked(count);
        let (taken, rest) = split.ok_or(MalformedMessage::Truncated)?;
        self.rest = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], MalformedMessage> {
        let (taken, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(MalformedMessage::Truncated)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub(crate) const fn finish(self) -> Result<(), MalformedMessage> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(MalformedMessage::TrailingBytes)
        }
    }
}

/// A field in the body of a message.
pub(crate) trait Field: Sized {
    /// Appends the field's bytes.
    fn put(&self, to: &mut Vec<u8>);

    /// Takes the field off the front.
    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage>;

    /// Takes `count` fields; the caller has checked that their bytes are present.
    fn take_all(from: &mut FieldReader<'_>, count: usize) -> Result<Vec<Self>, MalformedMessage> {
        (0..count).map(|_| Self::take(from)).collect()
    }
}

impl Field for u32 {
    fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&self.to_be_bytes());
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        from.array().map(Self::from_be_bytes)
    }
}

impl Field for f32 {
    fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&self.to_be_bytes());
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        from.array().map(Self::from_be_bytes)
    }
}

impl<T: Field + Copy + Default, const N: usize> Field for [T; N] {
    fn put(&self, to: &mut Vec<u8>) {
        for value in self {
            value.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = T::take(from)?;
        }
        Ok(values)
    }
}

impl Field for Vec3 {
    fn put(&self, to: &mut Vec<u8>) {
        self.to_array().put(to);
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        <[f32; 3]>::take(from).map(Self::from_array)
    }
}

impl Field for Quat {
    fn put(&self, to: &mut Vec<u8>) {
        self.to_array().put(to);
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        <[f32; 4]>::take(from).map(Self::from_array)
    }
}

/// A struct whose bytes are those of its fields, in order.
macro_rules! fields {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $field:ident: $type:ty,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            $($(#[$doc])* pub $field: $type,)+
        }

        impl $crate::wire::codec::Field for $name {
            fn put(&self, to: &mut Vec<u8>) {
                $($crate::wire::codec::Field::put(&self.$field, to);)+
            }

            fn take(
                from: &mut $crate::wire::codec::FieldReader<'_>,
            ) -> Result<Self, $crate::wire::malformed::MalformedMessage> {
                Ok(Self { $($field: $crate::wire::codec::Field::take(from)?,)+ })
            }
        }
    };
}

pub(crate) use fields;
