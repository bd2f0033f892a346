//! What a client of the paper's protocol knows of its actors.

use std::collections::BTreeMap;
use std::hint::black_box;

use glam::{Quat, Vec3};
use rhumb_app::Message;
use rhumb_reckoning::BodyId;

use super::words::{SIMULATION, body_of};

/// The poses that were heard last.
#[derive(Debug, Default)]
pub(super) struct Copy {
    poses: BTreeMap<u32, (BodyId, Vec3, Quat)>,
    /// Everyone who was ever heard of, again and again, if the client keeps such a list.
    heard_of: Option<Vec<u32>>,
    /// Actors whose pose changed since this was last emptied.
    pub(super) changed: Vec<BodyId>,
    pub(super) states: u64,
    /// Whether the server has taken it in.
    pub(super) ready: bool,
    /// Frames that were told to be over.
    pub(super) over: u64,
    /// Frames that were given up: their ends were lost, or came too late.
    pub(super) lost: u64,
    /// Ends of frames that were given up and may come yet.
    owed: u64,
}

/// The end of a frame that is waited for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Awaited {
    /// Frames that were over before.
    over: u64,
    /// States that were heard before.
    states: u64,
}

impl Copy {
    /// `lists`: whether it keeps the list that is never emptied.
    pub(super) fn new(lists: bool) -> Self {
        Self {
            heard_of: lists.then(Vec::new),
            ..Self::default()
        }
    }

    /// Whether a buffer that holds so many datagrams may overflow by a state of each body and the frame's end.
    pub(super) fn may_lose(&self, room: usize) -> bool {
        self.poses.len() + 2 > room
    }

    /// Begins to wait for the end of a frame that was just asked for.
    pub(super) fn await_end(&self) -> Awaited {
        Awaited {
            over: self.over,
            states: self.states,
        }
    }

    /// Whether it has come. An end that is heard before any state while one is owed is that of a frame that was given up.
    pub(super) fn has_ended(&mut self, awaited: &mut Awaited) -> bool {
        if self.over > awaited.over && self.states == awaited.states && self.owed > 0 {
            self.owed -= 1;
            awaited.over += 1;
        }
        self.over > awaited.over
    }

    /// Waits no longer.
    pub(super) fn give_up(&mut self) {
        self.lost += 1;
        self.owed += 1;
    }

    /// A body is created where its simulator says.
    pub(super) fn place(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.poses.insert(id.index(), (id, position, rotation));
        self.changed.push(id);
    }

    /// A body is removed.
    pub(super) fn remove(&mut self, id: BodyId) {
        self.poses.remove(&id.index());
    }

    pub(super) fn pose(&self, id: BodyId) -> Option<(Vec3, Quat)> {
        let (known, position, rotation) = *self.poses.get(&id.index())?;
        (known == id).then_some((position, rotation))
    }

    /// Takes a message in, with the work that the published client makes of it if it is one.
    pub(super) fn hear(&mut self, message: &Message) {
        match message {
            Message::SetDynamicActor(state) => {
                self.states += 1;
                let object = state.actor.object;
                if let Some(list) = &mut self.heard_of {
                    let entries = list.iter().filter(|other| **other == object).count();
                    black_box(entries);
                    list.push(object);
                }
                let Some(index) = body_of(object) else { return };
                if let Some((id, position, rotation)) = self.poses.get_mut(&index) {
                    (*position, *rotation) = (state.position, state.rotation);
                    self.changed.push(*id);
                }
            }
            Message::TimeAdvanced(SIMULATION) => {
                self.over += 1;
                if let Some(list) = &self.heard_of {
                    for object in list.clone() {
                        black_box(body_of(object).and_then(|index| self.poses.get(&index)));
                    }
                }
            }
            Message::LogonReady(SIMULATION) => self.ready = true,
            _ => {}
        }
    }
}
