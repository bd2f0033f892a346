//! Shapes, bodies, joints, commands, queries and joins, out of JSON.
//!
//! The words are those of `rhumb.d.ts`. Numbers are checked by the protocol when a command is queued.

use core::num::NonZeroU32;
use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{HITS_MAX, JOINTS_MAX, SHAPES_MAX};
use rhumb_protocol::message::{SessionKey, StreamChoice, TierPolicy};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, BodyKind, Cell, CellGrid, CollisionGroups, Command, Compound, Edges,
    Heights, Hull, Joint, JointFrame, JointId, JointKind, JointLimits, JointStrength, LockedAxes,
    Mass, Material, Mesh, Motor, Part, PublishSchedule, Query, QueryFilter, QueryKind, SceneConfig,
    Shape, ShapeId, Sleep, SleepThresholds, Spring, Stepping,
};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{
    BodyId, BodyState, Damping, Integrator, LengthBound, Metres, Radians, Rate, Ticks, Tolerance,
    ToleranceScale, TurnBound,
};
use rhumb_view::{InvalidTicks, JoinMode, ViewOptions};

use crate::argument::{Argument, Failure};
use crate::generated;

pub(crate) fn shape(from: &Argument<'_>) -> Result<Shape, Failure> {
    let number = |field| from.number_of(field);
    let half_extents = || from.vector_of("halfExtents");
    let kind = from.field("kind")?;
    Ok(match kind.text()? {
        "ball" => Shape::Ball {
            radius: number("radius")?,
        },
        "cuboid" => Shape::Cuboid {
            half_extents: half_extents()?,
        },
        "roundedCuboid" => Shape::RoundedCuboid {
            half_extents: half_extents()?,
            radius: number("radius")?,
        },
        "capsule" => Shape::capsule(number("halfHeight")?, number("radius")?),
        "cylinder" => Shape::cylinder(number("halfHeight")?, number("radius")?),
        "cone" => Shape::cone(number("halfHeight")?, number("radius")?),
        "halfSpace" => Shape::HalfSpace {
            normal: from.vector_of("normal")?,
        },
        "hull" => Shape::Hull(Hull::new(&points(from)?).map_err(|why| from.refused(why))?),
        "heights" => {
            let rows = from.field("rows")?.u32()?;
            let columns = from.field("columns")?.u32()?;
            let heights = from.field("heights")?.all_singles()?;
            if heights.len() as u64 != u64::from(rows) * u64::from(columns) {
                let count = heights.len();
                let why = format_args!("{count} heights are not {rows} rows of {columns} columns");
                return Err(from.refused(why));
            }
            let spacing = [number("rowSpacing")?, number("columnSpacing")?];
            let field = Heights::new(rows, spacing[0], spacing[1], &heights);
            let field = field.map_err(|why| from.refused(why))?;
            Shape::Heights(field.with_edges(edges(from)?))
        }
        "mesh" => {
            let mesh = Mesh::new(&points(from)?, &triangles(from)?);
            let mesh = mesh.map_err(|why| from.refused(why))?;
            Shape::Mesh(mesh.with_edges(edges(from)?))
        }
        "compound" => {
            let parts = from.field("parts")?;
            let parts = parts.items()?.map(|part| part_of(&part));
            let compound = Compound::new(parts.collect::<Result<_, _>>()?);
            Shape::Compound(compound.map_err(|why| from.refused(why))?)
        }
        _ => return Err(kind.wrong("a kind of shape")),
    })
}

/// The points of a hull or a mesh.
fn points(from: &Argument<'_>) -> Result<Vec<Vec3>, Failure> {
    let numbers = from.field("points")?.all_singles()?;
    let (points, rest) = numbers.as_chunks::<3>();
    if rest.is_empty() {
        Ok(points.iter().copied().map(Vec3::from_array).collect())
    } else {
        Err(from.wrong("a shape with three numbers for each point"))
    }
}

/// The triangles of a mesh, as numbers of its points.
fn triangles(from: &Argument<'_>) -> Result<Vec<[u32; 3]>, Failure> {
    let numbers = from.field("triangles")?;
    let numbers: Vec<u32> = numbers
        .items()?
        .map(|item| item.u32())
        .collect::<Result<_, _>>()?;
    let (triangles, rest) = numbers.as_chunks::<3>();
    if rest.is_empty() {
        Ok(triangles.to_vec())
    } else {
        Err(from.wrong("a mesh with three points for each triangle"))
    }
}

