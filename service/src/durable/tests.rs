//! Recovery of scenes on a disk that crashes, is cut, or is flipped.
//!
//! Each run is recorded with the digest of every tick. A restored run must equal the recorded run at its tick.

mod follow;
mod repair;
mod scene_log;
mod sim_disk;

use std::path::PathBuf;
use std::sync::Arc;

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_protocol::message::SessionKey;
use rhumb_protocol::scene::{
    ActiveEvents, BodyDesc, BodyKind, Character, Command, Joint, JointFrame, JointId, JointKind,
    JumpFrom, SceneConfig, SceneName, Shape, ShapeId, Vehicle, Wheel, WheelInput,
};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::engine::StepThreads;
use rhumb_scene::{LogEntry, Ownership, Scene, SessionNumber, Sessions};
use ring::hmac;

use self::sim_disk::SimDisk;
use super::disk::{DataError, Disk};
use super::format::{LogFrame, LogFrames, OVERHEAD, Snapshot};
use super::recovery::{LogTail, ReplayStart, Restored};
use super::scene_files::{LogHeader, SceneFiles, Segment};

const SESSION: SessionNumber = SessionNumber(0);

/// A scene that is recorded, and the digest of each of its ticks.
struct Recorded {
    disk: SimDisk,
    files: SceneFiles,
    scene: Scene,
    sessions: Sessions,
    segment: Option<Segment>,
    digests: Vec<u64>,
    /// The newest tick that was synchronised.
    durable: Tick,
    bodies: u32,
    chance: Chance,
}

fn name() -> SceneName {
    "pit".parse().unwrap()
}

fn files(disk: &SimDisk) -> SceneFiles {
    SceneFiles {
        is_there: None,
        disk: Arc::new(disk.clone()),
        directory: PathBuf::from("scenes/pit.0"),
        key: hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]),
    }
}

fn state(position: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        [0.0, 0.0, 0.0, 1.0],
        [0.0; 3],
        [0.0; 3],
    )
    .unwrap()
}

impl Recorded {
    fn new(seed: u64) -> Self {
        let disk = SimDisk::default();
        let files = files(&disk);
        let mut scene = Scene::new(SceneConfig::default()).unwrap();
        scene.record_mut().begin_log();
        let header = header(None);
        let segment = files.begin_segment(0, Tick::ZERO, &header).unwrap();
        let mut recorded = Self {
            disk,
            files,
            digests: vec![scene.digest().value()],
            scene,
            sessions: Sessions::default(),
            segment: Some(segment),
            durable: Tick::ZERO,
            bodies: 0,
            chance: Chance(seed),
        };
        recorded.note(LogEntry::opened(
            SESSION,
            SessionKey([1; 16]),
            Some("anna".into()),
        ));
        let boxes = [
            (0, Shape::cuboid(40.0, 1.0, 40.0)),
            (1, Shape::cuboid(1.0, 0.6, 0.8)),
            (2, Shape::ball(0.5)),
        ];
        for (id, shape) in boxes {
            let id = ShapeId(id);
            recorded.command(&Command::AddShape { id, shape });
        }
        recorded.add(BodyKind::Fixed, ShapeId(0), Vec3::ZERO);
        for place in 0..8 {
            recorded.add(
                BodyKind::Dynamic,
                ShapeId(1 + place % 2),
                Vec3::Y * (1.5 + place as f32),
            );
        }
        recorded.add(BodyKind::Kinematic, ShapeId(1), Vec3::new(6.0, 1.0, 0.0));
        recorded.add(BodyKind::Kinematic, ShapeId(2), Vec3::new(-6.0, 1.8, 0.0));
        let character = BodyId::new(recorded.bodies - 1, 0);
        recorded.command(&Command::SetLocomotion {
            id: character,
            locomotion: Box::new(Character::default().into()),
        });
        recorded.command(&Command::SetVelocity {
            id: character,
            linear: Vec3::X,
            angular: Vec3::Y,
        });
        recorded
    }

