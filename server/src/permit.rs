//! The permit of a client, from its token, owners, and index ranges.
//!
//! Values, and their codec for snapshots and logs. `rights` decides whether a request is allowed.
//!
//! Indices of former members are granted again one by one: a body that lives keeps its own index and no other.
//! Invariants: no index is in two ranges, and a range beyond the first of each member leaves vacant indices for the
//! members that may still join.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rhumb_protocol::limits::{GRANT, GRANTED_MAX, RANGES_PER_MEMBER_MAX, RESERVE_MAX};
use rhumb_protocol::message::Role;
use rhumb_protocol::scene::{BodyDesc, Command, IdRange, JointId, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;

/// The name of a client in its tokens. It owns what it adds to a scene, over all its connections.
pub type ClientName = Arc<str>;

/// The rights of one connection.
#[derive(Clone, Debug, PartialEq)]
pub struct Permit {
    /// `None` without a token: then nothing in a scene belongs to the client.
    pub client: Option<ClientName>,
    /// The kind of requests that it may make.
    pub role: Role,
    /// Its part of the scene.
    pub quotas: Quotas,
    /// True if the scenes that it creates are its own: it alone steps and deletes them, they end when it leaves, and no
    /// store keeps them. Such clients are gateways of other protocols.
    pub owns: bool,
}

/// Limits of one client in one scene; `None` leaves the server's own limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    /// Bodies at one time.
    pub bodies: Option<u32>,
    /// Commands in a second, on average over a second. A faster client waits.
    pub commands: Option<u32>,
    /// Body steps in a second: ticks times substeps times the client's bodies.
    pub load: Option<u64>,
    /// Members at one time.
    pub members: Option<u32>,
    /// Scenes of the client's tenant at one time; in the permit of a connection, how many more there may be, its own among
    /// them.
    pub scenes: Option<u32>,
}

impl Permit {
    /// The rights of every client of an open server.
    pub const OPEN: Self = Self {
        client: None,
        role: Role::Owner,
        quotas: Quotas {
            bodies: None,
            commands: None,
            load: None,
            members: None,
            scenes: None,
        },
        owns: false,
    };

    /// The rights of a gateway, which owns the scenes that it creates.
    pub const GATEWAY: Self = Self {
        owns: true,
        ..Self::OPEN
    };
}

/// Owners in one scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ownership {
    bodies: BTreeMap<BodyId, ClientName>,
    shapes: BTreeMap<ShapeId, ClientName>,
    joints: BTreeMap<JointId, ClientName>,
    counts: BTreeMap<ClientName, u32>,
    /// Bits of the dampings that each client's bodies ever had: a scene keeps a table for each.
    dampings: BTreeMap<ClientName, BTreeSet<[u32; 2]>>,
}

impl Ownership {
    /// Notes the effect of a command that was applied.
    pub fn note(&mut self, client: Option<&ClientName>, command: &Command) {
        match (command, client) {
            (Command::AddBody { desc, .. }, Some(client)) => {
                self.bodies.insert(desc.id, client.clone());
                *self.counts.entry(client.clone()).or_default() += 1;
                self.note_damping(client, desc);
            }
            (Command::ChangeBody { desc }, Some(client)) => self.note_damping(client, desc),
            (Command::AddShape { id, .. }, Some(client)) => {
                self.shapes.insert(*id, client.clone());
            }
            (Command::AddJoint { id, .. }, Some(client)) => {
                self.joints.insert(*id, client.clone());
            }
            (Command::RemoveShape { id }, _) => {
                self.shapes.remove(id);
            }
            (Command::RemoveJoint { id }, _) => self.remove_joint(*id),
            _ => {}
        }
    }

    fn note_damping(&mut self, client: &ClientName, desc: &BodyDesc) {
        if let Some(damping) = damping_of(desc) {
            let dampings = self.dampings.entry(client.clone()).or_default();
            dampings.insert(damping);
        }
    }

    /// True if [`Self::note`] notes something of a command for its client.
    pub(crate) const fn concerns(command: &Command) -> bool {
        matches!(
            command,
            Command::AddBody { .. }
                | Command::AddShape { .. }
                | Command::AddJoint { .. }
                | Command::ChangeBody {
                    desc: BodyDesc {
                        damping: Some(_),
                        ..
                    }
                }
        )
    }

