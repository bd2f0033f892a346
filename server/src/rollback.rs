//! The way back of a scene whose engine failed, in memory.
//!
//! Holds a copy of the scene as it was after an earlier step, and does again what was done since, without the commands
//! on which the engine fails. A scene that runs the same commands runs to the same bits, so that members notice only
//! what was left out. Reads no clock: the running scene adds the time of steps. Invariants: a restored scene is at the
//! tick of the failed one, and a copy of it has taken the next step.

use rhumb_protocol::Span;
use rhumb_protocol::scene::Command;

use crate::permit::Ownership;
use crate::record::{Author, LogEntry};
use crate::scene::Scene;

/// The way back of one scene.
#[derive(Default)]
pub(crate) struct Rollback {
    base: Option<Base>,
    /// Time of the steps since then: a replay takes about as long.
    stepped: Span,
}

/// A scene right after a step, with its owners.
struct Base {
    scene: Scene,
    ownership: Ownership,
}

/// A scene that continues, and what it lacks.
pub(crate) struct Restoration {
    pub(crate) scene: Scene,
    pub(crate) ownership: Ownership,
    /// The authors of the commands that were left out, in the order of the commands.
    pub(crate) left_out: Vec<Option<Author>>,
    /// True if a command was left out that acted in an earlier step: every body may be elsewhere.
    pub(crate) differs: bool,
}

/// The call in which an engine failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FailedIn {
    /// In a command, which the record lacks.
    Command,
    /// In a step.
    Step,
}

/// Time of steps after which a copy is due, as long as the scene is small. A copy takes some 0.1 % of it with 1,000
/// bodies, and 4 % with 10,000.
const COPY_AFTER: Span = Span::from_millis(500);
/// The same for a large scene: together with a search, less than the 3 s that a restoration may take.
const COPY_AFTER_MAX: Span = Span::from_millis(1_000);
/// Bodies from which on a scene is large.
const LARGE: usize = 20_000;
/// Bytes of entries after which a copy is due.
const ENTRY_BYTES_MAX: usize = 1 << 20;
/// Commands of one tick that are left out by themselves, before all of them are.
const CULPRITS_MAX: usize = 3;
/// Attempts with ever more commands left out, before all since the copy are.
const ATTEMPTS_MAX: usize = 4;

impl Rollback {
    /// Adds the time of a step.
    pub(crate) fn note_step(&mut self, took: Span) {
        self.stepped = Span::from_nanos(self.stepped.as_nanos() + took.as_nanos());
    }

    /// Copies the scene if that is due and the scene can be copied now: right after a step. To be called before a
    /// scene is changed.
    pub(crate) fn copy_if_due(&mut self, scene: &mut Scene, ownership: &Ownership) {
        let after = if scene.body_count() < LARGE {
            COPY_AFTER
        } else {
            COPY_AFTER_MAX
        };
        let bytes = scene.record().bytes_since_base();
        let is_due = bytes.is_none_or(|bytes| bytes >= ENTRY_BYTES_MAX);
        if !is_due && self.stepped < after {
            return;
        }
        self.begin_at(scene, ownership);
    }

    /// Begins with a scene that has not changed since its last step.
    pub(crate) fn begin_at(&mut self, scene: &mut Scene, ownership: &Ownership) {
        if let Some(copy) = scene.copy() {
            let ownership = ownership.clone();
            self.begin(Base {
                scene: copy,
                ownership,
            });
            scene.record_mut().begin_base();
        }
    }

