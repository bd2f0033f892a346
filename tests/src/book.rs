//! The Rust code of the README and the book, compiled as documentation tests.
//!
//! Empty in every other build. A chapter without Rust code needs no item here.

#[doc = include_str!("../../README.md")]
pub struct Readme;

#[doc = include_str!("../../docs/book/src/local.md")]
pub struct Local;

#[doc = include_str!("../../docs/book/src/tutorial.md")]
pub struct Tutorial;