    /// Forgets a body that has left the scene.
    pub fn remove_body(&mut self, id: BodyId) {
        let Some(client) = self.bodies.remove(&id) else {
            return;
        };
        if let Some(count) = self.counts.get_mut(&client) {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&client);
            }
        }
    }

    /// Forgets a joint that has left the scene.
    pub fn remove_joint(&mut self, id: JointId) {
        self.joints.remove(&id);
    }

    /// Shapes of a client.
    pub(crate) fn shapes_of(&self, client: &ClientName) -> impl Iterator<Item = ShapeId> {
        let shapes = self.shapes.iter();
        shapes.filter_map(move |(id, owner)| (owner == client).then_some(*id))
    }

    /// Bodies of a client.
    pub(crate) fn bodies_of(&self, client: &ClientName) -> u32 {
        self.counts.get(client).copied().unwrap_or(0)
    }

    /// Number of a client's dampings if it adds a body.
    pub(crate) fn dampings_with(&self, client: &ClientName, desc: &BodyDesc) -> usize {
        let dampings = self.dampings.get(client);
        let known = dampings.map_or(0, BTreeSet::len);
        let is_new = damping_of(desc)
            .is_some_and(|damping| !dampings.is_some_and(|known| known.contains(&damping)));
        known + usize::from(is_new)
    }

    pub(crate) fn owns_body(&self, client: Option<&ClientName>, id: BodyId) -> bool {
        owns(&self.bodies, client, id)
    }

    pub(crate) fn owns_shape(&self, client: Option<&ClientName>, id: ShapeId) -> bool {
        owns(&self.shapes, client, id)
    }

    pub(crate) fn owns_joint(&self, client: Option<&ClientName>, id: JointId) -> bool {
        owns(&self.joints, client, id)
    }
}

/// The bits of a body's own damping.
fn damping_of(desc: &BodyDesc) -> Option<[u32; 2]> {
    let damping = desc.damping?;
    Some([damping.linear.to_bits(), damping.angular.to_bits()])
}

impl Wire for Ownership {
    fn encode(&self, to: &mut Writer) {
        encode_owners(&self.bodies, to);
        encode_owners(&self.shapes, to);
        encode_owners(&self.joints, to);
        to.varint(self.dampings.len() as u64);
        for (client, dampings) in &self.dampings {
            to.sized(client.as_bytes());
            to.varint(dampings.len() as u64);
            let bits = dampings.iter().flatten();
            bits.for_each(|bits| to.raw(&bits.to_le_bytes()));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut ownership = Self {
            bodies: decode_owners(from)?,
            shapes: decode_owners(from)?,
            joints: decode_owners(from)?,
            ..Self::default()
        };
        for client in ownership.bodies.values() {
            *ownership.counts.entry(client.clone()).or_default() += 1;
        }
        for _ in 0..from.varint()? {
            let dampings = ownership.dampings.entry(decode_client(from)?).or_default();
            for _ in 0..from.varint()? {
                dampings.insert([decode_bits(from)?, decode_bits(from)?]);
            }
        }
        Ok(ownership)
    }
}

fn decode_bits(from: &mut Reader<'_>) -> Result<u32, Malformed> {
    let bytes = from.raw(4)?;
    let bytes = bytes.try_into().map_err(|_| Malformed::Truncated)?;
    Ok(u32::from_le_bytes(bytes))
}

fn encode_owners<Id: Wire>(owners: &BTreeMap<Id, ClientName>, to: &mut Writer) {
    to.varint(owners.len() as u64);
    for (id, client) in owners {
        id.encode(to);
        to.sized(client.as_bytes());
    }
}

fn decode_owners<Id: Wire + Ord>(
    from: &mut Reader<'_>,
) -> Result<BTreeMap<Id, ClientName>, Malformed> {
    let mut owners = BTreeMap::new();
    for _ in 0..from.varint()? {
        let id = Id::decode(from)?;
        owners.insert(id, decode_client(from)?);
    }
    Ok(owners)
}

/// A client's name, as its length and text.
pub(crate) fn decode_client(from: &mut Reader<'_>) -> Result<ClientName, Malformed> {
    let bytes = from.sized(from.rest().len())?;
    let text = std::str::from_utf8(bytes).map_err(|_| Malformed::Text)?;
    Ok(text.into())
}

/// A client's name, or none.
pub fn encode_client_of(client: Option<&ClientName>, to: &mut Writer) {
    to.u8(u8::from(client.is_some()));
    if let Some(client) = client {
        to.sized(client.as_bytes());
    }
}

/// A client's name, or none.
///
/// # Errors
///
/// [`Malformed`] for bytes that are neither.
pub fn decode_client_of(from: &mut Reader<'_>) -> Result<Option<ClientName>, Malformed> {
    match from.u8()? {
        0 => Ok(None),
        1 => decode_client(from).map(Some),
        _ => Err(Malformed::UnknownCode),
    }
}

fn owns<Id: Ord>(owners: &BTreeMap<Id, ClientName>, client: Option<&ClientName>, id: Id) -> bool {
    client.is_some_and(|client| owners.get(&id) == Some(client))
}

/// The free indices of one scene. Members and sessions hold their own ranges.
#[derive(Debug, Default)]
pub(crate) struct IdRanges {
    /// No index from here on was ever granted.
    end: u32,
    /// Runs of indices below `end` that no member has: the first one, and their number. No two runs touch.
    free: BTreeMap<u32, u32>,
}

/// Bounds on the indices of a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IndexLimits {
    /// All new indices are below it: tables by index are no longer.
    pub(crate) indices: u32,
    /// Members that may still join.
    pub(crate) members: u32,
    /// Indices of each new member, at most [`GRANT`].
    pub(crate) share: u32,
}

