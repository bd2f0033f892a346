//! An MCAP file that takes protobuf messages by topic.
//!
//! Compression runs in the caller's thread, so one record gives the same bytes on any machine. A topic is declared
//! with its first message, so a topic without messages does not appear.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use foxglove::Encode;
use foxglove::messages::SceneUpdate;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions, Writer};

use super::messages::DESCRIPTORS;

/// The message type of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Schema {
    /// `foxglove.SceneUpdate`.
    Scene,
    /// A message of `proto/rhumb.proto`, by its full name.
    Own(&'static str),
    /// The same, on a topic that carries captured packets.
    Wire(&'static str),
}

/// A topic and its write position.
#[derive(Debug)]
pub(super) struct Topic {
    name: String,
    schema: Schema,
    channel: Option<u16>,
    sequence: u32,
}

impl Topic {
    pub(super) const fn new(name: String, schema: Schema) -> Self {
        Self {
            name,
            schema,
            channel: None,
            sequence: 0,
        }
    }
}

/// The MCAP file.
pub(super) struct TraceFile<W: Write + Seek> {
    writer: Writer<W>,
    buffer: Vec<u8>,
}

impl<W: Write + Seek> TraceFile<W> {
    pub(super) fn new(to: W) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .library(concat!("rhumb-bench/", env!("CARGO_PKG_VERSION")));
        Ok(Self {
            writer: options.create(to)?,
            buffer: Vec::new(),
        })
    }

    /// Writes a message with log and publish time `at_ns`.
    pub(super) fn put(
        &mut self,
        topic: &mut Topic,
        at_ns: u64,
        message: &impl prost::Message,
    ) -> Result<(), McapError> {
        let channel_id = match topic.channel {
            Some(channel) => channel,
            None => *topic
                .channel
                .insert(self.declare(topic.schema, &topic.name)?),
        };
        self.buffer.clear();
        message
            .encode(&mut self.buffer)
            .expect("a vector grows as needed");
        let header = MessageHeader {
            channel_id,
            sequence: topic.sequence,
            log_time: at_ns,
            publish_time: at_ns,
        };
        topic.sequence += 1;
        self.writer.write_to_known_channel(&header, &self.buffer)
    }

    /// Writes a metadata record.
    pub(super) fn put_metadata(
        &mut self,
        name: String,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), McapError> {
        self.writer.write_metadata(&Metadata { name, metadata })
    }

    /// Writes the indexes and closes the file.
    pub(super) fn finish(mut self) -> Result<W, McapError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }

    fn declare(&mut self, schema: Schema, topic: &str) -> Result<u16, McapError> {
        let mut metadata = BTreeMap::new();
        let schema = match schema {
            Schema::Scene => {
                let scene = SceneUpdate::get_schema().expect("Foxglove's types have schemas");
                self.writer
                    .add_schema(&scene.name, &scene.encoding, &scene.data)?
            }
            Schema::Own(name) => self.writer.add_schema(name, "protobuf", DESCRIPTORS)?,
            Schema::Wire(name) => {
                metadata.insert("protocol".to_owned(), "rhumb/1".to_owned());
                self.writer.add_schema(name, "protobuf", DESCRIPTORS)?
            }
        };
        self.writer
            .add_channel(schema, topic, "protobuf", &metadata)
    }
}
