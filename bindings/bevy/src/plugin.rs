//! The plug-in: its systems, and where they run.

use bevy_app::{
    App, FixedUpdate, Last, Plugin, PreUpdate, RunFixedMainLoop, RunFixedMainLoopSystems,
};
use bevy_ecs::change_detection::DetectChangesMut as _;
use bevy_ecs::message::MessageWriter;
use bevy_ecs::resource::Resource;
use bevy_ecs::schedule::common_conditions::{resource_exists, resource_removed};
use bevy_ecs::schedule::{IntoScheduleConfigs as _, SystemCondition as _, SystemSet};
use bevy_ecs::system::{Query, Res, ResMut};
use bevy_time::{Fixed, Time};
use rhumb_client::PipelineDepth;
use rhumb_client::scene::Stepping;
use tracing::{error, warn};

use crate::client::{
    RhumbClient, RhumbEnded, RhumbJoin, RhumbJoinFailed, RhumbMessage, finish_join,
};
use crate::entities::{BodyEntities, RhumbBodyId, RhumbErrorBound, begin_step, interpolate};

/// Follows the scene of the resource [`RhumbClient`], if there is one.
#[derive(Clone, Copy, Debug)]
pub struct RhumbPlugin {
    /// Published ticks by which a lockstep scene may be ahead of its view. At [`PipelineDepth::LOCKSTEP`] each fixed step
    /// waits for its tick, at most for the client's time limit. Any other depth never waits; the default is
    /// [`PipelineDepth::PIPELINED`].
    pub depth: PipelineDepth,
}

impl Default for RhumbPlugin {
    fn default() -> Self {
        Self {
            depth: PipelineDepth::PIPELINED,
        }
    }
}

/// Sets of the plug-in's systems, for systems that must run before or after them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, SystemSet)]
pub enum RhumbSystems {
    /// Computes the next view, writes messages, and spawns, moves and despawns entities: in `PreUpdate` for a free-running
    /// scene, in `FixedUpdate` for a lockstep scene.
    Advance,
    /// Writes the transforms of a lockstep scene's bodies for the frame's moment, in `RunFixedMainLoop`.
    Draw,
    /// Sends the commands of the frame, in `Last`.
    Send,
}

/// The plug-in's depth.
#[derive(Clone, Copy, Debug, Resource)]
struct StepDepth(PipelineDepth);

impl Plugin for RhumbPlugin {
    fn build(&self, app: &mut App) {
        let free_running = resource_exists::<RhumbClient>.and_then(steps_by(Stepping::FreeRunning));
        let lockstep = resource_exists::<RhumbClient>.and_then(steps_by(Stepping::Lockstep));
        app.insert_resource(StepDepth(self.depth))
            .add_message::<RhumbMessage>()
            .add_message::<RhumbEnded>()
            .add_message::<RhumbJoinFailed>()
            .add_systems(
                PreUpdate,
                (
                    despawn_all.run_if(resource_removed::<RhumbClient>),
                    finish_join.run_if(resource_exists::<RhumbJoin>),
                )
                    .chain()
                    .before(RhumbSystems::Advance),
            )
            .add_systems(
                PreUpdate,
                (advance, write_bounds)
                    .chain()
                    .in_set(RhumbSystems::Advance)
                    .run_if(free_running),
            )
            .add_systems(
                FixedUpdate,
                (check_time_step, begin_step, advance, write_bounds)
                    .chain()
                    .in_set(RhumbSystems::Advance)
                    .run_if(lockstep),
            )
            .add_systems(
                RunFixedMainLoop,
                interpolate
                    .in_set(RunFixedMainLoopSystems::AfterFixedMainLoop)
                    .in_set(RhumbSystems::Draw)
                    .run_if(resource_exists::<Time<Fixed>>),
            )
            .add_systems(
                Last,
                send.in_set(RhumbSystems::Send)
                    .run_if(resource_exists::<RhumbClient>),
            );
    }
}

fn steps_by(stepping: Stepping) -> impl Fn(Res<'_, RhumbClient>) -> bool + Clone {
    move |client: Res<'_, RhumbClient>| client.stepping() == stepping
}

/// Says once for a scene that a fixed step does not take the time of a tick.
fn check_time_step(client: Res<'_, RhumbClient>, time: Res<'_, Time<Fixed>>) {
    let (tick, step) = (
        client.fixed_step().as_secs_f64(),
        time.timestep().as_secs_f64(),
    );
    if client.is_new() && !client.is_ended() && (step / tick - 1.0).abs() > 1e-3 {
        warn!(
            "a fixed step of the app takes {step} s, a tick of the scene {tick} s: the scene runs {} times as fast as \
             it should; use Time::<Fixed>::from_duration(client.fixed_step())",
            tick / step
        );
    }
}

fn advance(
    mut client: ResMut<'_, RhumbClient>,
    depth: Res<'_, StepDepth>,
    mut entities: BodyEntities<'_, '_>,
    mut events: MessageWriter<'_, RhumbMessage>,
    mut endings: MessageWriter<'_, RhumbEnded>,
) {
    if client.is_ended() {
        return;
    }
    let advanced = client.advance(depth.0);
    let mut gone = Vec::new();
    while let Some((after, event)) = client.inner().poll_event() {
        gone.extend(client.note(&event));
        events.write(RhumbMessage { after, event });
    }
    if let Some(refused) = client.take_refused() {
        error!("{refused}");
    }
    match advanced {
        Ok(true) => entities.follow(&mut client),
        Ok(false) => {}
        Err(error) => {
            client.end();
            endings.write(RhumbEnded { error });
        }
    }
    for id in gone {
        entities.despawn_reserved(&mut client, id);
    }
}

fn write_bounds(
    mut client: ResMut<'_, RhumbClient>,
    mut bodies: Query<'_, '_, (&RhumbBodyId, &mut RhumbErrorBound)>,
) {
    for (body, mut bound) in &mut bodies {
        bound.set_if_neq(RhumbErrorBound::of(client.error_bound(body.id())));
    }
}

fn send(mut client: ResMut<'_, RhumbClient>) {
    if !client.is_ended() {
        client.inner().flush();
    }
}

fn despawn_all(mut entities: BodyEntities<'_, '_>) {
    entities.despawn_all();
}
