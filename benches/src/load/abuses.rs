//! The abuses of a server, one row each, and what they are made of.
//!
//! Each row is played until the attacker is stopped. One whose connection is closed, or which is refused, has met a defence:
//! its error is what the server said. Measures nothing.

use std::f32::consts::TAU;
use std::num::NonZeroU32;
use std::thread;
use std::time::Duration;

use glam::{Quat, Vec3};
use rhumb_client::scene::{
    ActiveEvents, BodyBuilder, BodyDesc, Cell, Command, Heights, Hull, Joint, JointFrame, JointId,
    JointKind, Mesh, Query, SceneConfig, Shape, ShapeId, Sleep, Stepping,
};
use rhumb_client::{BodyId, Integrator, JoinMode, Rate, StreamChoice, Tick, Tolerance};
use rhumb_protocol::message::{CellRequest, ClientMessage, ResyncCause};
use rhumb_protocol::packet::{LossReport, Low16};

use super::attacker::{Attacker, VICTIM, ping};
use crate::output::Failure;

/// One abuse of a server.
pub(super) struct Abuse {
    pub(super) words: &'static str,
    /// Plays it until the attacker is stopped; returns the number of what was done.
    pub(super) play: fn(&Attacker) -> Result<u64, Failure>,
}

const fn abuse(words: &'static str, play: fn(&Attacker) -> Result<u64, Failure>) -> Abuse {
    Abuse { words, play }
}

