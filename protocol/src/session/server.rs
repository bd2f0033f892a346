//! One connection at the server: reads requests where they are allowed.
//!
//! Does not know scenes: what a request means is decided by the host, which answers by `send`. Invariant: after the
//! first violation nothing more is read, and the connection is to be closed.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use super::close::CloseCode;
use crate::message::{
    ClientMessage, Frames, Grease, ServerMessage, StreamChoice, TakeAuthority, TierPolicy,
    VERSIONS, Welcome,
};
use crate::packet::StreamId;
use crate::scene::{Command, CommandError, SceneConfig, SceneName};
use crate::time::Instant;
use crate::wire::Malformed;

/// What a client wants, now that it may want it.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// The first of every connection; to be answered by [`ServerSession::welcome`].
    Hello {
        /// What the connection is about.
        scene: SceneName,
    },
    /// Create the scene.
    Create(SceneConfig),
    /// Become a member.
    Join(StreamChoice),
    /// Be one no longer.
    Leave,
    /// End the scene.
    Delete,
    /// More body indices.
    Reserve(u32),
    /// A command with its number.
    Command {
        /// CountSink from the joining.
        number: u64,
        /// What is requested_authority, or why nobody can wish that.
        command: Result<Command, CommandError>,
    },
    /// Step to this tick.
    Advance(Tick),
    /// A new snapshot.
    Resync,
    /// The time.
    Ping(Instant),
    /// The scene's state.
    Inspect,
    /// Another stream.
    Subscribe(StreamChoice),
    /// The stream before this one is needed no more.
    Subscribed(StreamId),
    /// To drive bodies.
    TakeAuthority(TakeAuthority),
    /// A packet of the stream on which it says how they move.
    Upstream(Vec<u8>),
    /// To be moved only so far when its link is thin.
    TierPolicy(TierPolicy),
}

/// How far the conversation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ServerState {
    Silent,
    Greeted,
    Lobby,
    Member {
        commands: u64,
    },
    /// A member until just now: what it said before it knew may still be under way, and is skipped.
    AwaitingLeft,
    Closed,
}

/// The server's end of one connection.
#[derive(Debug)]
pub struct ServerSession {
    state: ServerState,
    frames: Frames,
    grease: Grease,
    out: Vec<u8>,
    queue: VecDeque<Bytes>,
    close: Option<CloseCode>,
}

impl ServerSession {
    /// A conversation that waits for its `Hello`.
    #[must_use]
    pub const fn new(grease: Grease) -> Self {
        Self {
            state: ServerState::Silent,
            frames: Frames::new(),
            grease,
            out: Vec::new(),
            queue: VecDeque::new(),
            close: None,
        }
    }

    /// The next bytes of the client's control stream. Drain [`Self::poll_request`] after each call.
    pub fn handle_control(&mut self, bytes: &[u8]) {
        if self.state != ServerState::Closed {
            self.frames.push(bytes);
        }
    }

    /// The next request. Answer it before the next call: what is allowed depends on the answer.
    pub fn poll_request(&mut self) -> Option<Request> {
        while self.state != ServerState::Closed {
            let message = match self.frames.next_frame() {
                Ok(None) => return None,
                Ok(Some(framed)) => ClientMessage::decode(&framed),
                Err(malformed) => Err(malformed),
            };
            match message {
                Ok(None) => {}
                Ok(Some(message)) => match self.admit(message) {
                    Ok(Some(request)) => return Some(request),
                    Ok(None) => {}
                    Err(code) => self.close(code),
                },
                // Well framed and numbered, so that it is refused like any other command that cannot be.
                Err(Malformed::Motion(invalid)) if self.is_member() => {
                    let command = Err(CommandError::Invalid(invalid.into()));
                    return Some(self.numbered(command));
                }
                Err(Malformed::UnknownCommand) if self.is_member() => {
                    return Some(self.numbered(Err(CommandError::UnknownCommand)));
                }
                Err(malformed) => self.close(malformed.into()),
            }
        }
        None
    }

    const fn is_member(&self) -> bool {
        matches!(self.state, ServerState::Member { .. })
    }

    /// Gives a member's command its number.
    fn numbered(&mut self, command: Result<Command, CommandError>) -> Request {
        let number = match self.state {
            ServerState::Member { commands } => commands,
            _ => 0,
        };
        self.state = ServerState::Member {
            commands: number + 1,
        };
        Request::Command { number, command }
    }