fn edges(from: &Argument<'_>) -> Result<Edges, Failure> {
    let Some(from) = from.optional("edges") else {
        return Ok(Edges::default());
    };
    match from.text()? {
        "plain" => Ok(Edges::Plain),
        "smooth" => Ok(Edges::Smooth),
        _ => Err(from.wrong("plain or smooth")),
    }
}

/// Conditions of sleep.
pub(crate) fn sleep(from: &Argument<'_>) -> Result<Sleep, Failure> {
    match from.as_text() {
        Some("settled") => Ok(Sleep::Settled),
        Some("never") => Ok(Sleep::Never),
        Some(_) => Err(from.wrong("settled, never, or an object of thresholds")),
        None => Ok(Sleep::Below(SleepThresholds {
            speed: from.number_of("speed")?,
            angular_speed: from.number_of("angularSpeed")?,
            seconds: from.number_of("seconds")?,
        })),
    }
}

fn part_of(from: &Argument<'_>) -> Result<Part, Failure> {
    Ok(Part {
        position: from.vector_of("position")?,
        rotation: from.field("rotation")?.rotation()?,
        shape: shape(&from.field("shape")?)?,
    })
}

/// The state of a body; what is left out is the identity or zero.
pub(crate) fn body_state(from: &Argument<'_>) -> Result<BodyState, Failure> {
    let vector = |field| from.optional(field).map(|field| field.singles());
    let position = vector("position").transpose()?.unwrap_or_default();
    let rotation = (from.optional("rotation")).map(|field| field.singles());
    let rotation = rotation.transpose()?.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let linear = vector("linearVelocity").transpose()?.unwrap_or_default();
    let angular = vector("angularVelocity").transpose()?.unwrap_or_default();
    BodyState::new(position, rotation, linear, angular).map_err(|why| from.refused(why))
}

/// A body to add.
pub(crate) fn body(from: &Argument<'_>) -> Result<BodyBuilder, Failure> {
    let desc = properties(from, BodyId::new(0, 0), ShapeId(0))?;
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = body_state(from)?.parts();
    Ok(BodyBuilder::of(desc, shape(&from.field("shape")?)?)
        .at(px, py, pz)
        .rotation(Quat::from_xyzw(x, y, z, w))
        .linear_velocity(Vec3::new(vx, vy, vz))
        .angular_velocity(Vec3::new(wx, wy, wz)))
}

fn shape_id(from: &Argument<'_>) -> Result<ShapeId, Failure> {
    Ok(ShapeId(from.whole(0, i64::from(SHAPES_MAX) - 1)? as u32))
}

fn desc(from: &Argument<'_>) -> Result<BodyDesc, Failure> {
    let shape = shape_id(&from.field("shape")?)?;
    properties(from, from.field("id")?.body()?, shape)
}

fn properties(from: &Argument<'_>, id: BodyId, shape: ShapeId) -> Result<BodyDesc, Failure> {
    let kind = from.field("kind")?;
    let kind = match kind.text()? {
        "fixed" => BodyKind::Fixed,
        "dynamic" => BodyKind::Dynamic,
        "kinematic" => BodyKind::Kinematic,
        _ => return Err(kind.wrong("fixed, dynamic or kinematic")),
    };
    let mut desc = BodyDesc::plain(id, kind, shape);
    if let Some(from) = from.optional("material") {
        desc.material = Some(material(&from)?);
    }
    if let Some(from) = from.optional("damping") {
        desc.damping = Some(damping(&from)?);
    }
    desc.gravity_scale = from.number_or("gravityScale", desc.gravity_scale)?;
    desc.gyroscopic = from.flag_or("gyroscopic", desc.gyroscopic)?;
    if let Some(from) = from.optional("toleranceScale") {
        let exponent = from.whole(-3, 3)? as i8;
        desc.tolerance_scale = ToleranceScale::new(exponent).unwrap_or_default();
    }
    if let Some(from) = from.optional("lockedAxes") {
        desc.locked = locked_axes(&from)?;
    }
    if let Some(from) = from.optional("mass") {
        let moments = from.optional("moments").map(|from| from.vector());
        desc.mass = Some(Mass {
            mass: from.number_of("mass")?,
            moments: moments.transpose()?,
        });
    }
    if let Some(from) = from.optional("groups") {
        desc.groups = CollisionGroups {
            members: from.field("members")?.u32()?,
            touches: from.field("touches")?.u32()?,
        };
    }
    if let Some(from) = from.optional("dominance") {
        desc.dominance = from.whole(i64::from(i8::MIN), i64::from(i8::MAX))? as i8;
    }
    if let Some(from) = from.optional("sleep") {
        desc.sleep = Some(sleep(&from)?);
    }
    desc.sensor = from.flag_or("sensor", desc.sensor)?;
    desc.swept = from.flag_or("swept", desc.swept)?;
    desc.enabled = from.flag_or("enabled", desc.enabled)?;
    Ok(desc)
}

