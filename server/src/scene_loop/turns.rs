//! Turns of connections: which messages are handled now, and which wait.

use rhumb_protocol::message::ClientMessage;
use rhumb_protocol::scene::{Command, CommandError};
use rhumb_protocol::{Instant, Peer, Span};

use super::{DisconnectReason, RunningScene, SceneLoop};
use crate::baking::{self, Bake};
use crate::clients::Turn;

/// Messages of one connection that are handled before others, and the ticks, get their turn.
const MESSAGES_PER_TURN: usize = 512;
/// Scene events that are encoded before they are sent to the members.
const EVENT_BYTES: usize = 256 << 10;
/// The pause before a connection is tried again whose messages wait for slower members.
const RETRY: Span = Span::from_millis(20);

impl SceneLoop {
    /// Handles a connection's messages, until none is left, it must wait, or others have their turn.
    pub(super) fn take_turn(&mut self, now: Instant, peer: Peer) {
        let mut left = if self.clients.is_paced(peer) {
            MESSAGES_PER_TURN
        } else {
            usize::MAX
        };
        loop {
            if self.must_wait(now, peer) {
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            }
            if left == 0 {
                self.clients.set_turn(peer, Turn::Queued);
                break;
            }
            let Some(message) = self.next_message(peer) else {
                break;
            };
            if let Ok(message @ ClientMessage::Join(_)) = &message
                && !self.clients.may_snapshot(peer)
                && let Some(client) = self.clients.get_mut(peer)
            {
                client.held = Some(message.clone());
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            }
            let Some(message) = self.bake(now, peer, message) else {
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            };
            // A message of queries or for indices ends the turn: it is as much work as many others.
            let is_work = left != usize::MAX
                && matches!(
                    message,
                    Ok(ClientMessage::Query(_) | ClientMessage::Reserve { .. })
                );
            left = if is_work { 0 } else { left - 1 };
            self.settings.heartbeat.beat();
            self.handle_message(now, peer, message);
            self.answer_if_long();
        }
        self.end_if_broken(peer);
        self.answer_pending();
    }

    /// Sends the scene events if there are many.
    fn answer_if_long(&mut self) {
        if self
            .running
            .as_ref()
            .is_some_and(|running| running.unsent_bytes() > EVENT_BYTES)
        {
            self.answer_pending();
        }
    }

    /// True if a connection's next message must stay unread.
    fn must_wait(&mut self, now: Instant, peer: Peer) -> bool {
        if self.clients.is_behind(peer) {
            return true;
        }
        RunningScene::holds_back(now, peer, &mut self.clients)
    }

    fn next_message(&mut self, peer: Peer) -> Option<Result<ClientMessage, CommandError>> {
        let client = self.clients.get_mut(peer)?;
        if client.turn == Turn::Over {
            return None;
        }
        match client.held.take() {
            Some(message) => Some(Ok(message)),
            None => self.clients.session(peer)?.poll_message(),
        }
    }

    /// Tries the connections again that had to wait. Those whose solids wait for others come first, the longest wait before
    /// all: so a place for a solid goes to the one that waits longest.
    pub(super) fn retry(&mut self, now: Instant) {
        self.retry_at = now + RETRY;
        let mut blocked = self.clients.take_in_turn(Turn::Blocked);
        blocked.sort_by_key(|peer| {
            let since = self.waits_to_bake_since(*peer);
            (since.is_none(), since)
        });
        for peer in blocked {
            self.take_turn(now, peer);
        }
    }

    /// The moment since which a connection's solid waits for others; `None` if none does.
    fn waits_to_bake_since(&self, peer: Peer) -> Option<Instant> {
        self.clients.get(peer)?.bake.as_ref()?.waits_since()
    }

    /// Something that a connection waited for is there.
    pub fn handle_wake(&mut self, now: Instant) {
        self.clients.at(now);
        if self.is_baking() {
            self.retry(now);
        }
    }

    /// True if a connection waits for a solid.
    fn is_baking(&self) -> bool {
        let mut waiting = self.clients.in_turn(Turn::Blocked);
        let bakes = |peer| (self.clients.get(peer)).is_some_and(|of| of.bake.is_some());
        self.bakery.is_busy() || waiting.any(bakes)
    }

    /// Handles what arrived before the end of a connection, as far as it does something without its client: an answer
    /// would have no reader. A client that leaves loses nothing. Of one that broke off, what is beyond its rate is left out,
    /// since its session sends it again.
    pub(super) fn handle_rest(&mut self, now: Instant, peer: Peer, reason: DisconnectReason) {
        let is_left_out = |scene: &mut Self| {
            reason == DisconnectReason::Disconnected
                && (scene.clients.member(peer)).is_some_and(|member| member.is_over_rate(now))
        };
        while !is_left_out(self)
            && let Some(message) = self.next_message(peer)
        {
            self.settings.heartbeat.beat();
            match message {
                // The client is gone and joins nothing.
                Ok(ClientMessage::Join(_) | ClientMessage::Session(_)) => break,
                Ok(message) if asks_for_an_answer_alone(&message) => continue,
                _ => {}
            }
            let Some(message) = self.bake(now, peer, message) else {
                break;
            };
            self.handle_message(now, peer, message);
            self.answer_if_long();
        }
    }

