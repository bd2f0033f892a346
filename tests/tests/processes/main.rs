//! Server processes and real sockets on loopback.
//!
//! Every wait is for an event, with a time limit.

use rhumb_tests::Programme;

mod access;
mod agones;
mod app_process;
mod authority_quic;
mod bindings;
mod body_ids;
mod deployed;
mod directory;
mod durable;
mod durable_disk;
mod edges;
mod examples;
mod hostile_load;
#[cfg(target_os = "linux")]
mod invented_clients;
mod public_client;
mod recording;
mod tier_policy_quic;
mod top;
#[cfg(unix)]
mod unix_socket;
mod view;
#[cfg(target_os = "linux")]
mod workers;

const SERVER: Programme = Programme(env!("CARGO_BIN_EXE_rhumb-test-server"));
