//! The attacker of a load: its connections, with a session and without.
//!
//! Knows no abuse. A raw member sends any messages in any order, and reads what comes only while it waits for something.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rhumb_client::scene::{BodyBuilder, SceneConfig};
use rhumb_client::{BodyId, Client, JoinMode, JoinOptions, Refusals, Trust};
use rhumb_netsim::{RawConnection, RawEvent, RawPeerConfig};
use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, ServerMessage, StreamChoice, Token, VERSIONS,
};
use rhumb_protocol::packet::StreamId;
use rhumb_reckoning::Tolerance;
use rhumb_transport::Fingerprint;

use super::rig::LIMIT;
use crate::output::Failure;

/// The scene whose ticks are measured.
pub(super) const VICTIM: &str = "victim/scene";
/// Time between two looks at whether the abuse is over.
const LOOK: Duration = Duration::from_millis(20);
/// Pause after something was refused.
const REFUSED_PAUSE: Duration = Duration::from_millis(100);
/// Batches of messages on their way at one time: the next one arrives while the server works on this one.
const BATCHES: u64 = 2;

/// One who abuses a server until it is stopped.
pub(super) struct Attacker {
    pub(super) address: SocketAddr,
    pub(super) fingerprint: Fingerprint,
    /// Its token as the owner of its own scenes, `attacker/*`.
    pub(super) own: String,
    /// Its token as a controller of the victim's scene.
    pub(super) of_victim: String,
    pub(super) is_stopped: AtomicBool,
}

impl Attacker {
    /// True until it is stopped.
    pub(super) fn goes_on(&self) -> bool {
        !self.is_stopped.load(Ordering::Relaxed)
    }

    /// Does something again and again; returns how often it was done. What is refused is tried again after a pause.
    ///
    /// # Errors
    ///
    /// The last refusal, if it was never done.
    pub(super) fn again(
        &self,
        mut turn: impl FnMut(u64) -> Result<(), Failure>,
    ) -> Result<u64, Failure> {
        let (mut done, mut tries, mut refused) = (0, 0, None);
        while self.goes_on() {
            match turn(tries) {
                Ok(()) => done += 1,
                Err(cause) => {
                    refused = Some(cause);
                    thread::sleep(REFUSED_PAUSE);
                }
            }
            tries += 1;
        }
        match refused {
            Some(cause) if done == 0 => Err(cause),
            _ => Ok(done),
        }
    }

    /// Does something so many times at once, each on a thread; returns the sum.
    pub(super) fn side_by_side(
        &self,
        count: u64,
        one: impl Fn(u64) -> Result<u64, Failure> + Sync,
    ) -> Result<u64, Failure> {
        thread::scope(|scope| {
            let one = &one;
            let threads: Vec<_> = (0..count)
                .map(|number| scope.spawn(move || one(number)))
                .collect();
            let ended = threads.into_iter().map(|thread| {
                let ended = thread.join();
                ended.unwrap_or_else(|_| Err("a thread of the abuse panicked".into()))
            });
            ended.sum()
        })
    }

    fn token(&self, scene: &str) -> &str {
        if scene == VICTIM {
            &self.of_victim
        } else {
            &self.own
        }
    }

    /// Joins a scene.
    pub(super) fn join(&self, scene: &str, mode: JoinMode) -> Result<Client, Failure> {
        let options = JoinOptions {
            mode,
            refusals: Refusals::Events,
            ..JoinOptions::default()
        };
        let trust = Trust::Fingerprint(self.fingerprint);
        let connection = Client::connect(&self.address.to_string(), trust)?;
        let connection = connection.timeout(LIMIT).token(self.token(scene));
        Ok(connection.join_with(scene, options)?)
    }

    /// Makes a scene with these bodies, which it may have refused.
    pub(super) fn make(
        &self,
        scene: &str,
        config: SceneConfig,
        bodies: impl IntoIterator<Item = BodyBuilder>,
    ) -> Result<(Client, Vec<BodyId>), Failure> {
        let mut client = self.join(scene, JoinMode::Create(config))?;
        let ids = client.add_bodies(bodies)?;
        client.flush();
        Ok((client, ids))
    }

