//! A scene that is open, and its arrays.

use rhumb_bindings::RemoteScene;

use crate::view_array::ViewArray;

/// A scene that is open, and its arrays.
pub(crate) struct OpenScene {
    pub(crate) scene: RemoteScene,
    pub(crate) bodies: ViewArray<u64>,
    pub(crate) changed: ViewArray<u32>,
    pub(crate) removed: ViewArray<u64>,
    pub(crate) positions: ViewArray<f32>,
    pub(crate) rotations: ViewArray<f32>,
    pub(crate) linear: ViewArray<f32>,
    pub(crate) angular: ViewArray<f32>,
    pub(crate) resting: ViewArray<bool>,
    /// Computed whenever it is read.
    pub(crate) bounds: ViewArray<f32>,
}

impl OpenScene {
    pub(crate) const fn new(scene: RemoteScene) -> Self {
        Self {
            scene,
            bodies: ViewArray::new(),
            changed: ViewArray::new(),
            removed: ViewArray::new(),
            positions: ViewArray::new(),
            rotations: ViewArray::new(),
            linear: ViewArray::new(),
            angular: ViewArray::new(),
            resting: ViewArray::new(),
            bounds: ViewArray::new(),
        }
    }

    /// Marks the arrays as old: the view is about to be computed anew.
    pub(crate) const fn expire(&mut self) {
        self.bodies.expire();
        self.changed.expire();
        self.removed.expire();
        self.positions.expire();
        self.rotations.expire();
        self.linear.expire();
        self.angular.expire();
        self.resting.expire();
        self.bounds.expire();
    }
}