impl IndexLimits {
    /// The bounds of a scene with so many indices, for at most `members_max` members, of which `members` are there.
    ///
    /// Each member has a share. A third is left for reservations, but no more than one member may ask for.
    pub(crate) fn of(indices: u64, members_max: u64, members: u64) -> Self {
        let shared = indices - (indices / 3).min(RESERVE_MAX.into());
        let share = shared / members_max.max(1);
        Self {
            indices: indices as u32,
            members: members_max.saturating_sub(members) as u32,
            share: share.clamp(1, GRANT.into()) as u32,
        }
    }
}

/// True if an id is in one of these ranges.
pub(crate) fn has(ranges: &[IdRange], id: BodyId) -> bool {
    ranges.iter().any(|range| range.contains(id))
}

/// Vacancy of an index: `None` while a body lives there, or if its generations are used up; otherwise the least unused
/// generation.
type Vacancy<'a> = dyn Fn(u32) -> Option<u16> + 'a;

/// Consecutive vacant indices.
#[derive(Clone, Copy, Debug, Default)]
struct VacantRun {
    first: u32,
    count: u32,
    generation: u16,
}

impl IdRanges {
    /// Grants a new member its first range: its share of the indices, or the longest run if none is so long. `None` when
    /// that has fewer than `least`.
    pub(crate) fn admit(
        &mut self,
        least: u32,
        limits: IndexLimits,
        vacancy: &Vacancy<'_>,
    ) -> Option<IdRange> {
        let fresh = self.fresh(limits);
        let share = limits.share;
        let run = match self.reuse(share, vacancy) {
            run if run.count >= share => run,
            _ if fresh.count >= share => fresh,
            run if run.count >= fresh.count => run,
            _ => fresh,
        };
        (run.count >= least).then(|| self.take(run, share))?
    }

    /// Grants a member `count` further indices, beside those that it has. `None` when no run of that length is left,
    /// when later members would find too few, or when the member has too many.
    pub(crate) fn reserve(
        &mut self,
        granted: &[IdRange],
        count: u32,
        limits: IndexLimits,
        vacancy: &Vacancy<'_>,
    ) -> Option<IdRange> {
        let indices: u32 = granted.iter().map(IdRange::count).sum();
        let fresh = self.fresh(limits);
        if granted.len() >= RANGES_PER_MEMBER_MAX
            || count > GRANTED_MAX - indices.min(GRANTED_MAX)
            || !self.has_left(
                count.saturating_add(limits.share.saturating_mul(limits.members)),
                fresh.count,
                vacancy,
            )
        {
            return None;
        }
        let again = self.reuse(count, vacancy);
        let run = if again.count < count { fresh } else { again };
        (run.count >= count).then(|| self.take(run, count))?
    }

    /// The indices that were never granted.
    fn fresh(&self, limits: IndexLimits) -> VacantRun {
        VacantRun {
            first: self.end,
            count: limits.indices.saturating_sub(self.end),
            generation: 0,
        }
    }

    /// True if at least `count` indices are vacant, `fresh` of which were never granted.
    fn has_left(&self, count: u32, fresh: u32, vacancy: &Vacancy<'_>) -> bool {
        let Some(wanted) = count.checked_sub(fresh).filter(|wanted| *wanted > 0) else {
            return true;
        };
        let runs = self.free.iter();
        let indices = runs.flat_map(|(first, length)| *first..first + length);
        let vacant = indices.filter(|index| vacancy(*index).is_some());
        vacant.take(wanted as usize).count() == wanted as usize
    }

