//! A client's copy in the paper's protocol, and the defects it may have.
//!
//! A defect is a time loss of the published client, each a switch. Each cost is measured here. That the paper's client
//! lost the same time is inferred, because it ran on another runtime and machine.

use std::collections::BTreeMap;
use std::fmt;
use std::hint::black_box;

use clap::ValueEnum;
use glam::{Quat, Vec3};
use rhumb_app::Message;
use rhumb_reckoning::BodyId;

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

/// An avoidable time loss of the published client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Defect {
    /// Threads poll for work every 30 ms (TCP) and 10 ms (received messages) instead of being woken.
    Poll,
    /// At most fifty messages are sent per 30 ms.
    Cap,
    /// A list of received bodies is never emptied: each state scans it, each end of frame copies and walks it.
    List,
    /// The socket buffer has the system's default size, which holds 277 datagrams.
    Buffer,
}

/// The defects of a client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// See [`Defect::Poll`].
    pub poll: bool,
    /// See [`Defect::Cap`].
    pub cap: bool,
    /// See [`Defect::List`].
    pub list: bool,
    /// See [`Defect::Buffer`].
    pub buffer: bool,
    /// Initial entries of the list, as if the client had received that many states before.
    pub listed: u32,
}

impl Defects {
    /// A client without defects.
    pub const SOUND: Self = Self {
        poll: false,
        cap: false,
        list: false,
        buffer: false,
        listed: 0,
    };

    /// The published client, with all defects.
    pub const AS_PUBLISHED: Self = Self {
        poll: true,
        cap: true,
        list: true,
        buffer: true,
        listed: 0,
    };

    /// A client with the given defects only.
    #[must_use]
    pub fn only(defects: &[Defect]) -> Self {
        Self {
            poll: defects.contains(&Defect::Poll),
            cap: defects.contains(&Defect::Cap),
            list: defects.contains(&Defect::List),
            buffer: defects.contains(&Defect::Buffer),
            listed: 0,
        }
    }

    /// The same, with a list of this many initial entries.
    #[must_use]
    pub const fn with_listed(self, listed: u32) -> Self {
        Self { listed, ..self }
    }
}

impl fmt::Display for Defects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = [
            (self.poll, "poll"),
            (self.cap, "cap"),
            (self.list, "list"),
            (self.buffer, "buffer"),
        ];
        let names: Vec<_> = named
            .iter()
            .filter(|(on, _)| *on)
            .map(|(_, n)| *n)
            .collect();
        match names.as_slice() {
            [] => f.write_str("sound"),
            _ if self.with_listed(0) == Self::AS_PUBLISHED => f.write_str("as published"),
            names => write!(f, "sound except for {}", names.join(", ")),
        }
    }
}
