//! Answers to queries and inspections, and the events of bodies.
//!
//! All are work and bytes beside the stream: a scene that is late answers no queries, and a member that reads slowly
//! gets no events until it has caught up.

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{Inspection, QueryError, QueryResult, ServerMessage, TickEvents};
use rhumb_protocol::scene::{Answer, Query, Stepping};

use super::SceneRunner;
use crate::event_monitor::StepEvents;
use crate::outbox::Outbox;

impl SceneRunner {
    /// Answers a member's message of queries.
    pub(super) fn answer_queries(&mut self, peer: Peer, queries: &[Query], out: &mut Outbox) {
        // Answers keep the order of messages: pending commands are answered first.
        self.answer_pending(out);
        let answers = self.evaluate(peer, queries, out);
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        let result = QueryResult {
            number: member.number_query(),
            tick: self.scene.tick(),
            answers,
        };
        out.send(peer, &ServerMessage::QueryResult(result));
    }

    /// Charges the queries to the member, and evaluates them.
    fn evaluate(
        &mut self,
        peer: Peer,
        queries: &[Query],
        out: &Outbox,
    ) -> Result<Vec<Answer>, QueryError> {
        if self.faulted {
            return Err(QueryError::SceneFaulted);
        }
        let count = self.members.len();
        let cost = queries.iter().map(Query::cost).sum();
        // The members of a lockstep scene wait for one another anyway.
        if self.config().stepping == Stepping::FreeRunning
            && let Some(member) = self.members.get_mut(&peer)
            && (self.late || !member.query_budget.spend(out.now(), cost, count))
        {
            return Err(QueryError::Overloaded);
        }
        self.scene.query(queries)
    }

    /// Sends the events of a step to the members, encoded once.
    pub(super) fn send_step_events(&mut self, happened: StepEvents, out: &mut Outbox) {
        if happened == StepEvents::default() {
            return;
        }
        let mut events = TickEvents {
            tick: self.scene.tick(),
            missed: happened.missed,
            events: happened.events,
        };
        let encoded = |events: &TickEvents| {
            let mut bytes = Vec::new();
            ServerMessage::TickEvents(events.clone()).encode(&mut bytes);
            Bytes::from(bytes)
        };
        let shared = encoded(&events);
        for (peer, member) in &mut self.members {
            if out.is_behind(*peer) {
                member.missed_events += happened.missed + events.events.len() as u64;
            } else if member.missed_events == 0 {
                out.send_encoded(*peer, &shared);
            } else {
                events.missed = happened.missed + std::mem::take(&mut member.missed_events);
                out.send_encoded(*peer, &encoded(&events));
            }
        }
    }

    pub(crate) fn inspect(&mut self, peer: Peer, out: &mut Outbox) {
        let times = self.times.summary();
        let Some(stream) = self.stream_of(peer) else {
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
        out.send(peer, &ServerMessage::Inspection(inspection));
    }
}
