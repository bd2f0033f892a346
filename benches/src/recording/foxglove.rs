//! Poses of bodies in MCAP files of Foxglove and ROS 2.
//!
//! Of a scene each solid of an entity is a body. An entity stays until it is deleted, or until its lifetime is over. A
//! primitive that is no solid, or of a shape that is not kept, is a sentence of the recording.

use std::collections::{BTreeMap, BTreeSet};

use foxglove::messages::{
    CylinderPrimitive, FrameTransform, FrameTransforms, Pose, PoseInFrame, PosesInFrame,
    Quaternion, SceneEntity, SceneUpdate, Timestamp, Vector3,
};
use glam::{DQuat, DVec3, Vec3};
use prost::Message;
use rhumb_protocol::scene::Shape;
use rhumb_trace::{FileContents, StoredChannel, StoredMessage};

use super::error::{Place, RecordingError, RowDefect};
use super::options::ReadOptions;
use super::poses::{TimedPose, TimedPoses};
use super::recorded::Recording;
use super::ros2;
use super::ros2::{Refusal, Statics};
use super::stays::{Removal, RemovalCause, Removed};

/// Kinds of poses, by the schemas of their messages. A file with several kinds has the first of them read.
const KINDS: [Kind; 6] = [
    Kind {
        name: "transforms",
        encoding: PROTOBUF,
        schemas: &["foxglove.FrameTransforms", "foxglove.FrameTransform"],
    },
    Kind {
        name: "poses",
        encoding: PROTOBUF,
        schemas: &["foxglove.PosesInFrame", "foxglove.PoseInFrame"],
    },
    Kind {
        name: "scene",
        encoding: PROTOBUF,
        schemas: &["foxglove.SceneUpdate"],
    },
    Kind {
        name: "tf",
        encoding: CDR,
        schemas: &[ros2::TRANSFORMS],
    },
    Kind {
        name: "odometry",
        encoding: CDR,
        schemas: &[ros2::ODOMETRY],
    },
    Kind {
        name: "stamped",
        encoding: CDR,
        schemas: &[ros2::POSE],
    },
];

/// A kind of poses.
struct Kind {
    /// Its name as a load.
    name: &'static str,
    encoding: &'static str,
    schemas: &'static [&'static str],
}

const PROTOBUF: &str = "protobuf";
const CDR: &str = "cdr";

impl Kind {
    fn has(&self, channel: &StoredChannel) -> bool {
        channel.encoding == self.encoding && self.schemas.contains(&channel.schema.as_str())
    }
}

/// Reads the poses of a file.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    outline: &FileContents,
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    let is_there = |kind: &&Kind| outline.channels.values().any(|channel| kind.has(channel));
    let kinds: Vec<&Kind> = KINDS.iter().filter(is_there).collect();
    let names: Vec<String> = kinds.iter().map(|kind| kind.name.to_owned()).collect();
    if names.is_empty() {
        let found = outline.channels.values().map(|channel| {
            let StoredChannel {
                topic,
                schema,
                encoding,
            } = channel;
            format!("{topic} of {encoding} {schema}")
        });
        return Err(RecordingError::NoPoses {
            found: found.collect(),
        });
    }
    let chosen = options.choose(&names)?;
    let kind = kinds.iter().find(|kind| kind.name == chosen);
    let contents =
        FileContents::read(bytes, &|channel| kind.is_some_and(|kind| kind.has(channel)))?;
    let mut poses = TimedPoses::default();
    let mut statics = Statics::default();
    let mut scene = Scene::default();
    for message in &contents.messages {
        let Some(channel) = contents.channels.get(&message.channel) else {
            continue;
        };
        let mut source = Source {
            poses: &mut poses,
            scene: &mut scene,
            topic: &channel.topic,
            message,
        };
        if channel.encoding == CDR {
            source.take_cdr(&channel.schema, &mut statics)?;
            continue;
        }
        let taken = source.take(&channel.schema);
        taken.map_err(|cause| RecordingError::Message {
            topic: channel.topic.clone(),
            log_ns: message.log_ns,
            cause,
        })??;
    }
    let hung = statics.add_to(&mut poses);
    hung.map_err(|refusal| refused(refusal, Place::Whole))?;
    scene.add_to(&mut poses);
    let mut recording = poses.recording(name, options)?;
    if names.len() > 1 && options.load.is_none() {
        let all = names.join(", ");
        recording.notes.push(format!(
            "of the loads {all} this is {chosen}; --load NAME chooses another"
        ));
    }
    Ok(recording)
}

