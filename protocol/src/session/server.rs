//! The server's end of a connection: hands on the messages allowed now.
//!
//! Does not know scenes: the server loop acts on a message and answers by `send`. Invariant: after the first violation
//! nothing more is read, and the server closes the connection.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;

use super::CloseCode;
use crate::message::{
    ClientMessage, Extension, Framed, Frames, Grease, Role, ServerMessage, VERSIONS, Welcome,
};
use crate::scene::{CommandError, SceneConfig};
use crate::wire::Malformed;

/// The state of the connection as the server knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ServerState {
    Silent,
    Greeted,
    Lobby,
    Member,
    /// The membership just ended. Messages that the client sent before it learned this are skipped.
    AwaitingLeft,
    Closed,
}

/// The server's end of one connection.
#[derive(Debug)]
pub struct ServerSession {
    state: ServerState,
    frames: Frames,
    /// The frame of the last message that was handed on.
    last_frame: Option<Framed>,
    grease: Grease,
    out: Vec<u8>,
    queue: VecDeque<Bytes>,
    /// Bytes in the queue.
    queue_bytes: usize,
    close: Option<CloseCode>,
}

impl ServerSession {
    /// A session that waits for a `Hello`.
    #[must_use]
    pub const fn new(grease: Grease) -> Self {
        Self {
            state: ServerState::Silent,
            frames: Frames::new(),
            last_frame: None,
            grease,
            out: Vec::new(),
            queue: VecDeque::new(),
            queue_bytes: 0,
            close: None,
        }
    }

    /// Appends bytes of the client's control stream. Drain [`Self::poll_message`] after each call.
    pub fn handle_control(&mut self, bytes: &[u8]) {
        if self.state != ServerState::Closed {
            self.frames.push(bytes);
        }
    }

    /// The next message allowed in this state, or the error of a member's command that this version cannot carry out.
    ///
    /// Answer it before the next call: the answer decides which messages are allowed.
    pub fn poll_message(&mut self) -> Option<Result<ClientMessage, CommandError>> {
        while self.state != ServerState::Closed {
            let framed = match self.frames.next_frame() {
                Ok(None) => return None,
                Ok(Some(framed)) => framed,
                Err(malformed) => {
                    self.close(malformed.into());
                    continue;
                }
            };
            let message = ClientMessage::decode(&framed);
            self.last_frame = Some(framed);
            match message {
                Ok(None) => {}
                Ok(Some(message)) => match self.admit(&message) {
                    Ok(true) => return Some(Ok(message)),
                    Ok(false) => {}
                    Err(code) => self.close(code),
                },
                // The frame is complete, so only this command is refused and the connection stays open.
                Err(Malformed::Motion(invalid)) if self.state == ServerState::Member => {
                    return Some(Err(CommandError::Invalid(invalid.into())));
                }
                Err(Malformed::UnknownCommand) if self.state == ServerState::Member => {
                    return Some(Err(CommandError::UnknownCommand));
                }
                Err(malformed) => self.close(malformed.into()),
            }
        }
        None
    }

    /// The frame of the last message from [`Self::poll_message`], to hand it on as it is.
    #[must_use]
    pub const fn last_frame(&self) -> Option<&Framed> {
        self.last_frame.as_ref()
    }

    /// Returns `false` for a message to drop: the client sent it before it learned that its membership had ended.
    fn admit(&mut self, message: &ClientMessage) -> Result<bool, CloseCode> {
        match (self.state, message) {
            (
                ServerState::Silent,
                ClientMessage::Hello {
                    versions,
                    extensions,
                    ..
                },
            ) => {
                if !versions.contains(&VERSIONS[0]) {
                    return Err(CloseCode::VERSION);
                }
                if extensions.has_unknown_critical() {
                    return Err(CloseCode::EXTENSION);
                }
                self.state = ServerState::Greeted;
                Ok(true)
            }
            (ServerState::Silent | ServerState::Greeted | ServerState::Closed, _) => {
                Err(CloseCode::VIOLATION)
            }
            (_, ClientMessage::Ping { .. } | ClientMessage::Delete) => Ok(true),
            (ServerState::AwaitingLeft, message) if is_for_members(message) => Ok(false),
            (ServerState::Member, message) if is_for_members(message) => Ok(true),
            (
                ServerState::Lobby | ServerState::AwaitingLeft,
                ClientMessage::Create(_)
                | ClientMessage::Join(_)
                | ClientMessage::Session(_)
                | ClientMessage::JoinCells,
            ) => Ok(true),
            _ => Err(CloseCode::VIOLATION),
        }
    }

