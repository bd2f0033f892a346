//! Parts of a scene as JSON, in the words of `rhumb.d.ts`.

use glam::{Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Joint, JointFrame, JointKind, JointLimits, LockedAxes,
    Material, SceneConfig, Shape, Stepping,
};
use rhumb_reckoning::{Anchor, Damping, Motion, Predictor, Tolerance, ToleranceScale, Track};
use serde_json::{Map, Value, json};

use crate::argument::id_number;

pub(crate) fn vector(vector: Vec3) -> Value {
    json!(vector.to_array())
}

fn rotation(rotation: Quat) -> Value {
    json!(rotation.to_array())
}

fn points(points: &[Vec3]) -> Vec<f32> {
    points.iter().flat_map(Vec3::to_array).collect()
}

pub(crate) fn shape(shape: &Shape) -> Value {
    match shape {
        Shape::Ball { radius } => json!({"kind": "ball", "radius": radius}),
        Shape::Cuboid { half_extents } => {
            json!({"kind": "cuboid", "halfExtents": vector(*half_extents)})
        }
        Shape::RoundedCuboid {
            half_extents,
            radius,
        } => json!({
            "kind": "roundedCuboid", "halfExtents": vector(*half_extents), "radius": radius
        }),
        Shape::Capsule {
            half_height,
            radius,
        } => json!({"kind": "capsule", "halfHeight": half_height, "radius": radius}),
        Shape::Cylinder {
            half_height,
            radius,
        } => json!({"kind": "cylinder", "halfHeight": half_height, "radius": radius}),
        Shape::Cone {
            half_height,
            radius,
        } => json!({"kind": "cone", "halfHeight": half_height, "radius": radius}),
        Shape::HalfSpace { normal } => json!({"kind": "halfSpace", "normal": vector(*normal)}),
        Shape::Hull(hull) => json!({"kind": "hull", "points": points(hull.points())}),
        Shape::Heights(heights) => json!({
            "kind": "heights", "rows": heights.rows(), "columns": heights.columns(),
            "rowSpacing": heights.row_spacing(), "columnSpacing": heights.column_spacing(),
            "heights": heights.heights()
        }),
        Shape::Mesh(mesh) => json!({
            "kind": "mesh", "points": points(mesh.points()),
            "triangles": mesh.triangles().as_flattened()
        }),
        Shape::Compound(compound) => {
            let part = |part: &rhumb_protocol::scene::Part| {
                json!({
                    "position": vector(part.position), "rotation": rotation(part.rotation),
                    "shape": self::shape(&part.shape)
                })
            };
            let parts: Vec<_> = compound.parts().iter().map(part).collect();
            json!({"kind": "compound", "parts": parts})
        }
    }
}

const fn kind_name(kind: BodyKind) -> &'static str {
    match kind {
        BodyKind::Static => "static",
        BodyKind::Dynamic => "dynamic",
        BodyKind::Kinematic => "kinematic",
    }
}

/// A body's description; what has its default is left out.
pub(crate) fn body(desc: &BodyDesc) -> Value {
    let mut json = Map::new();
    let mut put = |name: &str, value: Value| drop(json.insert(name.to_owned(), value));
    put("id", json!(id_number(desc.id)));
    put("kind", json!(kind_name(desc.kind)));
    put("shape", json!(desc.shape.0));
    if let Some(of_body) = desc.material {
        put("material", material(of_body));
    }
    if let Some(of_body) = desc.damping {
        put("damping", damping(of_body));
    }
    if desc.gravity_scale != 1.0 {
        put("gravityScale", json!(desc.gravity_scale));
    }
    if !desc.gyroscopic {
        put("gyroscopic", json!(false));
    }
    if desc.tolerance_scale != ToleranceScale::USUAL {
        put("toleranceScale", json!(desc.tolerance_scale.exponent()));
    }
    if desc.locked != LockedAxes::NONE {
        put("lockedAxes", json!(desc.locked.bits()));
    }
    if let Some(mass) = desc.mass {
        let moments = mass.moments.map(vector);
        put("mass", json!({"mass": mass.mass, "moments": moments}));
    }
    if desc.groups != CollisionGroups::ALL {
        let CollisionGroups { members, touches } = desc.groups;
        put("groups", json!({"members": members, "touches": touches}));
    }
    if desc.dominance != 0 {
        put("dominance", json!(desc.dominance));
    }
    for (name, set) in [("sensor", desc.sensor), ("swept", desc.swept)] {
        if set {
            put(name, json!(true));
        }
    }
    if !desc.enabled {
        put("enabled", json!(false));
    }
    Value::Object(json)
}

