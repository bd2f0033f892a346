//! An app that follows the scene of a server, and the truth beside it.
//!
//! The truth is another client, whose stream has every exact state.

use std::time::Duration;

use bevy_app::{App, Last, TaskPoolPlugin};
use bevy_ecs::prelude::*;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use bevy_transform::TransformPlugin;
use rhumb_bevy::{
    RhumbBodyId, RhumbClient, RhumbEnded, RhumbJoinFailed, RhumbMessage, RhumbPlugin,
};
use rhumb_client::{BodyId, Event, PipelineDepth};

/// Frames after which a test gives up; each may take a hundredth of a second.
const FRAMES_MAX: u32 = 3_000;
/// Time between two frames of an app that follows the server's clock.
const FRAME: Duration = Duration::from_millis(10);

/// Messages that an app has read.
#[derive(Default, Resource)]
pub(crate) struct Read {
    pub(crate) events: Vec<Event>,
    pub(crate) endings: Vec<String>,
    pub(crate) failures: Vec<String>,
}

fn read(
    mut read: ResMut<Read>,
    mut events: MessageReader<RhumbMessage>,
    mut endings: MessageReader<RhumbEnded>,
    mut failures: MessageReader<RhumbJoinFailed>,
) {
    read.events
        .extend(events.read().map(|message| message.event.clone()));
    read.endings
        .extend(endings.read().map(|message| message.error.to_string()));
    read.failures
        .extend(failures.read().map(|message| message.error.to_string()));
}

/// An app without a window that has the plug-in. Each update of it takes one fixed step, a sixtieth of a second.
pub(crate) fn app(depth: PipelineDepth) -> App {
    let mut app = App::new();
    let step = Duration::from_secs_f64(1.0 / 60.0);
    app.add_plugins((
        TaskPoolPlugin::default(),
        TimePlugin,
        TransformPlugin,
        RhumbPlugin { depth },
    ))
    .insert_resource(Time::<Fixed>::from_duration(step))
    .insert_resource(TimeUpdateStrategy::ManualDuration(step))
    .init_resource::<Read>()
    .add_systems(Last, read);
    // The first update has no time in it.
    app.update();
    app
}

/// The app's scene.
pub(crate) fn rhumb(app: &mut App) -> Mut<'_, RhumbClient> {
    app.world_mut().resource_mut::<RhumbClient>()
}

pub(crate) fn messages(app: &App) -> &Read {
    app.world().resource::<Read>()
}

/// The entity of a body, if it has one.
pub(crate) fn entity(app: &mut App, id: BodyId) -> Option<Entity> {
    let mut bodies = app.world_mut().query::<(Entity, &RhumbBodyId)>();
    let mut found = bodies.iter(app.world()).filter(|(_, body)| body.id() == id);
    let entity = found.next().map(|(entity, _)| entity);
    assert!(found.next().is_none(), "one entity for a body");
    entity
}

/// The value of a component of a body's entity.
pub(crate) fn component<T: Component + Copy>(app: &mut App, id: BodyId) -> T {
    let entity = entity(app, id).expect("the body has an entity");
    *app.world()
        .get::<T>(entity)
        .expect("the entity has the component")
}

/// Updates an app, with time for the server between its frames, until something holds.
pub(crate) fn run_until(app: &mut App, what: &str, mut holds: impl FnMut(&mut App) -> bool) {
    for _ in 0..FRAMES_MAX {
        app.update();
        if holds(app) {
            return;
        }
        pass(app);
    }
    panic!("not in {FRAMES_MAX} frames: {what}");
}

/// Passes the time of a frame.
fn pass(app: &mut App) {
    match app.world_mut().get_resource_mut::<RhumbClient>() {
        // A client that has ended returns at once, and has nothing to wait for.
        Some(mut rhumb) if !rhumb.is_ended() => {
            let _ended = rhumb.inner().idle(FRAME);
        }
        _ => std::thread::yield_now(),
    }
}
