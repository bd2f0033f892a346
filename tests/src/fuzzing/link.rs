//! Fuzzes a publisher and a subscriber over a scripted link.
//!
//! Promises: every packet is well-formed for its receiver. While the subscriber has a complete tick, its tracks are
//! bit-identical to the publisher's. Each stated bound holds. After the end of the script the subscriber converges.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::stream::{Budget, ErrorBound, Redundancy, Subscriber};
use rhumb_reckoning::{Divergence, Metres, Radians, Tolerance};

use super::script::Script;
use super::source::{BODIES, SceneChange, Source, parameters};

/// Number of ticks of one script, so that it ends soon.
const TICKS_MAX: u64 = 240;
/// Ticks within which the subscriber converges once no datagram is lost.
const CALM_TICKS: u64 = 40;

struct FuzzedLink {
    source: Source,
    subscriber: Subscriber,
    limited: bool,
    /// Datagrams in flight, by the tick of their arrival.
    in_flight: VecDeque<(u64, Bytes)>,
    pending_changes: VecDeque<(u64, SceneChange)>,
    /// One bit for each datagram in turn: whether it is lost.
    loss_bits: u32,
    /// Greatest delay of datagrams and of scene changes, in ticks.
    late: [u64; 2],
    copies: bool,
    redundancy: Redundancy,
    sent: u32,
}

/// A script of ticks, impulses, new bodies and faults.
pub fn link(data: &[u8]) {
    let mut script = Script::new(data);
    let mut link = FuzzedLink::new(&mut script);
    while script.goes_on() && link.source.tick.value() < TICKS_MAX {
        link.act(&mut script);
        link.check();
    }
    (link.loss_bits, link.late, link.copies) = (0, [0, 0], false);
    for _ in 0..CALM_TICKS {
        link.tick();
        link.check();
    }
    let tick = link.source.tick;
    assert!(
        link.subscriber.is_converged(),
        "the subscriber does not converge"
    );
    assert_eq!(link.subscriber.complete(), tick);
    assert_eq!(
        link.subscriber.state_checksum(),
        link.source.publisher.state_checksum()
    );
}

fn tolerance(script: &mut Script<'_>) -> Tolerance {
    let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002));
    match script.below(5) {
        0 => Tolerance::EXACT,
        1 => Tolerance::FINE,
        2 => Tolerance::COARSE,
        3 => parts.expect("within bounds"),
        _ => Tolerance::NORMAL,
    }
}

impl FuzzedLink {
    fn new(script: &mut Script<'_>) -> Self {
        let tolerance = tolerance(script);
        let limited = script.below(4) == 0;
        let budget = limited.then(|| Budget::new(1_500, 1_150).expect("within bounds"));
        let source = Source::new(tolerance, budget);
        let start = source.start();
        let mut subscriber = if limited {
            Subscriber::limited(&start)
        } else {
            Subscriber::new(&start)
        };
        subscriber.handle_snapshot_end();
        let mut link = Self {
            source,
            subscriber,
            limited,
            in_flight: VecDeque::new(),
            pending_changes: VecDeque::new(),
            loss_bits: 0,
            late: [0, 0],
            copies: false,
            redundancy: Redundancy::Off,
            sent: 0,
        };
        for index in 0..BODIES / 2 {
            let changes = link.source.add(index, script.sane_vector(20.0));
            link.queue_changes(changes);
        }
        link
    }

    fn queue_changes(&mut self, changes: impl IntoIterator<Item = SceneChange>) {
        let at = self.source.tick.value() + self.late[1];
        self.pending_changes
            .extend(changes.into_iter().map(|changes| (at, changes)));
    }

    fn act(&mut self, script: &mut Script<'_>) {
        match script.below(10) {
            0..3 => {
                for _ in 0..=script.below(8) {
                    self.tick();
                    self.check();
                }
            }
            3 | 4 => self.source.strike(script),
            5 => {
                self.loss_bits = script.any();
                self.late = [script.below(5) as u64, script.below(9) as u64];
                self.copies = script.any();
            }
            6 => {
                let changes = self
                    .source
                    .add(script.below(BODIES), script.sane_vector(20.0));
                self.queue_changes(changes);
            }
            7 => {
                let changes = self.source.remove(script.below(BODIES));
                self.queue_changes(changes);
            }
            8 => {
                let changes = self.source.change_gravity(script.sane_vector(30.0));
                self.queue_changes([changes]);
            }
            _ => {
                self.redundancy = script.one_of(&[
                    Redundancy::Off,
                    Redundancy::Thin,
                    Redundancy::Plain,
                    Redundancy::Thick,
                ]);
            }
        }
    }