    /// Answers the client's `Hello`. `scene` is the config of the scene, if it exists; `role` answers a token.
    pub fn welcome(&mut self, scene: Option<SceneConfig>, role: Option<Role>) {
        self.welcome_with(scene, role.map(Role::extension));
    }

    /// Answers the client's `Hello` by the address of the server that has the scene, and closes.
    ///
    /// `place`: printable ASCII of at most as many bytes as an extension may have.
    pub fn welcome_elsewhere(&mut self, place: &str, role: Option<Role>) {
        let elsewhere = Extension {
            id: Extension::ELSEWHERE,
            value: place.as_bytes().to_vec(),
        };
        let role = role.map(Role::extension);
        self.welcome_with(None, role.into_iter().chain([elsewhere]));
        self.close(CloseCode::SCENE_ELSEWHERE);
    }

    fn welcome_with(
        &mut self,
        scene: Option<SceneConfig>,
        more: impl IntoIterator<Item = Extension>,
    ) {
        if self.state == ServerState::Greeted {
            self.state = ServerState::Lobby;
            let mut extensions = self.grease.extensions();
            for extension in more {
                let fits = extensions.insert(extension);
                debug_assert!(fits, "a few extensions fit");
            }
            let welcome = Welcome {
                version: VERSIONS[0],
                scene,
                extensions,
            };
            self.send(&ServerMessage::Welcome(welcome));
            self.grease.message(&mut self.out);
        }
    }

    /// Sends a message. A message that starts or ends a membership changes which messages are allowed next.
    pub fn send(&mut self, message: &ServerMessage) {
        match message {
            ServerMessage::Joined(_)
                if matches!(self.state, ServerState::Lobby | ServerState::AwaitingLeft) =>
            {
                self.state = ServerState::Member;
            }
            ServerMessage::Left | ServerMessage::Deleted if self.state == ServerState::Member => {
                self.state = ServerState::AwaitingLeft;
            }
            _ => {}
        }
        message.encode(&mut self.out);
    }

    /// Sends messages that were encoded once for many clients.
    pub fn send_encoded(&mut self, messages: &Bytes) {
        self.flush();
        self.queue_bytes += messages.len();
        self.queue.push_back(messages.clone());
    }

    /// Closes the connection with the first code given.
    pub fn close(&mut self, code: CloseCode) {
        self.state = ServerState::Closed;
        self.close.get_or_insert(code);
    }

    fn flush(&mut self) {
        if !self.out.is_empty() {
            let out = core::mem::take(&mut self.out);
            self.queue_bytes += out.len();
            self.queue.push_back(Bytes::from(out));
        }
    }

    /// The next bytes for the client's control stream.
    pub fn poll_control(&mut self) -> Option<Bytes> {
        self.flush();
        let bytes = self.queue.pop_front()?;
        self.queue_bytes -= bytes.len();
        Some(bytes)
    }

    /// Bytes for the client's control stream that were not polled yet.
    #[must_use]
    pub const fn queued_bytes(&self) -> usize {
        self.out.len() + self.queue_bytes
    }

    /// Bytes of the client's control stream that no message has used yet.
    #[must_use]
    pub const fn unread_bytes(&self) -> usize {
        self.frames.unread_bytes()
    }

    /// The code to close with, once all control bytes are sent.
    #[must_use]
    pub const fn poll_close(&self) -> Option<CloseCode> {
        self.close
    }
}

