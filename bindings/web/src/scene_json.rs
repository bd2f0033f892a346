//! Parts of a scene, and events, as JSON in the words of `rhumb.d.ts`.

use glam::{Quat, Vec3};
use rhumb_protocol::Ending;
use rhumb_protocol::message::{
    FaultCause, Inspection, QueryResult, RemovalCause, StreamChoice, TierChangeCause,
};
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, Cell, CollisionGroups, Contact, Edges, Joint,
    JointFrame, JointKind, JointLimits, LockedAxes, Mass, Material, SceneConfig, Shape, Sleep,
    Stepping,
};
use rhumb_protocol::session::{CellState, CloseCode, Event, TransportCode};
use rhumb_reckoning::{
    Anchor, BodyId, Damping, Motion, Predictor, Tolerance, ToleranceScale, Track,
};
use serde_json::Value;

use crate::argument::{denial_code, id_number, object};

pub(crate) fn vector(vector: Vec3) -> Value {
    vector.to_array().into()
}

fn rotation(rotation: Quat) -> Value {
    rotation.to_array().into()
}

fn points(points: &[Vec3]) -> Vec<f32> {
    points.iter().flat_map(Vec3::to_array).collect()
}

pub(crate) fn taken_cell(cell: Cell, state: CellState) -> Value {
    let (state, denial) = match state {
        CellState::Awaited => ("awaited", None),
        CellState::Shown => ("shown", None),
        CellState::Denied(denial) => ("denied", Some(denial_code(denial))),
    };
    object!({"cell": cell.0, "state": state, "denial": denial})
}

pub(crate) fn shape(shape: &Shape) -> Value {
    match *shape {
        Shape::Ball { radius } => object!({"kind": "ball", "radius": radius}),
        Shape::Cuboid { half_extents } => {
            object!({"kind": "cuboid", "halfExtents": vector(half_extents)})
        }
        Shape::RoundedCuboid {
            half_extents,
            radius,
        } => object!({
            "kind": "roundedCuboid", "halfExtents": vector(half_extents), "radius": radius
        }),
        Shape::Capsule {
            half_height,
            radius,
        } => object!({"kind": "capsule", "halfHeight": half_height, "radius": radius}),
        Shape::Cylinder {
            half_height,
            radius,
        } => object!({"kind": "cylinder", "halfHeight": half_height, "radius": radius}),
        Shape::Cone {
            half_height,
            radius,
        } => object!({"kind": "cone", "halfHeight": half_height, "radius": radius}),
        Shape::HalfSpace { normal } => object!({"kind": "halfSpace", "normal": vector(normal)}),
        Shape::Hull(ref hull) => object!({"kind": "hull", "points": points(hull.points())}),
        Shape::Heights(ref heights) => object!({
            "kind": "heights", "rows": heights.rows(), "columns": heights.columns(),
            "rowSpacing": heights.row_spacing(), "columnSpacing": heights.column_spacing(),
            "edges": edges(heights.edges()), "heights": heights.heights()
        }),
        Shape::Mesh(ref mesh) => object!({
            "kind": "mesh", "edges": edges(mesh.edges()), "points": points(mesh.points()),
            "triangles": mesh.triangles().as_flattened()
        }),
        Shape::Compound(ref compound) => {
            let part = |part: &rhumb_protocol::scene::Part| {
                object!({
                    "position": vector(part.position), "rotation": rotation(part.rotation),
                    "shape": self::shape(&part.shape)
                })
            };
            let parts: Value = compound.parts().iter().map(part).collect();
            object!({"kind": "compound", "parts": parts})
        }
    }
}

const fn edges(edges: Edges) -> &'static str {
    match edges {
        Edges::Plain => "plain",
        Edges::Smooth => "smooth",
    }
}

const fn kind_name(kind: BodyKind) -> &'static str {
    match kind {
        BodyKind::Fixed => "fixed",
        BodyKind::Dynamic => "dynamic",
        BodyKind::Kinematic => "kinematic",
    }
}

