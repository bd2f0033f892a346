//! Reads an MCAP file: a trace, a server's recording, or others' poses.
//!
//! A trace has a load for each number of bodies, a recording one for each scene, and another program's file one for
//! each kind of poses. One of them is read. The truth of a load is in the messages of its topic `truth/state`. A trace
//! begins at tick 0, a recording of a server at any tick, which becomes tick 0 here. A recording may lack ticks: the
//! next message then has every body.

use std::collections::BTreeMap;

use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Rate, Tick};
use rhumb_trace::{FileContents, SceneFacts, StatesReader, StoredChannel, TickStates};

use super::error::RecordingError;
use super::foxglove;
use super::options::{ReadOptions, rate_of_step};
use super::recorded::{self, Recording, ScriptOrigin, Velocities, set_digest};
use crate::record::{Placed, Truth};

/// The end of the topics of states.
const STATES: &str = "/truth/state";

/// Reads a load.
///
/// # Errors
///
/// [`RecordingError`] if the bytes are no MCAP file, or it has no bodies that are read.
pub fn read(name: &str, bytes: &[u8], options: &ReadOptions) -> Result<Recording, RecordingError> {
    let outline = FileContents::read(bytes, &|_| false)?;
    outline.check_begun(bytes.len())?;
    let loads = loads(&outline);
    let mut recording = if loads.is_empty() {
        let mut recording = foxglove::read(name, bytes, &outline, options)?;
        let unused = options.note_unused("messages", &["--load"]);
        recording.notes.extend(unused);
        recording
    } else {
        let load = options.choose(&loads)?;
        let mut recording = of_states(bytes, &outline, load)?;
        recording.notes.extend(options.note_of_states());
        if loads.len() > 1 && options.load.is_none() {
            recording.notes.push(format!(
                "of the loads {} this is {load}; --load NAME chooses another, in `fit` FILE,load=NAME",
                loads.join(", ")
            ));
        }
        recording
    };
    recording.notes.extend(outline.note());
    Ok(recording)
}

/// The loads that have states, in the order of the file.
fn loads(outline: &FileContents) -> Vec<String> {
    let is_of_states = |channel: &&StoredChannel| channel.schema == "rhumb.States";
    let channels = outline.channels.values().filter(is_of_states);
    let mut loads: Vec<String> = Vec::new();
    for channel in channels {
        let load = channel.topic.strip_suffix(STATES);
        let load = load.map(|load| load.trim_start_matches('/').to_owned());
        loads.extend(load.filter(|load| !loads.contains(load)));
    }
    loads
}

/// A load of a trace or a recording.
fn of_states(
    bytes: &[u8],
    outline: &FileContents,
    load: &str,
) -> Result<Recording, RecordingError> {
    let topic = format!("/{load}{STATES}");
    let contents = FileContents::read(bytes, &|channel| channel.topic == topic)?;
    let ReadTruth {
        truth,
        has_velocities,
        notes,
    } = read_truth(&contents, load)?;
    let mut recording = match origin(outline, load)? {
        Origin::Stated {
            name,
            played,
            facts,
        } => Recording {
            name,
            played,
            truth,
            integrator: facts.integrator,
            gravity: facts.gravity,
            damping: facts.damping,
            inertias: BTreeMap::new(),
            velocities: Velocities::Recorded,
            notes: Vec::new(),
        },
        Origin::Script { name, played } => {
            let ScriptOrigin { bodies, seed } = played;
            let script = rhumb_sims::by_name(&name, bodies, seed);
            let mut script = script.ok_or(RecordingError::UnknownScene { name })?;
            Recording {
                played: Some(played),
                ..Recording::of_play(&mut *script, truth)
            }
        }
        Origin::Unstated { name, rate } => unstated(name, rate, truth),
    };
    recording.notes.extend(notes);
    if !has_velocities {
        recorded::derive(&mut recording)?;
        set_digest(&mut recording.truth);
    }
    Ok(recording)
}

/// A recording of a server that did not state its engine yet.
fn unstated(name: String, rate: Option<Rate>, truth: Truth) -> Recording {
    let usual = rhumb_protocol::scene::SceneConfig::default();
    Recording {
        name,
        played: None,
        truth,
        integrator: rhumb_reckoning::Integrator {
            rate: rate.unwrap_or(usual.integrator.rate),
            ..usual.integrator
        },
        gravity: usual.gravity,
        damping: usual.damping,
        inertias: BTreeMap::new(),
        velocities: Velocities::Recorded,
        notes: vec![
            "the file does not state the engine's gravity, damping and substeps: those of a new scene are taken"
                .to_owned(),
        ],
    }
}

