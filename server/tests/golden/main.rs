//! Results that are equal to the bit in every build, on any number of threads.
//!
//! Continuous integration runs them again in release mode and with the feature `parallel`.

mod scripts;
mod threads;
mod truth;
