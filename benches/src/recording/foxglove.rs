//! Poses of bodies in MCAP files of Foxglove and ROS 2.

use foxglove::messages::{
    FrameTransform, FrameTransforms, Pose, PoseInFrame, PosesInFrame, Quaternion, SceneEntity,
    SceneUpdate, Timestamp, Vector3,
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
    for message in &contents.messages {
        let Some(channel) = contents.channels.get(&message.channel) else {
            continue;
        };
        let mut source = Source {
            poses: &mut poses,
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
                let at_ns = self.moment(message.timestamp);
                self.body(self.topic, None).map(|body| {
                    self.pose(at_ns, body, message.pose.unwrap_or_default());
                })
            }
            "foxglove.PosesInFrame" => {
                let message = PosesInFrame::decode(bytes)?;
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
            let bodies = self.poses.bodies.iter().enumerate();
            // All entities, or the one of this id.
            let is_meant = |name: &str| deletion.r#type == 1 || base(name) == deletion.id;
            let gone = bodies
                .filter(|(_, body)| is_meant(&body.name))
                .map(|(body, _)| (at_ns, body));
            let gone: Vec<_> = gone.collect();
            self.poses.removals.extend(gone);
        }
        for entity in update.entities {
            let at_ns = self.moment(entity.timestamp);
            for (number, (pose, shape)) in solids(&entity).into_iter().enumerate() {
                let name = if number == 0 {
                    entity.id.clone()
                } else {
                    format!("{}#{number}", entity.id)
                };
                let body = self.body(&name, None)?;
                self.poses.bodies[body].shape.get_or_insert(shape);
                self.pose(at_ns, body, pose);
            }
        }
        Ok(())
    }
}

/// The entity of a body's name.
fn base(name: &str) -> &str {
    name.split_once('#').map_or(name, |(entity, _)| entity)
}

fn rotation(stated: Option<Quaternion>) -> DQuat {
    // A message without a rotation is unturned; one with zeros has a defect.
    stated.map_or(DQuat::IDENTITY, |q| DQuat::from_xyzw(q.x, q.y, q.z, q.w))
}

/// The solids of an entity that has a size.
fn solids(entity: &SceneEntity) -> Vec<(Pose, Shape)> {
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
    let whole = all.filter_map(|(pose, shape)| Some((pose?, shape)));
    whole.filter(|(_, shape)| shape.check().is_ok()).collect()
}
