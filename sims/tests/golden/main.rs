//! Scenes give results that are equal to the bit in every build.
//!
//! Continuous integration runs them with the server's feature `parallel`, and again without it in an optimised build.

mod displayed;
mod scripts;
mod test_scenes;
mod threads;