/// All abuses: of the victim's own scene, of a scene beside it, of many scenes, and of connections.
pub(super) const ABUSES: [Abuse; 38] = [
    abuse("pings in the victim's scene", |attacker| {
        flood_victim(attacker, &vec![ping(0); 4_000])
    }),
    abuse("inspections in the victim's scene", |attacker| {
        flood_victim(attacker, &vec![ClientMessage::Inspect; 4_000])
    }),
    abuse("refused commands in the victim's scene", |attacker| {
        flood_victim(attacker, &vec![refused_command(); 4_000])
    }),
    abuse("rays in the victim's scene", |attacker| {
        flood_victim(attacker, &vec![rays(); 8])
    }),
    abuse(
        "400 new snapshots at once in the victim's scene",
        |attacker| flood_victim(attacker, &vec![RESYNC; 400]),
    ),
    abuse("changes of the stream in the victim's scene", |attacker| {
        flood_victim(attacker, &stream_changes())
    }),
    abuse("large meshes for the victim's scene", |attacker| {
        flood_victim(attacker, &added_and_removed(mesh()))
    }),
    abuse(
        "a member of the victim's scene that reads nothing",
        |attacker| unread(attacker, VICTIM, 1),
    ),
    abuse(
        "leaving and joining, 2,000 times at once, four large meshes",
        leaves_and_joins,
    ),
    abuse("joins of 5,000 bodies", joins),
    abuse("inspections of 1,000 bodies", |attacker| {
        flood(attacker, 1_000, |_| vec![ClientMessage::Inspect; 4_000])
    }),
    abuse("impulses", |attacker| {
        flood(attacker, 100, |ids| impulses(ids, 4_000))
    }),
    abuse("changes of gravity", |attacker| {
        flood(attacker, 100, |_| gravities(1_000))
    }),
    abuse("shape casts", |attacker| {
        flood(attacker, 1_000, |_| vec![casts(); 8])
    }),
    abuse("256 cells, taken and given up", cells),
    abuse("false reports of losses", loss_reports),
    abuse(
        "65,534 refused commands behind a long advance",
        behind_an_advance,
    ),
    abuse("5,000 balls within 10 cm", |attacker| {
        heap(attacker, &[within_centimetres])
    }),
    abuse("10,000 crossed capsules of 100 m", |attacker| {
        heap(attacker, &[crossed_capsules])
    }),
    abuse("1,000 cylinders at one point", |attacker| {
        heap(attacker, &[cylinders])
    }),
    abuse("3,000 boxes of 10 km", |attacker| {
        heap(attacker, &[wide_boxes])
    }),
    abuse("heaps of each kind, in eight scenes at once", |attacker| {
        let kinds: &[fn() -> Vec<BodyBuilder>] =
            &[within_centimetres, crossed_capsules, cylinders, wide_boxes];
        attacker.side_by_side(8, |number| heap_of(attacker, kinds, number))
    }),
    abuse("5,000 balls that fly to one point", |attacker| {
        heap(attacker, &[converging_balls])
    }),
    abuse("2,000 balls put into one place", put_together),
    abuse("65,000 joints of 20 bodies", joints),
    abuse("events of 3,000 boxes that touch", contact_events),
    abuse(
        "2,000 touching boxes at 1,000 Hz with 16 substeps",
        |attacker| step(attacker, 1, fast(), 2_000),
    ),
    abuse(
        "seven scenes of 300 touching boxes at 1,000 Hz with 16 substeps",
        |attacker| step(attacker, 7, fast(), 300),
    ),
    abuse("as many scenes as are admitted, at 1,000 Hz", |attacker| {
        many_scenes(attacker, fast())
    }),
    abuse("as many scenes as are admitted, at 60 Hz", |attacker| {
        many_scenes(attacker, free())
    }),
    abuse("a scene, created and deleted", created_and_deleted),
    abuse("the largest mesh in 16 scenes at once", |attacker| {
        attacker.side_by_side(16, |number| solids(attacker, number, &[mesh()]))
    }),
    abuse("large hulls and height fields", |attacker| {
        solids(attacker, 0, &[hull(), heights()])
    }),
    abuse(
        "gravity of a scene with a log that never steps",
        |attacker| never_stepped(attacker, &gravities(1_000)),
    ),
    abuse(
        "meshes for a scene with a log that never steps",
        |attacker| never_stepped(attacker, &added_and_removed(mesh())),
    ),
    abuse(
        "60 members that read nothing, of 20,000 bodies",
        |attacker| {
            let bodies = grid(20_000, 2.0, || {
                BodyDesc::fixed(Shape::cuboid(0.5, 0.5, 0.5))
            });
            let (mut owner, _) = attacker.make("attacker/unread", free(), bodies)?;
            attacker.stay(std::slice::from_mut(&mut owner), Duration::from_secs(1))?;
            unread(attacker, "attacker/unread", 60)
        },
    ),
    abuse("200 connections that say nothing", silent),
    abuse("80,000 boxes", |attacker| {
        let bodies = grid(80_000, 2.0, || {
            BodyDesc::fixed(Shape::cuboid(0.5, 0.5, 0.5))
        });
        let (owner, ids) = attacker.make("attacker/filled", free(), bodies)?;
        attacker.stay(&mut [owner], Duration::MAX)?;
        Ok(ids.len() as u64)
    }),
];

/// A scene that runs by the server's clock.
fn free() -> SceneConfig {
    SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    }
}

/// The most work of a scene: 1,000 ticks a second of 16 substeps, of bodies that never sleep.
fn fast() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::new(1_000, 1).expect("a rate"),
            substeps: NonZeroU32::MIN.saturating_add(15),
        },
        sleep: Sleep::Never,
        ..free()
    }
}

/// Bodies in a square, so far from one another, on a floor if they fall.
fn grid(
    count: u32,
    distance: f32,
    body: impl Fn() -> BodyBuilder,
) -> impl Iterator<Item = BodyBuilder> {
    let across = f64::from(count).sqrt().ceil() as u32;
    let bodies = (0..count).map(move |number| {
        let [x, z] = [number % across, number / across].map(|place| place as f32 * distance);
        body().at(x, 0.5, z)
    });
    [floor()].into_iter().chain(bodies)
}

fn floor() -> BodyBuilder {
    BodyDesc::fixed(Shape::cuboid(1_000.0, 0.5, 1_000.0)).at(0.0, -0.5, 0.0)
}