fn locked_axes(from: &Argument<'_>) -> Result<LockedAxes, Failure> {
    let bits = from.whole(0, 0b11_1111)? as u8;
    LockedAxes::new(bits).ok_or_else(|| from.wrong("bits of six axes"))
}

pub(crate) fn material(from: &Argument<'_>) -> Result<Material, Failure> {
    Ok(Material {
        friction: from.number_of("friction")?,
        restitution: from.number_of("restitution")?,
        density: from.number_of("density")?,
    })
}

pub(crate) fn damping(from: &Argument<'_>) -> Result<Damping, Failure> {
    Ok(Damping {
        linear: from.number_of("linear")?,
        angular: from.number_of("angular")?,
    })
}

fn limits(from: &Argument<'_>) -> Result<JointLimits, Failure> {
    Ok(JointLimits {
        least: from.number_of("least")?,
        most: from.number_of("most")?,
    })
}

/// A list of as many elements, each of which may be null.
fn each<T, const N: usize>(
    from: &Argument<'_>,
    read: impl Fn(&Argument<'_>) -> Result<T, Failure>,
) -> Result<[Option<T>; N], Failure> {
    let items = from.items()?.map(|item| match item.is_null() {
        true => Ok(None),
        false => read(&item).map(Some),
    });
    let items: Vec<Option<T>> = items.collect::<Result<_, _>>()?;
    items
        .try_into()
        .map_err(|_| from.wrong(&format!("a list of {N} elements")))
}

fn joint_kind(from: &Argument<'_>) -> Result<JointKind, Failure> {
    let number = |field| from.number_of(field);
    let one = || {
        (from.optional("limits"))
            .map(|from| limits(&from))
            .transpose()
    };
    let kind = from.field("kind")?;
    Ok(match kind.text()? {
        "fixed" => JointKind::Fixed,
        "spherical" => JointKind::Spherical(match from.optional("limits") {
            None => None,
            Some(from) => match each(&from, limits)? {
                [Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => return Err(from.wrong("a list of three limits")),
            },
        }),
        "revolute" => JointKind::Revolute(one()?),
        "prismatic" => JointKind::Prismatic(one()?),
        "rope" => JointKind::Rope(number("length")?),
        "spring" => JointKind::Spring(Spring {
            length: number("length")?,
            stiffness: number("stiffness")?,
            damping: number("damping")?,
        }),
        "generic" => JointKind::Generic(
            locked_axes(&from.field("lockedAxes")?)?,
            each(&from.field("limits")?, limits)?,
        ),
        _ => return Err(kind.wrong("a kind of joint")),
    })
}

fn motor(from: &Argument<'_>) -> Result<Motor, Failure> {
    let number = |field| from.number_of(field);
    Ok(Motor {
        position: number("position")?,
        velocity: number("velocity")?,
        stiffness: number("stiffness")?,
        damping: number("damping")?,
        force: number("force")?,
    })
}

fn joint_frame(from: &Argument<'_>) -> Result<JointFrame, Failure> {
    Ok(JointFrame {
        anchor: from.vector_of("anchor")?,
        rotation: from.rotation_or("rotation", Quat::IDENTITY)?,
    })
}

fn body_id(from: &Argument<'_>) -> Result<BodyId, Failure> {
    from.body()
}

fn joint(from: &Argument<'_>) -> Result<Box<Joint>, Failure> {
    let (bodies, frames) = (from.field("bodies")?, from.field("frames")?);
    let [Some(first), Some(second)] = each(&bodies, body_id)? else {
        return Err(bodies.wrong("a list of two bodies"));
    };
    let [Some(of_first), Some(of_second)] = each(&frames, joint_frame)? else {
        return Err(frames.wrong("a list of two frames"));
    };
    let mut joint = Joint::plain(joint_kind(from)?, [first, second], [of_first, of_second]);
    joint.collide = from.flag_or("collide", joint.collide)?;
    if let Some(from) = from.optional("motors") {
        joint.motors = each(&from, motor)?;
    }
    if let Some(from) = from.optional("strength") {
        joint.strength = Some(JointStrength {
            force: from.number_of("force")?,
            torque: from.number_of("torque")?,
        });
    }
    Ok(Box::new(joint))
}

pub(crate) fn command(from: &Argument<'_>) -> Result<Command, Failure> {
    let kind = from.field("kind")?;
    let kind_text = kind.text()?;
    if let Some(made) = generated::command(from, kind_text)? {
        return Ok(made);
    }
    let shape_number = || from.field("id").and_then(|id| shape_id(&id));
    let joint_id = || {
        let id = from.field("id")?;
        Ok::<_, Failure>(JointId(id.whole(0, i64::from(JOINTS_MAX) - 1)? as u32))
    };
    let joint = || joint(&from.field("joint")?);
    Ok(match kind_text {
        "changeBody" => Command::ChangeBody {
            desc: desc(&from.field("desc")?)?,
        },
        "addShape" => Command::AddShape {
            id: shape_number()?,
            shape: shape(&from.field("shape")?)?,
        },
        "removeShape" => Command::RemoveShape {
            id: shape_number()?,
        },
        "addJoint" => Command::AddJoint {
            id: joint_id()?,
            joint: joint()?,
        },
        "changeJoint" => Command::ChangeJoint {
            id: joint_id()?,
            joint: joint()?,
        },
        "removeJoint" => Command::RemoveJoint { id: joint_id()? },
        _ => return Err(kind.wrong("a kind of command")),
    })
}

pub(crate) fn query(from: &Argument<'_>) -> Result<Query, Failure> {
    let vector = |field| from.vector_of(field);
    let cast = || {
        let rotation = from.rotation_or("rotation", Quat::IDENTITY)?;
        let shape = shape(&from.field("shape")?)?;
        Ok::<_, Failure>((shape, vector("position")?, rotation))
    };
    let kind = from.field("kind")?;
    let mut query = Query::ray(Vec3::ZERO, Vec3::ZERO);
    query.kind = match kind.text()? {
        "ray" => QueryKind::Ray {
            origin: vector("origin")?,
            translation: vector("translation")?,
        },
        "shapeCast" => {
            let (shape, position, rotation) = cast()?;
            QueryKind::ShapeCast {
                shape,
                position,
                rotation,
                translation: vector("translation")?,
            }
        }
        "projection" => QueryKind::Projection {
            point: vector("point")?,
            distance: from.number_of("distance")?,
        },
        "overlap" => {
            let (shape, position, rotation) = cast()?;
            QueryKind::Overlap {
                shape,
                position,
                rotation,
            }
        }
        "contacts" => {
            query.hits = HITS_MAX;
            QueryKind::Contacts {
                body: from.field("body")?.body()?,
            }
        }
        _ => return Err(kind.wrong("a kind of query")),
    };
    if let Some(from) = from.optional("hits") {
        query.hits = from.whole(1, i64::from(HITS_MAX))? as u8;
    }
    if let Some(from) = from.optional("filter") {
        query.filter = filter(&from)?;
    }
    Ok(query)
}

fn filter(from: &Argument<'_>) -> Result<QueryFilter, Failure> {
    let mut filter = QueryFilter::DEFAULT;
    filter.with_fixed = from.flag_or("withFixed", filter.with_fixed)?;
    filter.with_dynamic = from.flag_or("withDynamic", filter.with_dynamic)?;
    filter.with_kinematic = from.flag_or("withKinematic", filter.with_kinematic)?;
    filter.with_sensors = from.flag_or("withSensors", filter.with_sensors)?;
    filter.except = from
        .optional("except")
        .map(|from| from.body())
        .transpose()?;
    if let Some(from) = from.optional("groups") {
        filter.groups = from.u32()?;
    }
    Ok(filter)
}

/// Options of a join.
#[derive(Debug)]
pub(crate) struct JoinArguments {
    pub(crate) mode: JoinMode,
    pub(crate) stream: StreamChoice,
    /// True if the scene is taken by cells.
    pub(crate) cells: bool,
    pub(crate) view: ViewOptions,
    pub(crate) lead_ticks: f64,
}

impl JoinArguments {
    pub(crate) fn read(from: &Argument<'_>) -> Result<Self, Failure> {
        let number = |field| {
            let number = from.optional(field).map(|field| field.number());
            Ok::<_, Failure>(number.transpose()?.unwrap_or_default())
        };
        let ticks = |field| {
            let (ticks, given) = (number(field)?, from.optional(field));
            match (InvalidTicks::check_delay(ticks), given) {
                (Err(_), Some(given)) => Err(given.wrong("0 to 3600 ticks")),
                _ => Ok(ticks),
            }
        };
        let flag = |field| from.optional(field).map(|field| field.flag()).transpose();
        Ok(Self {
            mode: mode(from.optional("mode"))?,
            stream: match from.optional("stream") {
                None => StreamChoice::Within(Tolerance::NORMAL),
                Some(from) => stream(&from)?,
            },
            cells: flag("cells")?.unwrap_or_default(),
            view: ViewOptions {
                delay_ticks: ticks("delayTicks")?,
                whole_ticks: flag("wholeTicks")?.unwrap_or_default(),
                smooth: flag("smooth")?.unwrap_or(true),
            },
            lead_ticks: ticks("leadTicks")?,
        })
    }
}

/// Cells to take.
#[derive(Debug)]
pub(crate) enum CellArguments {
    /// Those around a point, by bands.
    Around(Vec3, Vec<(Metres, StreamChoice)>),
    These(BTreeMap<Cell, StreamChoice>),
}

impl CellArguments {
    pub(crate) fn read(from: &Argument<'_>) -> Result<Self, Failure> {
        let Some(cells) = from.optional("cells") else {
            let bands = from.field("bands")?.each(|band| {
                let radius = band.field("radius")?;
                let metres = radius.number()?;
                match (0.0..f64::INFINITY).contains(&metres) {
                    true => Ok((Metres::new(metres), stream(&band.field("stream")?)?)),
                    false => Err(radius.wrong("metres, 0 or more")),
                }
            });
            return Ok(Self::Around(from.vector_of("point")?, bands?));
        };
        let cells = cells.each(|chosen| {
            let places = chosen.field("cell")?;
            let wrong = || places.wrong("three whole numbers");
            let whole = |place: Argument<'_>| {
                let limit = i64::from(Cell::PLACE_MAX);
                place.whole(-limit, limit).map(|place| place as i32)
            };
            let each: Vec<i32> = places.items()?.map(whole).collect::<Result<_, _>>()?;
            let places = each.try_into().map_err(|_| wrong())?;
            Ok((Cell(places), stream(&chosen.field("stream")?)?))
        });
        Ok(Self::These(cells?.into_iter().collect()))
    }

    /// The cells, with the streams that are chosen for them.
    pub(crate) fn of(&self, grid: CellGrid) -> Result<BTreeMap<Cell, StreamChoice>, Misuse> {
        match self {
            Self::Around(point, bands) => {
                let cells = grid.within(*point, bands);
                cells.map_err(Misuse::Invalid)?.ok_or(Misuse::TooManyCells)
            }
            Self::These(cells) => Ok(cells.clone()),
        }
    }
}

fn mode(from: Option<Argument<'_>>) -> Result<JoinMode, Failure> {
    let Some(from) = from else {
        return Ok(JoinMode::Join);
    };
    if from.as_text() == Some("join") {
        return Ok(JoinMode::Join);
    }
    if let Some(config) = from.optional("create") {
        return Ok(JoinMode::Create(scene_config(&config)?));
    }
    match from.optional("createOrJoin") {
        Some(config) => Ok(JoinMode::CreateOrJoin(scene_config(&config)?)),
        None => Err(from.wrong("\"join\", or an object with create or createOrJoin")),
    }
}

fn scene_config(from: &Argument<'_>) -> Result<SceneConfig, Failure> {
    let mut config = SceneConfig::default();
    if let Some(from) = from.optional("stepping") {
        config.stepping = match from.text()? {
            "lockstep" => Stepping::Lockstep,
            "freeRunning" => Stepping::FreeRunning,
            _ => return Err(from.wrong("lockstep or freeRunning")),
        };
    }
    if let Some(from) = from.optional("rate") {
        let (ticks, seconds) = (from.field("ticks")?.u32()?, from.field("seconds")?.u32()?);
        let rate = Rate::new(ticks, seconds);
        config.integrator = Integrator {
            rate: rate.ok_or_else(|| from.wrong("ticks and seconds, neither of them 0"))?,
            ..config.integrator
        };
    }
    let count = |from: &Argument<'_>| {
        let count = NonZeroU32::new(from.u32()?);
        count.ok_or_else(|| from.wrong("a whole number that is not 0"))
    };
    if let Some(from) = from.optional("substeps") {
        config.integrator.substeps = count(&from)?;
    }
    if let Some(from) = from.optional("gravity") {
        config.gravity = from.vector()?;
    }
    if let Some(from) = from.optional("material") {
        config.material = material(&from)?;
    }
    if let Some(from) = from.optional("damping") {
        config.damping = damping(&from)?;
    }
    if let Some(from) = from.optional("sleep") {
        config.sleep = sleep(&from)?;
    }
    let mut schedule = PublishSchedule::EACH_TICK;
    if let Some(from) = from.optional("publishInterval") {
        schedule.publish_interval = count(&from)?;
    }
    if let Some(from) = from.optional("lookahead") {
        schedule.lookahead = Ticks::new(from.u32()?);
    }
    config.publish_schedule = schedule;
    config.check().map_err(|why| from.refused(why))?;
    Ok(config)
}

