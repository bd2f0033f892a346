//! Scenes give results that are equal to the bit in every build, on any number of threads.
//!
//! Continuous integration runs them again, optimised and with the server's feature `parallel`.

mod displayed;
mod scripts;
mod test_scenes;
mod threads;
