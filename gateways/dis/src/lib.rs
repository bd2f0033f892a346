//! A gateway between a scene and DIS, the protocol of distributed simulators.
//!
//! [`published`] turns bodies into PDUs, [`foreign`] turns PDUs into bodies. Their parts are usable alone: the codec of
//! PDUs, the nine models of dead reckoning, and geodesy. None of them reads a clock, opens a socket or allocates by what a
//! sender claims; only `socket` does. Time is a [`core::time::Duration`] since any fixed moment.
//!
//! | frame | axes | where |
//! |---|---|---|
//! | scene | as the scene has them, see [`geodesy::SceneAxes`] | bodies of Rhumb |
//! | geocentric | WGS84: x to 0° E, y to 90° E, z to the north pole; metres | locations and velocities of PDUs |
//! | entity | x forward, y right, z down | angular velocities of PDUs, and models 6 to 9 |
//!
//! The feature `gateway`, on by default, adds the program `rhumb-dis` and its parts: [`gateway`] is a member of a scene,
//! [`rules`] say what bodies and entities become.
#![forbid(unsafe_code)]

pub mod dead_reckoning;
pub mod entity;
pub mod foreign;
#[cfg(feature = "gateway")]
pub mod gateway;
pub mod geodesy;
pub mod pdu;
pub mod published;
#[cfg(feature = "gateway")]
pub mod rules;
#[cfg(feature = "gateway")]
pub mod socket;

pub use glam;