    /// The first free run of `count` vacant indices; otherwise the longest.
    fn reuse(&self, count: u32, vacancy: &Vacancy<'_>) -> VacantRun {
        let mut longest = VacantRun::default();
        for (first, length) in &self.free {
            let mut run = VacantRun::default();
            for index in *first..first + length {
                let Some(generation) = vacancy(index) else {
                    run = VacantRun::default();
                    continue;
                };
                if run.count == 0 {
                    run.first = index;
                }
                run.count += 1;
                run.generation = run.generation.max(generation);
                if run.count > longest.count {
                    longest = run;
                }
                if longest.count >= count {
                    return longest;
                }
            }
        }
        longest
    }

    /// Grants the first `count` indices of a run, or all of them if it has fewer.
    fn take(&mut self, run: VacantRun, count: u32) -> Option<IdRange> {
        let count = run.count.min(count);
        let range = (count > 0).then(|| IdRange::new(run.first, count, run.generation))??;
        let after = run.first + count;
        if run.first >= self.end {
            self.end = after;
        } else if let Some((first, length)) = self.free.range(..=run.first).next_back() {
            let (first, end) = (*first, *first + *length);
            self.free.remove(&first);
            self.insert_free(first, run.first);
            self.insert_free(after, end);
        }
        Some(range)
    }

    fn insert_free(&mut self, first: u32, end: u32) {
        if first < end {
            self.free.insert(first, end - first);
        }
    }

    /// Grants indices from this one on, in a scene whose script has those before it.
    pub(crate) fn begin_after(&mut self, end: u32) {
        self.end = self.end.max(end);
    }

    /// Begins in a scene that had members before: sessions keep these ranges, and the other indices before `end` are
    /// free.
    pub(crate) fn restore(&mut self, end: u32, kept: impl IntoIterator<Item = IdRange>) {
        let mut kept: Vec<_> = kept.into_iter().collect();
        kept.sort_by_key(IdRange::first);
        let mut next = self.end;
        for range in kept {
            self.insert_free(next, range.first());
            next = next.max(range.first() + range.count());
        }
        self.insert_free(next, end);
        self.end = next.max(end);
    }

