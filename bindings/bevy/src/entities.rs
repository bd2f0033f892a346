//! The entities of a scene's bodies: spawned, moved and despawned.
//!
//! An entity that the application has despawned is left alone; its body lives on.

use bevy_ecs::entity::Entity;
use bevy_ecs::query::{With, Without};
use bevy_ecs::system::{Commands, Query, SystemParam};
use bevy_transform::components::Transform;
use rhumb_bindings::ObjectChange;
use rhumb_client::BodyId;
use rhumb_client::scene::Stepping;

use crate::body::{RhumbBodyId, RhumbState};
use crate::client::RhumbClient;
use crate::interpolation::PoseBefore;

/// Access to the entities of bodies.
#[derive(SystemParam)]
pub(crate) struct BodyEntities<'w, 's> {
    commands: Commands<'w, 's>,
    shown: Query<'w, 's, Entity, With<RhumbBodyId>>,
    states: Query<
        'w,
        's,
        (
            &'static mut RhumbState,
            &'static mut Transform,
            Option<&'static PoseBefore>,
        ),
    >,
    /// Of the application's own entities.
    others: Query<'w, 's, &'static Transform, Without<RhumbState>>,
}

impl BodyEntities<'_, '_> {
    /// Makes the entities show the view of the scene's client.
    pub(crate) fn follow(&mut self, client: &mut RhumbClient) {
        if client.is_new() {
            // The app may have had another scene before.
            self.despawn_all();
        }
        for change in client.changes() {
            match change {
                ObjectChange::Destroy(entity) => self.despawn(entity),
                ObjectChange::Show(record) => {
                    let (id, state) = (record.body, RhumbState::of(&record));
                    match client.entity(id) {
                        Some(entity) => self.show(entity, state),
                        None => self.spawn(client, id, state),
                    }
                }
            }
        }
    }

    /// Despawns the entity of the application that waits for a body. The body is gone, and was never shown.
    pub(crate) fn despawn_reserved(&mut self, client: &mut RhumbClient, id: BodyId) {
        if let Some(entity) = client.take_reserved(id) {
            self.despawn(entity);
        }
    }

    /// Despawns the entities of all bodies.
    pub(crate) fn despawn_all(&mut self) {
        for entity in &self.shown {
            self.commands.entity(entity).try_despawn();
        }
    }

    fn despawn(&mut self, entity: Entity) {
        if let Ok(mut entity) = self.commands.get_entity(entity) {
            entity.try_despawn();
        }
    }

    fn show(&mut self, entity: Entity, state: RhumbState) {
        let Ok((mut known, mut transform, before)) = self.states.get_mut(entity) else {
            return;
        };
        *known = state;
        // In a lockstep scene the frame writes it, between this state and the one before.
        if before.is_none() {
            transform.translation = state.position;
            transform.rotation = state.rotation;
        }
    }

    /// Gives a body its entity.
    fn spawn(&mut self, client: &mut RhumbClient, id: BodyId, state: RhumbState) {
        let reserved = client.take_reserved(id);
        let scaled = reserved.and_then(|entity| self.others.get(entity).ok());
        let transform = Transform {
            translation: state.position,
            rotation: state.rotation,
            ..scaled.copied().unwrap_or_default()
        };
        let mut entity = match reserved {
            None => self.commands.spawn_empty(),
            Some(entity) => match self.commands.get_entity(entity) {
                Ok(commands) => commands,
                // The application has despawned it meanwhile, which hides the body.
                Err(_) => return client.set_entity(id, entity),
            },
        };
        client.set_entity(id, entity.id());
        entity.try_insert((RhumbBodyId::new(id), state, transform));
        if client.stepping() == Stepping::Lockstep {
            entity.try_insert(PoseBefore::of(&state));
        }
    }
}