    /// A message that is to be handled now: the message itself, or the error of a shape whose solid took too long. `None`
    /// if it is held until its solid is made.
    fn bake(
        &mut self,
        now: Instant,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
    ) -> Option<Result<ClientMessage, CommandError>> {
        let Ok(ClientMessage::Command(Command::AddShape { id, shape })) = &message else {
            return Some(message);
        };
        if !baking::is_heavy(shape) {
            return Some(message);
        }
        let is_new = (self.clients.get(peer)).is_some_and(|of| of.bake.is_none());
        // A new one gives way to those that wait, and is tried again after them.
        let waits = |of| self.waits_to_bake_since(of).is_some();
        let gives_way = is_new && self.clients.in_turn(Turn::Blocked).any(waits);
        let Some(client) = self.clients.get_mut(peer) else {
            return Some(message);
        };
        let running = self.running.as_mut().filter(|_| client.member.is_some());
        let Some((running, baker)) = running.and_then(|running| {
            let baker = running.baker_for(&client.permit, *id, shape)?;
            Some((running, baker))
        }) else {
            // The shape needs no solid any more; one that is made for it is of no other use.
            client.bake = None;
            return Some(message);
        };
        let bake = client.bake.get_or_insert_with(|| Bake::wanted(now));
        if !gives_way {
            self.bakery.begin(bake, now, shape, baker);
        }
        if let Some(baked) = bake.take() {
            running.put_baked(*id, shape, baked);
            client.bake = None;
            return Some(message);
        }
        if bake.takes_longer_than(self.settings.limits.bake(), now) {
            client.bake = None;
            let limit_ms =
                u32::try_from(self.settings.limits.bake_milliseconds).unwrap_or(u32::MAX);
            return Some(Err(CommandError::ShapeTooSlow { limit_ms }));
        }
        client.held = message.ok();
        None
    }
}

/// True for a message that does nothing but for its sender.
const fn asks_for_an_answer_alone(message: &ClientMessage) -> bool {
    matches!(
        message,
        ClientMessage::Query(_)
            | ClientMessage::Inspect
            | ClientMessage::Ping { .. }
            | ClientMessage::Reserve { .. }
            | ClientMessage::Resync(_)
            | ClientMessage::Subscribe(_)
            | ClientMessage::Subscribed(_)
            | ClientMessage::TierPolicy(_)
    )
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rhumb_protocol::message::{
        Extensions, Frames, SceneEvent, ServerMessage, StreamChoice, VERSIONS,
    };
    use rhumb_protocol::scene::{SceneConfig, Shape, ShapeId};
    use rhumb_protocol::session::CloseCode;
    use rhumb_protocol::{Ending, Endpoint as _, Transmit};

    use super::*;
    use crate::permit::{Permit, Quotas};
    use crate::settings::SceneSettings;

    const HASTY: Peer = Peer(1);
    const WATCHER: Peer = Peer(2);
    /// Commands in a second.
    const RATE: u32 = 10;
    /// Commands that the hasty client sends at once.
    const SENT: u32 = 100;

    fn send(server: &mut SceneLoop, peer: Peer, messages: &[ClientMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        server.handle_control(Instant::ZERO, peer, &bytes);
    }

    fn join(server: &mut SceneLoop, peer: Peer, permit: Permit) {
        server.handle_opened(Instant::ZERO, peer);
        server.admit(peer, Arc::new(permit));
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: "rate".parse().unwrap(),
            extensions: Extensions::NONE,
        };
        let create = ClientMessage::Create(SceneConfig::default());
        let join = ClientMessage::Join(StreamChoice::Full);
        send(server, peer, &[hello, create, join]);
    }

    /// Commands of a client beyond its rate that are applied when its connection ends.
    fn applied(ending: Ending) -> u32 {
        let settings = SceneSettings::new(|| Instant::ZERO).into();
        let mut server = SceneLoop::new("rate".parse().unwrap(), settings);
        join(&mut server, WATCHER, Permit::OPEN);
        let quotas = Quotas {
            commands: Some(RATE),
            ..Quotas::default()
        };
        let permit = Permit {
            quotas,
            ..Permit::OPEN
        };
        join(&mut server, HASTY, permit);
        let added = |id| {
            let shape = Shape::ball(0.5);
            ClientMessage::Command(Command::AddShape {
                id: ShapeId(id),
                shape,
            })
        };
        let commands: Vec<_> = (0..SENT).map(added).collect();
        send(&mut server, HASTY, &commands);
        server.handle_ended(Instant::ZERO, HASTY, ending);
        let (mut frames, mut count) = (Frames::default(), 0);
        while let Some(transmit) = server.poll_transmit() {
            if let Transmit::Control { to: WATCHER, bytes } = transmit {
                frames.push(&bytes);
            }
        }
        while let Some(framed) = frames.next_frame().unwrap() {
            let message = ServerMessage::decode(&framed).unwrap();
            count += u32::from(matches!(
                message,
                Some(ServerMessage::SceneEvent(SceneEvent::ShapeAdded { .. }))
            ));
        }
        count
    }

    #[test]
    fn a_broken_connection_takes_no_command_beyond_its_rate_and_one_that_leaves_loses_none() {
        // A second of its rate, and the command that exceeds it.
        assert_eq!(applied(Ending::Broken), RATE + 1);
        assert_eq!(applied(Ending::TimedOut), RATE + 1);
        assert_eq!(applied(Ending::Closed(CloseCode::DONE.0)), SENT);
    }
}
