//! `rhumb-bench dis`: bytes and errors of DIS beside those of Rhumb.
//!
//! Both publish the truth of one run over a perfect link. DIS sends Entity States by the publisher of `rhumb-dis`, with
//! gravity as the acceleration of a body in flight, full bundles and heartbeats of 5 s; its receivers predict by the
//! models of the standard. Errors are those of bodies that the recording lists as moving, at every tick: how far any point
//! of the body is from its true place.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use glam::{DVec3, Quat, Vec3};
use rhumb_dis::entity::{EntityId, Marking};
use rhumb_dis::foreign::{ForeignConfig, ForeignEntities, ForeignEvent};
use rhumb_dis::geodesy::{Geodetic, SceneAxes, TangentFrame};
use rhumb_dis::pdu::TimeBase;
use rhumb_dis::published::{Kind, Observed, Publisher, PublisherConfig};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Metres, Radians, Tick, Tolerance};
use serde::{Deserialize, Serialize};

use crate::ablate::LoadChoice;
use crate::drive::compare::divergence;
use crate::numbers::WithZeros;
use crate::output::{self, Failure, Provenance, ended};
use crate::record::{Change, Changes};
use crate::recording::Recording;
use crate::replay::{ReplayConfig, run};

/// Arguments: loads, output.
#[derive(Clone, Debug, Args)]
pub struct DisArguments {
    /// Loads: cubes, pit, asteroids, ragdolls, tumbler. NAME=FILE takes a recording in place of that load's scene.
    #[arg(long, value_delimiter = ',', default_values = ["pit", "asteroids", "ragdolls", "tumbler"])]
    load: Vec<LoadChoice>,
    /// Seed of the scenes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for dis.json; created if missing.
    #[arg(long, default_value = "results/dis")]
    out: PathBuf,
}

/// The measured rows, with their provenance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DisComparison {
    /// The commit and the machine of the measurement.
    pub provenance: Provenance,
    /// A row for each load and each way of sending it.
    pub rows: Vec<DisRow>,
}

/// One way of sending one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DisRow {
    /// Name of the load.
    pub load: String,
    /// Bodies that can move.
    pub bodies: u32,
    /// DIS or Rhumb, and its thresholds.
    pub sent_by: String,
    /// States or updates in a second.
    pub updates_per_second: f64,
    /// 1,000 bit/s with 28 bytes of UDP and IP for each datagram, and QUIC's 22 for those of Rhumb.
    pub kbps: f64,
    /// Half of the errors are at most this, metres.
    pub error_p50_m: f64,
    /// 99 of 100 errors are at most this, metres.
    pub error_p99_m: f64,
    /// The largest error, metres.
    pub error_max_m: f64,
}

/// Compares each load. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn dis(arguments: &DisArguments) -> ExitCode {
    ended(compare(arguments))
}

fn compare(arguments: &DisArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let mut rows = Vec::new();
    for choice in &arguments.load {
        let recording = choice.recording(arguments.seed)?;
        rows.extend(rows_of(choice.name(), &recording, &choice.config()?)?);
    }
    let comparison = DisComparison {
        provenance: Provenance::here(),
        rows,
    };
    let table = comparison.table();
    output::write(&arguments.out, "dis.json", &comparison, &[("", table)])?;
    Ok(())
}

/// DIS and Rhumb at the thresholds of DIS and at the load's tolerance.
fn rows_of(name: &str, recording: &Recording, base: &ReplayConfig) -> Result<Vec<DisRow>, Failure> {
    let usual = Thresholds {
        metres: 1.0,
        radians: 3_f64.to_radians(),
    };
    let fine = Thresholds {
        metres: base.tolerance.reach(Metres::new(0.0)).metres(),
        // The turn by which a point at the bounding radius moves as far as the position may.
        radians: f64::INFINITY,
    };
    let loose = Tolerance::parts(Metres::new(usual.metres), Radians::new(usual.radians))?;
    let mut rows = Vec::new();
    for (thresholds, tolerance) in [(usual, loose), (fine, base.tolerance)] {
        let label = if thresholds == usual {
            "1 m, 3°".to_owned()
        } else {
            format!("{} m", fine.metres)
        };
        let mut dis = SentByDis::run(recording, thresholds);
        rows.push(dis.row(name, recording, &label)?);
        let config = ReplayConfig { tolerance, ..*base };
        rows.push(rhumb_row(name, recording, &config, &label)?);
    }
    Ok(rows)
}

