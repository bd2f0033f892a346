//! The connections of an edge to the owners of scenes, and its mirrors.
//!
//! Opens, reopens and ends connections; what comes over them is for the edge. Invariant: a mirror has one connection at
//! most, and is kept as long as a client needs it.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_protocol::limits::STREAMS_PER_SCENE_MAX;
use rhumb_protocol::message::{StreamChoice, Token};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_reckoning::Tick;

use crate::client::{EdgeClient, EdgeMember, MirrorId};
use crate::mirror::{Mirror, RETRY};
use crate::voice::Voice;

/// Time for which a mirror without members is kept.
const KEPT: Span = Span::from_millis(10_000);
/// Mirrors of an edge, for all scenes together. Derived: half of the connections that an owner takes from one address;
/// the others are for members that act.
pub const MIRRORS_MAX: usize = 256;

/// Addresses of moved scenes beyond which all are forgotten, and learned anew.
const MOVED_MAX: usize = 1_024;

/// A connection to open to the owner of a scene; `handle_opened` of [`OwnerSide`](crate::OwnerSide) follows, or
/// `handle_ended`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dial {
    /// The number of the connection.
    pub link: Peer,
    /// The scene that it will name.
    pub scene: SceneName,
    /// The address of the server that has the scene (PROTOCOL 3.7), if it is not the owner that the edge was given.
    pub elsewhere: Option<String>,
}

/// The purpose of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LinkUse {
    Mirror(MirrorId),
    /// The client that it speaks for.
    Voice(Peer),
}

/// Mirrors and connections.
pub(crate) struct Owners {
    pub(crate) mirrors: BTreeMap<MirrorId, Mirror>,
    pub(crate) links: BTreeMap<Peer, LinkUse>,
    /// The token of the edge itself.
    token: Option<Token>,
    next_mirror: u64,
    next_link: u64,
    dials: VecDeque<Dial>,
    /// Addresses of scenes that have moved.
    moved: BTreeMap<SceneName, String>,
    /// The last bytes for connections that the edge has ended.
    last_words: VecDeque<Transmit>,
}

impl Owners {
    pub(crate) const fn new(token: Option<Token>) -> Self {
        Self {
            mirrors: BTreeMap::new(),
            links: BTreeMap::new(),
            token,
            next_mirror: 0,
            next_link: 0,
            dials: VecDeque::new(),
            moved: BTreeMap::new(),
            last_words: VecDeque::new(),
        }
    }

    pub(crate) fn get(&self, id: MirrorId) -> Option<&Mirror> {
        self.mirrors.get(&id)
    }

    pub(crate) fn get_mut(&mut self, id: MirrorId) -> Option<&mut Mirror> {
        self.mirrors.get_mut(&id)
    }

    /// The streams of all mirrors that know theirs.
    pub(crate) fn streams(&self) -> impl Iterator<Item = SharedStream> {
        self.mirrors.values().filter_map(|mirror| {
            let (scene, stream) = (mirror.scene.clone(), mirror.stream()?);
            Some(SharedStream { scene, stream })
        })
    }