/// A message, and the poses so far.
struct Source<'a> {
    poses: &'a mut TimedPoses,
    scene: &'a mut Scene,
    topic: &'a str,
    message: &'a StoredMessage,
}

fn refused(refusal: Refusal, place: Place) -> RecordingError {
    match refusal {
        Refusal::Cdr(cause) => RecordingError::Cdr { place, cause },
        Refusal::Row(defect) => RecordingError::Row { place, defect },
        Refusal::Bodies(many) => many.at(place),
    }
}

impl Source<'_> {
    fn take_cdr(&mut self, schema: &str, statics: &mut Statics) -> Result<(), RecordingError> {
        let place = self.place();
        let bytes = &self.message.bytes;
        let taken = ros2::take(schema, bytes, &place, self.topic, (self.poses, statics));
        taken.map_err(|refusal| refused(refusal, place))
    }

    /// The number of a body, which is added if it is new.
    fn body(&mut self, name: &str, parent: Option<&str>) -> Result<usize, RecordingError> {
        let place = self.place();
        self.poses.body(name, parent).map_err(|many| many.at(place))
    }

    fn take(&mut self, schema: &str) -> Result<Result<(), RecordingError>, prost::DecodeError> {
        let bytes = &*self.message.bytes;
        Ok(match schema {
            "foxglove.FrameTransforms" => {
                let transforms = FrameTransforms::decode(bytes)?.transforms;
                transforms
                    .iter()
                    .try_for_each(|transform| self.transform(transform))
            }
            "foxglove.FrameTransform" => self.transform(&FrameTransform::decode(bytes)?),
            "foxglove.PoseInFrame" => {
                let message = PoseInFrame::decode(bytes)?;
                self.poses.of_frame(&message.frame_id);
                let at_ns = self.moment(message.timestamp);
                self.body(self.topic, None).map(|body| {
                    self.pose(at_ns, body, message.pose.unwrap_or_default());
                })
            }
            "foxglove.PosesInFrame" => {
                let message = PosesInFrame::decode(bytes)?;
                self.poses.of_frame(&message.frame_id);
                let at_ns = self.moment(message.timestamp);
                let topic = self.topic;
                let mut poses = message.poses.into_iter().enumerate();
                poses.try_for_each(|(number, pose)| {
                    let body = self.body(&format!("{topic}/{number}"), None)?;
                    self.pose(at_ns, body, pose);
                    Ok(())
                })
            }
            _ => self.scene(SceneUpdate::decode(bytes)?),
        })
    }

    /// The moment that a message states, or its log time.
    fn moment(&self, stated: Option<Timestamp>) -> i64 {
        let ns = stated.map_or(self.message.log_ns, |stated| stated.total_nanos());
        i64::try_from(ns).unwrap_or(i64::MAX)
    }

    fn place(&self) -> Place {
        Place::Message {
            topic: self.topic.to_owned(),
            log_ns: self.message.log_ns,
        }
    }

    fn transform(&mut self, transform: &FrameTransform) -> Result<(), RecordingError> {
        let at_ns = self.moment(transform.timestamp);
        let (child, parent) = (&transform.child_frame_id, &transform.parent_frame_id);
        let body = self.body(child, Some(parent))?;
        if self.poses.bodies[body].parent.as_ref() != Some(parent) {
            return Err(RecordingError::Row {
                place: self.place(),
                defect: RowDefect::Parent {
                    frame: child.clone(),
                },
            });
        }
        let pose = Pose {
            position: transform.translation,
            orientation: transform.rotation,
        };
        self.pose(at_ns, body, pose);
        Ok(())
    }

    fn pose(&mut self, at_ns: i64, body: usize, pose: Pose) {
        let Vector3 { x, y, z } = pose.position.unwrap_or_default();
        let position = DVec3::new(x, y, z);
        let place = self.place();
        self.poses.poses.push(TimedPose {
            at_ns,
            body,
            position,
            rotation: rotation(pose.orientation),
            velocity: None,
            place,
        });
    }

    /// The first primitive of an entity is its body; each further one is a body of its own.
    fn scene(&mut self, update: SceneUpdate) -> Result<(), RecordingError> {
        self.poses.persist = true;
        for deletion in update.deletions {
            let at_ns = self.moment(deletion.timestamp);
            let of = match deletion.r#type {
                1 => Some(Removed::All),
                _ => {
                    let group = self.scene.entities.get(&deletion.id);
                    group.map(|group| Removed::Group(*group))
                }
            };
            self.poses.removals.extend(of.map(|of| Removal {
                at_ns,
                of,
                cause: RemovalCause::Deleted,
            }));
        }
        for entity in update.entities {
            let at_ns = self.moment(entity.timestamp);
            let group = self.scene.group(&entity, at_ns);
            self.poses.of_frame(&entity.frame_id);
            let solids = solids(&entity);
            self.replace(group, solids.len(), at_ns);
            for (number, solid) in solids.into_iter().enumerate() {
                let Some((pose, shape)) = solid else {
                    self.scene.left_out.insert(NO_POSE);
                    continue;
                };
                let body = self.solid(&entity.id, group, number)?;
                let known = self.poses.bodies[body]
                    .shape
                    .get_or_insert_with(|| shape.clone());
                if *known != shape {
                    self.scene.left_out.insert(OTHER_SHAPE);
                }
                self.pose(at_ns, body, pose);
            }
        }
        Ok(())
    }

    /// An entity replaces what it was: further bodies than it has now are gone.
    fn replace(&mut self, group: usize, count: usize, at_ns: i64) {
        let before = std::mem::replace(&mut self.scene.counts[group], count);
        let gone = (count..before).filter_map(|number| self.scene.bodies.get(&(group, number)));
        self.poses.removals.extend(gone.map(|body| Removal {
            at_ns,
            of: Removed::Body(*body),
            cause: RemovalCause::Deleted,
        }));
    }

    /// The number of the body of a primitive.
    fn solid(
        &mut self,
        entity: &str,
        group: usize,
        number: usize,
    ) -> Result<usize, RecordingError> {
        if let Some(body) = self.scene.bodies.get(&(group, number)) {
            return Ok(*body);
        }
        let name = match number {
            0 => entity.to_owned(),
            _ => format!("{entity}#{number}"),
        };
        let place = self.place();
        let body = self
            .poses
            .new_body(&name, None)
            .map_err(|many| many.at(place))?;
        self.poses.bodies[body].group = Some(group);
        self.scene.bodies.insert((group, number), body);
        Ok(body)
    }
}

