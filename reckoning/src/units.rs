//! Scalars that carry their unit, for configurations, tolerances and scores.
//!
//! No arithmetic between units is offered: callers take the number out, compute, and wrap the result.

use core::fmt;

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $read:ident, $suffix:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub struct $name(f64);

        impl $name {
            #[doc = concat!("A quantity in ", stringify!($read), ".")]
            #[must_use]
            pub const fn new($read: f64) -> Self {
                Self($read)
            }

            #[doc = concat!("The number of ", stringify!($read), ".")]
            #[must_use]
            pub const fn $read(self) -> f64 {
                self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!("{} ", $suffix), self.0)
            }
        }
    };
}

unit!(
    /// A length.
    Metres,
    metres,
    "m"
);
unit!(
    /// An angle.
    Radians,
    radians,
    "rad"
);
unit!(
    /// A span of simulated or displayed time.
    Seconds,
    seconds,
    "s"
);
unit!(
    /// A speed.
    MetresPerSecond,
    metres_per_second,
    "m/s"
);
