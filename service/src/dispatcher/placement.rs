//! Connections whose scene may be another server's: it is asked for first.
//!
//! A scene that has a worker is this server's, unless the worker stands by for a scene that is to come. Invariants: a worker
//! serves only what the directory has given this server, in the files of that claim; from the moment at which its lease may be
//! over, nothing of any scene leaves this server, and its workers end; their scenes continue elsewhere, or here under the
//! next lease.

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Peer, Transmit};

use super::accounts::Account;
use super::message::{Duty, WorkerId, WorkerInput};
use super::{Connection, Dispatcher, NamedScene};
use crate::directory::{DirectoryEvent, HandoverStep, Keeper, ServerPlace};
use crate::durable::{Generation, LogTail};

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

    /// Takes what the directory has said. Returns the moment from which nothing may be published, as it was before: if that is
    /// of another lease already, the end of the one before it is among what was said.
    pub(super) fn take_places(&mut self) -> Option<Instant> {
        let until = self.directory.as_ref().map(Keeper::publishes_until);
        while let Some(event) = self.directory.as_ref().and_then(Keeper::poll_event) {
            match event {
                DirectoryEvent::Owned(scene, generation) => {
                    if self.owned.give(&scene, generation) {
                        self.serve(&scene);
                    }
                }
                DirectoryEvent::Released(scene) => self.owned.note_released(&scene),
                DirectoryEvent::Elsewhere(scene, place) => {
                    for peer in self.asking_for(&scene) {
                        self.send_on(peer, &place);
                    }
                }
                DirectoryEvent::Unknown(scene) => {
                    for peer in self.asking_for(&scene) {
                        self.close(peer, CloseCode::BUSY);
                    }
                }
                DirectoryEvent::Lost => self.lose_scenes(),
                DirectoryEvent::Handover(HandoverStep::Prepare(scene)) => self.prepare(scene),
                DirectoryEvent::Handover(HandoverStep::Forget(scene)) => self.forget(&scene),
                DirectoryEvent::Handover(HandoverStep::Leave(scene, to)) => {
                    self.leave(&scene, to);
                }
            }
        }
        until
    }

    /// Ends everything that is published without a lease. `until`: the moment from which that is so, as it was before the
    /// directory's events were taken.
    pub(super) fn keep_fence(&mut self, until: Option<Instant>) {
        let (Some(directory), Some(until)) = (&self.directory, until) else {
            return;
        };
        if !self.workers.is_empty() && !directory.is_before(until) {
            self.lose_scenes();
        }
    }

    /// Gives a scene up, if it is this server's.
    pub(super) fn release(&mut self, scene: &SceneName) {
        if self.owned.release(scene)
            && let Some(directory) = &self.directory
        {
            directory.release(scene);
        }
    }

    /// The number of a scene's files with a directory; an error if that does not give this server the scene.
    pub(super) fn generation_of(&self, scene: &SceneName) -> Result<Option<Generation>, CloseCode> {
        let generation = self.owned.generation(scene);
        if self.directory.is_some() && generation.is_none() {
            tracing::error!(%scene, "the directory does not give this server the scene");
            return Err(CloseCode::BUSY);
        }
        Ok(generation)
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
            let generation = self.owned.generation(scene);
            self.route(id, WorkerInput::Restore(LogTail::Kept, generation));
        }
        for peer in self.asking_for(scene) {
            if let Some(Connection::Asking(named)) = self.connections.remove(&peer) {
                self.connections.insert(peer, Connection::Closed);
                self.bind(now, peer, *named);
            }
        }
        if self.must_ask(scene) {
            // Its clients have gone, or it can have no worker here.
            self.release(scene);
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
        // A worker that hangs ends by itself, and its scene does not come back from the files.
        self.by_scene.clear();
        self.owned.lose();
    }
}

impl Dispatcher {
    /// Tells a worker to follow the scene of another server.
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

    /// Gives a move to this server up: the scene stays where it is.
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

    /// Tells a worker to give its scene up.
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

