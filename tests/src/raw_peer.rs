//! A raw peer: a member that sends messages which no session would send.
//!
//! It decodes the answers, and keeps no copy of the scene.

use rhumb_protocol::Peer;
use rhumb_protocol::message::{ClientMessage, Extensions, Frames, ServerMessage, StreamChoice};
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::session::CloseCode;

use crate::table::{Delivered, Table};

/// A raw peer that is a member of a scene.
#[derive(Debug)]
pub struct RawPeer {
    /// Its connection.
    pub peer: Peer,
    /// The id range granted to it.
    pub granted: IdRange,
    frames: Frames,
    commands: u64,
}

impl RawPeer {
    /// Joins an existing scene.
    ///
    /// # Panics
    ///
    /// When joining is denied.
    #[must_use]
    pub fn enter(table: &mut Table, scene: &str) -> Self {
        Self::enter_after(table, scene, &[])
    }

    /// Joins an existing scene by cells.
    ///
    /// # Panics
    ///
    /// As [`Self::enter`].
    #[must_use]
    pub fn enter_by_cells(table: &mut Table, scene: &str) -> Self {
        Self::enter_after(table, scene, &[ClientMessage::JoinCells])
    }

    /// Joins after other messages.
    fn enter_after(table: &mut Table, scene: &str, before: &[ClientMessage]) -> Self {
        let peer = table.connect_raw_peer();
        let mut raw_peer = Self {
            peer,
            granted: IdRange::EMPTY,
            frames: Frames::new(),
            commands: 0,
        };
        let scene = scene.parse().expect("a valid scene name");
        raw_peer.send(
            table,
            &ClientMessage::Hello {
                versions: vec![1],
                scene,
                extensions: Extensions::NONE,
            },
        );
        for message in before {
            raw_peer.send(table, message);
        }
        let received = raw_peer.send(table, &ClientMessage::Join(StreamChoice::Full));
        let granted = received.iter().find_map(|message| match message {
            ServerMessage::Joined(joined) => Some(joined.granted),
            _ => None,
        });
        raw_peer.granted = granted.expect("joining an existing scene succeeds");
        raw_peer
    }

    /// Sends a message and returns the answers on the control stream.
    pub fn send(&mut self, table: &mut Table, message: &ClientMessage) -> Vec<ServerMessage> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.send_bytes(table, &bytes)
    }

    /// Sends bytes and returns the answers on the control stream.
    ///
    /// # Panics
    ///
    /// When an answer is not valid protocol.
    pub fn send_bytes(&mut self, table: &mut Table, bytes: &[u8]) -> Vec<ServerMessage> {
        table.control(self.peer, bytes);
        let mut received = Vec::new();
        for sent in table.take_received(self.peer) {
            if let Delivered::Control(bytes) = sent {
                self.frames.push(&bytes);
            }
            while let Some(framed) = self
                .frames
                .next_frame()
                .expect("a server sends whole messages")
            {
                received
                    .extend(ServerMessage::decode(&framed).expect("a server sends known messages"));
            }
        }
        received
    }

    /// Sends a command, unchecked.
    ///
    /// # Errors
    ///
    /// The reason of its refusal.
    ///
    /// # Panics
    ///
    /// When there is not exactly one answer.
    pub fn command(&mut self, table: &mut Table, command: Command) -> Result<(), CommandError> {
        let expected = self.commands;
        self.commands += 1;
        let received = self.send(table, &ClientMessage::Command(command.clone()));
        let applied = received.iter().filter(|message| {
            matches!(message, ServerMessage::Applied { through, .. } if *through == expected)
        });
        assert_eq!(
            applied.count(),
            1,
            "the answer to {command:?} is {received:?}"
        );
        let mut refusals = received.iter().filter_map(|message| match message {
            ServerMessage::Refused { number, error } => Some((*number, *error)),
            _ => None,
        });
        match (refusals.next(), refusals.next()) {
            (None, None) => Ok(()),
            (Some((number, error)), None) if number == expected => Err(error),
            other => panic!("{command:?} is answered by {other:?}"),
        }
    }

    /// The scene's checksum, tick and number of bodies.
    ///
    /// # Panics
    ///
    /// When no answer comes.
    pub fn inspect(&mut self, table: &mut Table) -> (u64, u64, u32) {
        let received = self.send(table, &ClientMessage::Inspect);
        let reported = received.iter().find_map(|message| match message {
            ServerMessage::Inspection(reported) => {
                Some((reported.truth, reported.tick.value(), reported.bodies))
            }
            _ => None,
        });
        reported.expect("a member may inspect")
    }

    /// The code with which the server closed the connection, if it did.
    #[must_use]
    pub fn closed(&self, table: &Table) -> Option<CloseCode> {
        table.closed(self.peer)
    }
}
