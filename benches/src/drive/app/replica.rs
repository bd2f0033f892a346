//! State that a client of the paper's protocol keeps of its actors.

use std::collections::BTreeMap;
use std::hint::black_box;

use glam::{Quat, Vec3};
use rhumb_app::Message;
use rhumb_reckoning::BodyId;

use super::defects::Defects;
use super::messages::{SIMULATION, body_of, object_of};

/// The poses received last.
#[derive(Debug, Default)]
pub(super) struct AppReplica {
    poses: BTreeMap<u32, (BodyId, Vec3, Quat)>,
    /// The published client's list: one entry per received state, never emptied; `None` without that defect.
    known_objects: Option<Vec<u32>>,
    /// Entries to add to the list before the first state.
    listed: usize,
    /// Actors whose pose changed since this was last emptied.
    pub(super) changed: Vec<BodyId>,
    pub(super) states: u64,
    /// True if the server has admitted the client.
    pub(super) ready: bool,
    /// Frames that ended before their wait was abandoned.
    pub(super) ended_frames: u64,
    /// Frames abandoned: their end messages were lost or late.
    pub(super) lost: u64,
    /// End messages of abandoned frames that may still arrive.
    owed: u64,
    /// States received when the present frame was requested.
    begun: u64,
    /// True if an end message since then was attributed to an abandoned frame.
    paid: bool,
}

/// An awaited end of frame: the number of frames ended before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct AwaitedEnd(u64);

impl AppReplica {
    /// Creates the state, with the published client's list if `defects` has it.
    pub(super) fn new(defects: Defects) -> Self {
        Self {
            known_objects: defects.list.then(Vec::new),
            listed: defects.listed as usize,
            ..Self::default()
        }
    }

    /// True if a buffer of `buffer_datagrams` datagrams can overflow by one state per body and the end of frame.
    pub(super) fn may_lose(&self, buffer_datagrams: usize) -> bool {
        self.poses.len() + 2 > buffer_datagrams
    }

    /// Starts waiting for the end of a requested frame.
    pub(super) fn await_end(&mut self) -> AwaitedEnd {
        (self.begun, self.paid) = (self.states, false);
        AwaitedEnd(self.ended_frames)
    }

    /// True if the awaited end has arrived.
    pub(super) fn has_ended(&self, AwaitedEnd(before): AwaitedEnd) -> bool {
        self.ended_frames > before
    }

    /// Abandons the wait. If an end and then silence came, that end was this frame's own, and the owed one was lost.
    pub(super) fn abandon(&mut self) {
        if std::mem::take(&mut self.paid) {
            self.owed = 0;
            self.ended_frames += 1;
        } else {
            self.lost += 1;
            self.owed += 1;
        }
    }

    /// Attributes an end message. One that arrives before any state while another is owed belongs to an abandoned
    /// frame. Datagrams keep their order on loopback, so no owed end can follow a frame's own end.
    fn receive_end(&mut self) {
        if self.owed > 0 && self.states == self.begun {
            self.owed -= 1;
            self.paid = true;
        } else {
            self.ended_frames += 1;
            self.owed = 0;
        }
    }

    /// Adds a body at its initial pose.
    pub(super) fn place(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.poses.insert(id.index(), (id, position, rotation));
        self.changed.push(id);
    }

    /// Removes a body.
    pub(super) fn remove(&mut self, id: BodyId) {
        self.poses.remove(&id.index());
    }

    pub(super) fn pose(&self, id: BodyId) -> Option<(Vec3, Quat)> {
        let (known, position, rotation) = *self.poses.get(&id.index())?;
        (known == id).then_some((position, rotation))
    }

    /// Processes a message, with the published client's list work if that defect is set.
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
