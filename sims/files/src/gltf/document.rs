//! The JSON text of a glTF file, as far as it is read or listed.

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Map, Value};

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    pub(super) asset: Asset,
    pub(super) extensions_required: Vec<String>,
    pub(super) extensions_used: Vec<String>,
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<Scene>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<Mesh>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) buffer_views: Vec<BufferView>,
    pub(super) buffers: Vec<Buffer>,
    pub(super) animations: Vec<IgnoredAny>,
    pub(super) skins: Vec<IgnoredAny>,
    pub(super) cameras: Vec<IgnoredAny>,
    pub(super) materials: Vec<IgnoredAny>,
    pub(super) images: Vec<IgnoredAny>,
    pub(super) extensions: Extensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    pub(super) version: String,
    #[serde(rename = "minVersion")]
    pub(super) min_version: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    pub(super) name: String,
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) name: String,
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    pub(super) extensions: NodeExtensions,
    pub(super) extras: Value,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    pub(super) name: String,
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<usize>,
    pub(super) mode: Option<u32>,
    pub(super) targets: Vec<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub(super) position: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) sparse: Option<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    pub(super) byte_length: usize,
}

/// Extensions of the file.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Extensions {
    #[serde(rename = "KHR_implicit_shapes")]
    pub(super) shapes: Shapes,
    #[serde(rename = "KHR_physics_rigid_bodies")]
    pub(super) physics: Option<Physics>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Shapes {
    pub(super) shapes: Vec<Shape>,
}

/// A shape without triangles; of the parts the one of its type.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Shape {
    #[serde(rename = "type")]
    pub(super) kind: String,
    #[serde(rename = "box")]
    pub(super) cuboid: Cuboid,
    pub(super) sphere: Sphere,
    pub(super) capsule: Round,
    pub(super) cylinder: Round,
}

#[derive(Debug, Deserialize)]
#[serde(default)]
pub(super) struct Cuboid {
    pub(super) size: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(default)]
pub(super) struct Sphere {
    pub(super) radius: f64,
}

/// A capsule or a cylinder along y.
#[derive(Debug, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Round {
    pub(super) height: f64,
    pub(super) radius_bottom: f64,
    pub(super) radius_top: f64,
}

// The defaults are those of the extension's schema.
impl Default for Cuboid {
    fn default() -> Self {
        Self { size: [1.0; 3] }
    }
}

impl Default for Sphere {
    fn default() -> Self {
        Self { radius: 0.5 }
    }
}

impl Default for Round {
    fn default() -> Self {
        Self {
            height: 0.5,
            radius_bottom: 0.25,
            radius_top: 0.25,
        }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Physics {
    pub(super) physics_materials: Vec<Material>,
    pub(super) physics_joints: Vec<PhysicsJoint>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct PhysicsJoint {
    pub(super) limits: Vec<JointLimit>,
    pub(super) drives: Vec<JointDrive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct JointLimit {
    pub(super) linear_axes: Option<Vec<usize>>,
    pub(super) angular_axes: Option<Vec<usize>>,
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
    pub(super) stiffness: Option<f64>,
    pub(super) damping: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct JointDrive {
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) mode: String,
    pub(super) axis: Option<usize>,
    pub(super) max_force: Option<f64>,
    pub(super) position_target: Option<f64>,
    pub(super) velocity_target: Option<f64>,
    pub(super) stiffness: f64,
    pub(super) damping: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Material {
    pub(super) dynamic_friction: Option<f64>,
    pub(super) restitution: Option<f64>,
}

/// Extensions of a node.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "KHR_physics_rigid_bodies")]
    pub(super) body: Option<RigidBody>,
    #[serde(flatten)]
    pub(super) others: Map<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct RigidBody {
    pub(super) motion: Option<Motion>,
    pub(super) collider: Option<Collider>,
    pub(super) trigger: Option<IgnoredAny>,
    pub(super) joint: Option<NodeJoint>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct NodeJoint {
    pub(super) connected_node: Option<usize>,
    pub(super) joint: Option<usize>,
    pub(super) enable_collision: bool,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Motion {
    pub(super) is_kinematic: bool,
    pub(super) mass: Option<f64>,
    pub(super) center_of_mass: [f64; 3],
    pub(super) inertia_diagonal: Option<[f64; 3]>,
    pub(super) inertia_orientation: Option<[f64; 4]>,
    pub(super) linear_velocity: Option<[f64; 3]>,
    pub(super) angular_velocity: Option<[f64; 3]>,
    pub(super) gravity_factor: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Collider {
    pub(super) geometry: Geometry,
    pub(super) physics_material: Option<usize>,
    pub(super) collision_filter: Option<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Geometry {
    pub(super) shape: Option<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) node: Option<usize>,
}

/// The name of a node or a mesh, or its number.
pub(super) fn title(number: usize, name: &str) -> String {
    match name.is_empty() {
        true => format!("{number}"),
        false => name.to_owned(),
    }
}
