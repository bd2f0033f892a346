//! A member that commands through an edge, and what of it was applied.
//!
//! Its ball floats above all others, without gravity or damping. Each command is the same impulse, so that the ball's speed
//! is the number of commands that were applied: one that is lost or applied twice shows. Judges nothing; the caller ends
//! edges and routers meanwhile.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, Command, Shape, Sleep};
use rhumb_client::{Client, Event, JoinMode, Replica, StreamChoice};
use rhumb_reckoning::BodyId;
use serde::{Deserialize, Serialize};

use super::member::Place;
use super::rig::LIMIT;
use crate::output::Failure;

/// Time between two commands.
const EACH: Duration = Duration::from_millis(50);
/// Time between two looks of a member at its connection.
const LOOK: Duration = Duration::from_millis(5);
/// Metres a second by one command: a power of two, so that speeds are exact. The ball has one kilogramme.
const FASTER: f32 = 1.0 / 64.0;
/// Metres above the scene.
const HEIGHT: f32 = 1_000.0;

/// Commands of a member in the whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commanded {
    /// Commands that it gave.
    pub given: u64,
    /// Those that were applied, a command that was applied twice counted twice; `None` if the body is gone.
    pub applied: Option<u64>,
    /// Those that were refused.
    pub refused: u64,
}

/// A member that commands until the end.
pub(super) struct Commander {
    body: BodyId,
    notes: Arc<Notes>,
    thread: JoinHandle<Result<Commanded, Failure>>,
}

#[derive(Default)]
struct Notes {
    stop: AtomicBool,
    /// When the newest command was given that has an answer.
    answered: Mutex<Option<Instant>>,
    /// The longest time to an answer since it was asked for, nanoseconds.
    slowest_ns: AtomicU64,
}

impl Notes {
    fn answered(&self) -> MutexGuard<'_, Option<Instant>> {
        self.answered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Commander {
    /// Joins a scene, adds its ball, and begins.
    pub(super) fn enter(place: &Place) -> Result<Self, Failure> {
        let mut client = place.join(JoinMode::Join)?;
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).mass(1.0);
        let ball = ball.gravity_scale(0.0).sleep(Sleep::Never);
        let body = client.add_body(ball.at(0.0, HEIGHT, 0.0))?;
        let notes = Arc::new(Notes::default());
        let noted = Arc::clone(&notes);
        let thread = thread::spawn(move || command(client, body, &noted));
        Ok(Self {
            body,
            notes,
            thread,
        })
    }

    /// True if a command that was given after a moment has an answer.
    pub(super) fn is_answered_since(&self, moment: Instant) -> bool {
        let answered = *self.notes.answered();
        answered.is_some_and(|answered| answered > moment)
    }

    /// The longest time from a command to its answer since the last call.
    pub(super) fn take_slowest(&self) -> Duration {
        Duration::from_nanos(self.notes.slowest_ns.swap(0, Ordering::Relaxed))
    }

    /// Ends it once all of its commands have answers, and looks at its ball at the server.
    pub(super) fn end(self, server: &Place) -> Result<Commanded, Failure> {
        self.notes.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.join();
        let commanded = ended.map_err(|_| "the thread of a commander panicked")??;
        let mut exact = server.join_stream(JoinMode::Join, StreamChoice::Full)?;
        // The answers have come, so that the first snapshot has all of them.
        exact.idle(LIMIT / 20)?;
        let complete = exact.statistics().complete;
        let stream = exact.replica().map(Replica::stream);
        let motion = stream.and_then(|stream| stream.predicted_motion(self.body, complete));
        let speed = motion.map(|motion| motion.twist().linear.x);
        Ok(Commanded {
            applied: speed.map(|speed| (speed / f64::from(FASTER)).round() as u64),
            ..commanded
        })
    }
}

/// Commands until the notes say stop, and until all commands have answers.
fn command(mut client: Client, body: BodyId, notes: &Notes) -> Result<Commanded, Failure> {
    let mut commanded = Commanded::default();
    let mut waiting: Vec<(u64, Instant)> = Vec::new();
    let mut due = Instant::now();
    loop {
        let stops = notes.stop.load(Ordering::Relaxed);
        if stops && waiting.is_empty() {
            return Ok(commanded);
        }
        let now = Instant::now();
        if stops && now > due + LIMIT {
            return Err("a command has no answer".into());
        }
        if !stops && now >= due {
            let impulse = Vec3::X * FASTER;
            let number = client.command(Command::Impulse { id: body, impulse })?;
            commanded.given += 1;
            waiting.push((number, now));
            due = now + EACH;
        }
        client.idle(LOOK)?;
        while let Some((_, event)) = client.poll_event() {
            match event {
                Event::Applied { through, .. } => note_answers(&mut waiting, through, notes),
                Event::Refused { .. } => commanded.refused += 1,
                _ => {}
            }
        }
    }
}

fn note_answers(waiting: &mut Vec<(u64, Instant)>, through: u64, notes: &Notes) {
    waiting.retain(|(number, given)| {
        if *number > through {
            return true;
        }
        let took = u64::try_from(given.elapsed().as_nanos()).unwrap_or(u64::MAX);
        notes.slowest_ns.fetch_max(took, Ordering::Relaxed);
        let mut answered = notes.answered();
        *answered = (*answered).max(Some(*given));
        false
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_that_of_all_commands_up_to_its_number() {
        let (notes, given) = (Notes::default(), Instant::now());
        let later = given + Duration::from_secs(1);
        let mut waiting = vec![(1, given), (2, later), (3, later)];
        note_answers(&mut waiting, 2, &notes);
        assert_eq!(waiting, [(3, later)]);
        assert_eq!(*notes.answered(), Some(later));
        note_answers(&mut waiting, 1, &notes);
        assert_eq!(waiting.len(), 1);
    }
}