fn seconds_of(recording: &Recording) -> f64 {
    f64::from(recording.ticks()) * recording.integrator.rate.step().seconds()
}

fn movable(recording: &Recording) -> u32 {
    let placed = recording.truth.placed.iter();
    let moves = placed.filter(|placed| placed.desc.kind != BodyKind::Fixed);
    moves.count() as u32
}

/// The figures of errors: p50, p99, largest.
fn quantiles(errors: &mut WithZeros) -> Result<[f64; 3], Failure> {
    let mut of = |percent| {
        errors
            .percentile(percent)
            .ok_or("the recording has no tick")
    };
    Ok([of(50)?, of(99)?, of(100)?])
}

fn rhumb_row(
    name: &str,
    recording: &Recording,
    config: &ReplayConfig,
    label: &str,
) -> Result<DisRow, Failure> {
    let bar = output::progress_bar(u64::from(recording.ticks()), format!("{name}, Rhumb"));
    let run = run(recording, config, &mut |_| bar.inc(1))?;
    bar.finish_and_clear();
    let mut errors = WithZeros::default();
    let (mut bytes, mut updates) = (0, 0);
    for frame in &run.frames {
        errors.extend(&frame.moving_errors_m, 0);
        bytes += frame.wire_bytes_down + HEADER_BYTES * frame.wire_datagrams_down;
        updates += frame.updates;
    }
    let [error_p50_m, error_p99_m, error_max_m] = quantiles(&mut errors)?;
    let seconds = seconds_of(recording);
    Ok(DisRow {
        load: name.to_owned(),
        bodies: movable(recording),
        sent_by: format!("Rhumb, {label}"),
        updates_per_second: updates as f64 / seconds,
        kbps: bytes as f64 * 8e-3 / seconds,
        error_p50_m,
        error_p99_m,
        error_max_m,
    })
}

/// Bytes of UDP and IPv4.
const HEADER_BYTES: u64 = 28;

/// Most distance and turn from the dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Thresholds {
    metres: f64,
    /// Infinite: as many as move a point at the bounding radius by the metres.
    radians: f64,
}

/// A body at the present tick.
struct Moving {
    kind: Kind,
    radius: Metres,
    motion: BodyState,
    acceleration: DVec3,
    activity: Activity,
}

/// One run over DIS.
struct SentByDis {
    publisher: Publisher,
    receiver: ForeignEntities,
    bodies: BTreeMap<u64, Moving>,
    names: BTreeMap<EntityId, u64>,
    errors: WithZeros,
    bytes: u64,
}

const fn key(id: BodyId) -> u64 {
    (id.index() as u64) << 16 | id.generation() as u64
}

impl SentByDis {
    fn run(recording: &Recording, thresholds: Thresholds) -> Self {
        let place = Geodetic::from_degrees(48.1, 11.6, 520.0).expect("it is on the earth");
        let axes = SceneAxes::YUp;
        let frame = TangentFrame::new(place, axes);
        let (exercise, site) = (1, 1);
        let mut sent = Self {
            publisher: Publisher::new(PublisherConfig {
                exercise,
                site,
                application: 1,
                frame,
                axes,
                base: TimeBase::Absolute,
                datagram_bytes: 1_440,
                states_per_second: u32::MAX,
            }),
            receiver: ForeignEntities::new(ForeignConfig {
                exercise,
                site,
                application: 2,
                frame,
                axes,
                timeout: ForeignConfig::TIMEOUT,
                entities_max: usize::MAX,
                reach: f64::INFINITY,
                pdus_per_second: u32::MAX,
            }),
            bodies: BTreeMap::new(),
            names: BTreeMap::new(),
            errors: WithZeros::default(),
            bytes: 0,
        };
        let step = recording.integrator.rate.step().seconds();
        let mut changes = recording.truth.changes();
        for tick in 0..=u64::from(recording.ticks()) {
            let row = sent.step(recording, tick, &mut changes, thresholds);
            // The scene begins at a full hour.
            let now = Duration::from_secs_f64(tick as f64 * step);
            sent.publish(now);
            sent.compare(now, row.iter().map(|observation| key(observation.id)));
        }
        sent
    }

