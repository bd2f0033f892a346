//! Events of the session as JSON, in the words of `rhumb.d.ts`.

use rhumb_protocol::Ending;
use rhumb_protocol::message::{Inspection, QueryResult, RemovalCause, TierChangeCause};
use rhumb_protocol::scene::{Answer, BodyEvent, Contact};
use rhumb_protocol::session::{CloseCode, Event, TransportCode};
use rhumb_reckoning::BodyId;
use serde_json::Value;

use crate::argument::id_number;
use crate::failure::denial_code;
use crate::object::object;
use crate::scene_json::{stream, vector};

/// An event; `None` for one that the binding itself has handled.
pub(crate) fn event(event: &Event) -> Option<Value> {
    Some(match event {
        Event::Welcomed(_) | Event::Created | Event::ClockSeen { .. } => return None,
        Event::Joined(_) => object!({"kind": "joined"}),
        Event::Inspected(inspected) => {
            object!({"kind": "inspected", "inspection": inspection(inspected)})
        }
        Event::SubscriptionChanged(choice) => {
            object!({"kind": "subscriptionChanged", "stream": stream(*choice)})
        }
        Event::TierChanged { to, cause } => object!({
            "kind": "tierChanged", "to": stream(*to),
            "cause": match cause {
                TierChangeCause::LinkCongested => "linkCongested",
                TierChangeCause::LinkRecovered => "linkRecovered",
            }
        }),
        Event::Left => object!({"kind": "left"}),
        Event::Deleted => object!({"kind": "deleted"}),
        Event::Reserved(_) => object!({"kind": "reserved"}),
        Event::Denied(denial) => object!({
            "kind": "denied", "denial": denial_code(*denial), "message": denial.to_string()
        }),
        Event::Applied { through, tick } => {
            object!({"kind": "applied", "through": *through, "tick": tick.value()})
        }
        Event::Refused { number, error } => {
            object!({"kind": "refused", "number": *number, "message": error.to_string()})
        }
        Event::Interrupted(by) => object!({"kind": "interrupted", "message": sentence(*by)}),
        Event::Resumed(_) => object!({"kind": "resumed"}),
        Event::SessionLost(_) => object!({"kind": "sessionLost"}),
        Event::Durable { commands, tick } => {
            object!({"kind": "durable", "commands": *commands, "tick": tick.value()})
        }
        Event::BodyPlaced(id) => object!({"kind": "bodyPlaced", "id": id_number(*id)}),
        Event::BodyRemoved { id, cause } => object!({
            "kind": "bodyRemoved", "id": id_number(*id),
            "cause": match cause {
                RemovalCause::Command => "command",
                RemovalCause::LeftWorld => "leftWorld",
                RemovalCause::NotFinite => "notFinite",
            }
        }),
        Event::ChecksumMismatch => object!({"kind": "checksumMismatch"}),
        Event::SceneFaulted { tick, .. } => object!({"kind": "sceneFaulted", "tick": tick.value()}),
        Event::PublisherSilent { id, since } => {
            object!({"kind": "publisherSilent", "body": id_number(*id), "since": since.value()})
        }
        Event::PublisherActive { id, tick } => {
            object!({"kind": "publisherActive", "body": id_number(*id), "tick": tick.value()})
        }
        Event::SceneRestored(tick) => object!({"kind": "sceneRestored", "tick": tick.value()}),
        Event::AuthorityGrant(bodies) => authority_grant(bodies),
        Event::AuthorityDenied(error) => {
            object!({"kind": "authorityDenied", "message": error.to_string()})
        }
        Event::QueryResult(result) => query_result(result),
        Event::Body { tick, event } => {
            let mut json = body_event(event);
            json["tick"] = tick.value().into();
            json
        }
        Event::EventsMissed { tick, count } => {
            object!({"kind": "eventsMissed", "tick": tick.value(), "count": *count})
        }
        Event::Ended(ending) => ended(*ending),
    })
}

fn authority_grant(bodies: &[BodyId]) -> Value {
    let bodies: Vec<_> = bodies.iter().map(|id| id_number(*id)).collect();
    object!({"kind": "authorityGrant", "bodies": bodies})
}