    /// Continues a move once a worker has done its part.
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
        if let Some(scene) = scene {
            self.release(&scene);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use rhumb_protocol::Endpoint;
    use rhumb_protocol::message::{ClientMessage, Extensions, VERSIONS};

    use super::*;
    use crate::directory::Puppet;
    use crate::dispatcher::DispatcherSettings;
    use crate::durable::DataDir;

    const NOW: Instant = Instant::from_nanos(1_000_000_000);

    fn pit() -> SceneName {
        "pit".parse().unwrap()
    }

    fn dispatcher(data: Option<DataDir>) -> (Dispatcher, Puppet) {
        let mut settings = DispatcherSettings::new(|| NOW);
        settings.data = data;
        let mut dispatcher = Dispatcher::new(settings, || {});
        let (keeper, puppet) = Puppet::new(NOW);
        dispatcher.ask_directory(keeper);
        puppet
            .until
            .store(NOW.since(Instant::ZERO).as_nanos() * 2, Ordering::SeqCst);
        (dispatcher, puppet)
    }

    fn say_hello(dispatcher: &mut Dispatcher, peer: Peer) {
        dispatcher.handle_opened(NOW, peer);
        let mut bytes = Vec::new();
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: pit(),
            extensions: Extensions::NONE,
        };
        hello.encode(&mut bytes);
        dispatcher.handle_control(NOW, peer, &bytes);
    }

    #[test]
    fn packets_of_a_lease_that_ended_unseen_do_not_leave_under_the_next_one() {
        let (mut dispatcher, puppet) = dispatcher(None);
        say_hello(&mut dispatcher, Peer(1));
        let owned = DirectoryEvent::Owned(pit(), Generation(5));
        puppet.events.send(owned).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        assert_eq!(dispatcher.workers.len(), 1);
        let state = Transmit::Control {
            to: Peer(1),
            bytes: b"state"[..].into(),
        };
        dispatcher.out.push_back(state);
        puppet.events.send(DirectoryEvent::Lost).unwrap();
        puppet.until.fetch_add(1, Ordering::SeqCst);
        let code = CloseCode::SCENE_RESTORING.0;
        let close = Transmit::Close { to: Peer(1), code };
        assert_eq!(dispatcher.poll_transmit(), Some(close));
        assert_eq!(dispatcher.poll_transmit(), None);
    }

    #[test]
    fn a_quarantined_scene_whose_lease_ends_does_not_come_back_by_itself() {
        let directory = tempfile::tempdir().unwrap();
        let data = DataDir::open_shared(directory.path()).unwrap();
        let (mut dispatcher, puppet) = dispatcher(Some(data));
        let id = WorkerId(77);
        assert!(dispatcher.owned.give(&pit(), Generation(5)));
        dispatcher.by_scene.insert(pit(), id);
        let quarantined = &mut dispatcher.watchdog.quarantined;
        quarantined.insert(id, (pit(), None));
        puppet.events.send(DirectoryEvent::Lost).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        assert!(dispatcher.must_ask(&pit()));
        dispatcher.note_over(id);
        assert!(dispatcher.workers.is_empty());
    }

    #[test]
    fn the_end_of_a_quarantined_worker_leaves_the_next_one_of_its_scene_alone() {
        let (mut dispatcher, puppet) = dispatcher(None);
        let old = WorkerId(77);
        let quarantined = &mut dispatcher.watchdog.quarantined;
        quarantined.insert(old, (pit(), None));
        say_hello(&mut dispatcher, Peer(1));
        let owned = DirectoryEvent::Owned(pit(), Generation(6));
        puppet.events.send(owned).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        dispatcher.note_over(old);
        assert!(!dispatcher.must_ask(&pit()));
        assert_eq!(dispatcher.workers.len(), 1);
    }

    #[test]
    fn a_scene_that_can_have_no_worker_is_given_up() {
        let (mut dispatcher, mut puppet) = dispatcher(None);
        dispatcher.settings.scenes.limits.quarantined_scenes = 0;
        say_hello(&mut dispatcher, Peer(1));
        let owned = DirectoryEvent::Owned(pit(), Generation(5));
        puppet.events.send(owned).unwrap();
        let code = CloseCode::BUSY.0;
        let close = Transmit::Close { to: Peer(1), code };
        assert_eq!(dispatcher.poll_transmit(), Some(close));
        assert_eq!(puppet.released(), [pit()]);
    }

    #[test]
    fn what_was_said_before_a_scene_was_given_up_gives_it_to_no_worker() {
        let (mut dispatcher, mut puppet) = dispatcher(None);
        let owned = |generation| DirectoryEvent::Owned(pit(), Generation(generation));
        puppet.events.send(owned(5)).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        assert_eq!(puppet.released(), [pit()], "no client waits for it");
        say_hello(&mut dispatcher, Peer(1));
        puppet.events.send(owned(5)).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        assert!(dispatcher.workers.is_empty());
        puppet.events.send(DirectoryEvent::Released(pit())).unwrap();
        puppet.events.send(owned(6)).unwrap();
        assert_eq!(dispatcher.poll_transmit(), None);
        assert_eq!(dispatcher.workers.len(), 1);
    }
}
