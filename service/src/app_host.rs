//! The server as the host of APP clients.
//!
//! Compiled by the feature `app`. The protocol, its sockets and its clients are in `rhumb-app`.

use core::net::SocketAddr;

use glam::Vec3;
use rhumb_app::{
    AppBindError, AppHost, AppListen, AppListener, AppOptions, AppScene, AppServer, Bulk, Geometry,
};
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{
    BodyDesc, Command, CommandError, Contact, IdRange, Joints, SceneConfig, SceneName, Shape,
    ShapeId,
};
use rhumb_protocol::stream::Observation;
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::BodyId;
use rhumb_scene::engine;
use rhumb_scene::{OwnedScene, SceneRouter};

use crate::dispatcher::AdapterQueue;
use crate::serve::Server;

/// The scenes of a router, for APP clients.
pub struct AppScenes<'a>(pub &'a mut SceneRouter);

/// A scene under the commands of its owner.
struct Owned<'a>(OwnedScene<'a>);

impl Server {
    /// Listens for APP clients too, and returns the address.
    ///
    /// # Errors
    ///
    /// [`AppBindError`] for an address that cannot be used.
    pub fn listen_app(
        &mut self,
        listen: AppListen,
        options: AppOptions,
    ) -> Result<SocketAddr, AppBindError> {
        let queue = AdapterQueue::new();
        let waker = queue.waker();
        let mut listener = AppListener::open(listen, move || waker.wake())?;
        let address = listener.address();
        let mut clients = AppServer::new(options);
        self.serve_also(queue.into_adapter(move |router| {
            listener.serve(&mut clients, &mut AppScenes(router));
        }));
        Ok(address)
    }
}

impl Geometry for AppScenes<'_> {
    fn bulk(&self, shape: &Shape) -> Option<Bulk> {
        let engine::ShapeVolume { centre, volume } = engine::shape_volume(shape).ok()?;
        Some(Bulk { centre, volume })
    }
}

impl AppHost for AppScenes<'_> {
    fn begin_scene(
        &mut self,
        owner: Peer,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<IdRange, Denial> {
        self.0.begin_owned(owner, name, config)
    }

    fn end_scene(&mut self, name: &SceneName) {
        self.0.end_owned(name);
    }

    fn scene(&mut self, owner: Peer, name: &SceneName) -> Option<Box<dyn AppScene + '_>> {
        Some(Box::new(Owned(self.0.owned(owner, name)?)))
    }
}

impl AppScene for Owned<'_> {
    fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        self.0.command(command)
    }

    fn step(&mut self) {
        self.0.step();
    }

    fn is_faulted(&self) -> bool {
        self.0.is_faulted()
    }

    fn now(&self) -> Instant {
        self.0.now()
    }

    fn note_reporting(&mut self, took: Span) {
        self.0.note_reporting(took);
    }

    fn gravity(&self) -> Vec3 {
        self.0.scene().gravity()
    }

    fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.0.scene().shape(id)
    }

    fn joints(&self) -> &Joints {
        self.0.scene().joints()
    }

    fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        self.0.scene().body(id)
    }

    fn observations(&self) -> &[Observation] {
        self.0.scene().observations()
    }

    fn observation(&self, id: BodyId) -> Option<Observation> {
        self.0.scene().observation(id)
    }

    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        self.0.scene().contacts(id, out);
    }
}
