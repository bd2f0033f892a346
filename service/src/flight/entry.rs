//! One event as a flight recorder keeps it.

use serde::{Deserialize, Serialize};

/// Bytes that are kept of one command; of longer ones, such as meshes, only the beginning.
pub(super) const COMMAND_BYTES_KEPT: usize = 256;
/// Bytes that are kept of a packet: its head.
pub(super) const HEAD_BYTES_KEPT: usize = 8;

/// One event of a scene. Moments are nanoseconds since the server's start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum FlightEntry<'a> {
    /// A client became a member; its name, if it showed a token.
    Joined { peer: u64, client: Option<&'a str> },
    /// A member left, or its connection ended.
    Left { peer: u64 },
    /// A command that is about to be checked and applied, as it is on the wire.
    Command {
        peer: u64,
        number: u64,
        /// The length of the whole command, bytes.
        length: u32,
        bytes: &'a [u8],
    },
    /// The last command was refused.
    Refused { error: &'a str },
    /// A step begins: the last entry of a scene whose step never ends.
    StepBegan { at_ns: u64, tick: u64 },
    /// A step and its publication have ended.
    Stepped {
        tick: u64,
        step_ns: u64,
        publish_ns: u64,
        members: u32,
        bodies: u32,
        awake: u32,
        /// Digest of all observations so far.
        digest: u64,
    },
    /// A packet of the tick, for all members of its stream.
    Packet { length: u32, head: &'a [u8] },
}