fn balls(count: u32) -> impl Iterator<Item = BodyBuilder> {
    grid(count, 2.0, || BodyDesc::dynamic(Shape::ball(0.5)))
}

const RESYNC: ClientMessage = ClientMessage::Resync(ResyncCause::LostSync);

fn refused_command() -> ClientMessage {
    let unknown = JointId(9);
    ClientMessage::Command(Command::RemoveJoint { id: unknown })
}

fn gravities(count: u16) -> Vec<ClientMessage> {
    let gravity = |number| Vec3::new(0.0, -1.0 - f32::from(number % 9), 0.0);
    let command = |number| Command::SetGravity {
        gravity: gravity(number),
    };
    (0..count)
        .map(|number| ClientMessage::Command(command(number)))
        .collect()
}

fn impulses(ids: &[BodyId], count: usize) -> Vec<ClientMessage> {
    let impulse = Vec3::new(0.0, 0.1, 0.0);
    // The first body is the floor.
    let bodies = ids.iter().skip(1).cycle().take(count);
    bodies
        .map(|id| ClientMessage::Command(Command::Impulse { id: *id, impulse }))
        .collect()
}

fn rays() -> ClientMessage {
    let ray = Query::ray(Vec3::new(0.0, 0.5, 0.0), Vec3::new(100.0, 0.0, 100.0));
    ClientMessage::Query(vec![ray; 500])
}

fn casts() -> ClientMessage {
    let (from, along) = (Vec3::new(-5.0, 0.5, -5.0), Vec3::new(200.0, 0.0, 200.0));
    let cast = Query::shape_cast(Shape::cuboid(5.0, 0.4, 5.0), from, Quat::IDENTITY, along);
    ClientMessage::Query(vec![cast; 400])
}

fn stream_changes() -> Vec<ClientMessage> {
    let choices = [Tolerance::NORMAL, Tolerance::LEAST].map(StreamChoice::Within);
    let choices = choices.into_iter().chain([StreamChoice::Full]);
    let changes = choices.map(ClientMessage::Subscribe).chain([RESYNC]);
    changes.cycle().take(400).collect()
}

/// A mesh of nearly as many triangles as there may be.
fn mesh() -> Shape {
    const ACROSS: u32 = 181;
    let place = |number: u32| [number % ACROSS, number / ACROSS].map(|place| place as f32);
    let points: Vec<Vec3> = (0..ACROSS * ACROSS)
        .map(|number| {
            let [x, z] = place(number);
            Vec3::new(x, (x * 0.7).sin() + (z * 1.3).cos(), z)
        })
        .collect();
    let squares = (0..ACROSS * (ACROSS - 1)).filter(|number| (number + 1) % ACROSS != 0);
    let triangles: Vec<[u32; 3]> = squares
        .flat_map(|at| {
            let below = at + ACROSS;
            [[at, below, at + 1], [at + 1, below, below + 1]]
        })
        .collect();
    Shape::Mesh(Mesh::new(&points, &triangles).expect("within the limits"))
}

fn hull() -> Shape {
    let points: Vec<Vec3> = (0_u8..255)
        .map(|number| {
            let height = f32::from(number) / 127.0 - 1.0;
            let around = f32::from(number) * 2.4;
            let radius = (1.0 - height * height).max(0.0).sqrt();
            Vec3::new(radius * around.cos(), height, radius * around.sin())
        })
        .collect();
    Shape::Hull(Hull::new(&points).expect("within the limits"))
}

fn heights() -> Shape {
    let posts: Vec<f32> = (0..512 * 512).map(|post| (post % 97) as f32).collect();
    Shape::Heights(Heights::new(512, 1.0, 1.0, &posts).expect("within the limits"))
}

fn added_and_removed(shape: Shape) -> Vec<ClientMessage> {
    let id = ShapeId(8_000);
    let commands = [Command::AddShape { id, shape }, Command::RemoveShape { id }];
    commands.map(ClientMessage::Command).to_vec()
}