/// Primitives that are left out.
const NO_POSE: &str = "cubes, spheres and cylinders without a pose or a size are left out";
/// Shapes that change.
const OTHER_SHAPE: &str = "bodies change their shape or size: the first one counts";
/// Spheres that are none.
const ELLIPSOID: &str = "an ellipsoid counts as a ball of its longest half axis";
/// Cylinders that are none.
const CONE: &str =
    "a cylinder with scaled faces, or of no circle, counts as the round one around it";

/// The entities of a file: their groups, bodies and lifetimes.
#[derive(Default)]
struct Scene {
    /// The groups of entities, by their ids.
    entities: BTreeMap<String, usize>,
    /// Bodies, by group and number of the primitive.
    bodies: BTreeMap<(usize, usize), usize>,
    /// Solids of each group, as it was said last.
    counts: Vec<usize>,
    /// By group: the moments of its poses and how long those stay, nanoseconds; zero for ever.
    lifetimes: Vec<Vec<(i64, i64)>>,
    left_out: BTreeSet<&'static str>,
    /// Primitives that are no solids, by their names.
    primitives: BTreeSet<&'static str>,
}

impl Scene {
    /// The group of an entity, whose facts are taken.
    fn group(&mut self, entity: &SceneEntity, at_ns: i64) -> usize {
        let group = match self.entities.get(&entity.id) {
            Some(group) => *group,
            None => {
                self.entities
                    .insert(entity.id.clone(), self.lifetimes.len());
                self.lifetimes.push(Vec::new());
                self.counts.push(0);
                self.lifetimes.len() - 1
            }
        };
        let lasts = entity.lifetime.map_or(0, |lifetime| {
            i64::from(lifetime.sec()) * 1_000_000_000 + i64::from(lifetime.nsec())
        });
        self.lifetimes[group].push((at_ns, lasts));
        let kinds = [
            ("arrows", entity.arrows.len()),
            ("lines", entity.lines.len()),
            ("models", entity.models.len()),
            ("texts", entity.texts.len()),
            ("triangles", entity.triangles.len()),
        ];
        let there = kinds.into_iter().filter(|(_, count)| *count > 0);
        self.primitives.extend(there.map(|(name, _)| name));
        let is_ball = |size: Vector3| size.x == size.y && size.y == size.z;
        let mut sizes = entity.spheres.iter().filter_map(|sphere| sphere.size);
        if sizes.any(|size| !is_ball(size)) {
            self.left_out.insert(ELLIPSOID);
        }
        let is_whole = |cylinder: &CylinderPrimitive| {
            let scales = (cylinder.bottom_scale, cylinder.top_scale);
            // Scales that are not stated are zero.
            let is_straight = scales == (1.0, 1.0) || scales == (0.0, 0.0);
            is_straight && cylinder.size.is_none_or(|size| size.x == size.y)
        };
        if !entity.cylinders.iter().all(is_whole) {
            self.left_out.insert(CONE);
        }
        group
    }

