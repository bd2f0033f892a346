//! Rhumb's own scene file: JSON, read and written.
//!
//! `docs/book/src/how-to/scene-files.md` describes it. Fields that no version has are noted. A text that is refused is searched
//! for the first field of a body, a joint or the scene that cannot be read alone. Invariant: what is written reads back as the
//! same scene, to the bit.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{BODIES_MAX, JOINTS_MAX};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, BodyKind, CollisionGroups, Compound, Edges, Heights, Hull, Invalid,
    LockedAxes, Mass, Material, Mesh, Part, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds,
};
use rhumb_reckoning::{BodyId, Damping, ToleranceScale};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Error, Value, json};

use crate::assemble::{LoadedBody, LoadedScene, rate};
use crate::json_joints::{SceneFileJoint, identity, is_false};
use crate::model::LoadOptions;
use crate::report::{Effect, LoadError, Place, Problem, Report};

/// Newest version of the format.
const VERSION: u32 = 1;

/// A scene as JSON: metres, seconds, kilograms; rotations are quaternions x, y, z, w; y points up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SceneFile {
    /// Version of the format: one.
    pub version: u32,
    /// Its name.
    pub scene: String,
    /// Seed of the script that placed its bodies.
    pub seed: u64,
    /// m/s².
    pub gravity: [f32; 3],
    /// Duration of a tick, seconds.
    pub step_s: f64,
    /// Steps of the engine in a tick.
    pub substeps: u32,
    /// Friction of bodies that have none of their own.
    pub friction: f32,
    /// Restitution of bodies that have none of their own.
    pub restitution: f32,
    /// kg/m³ of bodies that have none of their own.
    pub density: f32,
    /// 1/s.
    pub linear_damping: f32,
    /// 1/s.
    pub angular_damping: f32,
    /// Of bodies that have none of their own.
    #[serde(skip_serializing_if = "is_default")]
    pub sleep: SceneFileSleep,
    /// The bodies.
    pub bodies: Vec<SceneFileBody>,
    /// The joints.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<SceneFileJoint>,
    /// Fields that no version has.
    #[serde(flatten)]
    pub other: BTreeMap<String, Value>,
}

impl Default for SceneFile {
    fn default() -> Self {
        Self::without_bodies(&SceneConfig::default())
    }
}

/// A body and its start. Its pose is that of its centre of mass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFileBody {
    /// Its name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// The body is placed before the step that follows this tick.
    #[serde(default)]
    pub tick: u64,
    /// True if the engine moves it.
    pub dynamic: bool,
    /// True if its member moves it; neither is a fixed one.
    #[serde(default, skip_serializing_if = "is_false")]
    pub kinematic: bool,
    /// Its shape.
    pub shape: SceneFileShape,
    /// Metres.
    pub position: [f32; 3],
    /// Body → world.
    #[serde(default = "identity")]
    pub rotation: [f32; 4],
    /// m/s.
    #[serde(default)]
    pub linear: [f32; 3],
    /// rad/s about world axes.
    #[serde(default)]
    pub angular: [f32; 3],
    /// kg, in place of volume times density.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass: Option<f32>,
    /// kg·m² about its axes, in place of those of its shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moments: Option<[f32; 3]>,
    /// Friction, restitution and density (kg/m³), in place of the scene's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<[f32; 3]>,
    /// Linear and angular damping, 1/s, in place of the scene's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<[f32; 2]>,
    /// Factor on gravity.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub gravity_scale: f32,
    /// Bits of its groups, and of those that it touches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<[u32; 2]>,
    /// Bits of world axes along (1, 2, 4) or about (8, 16, 32) which it does not move.
    #[serde(default, skip_serializing_if = "is_default")]
    pub locked_axes: u8,
    /// Power of two on the tolerance of its copies, -3 to 3.
    #[serde(default, skip_serializing_if = "is_default")]
    pub tolerance_exponent: i8,
    /// Of two touching bodies the one of lower dominance gives way.
    #[serde(default, skip_serializing_if = "is_default")]
    pub dominance: i8,
    /// True if bodies pass through it.
    #[serde(default, skip_serializing_if = "is_false")]
    pub sensor: bool,
    /// True if it is swept against moving bodies.
    #[serde(default, skip_serializing_if = "is_false")]
    pub swept: bool,
    /// True if its axis of spin wanders.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub gyroscopic: bool,
    /// False if it does not take part in the scene.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub enabled: bool,
    /// When it falls asleep, in place of the scene's conditions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sleep: Option<SceneFileSleep>,
    /// Fields that no version has.
    #[serde(flatten)]
    pub other: BTreeMap<String, Value>,
}