/// Floods the scene that is measured, as a controller in it.
fn flood_victim(attacker: &Attacker, batch: &[ClientMessage]) -> Result<u64, Failure> {
    attacker.flood(attacker.enter(VICTIM, &[])?, batch)
}

/// Floods a scene of balls, which belongs to the attacker.
fn flood(
    attacker: &Attacker,
    bodies: u32,
    batch: impl FnOnce(&[BodyId]) -> Vec<ClientMessage>,
) -> Result<u64, Failure> {
    let (owner, ids) = attacker.make("attacker/flooded", free(), balls(bodies))?;
    let member = attacker.enter("attacker/flooded", &[])?;
    let flooded = attacker.flood(member, &batch(&ids));
    owner.close();
    flooded
}

fn leaves_and_joins(attacker: &Attacker) -> Result<u64, Failure> {
    let shape = mesh();
    let meshes = (0..4).map(|id| {
        let (id, shape) = (ShapeId(id), shape.clone());
        ClientMessage::Command(Command::AddShape { id, shape })
    });
    let mut member = attacker.enter("attacker/joined", &[ClientMessage::Create(free())])?;
    member.send(&meshes.collect::<Vec<_>>());
    // Its answers are read meanwhile.
    member.read(Duration::from_millis(500), |_| {})?;
    let join = ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL));
    let pair = [ClientMessage::Leave, join];
    attacker.flood(member, &vec![pair; 2_000].concat())
}

fn joins(attacker: &Attacker) -> Result<u64, Failure> {
    let (owner, _) = attacker.make("attacker/joined", free(), balls(5_000))?;
    let joined = attacker.again(|_| {
        attacker.join("attacker/joined", JoinMode::Join)?.close();
        Ok(())
    });
    owner.close();
    joined
}

fn cells(attacker: &Attacker) -> Result<u64, Failure> {
    let (owner, _) = attacker.make("attacker/cells", free(), balls(1_000))?;
    let member = attacker.enter("attacker/cells", &[ClientMessage::JoinCells])?;
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    let requests = [CellRequest::Subscribe(choice), CellRequest::Leave];
    let batch: Vec<_> = requests
        .into_iter()
        .flat_map(|request| {
            let cells = (0..256).map(|number| Cell([number % 16, 0, number / 16]));
            cells.map(move |cell| ClientMessage::OfCell { cell, request })
        })
        .collect();
    let flooded = attacker.flood(member, &batch);
    owner.close();
    flooded
}

/// Says that the newest packets were all lost, again and again.
fn loss_reports(attacker: &Attacker) -> Result<u64, Failure> {
    const LOST: u64 = 64;
    let (owner, _) = attacker.make("attacker/lossy", free(), balls(300))?;
    let mut member = attacker.enter("attacker/lossy", &[])?;
    let mut said = 0;
    while attacker.goes_on() {
        member.read(Duration::from_millis(1), |_| {})?;
        let next = member.packets;
        let report = LossReport {
            next: Low16::of(next),
            abandoned: Low16::of(next),
            repair_symbols: 0,
            lost: (next.saturating_sub(LOST)..next).map(Low16::of).collect(),
        };
        // One that the link does not take is lost in truth.
        said += u64::from(member.peer.send_datagram(report.encode(member.stream)));
    }
    owner.close();
    Ok(said)
}

fn behind_an_advance(attacker: &Attacker) -> Result<u64, Failure> {
    let config = SceneConfig {
        integrator: fast().integrator,
        ..SceneConfig::default()
    };
    let (owner, _) = attacker.make("attacker/advanced", config, balls(3_000))?;
    let member = attacker.enter("attacker/advanced", &[])?;
    let to = Tick::new(1_024);
    let mut batch = vec![ClientMessage::Advance { to }];
    batch.resize(65_535, refused_command());
    let flooded = attacker.flood(member, &batch);
    owner.close();
    flooded
}

