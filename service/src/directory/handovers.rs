//! Scenes that move by command, from one server to another.
//!
//! Decides, and asks the directory nothing itself: what is on the board comes in, as do readiness and claims. An operator
//! orders a move on the board. The new server restores the scene beside the old one and follows its log, then it says on
//! the board that it stands by. Only then the old one gives the scene up, and the new one claims it like any other: that
//! a scene never has two servers rests on claims alone, whatever the board says.

use std::collections::BTreeMap;

use rhumb_protocol::scene::SceneName;

use super::claims::{LeaseId, ServerPlace};

/// The notices of servers and operators in the directory. Each notice ends with a lease.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Board {
    /// Servers that run, with their leases.
    pub(super) servers: BTreeMap<ServerPlace, LeaseId>,
    /// Servers that were ordered to give up their scenes, each with its lease at the time of the order.
    pub(super) drained: BTreeMap<ServerPlace, LeaseId>,
    /// Scenes that are to move, each to this server.
    pub(super) orders: BTreeMap<SceneName, ServerPlace>,
    /// Scenes that a server follows and could take at once.
    pub(super) standbys: BTreeMap<SceneName, ServerPlace>,
    /// Scenes that have no files by which this server could take them.
    pub(super) refused: BTreeMap<SceneName, ServerPlace>,
}

impl Board {
    /// The servers that take scenes, except `but`.
    pub(super) fn taking<'a>(
        &'a self,
        but: &'a ServerPlace,
    ) -> impl Iterator<Item = &'a ServerPlace> {
        let takes = move |place: &&ServerPlace| *place != but && !self.drained.contains_key(*place);
        self.servers.keys().filter(takes)
    }
}

/// One notice on the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Notice {
    Server(ServerPlace),
    Drained(ServerPlace),
    Order(SceneName, ServerPlace),
    Standby(SceneName, ServerPlace),
    Refused(SceneName, ServerPlace),
}

/// One act of a server in a move.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum HandoverStep {
    /// Restore a scene of another server, and follow its log.
    Prepare(SceneName),
    /// The scene does not come: forget it.
    Forget(SceneName),
    /// Give a scene up: this server stands by.
    Leave(SceneName, ServerPlace),
}

/// One look for a scene's files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FilesSeen {
    There,
    Missing,
}

/// How near a scene is that comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Coming {
    /// Its files were looked for so often in vain.
    Sought(u32),
    /// It has files, which are followed.
    Followed,
    /// It could be taken at once.
    Ready,
}

/// Looks at the board, each a moment after the last one, after which a scene without files is refused: one that was created
/// just before its order has them by then.
const LOOKS: u32 = 20;

/// The moves that concern one server.
#[derive(Debug)]
pub(super) struct Handovers {
    place: ServerPlace,
    /// Scenes that come.
    coming: BTreeMap<SceneName, Coming>,
    /// Scenes that are to go, each to this server.
    going: BTreeMap<SceneName, ServerPlace>,
    /// True if a scene is ordered to go.
    is_ordered: bool,
    /// True if this server was ordered to give up its scenes. It holds until the server ends, also under a later lease.
    is_drained: bool,
    /// Another server that takes scenes, if there is one.
    other: Option<ServerPlace>,
}

impl Handovers {
    pub(super) const fn new(place: ServerPlace) -> Self {
        Self {
            place,
            coming: BTreeMap::new(),
            going: BTreeMap::new(),
            is_ordered: false,
            is_drained: false,
            other: None,
        }
    }

    /// True if the server gives all scenes away, and takes none.
    pub(super) const fn is_drained(&self) -> bool {
        self.is_drained
    }

    /// Takes the board, and says what is to be done. `lease`: this server's; an order to an earlier server at its place has
    /// another one. `owns`: true for a scene that is this server's.
    pub(super) fn take_board(
        &mut self,
        board: &Board,
        lease: Option<LeaseId>,
        owns: impl Fn(&SceneName) -> bool,
    ) -> Vec<HandoverStep> {
        self.is_drained |= lease.is_some() && board.drained.get(&self.place) == lease.as_ref();
        self.other = board.taking(&self.place).next().cloned();
        let goes = |(scene, to): (&SceneName, &ServerPlace)| *to != self.place && owns(scene);
        self.is_ordered = board.orders.iter().any(goes);
        let mut steps = Vec::new();
        let is_ordered = |scene: &SceneName| board.orders.get(scene) == Some(&self.place);
        let over: Vec<_> = (self.coming.keys())
            .filter(|scene| !is_ordered(scene))
            .cloned()
            .collect();
        for scene in over {
            self.coming.remove(&scene);
            steps.push(HandoverStep::Forget(scene));
        }
        // A later order may be the same as one that is done.
        (self.going).retain(|scene, to| board.orders.get(scene) == Some(to) && owns(scene));
        for (scene, to) in &board.orders {
            match (*to == self.place, owns(scene)) {
                (true, false) if !self.coming.contains_key(scene) => {
                    self.coming.insert(scene.clone(), Coming::Sought(0));
                    steps.push(HandoverStep::Prepare(scene.clone()));
                }
                (false, true)
                    if board.standbys.get(scene) == Some(to) && !self.going.contains_key(scene) =>
                {
                    self.going.insert(scene.clone(), to.clone());
                    steps.push(HandoverStep::Leave(scene.clone(), to.clone()));
                }
                _ => {}
            }
        }
        steps
    }

