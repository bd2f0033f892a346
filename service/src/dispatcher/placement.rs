//! Connections whose scene may be another server's: it is asked for first.
//!
//! A scene that has a worker is this server's, unless the worker stands by for a scene that is to come. Invariant: from the moment at which its lease may be over, nothing of any scene
//! leaves this server, and its workers end; their scenes go on elsewhere, or here under the next lease.

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Peer, Transmit};

use super::accounts::Account;
use super::message::{Duty, WorkerId, WorkerInput};
use super::{Connection, Dispatcher, NamedScene};
use crate::directory::{ClaimEvent, DirectoryEvent, HandoverStep, Keeper, ServerPlace};
use crate::durable::LogTail;

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
                DirectoryEvent::Claim(event) => self.take_claim(event),
                DirectoryEvent::Handover(HandoverStep::Prepare(scene)) => self.prepare(scene),
                DirectoryEvent::Handover(HandoverStep::Forget(scene)) => self.forget(&scene),
                DirectoryEvent::Handover(HandoverStep::Leave(scene, to)) => {
                    self.leave(&scene, to);
                }
            }
        }
    }

    fn take_claim(&mut self, event: ClaimEvent) {
        match event {
            ClaimEvent::Owned(scene, _) => self.serve(&scene),
            ClaimEvent::Elsewhere(scene, place) => {
                for peer in self.asking_for(&scene) {
                    self.send_on(peer, &place);
                }
            }
            ClaimEvent::Unknown(scene) => {
                for peer in self.asking_for(&scene) {
                    self.close(peer, CloseCode::BUSY);
                }
            }
            ClaimEvent::Lost => self.lose_scenes(),
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
        if let Some(id) = self.standbys.remove(scene)
            && let Some(worker) = self.workers.get_mut(&id)
        {
            worker.duty = Duty::Serve;
            self.by_scene.insert(scene.clone(), id);
            self.route(id, WorkerInput::Restore(LogTail::Kept));
        }
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

    /// Tells a connection that asks for a scene the server that has it, and closes it.
    pub(super) fn send_on(&mut self, peer: Peer, place: &ServerPlace) {
        if let Some(Connection::Asking(named)) = self.connections.get_mut(&peer) {
            let role = Some(named.admission.permit.role);
            let scene = &named.scene;
            tracing::debug!(peer = peer.0, %scene, place = place.0, "another server has the scene");
            let (bytes, code) = named.greeting.welcome_elsewhere(&place.0, role);
            self.out.push_back(Transmit::Control { to: peer, bytes });
            self.close(peer, code);
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

impl Dispatcher {
    /// Has a worker follow the scene of another server.
    fn prepare(&mut self, scene: SceneName) {
        if self.standbys.contains_key(&scene) || self.by_scene.contains_key(&scene) {
            return;
        }
        let account = Account::of(&scene, None);
        match self.place_worker((scene.clone(), account), Duty::StandBy) {
            Ok(id) => self.route(id, WorkerInput::Follow),
            Err(code) => tracing::error!(%scene, %code, "a scene cannot be followed"),
        }
    }

    /// A scene that was to come does not.
    fn forget(&mut self, scene: &SceneName) {
        tracing::info!(%scene, "a scene that was to come stays where it is");
        if let Some(id) = self.standbys.get(scene).copied() {
            self.drop_worker(id);
        }
        // Its clients may have come before it.
        if !self.asking_for(scene).is_empty()
            && let Some(directory) = &self.directory
        {
            directory.claim(scene);
        }
    }

    /// Has a worker give its scene up.
    fn leave(&mut self, scene: &SceneName, to: ServerPlace) {
        let id = self.by_scene.get(scene).copied();
        let Some((id, worker)) = id.and_then(|id| Some((id, self.workers.get_mut(&id)?))) else {
            return tracing::warn!(%scene, to = to.0, "a scene cannot move: it does not answer");
        };
        worker.duty = Duty::Leave(to.clone(), worker.sent + 1);
        self.route(id, WorkerInput::Move(to));
    }

    /// The server to which the scene of a worker goes.
    pub(super) fn goes_to(&self, scene: &SceneName) -> Option<ServerPlace> {
        let worker = self.workers.get(self.by_scene.get(scene)?)?;
        match &worker.duty {
            Duty::Leave(to, _) => Some(to.clone()),
            Duty::Serve | Duty::StandBy => None,
        }
    }

    /// Goes on with a move by what a worker has done.
    pub(super) fn note_handover(&mut self, id: WorkerId, (taken, is_ready): (u64, bool)) {
        let Some(worker) = self.workers.get_mut(&id) else {
            return;
        };
        match &worker.duty {
            Duty::StandBy if is_ready => {
                if let Some(directory) = &self.directory {
                    directory.ready(&worker.scene);
                }
            }
            // Its last output may be on its way in parts: its end follows them.
            Duty::Leave(_, by) if taken >= *by => self.route(id, WorkerInput::End),
            _ => {}
        }
    }

    /// True for a worker that gives its scene up.
    pub(super) fn has_left(&self, id: WorkerId) -> bool {
        let worker = self.workers.get(&id);
        worker.is_some_and(|worker| matches!(worker.duty, Duty::Leave(..)))
    }

    /// A worker has given its scene up, and has ended: another server may have the scene.
    pub(super) fn end_leaving(&mut self, id: WorkerId) {
        self.close_connections_of(id, CloseCode::SCENE_ELSEWHERE);
        let scene = self.workers.get(&id).map(|worker| worker.scene.clone());
        self.drop_worker(id);
        if let (Some(directory), Some(scene)) = (&self.directory, scene) {
            directory.release(&scene);
        }
    }
}
