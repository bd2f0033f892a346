//! Scenes of one thread, and which connection belongs to which of them.
//!
//! Reads the first message of a connection, which names its scene, and carries everything else between the connection
//! and the loop of that scene. The driver of one process and the simulated network use it alike.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake};

use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::feed::Feeds;
use crate::greeting::{Greeted, Greeting};
use crate::member::UpstreamStatistics;
use crate::permit::Permit;
use crate::scene_loop::SceneLoop;
use crate::settings::SceneSettings;

/// Scenes, and the connections to them.
pub struct SceneRouter {
    settings: Arc<SceneSettings>,
    /// The rights of a new connection.
    permit: Arc<Permit>,
    connections: BTreeMap<Peer, Routed>,
    /// The scenes that exist, and those that clients have named.
    loops: BTreeMap<SceneName, SceneLoop>,
    /// Connections to close that named no scene.
    closed: VecDeque<Transmit>,
}

enum Routed {
    Greeting {
        greeting: Greeting,
        opened: Instant,
        permit: Arc<Permit>,
    },
    Bound(SceneName),
    /// Only its end is still awaited.
    Closed,
}

impl SceneRouter {
    /// No scenes.
    #[must_use]
    pub fn new(settings: impl Into<Arc<SceneSettings>>) -> Self {
        Self {
            settings: settings.into(),
            permit: Arc::new(Permit::OPEN),
            connections: BTreeMap::new(),
            loops: BTreeMap::new(),
            closed: VecDeque::new(),
        }
    }

    /// With this permit for each new connection, unless [`Self::admit`] says otherwise.
    #[must_use]
    pub fn admitting(mut self, permit: Permit) -> Self {
        self.permit = Arc::new(permit);
        self
    }

    /// Sets what a new connection may do, before its first message; without this, everything.
    pub fn admit(&mut self, peer: Peer, permit: Arc<Permit>) {
        if let Some(Routed::Greeting { permit: of, .. }) = self.connections.get_mut(&peer) {
            *of = permit;
        }
    }

    /// The feeds of its scenes.
    #[must_use]
    pub fn feeds(&self) -> Feeds {
        self.settings.feeds.clone()
    }

    /// Names of the scenes that exist.
    pub fn scenes(&self) -> impl Iterator<Item = &SceneName> {
        let loops = self.loops.iter();
        loops.filter_map(|(name, scene)| scene.exists().then_some(name))
    }

    /// Statistics of all bodies of a scene under a member's authority.
    pub fn upstreams(&self, scene: &SceneName) -> impl Iterator<Item = UpstreamStatistics> {
        let scene = self.loops.get(scene).into_iter();
        scene.flat_map(SceneLoop::upstreams)
    }

    /// The state of a scene, as [`SceneLoop::save`] has it.
    ///
    /// # Errors
    ///
    /// As there.
    pub fn save(&self, name: &SceneName) -> Result<Checkpoint, CheckpointError> {
        let scene = self.loops.get(name);
        scene.map_or_else(
            || Err(CheckpointError::NoSuchScene(name.clone())),
            SceneLoop::save,
        )
    }

    /// Runs a new scene that continues from a checkpoint. It has neither members nor owners nor a log.
    ///
    /// # Errors
    ///
    /// As [`SceneLoop::restore`].
    pub fn restore(
        &mut self,
        now: Instant,
        name: &SceneName,
        checkpoint: &Checkpoint,
    ) -> Result<(), CheckpointError> {
        self.loop_of(name).restore(now, checkpoint)
    }

    fn loop_of(&mut self, name: &SceneName) -> &mut SceneLoop {
        let scene = self.loops.entry(name.clone());
        scene.or_insert_with_key(|name| SceneLoop::new(name.clone(), Arc::clone(&self.settings)))
    }

    fn bound(&self, peer: Peer) -> Option<&SceneLoop> {
        match self.connections.get(&peer)? {
            Routed::Bound(name) => self.loops.get(name),
            Routed::Greeting { .. } | Routed::Closed => None,
        }
    }

    fn bound_mut(&mut self, peer: Peer) -> Option<&mut SceneLoop> {
        match self.connections.get(&peer)? {
            Routed::Bound(name) => self.loops.get_mut(name),
            Routed::Greeting { .. } | Routed::Closed => None,
        }
    }

    /// Takes bytes of a connection that has not named its scene.
    fn greet(&mut self, now: Instant, peer: Peer, bytes: &[u8]) {
        let Some(Routed::Greeting {
            greeting,
            opened,
            permit,
        }) = self.connections.get_mut(&peer)
        else {
            return;
        };
        match greeting.handle_control(bytes) {
            Greeted::NotYet => {}
            Greeted::Broken(code) => {
                tracing::warn!(peer = peer.0, %code, "closing a connection that broke the protocol");
                self.connections.insert(peer, Routed::Closed);
                let (to, code) = (peer, code.0);
                self.closed.push_back(Transmit::Close { to, code });
            }
            Greeted::Names(name, _, received) => {
                let (opened, paced, permit) = (*opened, greeting.paced, Arc::clone(permit));
                let scene = self.loop_of(&name);
                scene.handle_opened(opened, peer);
                scene.admit(peer, permit);
                if paced {
                    scene.handle_control_taken(now, peer, 0);
                }
                scene.handle_control(now, peer, &received);
                self.connections.insert(peer, Routed::Bound(name));
            }
        }
    }
}

impl Endpoint for SceneRouter {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let connection = Routed::Greeting {
            greeting: Greeting::default(),
            opened: now,
            permit: Arc::clone(&self.permit),
        };
        self.connections.insert(peer, connection);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        match self.bound_mut(from) {
            Some(scene) => scene.handle_control(now, from, bytes),
            None => self.greet(now, from, bytes),
        }
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        if let Some(Routed::Greeting { greeting, .. }) = self.connections.get_mut(&peer) {
            greeting.paced = true;
        } else if let Some(scene) = self.bound_mut(peer) {
            scene.handle_control_taken(now, peer, bytes);
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        let bound = self.bound(from);
        bound.is_none_or(|scene| scene.wants_control(from))
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(scene) = self.bound_mut(from) {
            scene.handle_datagram(now, from, bytes);
        }
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        if let Some(scene) = self.bound_mut(peer) {
            scene.handle_link(now, peer, report);
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        if let Some(scene) = self.bound_mut(peer) {
            scene.handle_ended(now, peer, ending);
        }
        self.connections.remove(&peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        for scene in self.loops.values_mut() {
            scene.handle_timeout(now);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        if let Some(transmit) = self.closed.pop_front() {
            return Some(transmit);
        }
        let transmit = self.loops.values_mut().find_map(SceneLoop::poll_transmit);
        if transmit.is_none() {
            self.loops.retain(|_, scene| !scene.is_idle());
        }
        transmit
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let wakes = self.loops.values().filter_map(SceneLoop::poll_timeout);
        wakes.min_by_key(|wake| wake.at)
    }
}
