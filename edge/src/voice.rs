//! A member's own connection to the owner of its scene.
//!
//! Requests that act on the scene go there, and the answers come back.
//!
//! Frames pass as they are. Of what the owner sends to every member, it counts the scene events and drops the rest: the
//! mirror has it. Invariant: an answer waits until the member has the scene events before it, as if both had come over
//! one connection.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::message::{
    ClientMessage, Extension, Framed, Frames, Joined, ServerMessage, TierPolicy, frame,
};
use rhumb_protocol::packet::{Datagram, PacketKind};
use rhumb_protocol::session::TransportCode;
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::{Ending, Peer, Transmit};

/// The peer number of the owner on a link.
const OWNER: Peer = Peer(0);
/// Replies that wait for scene events beyond which the connection ends: the edge's own to the owner is late. Derived: those of
/// a member that asks for all that it may in a second.
const REPLIES_MAX: usize = 4_096;
/// Servers that a connection is sent on by, one after the other.
const FOLLOWED_MAX: u32 = 8;
/// Replies beyond which reports for the member's upstream are dropped.
const REPLIES_BEFORE_REPORTS: usize = 64;

/// The owner's answer to a member.
#[derive(Debug)]
pub(crate) enum Reply {
    /// A message for the member, and the scene events that precede it; `None` before a membership.
    Message(Box<ServerMessage>, Option<u64>),
    /// The owner has made it a member: its indices are in there, and the scene events of this snapshot.
    Joined(Box<Joined>),
    /// A datagram for its upstream.
    Datagram(Bytes),
    /// The connection has ended.
    Ended(Ending),
}

/// The connection of one member.
#[derive(Debug)]
pub(crate) struct Voice {
    link: Peer,
    is_open: bool,
    frames: Frames,
    /// Control bytes that wait until the connection is open.
    before_open: Vec<u8>,
    /// Scene events that the owner has sent to this member; `None` before its snapshot.
    events: Option<u64>,
    filling: bool,
    /// The newest start of a snapshot.
    joined: Option<Joined>,
    out: VecDeque<Transmit>,
    queued_bytes: usize,
    replies: VecDeque<Reply>,
    /// The member's hello, for another server.
    hello: Vec<u8>,
    /// The address of the server that has the scene, if the owner gave one.
    elsewhere: Option<String>,
    /// Servers that have sent it on.
    followed: u32,
}

impl Voice {
    /// A connection that is yet to be opened.
    pub(crate) const fn new(link: Peer) -> Self {
        Self {
            link,
            is_open: false,
            frames: Frames::new(),
            before_open: Vec::new(),
            events: None,
            filling: false,
            joined: None,
            out: VecDeque::new(),
            queued_bytes: 0,
            replies: VecDeque::new(),
            hello: Vec::new(),
            elsewhere: None,
            followed: 0,
        }
    }

    /// The address of the server that has the scene, if the owner gave one.
    pub(crate) fn elsewhere(&self) -> Option<&str> {
        self.elsewhere.as_deref()
    }

    /// Goes to the server that has the scene by another connection; false if it has been sent on too often.
    pub(crate) fn follow(&mut self, link: Peer) -> bool {
        self.followed += 1;
        if self.followed > FOLLOWED_MAX {
            return false;
        }
        (self.link, self.is_open) = (link, false);
        self.frames = Frames::new();
        self.before_open = self.hello.clone();
        self.out.clear();
        self.queued_bytes = 0;
        self.replies.clear();
        self.elsewhere = None;
        true
    }

    pub(crate) const fn link(&self) -> Peer {
        self.link
    }

    /// Bytes that wait for the owner.
    pub(crate) const fn queued_bytes(&self) -> usize {
        self.queued_bytes + self.before_open.len()
    }

    pub(crate) fn handle_opened(&mut self) {
        self.is_open = true;
        let waiting = std::mem::take(&mut self.before_open);
        self.push_control(waiting);
    }

    /// Sends a frame of the member.
    pub(crate) fn send_frame(&mut self, framed: &Framed) {
        let mut bytes = Vec::new();
        frame(framed.kind, &framed.body, &mut bytes);
        if self.hello.is_empty() {
            self.hello.clone_from(&bytes);
        }
        self.push_control(bytes);
    }

    /// Sends a message of the edge.
    fn send(&mut self, message: &ClientMessage) {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.push_control(bytes);
    }

    /// Sends a datagram of the member.
    pub(crate) fn send_datagram(&mut self, bytes: Bytes) {
        if self.is_open {
            self.out.push_back(Transmit::State { to: OWNER, bytes });
        }
    }