    /// Notices on a board that are of no use any more: orders that are done, as the scenes are this server's, and its refusals
    /// of scenes that it does not refuse now.
    pub(super) fn useless(&self, board: &Board, owns: impl Fn(&SceneName) -> bool) -> Vec<Notice> {
        let orders = board.orders.iter();
        let done = orders.filter(|(scene, to)| **to == self.place && owns(scene));
        let refusals = board.refused.iter();
        let stale = refusals.filter(|(scene, by)| **by == self.place && !self.refuses(scene));
        done.map(|(scene, to)| Notice::Order(scene.clone(), to.clone()))
            .chain(stale.map(|(scene, by)| Notice::Refused(scene.clone(), by.clone())))
            .collect()
    }

    /// The notices that the board lacks of this server, which has this lease. What this server says there is compared with
    /// each board, because a notice can be lost, and because an operator takes a refusal away with its order.
    pub(super) fn missing(&self, board: &Board, lease: LeaseId) -> Vec<Notice> {
        let is_there = board.servers.get(&self.place) == Some(&lease);
        let server = (!is_there).then(|| Notice::Server(self.place.clone()));
        let is_known = board.drained.get(&self.place) == Some(&lease);
        let drained = (self.is_drained && !is_known).then(|| Notice::Drained(self.place.clone()));
        let standbys = self
            .awaited()
            .filter(|scene| board.standbys.get(*scene) != Some(&self.place));
        let standbys = standbys.map(|scene| Notice::Standby(scene.clone(), self.place.clone()));
        let refused = (self.coming.keys())
            .filter(|scene| self.refuses(scene) && board.refused.get(*scene) != Some(&self.place));
        let refused = refused.map(|scene| Notice::Refused(scene.clone(), self.place.clone()));
        let of_server = server.into_iter().chain(drained);
        of_server.chain(standbys).chain(refused).collect()
    }

    /// Everything is over with the lease; the scenes that do not come.
    pub(super) fn lose(&mut self) -> Vec<HandoverStep> {
        self.going.clear();
        let coming = std::mem::take(&mut self.coming).into_keys();
        coming.map(HandoverStep::Forget).collect()
    }

    /// Notes that a scene that comes could be taken at once; the notice of it, unless it does not come any more.
    pub(super) fn note_ready(&mut self, scene: &SceneName) -> Option<Notice> {
        *self.coming.get_mut(scene)? = Coming::Ready;
        Some(Notice::Standby(scene.clone(), self.place.clone()))
    }

    /// Notes that a scene is this server's; the notices that are of no use any more.
    pub(super) fn note_owned(&mut self, scene: &SceneName) -> Vec<Notice> {
        match self.coming.remove(scene) {
            None => Vec::new(),
            Some(_) => {
                let place = &self.place;
                vec![
                    Notice::Order(scene.clone(), place.clone()),
                    Notice::Standby(scene.clone(), place.clone()),
                ]
            }
        }
    }

    /// The scenes that come and whose files have not been found.
    pub(super) fn sought(&self) -> impl Iterator<Item = &SceneName> {
        let sought = self.coming.iter();
        let sought = sought.filter(|(_, coming)| matches!(coming, Coming::Sought(_)));
        sought.map(|(scene, _)| scene)
    }

    /// Notes whether a scene that comes has files.
    pub(super) fn note_files(&mut self, scene: &SceneName, seen: FilesSeen) {
        let Some(coming) = self.coming.get_mut(scene) else {
            return;
        };
        if let Coming::Sought(looks) = coming {
            *coming = match seen {
                FilesSeen::There => Coming::Followed,
                FilesSeen::Missing => Coming::Sought(looks.saturating_add(1)),
            };
        }
    }