/// Conditions under which a body falls asleep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SceneFileSleep {
    /// Once it has settled.
    #[default]
    Settled,
    /// Never by itself.
    Never,
    /// Once it is slow: m/s of its fastest point, rad/s, seconds.
    Below([f32; 3]),
}

impl SceneFileSleep {
    const fn load(self) -> Sleep {
        match self {
            Self::Settled => Sleep::Settled,
            Self::Never => Sleep::Never,
            Self::Below([speed, angular_speed, seconds]) => Sleep::Below(SleepThresholds {
                speed,
                angular_speed,
                seconds,
            }),
        }
    }

    const fn of(sleep: Sleep) -> Self {
        match sleep {
            Sleep::Settled => Self::Settled,
            Sleep::Never => Self::Never,
            Sleep::Below(own) => Self::Below([own.speed, own.angular_speed, own.seconds]),
        }
    }
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

const fn yes() -> bool {
    true
}

fn is_yes(value: &bool) -> bool {
    *value
}

const fn one() -> f32 {
    1.0
}

fn is_one(value: &f32) -> bool {
    value.to_bits() == 1.0_f32.to_bits()
}

/// A shape, from the centre of mass of its body; long axes along y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[expect(missing_docs, reason = "the fields are those of the protocol's shapes")]
pub enum SceneFileShape {
    /// A sphere.
    Ball { radius: f32 },
    /// A box.
    Cuboid { half_extents: [f32; 3] },
    /// A capsule along y.
    Capsule { half_height: f32, radius: f32 },
    /// A cylinder along y.
    Cylinder { half_height: f32, radius: f32 },
    /// A cone with its tip along y.
    Cone { half_height: f32, radius: f32 },
    /// A box with round edges.
    RoundedCuboid { half_extents: [f32; 3], radius: f32 },
    /// The convex hull of points.
    Hull { points: Vec<[f32; 3]> },
    /// Triangles, for fixed bodies.
    Mesh {
        points: Vec<[f32; 3]>,
        triangles: Vec<[u32; 3]>,
        #[serde(default, skip_serializing_if = "is_false")]
        plain_edges: bool,
    },
    /// Heights row by row, as many in each row, for fixed bodies.
    Heights {
        rows: u32,
        row_spacing: f32,
        column_spacing: f32,
        heights: Vec<f32>,
        #[serde(default, skip_serializing_if = "is_false")]
        plain_edges: bool,
    },
    /// Everything behind a plane, for fixed bodies.
    HalfSpace { normal: [f32; 3] },
    /// Several shapes as one.
    Compound { parts: Vec<SceneFilePart> },
}

/// A part of a compound.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFilePart {
    /// Metres, in the body's axes.
    pub position: [f32; 3],
    /// Part → body.
    #[serde(default = "identity")]
    pub rotation: [f32; 4],
    /// Its shape; no compound.
    pub shape: SceneFileShape,
}