    /// Takes the truth of a tick, and returns what is observed in it.
    fn step<'a>(
        &mut self,
        recording: &'a Recording,
        tick: u64,
        changes: &mut Changes<'a>,
        thresholds: Thresholds,
    ) -> &'a [Observation] {
        let truth = &recording.truth;
        while let Some(change) = changes.until(Tick::new(tick)) {
            match change {
                Change::Placed(_, one) if one.desc.kind != BodyKind::Fixed => {
                    let radius = one.shape.bounding_radius();
                    let body = Moving {
                        kind: kind(key(one.desc.id), radius, thresholds),
                        radius,
                        motion: one.observation.motion,
                        acceleration: DVec3::ZERO,
                        activity: one.observation.activity,
                    };
                    self.bodies.insert(key(one.desc.id), body);
                }
                Change::Placed(..) => {}
                Change::Removed(id) => {
                    self.bodies.remove(&key(id));
                }
            }
        }
        let row = (tick as usize)
            .checked_sub(1)
            .map_or(&[][..], |row| &truth.ticks[row]);
        let step = recording.integrator.rate.step().seconds();
        for observation in row {
            if let Some(body) = self.bodies.get_mut(&key(observation.id)) {
                let (before, after) = (body.motion, observation.motion);
                body.acceleration = fall(before, after, step, recording.gravity);
                (body.motion, body.activity) = (after, observation.activity);
            }
        }
        row
    }

    fn publish(&mut self, now: Duration) {
        let observed: Vec<_> = self
            .bodies
            .iter()
            .map(|(key, body)| observed(*key, body))
            .collect();
        self.publisher.handle_bodies(now, &observed);
        let mut buffer = [0; 1_440];
        while let Some(bytes) = self.publisher.poll_datagram(&mut buffer) {
            self.bytes += bytes as u64 + HEADER_BYTES;
            let read = self.receiver.handle_datagram(now, &buffer[..bytes]);
            debug_assert_eq!(read, Ok(()), "our own states are sound");
        }
        while let Some(event) = self.receiver.poll_event() {
            match event {
                ForeignEvent::Appeared { id, marking, .. } => {
                    let text = std::str::from_utf8(&marking.text).unwrap_or_default();
                    let key = u64::from_str_radix(text.trim_end_matches('\0'), 36);
                    self.names.extend(key.ok().map(|key| (id, key)));
                }
                ForeignEvent::Left { id, .. } => {
                    self.names.remove(&id);
                }
            }
        }
    }

    /// Adds the errors of these bodies.
    fn compare(&mut self, now: Duration, seen: impl Iterator<Item = u64>) {
        let seen: BTreeSet<u64> = seen.collect();
        let mut errors = Vec::with_capacity(seen.len());
        for pose in self.receiver.poses(now) {
            let name = self.names.get(&pose.id).filter(|key| seen.contains(key));
            if let Some(body) = name.and_then(|key| self.bodies.get(key)) {
                let rotation: Quat = pose.rotation.as_quat();
                let off = divergence(&body.motion, pose.position.as_vec3(), rotation);
                errors.push(off.surface_error(body.radius).metres() as f32);
            }
        }
        self.errors.extend(&errors, 0);
    }

    fn row(&mut self, name: &str, recording: &Recording, label: &str) -> Result<DisRow, Failure> {
        let [error_p50_m, error_p99_m, error_max_m] = quantiles(&mut self.errors)?;
        let seconds = seconds_of(recording);
        let counts = self.publisher.statistics();
        Ok(DisRow {
            load: name.to_owned(),
            bodies: movable(recording),
            sent_by: format!("DIS, {label}"),
            updates_per_second: (counts.updates + counts.heartbeats) as f64 / seconds,
            kbps: self.bytes as f64 * 8e-3 / seconds,
            error_p50_m,
            error_p99_m,
            error_max_m,
        })
    }
}