/// A body's description; what has its default is left out.
pub(crate) fn body(desc: &BodyDesc) -> Value {
    object!({
        "id": id_number(desc.id),
        "kind": kind_name(desc.kind),
        "shape": desc.shape.0,
        "material": desc.material.map(material),
        "damping": desc.damping.map(damping),
        "gravityScale": (desc.gravity_scale != 1.0).then_some(desc.gravity_scale),
        "gyroscopic": (!desc.gyroscopic).then_some(false),
        "toleranceScale": (desc.tolerance_scale != ToleranceScale::USUAL)
            .then_some(desc.tolerance_scale.exponent()),
        "lockedAxes": (desc.locked != LockedAxes::NONE).then_some(desc.locked.bits()),
        "mass": desc.mass.map(mass),
        "groups": (desc.groups != CollisionGroups::ALL).then(|| groups(desc.groups)),
        "dominance": (desc.dominance != 0).then_some(desc.dominance),
        "sensor": desc.sensor.then_some(true),
        "swept": desc.swept.then_some(true),
        "sleep": desc.sleep.map(sleep),
        "enabled": (!desc.enabled).then_some(false),
    })
}

fn material(material: Material) -> Value {
    object!({
        "friction": material.friction, "restitution": material.restitution,
        "density": material.density
    })
}

fn damping(damping: Damping) -> Value {
    object!({"linear": damping.linear, "angular": damping.angular})
}

fn mass(mass: Mass) -> Value {
    object!({"mass": mass.mass, "moments": mass.moments.map(vector)})
}

fn groups(groups: CollisionGroups) -> Value {
    object!({"members": groups.members, "touches": groups.touches})
}

fn sleep(sleep: Sleep) -> Value {
    match sleep {
        Sleep::Settled => "settled".into(),
        Sleep::Never => "never".into(),
        Sleep::Below(thresholds) => object!({
            "speed": thresholds.speed, "angularSpeed": thresholds.angular_speed,
            "seconds": thresholds.seconds
        }),
    }
}

pub(crate) fn config(config: &SceneConfig) -> Value {
    let rate = config.integrator.rate;
    object!({
        "stepping": match config.stepping {
            Stepping::Lockstep => "lockstep",
            Stepping::FreeRunning => "freeRunning",
        },
        "rate": object!({"ticks": rate.ticks(), "seconds": rate.seconds()}),
        "step": rate.step().seconds(),
        "substeps": config.integrator.substeps.get(),
        "gravity": vector(config.gravity),
        "material": material(config.material),
        "damping": damping(config.damping),
        "sleep": sleep(config.sleep),
        "publishInterval": config.publish_schedule.publish_interval.get(),
        "lookahead": config.publish_schedule.lookahead.count(),
    })
}

pub(crate) fn tolerance(tolerance: Tolerance) -> Value {
    match tolerance {
        Tolerance::Surface(length) => length.metres().metres().into(),
        Tolerance::Parts { position, turn } => object!({
            "position": position.metres().metres(), "turn": turn.radians().radians()
        }),
    }
}

pub(crate) fn stream(choice: StreamChoice) -> Value {
    match choice {
        StreamChoice::Full => "full".into(),
        StreamChoice::Changed => "changed".into(),
        StreamChoice::Within(within) => object!({"within": tolerance(within)}),
        StreamChoice::Capped {
            tolerance: within,
            budget,
        } => object!({
            "within": tolerance(within),
            "budget": object!({
                "bytesPerSecond": budget.bytes_per_second(), "burst": budget.burst()
            })
        }),
    }
}

