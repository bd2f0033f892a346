//! Members of the load's scenes: owners and observers, each in a thread.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use glam::{Quat, Vec3};
use rhumb_client::{Client, JoinMode, JoinOptions, Trust};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Stepping};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_sims::by_name;
use rhumb_transport::Fingerprint;

/// Any error of a member or of its server.
pub(super) type Error = Box<dyn std::error::Error + Send + Sync>;

/// Time between two looks of a member at the clock.
const PAUSE: Duration = Duration::from_millis(50);

/// A scene of a server.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) address: SocketAddr,
    pub(super) fingerprint: Fingerprint,
    pub(super) number: u32,
}

/// Contents of a scene.
pub(super) struct Contents {
    pub(super) script: String,
    pub(super) bodies: u32,
    pub(super) seed: u64,
    /// Time after which the bodies are put back where they began.
    pub(super) reset: Duration,
}

impl Place {
    fn join(&self, mode: JoinMode) -> Result<Client, Error> {
        let trust = Trust::Fingerprint(self.fingerprint);
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.address.to_string(), trust)?;
        Ok(connection.join_with(&format!("load/{}", self.number), options)?)
    }
}

/// A member that follows its scene until the load ends.
pub(super) struct Member(JoinHandle<MemberEnd>);

/// The end of a member.
#[derive(Debug)]
pub(super) struct MemberEnd {
    /// Why it ended, unless the load ended it.
    pub(super) error: Option<String>,
    /// UDP payload received.
    pub(super) received_bytes: u64,
    /// Time that it was a member, seconds.
    pub(super) seconds: f64,
}

impl Member {
    /// Creates the scene and places its bodies; then puts them back again and again.
    pub(super) fn own(
        place: &Place,
        contents: &Contents,
        stop: &Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let script = by_name(&contents.script, contents.bodies, contents.seed);
        let mut script = script.ok_or("no scene has this name")?;
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..script.config()
        };
        let mut client = place.join(JoinMode::Create(config))?;
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        let mut resets = Resets::new(&commands);
        client.new_ids(u32::try_from(resets.bodies)?)?;
        for command in commands {
            client.command(command)?;
        }
        client.flush();
        let period = contents.reset;
        // The scenes' resets are spread over the period.
        let first = period * (place.number % 16 + 1) / 16;
        let mut due = Instant::now() + first;
        Ok(Self::follow(client, stop, move |client| {
            if Instant::now() < due {
                return Ok(());
            }
            due += period;
            resets.reset(client)
        }))
    }

    /// Follows a scene, and commands nothing.
    pub(super) fn observe(place: &Place, stop: &Arc<AtomicBool>) -> Result<Self, Error> {
        let client = place.join(JoinMode::Join)?;
        Ok(Self::follow(client, stop, |_| Ok(())))
    }

    fn follow(
        mut client: Client,
        stop: &Arc<AtomicBool>,
        mut work: impl FnMut(&mut Client) -> Result<(), Error> + Send + 'static,
    ) -> Self {
        let stop = Arc::clone(stop);
        Self(thread::spawn(move || {
            let begun = Instant::now();
            let before = client.statistics().wire.received_bytes;
            let mut error = None;
            while error.is_none() && !stop.load(Ordering::Relaxed) {
                let turn = work(&mut client).and_then(|()| Ok(client.idle(PAUSE)?));
                error = turn.err().map(|error| error.to_string());
                while client.poll_event().is_some() {}
            }
            MemberEnd {
                error,
                received_bytes: client.statistics().wire.received_bytes - before,
                seconds: begun.elapsed().as_secs_f64(),
            }
        }))
    }

    /// Waits until the member has seen the end of the load.
    pub(super) fn end(self) -> MemberEnd {
        self.0.join().unwrap_or_else(|_| MemberEnd {
            error: Some("its thread panicked".to_owned()),
            received_bytes: 0,
            seconds: 0.0,
        })
    }
}

/// Where the bodies of a scene began.
struct Resets {
    bodies: usize,
    movable: Vec<(BodyId, BodyState)>,
}

impl Resets {
    fn new(commands: &[Command]) -> Self {
        let mut resets = Self {
            bodies: 0,
            movable: Vec::new(),
        };
        for command in commands {
            if let Command::AddBody { desc, motion } = command {
                resets.bodies += 1;
                if desc.kind == BodyKind::Dynamic {
                    resets.movable.push((desc.id, *motion));
                }
            }
        }
        resets
    }

    fn reset(&mut self, client: &mut Client) -> Result<(), Error> {
        for &(id, motion) in &self.movable {
            let position = Vec3::from_array(motion.position());
            let rotation = Quat::from_array(motion.rotation());
            client.command(Command::SetPose {
                id,
                position,
                rotation,
            })?;
            let [.., lx, ly, lz, ax, ay, az] = motion.parts();
            let (linear, angular) = (Vec3::new(lx, ly, lz), Vec3::new(ax, ay, az));
            client.command(Command::SetVelocity {
                id,
                linear,
                angular,
            })?;
        }
        client.flush();
        Ok(())
    }
}
