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

use crate::engine::bulk;
use crate::front::AdapterQueue;
use crate::outbox::Outbox;
use crate::scene_runner::{SceneRunner, Stopwatch};
use crate::serve::Server;
use crate::server_loop::ServerLoop;

/// A scene under the commands of its owner.
struct OwnedScene<'a> {
    runner: &'a mut SceneRunner,
    owner: Peer,
    clock: Stopwatch<'a>,
    out: &'a mut Outbox,
}

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
        self.serve_also(queue.into_adapter(move |server_loop| {
            listener.serve(&mut clients, server_loop);
        }));
        Ok(address)
    }
}

impl Geometry for ServerLoop {
    fn bulk(&self, shape: &Shape) -> Option<Bulk> {
        bulk(shape).ok()
    }
}

impl AppHost for ServerLoop {
    fn begin_scene(
        &mut self,
        owner: Peer,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<IdRange, Denial> {
        let own_indices = self.create(name, config)?.give_to(owner);
        match own_indices {
            Ok(_) => self.note_empty(name),
            Err(_) => self.delete_scene(name),
        }
        own_indices
    }

    fn end_scene(&mut self, name: &SceneName) {
        self.delete_scene(name);
    }

    fn scene(&mut self, owner: Peer, name: &SceneName) -> Option<Box<dyn AppScene + '_>> {
        Some(Box::new(OwnedScene {
            runner: self.runners.get_mut(name)?,
            owner,
            clock: &self.stopwatch,
            out: &mut self.out,
        }))
    }
}