    fn note(&mut self, entry: LogEntry) {
        let tick = self.scene.tick();
        self.sessions.replay(&entry);
        self.scene.record_mut().note(tick, entry);
    }

    /// A numbered command of the session, whatever becomes of it.
    fn command(&mut self, command: &Command) {
        let refused = self.scene.apply(command).err();
        self.note(LogEntry::Counted(SESSION, refused));
    }

    fn add(&mut self, kind: BodyKind, shape: ShapeId, position: Vec3) {
        let id = BodyId::new(self.bodies, 0);
        self.bodies += 1;
        let desc = BodyDesc::plain(id, kind, shape);
        let motion = state(position);
        self.command(&Command::AddBody { desc, motion });
    }

    /// Some command, now and then one that is refused.
    fn any_command(&mut self) -> Command {
        let id = BodyId::new(self.chance.below(self.bodies as usize + 1) as u32, 0);
        let (small, large) = (self.chance.vector(3.0), self.chance.vector(900.0));
        match self.chance.below(16) {
            0 => Command::SetVelocity {
                id,
                linear: small,
                angular: small,
            },
            1 => Command::Impulse { id, impulse: large },
            2 => Command::Force { id, force: large },
            3 => Command::TorqueImpulse { id, impulse: small },
            4 => Command::RemoveBody { id },
            5 => Command::SetPose {
                id,
                position: small + Vec3::Y * 4.0,
                rotation: Quat::IDENTITY,
            },
            6 => Command::SetGravity {
                gravity: small - Vec3::Y * 9.0,
            },
            7 => {
                let other = BodyId::new(self.chance.below(self.bodies as usize) as u32, 0);
                let frames = [JointFrame::at(small), JointFrame::at(-small)];
                let joint = Joint::plain(JointKind::Spherical(None), [id, other], frames);
                let id = JointId(self.chance.below(4) as u32);
                Command::AddJoint {
                    id,
                    joint: Box::new(joint),
                }
            }
            8 => Command::Sleep { id },
            9 => Command::Wake { id },
            10 => Command::SetEvents {
                id,
                events: ActiveEvents {
                    contacts: true,
                    sleep: true,
                    ..ActiveEvents::NONE
                },
            },
            kind @ 11..15 => locomotion_command(kind, id, small, large),
            _ => Command::RemoveJoint {
                id: JointId(self.chance.below(4) as u32),
            },
        }
    }

    fn tick(&mut self) {
        for _ in 0..self.chance.below(3) {
            let command = self.any_command();
            self.command(&command);
        }
        if self.chance.below(8) == 0 {
            let position = self.chance.vector(2.0) + Vec3::Y * 6.0;
            self.add(BodyKind::Dynamic, ShapeId(2), position);
        }
        self.scene.step().unwrap();
        self.digests.push(self.scene.digest().value());
    }

    fn write(&mut self) {
        if let Some(batch) = self.scene.record_mut().take_batch() {
            self.segment.as_mut().unwrap().append(&[batch]).unwrap();
        }
    }

    fn sync(&mut self) {
        self.segment.as_mut().unwrap().sync().unwrap();
        self.durable = self.scene.tick();
    }

    /// Continues in a new segment, with a snapshot of its beginning if the engine has one.
    fn snapshot(&mut self) {
        self.write();
        self.sync();
        let Some(frozen) = self.scene.freeze() else {
            return;
        };
        let before = self.segment.take().unwrap();
        let number = before.number + 1;
        let header = header(Some((before.number, before.length)));
        let tick = self.scene.tick();
        self.segment = Some(self.files.begin_segment(number, tick, &header).unwrap());
        let snapshot = Snapshot {
            segment: number,
            tick,
            digest: self.scene.digest(),
            sessions: self.sessions.clone(),
            ownership: Ownership::default(),
            scene: frozen.encode().unwrap(),
        };
        self.files.write_snapshot(&snapshot).unwrap();
    }