impl SceneFile {
    /// The scene that it says. `path`: of errors and notes.
    pub(crate) fn load(&self, path: &str, options: &LoadOptions) -> Result<LoadedScene, LoadError> {
        let place = Place::of(path);
        let wrong = |problem| LoadError {
            place: place.clone(),
            problem,
        };
        if self.version == 0 || self.version > VERSION {
            return Err(wrong(Problem::Unsupported(
                "a version above 1 of the JSON scene",
            )));
        }
        let counts = [
            ("bodies", self.bodies.len(), BODIES_MAX),
            ("joints", self.joints.len(), JOINTS_MAX),
        ];
        for (what, found, most) in counts {
            let most = most as usize;
            if found > most {
                return Err(wrong(Problem::TooMany { what, found, most }));
            }
        }
        let mut report = Report::default();
        note(&self.other, "the scene", &place, &mut report);
        let config = self.config().ok_or_else(|| {
            let name = format!("step_s {} and substeps {}", self.step_s, self.substeps);
            let rule = "a step is a whole part of a second or of some seconds, of 1 to 16 substeps";
            wrong(Problem::Senseless { name, rule })
        })?;
        let refused = |name: String, invalid| {
            let invalid = Box::new(invalid);
            wrong(Problem::Refused { name, invalid })
        };
        config
            .check()
            .map_err(|invalid| refused("the scene".to_owned(), invalid))?;
        let mut scene = LoadedScene {
            name: self.scene.clone(),
            config,
            bodies: Vec::with_capacity(self.bodies.len()),
            joints: Vec::with_capacity(self.joints.len()),
            report: Report::default(),
        };
        for (number, body) in self.bodies.iter().enumerate() {
            let name = title("body", number, &body.name);
            note(&body.other, &name, &place, &mut report);
            let body = body.load(&name, options).map_err(&wrong)?;
            scene.bodies.push(body);
        }
        for (number, joint) in self.joints.iter().enumerate() {
            let name = title("joint", number, &joint.name);
            note(&joint.other, &name, &place, &mut report);
            if joint.bodies.iter().any(|place| *place >= self.bodies.len()) {
                let name = format!("{:?} of {name}", joint.bodies);
                return Err(wrong(Problem::UnknownName { what: "body", name }));
            }
            let loaded = joint.load(&name).map_err(&wrong)?;
            if let [first, second] = joint.bodies
                && first == second
            {
                let body = title("body", first, &self.bodies[first].name);
                let name = format!("{name} of {body} with itself");
                let rule = "bodies are the places of two different bodies in the list, from zero";
                return Err(wrong(Problem::Senseless { name, rule }));
            }
            scene.joints.push(loaded);
        }
        scene.report = report;
        Ok(scene)
    }

    fn config(&self) -> Option<SceneConfig> {
        let mut config = SceneConfig {
            gravity: Vec3::from_array(self.gravity),
            material: Material {
                friction: self.friction,
                restitution: self.restitution,
                density: self.density,
            },
            damping: Damping {
                linear: self.linear_damping,
                angular: self.angular_damping,
            },
            sleep: self.sleep.load(),
            ..SceneConfig::default()
        };
        config.integrator.rate = rate(self.step_s)?;
        config.integrator.substeps = std::num::NonZeroU32::new(self.substeps)?;
        Some(config)
    }

    /// A scene as a file.
    #[must_use]
    pub fn of(scene: &LoadedScene) -> Self {
        Self {
            scene: scene.name.clone(),
            bodies: scene.bodies.iter().map(SceneFileBody::of).collect(),
            joints: scene.joints.iter().map(SceneFileJoint::of).collect(),
            ..Self::without_bodies(&scene.config)
        }
    }

    fn without_bodies(config: &SceneConfig) -> Self {
        Self {
            version: VERSION,
            scene: "scene".to_owned(),
            seed: 0,
            gravity: config.gravity.to_array(),
            step_s: config.integrator.rate.step().seconds(),
            substeps: config.integrator.substeps.get(),
            friction: config.material.friction,
            restitution: config.material.restitution,
            density: config.material.density,
            linear_damping: config.damping.linear,
            angular_damping: config.damping.angular,
            sleep: SceneFileSleep::of(config.sleep),
            bodies: Vec::new(),
            joints: Vec::new(),
            other: BTreeMap::new(),
        }
    }
}

pub(crate) fn title(what: &str, number: usize, name: &str) -> String {
    match name.is_empty() {
        true => format!("{what} {number}"),
        false => format!("{what} {number} \"{name}\""),
    }
}

/// Notes fields that no version has.
fn note(other: &BTreeMap<String, Value>, of: &str, place: &Place, report: &mut Report) {
    for (name, value) in other {
        let why = "no version of the format has this field";
        let value: String = value.to_string().chars().take(60).collect();
        report.add(place, format!("{name} of {of}"), value, Effect::Left, why);
    }
}

/// A rule that a part of a file breaks.
fn senseless(name: &str, rule: &'static str) -> Problem {
    Problem::Senseless {
        name: name.to_owned(),
        rule,
    }
}