fn material(material: Material) -> Value {
    json!({
        "friction": material.friction, "restitution": material.restitution,
        "density": material.density
    })
}

fn damping(damping: Damping) -> Value {
    json!({"linear": damping.linear, "angular": damping.angular})
}

pub(crate) fn config(config: &SceneConfig) -> Value {
    let rate = config.integrator.rate;
    let sleep = config
        .sleep
        .map(|sleep| json!({"speed": sleep.speed, "seconds": sleep.seconds}));
    json!({
        "stepping": match config.stepping {
            Stepping::Lockstep => "lockstep",
            Stepping::FreeRunning => "freeRunning",
        },
        "rate": {"ticks": rate.ticks(), "seconds": rate.seconds()},
        "step": rate.step().seconds(),
        "substeps": config.integrator.substeps,
        "gravity": vector(config.gravity),
        "material": material(config.material),
        "damping": damping(config.damping),
        "sleep": sleep,
        "publishInterval": config.publish_schedule.publish_interval,
        "lookahead": config.publish_schedule.lookahead.count(),
    })
}

pub(crate) fn tolerance(tolerance: Tolerance) -> Value {
    match tolerance {
        Tolerance::Surface(length) => json!(length.metres().metres()),
        Tolerance::Parts { position, turn } => json!({
            "position": position.metres().metres(), "turn": turn.radians().radians()
        }),
    }
}

pub(crate) fn stream(choice: StreamChoice) -> Value {
    match choice {
        StreamChoice::Full => json!("full"),
        StreamChoice::Within(within) => json!({"within": tolerance(within)}),
        StreamChoice::Capped {
            tolerance: within,
            budget,
        } => json!({
            "within": tolerance(within),
            "budget": {"bytesPerSecond": budget.bytes_per_second(), "burst": budget.burst()}
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
    json!({
        "origin": track.origin.value(),
        "predictor": predictor,
        "acceleration": acceleration,
        "exact": matches!(track.anchor, Anchor::Exact(_)),
        "state": {
            "position": pose.position.to_array(),
            "rotation": pose.rotation.to_array(),
            "linearVelocity": twist.linear.to_array(),
            "angularVelocity": twist.angular.to_array(),
        },
        "parent": track.parent.map(id_number),
    })
}

fn limits(limits: JointLimits) -> Value {
    json!({"least": limits.least, "most": limits.most})
}

fn frame(frame: &JointFrame) -> Value {
    json!({"anchor": vector(frame.anchor), "rotation": rotation(frame.rotation)})
}

pub(crate) fn joint(joint: &Joint) -> Value {
    let mut json = match joint.kind {
        JointKind::Fixed => json!({"kind": "fixed"}),
        JointKind::Spherical(of_joint) => json!({
            "kind": "spherical", "limits": of_joint.map(|each| each.map(limits))
        }),
        JointKind::Revolute(of_joint) => {
            json!({"kind": "revolute", "limits": of_joint.map(limits)})
        }
        JointKind::Prismatic(of_joint) => {
            json!({"kind": "prismatic", "limits": of_joint.map(limits)})
        }
        JointKind::Rope(length) => json!({"kind": "rope", "length": length}),
        JointKind::Spring(spring) => json!({
            "kind": "spring", "length": spring.length, "stiffness": spring.stiffness,
            "damping": spring.damping
        }),
        JointKind::Generic(locked, of_joint) => json!({
            "kind": "generic", "lockedAxes": locked.bits(),
            "limits": of_joint.map(|each| each.map(limits))
        }),
    };
    json["bodies"] = json!(joint.bodies.map(id_number));
    json["frames"] = json!(joint.frames.each_ref().map(frame));
    json["collide"] = json!(joint.collide);
    let motors = joint.motors.map(|motor| {
        motor.map(|motor| {
            json!({
                "position": motor.position, "velocity": motor.velocity,
                "stiffness": motor.stiffness, "damping": motor.damping, "force": motor.force
            })
        })
    });
    if motors.iter().any(Option::is_some) {
        json["motors"] = json!(motors);
    }
    if let Some(strength) = joint.strength {
        json["strength"] = json!({"force": strength.force, "torque": strength.torque});
    }
    json
}
