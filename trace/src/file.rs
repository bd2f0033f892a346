//! An MCAP file of protobuf messages, by topic.
//!
//! Compression runs on the caller's thread, so equal messages give equal bytes on any machine. The first message of a
//! topic declares it: a topic without messages is not in the file.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};

use super::topics::{Schema, Topic, TraceSink};

/// An MCAP file that is being written.
pub struct TraceFile<W: Write + Seek> {
    writer: Writer<W>,
    buffer: Vec<u8>,
}

/// Options of every file: zstd on the caller's thread, with indexes and checksums.
fn options(library: &str) -> WriteOptions {
    WriteOptions::new()
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .library(library)
}

impl<W: Write> TraceFile<NoSeek<W>> {
    /// Begins a file that only grows: after a crash it can be read up to the last chunk that was finished.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn growing(to: W, library: &str) -> Result<Self, McapError> {
        let options = options(library).disable_seeking(true);
        Ok(Self {
            writer: options.create(NoSeek::new(to))?,
            buffer: Vec::new(),
        })
    }
}

impl<W: Write + Seek> TraceFile<W> {
    /// Begins a file; `library` names the program that writes it.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn new(to: W, library: &str) -> Result<Self, McapError> {
        Ok(Self {
            writer: options(library).create(to)?,
            buffer: Vec::new(),
        })
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn put_metadata(
        &mut self,
        name: String,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), McapError> {
        self.writer.write_metadata(&Metadata { name, metadata })
    }

    /// Ends the present chunk. A reader then finds all messages so far, even if nothing follows.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()
    }

    /// Writes the indexes and closes the file.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn finish(mut self) -> Result<W, McapError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }

    fn declare(&mut self, schema: Schema, topic: &str) -> Result<u16, McapError> {
        let mut metadata = BTreeMap::new();
        if matches!(schema, Schema::Wire(_)) {
            metadata.insert("protocol".to_owned(), "rhumb/1".to_owned());
        }
        let schema = schema.message_schema();
        let schema = (self.writer).add_schema(&schema.name, &schema.encoding, &schema.data)?;
        self.writer
            .add_channel(schema, topic, "protobuf", &metadata)
    }
}

impl<W: Write + Seek> TraceSink for TraceFile<W> {
    type Error = McapError;

    /// Writes a message with log and publish time `at_ns`.
    fn put(
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
}