    /// Ends the connection. With code 0 the member has left for good.
    pub(crate) fn close(&mut self, code: u32) {
        self.out.push_back(Transmit::Close { to: OWNER, code });
    }

    /// Control bytes of the owner. Malformed ones end the connection, and so does a member whose answers wait for long.
    pub(crate) fn handle_control(&mut self, bytes: &[u8]) {
        let read = self.read(bytes);
        if read.is_err() || self.replies.len() > REPLIES_MAX {
            tracing::warn!(
                link = self.link.0,
                malformed = read.is_err(),
                "closing a connection to the owner"
            );
            self.close(TransportCode::LEFT.0);
            self.handle_ended(Ending::Broken);
        }
    }

    fn read(&mut self, bytes: &[u8]) -> Result<(), Malformed> {
        self.frames.push(bytes);
        while let Some(framed) = self.frames.next_frame()? {
            if let Some(message) = ServerMessage::decode(&framed)? {
                self.take(message);
            }
        }
        Ok(())
    }

    pub(crate) fn handle_datagram(&mut self, bytes: &[u8]) {
        // The member's stream comes from the mirror; reports are about its upstream.
        if let Ok(datagram) = Datagram::open(bytes)
            && datagram.head().kind == PacketKind::LossReport
            && self.replies.len() < REPLIES_BEFORE_REPORTS
        {
            let bytes = Bytes::copy_from_slice(bytes);
            self.replies.push_back(Reply::Datagram(bytes));
        }
    }

    pub(crate) fn handle_ended(&mut self, ending: Ending) {
        // Answers that wait for scene events would delay the end. The member hears them again by its session.
        self.replies.clear();
        self.replies.push_back(Reply::Ended(ending));
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Transmit> {
        let transmit = self.out.pop_front()?;
        if let Transmit::Control { bytes, .. } = &transmit {
            self.queued_bytes -= bytes.len();
        }
        Some(transmit)
    }

    /// The oldest reply.
    pub(crate) fn next_reply(&self) -> Option<&Reply> {
        self.replies.front()
    }

    /// True if the owner has ended the membership.
    pub(crate) fn tells_end(&self) -> bool {
        let mut replies = self.replies.iter();
        replies.any(|reply| matches!(reply, Reply::Message(message, _) if ends(message)))
    }

    pub(crate) fn take_reply(&mut self) -> Option<Reply> {
        self.replies.pop_front()
    }

    fn push_control(&mut self, bytes: Vec<u8>) {
        if bytes.is_empty() {
            return;
        }
        if !self.is_open {
            return self.before_open.extend(bytes);
        }
        self.queued_bytes += bytes.len();
        let bytes = Bytes::from(bytes);
        self.out.push_back(Transmit::Control { to: OWNER, bytes });
    }

    fn take(&mut self, message: ServerMessage) {
        match message {
            ServerMessage::Joined(joined) => {
                self.filling = true;
                self.events = Some(joined.start.scene_events);
                if self.joined.is_none() {
                    // The edge carries the stream: the owner need not mind this link.
                    self.send(&ClientMessage::TierPolicy(TierPolicy::Never));
                    self.replies
                        .push_back(Reply::Joined(Box::new(joined.clone())));
                }
                self.joined = Some(joined);
            }
            ServerMessage::SnapshotEnd => {
                self.filling = false;
                if let Some(joined) = &self.joined {
                    let stream = joined.start.stream;
                    self.send(&ClientMessage::Subscribed(stream));
                }
            }
            ServerMessage::SceneEvent(_) if self.filling => {}
            ServerMessage::SceneEvent(_) => {
                self.events = self.events.map(|events| events + 1);
            }
            ServerMessage::TickEvents(_) | ServerMessage::TierChanged { .. } => {}
            // The owner closes next; the member stays with the edge.
            ServerMessage::Moved { address } => self.elsewhere = String::from_utf8(address).ok(),
            ServerMessage::Welcome(welcome)
                if welcome.extensions.value(Extension::ELSEWHERE).is_some() =>
            {
                let address = welcome.extensions.value(Extension::ELSEWHERE);
                let address = address.and_then(|address| std::str::from_utf8(address).ok());
                self.elsewhere = address.map(str::to_owned);
            }
            message => {
                let ends = ends(&message);
                let events = self.events;
                self.replies
                    .push_back(Reply::Message(Box::new(message), events));
                if ends {
                    (self.events, self.joined) = (None, None);
                }
            }
        }
    }
}

const fn ends(message: &ServerMessage) -> bool {
    matches!(message, ServerMessage::Left | ServerMessage::Deleted)
}