    /// Whether a message is allowed now; `None` for one that is overtaken by the end of a membership.
    fn admit(&mut self, message: ClientMessage) -> Result<Option<Request>, CloseCode> {
        if self.state == ServerState::AwaitingLeft && is_for_members(&message) {
            return Ok(None);
        }
        self.admit_now(message).map(Some)
    }

    fn admit_now(&mut self, message: ClientMessage) -> Result<Request, CloseCode> {
        match (self.state, message) {
            (
                ServerState::Silent,
                ClientMessage::Hello {
                    versions,
                    scene,
                    extensions,
                },
            ) => {
                if !versions.contains(&VERSIONS[0]) {
                    return Err(CloseCode::VERSION);
                }
                if extensions.has_unknown_critical() {
                    return Err(CloseCode::EXTENSION);
                }
                self.state = ServerState::Greeted;
                Ok(Request::Hello { scene })
            }
            (ServerState::Silent | ServerState::Greeted | ServerState::Closed, _) => {
                Err(CloseCode::VIOLATION)
            }
            (_, ClientMessage::Ping { sent }) => Ok(Request::Ping(sent)),
            (_, ClientMessage::Delete) => Ok(Request::Delete),
            (ServerState::Member { .. }, message) => self.admit_member(message),
            (_, ClientMessage::Create(config)) => Ok(Request::Create(config)),
            (_, ClientMessage::Join(choice)) => Ok(Request::Join(choice)),
            _ => Err(CloseCode::VIOLATION),
        }
    }

    fn admit_member(&mut self, message: ClientMessage) -> Result<Request, CloseCode> {
        Ok(match message {
            ClientMessage::Command(command) => self.numbered(Ok(command)),
            ClientMessage::Advance { to } => Request::Advance(to),
            ClientMessage::Reserve { count } => Request::Reserve(count),
            ClientMessage::Resync => Request::Resync,
            ClientMessage::Inspect => Request::Inspect,
            ClientMessage::Subscribe(choice) => Request::Subscribe(choice),
            ClientMessage::Subscribed(stream) => Request::Subscribed(stream),
            ClientMessage::TakeAuthority(drive) => Request::TakeAuthority(drive),
            ClientMessage::Upstream(packet) => Request::Upstream(packet),
            ClientMessage::TierPolicy(tier_policy) => Request::TierPolicy(tier_policy),
            ClientMessage::Leave => Request::Leave,
            _ => return Err(CloseCode::VIOLATION),
        })
    }

    /// Answers the hello.
    pub fn welcome(&mut self, scene: Option<SceneConfig>) {
        if self.state == ServerState::Greeted {
            self.state = ServerState::Lobby;
            let welcome = Welcome {
                version: VERSIONS[0],
                scene,
                extensions: self.grease.extensions(),
            };
            self.send(&ServerMessage::Welcome(welcome));
            self.grease.message(&mut self.out);
        }
    }

    /// Says a message. What makes or unmakes a member changes what is allowed from here on.
    pub fn send(&mut self, message: &ServerMessage) {
        match message {
            ServerMessage::Joined(_)
                if matches!(self.state, ServerState::Lobby | ServerState::AwaitingLeft) =>
            {
                self.state = ServerState::Member { commands: 0 };
            }
            ServerMessage::Left | ServerMessage::Deleted
                if matches!(self.state, ServerState::Member { .. }) =>
            {
                self.state = ServerState::AwaitingLeft;
            }
            _ => {}
        }
        message.encode(&mut self.out);
    }

    /// Says messages that were encoded for many at once.
    pub fn send_encoded(&mut self, messages: &Bytes) {
        self.flush();
        self.queue.push_back(messages.clone());
    }

    /// Ends the conversation.
    pub fn close(&mut self, code: CloseCode) {
        self.state = ServerState::Closed;
        self.close.get_or_insert(code);
    }

    fn flush(&mut self) {
        if !self.out.is_empty() {
            let out = core::mem::take(&mut self.out);
            self.queue.push_back(Bytes::from(out));
        }
    }

    /// The next bytes for the client's control stream.
    pub fn poll_control(&mut self) -> Option<Bytes> {
        self.flush();
        self.queue.pop_front()
    }

    /// Why to close the connection, once everything was said.
    #[must_use]
    pub const fn poll_close(&self) -> Option<CloseCode> {
        self.close
    }
}

