//! Fuzzes a server that has a live scene with arbitrary client data.
//!
//! Promises: a client that sends invalid protocol is closed with the right code, and no other client is. A refused
//! command leaves the scene's checksums, tick and bodies unchanged. An accepted command has the same effect as in a
//! second scene that is stepped in parallel. The copy of a well-behaved client is within tolerance all the time.

use std::sync::LazyLock;

use rhumb_protocol::Span;
use rhumb_protocol::message::{ClientMessage, Extensions, StreamChoice};
use rhumb_protocol::packet::{LossReport, Low16, StreamId};
use rhumb_protocol::scene::{Command, CommandError, Stepping};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{BodyId, Divergence, Tick, Tolerance};
use rhumb_scene::Scene;

use super::commands::command;
use super::inputs::with_bytes;
use super::scene_commands::scene_config;
use super::script::Script;
use super::subscriber::assert_is_within_limits;
use crate::{RawPeer, Table};
use rhumb_conformance::vectors::golden;

/// Number of actions of one script, so that it ends soon.
const ACTS_MAX: usize = 60;
const NAME: &str = "room";
const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Every client message of the golden vectors.
static MESSAGES: LazyLock<Vec<Vec<u8>>> =
    LazyLock::new(|| with_bytes(&golden("control.json")["client messages"]));

/// Types of messages by which any member may end, change or advance the scene; they are not sent.
const SPARED: [u8; 3] = [5, 7, 8];

struct FuzzedServer {
    table: Table,
    well_behaved: rhumb_protocol::Peer,
    raw_peer: RawPeer,
    bodies: Vec<BodyId>,
    truth: Scene,
}

/// A script of commands, steps and bytes.
pub fn control_script(data: &[u8]) {
    let mut script = Script::new(data);
    let mut stage = FuzzedServer::new();
    let mut stranger = stage.table.connect_raw_peer();
    for _ in 0..ACTS_MAX {
        if !script.goes_on() {
            break;
        }
        match script.below(10) {
            0..5 => {
                let command = command(&mut script, &stage.bodies);
                stage.command(command);
            }
            5 | 6 => stage.advance(),
            7 => {
                if stage.table.closed(stranger).is_some() {
                    stranger = stage.table.connect_raw_peer();
                }
                let bytes = strange_bytes(&mut script);
                stage.table.control(stranger, &bytes);
                assert_peer_code(stage.table.closed(stranger));
            }
            8 => {
                let datagram = datagram(&mut script);
                stage.table.datagram(stage.raw_peer.peer, &datagram);
            }
            _ => stage
                .table
                .pass(Span::from_millis(script.any::<u8>().into())),
        }
        stage.check();
    }
    stage.advance();
    stage.check();
}

/// Arbitrary bytes with or without a hello before them, or any message, possibly with one bit flipped.
fn strange_bytes(script: &mut Script<'_>) -> Vec<u8> {
    let mut bytes = Vec::new();
    if script.any() {
        let hello = ClientMessage::Hello {
            versions: vec![1],
            scene: NAME.parse().expect("a valid scene name"),
            extensions: Extensions::NONE,
        };
        hello.encode(&mut bytes);
    }
    let front = bytes.len();
    if script.any() {
        let place = script.below(MESSAGES.len());
        bytes.extend_from_slice(&MESSAGES[place]);
    } else {
        bytes.extend_from_slice(script.bytes(60));
    }
    let bit = script.any::<u16>() as usize;
    if let Some(byte) = bytes[front..].get_mut(bit / 8) {
        *byte ^= 1 << (bit % 8);
    }
    for byte in &mut bytes[front..] {
        if SPARED.contains(byte) {
            *byte = 0xff;
        }
    }
    bytes
}

/// Asserts that a session closes a connection because of what the peer sent, if it does.
///
/// # Panics
///
/// If it closes with another code.
pub fn assert_peer_code(code: Option<CloseCode>) {
    let known = [
        CloseCode::MALFORMED,
        CloseCode::VIOLATION,
        CloseCode::VERSION,
        CloseCode::LIMIT,
        CloseCode::EXTENSION,
    ];
    assert!(code.is_none_or(|code| known.contains(&code)), "{code:?}");
}

/// A loss report about other packets than the lost ones, or arbitrary bytes.
fn datagram(script: &mut Script<'_>) -> Vec<u8> {
    if script.any() {
        return script.bytes(60).to_vec();
    }
    let lost = (0..script.below(5)).map(|_| Low16(script.any()));
    let lost: Vec<_> = lost.collect();
    let loss_report = LossReport {
        next: Low16(script.any()),
        abandoned: Low16(script.any()),
        repair_symbols: script.below(33) as u8,
        lost,
    };
    loss_report.encode(StreamId(script.below(4) as u32))
}

