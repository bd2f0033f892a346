//! Simulated network: virtual time, connection ends, one run per seed.
//!
//! Proved with toy endpoints: clients count on both lanes, a server answers, and a log records all inputs.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_netsim::{Direction, Lane, LinkConfig, RunStop, SimNetwork};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};

/// Sends a number on both lanes every 10 ms until its count is done, and answers inputs if configured to.
struct Toy {
    next: Option<Instant>,
    left: u8,
    mode: ToyMode,
    out: VecDeque<Transmit>,
    received: Vec<(Instant, ToyInput)>,
}

#[derive(PartialEq, Eq)]
enum ToyMode {
    Counts,
    Answers,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum ToyInput {
    Opened(Peer),
    Control(Peer, u8),
    State(Peer, u8),
    Ended(Peer, Ending),
}

impl Toy {
    fn counting(left: u8) -> Self {
        let (out, received) = (VecDeque::new(), Vec::new());
        Self {
            next: Some(Instant::ZERO),
            left,
            mode: ToyMode::Counts,
            out,
            received,
        }
    }

    fn answering() -> Self {
        let (out, received) = (VecDeque::new(), Vec::new());
        Self {
            next: None,
            left: 0,
            mode: ToyMode::Answers,
            out,
            received,
        }
    }

    fn send(&mut self, to: Peer, number: u8) {
        let bytes = Bytes::from(vec![number]);
        self.out.push_back(Transmit::Control {
            to,
            bytes: bytes.clone(),
        });
        self.out.push_back(Transmit::State { to, bytes });
    }

    fn received(&self) -> Vec<ToyInput> {
        self.received
            .iter()
            .map(|(_, received)| received.clone())
            .collect()
    }
}

impl Endpoint for Toy {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.received.push((now, ToyInput::Opened(peer)));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.received.push((now, ToyInput::Control(from, bytes[0])));
        if self.mode == ToyMode::Answers {
            self.send(from, bytes[0]);
        }
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.received.push((now, ToyInput::State(from, bytes[0])));
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.received.push((now, ToyInput::Ended(peer, ending)));
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.left -= 1;
        self.send(Peer(0), self.left);
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
    let at_server = (at_ms(50), ToyInput::Control(Peer(0), 0));
    assert!(sim_network.server().received.contains(&at_server));
    let at_client = (at_ms(100), ToyInput::State(Peer(0), 0));
    assert!(sim_network.client(client).received.contains(&at_client));
    assert_eq!(
        sim_network
            .counts(client, Direction::Down, Lane::State)
            .delivered
            .pieces,
        1
    );
}

#[test]
fn time_advances_to_the_deadline_without_events() {
    let mut sim_network = toys("", 1);
    sim_network.run_until(at_ms(7));
    assert_eq!(sim_network.now(), at_ms(7));
    sim_network.connect(Toy::counting(200));
    assert_eq!(sim_network.run_until_idle_or(at_ms(50)), RunStop::Deadline);
    assert_eq!(sim_network.now(), at_ms(50));
}

#[test]
fn a_close_follows_sent_messages_and_ends_both_connections() {
    let mut sim_network = toys("rtt=20ms,loss=40%", 3);
    let client = sim_network.connect(Toy::answering());
    sim_network.client_mut(client).send(Peer(0), 5);
    sim_network
        .client_mut(client)
        .out
        .push_back(Transmit::Close {
            to: Peer(0),
            code: 9,
        });
    sim_network.client_mut(client).send(Peer(0), 6);
    assert_eq!(sim_network.run_until_idle_or(at_ms(60_000)), RunStop::Idle);
    let ended = ToyInput::Ended(Peer(0), Ending::Closed(9));
    assert_eq!(
        sim_network.client(client).received(),
        [ToyInput::Opened(Peer(0)), ended.clone()]
    );
    let server = sim_network.server().received();
    assert!(
        server.contains(&ToyInput::Control(Peer(0), 5))
            && !server.contains(&ToyInput::Control(Peer(0), 6))
    );
    assert_eq!(server.last(), Some(&ended));
}

#[test]
fn a_severed_connection_ends_at_both_ends() {
    let mut sim_network = toys("rtt=20ms", 3);
    let (severed, stays) = (
        sim_network.connect(Toy::counting(10)),
        sim_network.connect(Toy::counting(10)),
    );
    sim_network.run_until(at_ms(25));
    sim_network.sever(severed, Ending::TimedOut);
    sim_network.sever(severed, Ending::Broken);
    sim_network.run_until(at_ms(1_000));
    let ends = |toy: &Toy| {
        toy.received()
            .into_iter()
            .filter(|received| matches!(received, ToyInput::Ended(..)))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        ends(sim_network.client(severed)),
        [ToyInput::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(
        ends(sim_network.server()),
        [ToyInput::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(ends(sim_network.client(stays)), []);
}

#[test]
fn after_the_end_of_loss_everything_arrives() {
    let mut sim_network = toys("rtt=20ms,loss=100%", 4);
    let client = sim_network.connect(Toy::counting(5));
    sim_network.run_until(at_ms(1_000));
    assert_eq!(sim_network.server().received.len(), 1);
    sim_network.set_config(LinkConfig::round_trip(Span::from_millis(20)));
    sim_network.run_until(at_ms(10_000));
    let control = sim_network
        .client(client)
        .received()
        .into_iter()
        .filter(|received| matches!(received, ToyInput::Control(..)));
    assert_eq!(
        control.collect::<Vec<_>>(),
        [4, 3, 2, 1, 0].map(|number| ToyInput::Control(Peer(0), number))
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
        let mut log = sim_network.server().received.clone();
        clients
            .iter()
            .for_each(|&client| log.extend_from_slice(&sim_network.client(client).received));
        log
    };
    assert_eq!(run(11), run(11));
    assert_ne!(run(11), run(12));
}