/// Heaps of these kinds in turn, each in a scene of its own, until it ends or for two seconds.
fn heap(attacker: &Attacker, kinds: &[fn() -> Vec<BodyBuilder>]) -> Result<u64, Failure> {
    heap_of(attacker, kinds, 0)
}

fn heap_of(
    attacker: &Attacker,
    kinds: &[fn() -> Vec<BodyBuilder>],
    number: u64,
) -> Result<u64, Failure> {
    let mut next = kinds.iter().cycle().skip(number as usize);
    attacker.again(|round| {
        let bodies = next.next().map(|kind| kind()).unwrap_or_default();
        let name = format!("attacker/heap-{number}-{round}");
        let (mut owner, _) = attacker.make(&name, free(), bodies)?;
        attacker.stay(std::slice::from_mut(&mut owner), Duration::from_secs(2))?;
        Ok(owner.delete()?)
    })
}

fn within_centimetres() -> Vec<BodyBuilder> {
    let at = |number: u32| {
        let place = [number % 17, number / 17 % 17, number / 289];
        Vec3::from(place.map(|place| place as f32 * 0.006))
    };
    let ball = |number| BodyDesc::dynamic(Shape::ball(0.5)).position(at(number));
    (0..5_000).map(ball).collect()
}

fn crossed_capsules() -> Vec<BodyBuilder> {
    let capsule = |number: u16| {
        let turn = Quat::from_rotation_y(f32::from(number) * 0.01);
        let lying = turn * Quat::from_rotation_x(TAU / 4.0);
        let capsule = BodyDesc::dynamic(Shape::capsule(50.0, 0.05));
        capsule
            .at(0.0, f32::from(number % 100) * 0.01, 0.0)
            .rotation(lying)
    };
    (0..10_000).map(capsule).collect()
}

fn cylinders() -> Vec<BodyBuilder> {
    vec![BodyDesc::dynamic(Shape::cylinder(0.5, 0.5)); 1_000]
}

fn wide_boxes() -> Vec<BodyBuilder> {
    let wide = Shape::cuboid(5_000.0, 0.5, 5_000.0);
    let at = |number: u16| BodyDesc::dynamic(wide.clone()).at(0.0, f32::from(number) * 0.9, 0.0);
    (0..3_000).map(at).collect()
}

fn converging_balls() -> Vec<BodyBuilder> {
    let ball = |number: u16| {
        let height = f32::from(number) / 2_500.0 - 1.0;
        let around = f32::from(number) * 2.4;
        let radius = (1.0 - height * height).max(0.0).sqrt();
        let out = Vec3::new(radius * around.cos(), height, radius * around.sin());
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).position(out * 60.0);
        ball.linear_velocity(out * -60.0).gravity_scale(0.0)
    };
    (0..5_000).map(ball).collect()
}

fn put_together(attacker: &Attacker) -> Result<u64, Failure> {
    let (mut owner, ids) = attacker.make("attacker/put", free(), balls(2_000))?;
    attacker.again(|_| {
        for id in ids.iter().skip(1) {
            owner.command(Command::SetPose {
                id: *id,
                position: Vec3::new(0.0, 10.0, 0.0),
                rotation: Quat::IDENTITY,
            })?;
        }
        attacker.stay(std::slice::from_mut(&mut owner), Duration::from_millis(100))
    })
}

fn joints(attacker: &Attacker) -> Result<u64, Failure> {
    flood(attacker, 20, |ids| {
        let joint = |number: u32| {
            let bodies = [number % 20, (number / 20 + number + 1) % 20];
            let bodies = bodies.map(|place| ids[place as usize + 1]);
            let frames = [JointFrame::at(Vec3::X), JointFrame::at(Vec3::NEG_X)];
            let joint = Joint::plain(JointKind::Spherical(None), bodies, frames);
            ClientMessage::Command(Command::AddJoint {
                id: JointId(number),
                joint: Box::new(joint),
            })
        };
        (0..65_000).map(joint).collect()
    })
}