impl SceneFileBody {
    fn load(&self, name: &str, options: &LoadOptions) -> Result<LoadedBody, Problem> {
        let refused = |invalid| Problem::Refused {
            name: name.to_owned(),
            invalid: Box::new(invalid),
        };
        // A zero that is moved by nothing would lose its sign.
        let is_turned = options.rotation != Quat::IDENTITY;
        let turned = |at: [f32; 3]| match (is_turned, Vec3::from_array(at)) {
            (true, at) => options.rotation * at,
            (false, at) => at,
        };
        let place = |at: [f32; 3]| match options.position == Vec3::ZERO {
            true => turned(at),
            false => options.position + turned(at),
        };
        let builder = BodyBuilder::of(self.desc(name)?, self.shape.load().map_err(refused)?);
        let rotation = match is_turned {
            true => options.rotation * Quat::from_array(self.rotation),
            false => Quat::from_array(self.rotation),
        };
        let builder = builder.position(place(self.position)).rotation(rotation);
        let builder = builder.linear_velocity(turned(self.linear));
        let builder = builder.angular_velocity(turned(self.angular));
        builder.check().map_err(refused)?;
        if self.dynamic && !builder.shape().is_solid() {
            return Err(senseless(
                name,
                "dynamic is true, and its shape has no volume: mesh, heights, half_space and a compound with one of them \
                 are for bodies with \"dynamic\": false; the hull of the points of a mesh has volume",
            ));
        }
        if let Some(centre) = builder.off_centre() {
            return Err(Problem::OffCentre {
                name: name.to_owned(),
                centre: centre.to_array(),
            });
        }
        Ok(LoadedBody {
            name: self.name.clone(),
            builder,
            tick: self.tick,
            frame_position: Vec3::ZERO,
            frame_rotation: Quat::IDENTITY,
        })
    }

    /// All but its shape and motion.
    fn desc(&self, name: &str) -> Result<BodyDesc, Problem> {
        let kind = match (self.kinematic, self.dynamic) {
            (true, true) => {
                return Err(senseless(
                    name,
                    "dynamic and kinematic are both true: the engine or a member moves a body, so leave one out",
                ));
            }
            (true, false) => BodyKind::Kinematic,
            (false, true) => BodyKind::Dynamic,
            (false, false) => BodyKind::Fixed,
        };
        let mut desc = BodyDesc::plain(BodyId::new(0, 0), kind, ShapeId(0));
        desc.material = self
            .material
            .map(|[friction, restitution, density]| Material {
                friction,
                restitution,
                density,
            });
        desc.damping = self
            .damping
            .map(|[linear, angular]| Damping { linear, angular });
        desc.gravity_scale = self.gravity_scale;
        let moments = self.moments.map(Vec3::from_array);
        if self.mass.is_none() && moments.is_some() {
            return Err(senseless(
                name,
                "moments without mass: give both, or neither, for those of the shape",
            ));
        }
        desc.mass = self.mass.map(|mass| Mass { mass, moments });
        if let Some([members, touches]) = self.groups {
            desc.groups = CollisionGroups { members, touches };
        }
        desc.locked = LockedAxes::new(self.locked_axes)
            .ok_or_else(|| senseless(name, "locked_axes are bits 0 to 5: 63 at most"))?;
        desc.tolerance_scale = ToleranceScale::new(self.tolerance_exponent)
            .ok_or_else(|| senseless(name, "tolerance_exponent is -3 to 3"))?;
        desc.dominance = self.dominance;
        (desc.sensor, desc.swept) = (self.sensor, self.swept);
        (desc.gyroscopic, desc.enabled) = (self.gyroscopic, self.enabled);
        desc.sleep = self.sleep.map(SceneFileSleep::load);
        Ok(desc)
    }

