//! Events of the session as JSON, in the words of `rhumb.d.ts`.

use rhumb_protocol::Ending;
use rhumb_protocol::message::{Inspection, QueryResult, RemovalCause, TierChangeCause};
use rhumb_protocol::scene::{Answer, BodyEvent, Contact};
use rhumb_protocol::session::{CloseCode, Event, TransportCode};
use rhumb_reckoning::BodyId;
use serde_json::{Value, json};

use crate::argument::id_number;
use crate::failure::denial_code;
use crate::scene_json::{stream, vector};

/// An event; `None` for one that the binding itself has handled.
pub(crate) fn event(event: &Event) -> Option<Value> {
    Some(match event {
        Event::Welcomed(_) | Event::Created | Event::ClockSeen { .. } => return None,
        Event::Joined(_) => json!({"kind": "joined"}),
        Event::Inspected(inspected) => {
            json!({"kind": "inspected", "inspection": inspection(inspected)})
        }
        Event::SubscriptionChanged(choice) => {
            json!({"kind": "subscriptionChanged", "stream": stream(*choice)})
        }
        Event::TierChanged { to, cause } => json!({
            "kind": "tierChanged", "to": stream(*to),
            "cause": match cause {
                TierChangeCause::LinkCongested => "linkCongested",
                TierChangeCause::LinkRecovered => "linkRecovered",
            }
        }),
        Event::Left => json!({"kind": "left"}),
        Event::Deleted => json!({"kind": "deleted"}),
        Event::Reserved(_) => json!({"kind": "reserved"}),
        Event::Denied(denial) => json!({
            "kind": "denied", "denial": denial_code(*denial), "message": denial.to_string()
        }),
        Event::Applied { through, tick } => {
            json!({"kind": "applied", "through": through, "tick": tick.value()})
        }
        Event::Refused { number, error } => {
            json!({"kind": "refused", "number": number, "message": error.to_string()})
        }
        Event::Interrupted(by) => json!({"kind": "interrupted", "message": sentence(*by)}),
        Event::Resumed(_) => json!({"kind": "resumed"}),
        Event::SessionLost(_) => json!({"kind": "sessionLost"}),
        Event::Durable { commands, tick } => {
            json!({"kind": "durable", "commands": commands, "tick": tick.value()})
        }
        Event::BodyPlaced(id) => json!({"kind": "bodyPlaced", "id": id_number(*id)}),
        Event::BodyRemoved { id, cause } => json!({
            "kind": "bodyRemoved", "id": id_number(*id),
            "cause": match cause {
                RemovalCause::Command => "command",
                RemovalCause::LeftWorld => "leftWorld",
                RemovalCause::NotFinite => "notFinite",
            }
        }),
        Event::ChecksumMismatch => json!({"kind": "checksumMismatch"}),
        Event::SceneFaulted { tick, .. } => json!({"kind": "sceneFaulted", "tick": tick.value()}),
        Event::SceneRestored(tick) => json!({"kind": "sceneRestored", "tick": tick.value()}),
        Event::AuthorityGrant(bodies) => authority_grant(bodies),
        Event::AuthorityDenied(error) => {
            json!({"kind": "authorityDenied", "message": error.to_string()})
        }
        Event::QueryResult(result) => query_result(result),
        Event::Body { tick, event } => {
            let mut json = body_event(event);
            json["tick"] = json!(tick.value());
            json
        }
        Event::EventsMissed { tick, count } => {
            json!({"kind": "eventsMissed", "tick": tick.value(), "count": count})
        }
        Event::Ended(ending) => ended(*ending),
    })
}

fn authority_grant(bodies: &[BodyId]) -> Value {
    let bodies: Vec<_> = bodies.iter().map(|id| id_number(*id)).collect();
    json!({"kind": "authorityGrant", "bodies": bodies})
}

fn ended(ending: Ending) -> Value {
    let close_code = match ending {
        Ending::Closed(code) => Some(code),
        Ending::TimedOut | Ending::Broken => None,
    };
    json!({
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
    json!({
        "with": id_number(contact.with), "point": vector(contact.point),
        "normal": vector(contact.normal), "separation": contact.separation,
        "force": contact.force
    })
}

fn body_event(event: &BodyEvent) -> Value {
    match event {
        BodyEvent::ContactBegan { body, contact: at } => {
            json!({"kind": "contactBegan", "body": id_number(*body), "contact": contact(at)})
        }
        BodyEvent::ContactForce { body, contact: at } => {
            json!({"kind": "contactForce", "body": id_number(*body), "contact": contact(at)})
        }
        BodyEvent::ContactEnded { body, with } => json!({
            "kind": "contactEnded", "body": id_number(*body), "with": id_number(*with)
        }),
        BodyEvent::SensorEntered { sensor, body } => json!({
            "kind": "sensorEntered", "sensor": id_number(*sensor), "body": id_number(*body)
        }),
        BodyEvent::SensorLeft { sensor, body } => json!({
            "kind": "sensorLeft", "sensor": id_number(*sensor), "body": id_number(*body)
        }),
        BodyEvent::FellAsleep(body) => json!({"kind": "fellAsleep", "body": id_number(*body)}),
        BodyEvent::Woke(body) => json!({"kind": "woke", "body": id_number(*body)}),
        BodyEvent::Fault(body) => json!({"kind": "bodyFault", "body": id_number(*body)}),
        BodyEvent::ReachedGround(body) => {
            json!({"kind": "reachedGround", "body": id_number(*body)})
        }
        BodyEvent::LeftGround(body) => json!({"kind": "leftGround", "body": id_number(*body)}),
    }
}

fn query_result(result: &QueryResult) -> Value {
    let (number, tick) = (result.number, result.tick.value());
    let answers = match &result.answers {
        Ok(answers) => answers,
        Err(error) => {
            let message = error.to_string();
            return json!({"kind": "queryFailed", "number": number, "tick": tick, "message": message});
        }
    };
    let answer = |answer: &Answer| -> Vec<Value> {
        match answer {
            Answer::Hits(hits) => {
                let hit = |hit: &rhumb_protocol::scene::Hit| {
                    json!({
                        "body": id_number(hit.body), "distance": hit.distance,
                        "point": vector(hit.point), "normal": vector(hit.normal)
                    })
                };
                hits.iter().map(hit).collect()
            }
            Answer::Bodies(bodies) => {
                let body = |id: &BodyId| json!({"body": id_number(*id)});
                bodies.iter().map(body).collect()
            }
        }
    };
    let answers: Vec<_> = answers.iter().map(answer).collect();
    json!({"kind": "queryResult", "number": number, "tick": tick, "answers": answers})
}

fn inspection(inspection: &Inspection) -> Value {
    json!({
        "tick": inspection.tick.value(), "bodies": inspection.bodies, "awake": inspection.awake,
        "updates": inspection.updates, "packets": inspection.packets,
        "packetBytes": inspection.packet_bytes, "mismatches": inspection.mismatches,
        "overBudget": inspection.over_budget,
        "stepMedian": inspection.times.step_median, "stepP99": inspection.times.step_p99
    })
}