    fn is_lost(&mut self) -> bool {
        self.sent = self.sent.wrapping_add(1);
        self.loss_bits.rotate_right(self.sent) & 1 == 1
    }

    fn send(&mut self, datagram: &Bytes) {
        if self.is_lost() {
            return;
        }
        let now = self.source.tick.value();
        let delay = if self.late[0] == 0 {
            0
        } else {
            u64::from(self.sent) % (self.late[0] + 1)
        };
        self.in_flight.push_back((now + delay, datagram.clone()));
        if self.copies {
            self.in_flight
                .push_back((now + delay / 2, datagram.clone()));
        }
    }

    fn tick(&mut self) {
        let mut datagrams = self.source.step();
        let tick = self.source.tick.value();
        // Checksum packets do not carry the error scale of a stream with a budget, so such a stream sends none
        // separately.
        if tick.is_multiple_of(10) && !self.limited {
            datagrams.push(self.source.publisher.checksums(self.source.scene_events));
        }
        self.source
            .publisher
            .encode_repair_symbols(self.redundancy, &mut datagrams);
        for datagram in &datagrams {
            self.send(datagram);
        }
        self.deliver();
        if tick.is_multiple_of(5) {
            self.loss_report();
        }
    }

    fn deliver(&mut self) {
        let now = self.source.tick.value();
        while let Some((_, changes)) = self.pending_changes.pop_front_if(|(at, _)| *at <= now) {
            changes.apply_to(&mut self.subscriber);
        }
        let (due, later): (Vec<_>, Vec<_>) =
            self.in_flight.drain(..).partition(|(at, _)| *at <= now);
        self.in_flight.extend(later);
        for (_, datagram) in due {
            self.subscriber.handle_datagram(&datagram);
        }
    }

    fn loss_report(&mut self) {
        let loss_report = self.subscriber.loss_report();
        if self.is_lost() {
            return;
        }
        let scene_events = self.source.scene_events;
        let mut answers = Vec::new();
        for number in self.source.publisher.answer(&loss_report, &mut answers) {
            let refresh = self.source.publisher.refresh(number, scene_events);
            answers.extend(refresh.expect("the publisher keeps a long enough history"));
        }
        answers.push(self.source.publisher.watermark(scene_events));
        for datagram in &answers {
            self.send(datagram);
        }
        self.deliver();
    }

    fn check(&self) {
        let (publisher, subscriber) = (&self.source.publisher, &self.subscriber);
        let received = subscriber.statistics();
        assert_eq!((received.malformed, received.mismatches), (0, 0));
        let watermark_tick = subscriber.watermark_tick();
        let current = watermark_tick == self.source.tick && self.pending_changes.is_empty();
        for (id, track) in publisher.tracks() {
            let Some(bound) = subscriber.bound(id) else {
                assert!(!self.pending_changes.is_empty(), "{id} has no bound");
                continue;
            };
            let ErrorBound::Within(within) = bound else {
                continue;
            };
            if current {
                assert_eq!(
                    subscriber.track(id),
                    Some(track),
                    "{id} at {watermark_tick}"
                );
            }
            // A body that was added after that tick has no truth there.
            let Some(truth) = self.source.truth(id, watermark_tick) else {
                continue;
            };
            let predicted_motion = subscriber
                .predicted_motion(id, watermark_tick)
                .expect("a body with a bound");
            let apart = Divergence::between(&truth.motion().pose(), &predicted_motion.pose());
            let error = apart.surface_error(parameters(id).radius);
            assert!(
                error <= within,
                "{id} has an error of {error}, bound {within}"
            );
        }
        if current && subscriber.is_converged() {
            assert_eq!(subscriber.state_checksum(), publisher.state_checksum());
        }
    }
}
