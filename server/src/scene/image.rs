//! The image of a scene: everything that decides its further run.
//!
//! Taken when no body or joint has changed since the last step; shapes may have. A scene from an image, given the same
//! commands before the same ticks, runs to the same bits as the scene that it is of.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

use super::Scene;
use crate::baking::BakedShapes;
use crate::engine::{FrozenEngine, RapierEngine, StepThreads};
use crate::event_monitor::EventMonitor;
use crate::record::RunRecord;
use crate::registry::Registry;
use crate::scene::Digest;

/// The engine of images, and the number of their form: it changes with every one that reads others' bytes otherwise.
pub const IMAGE_FORMAT: &str = "rapier3d 0.36.1, image 6";

/// A copy of a scene, to be encoded on another thread.
pub struct FrozenScene {
    gravity: Vec3,
    registry: Registry,
    event_monitor: EventMonitor,
    engine: FrozenEngine,
}

impl FrozenScene {
    /// Its bytes; `None` if the engine cannot encode its world.
    #[must_use]
    pub fn encode(self) -> Option<Vec<u8>> {
        let mut to = Writer::new();
        to.f32s(&self.gravity.to_array());
        let mut registry = Writer::new();
        self.registry.encode(&mut registry);
        self.event_monitor.encode(&mut registry);
        to.sized(&registry.into_bytes());
        to.raw(&(self.engine)()?);
        Some(to.into_bytes())
    }
}

impl Scene {
    /// A copy of the scene; `None` if a body or joint has changed since the last step, and for an engine without images.
    #[must_use]
    pub fn freeze(&self) -> Option<FrozenScene> {
        // Neither is in the image; a step leaves none.
        if !self.displaced.is_empty() || !self.lost.is_empty() {
            return None;
        }
        let engine = self.engine.freeze()?;
        Some(FrozenScene {
            gravity: self.gravity,
            registry: self.registry.clone(),
            event_monitor: self.event_monitor.clone(),
            engine,
        })
    }

    /// A copy of the scene, without its record, that runs to the same bits. `None` unless a step was the last
    /// change, and for an engine that cannot be copied.
    pub(crate) fn copy(&self) -> Option<Self> {
        // The engine is asked first: where many bodies are added between two steps, it refuses each time.
        let engine = self.engine.copy()?;
        Some(Self {
            config: self.config,
            gravity: self.gravity,
            tick: self.tick,
            registry: self.registry.clone(),
            engine,
            observations: self.observations.clone(),
            lost: Vec::new(),
            displaced: BTreeMap::new(),
            digest: self.digest,
            event_monitor: self.event_monitor.clone(),
            record: RunRecord::default(),
            baked: BakedShapes::default(),
            crowding_max: self.crowding_max,
            broken: false,
        })
    }

    /// A scene from its image.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for bytes that are no image of this version.
    pub fn from_image(
        config: SceneConfig,
        threads: &StepThreads,
        (tick, digest): (Tick, Digest),
        image: &[u8],
    ) -> Result<Self, Malformed> {
        let mut from = Reader::new(image);
        let gravity = Vec3::from_array(from.f32s()?);
        let mut inner = Reader::new(from.sized(image.len())?);
        let registry = Registry::decode(&mut inner)?;
        let event_monitor = EventMonitor::decode(&mut inner)?;
        inner.finish()?;
        let engine = RapierEngine::from_image(&config, threads, registry.shapes(), from.rest())?;
        let scene = Self::with_engine(config, Box::new(engine)).map_err(|_| Malformed::OutOfRange);
        Ok(Self {
            gravity,
            tick,
            registry,
            event_monitor,
            digest,
            ..scene?
        })
    }
}