/// The source of the settings of a load's engine.
enum Origin {
    /// Its facts.
    Stated {
        name: String,
        played: Option<ScriptOrigin>,
        facts: SceneFacts,
    },
    /// The script that it ran, as older traces do.
    Script { name: String, played: ScriptOrigin },
    /// Its rate at most, as older recordings do.
    Unstated { name: String, rate: Option<Rate> },
}

fn origin(outline: &FileContents, load: &str) -> Result<Origin, RecordingError> {
    let records = |begins: &'static str| {
        let named =
            move |record: &&(String, BTreeMap<String, String>)| record.0.starts_with(begins);
        outline
            .metadata
            .iter()
            .filter(named)
            .map(|(_, record)| record)
    };
    let of_load =
        |record: &&BTreeMap<String, String>| record.get("load").is_some_and(|of| of == load);
    let of_scene =
        |record: &&BTreeMap<String, String>| record.get("scene").is_some_and(|of| of == load);
    let truth = outline
        .metadata
        .iter()
        .find(|(name, _)| *name == format!("rhumb.truth.{load}"));
    let facts = truth.and_then(|(_, record)| SceneFacts::of_metadata(record));
    if let Some(run) = records("rhumb.run.").find(of_load) {
        let value = |name: &str| run.get(name).map(String::as_str).unwrap_or_default();
        let name = value("scene").to_owned();
        let played = match (value("bodies").parse(), value("seed").parse()) {
            (Ok(bodies), Ok(seed)) => Some(ScriptOrigin { bodies, seed }),
            _ => None,
        };
        return match (facts, played) {
            (Some(facts), played) => {
                let played = played.filter(|_| rhumb_sims::NAMES.contains(&&*name));
                Ok(Origin::Stated {
                    name,
                    played,
                    facts,
                })
            }
            (None, Some(played)) => Ok(Origin::Script { name, played }),
            (None, None) => Err(RecordingError::UnknownScene { name }),
        };
    }
    let scene = records("rhumb.scene").find(of_scene);
    let name = load.to_owned();
    if let Some(facts) = scene.and_then(SceneFacts::of_metadata) {
        let played = None;
        return Ok(Origin::Stated {
            name,
            played,
            facts,
        });
    }
    let step_s = scene.and_then(|scene| scene.get("step_s")?.parse().ok());
    let rate = step_s.and_then(|step_s| rate_of_step(step_s, 1e-6));
    Ok(Origin::Unstated { name, rate })
}

/// Ticks that a recording may lack at a time: an hour at 60 Hz.
const MISSING_MAX: u64 = 216_000;

/// A truth as it is read.
struct ReadTruth {
    pub(super) truth: Truth,
    /// False if the poses have no velocities.
    pub(super) has_velocities: bool,
    pub(super) notes: Vec<String>,
}

/// The truth of a load, from the messages of its topic.
fn read_truth(contents: &FileContents, load: &str) -> Result<ReadTruth, RecordingError> {
    let mut reader = StatesReader::default();
    let mut building = Building::default();
    for message in &contents.messages {
        let states = reader.read(&message.bytes);
        let states = states.map_err(|cause| RecordingError::Message {
            topic: contents.topic(message).to_owned(),
            log_ns: message.log_ns,
            cause,
        })?;
        let states = states.ok_or(RecordingError::Number {
            tick: building.last,
            index: 0,
        })?;
        building.add(states, load)?;
    }
    if building.truth.ticks.is_empty() {
        return Err(RecordingError::NoTruth);
    }
    set_digest(&mut building.truth);
    let missing = building.missing;
    Ok(ReadTruth {
        truth: building.truth,
        has_velocities: building.has_velocities,
        notes: (missing > 0)
            .then(|| format!("the recording lacks {missing} ticks: its bodies stand still in them"))
            .into_iter()
            .collect(),
    })
}

/// A truth while its messages come.
struct Building {
    truth: Truth,
    /// Present bodies: the places of their placements.
    there: BTreeMap<BodyId, usize>,
    first: Option<Tick>,
    last: Tick,
    missing: u64,
    has_velocities: bool,
}

impl Default for Building {
    fn default() -> Self {
        Self {
            truth: Truth::default(),
            there: BTreeMap::new(),
            first: None,
            last: Tick::ZERO,
            missing: 0,
            has_velocities: true,
        }
    }
}

