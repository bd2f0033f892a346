//! Connections whose scene may be another server's: it is asked for first.
//!
//! A scene that has a worker is this server's. Invariant: from the moment at which its lease may be over, nothing of any scene
//! leaves this server, and its workers end; their scenes go on elsewhere, or here under the next lease.

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Peer, Transmit};

use super::{Connection, Dispatcher, NamedScene};
use crate::directory::{ClaimEvent, Keeper, ServerPlace};

impl Dispatcher {
    /// Serves only scenes that the directory gives this server, and names the servers of others to clients.
    pub(crate) fn ask_directory(&mut self, directory: Keeper) {
        self.directory = Some(directory);
    }

    /// True if it is not known whose a scene is.
    pub(super) fn must_ask(&self, scene: &SceneName) -> bool {
        self.directory.is_some() && !self.by_scene.contains_key(scene)
    }

    /// Keeps a connection until the directory says where its scene is.
    pub(super) fn ask_for(&mut self, peer: Peer, named: NamedScene) {
        if let Some(directory) = &self.directory {
            directory.claim(&named.scene);
        }
        let asking = Connection::Asking(Box::new(named));
        self.connections.insert(peer, asking);
    }

    /// Takes what the directory has said.
    pub(super) fn take_places(&mut self) {
        while let Some(event) = self.directory.as_ref().and_then(Keeper::poll_event) {
            match event {
                ClaimEvent::Owned(scene, _) => self.serve(&scene),
                ClaimEvent::Elsewhere(scene, place) => self.send_elsewhere(&scene, &place),
                ClaimEvent::Unknown(scene) => {
                    for peer in self.asking_for(&scene) {
                        self.close(peer, CloseCode::BUSY);
                    }
                }
                ClaimEvent::Lost => self.lose_scenes(),
            }
        }
    }

    /// Ends everything that is published without a lease.
    pub(super) fn keep_fence(&mut self) {
        let Some(directory) = &self.directory else {
            return;
        };
        if !self.workers.is_empty() && !directory.may_publish() {
            self.lose_scenes();
        }
    }

    fn asking_for(&self, scene: &SceneName) -> Vec<Peer> {
        let asks = |connection: &Connection| matches!(connection, Connection::Asking(named) if named.scene == *scene);
        let connections = self.connections.iter();
        let asking = connections.filter(|(_, connection)| asks(connection));
        asking.map(|(peer, _)| *peer).collect()
    }

    fn serve(&mut self, scene: &SceneName) {
        let now = (self.settings.scenes.clock)();
        let waiting = self.asking_for(scene);
        if waiting.is_empty()
            && self.must_ask(scene)
            && let Some(directory) = &self.directory
        {
            // Its clients have gone.
            directory.release(scene);
        }
        for peer in waiting {
            if let Some(Connection::Asking(named)) = self.connections.remove(&peer) {
                self.connections.insert(peer, Connection::Closed);
                self.bind(now, peer, *named);
            }
        }
    }

    fn send_elsewhere(&mut self, scene: &SceneName, place: &ServerPlace) {
        for peer in self.asking_for(scene) {
            if let Some(Connection::Asking(named)) = self.connections.get_mut(&peer) {
                let role = Some(named.admission.permit.role);
                let (bytes, code) = named.greeting.welcome_elsewhere(&place.0, role);
                tracing::debug!(peer = peer.0, %scene, place = place.0, "another server has the scene");
                self.out.push_back(Transmit::Control { to: peer, bytes });
                self.close(peer, code);
            }
        }
    }

    /// Ends all scenes, of which other servers may have each from now on.
    fn lose_scenes(&mut self) {
        let is_close = |transmit: &Transmit| matches!(transmit, Transmit::Close { .. });
        self.out.retain(is_close);
        let workers: Vec<_> = self.workers.keys().copied().collect();
        if !workers.is_empty() {
            let scenes = workers.len();
            tracing::error!(
                scenes,
                "the directory of scenes is out of reach: they end here before others may have them"
            );
        }
        for worker in workers {
            self.close_connections_of(worker, CloseCode::SCENE_RESTORING);
            self.drop_worker(worker);
        }
    }
}
