//! Scenes and geometry, as the APP server needs them of its host.
//!
//! The interface between this protocol and a server with an engine.

use glam::Vec3;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{
    BodyDesc, Command, CommandError, Contact, IdRange, Joints, SceneConfig, SceneName, Shape,
    ShapeId,
};
use rhumb_protocol::stream::Observation;
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::BodyId;

/// Mass properties of a shape with volume, at density one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bulk {
    /// Centre of mass in the shape's coordinates, metres.
    pub centre: Vec3,
    /// Volume, m³.
    pub volume: f32,
}

/// Solids, as the host's engine computes them.
pub trait Geometry {
    /// Mass properties of a shape; `None` if the engine cannot make a solid of it.
    fn bulk(&self, shape: &Shape) -> Option<Bulk>;
}

/// A server with scenes.
pub trait AppHost: Geometry {
    /// Creates a scene that this client owns: it alone steps and ends it. Returns the index range of its bodies.
    ///
    /// # Errors
    ///
    /// [`Denial`] if no such scene can be created.
    fn begin_scene(
        &mut self,
        owner: Peer,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<IdRange, Denial>;

    /// Ends a scene.
    fn end_scene(&mut self, name: &SceneName);

    /// A scene under the commands of its owner.
    fn scene(&mut self, owner: Peer, name: &SceneName) -> Option<Box<dyn AppScene + '_>>;
}

/// A scene, as its owner commands and reads it.
pub trait AppScene {
    /// Applies a command; other members learn of it with the next tick.
    ///
    /// # Errors
    ///
    /// [`CommandError`] names the reason; nothing has changed.
    fn command(&mut self, command: &Command) -> Result<(), CommandError>;

    /// Steps once and publishes the tick.
    fn step(&mut self);

    /// True if the engine failed: the scene takes no more steps.
    fn is_faulted(&self) -> bool;

    /// The present moment, to measure time.
    fn now(&self) -> Instant;

    /// Adds the time of a report to the owner: it counts as publishing.
    fn note_reporting(&mut self, took: Span);

    /// Gravity, m/s².
    fn gravity(&self) -> Vec3;

    /// The shape of this id.
    fn shape(&self, id: ShapeId) -> Option<&Shape>;

    /// All joints.
    fn joints(&self) -> &Joints;

    /// The description of a body that exists.
    fn body(&self, id: BodyId) -> Option<&BodyDesc>;

    /// Bodies that moved in the last step, or came to rest.
    fn observations(&self) -> &[Observation];

    /// The present observation of a body.
    fn observation(&self, id: BodyId) -> Option<Observation>;

    /// Adds the deepest contact with each body that touches this one.
    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>);
}
