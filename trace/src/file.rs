//! An MCAP file of protobuf messages, and the facts it states of its scene.
//!
//! Compression runs on the caller's thread, so equal messages give equal bytes on any machine. The first message of a
//! topic declares it: a topic without messages is not in the file. The facts are the engine's parameters of
//! predictions, kept as metadata, so that a reader needs no script and no server.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::num::NonZeroU32;
use std::str::FromStr;

use glam::Vec3;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use rhumb_protocol::scene::SceneConfig;
use rhumb_reckoning::{Damping, Integrator, Rate};

use crate::topics::{Schema, Topic, TraceSink};

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

/// The log time of a tick, nanoseconds: the tick times the step, rounded to the nearest, from zero at tick 0.
///
/// This is the one rule of all traces and recordings, and of what is shown live.
#[must_use]
pub fn log_time_ns(rate: Rate, tick: u64) -> u64 {
    let (ticks, seconds) = (u128::from(rate.ticks()), u128::from(rate.seconds()));
    let ns = (u128::from(tick) * seconds * 1_000_000_000 + ticks / 2) / ticks;
    u64::try_from(ns).unwrap_or(u64::MAX)
}

/// The parameters of an engine that predictions need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneFacts {
    /// Rate and substeps.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of bodies without one of their own.
    pub damping: Damping,
}

impl SceneFacts {
    /// The facts of a scene's config.
    #[must_use]
    pub const fn of(config: &SceneConfig) -> Self {
        Self {
            integrator: config.integrator,
            gravity: config.gravity,
            damping: config.damping,
        }
    }

    /// The values of a metadata record.
    #[must_use]
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let Integrator { rate, substeps } = self.integrator;
        let Vec3 { x, y, z } = self.gravity;
        let Damping { linear, angular } = self.damping;
        [
            ("rate", format!("{}/{}", rate.ticks(), rate.seconds())),
            ("step_s", rate.step().seconds().to_string()),
            ("substeps", substeps.to_string()),
            ("gravity", format!("{x} {y} {z}")),
            ("damping", format!("{linear} {angular}")),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    /// The facts of a metadata record; `None` if it lacks one of them, as those of earlier versions do.
    #[must_use]
    pub fn of_metadata(record: &BTreeMap<String, String>) -> Option<Self> {
        let (ticks, seconds) = record.get("rate")?.split_once('/')?;
        let [x, y, z] = numbers(record.get("gravity")?)?;
        let [linear, angular] = numbers(record.get("damping")?)?;
        let damped = [linear, angular].iter().all(|damping| *damping >= 0.0);
        let substeps: NonZeroU32 = record.get("substeps")?.parse().ok()?;
        damped.then_some(Self {
            integrator: Integrator {
                rate: Rate::new(ticks.parse().ok()?, seconds.parse().ok()?)?,
                substeps,
            },
            gravity: Vec3::new(x, y, z),
            damping: Damping { linear, angular },
        })
    }
}

/// Parses `COUNT` finite numbers with spaces between them.
fn numbers<const COUNT: usize>(text: &str) -> Option<[f32; COUNT]> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map(f32::from_str)
        .collect::<Result<_, _>>()
        .ok()?;
    let finite = numbers.iter().all(|number| number.is_finite());
    numbers.try_into().ok().filter(|_| finite)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> SceneFacts {
        SceneFacts {
            integrator: Integrator {
                rate: Rate::new(30_000, 1_001).unwrap(),
                substeps: NonZeroU32::new(4).unwrap(),
            },
            gravity: Vec3::new(0.0, -9.806_65, 1e-7),
            damping: Damping {
                linear: 0.0,
                angular: 0.05,
            },
        }
    }

    #[test]
    fn facts_are_read_as_they_are_written() {
        let written = facts().to_metadata();
        assert_eq!(SceneFacts::of_metadata(&written), Some(facts()));
        for name in ["rate", "substeps", "gravity", "damping"] {
            for wrong in ["", "x", "0/0", "0", "NaN NaN NaN", "-1 -1"] {
                let mut spoiled = written.clone();
                spoiled.insert(name.to_owned(), wrong.to_owned());
                assert_eq!(SceneFacts::of_metadata(&spoiled), None, "{name} {wrong}");
            }
            let mut missing = written.clone();
            missing.remove(name);
            assert_eq!(SceneFacts::of_metadata(&missing), None, "{name}");
        }
    }

    #[test]
    fn log_times_do_not_drift() {
        assert_eq!(log_time_ns(Rate::HZ_60, 0), 0);
        assert_eq!(log_time_ns(Rate::HZ_60, 1), 16_666_667);
        assert_eq!(log_time_ns(Rate::HZ_60, 2), 33_333_333);
        assert_eq!(log_time_ns(Rate::HZ_60, 60_000_000), 1_000_000_000_000_000);
        let film = Rate::new(30_000, 1_001).unwrap();
        assert_eq!(log_time_ns(film, 30_000), 1_001_000_000_000);
        assert_eq!(log_time_ns(film, u64::MAX), u64::MAX);
    }
}