/// True if only a member may send this message.
const fn is_for_members(message: &ClientMessage) -> bool {
    matches!(
        message,
        ClientMessage::Leave
            | ClientMessage::Reserve { .. }
            | ClientMessage::Command(_)
            | ClientMessage::Advance { .. }
            | ClientMessage::Resync(_)
            | ClientMessage::Inspect
            | ClientMessage::Subscribe(_)
            | ClientMessage::Subscribed(_)
            | ClientMessage::TakeAuthority(_)
            | ClientMessage::Upstream(_)
            | ClientMessage::TierPolicy(_)
            | ClientMessage::Query(_)
            | ClientMessage::OfCell { .. }
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rhumb_reckoning::Tick;

    use super::*;
    use crate::message::{Extensions, StreamChoice};
    use crate::scene::Command;

    fn hello() -> ClientMessage {
        ClientMessage::Hello {
            versions: alloc::vec![9, 1],
            scene: "pit".parse().unwrap(),
            extensions: Extensions::NONE,
        }
    }

    fn session_after(messages: &[ClientMessage]) -> ServerSession {
        let mut session = ServerSession::new(Grease::new(0));
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        session.handle_control(&bytes);
        session
    }

    #[test]
    fn a_session_begins_with_a_hello() {
        let mut session = session_after(&[ClientMessage::Delete]);
        assert_eq!(session.poll_message(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VIOLATION));
    }

    #[test]
    fn a_client_that_offers_only_unknown_versions_is_refused() {
        let future = ClientMessage::Hello {
            versions: alloc::vec![77],
            scene: "pit".parse().unwrap(),
            extensions: Extensions::NONE,
        };
        let mut session = session_after(&[future]);
        assert_eq!(session.poll_message(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VERSION));
    }

    #[test]
    fn an_unknown_extension_is_skipped_unless_it_is_critical() {
        for (id, closed) in [(27, None), (9, None), (8, Some(CloseCode::EXTENSION))] {
            let mut extensions = Extensions::NONE;
            let value = alloc::vec![1, 2];
            assert!(extensions.insert(Extension { id, value }));
            let mut session = session_after(&[ClientMessage::Hello {
                versions: alloc::vec![0x1a1a, 2, 1],
                scene: "pit".parse().unwrap(),
                extensions,
            }]);
            assert_eq!(session.poll_message().is_none(), closed.is_some());
            assert_eq!(session.poll_close(), closed);
        }
    }

    #[test]
    fn a_command_before_joining_closes_the_connection() {
        let command = ClientMessage::Command(Command::SetGravity {
            gravity: glam::Vec3::ZERO,
        });
        let mut session = session_after(&[hello(), command]);
        assert!(matches!(
            session.poll_message(),
            Some(Ok(ClientMessage::Hello { .. }))
        ));
        session.welcome(None, None);
        assert_eq!(session.poll_message(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VIOLATION));
    }

    #[test]
    fn messages_sent_before_a_left_reply_are_skipped() {
        let mut session = session_after(&[hello()]);
        session.poll_message();
        session.welcome(None, None);
        session.state = ServerState::Member;
        session.send(&ServerMessage::Deleted);
        let mut bytes = Vec::new();
        for message in [
            ClientMessage::Command(Command::SetGravity {
                gravity: glam::Vec3::ZERO,
            }),
            ClientMessage::Advance { to: Tick::new(9) },
            ClientMessage::Leave,
            ClientMessage::Delete,
            ClientMessage::Join(StreamChoice::Full),
        ] {
            message.encode(&mut bytes);
        }
        session.handle_control(&bytes);
        assert_eq!(session.poll_message(), Some(Ok(ClientMessage::Delete)));
        let joins = Some(Ok(ClientMessage::Join(StreamChoice::Full)));
        assert_eq!(session.poll_message(), joins);
        assert_eq!(session.poll_close(), None);
    }

    #[test]
    fn an_unknown_command_is_refused_without_closing() {
        let mut session = session_after(&[hello()]);
        session.poll_message();
        session.welcome(None, None);
        session.state = ServerState::Member;
        let mut bytes = Vec::new();
        crate::message::frame(7, &[0x80, 1, 2, 3], &mut bytes);
        ClientMessage::Command(Command::RemoveJoint {
            id: crate::scene::JointId(0),
        })
        .encode(&mut bytes);
        crate::message::frame(7, &[0x7f], &mut bytes);
        session.handle_control(&bytes);
        let refused = Some(Err(CommandError::UnknownCommand));
        assert_eq!(session.poll_message(), refused);
        let next = session.poll_message();
        assert!(matches!(next, Some(Ok(ClientMessage::Command(_)))));
        assert_eq!(session.poll_message(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::MALFORMED));
    }

    #[test]
    fn an_unknown_message_is_ignored() {
        let mut session = session_after(&[hello()]);
        let mut bytes = Vec::new();
        crate::message::frame(0xee, &[1, 2, 3], &mut bytes);
        ClientMessage::Delete.encode(&mut bytes);
        session.handle_control(&bytes);
        assert!(session.poll_message().is_some());
        session.welcome(None, None);
        assert_eq!(session.poll_message(), Some(Ok(ClientMessage::Delete)));
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_session_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2_000)) {
            let mut session = session_after(&[hello()]);
            session.handle_control(&bytes);
            let mut messages = 0;
            while let Some(message) = session.poll_message() {
                if let Ok(ClientMessage::Hello { .. }) = message {
                    session.welcome(None, None);
                }
                messages += 1;
            }
            prop_assert!(messages <= bytes.len() + 1);
        }
    }
}
