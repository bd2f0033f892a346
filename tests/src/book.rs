//! The Rust code of the README and the book, compiled as documentation tests.
//!
//! Empty in every other build. A chapter without Rust code needs no item here.

#[doc = include_str!("../../README.md")]
pub struct Readme;

#[doc = include_str!("../../docs/book/src/how-to/authority.md")]
pub struct HowToAuthority;

#[doc = include_str!("../../docs/book/src/how-to/cells.md")]
pub struct HowToCells;

#[doc = include_str!("../../docs/book/src/how-to/characters.md")]
pub struct HowToCharacters;

#[doc = include_str!("../../docs/book/src/how-to/frame-loop.md")]
pub struct HowToFrameLoop;

#[doc = include_str!("../../docs/book/src/how-to/from-everything.md")]
pub struct HowToFromEverything;

#[doc = include_str!("../../docs/book/src/how-to/from-snapshots.md")]
pub struct HowToFromSnapshots;

#[doc = include_str!("../../docs/book/src/how-to/motion.md")]
pub struct HowToMotion;

#[doc = include_str!("../../docs/book/src/how-to/record.md")]
pub struct HowToRecord;

#[doc = include_str!("../../docs/book/src/how-to/thin-links.md")]
pub struct HowToThinLinks;

#[doc = include_str!("../../docs/book/src/local.md")]
pub struct Local;

#[doc = include_str!("../../docs/book/src/tutorial.md")]
pub struct Tutorial;
