//! A scene that does not answer stops neither others nor the dispatcher.
//!
//! A hook that does not return stands for a step that does not end. Threads are real, and their clock is the test's, so
//! that a silence of two seconds takes no time. Waiting is for an output, with a time limit.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Extensions, StreamChoice, VERSIONS};
use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{Tick, Tolerance};
use rhumb_server::{
    Dispatcher, DispatcherSettings, Hook, Hooks, Limits, SceneRouter, SceneSettings,
};

/// Longer than any step of these tests; reached only by a failure.
const LONG: Duration = Duration::from_secs(30);

/// A dispatcher with threads, and what it transmitted.
struct Threaded {
    dispatcher: Dispatcher,
    clock: Arc<AtomicU64>,
    woken: Receiver<()>,
    /// The first step of a stuck scene has begun.
    entered: Receiver<()>,
    transmits: VecDeque<Transmit>,
}

impl Threaded {
    /// Scenes named `stuck` wait in their first step until the returned sender is dropped.
    fn new() -> (Self, Sender<()>) {
        Self::with(SceneSettings::new(|| Instant::ZERO).limits)
    }

    /// The same with limits.
    fn with(limits: Limits) -> (Self, Sender<()>) {
        let clock = Arc::new(AtomicU64::new(0));
        let (wake, woken) = channel();
        let wake = Mutex::new(wake);
        let time = Arc::clone(&clock);
        let (release, gate) = channel::<()>();
        let gate = Arc::new(Mutex::new(gate));
        let (enter, entered) = channel();
        let hooks = Hooks::new(move |name, _| {
            let (gate, enter) = (Arc::clone(&gate), enter.clone());
            (name.as_str() == "stuck").then(|| {
                Hook::new(move |_, _| {
                    let _ = enter.send(());
                    // Ends with an error when the test drops its end.
                    let _ = gate.lock().expect("no thread panics").recv();
                })
            })
        });
        let mut settings =
            DispatcherSettings::new(move || Instant::from_nanos(time.load(Ordering::SeqCst)));
        settings.scenes.hooks = Some(hooks);
        settings.scenes.limits = limits;
        let dispatcher = Dispatcher::new(settings, move || {
            // After the test no one listens.
            let _ = wake.lock().expect("no thread panics").send(());
        });
        let threaded = Self {
            dispatcher,
            clock,
            woken,
            entered,
            transmits: VecDeque::new(),
        };
        (threaded, release)
    }

    fn now(&self) -> Instant {
        Instant::from_nanos(self.clock.load(Ordering::SeqCst))
    }

    /// Lets time pass for the dispatcher, too.
    fn pass(&mut self, span: Span) {
        self.clock.fetch_add(span.as_nanos(), Ordering::SeqCst);
        let now = self.now();
        self.dispatcher.handle_timeout(now);
    }

    fn send(&mut self, peer: Peer, messages: &[ClientMessage]) {
        let now = self.now();
        self.dispatcher
            .handle_control(now, peer, &encoded(messages));
    }

    fn open(&mut self, peer: Peer, scene: &str) {
        let now = self.now();
        self.dispatcher.handle_opened(now, peer);
        self.send(peer, &[hello(scene)]);
    }

    /// Creates a scene named `stuck` for a client; its first step does not end.
    fn open_stuck(&mut self, peer: Peer) {
        self.open(peer, "stuck");
        self.send(peer, &script());
        self.entered.recv_timeout(LONG).expect("the step begins");
    }

    /// Takes what the dispatcher has to transmit now.
    fn drain(&mut self) -> Vec<Transmit> {
        std::iter::from_fn(|| self.dispatcher.poll_transmit()).collect()
    }

    /// Waits for a transmission of this kind.
    fn expect(&mut self, is_it: impl Fn(&Transmit) -> bool) {
        loop {
            let transmits = self.drain();
            self.transmits.extend(transmits);
            while let Some(transmit) = self.transmits.pop_front() {
                if is_it(&transmit) {
                    return;
                }
            }
            self.woken.recv_timeout(LONG).expect("a worker has output");
        }
    }
}

fn hello(scene: &str) -> ClientMessage {
    ClientMessage::Hello {
        versions: VERSIONS.to_vec(),
        scene: scene.parse().expect("a good name"),
        extensions: Extensions::NONE,
    }
}

/// Creates the scene, joins it, and steps it.
fn script() -> Vec<ClientMessage> {
    vec![
        ClientMessage::Create(SceneConfig::default()),
        ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL)),
        ClientMessage::Advance { to: Tick::new(3) },
    ]
}

fn encoded(messages: &[ClientMessage]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for message in messages {
        message.encode(&mut bytes);
    }
    bytes
}

fn state_to(peer: Peer) -> impl Fn(&Transmit) -> bool {
    move |transmit| matches!(transmit, Transmit::State { to, .. } if *to == peer)
}

fn control_to(peer: Peer) -> impl Fn(&Transmit) -> bool {
    move |transmit| matches!(transmit, Transmit::Control { to, .. } if *to == peer)
}

fn close_of(peer: Peer) -> impl Fn(&Transmit) -> bool {
    let code = CloseCode::SCENE_QUARANTINED.0;
    move |transmit| *transmit == Transmit::Close { to: peer, code }
}

