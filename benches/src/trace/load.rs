//! Topics of one load: the truth and each of its runs, tick by tick.

use std::io::{Seek, Write};

use mcap::McapError;
use rhumb_reckoning::{BodyId, Tick};
use rhumb_trace::{ASLEEP, AWAKE, SceneTopics, StateForm, States, TraceFile};

use super::bodies::{Body, TruthBodies};
use super::names::run_names;
use super::options::TraceOptions;
use super::run::RunTopics;
use super::time::Time;
use crate::record::Load;

/// Writes a load; `done` is called after each tick with its number.
pub(super) fn write_load<W: Write + Seek>(
    file: &mut TraceFile<W>,
    (prefix, load): (&str, &Load),
    form: StateForm,
    options: &TraceOptions,
    done: &mut dyn FnMut(u64),
) -> Result<(), McapError> {
    if load.runs.is_empty() {
        return Ok(());
    }
    let time = Time::of(load.facts.integrator.rate, options);
    let mut truth = TruthTopics::new((prefix, load), form, time, options);
    let mut runs: Vec<_> = run_names(load)
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
    form: StateForm,
    topics: SceneTopics,
    is_drawn: bool,
    bodies: TruthBodies<'a>,
    last: u64,
    drawn: Option<u64>,
    /// True if a static body was placed or removed since statics were last drawn.
    statics_changed: bool,
}

impl<'a> TruthTopics<'a> {
    fn new(
        (prefix, load): (&str, &'a Load),
        form: StateForm,
        time: Time,
        options: &TraceOptions,
    ) -> Self {
        Self {
            time,
            form,
            topics: SceneTopics::new(&format!("/{prefix}"), time.rest_delay_ticks()),
            is_drawn: options.draws(load),
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
        let removed: Vec<BodyId> = changes.removed.iter().map(|(_, id)| *id).collect();
        let after = (changes.placed, removed.as_slice());
        let states = States::of(tick, changes.observed, after, &mut self.form);
        self.topics.put_states(file, at_ns, &states)?;
        let due = self
            .drawn
            .is_none_or(|drawn| self.time.draws_after(drawn, tick.value()));
        if self.is_drawn && (due || tick.value() == self.last) {
            self.drawn = Some(tick.value());
            let bodies = || self.bodies.bodies.iter();
            if std::mem::take(&mut self.statics_changed) {
                let statics = bodies().filter(|body| body.is_static());
                self.topics
                    .draw_statics(file, at_ns, statics.map(Body::drawn))?;
            }
            let moving = bodies().filter(|body| !body.is_static());
            let painted: Vec<_> = moving
                .map(|body| (body.drawn(), if body.still { ASLEEP } else { AWAKE }))
                .collect();
            self.topics.draw(file, (tick.value(), at_ns), &painted)?;
        }
        Ok(())
    }
}