/// Whether only a member says such a thing.
const fn is_for_members(message: &ClientMessage) -> bool {
    matches!(
        message,
        ClientMessage::Leave
            | ClientMessage::Reserve { .. }
            | ClientMessage::Command(_)
            | ClientMessage::Advance { .. }
            | ClientMessage::Resync
            | ClientMessage::Inspect
            | ClientMessage::Subscribe(_)
            | ClientMessage::Subscribed(_)
            | ClientMessage::TakeAuthority(_)
            | ClientMessage::Upstream(_)
            | ClientMessage::TierPolicy(_)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Extension, Extensions};
    use proptest::prelude::*;

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
        assert_eq!(session.poll_request(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VIOLATION));
    }

    #[test]
    fn a_version_from_the_future_alone_is_refused() {
        let future = ClientMessage::Hello {
            versions: alloc::vec![77],
            scene: "pit".parse().unwrap(),
            extensions: Extensions::NONE,
        };
        let mut session = session_after(&[future]);
        assert_eq!(session.poll_request(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VERSION));
    }

    #[test]
    fn an_extension_is_skipped_unless_it_must_be_known() {
        for (id, closed) in [(27, None), (9, None), (8, Some(CloseCode::EXTENSION))] {
            let mut extensions = Extensions::NONE;
            let value = alloc::vec![1, 2];
            assert!(extensions.insert(Extension { id, value }));
            let mut session = session_after(&[ClientMessage::Hello {
                versions: alloc::vec![0x1a1a, 2, 1],
                scene: "pit".parse().unwrap(),
                extensions,
            }]);
            assert_eq!(session.poll_request().is_none(), closed.is_some());
            assert_eq!(session.poll_close(), closed);
        }
    }

    #[test]
    fn commands_are_for_members() {
        let command = ClientMessage::Command(Command::SetGravity {
            gravity: glam::Vec3::ZERO,
        });
        let mut session = session_after(&[hello(), command]);
        assert!(matches!(
            session.poll_request(),
            Some(Request::Hello { .. })
        ));
        session.welcome(None);
        assert_eq!(session.poll_request(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::VIOLATION));
    }

    #[test]
    fn messages_sent_before_a_left_reply_are_skipped() {
        let mut session = session_after(&[hello()]);
        session.poll_request();
        session.welcome(None);
        session.state = ServerState::Member { commands: 7 };
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
        assert_eq!(session.poll_request(), Some(Request::Delete));
        let joins = Some(Request::Join(StreamChoice::Full));
        assert_eq!(session.poll_request(), joins);
        assert_eq!(session.poll_close(), None);
    }

    #[test]
    fn a_command_from_the_future_is_refused_and_takes_a_number() {
        let mut session = session_after(&[hello()]);
        session.poll_request();
        session.welcome(None);
        session.state = ServerState::Member { commands: 7 };
        let mut bytes = Vec::new();
        crate::message::frame(7, &[0x80, 1, 2, 3], &mut bytes);
        ClientMessage::Command(Command::RemoveJoint {
            id: crate::scene::JointId(0),
        })
        .encode(&mut bytes);
        crate::message::frame(7, &[0x7f], &mut bytes);
        session.handle_control(&bytes);
        let command = Err(CommandError::UnknownCommand);
        let refused = Request::Command { number: 7, command };
        assert_eq!(session.poll_request(), Some(refused));
        let next = session.poll_request();
        assert!(matches!(
            next,
            Some(Request::Command {
                number: 8,
                command: Ok(_)
            })
        ));
        assert_eq!(session.poll_request(), None);
        assert_eq!(session.poll_close(), Some(CloseCode::MALFORMED));
    }

    #[test]
    fn an_unknown_message_that_may_be_ignored_is() {
        let mut session = session_after(&[hello()]);
        let mut bytes = Vec::new();
        crate::message::frame(0xee, &[1, 2, 3], &mut bytes);
        ClientMessage::Delete.encode(&mut bytes);
        session.handle_control(&bytes);
        assert!(session.poll_request().is_some());
        session.welcome(None);
        assert_eq!(session.poll_request(), Some(Request::Delete));
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_session_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2_000)) {
            let mut session = session_after(&[hello()]);
            session.handle_control(&bytes);
            let mut requests = 0;
            while let Some(request) = session.poll_request() {
                if let Request::Hello { .. } = request {
                    session.welcome(None);
                }
                requests += 1;
            }
            prop_assert!(requests <= bytes.len() + 1);
        }
    }
}