#[test]
fn a_scene_that_does_not_answer_is_quarantined_and_stops_no_other_scene() {
    let (mut threaded, release) = Threaded::new();
    let [stuck, other, late] = [1, 2, 3].map(Peer);
    threaded.open_stuck(stuck);
    threaded.pass(Span::from_millis(250));
    threaded.pass(Span::from_millis(1_650));
    let transmits = threaded.drain();
    assert!(
        !transmits.iter().any(close_of(stuck)),
        "two seconds are allowed: {transmits:?}"
    );
    // It begins now: the test's clock may pass 300 ms while a slow machine computes one of its ticks.
    threaded.open(other, "other");
    threaded.send(other, &script());
    (0..3).for_each(|_| threaded.expect(state_to(other)));
    threaded.pass(Span::from_millis(300));
    threaded.expect(close_of(stuck));
    threaded.send(other, &[ClientMessage::Advance { to: Tick::new(9) }]);
    (3..9).for_each(|_| threaded.expect(state_to(other)));
    threaded.open(late, "stuck");
    threaded.expect(close_of(late));
    // The step ends after all: the name is free again, as soon as the dispatcher knows.
    drop(release);
    let mut again = (4..).map(Peer);
    let free = loop {
        let peer = again.next().expect("there is no end of numbers");
        threaded.open(peer, "stuck");
        let transmits = threaded.drain();
        if !transmits.iter().any(close_of(peer)) {
            break peer;
        }
        assert!(peer.0 < 1_000, "the thread does not end");
        let _ = threaded.woken.recv_timeout(Duration::from_millis(30));
    };
    threaded.send(free, &[ClientMessage::Delete]);
    threaded.expect(control_to(free));
    threaded.dispatcher.shut_down();
}

#[test]
fn a_dispatcher_with_a_stuck_scene_ends_while_it_is_stuck() {
    let (mut threaded, release) = Threaded::new();
    threaded.open_stuck(Peer(1));
    threaded.dispatcher.shut_down();
    drop(release);
}

#[test]
fn the_thread_of_a_scene_that_expires_ends() {
    let (mut threaded, release) = Threaded::with(Limits {
        empty_scene_seconds: 1,
        ..Limits::default()
    });
    let peer = Peer(1);
    threaded.open(peer, "short");
    threaded.send(peer, &script());
    (0..3).for_each(|_| threaded.expect(state_to(peer)));
    let now = threaded.now();
    (threaded.dispatcher).handle_ended(now, peer, Ending::TimedOut);
    // With no thread to watch, the dispatcher waits for nothing. The clock passes slowly: a thread that computes is not
    // stuck.
    let mut looks = 0;
    while threaded.dispatcher.poll_timeout().is_some() {
        looks += 1;
        assert!(looks < 1_000, "the thread does not end");
        threaded.pass(Span::from_millis(50));
        threaded.drain();
        // No news is a moment that passes.
        let _ = threaded.woken.recv_timeout(Duration::from_millis(30));
    }
    drop(release);
}

#[test]
fn a_connection_that_says_no_hello_is_closed() {
    let mut dispatcher = Dispatcher::new(DispatcherSettings::new(|| Instant::ZERO), || ());
    dispatcher.handle_opened(Instant::ZERO, Peer(1));
    dispatcher.handle_control(Instant::ZERO, Peer(1), &[1]);
    let wake = dispatcher.poll_timeout().expect("a deadline");
    assert!(wake.at <= Instant::ZERO + Span::from_millis(8_000));
    dispatcher.handle_timeout(wake.at);
    let code = CloseCode::HELLO_LATE.0;
    let to = Peer(1);
    assert_eq!(
        dispatcher.poll_transmit(),
        Some(Transmit::Close { to, code })
    );
    assert_eq!(dispatcher.poll_timeout(), None);
}

/// Bytes for a client: of its control stream, and its datagrams.
#[derive(Default, PartialEq, Debug)]
struct Transmitted {
    control: Vec<u8>,
    datagrams: Vec<Bytes>,
}

impl Transmitted {
    fn add(&mut self, transmit: Transmit) {
        match transmit {
            Transmit::Control { bytes, .. } => self.control.extend_from_slice(&bytes),
            Transmit::State { bytes, .. } => self.datagrams.push(bytes),
            Transmit::Close { .. } => panic!("nothing is closed"),
        }
    }

    fn size(&self) -> (usize, usize) {
        (self.control.len(), self.datagrams.len())
    }
}

#[test]
fn a_dispatcher_changes_no_bit_and_a_worker_without_a_scene_ends() {
    let (now, peer) = (Instant::ZERO, Peer(1));
    let mut messages = vec![hello("same")];
    messages.extend(script());
    let mut plain = Transmitted::default();
    let mut router = SceneRouter::new(SceneSettings::new(|| Instant::ZERO));
    router.handle_opened(now, peer);
    router.handle_control(now, peer, &encoded(&messages));
    loop {
        std::iter::from_fn(|| router.poll_transmit()).for_each(|transmit| plain.add(transmit));
        match router.poll_timeout() {
            Some(wake) if wake.at <= now => router.handle_timeout(now),
            _ => break,
        }
    }
    assert_eq!(plain.datagrams.len(), 3, "a datagram for each tick");
    let (mut threaded, release) = Threaded::new();
    threaded.dispatcher.handle_opened(now, peer);
    threaded.send(peer, &messages);
    let mut transmitted = Transmitted::default();
    while transmitted.size() < plain.size() {
        for transmit in threaded.drain() {
            transmitted.add(transmit);
        }
        if transmitted.size() < plain.size() {
            threaded
                .woken
                .recv_timeout(LONG)
                .expect("a worker has output");
        }
    }
    assert_eq!(transmitted, plain);
    threaded.send(peer, &[ClientMessage::Delete]);
    threaded
        .dispatcher
        .handle_ended(now, peer, Ending::TimedOut);
    while threaded.dispatcher.poll_timeout().is_some() {
        threaded.drain();
        if threaded.dispatcher.poll_timeout().is_some() {
            threaded.woken.recv_timeout(LONG).expect("the worker ends");
        }
    }
    drop(release);
}
