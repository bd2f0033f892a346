//! Fuzzes a subscriber with arbitrary datagrams and scene changes.
//!
//! Promises: nothing panics. Memory stays within the limits. Each prediction is a motion within the limits of the wire
//! format. The subscriber sends valid packets.

use rhumb_protocol::limits::{HISTORY_PACKETS, LOST_NUMBERS_MAX};
use rhumb_protocol::packet::{
    Checksums, FullPacket, FullRecord, Low16, RefreshRecord, RefreshWriter, RepairSymbol,
    UpdateWriter, Watermark,
};
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{Anchor, BodyId, Motion, Tick, Ticks, Tolerance};

use super::packets::{KINDS, begun, written_again};
use super::payloads::{body_state, keyframe, updates};
use super::script::Script;
use super::source::{BODIES, STREAM, SceneChange, Source};

/// A source of packets with plausible numbers and ticks.
pub(super) struct PacketSource {
    pub(super) number: u64,
    pub(super) tick: u64,
    pub(super) scene_events: u64,
}

impl PacketSource {
    /// A number near another.
    fn near(script: &mut Script<'_>, number: u64) -> u64 {
        match script.below(8) {
            0 => script.any(),
            1 => number.saturating_sub(script.below(40) as u64),
            2 => number + script.below(40) as u64,
            _ => number,
        }
    }

    /// A datagram of the stream, valid or not.
    pub(super) fn datagram(&mut self, script: &mut Script<'_>, bodies: usize) -> Vec<u8> {
        let number = Self::near(script, self.number);
        let tick = Self::near(script, self.tick + 1);
        let scene_events = Self::near(script, self.scene_events);
        let (next, low_tick, low_notices) =
            (Low16::of(number), Low16::of(tick), Low16::of(scene_events));
        match script.below(8) {
            0..3 => {
                let mut writer = UpdateWriter::new(STREAM, number, tick, scene_events);
                for update in updates(script, bodies) {
                    if !writer.push(&update) {
                        break;
                    }
                }
                (self.number, self.tick) = (self.number + 1, self.tick + 1);
                writer.finish(script.any())
            }
            3 => {
                self.tick += 1;
                let watermark = Watermark {
                    next,
                    tick: low_tick,
                    scene_events: low_notices,
                };
                watermark.encode(STREAM)
            }
            4 => {
                let mut writer = RefreshWriter::default();
                let count = script.below(4) as u32;
                for index in 0..count {
                    writer.push(&RefreshRecord {
                        index: index * 2,
                        alias: script.any::<bool>().then(|| script.below(12) as u32),
                        age: Ticks::new(script.below(40) as u32),
                        keyframe: keyframe(script),
                    });
                }
                writer.finish(STREAM, number, tick, scene_events).remove(0)
            }
            5 => Checksums {
                next,
                tick: low_tick,
                scene_events: low_notices,
                sum: script.any(),
            }
            .encode(STREAM),
            6 => {
                let mut sums = script.bytes(60).to_vec();
                sums.push(1);
                let repair_symbol = RepairSymbol {
                    last: next,
                    covered: script.any::<u32>() >> 1,
                    row: script.any::<u8>() & 127,
                    sums,
                };
                repair_symbol.encode(STREAM)
            }
            _ => self.raw(script, tick),
        }
    }

    /// A full packet, or arbitrary bytes after a head of this stream.
    fn raw(&mut self, script: &mut Script<'_>, tick: u64) -> Vec<u8> {
        if script.any() {
            let records = (0..script.below(3) as u32).map(|index| FullRecord {
                index: index * 3,
                motion: body_state(script),
            });
            let packet = FullPacket {
                records: records.collect(),
                number: Low16::of(self.number),
                tick: Low16::of(tick),
                scene_events: Low16::of(self.scene_events),
                ends_tick: script.any(),
            };
            return packet.encode(STREAM);
        }
        let mut datagram = begun(script.one_of(&KINDS), STREAM);
        datagram.extend_from_slice(script.bytes(80));
        datagram
    }
}