    /// Bytes of the first frame, which holds the header.
    fn first_frame(&self) -> usize {
        let bytes = self.disk.read(&self.files.segment_path(0)).unwrap();
        OVERHEAD + LogFrames::read(&bytes).frames[0].payload.len()
    }

    fn restore(&self) -> Result<Option<Restored>, DataError> {
        self.files.restore(
            &StepThreads::default(),
            (ReplayStart::Newest, LogTail::Kept),
            &mut || {},
        )
    }

    /// Continues with a restored scene, in a new segment.
    fn continue_from(&mut self, restored: Restored) {
        let (number, tick) = (restored.next_segment, restored.scene.tick());
        let header = header(Some(restored.last));
        self.segment = Some(self.files.begin_segment(number, tick, &header).unwrap());
        self.scene = restored.scene;
        self.sessions = restored.sessions;
        self.scene.record_mut().begin_log();
        self.durable = tick;
        for entry in restored.unnoted {
            self.note(entry);
        }
    }

    /// A tick that is durable.
    fn tick_durably(&mut self) {
        self.tick();
        self.write();
        self.sync();
    }

    /// Checks that the files give the recorded scene back after some more ticks.
    fn check_after(&mut self, ticks: usize) -> Result<Restored, TestCaseError> {
        for _ in 0..ticks {
            self.tick();
            self.write();
        }
        self.sync();
        let again = self.restore().unwrap().unwrap();
        self.check(&again)?;
        prop_assert_eq!(again.scene.tick(), self.scene.tick());
        Ok(again)
    }

    /// Checks that a restored scene is the recorded one at its tick.
    fn check(&self, restored: &Restored) -> Result<(), TestCaseError> {
        let tick = restored.scene.tick().value() as usize;
        prop_assert!(tick < self.digests.len());
        prop_assert_eq!(restored.scene.digest().value(), self.digests[tick]);
        prop_assert_eq!(&restored.name, &name());
        Ok(())
    }
}

fn header(previous: Option<(u32, u64)>) -> LogHeader {
    LogHeader {
        scene: name(),
        config: SceneConfig::default(),
        previous,
    }
}

/// A run of some ticks, written and synchronised now and then, with snapshots now and then.
fn run(seed: u64, ticks: usize) -> Recorded {
    let mut recorded = Recorded::new(seed);
    for _ in 0..ticks {
        recorded.tick();
        match recorded.chance.below(12) {
            0 => recorded.snapshot(),
            1..4 => {}
            4..8 => recorded.write(),
            _ => {
                recorded.write();
                recorded.sync();
            }
        }
    }
    recorded
}

