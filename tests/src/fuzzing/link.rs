//! A publisher and a listener over a link that a script has at its mercy.
//!
//! Promises: nothing said is malformed to who hears it; while the listener knows all of a tick, its tracks are the
//! publisher's to the bit; what it bounds lies within its bound; when the script ends, everything becomes known.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::stream::{Budget, ErrorBound, Redundancy, Subscriber};
use rhumb_reckoning::{Divergence, Metres, Radians, Tolerance};

use super::script::Script;
use super::source::{BODIES, SceneChange, Source, parameters};

/// Ticks of one script, so that it ends soon.
const TICKS_MAX: u64 = 240;
/// Ticks within which all is known once nothing is lost any more.
const CALM_TICKS: u64 = 40;

struct FuzzedLink {
    source: Source,
    subscriber: Subscriber,
    limited: bool,
    /// What is under way, by the tick at which it arrives.
    air: VecDeque<(u64, Bytes)>,
    mail: VecDeque<(u64, SceneChange)>,
    /// Bits that say of each datagram in turn whether it is lost.
    fate: u32,
    /// Ticks by which datagrams and news are late at most.
    late: [u64; 2],
    copies: bool,
    redundancy: Redundancy,
    sent: u32,
}

/// A script of ticks, blows, new_bodies and faults.
pub fn link(data: &[u8]) {
    let mut script = Script::new(data);
    let mut link = FuzzedLink::new(&mut script);
    while script.goes_on() && link.source.tick.value() < TICKS_MAX {
        link.act(&mut script);
        link.check();
    }
    (link.fate, link.late, link.copies) = (0, [0, 0], false);
    for _ in 0..CALM_TICKS {
        link.tick();
        link.check();
    }
    let tick = link.source.tick;
    assert!(link.subscriber.is_converged(), "something stays unknown");
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
            air: VecDeque::new(),
            mail: VecDeque::new(),
            fate: 0,
            late: [0, 0],
            copies: false,
            redundancy: Redundancy::Off,
            sent: 0,
        };
        for index in 0..BODIES / 2 {
            let news = link.source.add(index, script.sane_vector(20.0));
            link.post(news);
        }
        link
    }

    fn post(&mut self, news: impl IntoIterator<Item = SceneChange>) {
        let at = self.source.tick.value() + self.late[1];
        self.mail.extend(news.into_iter().map(|news| (at, news)));
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
                self.fate = script.any();
                self.late = [script.below(5) as u64, script.below(9) as u64];
                self.copies = script.any();
            }
            6 => {
                let news = self
                    .source
                    .add(script.below(BODIES), script.sane_vector(20.0));
                self.post(news);
            }
            7 => {
                let news = self.source.remove(script.below(BODIES));
                self.post(news);
            }
            8 => {
                let news = self.source.change_gravity(script.sane_vector(30.0));
                self.post([news]);
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
        self.fate.rotate_right(self.sent) & 1 == 1
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
        self.air.push_back((now + delay, datagram.clone()));
        if self.copies {
            self.air.push_back((now + delay / 2, datagram.clone()));
        }
    }

    fn tick(&mut self) {
        let mut said = self.source.step();
        let tick = self.source.tick.value();
        // A checksums states nothing of what a budget over_budget, so that there it goes with packets alone.
        if tick.is_multiple_of(10) && !self.limited {
            said.push(self.source.publisher.checksums(self.source.scene_events));
        }
        self.source
            .publisher
            .encode_repair_symbols(self.redundancy, &mut said);
        for datagram in &said {
            self.send(datagram);
        }
        self.deliver();
        if tick.is_multiple_of(5) {
            self.loss_report();
        }
    }

    fn deliver(&mut self) {
        let now = self.source.tick.value();
        while let Some((_, news)) = self.mail.pop_front_if(|(at, _)| *at <= now) {
            news.tell(&mut self.subscriber);
        }
        let (due, later): (Vec<_>, Vec<_>) = self.air.drain(..).partition(|(at, _)| *at <= now);
        self.air.extend(later);
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
            answers.extend(refresh.expect("the history is long enough"));
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
        let current = watermark_tick == self.source.tick && self.mail.is_empty();
        for (id, track) in publisher.tracks() {
            let Some(bound) = subscriber.bound(id) else {
                assert!(!self.mail.is_empty(), "{id} is not bounded at all");
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
            // A body that came after that tick has no truth there.
            let Some(truth) = self.source.truth(id, watermark_tick) else {
                continue;
            };
            let predicted_motion = subscriber
                .predicted_motion(id, watermark_tick)
                .expect("it is bounded");
            let apart = Divergence::between(&truth.motion().pose(), &predicted_motion.pose());
            let error = apart.surface_error(parameters(id).radius);
            assert!(error <= within, "{id} is off by {error}, not {within}");
        }
        if current && subscriber.is_converged() {
            assert_eq!(subscriber.state_checksum(), publisher.state_checksum());
        }
    }
}
