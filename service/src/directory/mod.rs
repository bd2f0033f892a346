//! Which of several servers has a scene, by a directory that all of them ask.
//!
//! The servers share one data directory. The directory, an etcd cluster, has a key for each scene that a server has. `claims`
//! is what holds at any time, without I/O; `etcd` speaks to the store, `keeper` runs both on a thread.

mod claims;
mod etcd;
mod keeper;

pub(crate) use claims::{ClaimEvent, ServerPlace};
pub(crate) use etcd::Endpoints;
pub(crate) use keeper::{FenceClock, Keeper};
