//! Fuzzes the server's side of an upstream, over a bad link and with lies.
//!
//! Promises: bodies of an honest publisher are within its tolerance wherever the server claims to know them. A
//! dishonest publisher can add no body without a grant, and all bodies stay at valid places.

use std::collections::{BTreeMap, VecDeque};
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::message::{AuthorityGrant, TakeAuthority};
use rhumb_protocol::packet::{Datagram, LargestPacket, LossReport, PacketKind};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    Redundancy, StreamConfig,
};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{
    BodyId, BodyState, Damping, Divergence, Integrator, Metres, Rate, Tick, Tolerance,
    ToleranceScale,
};

use super::packets::written_again;
use super::script::Script;
use super::source::STREAM;
use super::subscriber::{PacketSource, assert_is_motion};

const BODIES: u32 = 4;
const TICKS_MAX: u64 = 240;
const SCENE_EVENTS: u64 = 0;
const TICK: Span = Span::from_nanos(16_666_667);
const PARAMETERS: PredictionParameters = PredictionParameters {
    radius: Metres::new(0.5),
    damping: Damping {
        linear: 0.0,
        angular: 0.0,
    },
    gravity_scale: 0.0,
    inertia: None,
    tolerance_scale: ToleranceScale::USUAL,
};

struct FuzzedUpstream {
    publisher: Publisher,
    observation_history: ObservationHistory,
    receiver: UpstreamReceiver,
    places: [Vec3; BODIES as usize],
    speeds: [Vec3; BODIES as usize],
    truth: BTreeMap<u64, Vec<BodyState>>,
    in_flight: VecDeque<(u64, Bytes)>,
    tick: u64,
    loss_bits: u32,
    late: u64,
    redundancy: Redundancy,
    sent: u32,
    /// True if the server received only data of the publisher.
    honest: bool,
}

/// A script of ticks, impulses, faults and invalid packets.
pub fn upstream(data: &[u8]) {
    let mut script = Script::new(data);
    let mut run = FuzzedUpstream::new(&mut script);
    let mut packet_source = PacketSource {
        number: 0,
        tick: 0,
        scene_events: SCENE_EVENTS,
    };
    while script.goes_on() && run.tick < TICKS_MAX {
        match script.below(8) {
            0..4 => {
                for _ in 0..=script.below(6) {
                    run.step();
                }
            }
            4 | 5 => {
                let body = script.below(BODIES as usize);
                run.speeds[body] = script.sane_vector(20.0);
            }
            6 => (run.loss_bits, run.late) = (script.any(), script.below(4) as u64),
            _ if script.below(8) == 0 => {
                run.honest = false;
                let datagram = packet_source.datagram(&mut script, 6);
                if let Ok(datagram) = Datagram::open(&datagram) {
                    run.receiver.handle_datagram(&datagram);
                }
            }
            _ => {
                (packet_source.number, packet_source.tick) =
                    (run.publisher.next_number(), run.tick);
            }
        }
        run.check();
    }
    (run.loss_bits, run.late) = (0, 0);
    for _ in 0..200 {
        run.step();
        run.check();
    }
    if run.honest {
        assert!(!run.receiver.has_lost_sync());
        assert!(run.receiver.is_complete_at(Tick::new(run.tick)));
        assert_eq!(run.receiver.watermark_tick(), Tick::new(run.tick));
    }
}

impl FuzzedUpstream {
    fn new(script: &mut Script<'_>) -> Self {
        let tolerance = script.one_of(&[Tolerance::NORMAL, Tolerance::EXACT, Tolerance::COARSE]);
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let config = StreamConfig {
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            tolerance,
            integrator,
            largest_packet: LargestPacket::DEFAULT,
            gravity: Vec3::ZERO,
            features: Features {
                ballistic: false,
                torque_free: false,
                attached: false,
                ..Features::ALL
            },
        };
        let places = [0.0, 1.0, 2.0, 3.0].map(|x| Vec3::new(x * 4.0, 1.0, 0.0));
        let bodies = places.iter().enumerate();
        let grant = AuthorityGrant {
            stream: STREAM,
            tick: Tick::ZERO,
            bodies: bodies
                .map(|(index, place)| {
                    (
                        BodyId::new(index as u32 + 10, 0),
                        motion(*place, Vec3::ZERO),
                    )
                })
                .collect(),
        };
        let request = TakeAuthority {
            tolerance,
            largest_packet: config.largest_packet,
            bodies: grant.bodies.iter().map(|(id, _)| *id).collect(),
        };
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        for (index, (_, motion)) in grant.bodies.iter().enumerate() {
            let id = BodyId::new(index as u32, 0);
            assert!(publisher.place(id, &PARAMETERS, grant.first_track(*motion)));
        }
        Self {
            receiver: UpstreamReceiver::new(&grant, &request, integrator, |_| Some(PARAMETERS)),
            publisher,
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            places,
            speeds: [Vec3::ZERO; BODIES as usize],
            truth: BTreeMap::new(),
            in_flight: VecDeque::new(),
            tick: 0,
            loss_bits: 0,
            late: 0,
            redundancy: script.one_of(&[Redundancy::Off, Redundancy::Plain]),
            sent: 0,
            honest: true,
        }
    }

