//! Abuses of the server by members of another scene, meanwhile.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, SceneConfig, Shape, Stepping};
use rhumb_client::{BodyId, Client, ClientError, JoinMode, JoinOptions, Refusals, Trust};
use rhumb_protocol::scene::{Command, Query};
use rhumb_transport::Fingerprint;

use crate::drive::ServerProcess;

/// Any error of a member or of its server.
pub(super) type Error = Box<dyn std::error::Error + Send + Sync>;

/// One abuse of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Abuse {
    Overlap,
    Commands,
    Queries,
    Joins,
}

impl Abuse {
    pub(super) const ALL: [Self; 4] = [Self::Overlap, Self::Commands, Self::Queries, Self::Joins];

    pub(super) const fn text(self) -> &'static str {
        match self {
            Self::Overlap => "300 balls in one place",
            Self::Commands => "impulses without a pause",
            Self::Queries => "rays without a pause",
            Self::Joins => "joins of 5,000 bodies without a pause",
        }
    }

    /// Number of balls in the scene.
    const fn balls(self) -> u32 {
        match self {
            Self::Overlap => 300,
            Self::Commands | Self::Queries => 100,
            Self::Joins => 5_000,
        }
    }

    /// Distance between two balls, metres.
    const fn distance(self) -> f32 {
        match self {
            Self::Overlap => 1e-3,
            _ => 2.0,
        }
    }
}

/// Commands or queries of one turn.
const BATCH: usize = 500;
/// Scenes of this server that abuse it.
const SCENE: &str = "abusing/scene";

/// An abuse that runs until it is stopped.
pub(super) struct RunningAbuse {
    stop: Arc<AtomicBool>,
    worker: JoinHandle<Result<u64, Error>>,
}

/// The address of a server.
#[derive(Clone, Copy)]
struct Target(SocketAddr, Fingerprint);

impl Target {
    fn join(self, mode: JoinMode) -> Result<Client, Error> {
        let options = JoinOptions {
            mode,
            refusals: Refusals::Events,
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.0.to_string(), Trust::Fingerprint(self.1))?;
        Ok(connection.join_with(SCENE, options)?)
    }
}

impl RunningAbuse {
    /// Makes the scene, then begins.
    pub(super) fn start(abuse: Abuse, server: &ServerProcess) -> Result<Self, Error> {
        let target = Target(server.address, server.fingerprint);
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..SceneConfig::default()
        };
        let mut client = target.join(JoinMode::Create(config))?;
        client.add_body(BodyDesc::fixed(Shape::cuboid(200.0, 0.5, 200.0)).at(0.0, -0.5, 0.0))?;
        let across = (f64::from(abuse.balls()).sqrt().ceil()) as u32;
        let balls = (0..abuse.balls()).map(|ball| {
            let [x, z] =
                [ball % across, ball / across].map(|place| place as f32 * abuse.distance());
            BodyDesc::dynamic(Shape::ball(0.5)).at(x, 0.5, z)
        });
        let ids = client.add_bodies(balls)?;
        client.flush();
        client.idle(Duration::from_millis(100))?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let worker = thread::spawn(move || {
            let mut done = 0;
            while !stopped.load(Ordering::Relaxed) {
                done += turn(abuse, target, &mut client, &ids)?;
                while client.poll_event().is_some() {}
            }
            client.delete()?;
            Ok(done)
        });
        Ok(Self { stop, worker })
    }

    /// Ends it; returns the number of what was done.
    pub(super) fn end(self) -> Result<u64, Error> {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.worker.join();
        ended.unwrap_or_else(|_| Err("the thread of the abuse panicked".into()))
    }
}

/// One turn of an abuse; returns the number of what was done.
fn turn(abuse: Abuse, target: Target, client: &mut Client, ids: &[BodyId]) -> Result<u64, Error> {
    let pause = Duration::from_millis(1);
    match abuse {
        Abuse::Overlap => {
            client.idle(Duration::from_millis(20))?;
            Ok(1)
        }
        Abuse::Commands => {
            for id in ids.iter().cycle().take(BATCH) {
                let (id, impulse) = (*id, Vec3::new(0.0, 0.1, 0.0));
                client.command(Command::Impulse { id, impulse })?;
            }
            client.flush();
            client.idle(pause)?;
            Ok(BATCH as u64)
        }
        Abuse::Queries => {
            let ray = Query::ray(Vec3::new(0.0, 0.5, 0.0), Vec3::new(100.0, 0.0, 100.0));
            // Refused queries are answered too.
            match client.ask(vec![ray; BATCH]) {
                Ok(_) => Ok(BATCH as u64),
                Err(ClientError::Timeout { .. }) => Ok(0),
                Err(error) => Err(error.into()),
            }
        }
        Abuse::Joins => {
            target.join(JoinMode::Join)?.close();
            client.idle(pause)?;
            Ok(1)
        }
    }
}
