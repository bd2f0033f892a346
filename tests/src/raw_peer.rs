//! A guest that says what no session would, message by message.
//!
//! Understands the answers and keeps no copy of the scene.

use rhumb_protocol::Peer;
use rhumb_protocol::message::{ClientMessage, Extensions, Frames, ServerMessage, StreamChoice};
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::session::CloseCode;

use crate::table::{Delivered, Table};

/// A member made of bytes.
#[derive(Debug)]
pub struct RawPeer {
    /// Its connection.
    pub peer: Peer,
    /// Indices that it was granted.
    pub granted: IdRange,
    frames: Frames,
    commands: u64,
}

impl RawPeer {
    /// A member of a scene that exists.
    ///
    /// # Panics
    ///
    /// When it is not let in.
    #[must_use]
    pub fn enter(table: &mut Table, scene: &str) -> Self {
        let peer = table.connect_raw_peer();
        let mut rude = Self {
            peer,
            granted: IdRange::EMPTY,
            frames: Frames::new(),
            commands: 0,
        };
        let scene = scene.parse().expect("tests name scenes well");
        rude.say(
            table,
            &ClientMessage::Hello {
                versions: vec![1],
                scene,
                extensions: Extensions::NONE,
            },
        );
        let received = rude.say(table, &ClientMessage::Join(StreamChoice::Full));
        let granted = received.iter().find_map(|message| match message {
            ServerMessage::Joined(joined) => Some(joined.granted),
            _ => None,
        });
        rude.granted = granted.expect("a scene that exists lets members in");
        rude
    }

    /// Says a message and returns what came back on the control stream.
    pub fn say(&mut self, table: &mut Table, message: &ClientMessage) -> Vec<ServerMessage> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.utter(table, &bytes)
    }

    /// Says bytes and returns what came back on the control stream.
    ///
    /// # Panics
    ///
    /// When what comes back is not of the protocol.
    pub fn utter(&mut self, table: &mut Table, bytes: &[u8]) -> Vec<ServerMessage> {
        table.control(self.peer, bytes);
        let mut received = Vec::new();
        for sent in table.take_heard(self.peer) {
            if let Delivered::Control(bytes) = sent {
                self.frames.push(&bytes);
            }
            while let Some(framed) = self.frames.next_frame().expect("a host says messages") {
                received.extend(ServerMessage::decode(&framed).expect("a host says what is known"));
            }
        }
        received
    }

    /// Commands without checking anything first.
    ///
    /// # Errors
    ///
    /// Why it was refused.
    ///
    /// # Panics
    ///
    /// When it is neither applied nor refused, once.
    pub fn command(&mut self, table: &mut Table, command: Command) -> Result<(), CommandError> {
        let expected = self.commands;
        self.commands += 1;
        let received = self.say(table, &ClientMessage::Command(command.clone()));
        let applied = received.iter().filter(|message| {
            matches!(message, ServerMessage::Applied { through, .. } if *through == expected)
        });
        assert_eq!(
            applied.count(),
            1,
            "{command:?} was answered by {received:?}"
        );
        let mut refusals = received.iter().filter_map(|message| match message {
            ServerMessage::Refused { number, error } => Some((*number, *error)),
            _ => None,
        });
        match (refusals.next(), refusals.next()) {
            (None, None) => Ok(()),
            (Some((number, error)), None) if number == expected => Err(error),
            other => panic!("{command:?} was refused as {other:?}"),
        }
    }

    /// The scene's digest, tick and number of bodies.
    ///
    /// # Panics
    ///
    /// When it is not reported.
    pub fn inspect(&mut self, table: &mut Table) -> (u64, u64, u32) {
        let received = self.say(table, &ClientMessage::Inspect);
        let reported = received.iter().find_map(|message| match message {
            ServerMessage::Inspection(reported) => {
                Some((reported.truth, reported.tick.value(), reported.bodies))
            }
            _ => None,
        });
        reported.expect("a member may inspect")
    }

    /// Why the host closed its connection, if it did.
    #[must_use]
    pub fn closed(&self, table: &Table) -> Option<CloseCode> {
        table.closed(self.peer)
    }
}
