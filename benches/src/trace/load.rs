//! Topics of one load: the truth and each of its runs, tick by tick.

use std::io::{Seek, Write};

use foxglove::messages::{Color, SceneUpdate};
use mcap::McapError;
use rhumb_reckoning::Tick;

use super::bodies::{Bodies, TruthBodies};
use super::file::{Schema, Topic, TraceFile};
use super::messages::States;
use super::options::TraceOptions;
use super::run::RunTopics;
use super::scene::{DrawnScene, entity};
use super::time::Time;
use super::{names, primitives};
use crate::record::Load;

/// Writes a load; `done` is called after each tick with its number.
pub(super) fn write<W: Write + Seek>(
    file: &mut TraceFile<W>,
    prefix: &str,
    load: &Load,
    options: &TraceOptions,
    done: &mut dyn FnMut(u64),
) -> Result<(), McapError> {
    let Some(first) = load.runs.first() else {
        return Ok(());
    };
    let time = Time::of(&first.config, options);
    let mut truth = TruthTopics::new(prefix, load, time, options);
    let mut runs: Vec<_> = names::runs(load)
        .iter()
        .zip(&load.runs)
        .map(|(name, run)| RunTopics::new(&format!("/{prefix}/{name}"), load, run, options))
        .collect();
    for tick in 0..=last_tick(load) {
        truth.write(file, Tick::new(tick))?;
        for run in &mut runs {
            run.write_through(file, tick, &truth.bodies.bodies)?;
        }
        done(tick);
    }
    runs.iter_mut().try_for_each(|run| run.end(file))
}

/// The last tick that the engine simulated or a frame showed.
pub(super) fn last_tick(load: &Load) -> u64 {
    let shown = load
        .runs
        .iter()
        .flat_map(|run| &run.frames)
        .map(|frame| frame.tick.value());
    shown.max().unwrap_or(0).max(load.truth.ticks.len() as u64)
}

struct TruthTopics<'a> {
    time: Time,
    state: Topic,
    statics: Topic,
    scene: Option<DrawnScene>,
    bodies: TruthBodies<'a>,
    last: u64,
    drawn: Option<u64>,
    /// True if a static body was placed or removed since statics were last drawn.
    statics_changed: bool,
}

impl<'a> TruthTopics<'a> {
    fn new(prefix: &str, load: &'a Load, time: Time, options: &TraceOptions) -> Self {
        let prefix = format!("/{prefix}/truth");
        Self {
            time,
            state: Topic::new(format!("{prefix}/state"), Schema::Own("rhumb.States")),
            statics: Topic::new(format!("{prefix}/static"), Schema::Scene),
            scene: options
                .draws(load)
                .then(|| DrawnScene::new(&prefix, time.rest_delay_ticks())),
            bodies: TruthBodies::new(&load.truth),
            last: last_tick(load),
            drawn: None,
            statics_changed: false,
        }
    }

    fn write<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        tick: Tick,
    ) -> Result<(), McapError> {
        let at_ns = self.time.at_ns(tick.value());
        let changes = self.bodies.step(tick);
        self.statics_changed |= changes.statics_changed;
        let states = States::of(tick, changes.observed, changes.placed, changes.removed);
        file.put(&mut self.state, at_ns, &states)?;
        let due = self
            .drawn
            .is_none_or(|drawn| self.time.draws_after(drawn, tick.value()));
        if let Some(scene) = &mut self.scene
            && (due || tick.value() == self.last)
        {
            self.drawn = Some(tick.value());
            if std::mem::take(&mut self.statics_changed) {
                file.put(
                    &mut self.statics,
                    at_ns,
                    &draw_statics(at_ns, &self.bodies.bodies),
                )?;
            }
            let moving = self.bodies.bodies.iter().filter(|body| !body.is_static());
            let painted: Vec<_> = moving
                .map(|body| (body, if body.still { ASLEEP } else { AWAKE }))
                .collect();
            scene.draw(file, (tick.value(), at_ns), &painted)?;
        }
        Ok(())
    }
}

fn draw_statics(at_ns: u64, bodies: &Bodies<'_>) -> SceneUpdate {
    let mut entity = entity("static", at_ns);
    for body in bodies.iter().filter(|body| body.is_static()) {
        primitives::add(
            &mut entity,
            &body.placed.shape,
            body.position,
            body.rotation,
            STATIC,
        );
    }
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}

const AWAKE: Color = grey(0.80, 1.0);
const ASLEEP: Color = grey(0.50, 1.0);
/// Translucent, because walls stand in front of the bodies they contain.
const STATIC: Color = grey(0.60, 0.25);

const fn grey(share: f64, a: f64) -> Color {
    Color {
        r: share,
        g: share,
        b: share,
        a,
    }
}
