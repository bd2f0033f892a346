//! What a client of the paper's protocol knows of its actors.

use std::collections::BTreeMap;
use std::hint::black_box;

use glam::{Quat, Vec3};
use rhumb_app::Message;
use rhumb_reckoning::BodyId;

use super::defects::Defects;
use super::messages::{SIMULATION, body_of, object_of};

/// The poses that were heard last.
#[derive(Debug, Default)]
pub(super) struct AppReplica {
    poses: BTreeMap<u32, (BodyId, Vec3, Quat)>,
    /// Everyone who was ever heard of, again and again, if the client keeps such a list.
    known_objects: Option<Vec<u32>>,
    /// Entries that this list is to have before the first state is heard.
    listed: usize,
    /// Actors whose pose changed since this was last emptied.
    pub(super) changed: Vec<BodyId>,
    pub(super) states: u64,
    /// Whether the server has taken it in.
    pub(super) ready: bool,
    /// Frames that were told to be over, before they were given up.
    pub(super) over: u64,
    /// Frames that were given up: their ends were lost, or came too late.
    pub(super) lost: u64,
    /// Ends of frames that were given up and may come yet.
    owed: u64,
    /// States that had been heard when the present frame was asked for.
    begun: u64,
    /// Whether an end was heard since then that was taken for an owed one.
    paid: bool,
}

/// The end of a frame that is waited for: frames that were over before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Awaited(u64);

impl AppReplica {
    /// Keeps the list that is never emptied if it is among the losses.
    pub(super) fn new(defects: Defects) -> Self {
        Self {
            known_objects: defects.list.then(Vec::new),
            listed: defects.listed as usize,
            ..Self::default()
        }
    }

    /// Whether a buffer that holds so many datagrams may overflow by a state of each body and the frame's end.
    pub(super) fn may_lose(&self, room: usize) -> bool {
        self.poses.len() + 2 > room
    }

    /// Begins to wait for the end of a frame that is asked for.
    pub(super) fn await_end(&mut self) -> Awaited {
        (self.begun, self.paid) = (self.states, false);
        Awaited(self.over)
    }

    /// Whether it has come.
    pub(super) fn has_ended(&self, Awaited(before): Awaited) -> bool {
        self.over > before
    }

    /// Waits no longer. Where an end came, and silence behind it, that was this frame's own: the owed one was lost.
    pub(super) fn give_up(&mut self) {
        if std::mem::take(&mut self.paid) {
            self.owed = 0;
            self.over += 1;
        } else {
            self.lost += 1;
            self.owed += 1;
        }
    }

    /// An end that is heard before any state while one is owed is that of a frame that was given up. Datagrams keep their
    /// order here: behind a frame's own end none that is owed can come.
    fn receive_end(&mut self) {
        if self.owed > 0 && self.states == self.begun {
            self.owed -= 1;
            self.paid = true;
        } else {
            self.over += 1;
            self.owed = 0;
        }
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
    pub(super) fn receive(&mut self, message: &Message) {
        match message {
            Message::SetDynamicActor(state) => {
                self.states += 1;
                let object = state.actor.object;
                if let Some(list) = &mut self.known_objects {
                    if list.len() < self.listed {
                        let known = self.poses.keys().map(|index| object_of(*index));
                        list.extend(known.cycle().take(self.listed));
                    }
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
                self.receive_end();
                if let Some(list) = &self.known_objects {
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