fn contact_events(attacker: &Attacker) -> Result<u64, Failure> {
    // Columns of thirty, each box a little beside the one below.
    let boxes = (0_u16..3_000).map(|number| {
        let [x, z, level] = [number % 10, number / 10 % 10, number / 100].map(f32::from);
        let each = BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5));
        each.at(x + level * 0.02, 0.5 + level, z)
    });
    let bodies = [floor()].into_iter().chain(boxes);
    let (mut owner, ids) = attacker.make("attacker/events", free(), bodies)?;
    let events = ActiveEvents {
        contacts: true,
        force: Some(0.0),
        ..ActiveEvents::NONE
    };
    for id in ids.iter().skip(1) {
        let id = *id;
        owner.command(Command::SetEvents { id, events })?;
    }
    attacker.stay(&mut [owner], Duration::MAX)?;
    Ok(ids.len() as u64)
}

/// So many scenes of boxes that never sleep; returns the number of those that are admitted.
fn step(
    attacker: &Attacker,
    scenes: u32,
    config: SceneConfig,
    bodies: u32,
) -> Result<u64, Failure> {
    let make = |number: u32| {
        let name = format!("attacker/stepped-{number}");
        let boxes = grid(bodies, 1.0, || {
            BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5))
        });
        Ok(attacker.make(&name, config, boxes)?.0)
    };
    let made: Vec<Result<_, Failure>> = (0..scenes).map(make).collect();
    let mut owners: Vec<_> = made.into_iter().filter_map(Result::ok).collect();
    if owners.is_empty() {
        return Err("no scene was admitted".into());
    }
    attacker.stay(&mut owners, Duration::MAX)?;
    Ok(owners.len() as u64)
}

/// Scenes without members, until no more are admitted.
fn many_scenes(attacker: &Attacker, config: SceneConfig) -> Result<u64, Failure> {
    attacker.again(|number| {
        let name = format!("attacker/many-{number}");
        attacker.join(&name, JoinMode::Create(config))?.close();
        Ok(())
    })
}

fn created_and_deleted(attacker: &Attacker) -> Result<u64, Failure> {
    let pair = [ClientMessage::Create(free()), ClientMessage::Delete];
    let member = attacker.greet("attacker/brief", &[])?;
    attacker.flood(member, &vec![pair; 500].concat())
}

/// Large shapes that are added and removed in a scene of this number.
fn solids(attacker: &Attacker, number: u64, shapes: &[Shape]) -> Result<u64, Failure> {
    let scene = format!("attacker/solids-{number}");
    let member = attacker.enter(&scene, &[ClientMessage::Create(free())])?;
    let batch: Vec<_> = (shapes.iter().cloned())
        .flat_map(added_and_removed)
        .collect();
    attacker.flood(member, &batch)
}

/// Commands to a scene that no member advances: its log grows.
fn never_stepped(attacker: &Attacker, batch: &[ClientMessage]) -> Result<u64, Failure> {
    let create = ClientMessage::Create(SceneConfig::default());
    let member = attacker.enter("attacker/logged", &[create])?;
    attacker.flood(member, batch)
}

/// So many members that read nothing.
fn unread(attacker: &Attacker, scene: &str, count: u64) -> Result<u64, Failure> {
    let join = ClientMessage::Join(StreamChoice::Full);
    let mut members = Vec::new();
    for _ in 0..count {
        let member = attacker.greet(scene, &[])?;
        member.peer.read_control(false);
        member.send(std::slice::from_ref(&join));
        members.push(member);
    }
    wait(attacker);
    Ok(count)
}

fn silent(attacker: &Attacker) -> Result<u64, Failure> {
    let mut connections = Vec::new();
    while attacker.goes_on() && connections.len() < 200 {
        connections.push(attacker.connect()?);
    }
    wait(attacker);
    Ok(connections.len() as u64)
}

/// Waits until the attacker is stopped.
fn wait(attacker: &Attacker) {
    while attacker.goes_on() {
        thread::sleep(Duration::from_millis(20));
    }
}
