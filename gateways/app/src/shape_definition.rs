//! An APP client's shapes as shapes of its scene, each stored once.
//!
//! A shape is checked when it is made: it can be given to an engine. The published plug-in defines a shape for every
//! object; a scene allows a few thousand, and sends each to every member.

use core::f32::consts::FRAC_1_SQRT_2;
use std::collections::{BTreeMap, BTreeSet};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{EXTENT_MIN, HULL_POINTS_MAX, POSTS_MAX, SHAPES_MAX};
use rhumb_protocol::scene::{
    Command, CommandError, Edges, Heights, Hull, Invalid, Mesh, Shape, ShapeId,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;
use rhumb_solids::UnitMass;

use crate::gateway::Refusal;
use crate::message::{ConvexMesh, HeightGrid, TriangleMesh};
use crate::scene::OwnScene;

/// Mass properties of a shape with volume, at density one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bulk {
    /// Centre of mass in the shape's coordinates, metres.
    pub(super) centre: Vec3,
    /// Volume, m³.
    pub(super) volume: f32,
}

impl Bulk {
    /// As the server computes it; `None` for a shape of which it cannot make a solid.
    fn of(shape: &Shape) -> Option<Self> {
        let UnitMass { centre, mass, .. } = UnitMass::of_shape(shape)?;
        let volume = mass;
        Some(Self { centre, volume })
    }
}

/// A shape, and its pose in the axes of the client's definition.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ShapeDefinition {
    pub(super) shape: Shape,
    /// Metres, in the client's axes.
    pub(super) position: Vec3,
    /// Shape → client's axes.
    pub(super) rotation: Quat,
    pub(super) bulk: Bulk,
    /// Replacement for a dynamic body, if the shape encloses no volume.
    hull: Option<Hull>,
}

/// Long axes are the client's x and the scene's y: a quarter turn back about z.
const Y_TO_X: Quat = Quat::from_xyzw(0.0, 0.0, -FRAC_1_SQRT_2, FRAC_1_SQRT_2);

impl ShapeDefinition {
    fn of(shape: Shape) -> Result<Self, Refusal> {
        shape.check()?;
        let bulk = Bulk::of(&shape).ok_or(Refusal::UnusableShape)?;
        Ok(Self {
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            bulk,
            hull: None,
        })
    }

    pub(super) fn ball(origin: Vec3, radius: f32) -> Result<Self, Refusal> {
        if !origin.is_finite() {
            return Err(Refusal::Number);
        }
        let ball = Self::of(Shape::Ball { radius })?;
        Ok(Self {
            position: origin,
            ..ball
        })
    }

    /// `edges`: whole edge lengths, metres.
    pub(super) fn cuboid(edges: Vec3) -> Result<Self, Refusal> {
        let half_extents = edges * 0.5;
        Self::of(Shape::Cuboid { half_extents })
    }

    /// `height`: from cap to cap, so that an avatar has its intended height; at least that of the caps.
    pub(super) fn capsule(radius: f32, height: f32) -> Result<Self, Refusal> {
        let half_height = (height * 0.5 - radius).max(EXTENT_MIN);
        let capsule = Shape::Capsule {
            half_height,
            radius,
        };
        Ok(Self {
            rotation: Y_TO_X,
            ..Self::of(capsule)?
        })
    }

    pub(super) fn hull(message: &ConvexMesh) -> Result<Self, Refusal> {
        let hull = hull_of(&message.points)?;
        Self::of(Shape::Hull(hull))
    }

    /// A shape without volume has the mass of its hull, if it has one.
    pub(super) fn mesh(message: &TriangleMesh) -> Result<Self, Refusal> {
        let mesh = Mesh::new(&message.points, &message.triangles)?;
        let hull = hull_of(&message.points).ok();
        let bulk = hull
            .as_ref()
            .and_then(|hull| Bulk::of(&Shape::Hull(hull.clone())));
        Ok(Self {
            bulk: bulk.unwrap_or(NO_BULK),
            hull: hull.filter(|_| bulk.is_some()),
            ..Self::sheet(Shape::Mesh(mesh))
        })
    }

    pub(super) fn heights(message: &HeightGrid) -> Result<Self, Refusal> {
        if message.heights.len() > POSTS_MAX {
            return Err(Refusal::TooMany);
        }
        let field = Heights::new(
            message.rows,
            message.row_spacing,
            message.column_spacing,
            &message.heights,
        )?;
        // Hosts turn their ground as they like, and smooth heights are touched from one side alone.
        let field = field.with_edges(Edges::Plain);
        Ok(Self::sheet(Shape::Heights(field)))
    }

    /// A shape without volume or hull.
    fn sheet(shape: Shape) -> Self {
        Self {
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            bulk: NO_BULK,
            hull: None,
        }
    }

    /// The shape for a dynamic body: itself, or the hull of its points. `None` for ground.
    pub(super) fn solid(&self) -> Option<Self> {
        if self.shape.is_solid() {
            return Some(self.clone());
        }
        let shape = Shape::Hull(self.hull.clone()?);
        Some(Self {
            shape,
            ..self.clone()
        })
    }

