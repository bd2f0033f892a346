//! Answers to queries and inspections, and the events of bodies.
//!
//! All are work and bytes beside the stream: a scene that is late answers no queries, and a member that reads slowly
//! gets no events until it has caught up.

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{Inspection, QueryError, QueryResult, ServerMessage, TickEvents};
use rhumb_protocol::scene::{Answer, BodyEvent, Query, Stepping};
use rhumb_reckoning::Tick;

use super::RunningScene;
use crate::clients::Clients;
use crate::event_monitor::{EventKey, StepEvents};

fn encoded(tick: Tick, missed: u64, events: Vec<BodyEvent>) -> Bytes {
    let events = TickEvents {
        tick,
        missed,
        events,
    };
    let mut bytes = Vec::new();
    ServerMessage::TickEvents(events).encode(&mut bytes);
    Bytes::from(bytes)
}

impl RunningScene {
    /// Answers a member's message of queries.
    pub(super) fn answer_queries(&mut self, peer: Peer, queries: &[Query], clients: &mut Clients) {
        // Answers keep the order of messages: pending commands are answered first.
        self.answer_pending(clients);
        let answers = self.evaluate(peer, queries, clients);
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        let result = QueryResult {
            number: member.number_query(),
            tick: self.scene.tick(),
            answers,
        };
        clients.send(peer, &ServerMessage::QueryResult(result));
    }

    /// Charges the queries to the member, and evaluates them.
    fn evaluate(
        &mut self,
        peer: Peer,
        queries: &[Query],
        clients: &mut Clients,
    ) -> Result<Vec<Answer>, QueryError> {
        if self.faulted {
            return Err(QueryError::SceneFaulted);
        }
        let (now, count) = (clients.now(), clients.member_count());
        let cost = queries.iter().map(Query::cost).sum();
        // The members of a lockstep scene wait for one another anyway.
        if self.config().stepping == Stepping::FreeRunning
            && let Some(member) = clients.member_mut(peer)
            && (self.late || !member.query_budget.spend(now, cost, count))
        {
            return Err(QueryError::Overloaded);
        }
        self.scene.query(queries)
    }

    /// Sends the events of a step to the members, encoded once. A member that missed some gets what stands, too.
    pub(super) fn send_step_events(&mut self, happened: StepEvents, clients: &mut Clients) {
        let (scene, tick) = (&self.scene, self.scene.tick());
        let count = happened.missed + happened.events.len() as u64;
        let (mut shared, mut standing) = (None, None);
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            if control.is_behind() {
                member.miss_events(count);
            } else if let Some(after) = member.standing_after {
                let standing = standing.get_or_insert_with(|| scene.standing_events());
                let (events, due) = happened.with_standing(standing, after);
                let missed = happened.missed + std::mem::take(&mut member.missed_events);
                member.standing_after = match happened.missed {
                    0 => due,
                    _ => Some(EventKey::FIRST),
                };
                if missed > 0 || !events.is_empty() {
                    control.send_encoded(&encoded(tick, missed, events), out);
                }
            } else if count > 0 {
                let shared = shared
                    .get_or_insert_with(|| encoded(tick, happened.missed, happened.events.clone()));
                control.send_encoded(shared, out);
                if happened.missed > 0 {
                    member.standing_after = Some(EventKey::FIRST);
                }
            }
        }
    }

    /// Tells a new member what stands; what exceeds a message, or waits for its snapshot, comes with the next ticks.
    pub(super) fn tell_standing(&self, peer: Peer, clients: &mut Clients) {
        let standing = self.scene.standing_events();
        let (events, due) = StepEvents::default().with_standing(&standing, EventKey::FIRST);
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        member.standing_after = due;
        if !events.is_empty() {
            clients.send_encoded(peer, &encoded(self.scene.tick(), 0, events));
        }
    }

    pub(crate) fn inspect(&mut self, peer: Peer, clients: &mut Clients) {
        let times = self.times.summary();
        let Some(stream) = self.stream_of(peer, clients) else {
            return;
        };
        let sent = stream.sender.statistics();
        let inspection = Inspection {
            tick: self.scene.tick(),
            truth: self.scene.digest().value(),
            bodies: self.scene.body_count() as u32,
            awake: self.scene.awake_count() as u32,
            updates: sent.updates,
            packets: sent.packets,
            packet_bytes: sent.bytes,
            mismatches: stream.sender.mismatches(),
            over_budget: sent.over_budget,
            times,
        };
        clients.send(peer, &ServerMessage::Inspection(inspection));
    }
}
