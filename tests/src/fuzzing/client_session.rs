//! Fuzzes a client session with recorded data, disturbed, and arbitrary bytes.
//!
//! Promises: nothing panics. The session sends valid protocol, in limited amounts, and nothing after its end. Its copy
//! stays within the limits.

use std::sync::LazyLock;

use rhumb_protocol::limits::{HISTORY_PACKETS, INDICES_MAX};
use rhumb_protocol::message::{ClientMessage, Frames, StreamChoice, TierPolicy};
use rhumb_protocol::session::{ClientSession, CloseCode, Replica};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{Tick, Tolerance};
use serde_json::Value;

use super::commands::command;
use super::inputs::with_bytes;
use super::packets::written_again;
use super::payloads::body_state;
use super::script::Script;
use super::subscriber::assert_is_within_limits;
use rhumb_conformance::vectors::golden;
use rhumb_conformance::vectors::greeted;

/// One unit of received data.
enum Received {
    Control(Vec<u8>),
    Datagram(Vec<u8>),
}

/// The data that the members of the golden streams received.
static STREAMS: LazyLock<Vec<Vec<Received>>> = LazyLock::new(|| {
    let file = golden("streams.json");
    let streams = file["streams"]
        .as_array()
        .expect("streams are listed")
        .iter();
    streams.map(received).collect()
});

/// Every server message of the golden vectors.
static MESSAGES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| with_bytes(&golden("control.json")["server messages"]));

fn received(stream: &Value) -> Vec<Received> {
    let events = stream["events"]
        .as_array()
        .expect("events are listed")
        .iter();
    let received = events.filter_map(|event| {
        let bytes = || rhumb_conformance::grammar::unhex(event[1].as_str().unwrap_or_default());
        match event[0].as_str() {
            Some("control") => Some(Received::Control(bytes())),
            Some("datagram") => Some(Received::Datagram(bytes())),
            _ => None,
        }
    });
    received.collect()
}

/// The server's name in the session.
const HOST: Peer = Peer(0);
/// The most messages that a session sends after one received unit, or at one moment.
const ANSWERS_MAX: usize = 8;

struct Client {
    session: ClientSession,
    now: Instant,
    frames: Frames,
    ended: bool,
}

/// A script of received data and application calls.
pub fn client_session(data: &[u8]) {
    let mut script = Script::new(data);
    let mut client = Client {
        session: greeted(),
        now: Instant::ZERO,
        frames: Frames::new(),
        ended: false,
    };
    client.drain();
    let stream = script.below(STREAMS.len());
    let mut rest = STREAMS[stream].iter();
    while script.goes_on() {
        match script.below(12) {
            0..4 => {
                for received in rest.by_ref().take(1 + script.below(30)) {
                    client.receive(received);
                }
            }
            4 => drop(rest.nth(script.below(3))),
            5 | 6 => {
                if let Some(received) = rest.as_slice().first() {
                    client.receive(&with_bit_flipped(received, &mut script));
                }
            }
            7 => {
                let place = script.below(MESSAGES.len());
                client.receive(&with_bit_flipped(
                    &Received::Control(MESSAGES[place].clone()),
                    &mut script,
                ));
            }
            8 => client.receive(&Received::Control(script.bytes(60).to_vec())),
            9 => client.receive(&Received::Datagram(script.bytes(60).to_vec())),
            10 => client.wait(script.any()),
            _ => client.want(&mut script),
        }
    }
}

/// The same data, possibly with one bit flipped.
fn with_bit_flipped(received: &Received, script: &mut Script<'_>) -> Received {
    let mut turn = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        let bit = script.any::<u16>() as usize;
        if let Some(byte) = bytes.get_mut(bit / 8) {
            *byte ^= 1 << (bit % 8);
        }
        bytes
    };
    match received {
        Received::Control(bytes) => Received::Control(turn(bytes)),
        Received::Datagram(bytes) => Received::Datagram(turn(bytes)),
    }
}

impl Client {
    fn receive(&mut self, received: &Received) {
        match received {
            Received::Control(bytes) => self.session.handle_control(self.now, HOST, bytes),
            Received::Datagram(bytes) => self.session.handle_datagram(self.now, HOST, bytes),
        }
        self.drain();
    }

    fn wait(&mut self, milliseconds: u8) {
        self.now = self.now + Span::from_millis(u64::from(milliseconds) * 4);
        self.session.handle_timeout(self.now);
        self.drain();
    }

    /// The application may call anything at any time; the session refuses invalid calls.
    fn want(&mut self, script: &mut Script<'_>) {
        let session = &mut self.session;
        let choice = script.one_of(&[
            StreamChoice::Full,
            StreamChoice::Within(Tolerance::EXACT),
            StreamChoice::Within(Tolerance::NORMAL),
        ]);
        let bodies: Vec<_> = session.replica().map_or_else(Vec::new, |replica| {
            replica.bodies().map(|desc| desc.id).take(3).collect()
        });
        let _ = match script.below(11) {
            0 => session.join(choice),
            1 => session.subscribe(choice),
            2 => session.leave(),
            3 => session.reserve(script.any()),
            4 => session.command(command(script, &bodies)).map(drop),
            5 => session.advance(self.now, Tick::new(script.any::<u32>().into())),
            6 => session.inspect(),
            7 => session.take_authority(Tolerance::NORMAL, &bodies),
            8 => {
                let motions = bodies.iter().map(|id| (*id, body_state(script)));
                let motions: Vec<_> = motions.collect();
                let tick = Tick::new(script.any::<u16>().into());
                session.publish(tick, &motions).map(drop)
            }
            9 => session.set_tier_policy(TierPolicy::Never),
            _ => {
                if script.any() {
                    session.close(CloseCode::DONE);
                } else {
                    session.handle_ended(self.now, HOST, Ending::Broken);
                }
                Ok(())
            }
        };
        self.drain();
    }

    /// Checks that all sent data is valid protocol, and that the copy is within limits.
    fn drain(&mut self) {
        while self.session.poll_event().is_some() {}
        let mut sent = 0;
        while let Some(transmit) = self.session.poll_transmit() {
            sent += 1;
            assert!(!self.ended, "{transmit:?} is sent after the end");
            match transmit {
                Transmit::Control { bytes, .. } => self.frames.push(&bytes),
                Transmit::State { bytes, .. } => assert_eq!(written_again(&bytes), Ok(())),
                Transmit::Close { .. } => self.ended = true,
            }
        }
        assert!(sent <= ANSWERS_MAX, "{sent} answers to one unit of data");
        while let Some(framed) = self
            .frames
            .next_frame()
            .expect("a session sends whole messages")
        {
            ClientMessage::decode(&framed).expect("a session sends known messages");
        }
        let Some(stream) = self.session.replica().map(Replica::stream) else {
            return;
        };
        assert!(stream.missing() <= HISTORY_PACKETS);
        assert!(stream.index_end() <= INDICES_MAX as usize);
        assert_is_within_limits(stream, stream.index_end().min(20) as u32);
    }
}