/// A body's thresholds, with its key as its name.
fn kind(key: u64, radius: Metres, thresholds: Thresholds) -> Kind {
    let mut digits = Vec::new();
    let mut rest = key;
    while rest > 0 || digits.is_empty() {
        digits.extend(char::from_digit((rest % 36) as u32, 36));
        rest /= 36;
    }
    let turn = 2.0 * (0.5 * thresholds.metres / radius.metres()).min(1.0).asin();
    Kind {
        marking: Marking::ascii(&digits.into_iter().rev().collect::<String>()),
        metres: thresholds.metres,
        radians: thresholds.radians.min(turn.max(1e-6)),
        ..Kind::default()
    }
}

/// Gravity if it alone has changed the velocity within a step, else nothing.
fn fall(before: BodyState, after: BodyState, step: f64, gravity: Vec3) -> DVec3 {
    let velocity = |state: BodyState| state.motion().twist().linear;
    let change = (velocity(after) - velocity(before)) / step;
    let gravity = gravity.as_dvec3();
    let is_free = (change - gravity).length() <= 0.02 * gravity.length();
    if is_free { gravity } else { DVec3::ZERO }
}

fn observed(key: u64, body: &Moving) -> Observed {
    let motion = body.motion.motion();
    let rests = body.activity == Activity::Asleep;
    let [velocity, acceleration, spin] = if rests {
        [DVec3::ZERO; 3]
    } else {
        [
            motion.twist().linear,
            body.acceleration,
            motion.twist().angular,
        ]
    };
    Observed {
        key,
        kind: body.kind,
        position: motion.pose().position,
        rotation: motion.pose().rotation,
        velocity,
        acceleration,
        spin,
    }
}

impl DisComparison {
    fn table(&self) -> Vec<Vec<String>> {
        let head = [
            "load",
            "bodies",
            "sent by",
            "updates/s",
            "kbit/s",
            "error p50, m",
            "p99",
            "max",
        ];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.extend(self.rows.iter().map(|row| {
            vec![
                row.load.clone(),
                row.bodies.to_string(),
                row.sent_by.clone(),
                format!("{:.1}", row.updates_per_second),
                format!("{:.1}", row.kbps),
                format!("{:.4}", row.error_p50_m),
                format!("{:.4}", row.error_p99_m),
                format!("{:.4}", row.error_max_m),
            ]
        }));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_dis_stay_within_its_thresholds_at_several_times_the_bytes() {
        let choice: LoadChoice = "tumbler".parse().expect("a load");
        let mut choice = choice;
        choice.of.seconds = 3.0;
        let recording = choice.recording(1).expect("the scene runs");

        let config = choice.config().expect("its tolerance is sound");
        let rows = rows_of("tumbler", &recording, &config).expect("it is measured");
        let [dis, _, fine, rhumb] = <[DisRow; 4]>::try_from(rows).expect("four rows");
        assert!(
            dis.error_max_m > 0.0 && dis.error_max_m <= 1.0 + 0.1,
            "{dis:?}"
        );
        // Position and turn have a threshold each.
        assert!(fine.error_max_m <= 2.0 * 0.05 + 1e-6, "{fine:?}");
        assert!(
            dis.kbps > rhumb.kbps && fine.kbps > 3.0 * rhumb.kbps,
            "{dis:?} {fine:?} {rhumb:?}"
        );
        assert!(rhumb.error_max_m <= 0.05 + 1e-6, "{rhumb:?}");
    }
}