    fn of(body: &LoadedBody) -> Self {
        let desc = body.builder.desc(BodyId::new(0, 0), ShapeId(0));
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = (body.builder.state())
            .expect("a loaded body was checked")
            .parts();
        let groups = desc.groups;
        Self {
            name: body.name.clone(),
            tick: body.tick,
            dynamic: desc.kind == BodyKind::Dynamic,
            kinematic: desc.kind == BodyKind::Kinematic,
            shape: SceneFileShape::of(body.builder.shape()),
            position: [px, py, pz],
            rotation: [x, y, z, w],
            linear: [vx, vy, vz],
            angular: [wx, wy, wz],
            mass: desc.mass.map(|mass| mass.mass),
            moments: desc
                .mass
                .and_then(|mass| mass.moments)
                .map(|at| at.to_array()),
            material: (desc.material).map(|own| [own.friction, own.restitution, own.density]),
            damping: desc.damping.map(|own| [own.linear, own.angular]),
            gravity_scale: desc.gravity_scale,
            groups: (groups != CollisionGroups::ALL).then_some([groups.members, groups.touches]),
            locked_axes: desc.locked.bits(),
            tolerance_exponent: desc.tolerance_scale.exponent(),
            dominance: desc.dominance,
            sensor: desc.sensor,
            swept: desc.swept,
            gyroscopic: desc.gyroscopic,
            enabled: desc.enabled,
            sleep: desc.sleep.map(SceneFileSleep::of),
            other: BTreeMap::new(),
        }
    }
}

impl SceneFileShape {
    fn load(&self) -> Result<Shape, Invalid> {
        let points = |points: &[[f32; 3]]| -> Vec<_> {
            points.iter().map(|at| Vec3::from_array(*at)).collect()
        };
        Ok(match *self {
            Self::Ball { radius } => Shape::ball(radius),
            Self::Cuboid { half_extents } => Shape::Cuboid {
                half_extents: Vec3::from_array(half_extents),
            },
            Self::Capsule {
                half_height,
                radius,
            } => Shape::capsule(half_height, radius),
            Self::Cylinder {
                half_height,
                radius,
            } => Shape::cylinder(half_height, radius),
            Self::Cone {
                half_height,
                radius,
            } => Shape::cone(half_height, radius),
            Self::RoundedCuboid {
                half_extents,
                radius,
            } => Shape::RoundedCuboid {
                half_extents: Vec3::from_array(half_extents),
                radius,
            },
            Self::Hull { points: ref own } => Shape::Hull(Hull::new(&points(own))?),
            Self::Mesh {
                points: ref own,
                ref triangles,
                plain_edges,
            } => Shape::Mesh(Mesh::new(&points(own), triangles)?.with_edges(edges(plain_edges))),
            Self::Heights {
                rows,
                row_spacing,
                column_spacing,
                ref heights,
                plain_edges,
            } => {
                let heights = Heights::new(rows, row_spacing, column_spacing, heights)?;
                Shape::Heights(heights.with_edges(edges(plain_edges)))
            }
            Self::HalfSpace { normal } => Shape::HalfSpace {
                normal: Vec3::from_array(normal),
            },
            Self::Compound { ref parts } => {
                let part = |part: &SceneFilePart| -> Result<_, Invalid> {
                    Ok(Part {
                        position: Vec3::from_array(part.position),
                        rotation: Quat::from_array(part.rotation),
                        shape: part.shape.load()?,
                    })
                };
                let parts: Result<_, _> = parts.iter().map(part).collect();
                Shape::Compound(Compound::new(parts?)?)
            }
        })
    }

    /// A shape as the file has it.
    #[must_use]
    pub fn of(shape: &Shape) -> Self {
        match shape {
            Shape::Ball { radius } => Self::Ball { radius: *radius },
            Shape::Cuboid { half_extents } => Self::Cuboid {
                half_extents: half_extents.to_array(),
            },
            &Shape::Capsule {
                half_height,
                radius,
            } => Self::Capsule {
                half_height,
                radius,
            },
            &Shape::Cylinder {
                half_height,
                radius,
            } => Self::Cylinder {
                half_height,
                radius,
            },
            &Shape::Cone {
                half_height,
                radius,
            } => Self::Cone {
                half_height,
                radius,
            },
            Shape::RoundedCuboid {
                half_extents,
                radius,
            } => Self::RoundedCuboid {
                half_extents: half_extents.to_array(),
                radius: *radius,
            },
            Shape::Hull(hull) => Self::Hull {
                points: hull.points().iter().map(Vec3::to_array).collect(),
            },
            Shape::Mesh(mesh) => Self::Mesh {
                points: mesh.points().iter().map(Vec3::to_array).collect(),
                triangles: mesh.triangles().to_vec(),
                plain_edges: mesh.edges() == Edges::Plain,
            },
            Shape::Heights(heights) => Self::Heights {
                rows: heights.rows(),
                row_spacing: heights.row_spacing(),
                column_spacing: heights.column_spacing(),
                heights: heights.heights().to_vec(),
                plain_edges: heights.edges() == Edges::Plain,
            },
            Shape::HalfSpace { normal } => Self::HalfSpace {
                normal: normal.to_array(),
            },
            Shape::Compound(compound) => {
                let part = |part: &Part| SceneFilePart {
                    position: part.position.to_array(),
                    rotation: part.rotation.to_array(),
                    shape: Self::of(&part.shape),
                };
                let parts = compound.parts().iter().map(part).collect();
                Self::Compound { parts }
            }
        }
    }
}

