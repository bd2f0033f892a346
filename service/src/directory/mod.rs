//! Which of several servers has a scene, by a directory that all of them ask.
//!
//! The servers share one data directory. The directory, an etcd cluster, has a key for each scene that a server has. `claims`
//! is what holds at any time, `handovers` moves scenes by order, both without I/O; `etcd` speaks to the store, `keeper`
//! runs all on a thread, and the files on another, and `command` is the operator's end.

mod claims;
mod command;
mod etcd;
mod handovers;
mod keeper;

pub(crate) use claims::{LeaseSeconds, ServerPlace};
pub(crate) use command::{DrainArguments, MoveArguments, run_drain, run_move};
pub(crate) use etcd::Endpoints;
pub(crate) use handovers::HandoverStep;
#[cfg(test)]
pub(crate) use keeper::puppet::Puppet;
pub(crate) use keeper::{DirectoryEvent, FenceClock, Keeper};