impl Building {
    fn add(&mut self, states: TickStates, load: &str) -> Result<(), RecordingError> {
        let first = *self.first.get_or_insert(states.tick);
        let since = states
            .tick
            .since(first)
            .map(|ticks| u64::from(ticks.count()));
        let twice = || RecordingError::TickTwice {
            tick: states.tick,
            load: load.to_owned(),
        };
        // Log times grow with ticks, so a tick that does not follow is one of another run.
        let since = since.ok_or_else(twice)?;
        let is_first = since == 0 && self.truth.ticks.is_empty() && self.there.is_empty();
        let due = self.truth.ticks.len() as u64 + 1;
        if !is_first {
            if since < due {
                return Err(twice());
            }
            if since - due > MISSING_MAX {
                return Err(RecordingError::Record {
                    tick: states.tick,
                    index: 0,
                });
            }
            if since > due {
                self.missing += since - due;
                self.stand_still();
            }
            self.truth.ticks.resize(since as usize - 1, Vec::new());
        }
        self.last = states.tick;
        self.has_velocities &= states.is_exact || states.observed.is_empty();
        let tick = Tick::new(since);
        let mut row = states.observed;
        let gone = states.removed.iter().map(|(_, id)| *id);
        let (gone, new): (Vec<_>, Vec<_>) = gone.partition(|id| self.there.contains_key(id));
        gone.into_iter().for_each(|id| self.remove(tick, id));
        for placed in states.placed {
            self.place(Placed { tick, ..placed }, &mut row);
        }
        // A body that was placed and removed between two messages may be unknown.
        new.into_iter().for_each(|id| self.remove(tick, id));
        if is_first {
            return Ok(());
        }
        if let Some(unknown) = row.iter().find(|of| !self.is_known(of, tick)) {
            return Err(RecordingError::NotPlaced {
                tick: states.tick,
                index: unknown.id.index(),
            });
        }
        row.sort_by_key(|observation| observation.id.index());
        self.truth.ticks.push(row);
        Ok(())
    }

    /// Ticks are missing: what moved stands still until the next one.
    fn stand_still(&mut self) {
        let last = Tick::new(self.truth.ticks.len() as u64);
        let placed = self.truth.placed.iter_mut().rev();
        for placed in placed.take_while(|placed| placed.tick == last) {
            placed.observation.activity = Activity::Asleep;
        }
        for observation in self.truth.ticks.last_mut().into_iter().flatten() {
            observation.activity = Activity::Asleep;
        }
    }

    /// A body may be observed in the tick in which it is removed.
    fn is_known(&self, observation: &Observation, tick: Tick) -> bool {
        let removed = || (self.truth.removed.iter().rev()).take_while(|(when, _)| *when == tick);
        self.there.contains_key(&observation.id) || removed().any(|(_, id)| *id == observation.id)
    }

    fn remove(&mut self, tick: Tick, id: BodyId) {
        if self.there.remove(&id).is_some() {
            self.truth.removed.push((tick, id));
        }
    }

    /// Places a body. A body that exists already moves to its new place, or is exchanged if it has changed.
    fn place(&mut self, placed: Placed, row: &mut Vec<Observation>) {
        let id = placed.desc.id;
        if let Some(known) = self.there.get(&id) {
            let known = &mut self.truth.placed[*known];
            let is_same = known.shape == placed.shape && known.desc == placed.desc;
            row.retain(|observation| observation.id != id);
            if is_same && known.inertia == placed.inertia {
                row.push(placed.observation);
                return;
            }
            if known.tick == placed.tick {
                *known = placed;
                return;
            }
            self.remove(placed.tick, id);
        }
        self.there.insert(id, self.truth.placed.len());
        self.truth.placed.push(placed);
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Cursor;

    use mcap::records::op;
    use mcap::{Compression, MessageStream, Summary, WriteOptions};

    use super::*;

    fn read(bytes: &[u8]) -> Result<Recording, RecordingError> {
        super::read("trace", bytes, &ReadOptions::default())
    }

    fn packed() -> Vec<u8> {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../tests/data/traces/free_fall.mcap"
        );
        fs::read(path).expect("the repository contains a trace")
    }