    /// Stays in scenes until all of this time is over, or the abuse is.
    pub(super) fn stay(&self, clients: &mut [Client], time: Duration) -> Result<(), Failure> {
        let begun = Instant::now();
        while self.goes_on() && begun.elapsed() < time {
            thread::sleep(LOOK);
            for client in &mut *clients {
                client.idle(Duration::ZERO)?;
                while client.poll_event().is_some() {}
            }
        }
        Ok(())
    }

    /// Connects a raw peer that says hello to a scene, and sends these messages.
    pub(super) fn greet(
        &self,
        scene: &str,
        messages: &[ClientMessage],
    ) -> Result<RawMember, Failure> {
        let peer = self.connect()?;
        peer.open_control();
        let token: Token = self.token(scene).parse()?;
        let mut extensions = Extensions::NONE;
        let shown = extensions.insert(token.extension());
        debug_assert!(shown, "it is the only one");
        let member = RawMember {
            peer,
            frames: Frames::new(),
            stream: StreamId(0),
            packets: 0,
        };
        member.send(&[ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: scene.parse()?,
            extensions,
        }]);
        member.send(messages);
        Ok(member)
    }

    /// A raw member of a scene, after these messages.
    pub(super) fn enter(
        &self,
        scene: &str,
        before: &[ClientMessage],
    ) -> Result<RawMember, Failure> {
        let join = ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL));
        let mut member = self.greet(scene, before)?;
        member.send(&[join]);
        let mut stream = None;
        while self.goes_on() && stream.is_none() {
            let mut denied = None;
            member.read(LOOK, |message| match message {
                ServerMessage::Joined(joined) => stream = Some(joined.start.stream),
                ServerMessage::Denied(denial) => denied = Some(denial),
                _ => {}
            })?;
            if let Some(denial) = denied {
                return Err(denial.to_string().into());
            }
        }
        member.stream = stream.unwrap_or(member.stream);
        Ok(member)
    }

    /// A connection that has said nothing.
    pub(super) fn connect(&self) -> Result<RawConnection, Failure> {
        let trust = Trust::Fingerprint(self.fingerprint);
        let config = RawPeerConfig::default();
        let connected = RawConnection::connect(self.address, "localhost", &trust, &config, LIMIT);
        Ok(connected?)
    }

    /// Sends these messages again and again, as fast as the server handles them; returns their number.
    pub(super) fn flood(
        &self,
        mut member: RawMember,
        batch: &[ClientMessage],
    ) -> Result<u64, Failure> {
        let (mut sent, mut handled) = (0, 0);
        while self.goes_on() {
            if sent < handled + BATCHES {
                sent += 1;
                member.send(batch);
                member.send(&[ping(sent)]);
            } else {
                member.read(LOOK, |message| {
                    if let ServerMessage::Pong { sent, .. } = message {
                        handled = handled.max(sent.as_nanos());
                    }
                })?;
            }
        }
        Ok(handled * batch.len() as u64)
    }
}

/// A ping with a number, 0 for one whose answer is not awaited.
pub(super) const fn ping(number: u64) -> ClientMessage {
    ClientMessage::Ping {
        sent: rhumb_protocol::Instant::from_nanos(number),
    }
}

/// A member without a session: every message is its owner's.
pub(super) struct RawMember {
    pub(super) peer: RawConnection,
    frames: Frames,
    /// The stream that it takes.
    pub(super) stream: StreamId,
    /// Datagrams received.
    pub(super) packets: u64,
}

impl RawMember {
    pub(super) fn send(&self, messages: &[ClientMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        self.peer.send_control(bytes);
    }

    /// Reads what comes, or waits so long for something; hands over each message.
    ///
    /// # Errors
    ///
    /// The end of the connection, and messages that are none.
    pub(super) fn read(
        &mut self,
        timeout: Duration,
        mut each: impl FnMut(ServerMessage),
    ) -> Result<(), Failure> {
        let mut event = self.peer.next_event(timeout);
        while let Some(received) = event {
            match received {
                RawEvent::Control(bytes) => self.frames.push(&bytes),
                RawEvent::Datagram(_) => self.packets += 1,
                RawEvent::Ended(end) => return Err(end.to_string().into()),
                _ => {}
            }
            event = self.peer.next_event(Duration::ZERO);
        }
        let malformed = |_| "the server sent no message";
        while let Some(framed) = self.frames.next_frame().map_err(malformed)? {
            if let Some(message) = ServerMessage::decode(&framed).map_err(malformed)? {
                each(message);
            }
        }
        Ok(())
    }
}
