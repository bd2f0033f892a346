//! Records of a scene that its command log has not got yet.
//!
//! In memory only. The scene adds what changes it, the scene runner what its sessions need.

use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;
use rhumb_reckoning::Tick;

use crate::record::Record;

/// Records in their order.
#[derive(Debug, Default)]
pub struct Journal {
    records: Writer,
    /// The scene's tick before the first of them.
    tick: Option<Tick>,
}

/// Records that are written as a whole or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The scene's tick before them.
    pub tick: Tick,
    /// Their bytes.
    pub records: Vec<u8>,
}

impl Batch {
    /// Bytes that it takes in memory.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.records.capacity()
    }
}

impl Journal {
    /// Adds a command that was applied.
    pub(crate) fn applied(&mut self, tick: Tick, command: &Command) {
        self.tick.get_or_insert(tick);
        Record::encode_applied(command, &mut self.records);
    }

    /// Adds a record.
    pub fn push(&mut self, tick: Tick, record: &Record) {
        self.tick.get_or_insert(tick);
        record.encode(&mut self.records);
    }

    /// Everything since the last call.
    pub fn take(&mut self) -> Option<Batch> {
        let tick = self.tick.take()?;
        let records = std::mem::take(&mut self.records).into_bytes();
        Some(Batch { tick, records })
    }
}