    /// The mirrors of a scene.
    pub(crate) fn of_scene<'a>(
        &'a self,
        scene: Option<&'a SceneName>,
    ) -> impl Iterator<Item = (MirrorId, &'a Mirror)> {
        let mirrors = self.mirrors.iter().map(|(id, mirror)| (*id, mirror));
        mirrors.filter(move |(_, mirror)| Some(&mirror.scene) == scene)
    }

    /// The mirror of a scene for a choice.
    pub(crate) fn of_choice(
        &self,
        scene: Option<&SceneName>,
        choice: StreamChoice,
    ) -> Option<(MirrorId, &Mirror)> {
        self.mirrors
            .iter()
            .map(|(id, mirror)| (*id, mirror))
            .find(|(_, mirror)| Some(&mirror.scene) == scene && mirror.choice == choice)
    }

    /// The time of a mirror's scene at a moment: a tick, and nanoseconds since it.
    pub(crate) fn time(&self, now: Instant, mirror: Option<MirrorId>) -> (Tick, u64) {
        let mirror = mirror.and_then(|id| self.get(id));
        mirror.map_or((Tick::ZERO, 0), |mirror| mirror.time(now))
    }

    /// The next connection to open: one of a mirror, for which all of its observers wait, before those that speak for one
    /// client.
    pub(crate) fn poll_dial(&mut self) -> Option<Dial> {
        let is_mirrors =
            |dial: &Dial| matches!(self.links.get(&dial.link), Some(LinkUse::Mirror(_)));
        let place = self.dials.iter().position(is_mirrors).unwrap_or(0);
        self.dials.remove(place)
    }

    pub(crate) fn dial(&mut self, scene: SceneName, use_of: LinkUse) -> Peer {
        let link = Peer(self.next_link);
        self.next_link += 1;
        self.links.insert(link, use_of);
        let elsewhere = self.moved.get(&scene).cloned();
        self.dials.push_back(Dial {
            link,
            scene,
            elsewhere,
        });
        link
    }

    /// Notes where a scene is, by the end of a connection that named it. If nothing answers there, the scene is asked for
    /// at the edge's own owner again.
    pub(crate) fn note_end(&mut self, scene: &SceneName, ending: Ending, elsewhere: Option<&str>) {
        match (ending, elsewhere) {
            (Ending::Closed(_), None) => {}
            (Ending::Closed(_), Some(address)) => {
                // Each entry is of a scene that a client has named, and scenes that are over are few.
                if self.moved.len() >= MOVED_MAX {
                    self.moved.clear();
                }
                self.moved.insert(scene.clone(), address.to_owned());
            }
            (Ending::TimedOut | Ending::Broken, _) => drop(self.moved.remove(scene)),
        }
    }

    /// Notes the end of a mirror's connection. One whose scene has moved is connected at once; true if it is.
    pub(crate) fn note_mirror_end(&mut self, now: Instant, id: MirrorId, ending: Ending) -> bool {
        let Some(mirror) = self.mirrors.get_mut(&id) else {
            return false;
        };
        let elsewhere = mirror.elsewhere().map(str::to_owned);
        let follows = elsewhere.is_some() && mirror.follow(now);
        let scene = mirror.scene.clone();
        self.note_end(&scene, ending, elsewhere.as_deref());
        follows
    }

    /// Makes and connects the mirror of a choice, unless it is there. Returns false if there is no room for it.
    pub(crate) fn mirror_of(
        &mut self,
        now: Instant,
        (scene, choice): (&SceneName, StreamChoice),
        is_used: impl Fn(MirrorId, &Mirror) -> bool,
    ) -> bool {
        let mut mirrors = self.mirrors.values_mut();
        let found = mirrors.find(|mirror| mirror.scene == *scene && mirror.choice == choice);
        if let Some(mirror) = found {
            mirror.join_again();
            return true;
        }
        if !self.make_room(scene, is_used) {
            return false;
        }
        let id = MirrorId(self.next_mirror);
        self.next_mirror += 1;
        self.mirrors.insert(id, Mirror::new(scene.clone(), choice));
        self.connect(now, id);
        true
    }

    /// Returns false if a scene, or the edge, has as many mirrors as it may, and needs them all. Of those that no client
    /// needs, the one unused for the longest time makes room, unless it is being dialled.
    fn make_room(
        &mut self,
        scene: &SceneName,
        is_used: impl Fn(MirrorId, &Mirror) -> bool,
    ) -> bool {
        let of_scene = self.of_scene(Some(scene)).count();
        let is_full_scene = of_scene >= STREAMS_PER_SCENE_MAX;
        if !is_full_scene && self.mirrors.len() < MIRRORS_MAX {
            return true;
        }
        let is_candidate = |id, mirror: &Mirror| {
            let helps = !is_full_scene || mirror.scene == *scene;
            helps && !is_used(id, mirror) && !self.is_dialling(mirror)
        };
        let candidates = self.mirrors.iter();
        let candidates = candidates.filter(|(id, mirror)| is_candidate(**id, mirror));
        // A stream that is not noted as unused yet was needed a moment ago.
        let longest = candidates.min_by_key(|(_, mirror)| {
            let since = mirror.unused_since;
            (since.is_none(), since)
        });
        let Some(unused) = longest.map(|(id, _)| *id) else {
            return false;
        };
        self.close(unused);
        true
    }

    /// True while the driver opens a mirror's connection.
    fn is_dialling(&self, mirror: &Mirror) -> bool {
        let is_waiting = |link| self.dials.iter().any(|dial| dial.link == link);
        (mirror.link).is_some_and(|link| !mirror.is_open() && !is_waiting(link))
    }

    /// Leaves a stream.
    fn close(&mut self, id: MirrorId) {
        let Some(mut mirror) = self.mirrors.remove(&id) else {
            return;
        };
        let Some(link) = mirror.link else {
            return;
        };
        self.links.remove(&link);
        if self.forget_dial(link) {
            return;
        }
        mirror.close();
        while let Some(transmit) = mirror.poll_transmit() {
            self.last_words.push_back(to_link(transmit, link));
        }
        if !mirror.is_open() {
            // The session knows of no connection to close.
            let code = CloseCode::DONE.0;
            let close = Transmit::Close { to: link, code };
            self.last_words.push_back(close);
        }
    }

    /// Returns true if the driver was yet to open this connection, and does not any more.
    fn forget_dial(&mut self, link: Peer) -> bool {
        let waiting = self.dials.len();
        self.dials.retain(|dial| dial.link != link);
        self.dials.len() < waiting
    }

    /// The mirror whose snapshot a client waits for and could be sent.
    pub(crate) fn source_for(&self, client: &EdgeClient) -> Option<MirrorId> {
        let (choice, needs) = client.awaits_copy()?;
        let (id, mirror) = self.of_choice(client.scene.as_ref(), choice)?;
        // Both copies of a member count the same scene events.
        let at = mirror.scene_events();
        let is_behind = |member: &EdgeMember| {
            let present = self.get(member.mirror);
            present.is_some_and(|present| present.is_live() && present.scene_events() != at)
        };
        let is_behind = at < needs || client.member.as_ref().is_some_and(is_behind);
        (mirror.is_settled() && !is_behind).then_some(id)
    }

    fn connect(&mut self, now: Instant, id: MirrorId) {
        let Some(scene) = self.mirrors.get(&id).map(|mirror| mirror.scene.clone()) else {
            return;
        };
        let link = self.dial(scene, LinkUse::Mirror(id));
        let token = self.token.clone();
        if let Some(mirror) = self.mirrors.get_mut(&id) {
            mirror.connect(link, token);
            mirror.retry_at = now + RETRY;
        }
    }

    /// The answers to a member that has left are dropped.
    pub(crate) fn forget_questions(&mut self, peer: Peer) {
        for mirror in self.mirrors.values_mut() {
            mirror.forget_questions(peer);
        }
    }

    /// A client's connection to the owner of this scene broke.
    pub(crate) fn doubt(&mut self, now: Instant, scene: Option<&SceneName>) {
        let mirrors = self.mirrors.values_mut();
        for mirror in mirrors.filter(|mirror| Some(&mirror.scene) == scene) {
            mirror.doubt(now);
        }
    }

    /// Forgets a client's connection, once it has sent what it has.
    pub(crate) fn end_voice(&mut self, mut voice: Voice) {
        let link = voice.link();
        self.links.remove(&link);
        if self.forget_dial(link) {
            return;
        }
        while let Some(transmit) = voice.poll_transmit() {
            self.last_words.push_back(to_link(transmit, link));
        }
    }

    /// Leaves the streams that no client has needed for some time.
    pub(crate) fn close_unused(
        &mut self,
        now: Instant,
        is_used: impl Fn(MirrorId, &Mirror) -> bool,
    ) {
        for (id, mirror) in &mut self.mirrors {
            let since = mirror.unused_since.unwrap_or(now);
            mirror.unused_since = (!is_used(*id, mirror)).then_some(since);
        }
        let is_over =
            |mirror: &Mirror| mirror.unused_since.is_some_and(|since| now >= since + KEPT);
        let unused = self.mirrors.iter().filter(|(_, mirror)| is_over(mirror));
        for id in unused.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.close(id);
        }
    }

    /// Does what is due: returns the mirrors whose timeout has come, and connects those that have lost their connection.
    pub(crate) fn wake(&mut self, now: Instant) -> Vec<MirrorId> {
        let is_due = |mirror: &Mirror| mirror.poll_timeout().is_some_and(|wake| wake.at <= now);
        let mut due = Vec::new();
        for (id, mirror) in &mut self.mirrors {
            if mirror.is_refused() && mirror.retry_at <= now {
                mirror.join_again();
                mirror.retry_at = now + RETRY;
            }
            if is_due(mirror) {
                mirror.handle_timeout(now);
                due.push(*id);
            }
        }
        let is_lost = |mirror: &Mirror| mirror.link.is_none() && mirror.retry_at <= now;
        let lost = self.mirrors.iter().filter(|(_, mirror)| is_lost(mirror));
        for id in lost.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.connect(now, id);
        }
        due
    }

    pub(crate) fn next_wake(&self) -> Option<Wake> {
        let deadline = |at| Wake {
            at,
            reason: WakeReason::Deadline,
        };
        let mirrors = || self.mirrors.values();
        let lost = mirrors().filter(|mirror| mirror.link.is_none() || mirror.is_refused());
        let retries = lost.map(|mirror| deadline(mirror.retry_at));
        let unused = mirrors().filter_map(|mirror| Some(deadline(mirror.unused_since? + KEPT)));
        let sessions = mirrors().filter_map(Mirror::poll_timeout);
        (retries.chain(unused).chain(sessions)).min_by_key(|wake| wake.at)
    }

    /// The next transmission of a mirror, or of a connection that has ended.
    pub(crate) fn poll_transmit(&mut self) -> Option<Transmit> {
        self.last_words.pop_front().or_else(|| {
            self.mirrors.values_mut().find_map(|mirror| {
                let link = mirror.link?;
                Some(to_link(mirror.poll_transmit()?, link))
            })
        })
    }
}