    /// An earlier state of the scene, and what it has changed since.
    pub(crate) fn way_to<'a>(
        &'a self,
        scene: &'a Scene,
    ) -> Option<(&'a Scene, impl Iterator<Item = &'a LogEntry>)> {
        let base = self.base.as_ref()?;
        Some((&base.scene, scene.record().since_base()?))
    }

    fn begin(&mut self, base: Base) {
        self.base = Some(base);
        self.stepped = Span::ZERO;
    }

    /// Restores a failed scene; `None` if it fails again without any command since the copy. `beat` is called before
    /// each step.
    pub(crate) fn restore(
        &mut self,
        failed: &Scene,
        failed_in: FailedIn,
        beat: &mut dyn FnMut(),
    ) -> Option<Restoration> {
        let done: Vec<LogEntry> = failed.record().since_base()?.cloned().collect();
        let is_step = |change: &LogEntry| matches!(change, LogEntry::Stepped(_));
        let newest = done.iter().rposition(is_step);
        let (earlier, pending) = done.split_at(newest.map_or(0, |place| place + 1));
        let attempt = self.leave_out_of_pending(earlier, pending, failed_in, beat);
        let attempt = attempt.or_else(|| self.leave_out_of_all(earlier, pending, beat))?;
        self.adopt(attempt)
    }

    /// Leaves out what fails of the commands since the newest step: single ones if that suffices, otherwise all.
    fn leave_out_of_pending(
        &self,
        earlier: &[LogEntry],
        pending: &[LogEntry],
        failed_in: FailedIn,
        beat: &mut dyn FnMut(),
    ) -> Option<Continuation> {
        let base = self.base.as_ref()?.replay(earlier, beat)?;
        let mut attempt = Continuation {
            base,
            kept: pending.to_vec(),
            left_out: Vec::new(),
            differs: false,
        };
        if failed_in == FailedIn::Command {
            return Some(attempt);
        }
        for _ in 0..CULPRITS_MAX {
            beat();
            if attempt.steps(attempt.kept.len()) {
                return Some(attempt);
            }
            let Some(culprit) = attempt.culprit(beat) else {
                break;
            };
            attempt.leave_out(culprit);
        }
        while !attempt.kept.is_empty() {
            attempt.leave_out(0);
        }
        attempt.steps(0).then_some(attempt)
    }

    /// Leaves out ever more of the last commands, at last all since the copy: some act on the engine late.
    fn leave_out_of_all(
        &self,
        earlier: &[LogEntry],
        pending: &[LogEntry],
        beat: &mut dyn FnMut(),
    ) -> Option<Continuation> {
        let is_command = |change: &&LogEntry| matches!(change, LogEntry::Applied(_));
        let commands = earlier.iter().filter(is_command).count();
        let mut count = 1;
        for attempts in 1.. {
            if commands == 0 {
                return None;
            }
            if count >= commands || attempts > ATTEMPTS_MAX {
                count = commands;
            }
            let mut left = commands - count;
            let (mut kept, mut left_out) = (Vec::new(), Vec::new());
            for change in earlier {
                match change {
                    LogEntry::Applied(applied) if left == 0 => left_out.push(applied.author),
                    LogEntry::Applied(_) => {
                        left -= 1;
                        kept.push(change.clone());
                    }
                    _ => kept.push(change.clone()),
                }
            }
            left_out.extend(pending.iter().filter_map(author_of));
            if let Some(base) = self.base.as_ref()?.replay(&kept, beat) {
                let attempt = Continuation {
                    base,
                    kept: Vec::new(),
                    left_out,
                    differs: true,
                };
                if attempt.steps(0) {
                    return Some(attempt);
                }
            }
            if count == commands {
                return None;
            }
            count *= 8;
        }
        None
    }

    /// Continues from an attempt that stepped.
    fn adopt(&mut self, attempt: Continuation) -> Option<Restoration> {
        let Continuation {
            base,
            kept,
            mut left_out,
            differs,
        } = attempt;
        let mut scene = base.scene.copy()?;
        let mut ownership = base.ownership.clone();
        scene.record_mut().begin_base();
        for change in kept {
            if !replay(&change, &mut scene, &mut ownership) {
                left_out.extend(author_of(&change));
            } else if let LogEntry::Applied(applied) = change
                && let Some(author) = applied.author
            {
                scene.record_mut().attribute(author, applied.client);
            }
        }
        self.begin(base);
        Some(Restoration {
            scene,
            ownership,
            left_out,
            differs,
        })
    }
}

/// A state at the newest tick, and the commands since then that are kept.
struct Continuation {
    base: Base,
    kept: Vec<LogEntry>,
    left_out: Vec<Option<Author>>,
    differs: bool,
}

impl Continuation {
    /// True if the scene takes a step after so many of the commands.
    fn steps(&self, count: usize) -> bool {
        let Some(mut scene) = self.base.scene.copy() else {
            return false;
        };
        for change in &self.kept[..count] {
            // A command that depends on one that was left out is refused, and left out too.
            if let LogEntry::Applied(applied) = change {
                let _ = scene.apply(&applied.command);
            }
        }
        scene.step().is_ok()
    }

    /// The command after which the scene does not step any more; `None` if it does not step without any.
    fn culprit(&self, beat: &mut dyn FnMut()) -> Option<usize> {
        if !self.steps(0) {
            return None;
        }
        let (mut good, mut bad) = (0, self.kept.len());
        while bad - good > 1 {
            beat();
            let middle = usize::midpoint(good, bad);
            if self.steps(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        (bad > 0).then_some(good)
    }

    fn leave_out(&mut self, place: usize) {
        let change = self.kept.remove(place);
        self.left_out.extend(author_of(&change));
    }
}

impl Base {
    /// The state after these changes; `None` if it fails on the way.
    fn replay(&self, done: &[LogEntry], beat: &mut dyn FnMut()) -> Option<Self> {
        let mut scene = self.scene.copy()?;
        let mut ownership = self.ownership.clone();
        for change in done {
            if matches!(change, LogEntry::Stepped(_)) {
                beat();
            }
            if !replay(change, &mut scene, &mut ownership) {
                return None;
            }
        }
        Some(Self { scene, ownership })
    }
}

/// Does an entry again; `false` if the scene refuses or fails.
pub fn replay(entry: &LogEntry, scene: &mut Scene, ownership: &mut Ownership) -> bool {
    match entry {
        LogEntry::Applied(applied) => {
            if scene.apply(&applied.command).is_err() {
                return false;
            }
            if let Command::RemoveBody { id } = applied.command {
                ownership.remove_body(id);
            }
            ownership.note(applied.client.as_ref(), &applied.command);
        }
        LogEntry::Stepped(_) => {
            let Ok(stepped) = scene.step() else {
                return false;
            };
            (stepped.removed.iter()).for_each(|(id, _)| ownership.remove_body(*id));
            (stepped.broken.iter()).for_each(|id| ownership.remove_joint(*id));
        }
        _ => {}
    }
    true
}

fn author_of(change: &LogEntry) -> Option<Option<Author>> {
    match change {
        LogEntry::Applied(applied) => Some(applied.author),
        _ => None,
    }
}