    /// The same trace, written otherwise.
    fn written(options: WriteOptions) -> Vec<u8> {
        let packed = packed();
        let mut writer = options
            .create(Cursor::new(Vec::new()))
            .expect("writing to memory succeeds");
        for message in MessageStream::new(&packed).expect("it is a trace") {
            writer
                .write(&message.expect("the trace is intact"))
                .expect("writing to memory succeeds");
        }
        let summary = Summary::read(&packed)
            .expect("the trace is intact")
            .expect("it has a summary");
        for index in &summary.metadata_indexes {
            let record = ::mcap::read::metadata(&packed, index).expect("the trace is intact");
            writer
                .write_metadata(&record)
                .expect("writing to memory succeeds");
        }
        writer.finish().expect("writing to memory succeeds");
        writer.into_inner().into_inner()
    }

    #[test]
    fn a_trace_without_summary_or_packed_by_lz4_is_read_as_the_same() {
        let digest = read(&packed()).expect("the trace is intact").truth.digest;
        let plain = WriteOptions::new();
        let forms = [
            plain.clone().compression(Some(Compression::Lz4)),
            plain.clone().emit_summary_records(false),
            plain
                .emit_message_indexes(false)
                .emit_metadata_indexes(false),
        ];
        for options in forms {
            let recording = read(&written(options)).expect("it is the same trace");
            assert_eq!(recording.truth.digest, digest);
        }
    }

    #[test]
    fn what_is_for_poses_alone_is_named_where_a_file_has_states() {
        let whole = written(WriteOptions::new());
        let options = ReadOptions {
            gravity: Some(glam::Vec3::ZERO),
            missing: super::super::options::MissingPoses::Hold,
            ..ReadOptions::default()
        };
        let notes = super::read("a", &whole, &options)
            .expect("whole")
            .notes
            .join("\n");
        assert!(notes.contains("not used: --gravity, --missing"), "{notes}");
        let plain = super::read("a", &whole, &ReadOptions::default()).expect("whole");
        assert!(
            !plain.notes.join("\n").contains("not used"),
            "{:?}",
            plain.notes
        );
    }

    #[test]
    fn a_trace_that_ends_early_is_read_up_to_there_with_a_note() {
        let whole = written(WriteOptions::new().compression(None));
        let ticks = read(&whole).expect("it is whole").ticks();
        // The metadata of this copy follow its messages; a writer of traces puts them first.
        let summary = Summary::read(&whole).unwrap().unwrap();
        let metadata = summary.metadata_indexes.iter();
        let records = metadata.flat_map(|index| {
            whole[index.offset as usize..(index.offset + index.length) as usize].to_vec()
        });
        let records: Vec<u8> = records.collect();
        let header = 8 + 9 + u64::from_le_bytes(whole[9..17].try_into().unwrap()) as usize;
        let cut = |length: usize| {
            let parts = [&whole[..header], &records, &whole[header..length]].concat();
            read(&parts).ok()
        };
        let found: Vec<_> = (header..whole.len()).step_by(701).filter_map(cut).collect();
        let counts: Vec<u32> = found.iter().map(Recording::ticks).collect();
        assert!(counts.is_sorted() && counts[0] < ticks, "{counts:?}");
        assert_eq!(counts.last(), Some(&ticks));
        assert!(
            found[0].notes[0].contains("has no end"),
            "{:?}",
            found[0].notes
        );
    }

    #[test]
    fn a_load_that_is_not_there_is_refused_with_those_that_are() {
        let options = ReadOptions {
            load: Some("n7".to_owned()),
            ..ReadOptions::default()
        };
        let refused = super::read("trace", &packed(), &options).expect_err("there is no such load");
        let refused = refused.to_string();
        assert!(refused.contains("no load \"n7\"; there are n"), "{refused}");
    }

    #[test]
    fn an_oversized_record_is_refused_without_allocating_its_length() {
        let whole = written(WriteOptions::new().compression(None));
        assert!(read(&whole).is_ok());
        // Magic; the header's code, length and body; the chunk's code and length, and 40 bytes before its first record.
        let header = u64::from_le_bytes(whole[9..17].try_into().expect("eight bytes"));
        let at = 8 + 9 + header as usize + 9 + 40;
        assert_eq!(whole[at], op::SCHEMA);
        for length in [u64::MAX, 1 << 62, (64 << 20) + 1_u64] {
            let mut spoiled = whole.clone();
            spoiled[at + 1..at + 9].copy_from_slice(&length.to_le_bytes());
            assert!(
                matches!(read(&spoiled), Err(RecordingError::Contents(_))),
                "{length}"
            );
        }
    }
}