    fn is_lost(&mut self) -> bool {
        self.sent = self.sent.wrapping_add(1);
        self.loss_bits.rotate_right(self.sent) & 1 == 1
    }

    fn send(&mut self, datagrams: &[Bytes]) {
        for datagram in datagrams {
            if !self.is_lost() {
                let at = self.tick + u64::from(self.sent) % (self.late + 1);
                self.in_flight.push_back((at, datagram.clone()));
            }
        }
    }

    /// One tick of the publisher and of the server.
    fn step(&mut self) {
        self.tick += 1;
        for (place, speed) in self.places.iter_mut().zip(self.speeds) {
            *place = (*place + speed / 60.0).clamp(Vec3::splat(-1e4), Vec3::splat(1e4));
        }
        let motions = self.places.iter().zip(self.speeds);
        let motions: Vec<_> = motions
            .map(|(place, speed)| motion(*place, speed))
            .collect();
        let observed = motions.iter().enumerate();
        let observed: Vec<_> = observed
            .map(|(index, motion)| Observation {
                id: BodyId::new(index as u32, 0),
                motion: *motion,
                activity: Activity::Awake,
            })
            .collect();
        self.truth.insert(self.tick, motions);
        self.observation_history
            .observe(Tick::new(self.tick), &observed);
        let mut datagrams = Vec::new();
        self.publisher
            .publish(&self.observation_history, SCENE_EVENTS, &mut datagrams);
        if datagrams.is_empty() {
            datagrams.push(self.publisher.watermark(SCENE_EVENTS));
        }
        self.publisher
            .encode_repair_symbols(self.redundancy, &mut datagrams);
        self.send(&datagrams);
        self.deliver();
        let mut reports = Vec::new();
        let now = Instant::ZERO + Span::from_nanos(TICK.as_nanos() * self.tick);
        self.receiver
            .poll_reports(now, Tick::new(self.tick), &mut reports);
        for datagram in reports {
            assert_eq!(written_again(&datagram), Ok(()));
            if !self.is_lost() {
                self.answer(&datagram);
            }
        }
        self.deliver();
    }

    fn answer(&mut self, datagram: &[u8]) {
        let datagram = Datagram::open(datagram).expect("a server sends valid packets");
        let mut answers = Vec::new();
        assert_eq!(datagram.head().kind, PacketKind::LossReport);
        let loss_report =
            LossReport::decode(datagram.body()).expect("a server sends valid loss reports");
        for number in self.publisher.answer(&loss_report, &mut answers) {
            let refresh = self.publisher.refresh(number, SCENE_EVENTS);
            answers.extend(refresh.unwrap_or_default());
        }
        answers.push(self.publisher.watermark(SCENE_EVENTS));
        self.send(&answers);
    }

    fn deliver(&mut self) {
        let now = self.tick;
        let (due, later): (Vec<_>, Vec<_>) =
            self.in_flight.drain(..).partition(|(at, _)| *at <= now);
        self.in_flight.extend(later);
        for (_, datagram) in due {
            let datagram = Datagram::open(&datagram).expect("an upstream sends datagrams");
            self.receiver.handle_datagram(&datagram);
        }
    }

    fn check(&mut self) {
        let tick = Tick::new(self.tick);
        let known = self.receiver.is_complete_at(tick) && self.receiver.watermark_tick() >= tick;
        let tolerance = self.receiver.tolerance();
        let mut count = 0;
        for (id, motion) in self.receiver.motions(tick) {
            assert!(
                (10..10 + BODIES).contains(&id.index()),
                "{id} is outside the grant"
            );
            assert_is_motion(&motion);
            count += 1;
            let truth = self.truth.get(&self.tick);
            if let Some(truth) = truth.filter(|_| self.honest && known) {
                let truth = truth[id.index() as usize - 10].motion().pose();
                let apart = Divergence::between(&truth, &motion.pose());
                let share = tolerance.share(&apart, PARAMETERS.radius);
                assert!(
                    share <= 1.0,
                    "{id} at {tick} has an error of {share} tolerances"
                );
            }
        }
        assert!(count <= BODIES);
        if self.honest {
            let received = self.receiver.statistics();
            assert_eq!((received.malformed, received.mismatches), (0, 0));
        }
    }
}

fn motion(place: Vec3, speed: Vec3) -> BodyState {
    let spin = Vec3::new(0.0, speed.x * 0.1, 0.0);
    let rotation = [0.0, 0.0, 0.0, 1.0];
    BodyState::new(
        place.to_array(),
        rotation,
        speed.to_array(),
        spin.to_array(),
    )
    .expect("a finite state")
}
