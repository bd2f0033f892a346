//! Meshes, colours, a light and a camera for the bodies of a scene.

use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::prelude::*;
use rhumb_bevy::{RhumbBodyId, RhumbClient};
use rhumb_client::scene::Shape;

/// Hues of the balls, degrees.
const HUES: [f32; 6] = [5.0, 35.0, 50.0, 150.0, 205.0, 270.0];

/// Gives new bodies a mesh by their shapes.
pub(crate) fn draw_new_bodies(
    client: Option<ResMut<RhumbClient>>,
    added: Query<(Entity, &RhumbBodyId), Added<RhumbBodyId>>,
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let Some(mut client) = client else {
        return;
    };
    for (entity, body) in &added {
        let Some((mesh, color)) = client.shape(body.id()).and_then(|shape| drawn(shape, body))
        else {
            warn!(
                "{:?} has a shape that this example does not draw",
                body.id()
            );
            continue;
        };
        commands.entity(entity).insert((
            Mesh3d(meshes.add(mesh)),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: color,
                perceptual_roughness: 0.6,
                ..default()
            })),
        ));
    }
}

fn drawn(shape: &Shape, body: &RhumbBodyId) -> Option<(Mesh, Color)> {
    let hue = HUES[body.id().index() as usize % HUES.len()];
    match shape {
        Shape::Ball { radius } => Some((
            Sphere::new(*radius).mesh().uv(24, 16),
            Color::hsl(hue, 0.75, 0.5),
        )),
        Shape::Cuboid { half_extents } => {
            let edges = 2.0 * Vec3::from_array(half_extents.to_array());
            Some((
                Cuboid::from_size(edges).into(),
                Color::srgb(0.55, 0.58, 0.62),
            ))
        }
        _ => None,
    }
}

/// Places the camera and the light.
pub(crate) fn look_into_the_pit(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        Tonemapping::None,
        Transform::from_xyz(0.0, 11.0, 15.0).looking_at(Vec3::new(0.0, 1.5, 0.0), Vec3::Y),
    ));
    commands.spawn((
        DirectionalLight {
            illuminance: 9_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(6.0, 14.0, 8.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}