/// The transmission of a session with one peer, for the link that carries it.
pub(crate) fn to_link(transmit: Transmit, link: Peer) -> Transmit {
    match transmit {
        Transmit::Control { bytes, .. } => Transmit::Control { to: link, bytes },
        Transmit::State { bytes, .. } => Transmit::State { to: link, bytes },
        Transmit::Close { code, .. } => Transmit::Close { to: link, code },
    }
}

/// Bytes that wait for a fan-out, with the cost of each packet. Derived: those of a client that does not read.
const SHARED_BYTES: usize = 4 << 20;
/// Cost of a packet beside its bytes.
const PACKET_COST_BYTES: usize = 64;

/// A stream that a fan-out carries.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SharedStream {
    /// The scene.
    pub scene: SceneName,
    /// The stream of the scene.
    pub stream: StreamId,
}

/// A packet for all that a fan-out carries it to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SharedPacket {
    /// Its stream.
    pub of: SharedStream,
    /// The datagram.
    pub bytes: Bytes,
}

/// Packets that wait for a fan-out, oldest first.
///
/// At most [`SHARED_BYTES`] wait; the oldest are dropped for newer ones, as a network drops them.
#[derive(Debug, Default)]
pub(crate) struct SharedQueue {
    waiting: VecDeque<SharedPacket>,
    cost_bytes: usize,
}