    /// The shape around its centre of mass, and the former centre. A centre that is off by rounding only stays.
    pub(super) fn centred(&self) -> (Shape, Vec3) {
        let centre = self.bulk.centre;
        let rounding = self.shape.bounding_radius().metres() as f32 * ROUNDING;
        if let Shape::Hull(hull) = &self.shape
            && centre.length() > rounding
        {
            let points: Vec<Vec3> = hull.points().iter().map(|point| point - centre).collect();
            if let Ok(hull) = Hull::new(&points) {
                return (Shape::Hull(hull), centre);
            }
        }
        (self.shape.clone(), Vec3::ZERO)
    }
}

const NO_BULK: Bulk = Bulk {
    centre: Vec3::ZERO,
    volume: 0.0,
};
/// Share of its radius by which rounding alone may displace a hull's centre of mass.
const ROUNDING: f32 = 1e-4;

/// A hull of any number of points, reduced to the allowed number: the farthest points in directions all around.
///
/// # Errors
///
/// [`Invalid`] for a point that is not finite or too far out, and for points that make no hull.
fn hull_of(points: &[Vec3]) -> Result<Hull, Invalid> {
    if points.len() <= HULL_POINTS_MAX {
        return Hull::new(points);
    }
    let mut chosen = Vec::new();
    for direction in directions(HULL_POINTS_MAX) {
        let reach = |point: &Vec3| point.dot(direction);
        let farthest = points.iter().max_by(|a, b| reach(a).total_cmp(&reach(b)));
        chosen.extend(farthest.filter(|point| !chosen.contains(*point)).copied());
    }
    Hull::new(&chosen)
}

/// Unit vectors spread over a sphere, by the golden angle.
fn directions(count: usize) -> impl Iterator<Item = Vec3> {
    let golden = core::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    (0..count).map(move |place| {
        let y = 1.0 - 2.0 * (place as f32 + 0.5) / count as f32;
        let across = (1.0 - y * y).max(0.0).sqrt();
        let angle = golden * place as f32;
        Vec3::new(across * angle.cos(), y, across * angle.sin())
    })
}

/// Refused shapes that are remembered.
const REFUSED_MAX: usize = 64;

/// Shapes in the scene, by their bytes.
#[derive(Debug, Default)]
pub(super) struct ShapeCache {
    known: BTreeMap<Vec<u8>, ShapeId>,
    /// Number of bodies with each shape, and its bytes.
    users: BTreeMap<ShapeId, (usize, Vec<u8>)>,
    /// The last assigned number.
    last: u32,
    /// Bytes of shapes that the scene refused, until it has room again.
    refused: BTreeSet<Vec<u8>>,
}

impl ShapeCache {
    /// The scene's id of a shape, for one more body.
    pub(super) fn take(
        &mut self,
        shape: &Shape,
        scene: &mut OwnScene,
    ) -> Result<ShapeId, CommandError> {
        let mut writer = Writer::new();
        shape.encode(&mut writer);
        let bytes = writer.into_bytes();
        if let Some(id) = self.known.get(&bytes) {
            if let Some((users, _)) = self.users.get_mut(id) {
                *users += 1;
            }
            return Ok(*id);
        }
        if self.refused.contains(&bytes) {
            return Err(CommandError::ShapeUnfit(ShapeId(self.last)));
        }
        if self.users.len() >= SHAPES_MAX as usize {
            return Err(CommandError::UnknownShape(ShapeId(SHAPES_MAX)));
        }
        let id = self.free(scene);
        let shape = shape.clone();
        scene.command(&Command::AddShape { id, shape })?;
        self.last = id.0;
        self.known.insert(bytes.clone(), id);
        self.users.insert(id, (1, bytes));
        Ok(id)
    }

    /// Releases a shape for one body.
    pub(super) fn give_back(&mut self, id: ShapeId, scene: &mut OwnScene) {
        let Some((users, bytes)) = self.users.get_mut(&id) else {
            return;
        };
        *users -= 1;
        if *users > 0 {
            return;
        }
        self.known.remove(bytes);
        self.users.remove(&id);
        // Another shape may fit now.
        self.refused.clear();
        if let Err(error) = scene.command(&Command::RemoveShape { id }) {
            tracing::debug!(%error, "a shape stays in its scene");
        }
    }

    /// Forgets a shape that the scene refused.
    pub(super) fn refuse(&mut self, id: ShapeId) {
        let Some((_, bytes)) = self.users.remove(&id) else {
            return;
        };
        self.known.remove(&bytes);
        if self.refused.len() >= REFUSED_MAX {
            self.refused.clear();
        }
        self.refused.insert(bytes);
    }

    /// A number without a shape in the scene: members may have taken any. Beyond the limit if all are taken.
    fn free(&self, scene: &OwnScene) -> ShapeId {
        let from = (self.last + 1) % SHAPES_MAX;
        let numbers = (from..SHAPES_MAX).chain(0..from).map(ShapeId);
        let free = |id: &ShapeId| scene.shape(*id).is_none();
        numbers
            .into_iter()
            .find(free)
            .unwrap_or(ShapeId(SHAPES_MAX))
    }
}
