//! Answers to queries and inspections, and the events of bodies.
//!
//! All are work and bytes beside the stream: a scene that is late answers no queries, and a member that reads slowly
//! gets no events until it has caught up.

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{Inspection, QueryError, QueryResult, ServerMessage, TickEvents};
use rhumb_protocol::scene::{Answer, Query, Stepping};

use super::RunningScene;
use crate::clients::Clients;
use crate::event_monitor::StepEvents;

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

    /// Sends the events of a step to the members, encoded once.
    pub(super) fn send_step_events(&mut self, happened: StepEvents, clients: &mut Clients) {
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
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            if control.is_behind() {
                member.missed_events += happened.missed + events.events.len() as u64;
            } else if member.missed_events == 0 {
                control.send_encoded(&shared, out);
            } else {
                events.missed = happened.missed + std::mem::take(&mut member.missed_events);
                control.send_encoded(&encoded(&events), out);
            }
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
