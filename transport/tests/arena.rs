//! The arena: time that jumps, ends as real ones, one run per seed.
//!
//! Proved with a toy: clients that count aloud on both lanes, a server that answers, and a log of all that was heard.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_transport::{Arena, Direction, Lane, LinkTerms, Rest};

/// Says a number on both lanes every 10 ms until it has said enough, and answers what it hears if told to.
struct Toy {
    next: Option<Instant>,
    left: u8,
    manners: Manners,
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
            manners: Manners::Counts,
            out,
            heard,
        }
    }

    fn answering() -> Self {
        let (out, heard) = (VecDeque::new(), Vec::new());
        Self {
            next: None,
            left: 0,
            manners: Manners::Answers,
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
        if self.manners == Manners::Answers {
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

fn toys(terms: &str, seed: u64) -> Arena<Toy, Toy> {
    Arena::new(Toy::answering(), terms.parse().expect("good terms"), seed)
}

#[test]
fn time_jumps_from_event_to_event_until_all_rest() {
    let mut arena = toys("rtt=100ms", 1);
    let client = arena.connect(Toy::counting(1));
    assert_eq!(arena.run_until_idle_or(at_ms(60_000)), Rest::Idle);
    assert_eq!(arena.now(), at_ms(100));
    let there = (at_ms(50), Heard::Control(Peer(0), 0));
    assert!(arena.server().heard.contains(&there));
    let back = (at_ms(100), Heard::State(Peer(0), 0));
    assert!(arena.client(client).heard.contains(&back));
    assert_eq!(
        arena
            .counts(client, Direction::Down, Lane::State)
            .delivered
            .pieces,
        1
    );
}

#[test]
fn a_deadline_comes_even_if_nothing_happens() {
    let mut arena = toys("", 1);
    arena.run_until(at_ms(7));
    assert_eq!(arena.now(), at_ms(7));
    arena.connect(Toy::counting(200));
    assert_eq!(arena.run_until_idle_or(at_ms(50)), Rest::Deadline);
    assert_eq!(arena.now(), at_ms(50));
}

#[test]
fn a_close_comes_after_what_was_said_and_ends_both() {
    let mut arena = toys("rtt=20ms,loss=40%", 3);
    let client = arena.connect(Toy::answering());
    arena.client_mut(client).say(Peer(0), 5);
    arena.client_mut(client).out.push_back(Transmit::Close {
        to: Peer(0),
        code: 9,
    });
    arena.client_mut(client).say(Peer(0), 6);
    assert_eq!(arena.run_until_idle_or(at_ms(60_000)), Rest::Idle);
    let ended = Heard::Ended(Peer(0), Ending::Closed(9));
    assert_eq!(
        arena.client(client).heard(),
        [Heard::Opened(Peer(0)), ended.clone()]
    );
    let server = arena.server().heard();
    assert!(
        server.contains(&Heard::Control(Peer(0), 5))
            && !server.contains(&Heard::Control(Peer(0), 6))
    );
    assert_eq!(server.last(), Some(&ended));
}

#[test]
fn a_severed_connection_ends_for_both() {
    let mut arena = toys("rtt=20ms", 3);
    let (gone, stays) = (
        arena.connect(Toy::counting(10)),
        arena.connect(Toy::counting(10)),
    );
    arena.run_until(at_ms(25));
    arena.sever(gone, Ending::TimedOut);
    arena.sever(gone, Ending::Broken);
    arena.run_until(at_ms(1_000));
    let ends = |toy: &Toy| {
        toy.heard()
            .into_iter()
            .filter(|heard| matches!(heard, Heard::Ended(..)))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        ends(arena.client(gone)),
        [Heard::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(
        ends(arena.server()),
        [Heard::Ended(Peer(0), Ending::TimedOut)]
    );
    assert_eq!(ends(arena.client(stays)), []);
}

#[test]
fn when_loss_stops_everything_arrives() {
    let mut arena = toys("rtt=20ms,loss=100%", 4);
    let client = arena.connect(Toy::counting(5));
    arena.run_until(at_ms(1_000));
    assert_eq!(arena.server().heard.len(), 1);
    arena.set_terms(LinkTerms::round_trip(Span::from_millis(20)));
    arena.run_until(at_ms(10_000));
    let control = arena
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
fn the_same_seed_gives_the_same_run_to_the_bit() {
    let run = |seed| {
        let mut arena = toys(
            "rtt=60ms,loss=20%,burst=3,jitter=30ms,dup=5%,reorder=10%,rate=2mbit",
            seed,
        );
        let clients = [30, 40, 50].map(|count| arena.connect(Toy::counting(count)));
        arena.run_until(at_ms(200));
        arena.set_terms("rtt=10ms,loss=5%".parse().expect("good terms"));
        arena.run_until_idle_or(at_ms(60_000));
        let mut log = arena.server().heard.clone();
        clients
            .iter()
            .for_each(|&client| log.extend_from_slice(&arena.client(client).heard));
        log
    };
    assert_eq!(run(11), run(11));
    assert_ne!(run(11), run(12));
}