impl SharedQueue {
    pub(crate) fn push(&mut self, packet: SharedPacket) {
        self.cost_bytes += cost(&packet);
        self.waiting.push_back(packet);
        while self.cost_bytes > SHARED_BYTES && self.pop().is_some() {}
    }

    pub(crate) fn pop(&mut self) -> Option<SharedPacket> {
        let packet = self.waiting.pop_front()?;
        self.cost_bytes -= cost(&packet);
        Some(packet)
    }
}

fn cost(packet: &SharedPacket) -> usize {
    packet.bytes.len() + PACKET_COST_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrors_are_dialled_before_voices_and_each_kind_in_its_order() {
        let mut owners = Owners::new(None);
        let voice = |client| LinkUse::Voice(Peer(client));
        let mirror = |id| LinkUse::Mirror(MirrorId(id));
        let scene: SceneName = "pit".parse().expect("a name");
        let uses = [voice(1), mirror(0), voice(2), mirror(1)];
        let links = uses.map(|use_of| owners.dial(scene.clone(), use_of));
        let dialled = std::iter::from_fn(|| owners.poll_dial()).map(|dial| dial.link);
        let order = [1, 3, 0, 2].map(|place: usize| links[place]);
        assert_eq!(dialled.collect::<Vec<_>>(), order);
    }

    #[test]
    fn a_scene_that_moved_is_dialled_there_until_nothing_answers() {
        let mut owners = Owners::new(None);
        let scene: SceneName = "pit".parse().expect("a name");
        let dialled = |owners: &mut Owners| {
            owners.dial(scene.clone(), LinkUse::Voice(Peer(1)));
            owners.poll_dial().and_then(|dial| dial.elsewhere)
        };
        assert_eq!(dialled(&mut owners), None);
        let moved = Ending::Closed(CloseCode::SCENE_ELSEWHERE.0);
        owners.note_end(&scene, moved, Some("rhumb://b:1"));
        assert_eq!(dialled(&mut owners).as_deref(), Some("rhumb://b:1"));
        owners.note_end(&scene, Ending::Closed(CloseCode::BUSY.0), None);
        assert_eq!(dialled(&mut owners).as_deref(), Some("rhumb://b:1"));
        owners.note_end(&scene, Ending::Broken, None);
        assert_eq!(dialled(&mut owners), None);
    }

    #[test]
    fn without_a_fan_out_the_oldest_packets_are_dropped() {
        let mut queue = SharedQueue::default();
        let packet = |number: u32| SharedPacket {
            of: SharedStream {
                scene: "stage".parse().expect("a valid name"),
                stream: StreamId(1),
            },
            bytes: Bytes::from([number.to_be_bytes().as_slice(), &[0; 996]].concat()),
        };
        for number in 0..10_000 {
            queue.push(packet(number));
        }
        let kept = SHARED_BYTES / (1_000 + PACKET_COST_BYTES);
        let left: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(left.len(), kept);
        assert_eq!(left[0], packet(10_000 - kept as u32));
        assert_eq!(queue.cost_bytes, 0);
    }
}