impl FuzzedServer {
    fn new() -> Self {
        let mut table = Table::default();
        let well_behaved = table.connect(NAME);
        let config = scene_config(Stepping::Lockstep);
        let session = table.session(well_behaved);
        session.create(config).expect("the session is in the lobby");
        session.join(NORMAL).expect("the session is in the lobby");
        table.run_until_idle();
        let raw_peer = RawPeer::enter(&mut table, NAME);
        let granted = |place| raw_peer.granted.id(place).expect("a member has indices");
        let mut bodies: Vec<_> = (0..5).map(granted).collect();
        // Two more ids: a body that is added again, and one of another member.
        let again = bodies[0];
        bodies.push(BodyId::new(again.index(), again.generation() + 1));
        bodies.push(BodyId::new(1 << 19, 0));
        Self {
            table,
            well_behaved,
            raw_peer,
            bodies,
            truth: Scene::new(config).expect("a valid configuration"),
        }
    }

    /// Sends a command to both scenes and compares the answers.
    fn command(&mut self, command: Command) {
        let before = self.raw_peer.inspect(&mut self.table);
        // A command that cannot be encoded is malformed, which the fuzzers of messages cover.
        if command.check().is_err() && !is_encodable(&command) {
            return;
        }
        let answer = self.raw_peer.command(&mut self.table, command.clone());
        let after = self.raw_peer.inspect(&mut self.table);
        if answer.is_err() {
            assert_eq!(after, before, "{command:?} was refused by {answer:?}");
        }
        let is_own = |id: BodyId| self.raw_peer.granted.contains(id);
        if let Command::AddBody { desc, .. } = &command
            && !is_own(desc.id)
        {
            assert!(
                answer.is_err(),
                "{command:?} names an id outside the granted range"
            );
            return;
        }
        let beside = self.truth.apply(&command);
        let fault = Err(CommandError::SceneFaulted);
        assert!(answer != fault && beside != fault, "{command:?}");
        assert_eq!(answer, beside, "{command:?}");
    }

    fn advance(&mut self) {
        let tick = self
            .truth
            .step()
            .expect("a scene of accepted commands can be stepped")
            .tick;
        let now = self.table.now();
        let session = self.table.session(self.well_behaved);
        session.advance(now, tick).expect("the session is a member");
        self.table.run_until_idle();
        let reported = self.raw_peer.inspect(&mut self.table);
        let bodies = self.truth.body_count() as u32;
        let expected = (self.truth.digest().value(), tick.value(), bodies);
        assert_eq!(
            reported, expected,
            "the server's scene differs from the parallel one"
        );
        let session = self.table.session(self.well_behaved);
        let stream = session.replica().expect("the session is a member").stream();
        let all_there = self
            .truth
            .bodies()
            .all(|desc| stream.track(desc.id).is_some());
        assert!(all_there, "the copy misses a body");
    }

    fn check(&mut self) {
        assert_eq!(self.table.closed(self.well_behaved), None);
        assert_eq!(self.table.closed(self.raw_peer.peer), None);
        let tick: Tick = self.truth.tick();
        let session = self.table.session(self.well_behaved);
        while session.poll_event().is_some() {}
        let stream = session.replica().expect("the session is a member").stream();
        assert_eq!(stream.complete(), tick);
        assert_is_within_limits(stream, stream.index_end().min(6_000) as u32);
        let mut all = Vec::new();
        self.truth.observe_all(&mut all);
        for observation in all {
            let desc = *self
                .truth
                .body(observation.id)
                .expect("an observed body exists");
            // A body that was added since the last step is published with the next one.
            let Some(predicted_motion) = stream.predicted_motion(desc.id, tick) else {
                continue;
            };
            let radius = self.truth.bounding_radius(desc.id).expect("a shape");
            let apart = Divergence::between(
                &observation.motion.motion().pose(),
                &predicted_motion.pose(),
            );
            let tolerance = Tolerance::NORMAL.scaled(desc.tolerance_scale);
            let share = tolerance.share(&apart, radius);
            assert!(
                share <= 1.0,
                "{} has an error of {share} tolerances",
                desc.id
            );
        }
    }
}

/// True if an invalid command can be encoded, so that it is answered.
fn is_encodable(command: &Command) -> bool {
    use rhumb_protocol::wire::Wire as _;
    use rhumb_protocol::wire::bytes::{Reader, Writer};
    let mut to = Writer::new();
    command.encode(&mut to);
    let bytes = to.into_bytes();
    Command::decode(&mut Reader::new(&bytes)).is_ok()
}