    /// True for a scene that is ordered here and had no files at enough looks.
    fn refuses(&self, scene: &SceneName) -> bool {
        matches!(self.coming.get(scene), Some(Coming::Sought(looks)) if *looks >= LOOKS)
    }

    /// True for a scene that is asked for again until it is this server's.
    pub(super) fn awaits(&self, scene: &SceneName) -> bool {
        self.coming.get(scene) == Some(&Coming::Ready)
    }

    /// The scenes that are to be asked for again.
    pub(super) fn awaited(&self) -> impl Iterator<Item = &SceneName> {
        let coming = self.coming.iter();
        let ready = coming.filter(|(_, coming)| **coming == Coming::Ready);
        ready.map(|(scene, _)| scene)
    }

    /// True while a scene comes or goes, so that the board is read often.
    pub(super) fn is_busy(&self) -> bool {
        self.is_ordered || !self.coming.is_empty() || !self.going.is_empty()
    }

    /// The server to which clients that ask for a scene of none are sent, if this one is to have no scenes.
    pub(super) fn instead(&self) -> Option<&ServerPlace> {
        self.other.as_ref().filter(|_| self.is_drained)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> ServerPlace {
        ServerPlace(name.to_owned())
    }

    fn pit() -> SceneName {
        "pit".parse().expect("a name")
    }

    /// A board on which the pit is to move from `a` to `b`.
    fn ordered() -> Board {
        let servers = [(place("a"), LeaseId(1)), (place("b"), LeaseId(2))];
        Board {
            servers: servers.into(),
            orders: [(pit(), place("b"))].into(),
            ..Board::default()
        }
    }

    #[test]
    fn a_scene_leaves_once_the_other_server_stands_by() {
        let (mut from, mut to) = (Handovers::new(place("a")), Handovers::new(place("b")));
        let mut board = ordered();
        assert_eq!(from.take_board(&board, None, |_| true), []);
        let prepare = [HandoverStep::Prepare(pit())];
        assert_eq!(to.take_board(&board, None, |_| false), prepare);
        assert_eq!(
            to.take_board(&board, None, |_| false),
            [],
            "it does so already"
        );
        assert!(!to.awaits(&pit()));
        let standby = to.note_ready(&pit());
        assert_eq!(standby, Some(Notice::Standby(pit(), place("b"))));
        assert!(to.awaits(&pit()));
        board.standbys.insert(pit(), place("b"));
        let leave = [HandoverStep::Leave(pit(), place("b"))];
        assert_eq!(from.take_board(&board, None, |_| true), leave);
        assert_eq!(from.take_board(&board, None, |_| true), [], "once");
        assert_eq!(from.take_board(&board, None, |_| false), [], "it is gone");
        assert_eq!(from.take_board(&board, None, |_| true), leave, "it is back");
        let useless = [
            Notice::Order(pit(), place("b")),
            Notice::Standby(pit(), place("b")),
        ];
        assert_eq!(to.note_owned(&pit()), useless);
        assert!(!to.is_busy());
    }

    #[test]
    fn an_order_that_ends_is_forgotten_at_both_ends() {
        let (mut from, mut to) = (Handovers::new(place("a")), Handovers::new(place("b")));
        let mut board = ordered();
        to.take_board(&board, None, |_| false);
        to.note_ready(&pit());
        board.standbys.insert(pit(), place("b"));
        from.take_board(&board, None, |_| true);
        assert!(from.is_busy());
        let nothing = Board::default();
        assert_eq!(from.take_board(&nothing, None, |_| true), []);
        let forget = [HandoverStep::Forget(pit())];
        assert_eq!(to.take_board(&nothing, None, |_| false), forget);
        assert!(!from.is_busy() && !to.is_busy());
        assert_eq!(to.note_ready(&pit()), None, "it came too late");
    }

    #[test]
    fn a_scene_without_files_is_refused_while_its_order_stands_and_it_has_none() {
        let mut to = Handovers::new(place("b"));
        let mut board = ordered();
        to.take_board(&board, None, |_| false);
        for _ in 0..LOOKS {
            assert_eq!(to.sought().collect::<Vec<_>>(), [&pit()]);
            assert_eq!(to.missing(&board, LeaseId(2)), []);
            to.note_files(&pit(), FilesSeen::Missing);
        }
        let refused = [Notice::Refused(pit(), place("b"))];
        assert_eq!(to.missing(&board, LeaseId(2)), refused);
        board.refused.insert(pit(), place("b"));
        assert_eq!(to.missing(&board, LeaseId(2)), [], "it is there");
        assert_eq!(to.useless(&board, |_| false), []);
        // An operator takes its order back and gives it again, and this server has seen no board between.
        board.refused.clear();
        assert_eq!(to.take_board(&board, None, |_| false), []);
        assert_eq!(to.missing(&board, LeaseId(2)), refused, "again");
        board.refused.insert(pit(), place("b"));
        to.note_files(&pit(), FilesSeen::There);
        assert_eq!(to.useless(&board, |_| false), refused, "it has files");
        assert_eq!(to.sought().count(), 0);
        to.note_files(&pit(), FilesSeen::Missing);
        assert_eq!(to.missing(&ordered(), LeaseId(2)), [], "it was there");
    }

    #[test]
    fn a_refusal_ends_with_its_order() {
        let mut to = Handovers::new(place("b"));
        let mut board = ordered();
        to.take_board(&board, None, |_| false);
        for _ in 0..LOOKS {
            to.note_files(&pit(), FilesSeen::Missing);
        }
        board.orders.clear();
        board.refused.insert(pit(), place("b"));
        assert_eq!(
            to.take_board(&board, None, |_| false),
            [HandoverStep::Forget(pit())]
        );
        assert_eq!(to.missing(&board, LeaseId(2)), []);
        let refused = [Notice::Refused(pit(), place("b"))];
        assert_eq!(to.useless(&board, |_| false), refused);
        board.refused.insert(pit(), place("c"));
        assert_eq!(to.useless(&board, |_| false), [], "another server's");
    }

    #[test]
    fn a_standby_of_a_third_server_moves_nothing() {
        let mut from = Handovers::new(place("a"));
        let mut board = ordered();
        board.standbys.insert(pit(), place("c"));
        assert_eq!(from.take_board(&board, None, |_| true), []);
        let mut third = Handovers::new(place("c"));
        assert_eq!(third.take_board(&board, None, |_| false), []);
    }

    #[test]
    fn an_order_to_the_server_that_has_the_scene_is_done() {
        let mut to = Handovers::new(place("b"));
        assert_eq!(to.take_board(&ordered(), None, |_| true), []);
        let done = [Notice::Order(pit(), place("b"))];
        assert_eq!(to.useless(&ordered(), |_| true), done);
    }

    #[test]
    fn notices_that_were_lost_are_posted_again() {
        let mut to = Handovers::new(place("b"));
        let board = ordered();
        assert_eq!(to.missing(&board, LeaseId(2)), []);
        let server = [Notice::Server(place("b"))];
        assert_eq!(to.missing(&board, LeaseId(3)), server, "a later lease");
        to.take_board(&board, None, |_| false);
        to.note_ready(&pit());
        let standby = [Notice::Standby(pit(), place("b"))];
        assert_eq!(to.missing(&board, LeaseId(2)), standby);
        assert_eq!(to.lose(), [HandoverStep::Forget(pit())]);
        assert_eq!(to.missing(&board, LeaseId(2)), []);
    }

    #[test]
    fn a_drained_server_names_one_that_takes_scenes() {
        let mut drained = Handovers::new(place("a"));
        let mut board = ordered();
        let lease = Some(LeaseId(1));
        drained.take_board(&board, lease, |_| false);
        assert_eq!(drained.instead(), None);
        board.drained.insert(place("a"), LeaseId(9));
        drained.take_board(&board, lease, |_| false);
        assert_eq!(drained.instead(), None, "an earlier server's order");
        board.drained.insert(place("a"), LeaseId(1));
        drained.take_board(&board, lease, |_| false);
        assert_eq!(drained.instead(), Some(&place("b")));
        board.drained.insert(place("b"), LeaseId(2));
        drained.take_board(&board, lease, |_| false);
        assert_eq!(drained.instead(), None, "none is left");
    }

    #[test]
    fn a_drained_server_stays_so_under_a_later_lease() {
        let mut drained = Handovers::new(place("a"));
        let mut board = ordered();
        board.drained.insert(place("a"), LeaseId(1));
        drained.take_board(&board, Some(LeaseId(1)), |_| false);
        assert_eq!(drained.missing(&board, LeaseId(1)), []);
        drained.lose();
        board.drained.clear();
        board.servers.insert(place("a"), LeaseId(5));
        drained.take_board(&board, Some(LeaseId(5)), |_| false);
        assert!(drained.is_drained());
        let again = [Notice::Drained(place("a"))];
        assert_eq!(drained.missing(&board, LeaseId(5)), again);
        board.drained.insert(place("a"), LeaseId(5));
        assert_eq!(drained.missing(&board, LeaseId(5)), []);
    }
}