/// A track and its state, which is widened to doubles without loss.
pub(crate) fn track(track: &Track, state: &Motion) -> Value {
    let (predictor, acceleration) = match track.predictor {
        Predictor::Rest => ("rest", None),
        Predictor::Uniform => ("uniform", None),
        Predictor::Ballistic => ("ballistic", None),
        Predictor::TorqueFree => ("torqueFree", None),
        Predictor::BallisticTorqueFree => ("ballisticTorqueFree", None),
        Predictor::Accelerated(by) => ("accelerated", Some(by.acceleration().to_array())),
    };
    let (pose, twist) = (state.pose(), state.twist());
    object!({
        "origin": track.origin.value(),
        "predictor": predictor,
        "acceleration": acceleration,
        "exact": matches!(track.anchor, Anchor::Exact(_)),
        "state": object!({
            "position": pose.position.to_array(),
            "rotation": pose.rotation.to_array(),
            "linearVelocity": twist.linear.to_array(),
            "angularVelocity": twist.angular.to_array(),
        }),
        "parent": track.parent.map(id_number),
    })
}

fn limits(limits: JointLimits) -> Value {
    object!({"least": limits.least, "most": limits.most})
}

fn frame(frame: &JointFrame) -> Value {
    object!({"anchor": vector(frame.anchor), "rotation": rotation(frame.rotation)})
}

pub(crate) fn joint(joint: &Joint) -> Value {
    let mut json = match joint.kind {
        JointKind::Fixed => object!({"kind": "fixed"}),
        JointKind::Spherical(of_joint) => object!({
            "kind": "spherical", "limits": of_joint.map(|each| each.map(limits))
        }),
        JointKind::Revolute(of_joint) => {
            object!({"kind": "revolute", "limits": of_joint.map(limits)})
        }
        JointKind::Prismatic(of_joint) => {
            object!({"kind": "prismatic", "limits": of_joint.map(limits)})
        }
        JointKind::Rope(length) => object!({"kind": "rope", "length": length}),
        JointKind::Spring(spring) => object!({
            "kind": "spring", "length": spring.length, "stiffness": spring.stiffness,
            "damping": spring.damping
        }),
        JointKind::Generic(locked, of_joint) => object!({
            "kind": "generic", "lockedAxes": locked.bits(),
            "limits": of_joint.map(|each| each.map(limits))
        }),
    };
    json["bodies"] = joint.bodies.map(id_number).into();
    json["frames"] = joint.frames.each_ref().map(frame).into();
    json["collide"] = joint.collide.into();
    let motors = joint.motors.map(|motor| {
        motor.map(|motor| {
            object!({
                "position": motor.position, "velocity": motor.velocity,
                "stiffness": motor.stiffness, "damping": motor.damping, "force": motor.force
            })
        })
    });
    if motors.iter().any(Option::is_some) {
        json["motors"] = motors.into();
    }
    if let Some(strength) = joint.strength {
        json["strength"] = object!({"force": strength.force, "torque": strength.torque});
    }
    json
}

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
            "cause": tier_change_cause(*cause)
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
            "cause": removal_cause(*cause)
        }),
        Event::ChecksumMismatch => object!({"kind": "checksumMismatch"}),
        Event::SceneFaulted { tick, cause } => object!({
            "kind": "sceneFaulted", "tick": tick.value(),
            "cause": fault_cause(*cause)
        }),
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
        Event::EventsMissed {
            tick,
            count,
            untold,
        } => object!({
            "kind": "eventsMissed", "tick": tick.value(), "count": *count, "untold": *untold
        }),
        Event::Ended(ending) => ended(*ending),
    })
}

const fn tier_change_cause(cause: TierChangeCause) -> &'static str {
    match cause {
        TierChangeCause::LinkCongested => "linkCongested",
        TierChangeCause::LinkRecovered => "linkRecovered",
    }
}

const fn removal_cause(cause: RemovalCause) -> &'static str {
    match cause {
        RemovalCause::Command => "command",
        RemovalCause::LeftWorld => "leftWorld",
        RemovalCause::NotFinite => "notFinite",
    }
}

const fn fault_cause(cause: FaultCause) -> &'static str {
    match cause {
        FaultCause::NoWayBack => "noWayBack",
        FaultCause::FailedAgain => "failedAgain",
        FaultCause::TooOften => "tooOften",
    }
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