impl AppScene for OwnedScene<'_> {
    fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        self.runner.command_of_owner(self.owner, command)
    }

    fn step(&mut self) {
        self.runner.step_for_owner(self.clock, self.out);
    }

    fn is_faulted(&self) -> bool {
        self.runner.is_faulted()
    }

    fn now(&self) -> Instant {
        (self.clock)()
    }

    fn note_reporting(&mut self, took: Span) {
        self.runner.note_reporting(took);
    }

    fn gravity(&self) -> Vec3 {
        self.runner.scene().gravity()
    }

    fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.runner.scene().shape(id)
    }

    fn joints(&self) -> &Joints {
        self.runner.scene().joints()
    }

    fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        self.runner.scene().body(id)
    }

    fn observations(&self) -> &[Observation] {
        self.runner.scene().observations()
    }

    fn observation(&self, id: BodyId) -> Option<Observation> {
        self.runner.scene().observation(id)
    }

    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        self.runner.scene().contacts(id, out);
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use rhumb_app::{AppTransmit, Logon, Message};
    use rhumb_protocol::message::RemovalCause;
    use rhumb_protocol::scene::{
        Answer, BodyEvent, Joint, JointId, JumpFrom, Locomotion, Query, WheelInput,
    };
    use rhumb_protocol::stream::Activity;
    use rhumb_reckoning::{BodyState, Inertia, Twist};

    use super::*;
    use crate::Limits;
    use crate::engine::{
        BodyProperties, Engine, EngineFault, Push, UnanswerableQuery, UnusableShape,
    };
    use crate::scene::Scene;
    use crate::scene_runner::Provision;
    use crate::stream_names::StreamNames;

    /// An engine that fails in its first step.
    struct Failing;

    impl Engine for Failing {
        fn add_shape(&mut self, _: ShapeId, _: &Shape) -> Result<(), UnusableShape> {
            Ok(())
        }

        fn remove_shape(&mut self, _: ShapeId) {}
        fn add_joint(&mut self, _: JointId, _: &Joint) {}
        fn remove_joint(&mut self, _: JointId) {}
        fn add(&mut self, _: &BodyProperties, _: BodyState) {}
        fn change(&mut self, _: &BodyDesc, _: &BodyProperties) {}
        fn set_activity(&mut self, _: BodyId, _: Activity) {}
        fn overloaded_joints(&self, _: &mut Vec<JointId>) {}
        fn set_locomotion(&mut self, _: BodyId, _: &Locomotion) {}
        fn jump(&mut self, _: BodyId, _: f32, _: JumpFrom) {}
        fn set_wheels(&mut self, _: BodyId, _: &[WheelInput]) {}
        fn ground_events(&self, _: &mut Vec<BodyEvent>) {}
        fn remove(&mut self, _: BodyId) {}
        fn set_pose(&mut self, _: BodyId, _: Vec3, _: Quat) {}
        fn set_velocity(&mut self, _: BodyId, _: Twist) {}
        fn push(&mut self, _: BodyId, _: Push) {}
        fn set_gravity(&mut self, _: Vec3) {}

        fn step(&mut self, _: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
            Err(EngineFault::Panicked)
        }

        fn observe(&self, _: &mut Vec<Observation>) {}

        fn observe_one(&self, _: BodyId) -> Option<Observation> {
            None
        }

        fn inertia(&self, _: BodyId) -> Option<Inertia> {
            None
        }

        fn contacts(&self, _: BodyId, _: &mut Vec<Contact>) {}
        fn sensed(&self, _: BodyId, _: &mut Vec<(BodyId, BodyId)>) {}

        fn query(&self, _: &Query) -> Result<Answer, UnanswerableQuery> {
            Err(UnanswerableQuery)
        }

        fn awake_count(&self) -> usize {
            0
        }

        fn fault(&self) -> Option<EngineFault> {
            None
        }
    }

    const FRAME: Message = Message::AdvanceTime((7, 0.089));

    /// A server with its APP clients.
    struct Host {
        server_loop: ServerLoop,
        app: AppServer,
    }

    impl Host {
        fn send(&mut self, peer: Peer, message: &Message) {
            let mut bytes = Vec::new();
            message.encode(0, &mut bytes);
            self.app
                .handle_bytes(&mut self.server_loop, peer, &bytes, 0);
        }

        /// Connects a client that logs on and sends a frame.
        fn begin(&mut self, peer: Peer) {
            let from = SocketAddr::from(([127, 0, 0, 1], 40_000));
            self.app.handle_opened(peer, from);
            self.send(peer, &Message::Logon(Logon::new(7, "x")));
            self.send(peer, &FRAME);
        }

        /// Connections that the server closes, of all its transmissions.
        fn closed(&mut self) -> Vec<Peer> {
            let transmits = core::iter::from_fn(|| self.app.poll_transmit());
            let closed = transmits.filter_map(|transmit| match transmit {
                AppTransmit::Close { to } => Some(to),
                _ => None,
            });
            closed.collect()
        }
    }

    #[test]
    fn an_engine_fault_closes_the_owning_client_which_may_return() {
        let mut host = Host {
            server_loop: ServerLoop::new(|| Instant::ZERO),
            app: AppServer::default(),
        };
        let [first, second] = [1, 2].map(Peer);
        host.begin(first);
        assert_eq!(host.closed(), []);
        let mut runners = host.server_loop.runners.iter_mut();
        let (_, runner) = runners.next().expect("its scene");
        let broken = Scene::with_engine(*runner.config(), Box::new(Failing)).expect("same config");
        *runner = SceneRunner::new(broken, StreamNames::of_scene(0), Provision::unbounded());
        assert!(runner.give_to(first).is_ok());
        host.send(first, &FRAME);
        assert_eq!(host.closed(), [first]);
        assert_eq!(host.server_loop.scenes().count(), 0);
        // The old connection is still closing when the client comes again.
        host.begin(second);
        host.send(second, &FRAME);
        assert_eq!(host.closed(), []);
        assert_eq!(host.server_loop.scenes().count(), 1);
    }

    #[test]
    fn a_scene_whose_owner_gets_no_indices_is_not_kept() {
        let mut server_loop = ServerLoop::new(|| Instant::ZERO);
        server_loop.set_limits(Limits {
            indices_per_scene: 4_096,
            ..Limits::default()
        });
        let name = "app/7".parse().expect("a good name");
        let begun = server_loop.begin_scene(Peer(1), &name, SceneConfig::default());
        assert_eq!(begun, Err(Denial::NoIndicesLeft));
        assert_eq!(server_loop.scenes().count(), 0);
    }
}
