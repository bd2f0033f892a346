//! Members of a load: the owner of a scene, and those who follow it.
//!
//! Each has a thread, and is a member until the load ends. Measures nothing but its own traffic.

use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use glam::{Quat, Vec3};
use rhumb_client::{Client, JoinMode, JoinOptions, StreamChoice, Trust};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, SceneName, Stepping};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_transport::Fingerprint;

use super::rig::{script, take_ids};
use crate::output::Failure;

/// Time between two looks of a member at the clock.
const PAUSE: Duration = Duration::from_millis(50);
/// Time for which a member that was interrupted tries to come back.
const RESUMES_WITHIN: Duration = Duration::from_secs(60);

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
    /// Ticks between publications.
    pub(super) publish_interval: NonZeroU32,
}

impl Place {
    pub(super) fn scene(&self) -> SceneName {
        let name = format!("load/{}", self.number);
        name.parse().expect("a valid name")
    }

    pub(super) fn join(&self, mode: JoinMode) -> Result<Client, Failure> {
        self.join_stream(mode, JoinOptions::default().stream)
    }

    pub(super) fn join_stream(
        &self,
        mode: JoinMode,
        stream: StreamChoice,
    ) -> Result<Client, Failure> {
        let trust = Trust::Fingerprint(self.fingerprint);
        let options = JoinOptions {
            mode,
            stream,
            resume_within: Some(RESUMES_WITHIN),
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.address.to_string(), trust)?;
        Ok(connection.join_with(self.scene().as_str(), options)?)
    }
}

/// A member that follows its scene until the load ends.
pub(super) struct Member(JoinHandle<MemberEnd>);

/// The end of a member.
#[derive(Debug)]
pub(super) struct MemberEnd {
    /// Cause of its end, unless the load ended it.
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
    ) -> Result<Self, Failure> {
        let mut script = script(&contents.script, contents.bodies, contents.seed)?;
        let mut config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..script.config()
        };
        config.publish_schedule.publish_interval = contents.publish_interval;
        let mut client = place.join(JoinMode::Create(config))?;
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        let mut resets = Resets::new(&commands);
        take_ids(&mut client, &commands)?;
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
    pub(super) fn observe(place: &Place, stop: &Arc<AtomicBool>) -> Result<Self, Failure> {
        let client = place.join(JoinMode::Join)?;
        Ok(Self::follow(client, stop, |_| Ok(())))
    }

    fn follow(
        mut client: Client,
        stop: &Arc<AtomicBool>,
        mut work: impl FnMut(&mut Client) -> Result<(), Failure> + Send + 'static,
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

/// The states in which the bodies of a scene began.
struct Resets(Vec<(BodyId, BodyState)>);

impl Resets {
    fn new(commands: &[Command]) -> Self {
        let movable = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } if desc.kind == BodyKind::Dynamic => {
                Some((desc.id, *motion))
            }
            _ => None,
        });
        Self(movable.collect())
    }

    fn reset(&mut self, client: &mut Client) -> Result<(), Failure> {
        for &(id, motion) in &self.0 {
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
