//! The sim_network: time that jumps, ends as real ones, one run per seed.
//!
//! Proved with a toy: clients that count aloud on both lanes, a server that answers, and a log of all that was heard.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_transport::{Direction, Lane, LinkConfig, RunStop, SimNetwork};

/// Says a number on both lanes every 10 ms until it has said enough, and answers what it hears if told to.
struct Toy {
    next: Option<Instant>,
    left: u8,
    parameters_list: Manners,
    out: VecDeque<Transmit>,
    heard: Vec<(Instant, Heard)>,
}

#[derive(PartialEq, Eq)]
enum Manners {
    Counts,
    Answers,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Heard {
    Opened(Peer),
    Control(Peer, u8),
    State(Peer, u8),
    Ended(Peer, Ending),
}

impl Toy {
    fn counting(left: u8) -> Self {
        let (out, heard) = (VecDeque::new(), Vec::new());
        Self {
            next: Some(Instant::ZERO),
            left,
            parameters_list: Manners::Counts,
            out,
            heard,
        }
    }

    fn answering() -> Self {
        let (out, heard) = (VecDeque::new(), Vec::new());
        Self {
            next: None,
            left: 0,
            parameters_list: Manners::Answers,
            out,
            heard,
        }
    }

    fn say(&mut self, to: Peer, number: u8) {
        let bytes = Bytes::from(vec![number]);
        self.out.push_back(Transmit::Control {
            to,
            bytes: bytes.clone(),
        });
        self.out.push_back(Transmit::State { to, bytes });
    }

    fn heard(&self) -> Vec<Heard> {
        self.heard.iter().map(|(_, heard)| heard.clone()).collect()
    }
}

impl Endpoint for Toy {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.heard.push((now, Heard::Opened(peer)));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.heard.push((now, Heard::Control(from, bytes[0])));
        if self.parameters_list == Manners::Answers {
            self.say(from, bytes[0]);
        }
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.heard.push((now, Heard::State(from, bytes[0])));
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.heard.push((now, Heard::Ended(peer, ending)));
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.left -= 1;
        self.say(Peer(0), self.left);
        self.next = (self.left > 0).then(|| now + Span::from_millis(10));
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.next.map(|at| Wake {
            at,
            reason: WakeReason::Tick,
        })
    }
}

fn at_ms(ms: u64) -> Instant {
    Instant::from_nanos(ms * 1_000_000)
}

fn toys(config: &str, seed: u64) -> SimNetwork<Toy, Toy> {
    SimNetwork::new(Toy::answering(), config.parse().expect("good config"), seed)
}

#[test]
fn time_jumps_between_events_until_all_is_idle() {
    let mut sim_network = toys("rtt=100ms", 1);
    let client = sim_network.connect(Toy::counting(1));
    assert_eq!(sim_network.run_until_idle_or(at_ms(60_000)), RunStop::Idle);
    assert_eq!(sim_network.now(), at_ms(100));
    let there = (at_ms(50), Heard::Control(Peer(0), 0));
    assert!(sim_network.server().heard.contains(&there));
    let back = (at_ms(100), Heard::State(Peer(0), 0));
    assert!(sim_network.client(client).heard.contains(&back));
    assert_eq!(
        sim_network
            .counts(client, Direction::Down, Lane::State)
            .delivered
            .pieces,
        1
    );
}

#[test]
fn a_deadline_comes_even_if_nothing_happens() {
    let mut sim_network = toys("", 1);
    sim_network.run_until(at_ms(7));
    assert_eq!(sim_network.now(), at_ms(7));
    sim_network.connect(Toy::counting(200));
    assert_eq!(sim_network.run_until_idle_or(at_ms(50)), RunStop::Deadline);
    assert_eq!(sim_network.now(), at_ms(50));
}

#[test]
fn a_close_follows_sent_messages_and_ends_both() {
    let mut sim_network = toys("rtt=20ms,loss=40%", 3);
    let client = sim_network.connect(Toy::answering());
    sim_network.client_mut(client).say(Peer(0), 5);
    sim_network
        .client_mut(client)
        .out
        .push_back(Transmit::Close {
            to: Peer(0),
            code: 9,
        });
    sim_network.client_mut(client).say(Peer(0), 6);
    assert_eq!(sim_network.run_until_idle_or(at_ms(60_000)), RunStop::Idle);
    let ended = Heard::Ended(Peer(0), Ending::Closed(9));
    assert_eq!(
        sim_network.client(client).heard(),
        [Heard::Opened(Peer(0)), ended.clone()]
    );
    let server = sim_network.server().heard();
    assert!(
        server.contains(&Heard::Control(Peer(0), 5))
            && !server.contains(&Heard::Control(Peer(0), 6))
    );
    assert_eq!(server.last(), Some(&ended));
}

#[test]
fn a_severed_connection_ends_for_both() {
    let mut sim_network = toys("rtt=20ms", 3);
    let (gone, stays) = (
        sim_network.connect(Toy::counting(10)),
        sim_network.connect(Toy::counting(10)),
    );
    sim_network.run_until(at_ms(25));
    sim_network.sever(gone, Ending::TimedOut);
    sim_network.sever(gone, Ending::Broken);
    sim_network.run_until(at_ms(1_000));
    let ends = |toy: &Toy| {
        toy.heard()
            .into_iter()
            .filter(|heard| matches!(heard, Heard::Ended(..)))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        ends(sim_network.client(gone)),
        [Heard::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(
        ends(sim_network.server()),
        [Heard::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(ends(sim_network.client(stays)), []);
}

#[test]
fn when_loss_stops_everything_arrives() {
    let mut sim_network = toys("rtt=20ms,loss=100%", 4);
    let client = sim_network.connect(Toy::counting(5));
    sim_network.run_until(at_ms(1_000));
    assert_eq!(sim_network.server().heard.len(), 1);
    sim_network.set_config(LinkConfig::round_trip(Span::from_millis(20)));
    sim_network.run_until(at_ms(10_000));
    let control = sim_network
        .client(client)
        .heard()
        .into_iter()
        .filter(|heard| matches!(heard, Heard::Control(..)));
    assert_eq!(
        control.collect::<Vec<_>>(),
        [4, 3, 2, 1, 0].map(|number| Heard::Control(Peer(0), number))
    );
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let run = |seed| {
        let mut sim_network = toys(
            "rtt=60ms,loss=20%,burst=3,jitter=30ms,dup=5%,reorder=10%,rate=2mbit",
            seed,
        );
        let clients = [30, 40, 50].map(|count| sim_network.connect(Toy::counting(count)));
        sim_network.run_until(at_ms(200));
        sim_network.set_config("rtt=10ms,loss=5%".parse().expect("good config"));
        sim_network.run_until_idle_or(at_ms(60_000));
        let mut log = sim_network.server().heard.clone();
        clients
            .iter()
            .for_each(|&client| log.extend_from_slice(&sim_network.client(client).heard));
        log
    };
    assert_eq!(run(11), run(11));
    assert_ne!(run(11), run(12));
}