const fn edges(plain: bool) -> Edges {
    match plain {
        true => Edges::Plain,
        false => Edges::Smooth,
    }
}

/// Reads a text.
pub(crate) fn read(path: &str, text: &str) -> Result<SceneFile, LoadError> {
    let text = text.trim_start_matches('\u{feff}');
    serde_json::from_str(text).map_err(|error| LoadError {
        place: Place {
            file: path.to_owned(),
            line: u32::try_from(error.line()).ok(),
        },
        problem: problem(text, &error),
    })
}

/// The problem of a text that is no scene. `error`: that of reading it whole.
fn problem(text: &str, error: &Error) -> Problem {
    let Ok(whole) = serde_json::from_str::<Value>(text) else {
        return Problem::Syntax(error.to_string());
    };
    let frame = json!({"position": [0, 0, 0]});
    let body = json!({"dynamic": false, "shape": {"ball": {"radius": 1}}, "position": [0, 0, 0]});
    let joint = json!({"bodies": [0, 1], "kind": "fixed", "frames": [frame, frame]});
    let found = of_list::<SceneFileBody>(&whole, ["bodies", "body"], &body)
        .or_else(|| of_list::<SceneFileJoint>(&whole, ["joints", "joint"], &joint))
        .or_else(|| of_fields::<SceneFile>(&whole, &json!({}), "the scene"));
    let (name, cause) = found.unwrap_or_else(|| ("the scene".to_owned(), error.to_string()));
    let cause = plain(&cause);
    Problem::WrongField { name, cause }
}

/// The first wrong field of the things in a list, and its cause. `right`: such a thing with all that it needs.
fn of_list<T: DeserializeOwned>(
    whole: &Value,
    [list, what]: [&str; 2],
    right: &Value,
) -> Option<(String, String)> {
    let all = whole.get(list)?.as_array()?;
    all.iter().enumerate().find_map(|(number, one)| {
        let error = serde_json::from_value::<T>(one.clone()).err()?;
        let name = one.get("name").and_then(Value::as_str);
        let name = title(what, number, name.unwrap_or_default());
        of_fields::<T>(one, right, &name).or_else(|| Some((name, error.to_string())))
    })
}

/// The first field that is wrong, whatever the others are.
fn of_fields<T: DeserializeOwned>(
    one: &Value,
    right: &Value,
    name: &str,
) -> Option<(String, String)> {
    one.as_object()?.iter().find_map(|(field, value)| {
        let mut with = right.as_object()?.clone();
        with.insert(field.clone(), value.clone());
        let error = serde_json::from_value::<T>(Value::Object(with)).err()?;
        Some((format!("{field} of {name}"), error.to_string()))
    })
}

/// A sentence of the parser without the names of types.
fn plain(cause: &str) -> String {
    let word = |word: &str| {
        let bare = word.trim_end_matches([',', '.']);
        let end = &word[bare.len()..];
        let said = match bare {
            "u8" => "a whole number from 0 to 255",
            "u32" | "u64" | "usize" => "a whole number from zero",
            "i8" => "a whole number from -128 to 127",
            "f32" | "f64" => "a number",
            "sequence" => "list",
            "map" => "object",
            "variant" => "word",
            "struct" | "enum" => return None,
            name if name.starts_with("SceneFile") => "an object",
            other => other,
        };
        Some(format!("{said}{end}"))
    };
    let words: Vec<_> = cause.split(' ').filter_map(word).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests;