/// A command about a character or a vehicle, by its number in [`Recorded::any_command`].
fn locomotion_command(kind: usize, id: BodyId, small: Vec3, large: Vec3) -> Command {
    match kind {
        11 => Command::SetLocomotion {
            id,
            locomotion: Box::new(Character::default().into()),
        },
        12 => {
            let wheels = vec![Wheel::at(small, 0.3), Wheel::at(-small, 0.4)];
            let locomotion = Box::new(Vehicle { wheels }.into());
            Command::SetLocomotion { id, locomotion }
        }
        13 => Command::Jump {
            id,
            speed: small.y,
            from: JumpFrom::Anywhere,
        },
        _ => {
            let input = WheelInput {
                steering: small.x,
                force: large.y,
                brake: large.z.abs(),
            };
            let inputs = vec![input; 2];
            Command::SetWheels { id, inputs }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_restored_scene_goes_on_to_the_same_bits(seed in any::<u64>(), ticks in 1..90_usize) {
        let mut recorded = run(seed, ticks);
        recorded.write();
        recorded.sync();
        let mut restored = recorded.restore().unwrap().unwrap();
        recorded.check(&restored)?;
        prop_assert_eq!(restored.scene.tick(), recorded.scene.tick());
        prop_assert_eq!(&restored.sessions, &recorded.sessions);
        for _ in 0..60 {
            for _ in 0..recorded.chance.below(3) {
                let command = recorded.any_command();
                let outcomes = (recorded.scene.apply(&command), restored.scene.apply(&command));
                prop_assert_eq!(&outcomes.0, &outcomes.1);
            }
            let stepped = recorded.scene.step().unwrap();
            prop_assert_eq!(restored.scene.step().unwrap(), stepped);
            prop_assert_eq!(restored.scene.digest(), recorded.scene.digest());
        }
    }

    #[test]
    fn a_crash_loses_nothing_that_was_synchronised(seed in any::<u64>(), ticks in 1..60_usize) {
        let mut recorded = run(seed, ticks);
        let mut chance = Chance(seed ^ 99);
        recorded.disk.crash(|n| chance.below(n));
        let restored = recorded.restore().unwrap().unwrap();
        recorded.check(&restored)?;
        prop_assert!(restored.scene.tick() >= recorded.durable);
        // A second life, and a second crash.
        recorded.digests.truncate(restored.scene.tick().value() as usize + 1);
        recorded.continue_from(restored);
        for _ in 0..20 {
            recorded.tick();
            recorded.write();
            if recorded.chance.below(3) == 0 {
                recorded.sync();
            }
        }
        recorded.disk.crash(|n| chance.below(n));
        let again = recorded.restore().unwrap().unwrap();
        recorded.check(&again)?;
        prop_assert!(again.scene.tick() >= recorded.durable);
    }

    #[test]
    fn commands_behind_the_last_step_are_left_out_and_refused(
        seed in any::<u64>(),
        ticks in 1..40_usize,
        behind in 0..8_u64,
    ) {
        let mut recorded = run(seed, ticks);
        recorded.write();
        recorded.sync();
        let (tick, bodies) = (recorded.scene.tick(), recorded.scene.body_count());
        let done = recorded.sessions.get(SESSION).unwrap().commands;
        for _ in 0..behind {
            let command = recorded.any_command();
            recorded.command(&command);
            recorded.write();
        }
        recorded.add(BodyKind::Dynamic, ShapeId(2), Vec3::Y * 9.0);
        recorded.write();
        recorded.sync();
        let left_out = (ReplayStart::Newest, LogTail::LeftOut);
        let restored = recorded.files.restore(&StepThreads::default(), left_out, &mut || {});
        let restored = restored.unwrap().unwrap();
        recorded.check(&restored)?;
        prop_assert_eq!((restored.scene.tick(), restored.scene.body_count()), (tick, bodies));
        recorded.continue_from(restored);
        let session = recorded.sessions.get(SESSION).unwrap();
        prop_assert_eq!(session.commands, done + behind + 1);
        prop_assert_eq!(session.refusals_from(done).count() as u64, behind + 1);
        // The log continues from there.
        let again = recorded.check_after(10)?;
        prop_assert_eq!(&again.sessions, &recorded.sessions);
    }

    #[test]
    fn a_damaged_file_gives_an_earlier_state_or_an_error_that_names_it(
        seed in any::<u64>(),
        file in any::<prop::sample::Index>(),
        place in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let recorded = run(seed, 40);
        let paths = recorded.disk.paths();
        let path = &paths[file.index(paths.len())];
        recorded.disk.damage(path, |bytes| {
            let place = place.index(bytes.len());
            if cut {
                bytes.truncate(place);
            } else {
                bytes[place] ^= 1;
            }
        });
        match recorded.restore() {
            Ok(Some(restored)) => recorded.check(&restored)?,
            Ok(None) => prop_assert!(false, "a scene that was durable is gone without a word"),
            Err(error) => prop_assert!(error.to_string().contains("scenes/pit.0/"), "{}", error),
        }
    }
}

#[test]
fn a_log_cut_at_any_byte_is_never_taken_for_a_shorter_run() {
    let mut recorded = Recorded::new(5);
    for _ in 0..3 {
        recorded.tick_durably();
    }
    let path = recorded.files.segment_path(0);
    let bytes = recorded.disk.read(&path).unwrap();
    for cut in 0..bytes.len() {
        recorded
            .disk
            .damage(&path, |now| *now = bytes[..cut].to_vec());
        let lost = recorded.restore().err().map(|error| error.to_string());
        let lost = lost.unwrap_or_default();
        assert!(
            lost.contains("00000000.log: damaged or cut at byte"),
            "{cut}: {lost}"
        );
        assert!(
            lost.contains(&format!("of {};", bytes.len())),
            "{cut}: {lost}"
        );
    }
    recorded.disk.damage(&path, |now| *now = bytes.clone());
    let restored = recorded.restore().unwrap().unwrap();
    assert_eq!(restored.scene.tick(), Tick::new(3));
}

/// Gives the first log another format.
fn make_older(recorded: &Recorded) -> PathBuf {
    let path = recorded.files.segment_path(0);
    recorded.disk.damage(&path, |bytes| {
        let mut older = Vec::new();
        for (place, frame) in LogFrames::read(bytes).frames.iter().enumerate() {
            let mut payload = frame.payload.to_vec();
            if place == 0 {
                payload[0] = 3;
            }
            let payload = &payload;
            LogFrame { payload, ..*frame }.encode(&mut older);
        }
        *bytes = older;
    });
    path
}

#[test]
fn a_log_of_another_format_is_refused_by_its_name() {
    let mut recorded = Recorded::new(13);
    recorded.tick_durably();
    let path = make_older(&recorded);
    let refused = recorded.restore().err().map(|error| error.to_string());
    let expected = format!(
        "{}: written by another version, with logs of format 3",
        path.display()
    );
    assert_eq!(refused, Some(expected));
}

#[test]
fn a_lost_head_or_newest_segment_is_named() {
    for lost in ["00000001.log", "head"] {
        let mut recorded = Recorded::new(7);
        while recorded.files.numbers().unwrap().0.len() < 2 {
            recorded.tick();
            recorded.snapshot();
        }
        let path = recorded.files.directory.join(lost);
        recorded.disk.remove(&path).unwrap();
        let error = recorded.restore().err().map(|error| error.to_string());
        let expected = format!("{}: missing", path.display());
        assert!(
            error
                .as_ref()
                .is_some_and(|error| error.starts_with(&expected)),
            "{error:?}"
        );
    }
}

#[test]
fn a_restoration_begins_with_the_newest_snapshot_and_passes_over_a_bad_one() {
    let mut recorded = Recorded::new(3);
    let mut snapshots = Vec::new();
    while snapshots.len() < 2 {
        recorded.tick();
        recorded.snapshot();
        let (_, numbers) = recorded.files.numbers().unwrap();
        if numbers.len() > snapshots.len() {
            snapshots.push(recorded.scene.tick());
        }
    }
    let restored = recorded.restore().unwrap().unwrap();
    assert_eq!(restored.report.from, snapshots[1]);
    let newest = recorded.files.snapshot_path(2);
    recorded.disk.damage(&newest, |bytes| bytes[40] ^= 1);
    let restored = recorded.restore().unwrap().unwrap();
    recorded.check(&restored).unwrap();
    assert_eq!(restored.report.from, snapshots[0]);
    assert_eq!(restored.scene.tick(), recorded.scene.tick());
    assert_eq!(restored.report.refused.len(), 1);
}

/// Numbers from a seed.
pub(super) struct Chance(pub(super) u64);

impl Chance {
    pub(super) fn below(&mut self, n: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        ((self.0 >> 33) as usize) % n.max(1)
    }

    pub(super) fn between(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.below(1_000) as f32 / 1_000.0
    }

    pub(super) fn vector(&mut self, most: f32) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| self.between(-most, most)))
    }
}