/// A script of datagrams and scene changes.
pub fn subscriber(data: &[u8]) {
    let mut script = Script::new(data);
    let tolerance = script.one_of(&[Tolerance::NORMAL, Tolerance::EXACT, Tolerance::COARSE]);
    let mut source = Source::new(tolerance, None);
    let start = source.start();
    let limited = script.any::<bool>();
    let mut subscriber = if limited {
        Subscriber::limited(&start)
    } else {
        Subscriber::new(&start)
    };
    let mut packet_source = PacketSource {
        number: 0,
        tick: 0,
        scene_events: 0,
    };
    for index in 0..BODIES / 2 {
        let changes = source.add(index, script.sane_vector(50.0));
        apply(changes, &mut subscriber, &mut packet_source);
    }
    while script.goes_on() {
        match script.below(12) {
            0 => {
                let changes = source.add(script.below(BODIES), script.sane_vector(50.0));
                apply(changes, &mut subscriber, &mut packet_source);
            }
            1 => {
                let changes = source.remove(script.below(BODIES));
                apply(changes, &mut subscriber, &mut packet_source);
            }
            2 => {
                let (since, gravity) = (script.below(200) as u64, script.sane_vector(1e3));
                let changes = SceneChange::Gravity(Tick::new(since), gravity);
                apply(Some(changes), &mut subscriber, &mut packet_source);
            }
            3 => subscriber.handle_snapshot_end(),
            _ => {
                let datagram = packet_source.datagram(&mut script, 10);
                subscriber.handle_datagram(&datagram);
            }
        }
        check(&mut subscriber);
    }
}

fn apply(
    changes: Option<SceneChange>,
    subscriber: &mut Subscriber,
    packet_source: &mut PacketSource,
) {
    if let Some(changes) = changes {
        changes.apply_to(subscriber);
        packet_source.scene_events += 1;
    }
}

fn check(subscriber: &mut Subscriber) {
    assert!(subscriber.missing() <= HISTORY_PACKETS);
    assert!(
        subscriber.index_end() <= BODIES,
        "a packet cannot add bodies"
    );
    let loss_report = subscriber.loss_report();
    assert!(loss_report.lost.len() <= LOST_NUMBERS_MAX);
    assert_eq!(written_again(&loss_report.encode(STREAM)), Ok(()));
    let mut changed = Vec::new();
    subscriber.drain_changed(&mut changed);
    let ends = changed.iter().all(|index| *index < BODIES as u32);
    assert!(ends, "{changed:?}");
    assert_is_within_limits(subscriber, BODIES as u32);
}

/// Checks that each prediction for bodies of these indices is a motion within the limits.
pub(super) fn assert_is_within_limits(stream: &Subscriber, end: u32) {
    let ids = (0..end).filter_map(|index| stream.body(index));
    for id in ids.collect::<Vec<BodyId>>() {
        let track = stream.track(id).expect("an existing body has a track");
        if let Anchor::Quantised(quantised) = &track.anchor {
            assert!(quantised.is_within_limits(), "{id}: {quantised:?}");
        }
        for later in [0, 1, 60] {
            let tick = stream.watermark_tick() + Ticks::new(later);
            let predicted_motion = stream
                .predicted_motion(id, tick)
                .expect("a body with a track");
            assert_is_motion(&predicted_motion);
        }
    }
}

/// Checks that a motion is finite, and that its rotation is of unit length.
pub(super) fn assert_is_motion(motion: &Motion) {
    let (pose, twist) = (motion.pose(), motion.twist());
    assert!(pose.position.is_finite(), "{motion:?}");
    let unit = (pose.rotation.length() - 1.0).abs() < 1e-9;
    assert!(unit, "{motion:?}");
    let finite = twist.linear.is_finite() && twist.angular.is_finite();
    assert!(finite, "{motion:?}");
}