fn ended(ending: Ending) -> Value {
    let close_code = match ending {
        Ending::Closed(code) => Some(code),
        Ending::TimedOut | Ending::Broken => None,
    };
    object!({
        "kind": "ended", "code": ending_code(ending), "message": sentence(ending),
        "closeCode": close_code
    })
}

const fn ending_code(ending: Ending) -> &'static str {
    match ending {
        Ending::Closed(_) => "closed",
        Ending::TimedOut | Ending::Broken => "broken",
    }
}

/// The end of a connection in words.
pub(crate) fn sentence(ending: Ending) -> String {
    match ending {
        Ending::Closed(code @ TransportCode::FIRST..) => {
            format!("the connection was closed: {}", TransportCode(code))
        }
        Ending::Closed(code) => format!("the connection was closed: {}", CloseCode(code)),
        Ending::TimedOut => "the connection timed out".to_owned(),
        Ending::Broken => "the connection broke".to_owned(),
    }
}

fn contact(contact: &Contact) -> Value {
    object!({
        "with": id_number(contact.with), "point": vector(contact.point),
        "normal": vector(contact.normal), "separation": contact.separation,
        "force": contact.force
    })
}

fn body_event(event: &BodyEvent) -> Value {
    match event {
        BodyEvent::ContactBegan { body, contact: at } => {
            object!({"kind": "contactBegan", "body": id_number(*body), "contact": contact(at)})
        }
        BodyEvent::ContactForce { body, contact: at } => {
            object!({"kind": "contactForce", "body": id_number(*body), "contact": contact(at)})
        }
        BodyEvent::ContactEnded { body, with } => object!({
            "kind": "contactEnded", "body": id_number(*body), "with": id_number(*with)
        }),
        BodyEvent::SensorEntered { sensor, body } => object!({
            "kind": "sensorEntered", "sensor": id_number(*sensor), "body": id_number(*body)
        }),
        BodyEvent::SensorLeft { sensor, body } => object!({
            "kind": "sensorLeft", "sensor": id_number(*sensor), "body": id_number(*body)
        }),
        BodyEvent::FellAsleep(body) => object!({"kind": "fellAsleep", "body": id_number(*body)}),
        BodyEvent::Woke(body) => object!({"kind": "woke", "body": id_number(*body)}),
        BodyEvent::Fault(body) => object!({"kind": "bodyFault", "body": id_number(*body)}),
        BodyEvent::ReachedGround(body) => {
            object!({"kind": "reachedGround", "body": id_number(*body)})
        }
        BodyEvent::LeftGround(body) => object!({"kind": "leftGround", "body": id_number(*body)}),
    }
}

fn query_result(result: &QueryResult) -> Value {
    let (number, tick) = (result.number, result.tick.value());
    let answers = match &result.answers {
        Ok(answers) => answers,
        Err(error) => {
            let message = error.to_string();
            return object!({"kind": "queryFailed", "number": number, "tick": tick, "message": message});
        }
    };
    let answer = |answer: &Answer| -> Vec<Value> {
        match answer {
            Answer::Hits(hits) => {
                let hit = |hit: &rhumb_protocol::scene::Hit| {
                    object!({
                        "body": id_number(hit.body), "distance": hit.distance,
                        "point": vector(hit.point), "normal": vector(hit.normal)
                    })
                };
                hits.iter().map(hit).collect()
            }
            Answer::Bodies(bodies) => {
                let body = |id: &BodyId| object!({"body": id_number(*id)});
                bodies.iter().map(body).collect()
            }
        }
    };
    let answers: Vec<_> = answers.iter().map(answer).collect();
    object!({"kind": "queryResult", "number": number, "tick": tick, "answers": answers})
}

fn inspection(inspection: &Inspection) -> Value {
    object!({
        "tick": inspection.tick.value(), "bodies": inspection.bodies, "awake": inspection.awake,
        "updates": inspection.updates, "packets": inspection.packets,
        "packetBytes": inspection.packet_bytes, "mismatches": inspection.mismatches,
        "overBudget": inspection.over_budget,
        "stepMedian": inspection.times.step_median, "stepP99": inspection.times.step_p99
    })
}