    /// Adds the ends of lifetimes, and sentences.
    fn add_to(self, poses: &mut TimedPoses) {
        for (group, mut said) in self.lifetimes.into_iter().enumerate() {
            said.sort_unstable();
            for (place, (at_ns, lasts)) in said.iter().enumerate() {
                let end = at_ns.saturating_add(*lasts);
                let next = said.get(place + 1);
                if *lasts > 0 && next.is_none_or(|(next, _)| *next > end) {
                    poses.removals.push(Removal {
                        at_ns: end,
                        of: Removed::Group(group),
                        cause: RemovalCause::Expired,
                    });
                }
            }
        }
        if !self.primitives.is_empty() {
            let names: Vec<&str> = self.primitives.into_iter().collect();
            poses.left_out.push(format!(
                "of entities cubes, spheres and cylinders are bodies: {} are left out",
                names.join(", ")
            ));
        }
        poses
            .left_out
            .extend(self.left_out.into_iter().map(str::to_owned));
    }
}

fn rotation(stated: Option<Quaternion>) -> DQuat {
    // A message without a rotation is unturned; one with zeros has a defect.
    stated.map_or(DQuat::IDENTITY, |q| DQuat::from_xyzw(q.x, q.y, q.z, q.w))
}

/// The solids of an entity; none for one without a pose or a size.
fn solids(entity: &SceneEntity) -> Vec<Option<(Pose, Shape)>> {
    let half = |size: Option<Vector3>| {
        let Vector3 { x, y, z } = size.unwrap_or_default();
        Vec3::new(x as f32, y as f32, z as f32).abs() / 2.0
    };
    let cubes = entity.cubes.iter().map(|cube| {
        let half_extents = half(cube.size);
        (cube.pose, Shape::Cuboid { half_extents })
    });
    let spheres = entity.spheres.iter().map(|sphere| {
        let radius = half(sphere.size).max_element();
        (sphere.pose, Shape::Ball { radius })
    });
    let cylinders = entity.cylinders.iter().map(|cylinder| {
        let half = half(cylinder.size);
        let pose = cylinder.pose.map(|pose| {
            // Foxglove's cylinders stand along z, ours along y.
            let turned =
                rotation(pose.orientation) * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
            let [x, y, z, w] = turned.to_array();
            Pose {
                orientation: Some(Quaternion { x, y, z, w }),
                ..pose
            }
        });
        let shape = Shape::Cylinder {
            half_height: half.z,
            radius: half.x.max(half.y),
        };
        (pose, shape)
    });
    let all = cubes.chain(spheres).chain(cylinders);
    all.map(|(pose, shape)| Some((pose?, shape)).filter(|(_, shape)| shape.check().is_ok()))
        .collect()
}
