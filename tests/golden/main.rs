//! Scenes give results that are equal to the bit in every build.
//!
//! Continuous integration runs them again in an optimised build, with the server's feature `parallel`.

mod displayed;
mod scripts;
mod test_scenes;
mod threads;