    /// Frees the ranges of a member that left, or of a session that is over.
    pub(crate) fn free(&mut self, ranges: Vec<IdRange>) {
        for range in ranges {
            let (mut first, mut end) = (range.first(), range.first() + range.count());
            if let Some(length) = self.free.remove(&end) {
                end += length;
            }
            if let Some((before, length)) = self.free.range(..first).next_back()
                && before + length == first
            {
                first = *before;
            }
            self.insert_free(first, end);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    const LIMITS: IndexLimits = IndexLimits {
        indices: 1 << 20,
        members: 0,
        share: GRANT,
    };

    fn nothing_lives(_: u32) -> Option<u16> {
        Some(3)
    }

    #[test]
    fn indices_without_bodies_are_granted_again() {
        let mut grants = IdRanges::default();
        let range = grants.admit(1, LIMITS, &nothing_lives).unwrap();
        assert_eq!(
            (range.first(), range.count(), range.generation()),
            (0, GRANT, 0)
        );
        assert!(has(&[range], BodyId::new(GRANT - 1, 0)));
        assert!(!has(&[range], BodyId::new(GRANT, 0)));
        grants.free(vec![range]);
        let mut second = Vec::new();
        let mut reserve = |count, vacancy: &Vacancy<'_>| {
            let range = grants.reserve(&second, count, LIMITS, vacancy).unwrap();
            second.push(range);
            range
        };
        // One body lives: the indices around it are free.
        let vacancy = |index| (index != 9).then_some(3);
        let again = reserve(5, &vacancy);
        assert_eq!(
            (again.first(), again.count(), again.generation()),
            (0, 5, 3)
        );
        let again = reserve(5, &vacancy);
        assert_eq!((again.first(), again.count()), (10, 5));
        let again = reserve(4, &vacancy);
        assert_eq!((again.first(), again.count()), (5, 4));
        let fresh = reserve(GRANT, &vacancy);
        assert_eq!((fresh.first(), fresh.generation()), (GRANT, 0));
    }

    #[test]
    fn a_new_member_gets_the_longest_run_if_none_suffices() {
        let mut grants = IdRanges::default();
        let limits = IndexLimits {
            indices: GRANT + 7,
            ..LIMITS
        };
        let first = grants.admit(1, limits, &nothing_lives).unwrap();
        let rest = grants.admit(1, limits, &nothing_lives).unwrap();
        assert_eq!((rest.first(), rest.count()), (GRANT, 7));
        assert_eq!(grants.admit(1, limits, &nothing_lives), None);
        grants.free(vec![first]);
        let vacancy = |index| (index % 100 != 50).then_some(0);
        let longest = grants.admit(1, limits, &vacancy).unwrap();
        assert_eq!((longest.first(), longest.count()), (51, 99));
    }

    #[test]
    fn one_member_takes_no_more_than_its_part_and_none_of_those_to_come() {
        let mut grants = IdRanges::default();
        let limits = IndexLimits {
            indices: 3 * GRANTED_MAX,
            members: 3,
            share: GRANT,
        };
        let mut members = [const { Vec::new() }; 5];
        let mut reserve = |member: usize, count| {
            let of: &mut Vec<_> = &mut members[member];
            let granted = grants.reserve(of, count, limits, &nothing_lives);
            of.extend(granted);
            granted.is_some()
        };
        assert!(reserve(1, RESERVE_MAX) && reserve(1, GRANT));
        assert!(!reserve(1, 1), "one member");
        assert!(reserve(2, RESERVE_MAX));
        assert!(!reserve(3, RESERVE_MAX), "three more members may come");
        let left = 3 * GRANTED_MAX - 2 * RESERVE_MAX - GRANT;
        assert!(reserve(3, left - 3 * GRANT));
        assert!(!reserve(4, 1));
        for _ in 5..8 {
            let granted = grants.admit(1, limits, &nothing_lives);
            assert_eq!(granted.map(|range| range.count()), Some(GRANT));
        }
        assert_eq!(grants.admit(1, limits, &nothing_lives), None);
    }

    #[test]
    fn each_member_that_a_scene_admits_finds_its_share() {
        for (indices, members_max) in [
            (393_216, 64),
            (393_216, 256),
            (4_096, 64),
            (4_096, 4_096),
            (1 << 20, 1),
        ] {
            let mut grants = IdRanges::default();
            for members in 0..members_max {
                let limits = IndexLimits::of(indices, members_max, members);
                let share = limits.share;
                let granted = grants.admit(share, limits, &nothing_lives);
                assert!(granted.is_some(), "{members} of {members_max}: {share}");
            }
        }
        let default = IndexLimits::of(393_216, 64, 0);
        assert_eq!(default.share, GRANT);
        let mut grants = IdRanges::default();
        let largest = grants.reserve(&[], RESERVE_MAX, default, &nothing_lives);
        assert!(largest.is_some(), "beside the shares of all");
    }

    #[test]
    fn a_restored_scene_has_free_indices_around_those_of_sessions() {
        let mut grants = IdRanges::default();
        let range = |first, count| IdRange::new(first, count, 0).unwrap();
        grants.restore(1_000, [range(500, 10), range(100, 10)]);
        assert_eq!(grants.free, [(0, 100), (110, 390), (510, 490)].into());
        grants.free(vec![range(100, 10)]);
        assert_eq!(grants.free, [(0, 500), (510, 490)].into());
        grants.free(vec![range(500, 10)]);
        assert_eq!((&grants.free, grants.end), (&[(0, 1_000)].into(), 1_000));
    }

    proptest! {
        /// Members come, reserve, leave some bodies behind and go, in any order.
        #[test]
        fn no_index_is_in_two_ranges_or_granted_while_its_body_lives(
            script in prop::collection::vec((0_u32..5, 0_usize..6, 1_u32..6_000), 1..80)
        ) {
            let mut grants = IdRanges::default();
            let mut members = [const { Vec::<IdRange>::new() }; 6];
            let mut living = BTreeSet::new();
            let limits = IndexLimits { indices: 30_000, ..LIMITS };
            for (what, member, number) in script {
                let ranges = &mut members[member];
                let vacancy = |index: u32| (!living.contains(&index)).then_some(0);
                match what {
                    0 if ranges.is_empty() => ranges.extend(grants.admit(1, limits, &vacancy)),
                    1 => ranges.extend(grants.reserve(ranges, number, limits, &vacancy)),
                    2 => grants.free(std::mem::take(ranges)),
                    3 => drop(living.pop_first()),
                    _ => {
                        let of = |range: &IdRange| range.first() + number % range.count();
                        living.extend(ranges.iter().map(of));
                    }
                }
                let mut runs: Vec<_> = grants.free.iter().map(|(a, n)| (*a, *n)).collect();
                let granted = members.iter().flatten();
                runs.extend(granted.map(|range| (range.first(), range.count())));
                runs.sort_unstable();
                let mut next = 0;
                for (first, count) in runs {
                    prop_assert_eq!(first, next);
                    next += count;
                }
                prop_assert_eq!(next, grants.end);
                prop_assert!(next <= limits.indices);
            }
        }
    }
}