pub(crate) fn stream(from: &Argument<'_>) -> Result<StreamChoice, Failure> {
    match from.as_text() {
        Some("full") => return Ok(StreamChoice::Full),
        Some("changed") => return Ok(StreamChoice::Changed),
        _ => {}
    }
    let tolerance = tolerance(&from.field("within")?)?;
    let Some(from) = from.optional("budget") else {
        return Ok(StreamChoice::Within(tolerance));
    };
    let budget = match from.as_number() {
        Some(_) => Budget::per_second(from.u32()?),
        None => Budget::new(
            from.field("bytesPerSecond")?.u32()?,
            from.field("burst")?.u32()?,
        ),
    };
    Ok(StreamChoice::Capped {
        tolerance,
        budget: budget.ok_or_else(|| from.wrong("a budget within the protocol's limits"))?,
    })
}

pub(crate) fn tolerance(from: &Argument<'_>) -> Result<Tolerance, Failure> {
    if from.as_number().is_some() {
        return Ok(Tolerance::Surface(length(from)?));
    }
    let turn = from.field("turn")?;
    let radians = Radians::new(turn.number()?);
    Ok(Tolerance::Parts {
        position: length(&from.field("position")?)?,
        turn: TurnBound::from_radians(radians).map_err(|why| turn.refused(why))?,
    })
}

fn length(from: &Argument<'_>) -> Result<LengthBound, Failure> {
    let metres = Metres::new(from.number()?);
    LengthBound::from_metres(metres).map_err(|why| from.refused(why))
}

pub(crate) fn tier_policy(from: &Argument<'_>) -> Result<TierPolicy, Failure> {
    match from.as_text() {
        Some("never") => Ok(TierPolicy::Never),
        _ => Ok(TierPolicy::UpTo(length(&from.field("upTo")?)?)),
    }
}

/// The key of a session, out of 32 hexadecimal digits.
pub(crate) fn session_key(from: &Argument<'_>) -> Result<SessionKey, Failure> {
    let digits = from.text()?;
    let mut key = [0; 16];
    let wrong = || from.wrong("32 hexadecimal digits");
    if digits.len() != 32 || !digits.is_ascii() {
        return Err(wrong());
    }
    for (byte, at) in key.iter_mut().zip((0..32).step_by(2)) {
        *byte = u8::from_str_radix(&digits[at..at + 2], 16).map_err(|_| wrong())?;
    }
    Ok(SessionKey(key))
}
