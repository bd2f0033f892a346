//! A plug-in for Bevy: entities for the bodies of a remote physics scene.
//!
//! The physics runs in a Rhumb server. The plug-in drives a [`rhumb_client::Client`], spawns an entity for each body of
//! its scene, writes the [`Transform`](bevy_transform::components::Transform)s, and despawns the entities of removed
//! bodies. It draws nothing and opens no window.
//!
//! Positions are in metres, in Bevy's own axes, which are Rhumb's: right-handed, y up. A transform is that of the
//! body's centre of mass.
//!
//! # Example
//!
//! ```no_run
//! use bevy_app::{App, Startup, Update};
//! use bevy_ecs::prelude::*;
//! use rhumb_bevy::{RhumbBodyId, RhumbJoin, RhumbPlugin, RhumbClient};
//! use rhumb_client::scene::{BodyDesc, Shape};
//! use rhumb_client::{Client, Trust};
//!
//! fn join(mut commands: Commands) -> Result {
//!     let trust = Trust::Fingerprint(std::env::var("RHUMB_FINGERPRINT")?.parse()?);
//!     // On a thread of its own: the window is drawn meanwhile.
//!     let join = RhumbJoin::start(move || {
//!         let mut client = Client::connect("127.0.0.1:4433", trust)?.join("drop")?;
//!         client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
//!         client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
//!         Ok(client)
//!     })?;
//!     commands.insert_resource(join);
//!     Ok(())
//! }
//!
//! fn kick(client: Option<ResMut<RhumbClient>>, bodies: Query<&RhumbBodyId>) -> Result {
//!     let Some(mut client) = client else { return Ok(()) };
//!     if client.is_ended() {
//!         return Ok(());
//!     }
//!     for body in &bodies {
//!         client.apply_impulse(body.id(), bevy_math::Vec3::Y)?;
//!     }
//!     Ok(())
//! }
//!
//! // An app with a window has `DefaultPlugins` beside it; without one, a runner and the time.
//! App::new()
//!     .add_plugins(RhumbPlugin::default())
//!     .add_systems(Startup, join)
//!     .add_systems(Update, kick)
//!     .run();
//! ```
//!
//! # When what happens
//!
//! | scene | [`RhumbSystems::Advance`] runs in | and |
//! |---|---|---|
//! | free running | `PreUpdate` | shows the present moment; never waits |
//! | lockstep | `FixedUpdate` | requests a tick at each fixed step, and waits only at depth 0 |
//!
//! In a lockstep scene [`RhumbSystems::Draw`] then writes transforms between the last two ticks shown, for the moment
//! of the frame. Commands are sent by [`RhumbSystems::Send`] in `Last`, or earlier by the next step.
#![forbid(unsafe_code)]

mod client;
mod entities;
mod plugin;

pub use client::{RhumbClient, RhumbEnded, RhumbJoin, RhumbJoinFailed, RhumbMessage};
pub use entities::{RhumbBodyId, RhumbErrorBound, RhumbState};
pub use plugin::{RhumbPlugin, RhumbSystems};
pub use rhumb_client;

/// The code of the book's page.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/book/src/how-to/engines.md")]
pub struct BookPage;
