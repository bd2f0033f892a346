//! Which stream a member asks for: one at a time, and then the newest wish
//!
//! Says nothing itself. Invariants: nothing is asked while a question is not answered (PROTOCOL 4.8-14), and whatever the
//! server does, a wish is taken, so that nobody is ever kept from another stream.

use crate::message::StreamChoice;

/// What was asked for, and what is wanted in its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choosing {
    /// Asked for, and not answered.
    asked: Option<StreamChoice>,
    /// To be asked for next.
    wanted: Option<StreamChoice>,
    /// Where the server moves the member: the snapshot of that comes next, whatever was asked for.
    moved: Option<StreamChoice>,
    coming: Coming,
}

/// Why there is a copy that is not shown yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Coming {
    /// There is none, or one of the stream that is followed already.
    Nothing,
    /// It was asked for.
    Asked(StreamChoice),
    /// The server moves the member.
    Moved,
}

impl Choosing {
    /// Nothing is wanted but what is there.
    pub(super) const fn new() -> Self {
        Self {
            asked: None,
            wanted: None,
            moved: None,
            coming: Coming::Nothing,
        }
    }

    /// This stream is wanted, and none that was wanted before.
    pub(super) fn want(&mut self, choice: StreamChoice) {
        let is_on_its_way = match self.asked {
            Some(asked) => asked == choice,
            None => self.coming == Coming::Asked(choice),
        };
        self.wanted = (!is_on_its_way).then_some(choice);
    }

    /// What to ask for now, if anything.
    pub(super) const fn ask(&mut self) -> Option<StreamChoice> {
        if self.asked.is_some() {
            return None;
        }
        self.asked = self.wanted.take();
        self.asked
    }

    /// Whether a question is not answered.
    pub(super) const fn is_asking(&self) -> bool {
        self.asked.is_some()
    }

    /// The server moves the member.
    pub(super) const fn hear_moved(&mut self, to: StreamChoice) {
        self.moved = Some(to);
    }

    /// A snapshot begins: the answer to what was asked for, that of a move, or the present stream's again.
    pub(super) fn hear_joined(&mut self, choice: StreamChoice) {
        if self.moved.take() == Some(choice) {
            self.coming = Coming::Moved;
        } else if self.asked == Some(choice) {
            self.asked = None;
            self.coming = Coming::Asked(choice);
        }
    }

    /// What was asked for is denied.
    pub(super) const fn hear_denied(&mut self) {
        self.asked = None;
    }

    /// The copy that came is shown; whether that is an answer or a move, and no mere repair.
    pub(super) fn take_news(&mut self) -> bool {
        core::mem::replace(&mut self.coming, Coming::Nothing) != Coming::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::Tolerance;

    const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
    const FINE: StreamChoice = StreamChoice::Within(Tolerance::FINE);
    const FULL: StreamChoice = StreamChoice::Full;

    /// After this was asked for.
    fn asking(choice: StreamChoice) -> Choosing {
        let mut choosing = Choosing::new();
        choosing.want(choice);
        assert_eq!(choosing.ask(), Some(choice));
        choosing
    }

    #[test]
    fn the_newest_wish_is_asked_for_once_the_one_before_is_answered() {
        let mut choosing = asking(EXACT);
        choosing.want(FULL);
        choosing.want(FINE);
        assert_eq!(choosing.ask(), None);
        choosing.hear_joined(EXACT);
        assert_eq!(choosing.ask(), Some(FINE));
        choosing.hear_denied();
        assert_eq!(choosing.ask(), None);
        assert!(!choosing.is_asking());
    }

    #[test]
    fn what_is_on_its_way_is_not_asked_for_again() {
        let mut choosing = asking(EXACT);
        choosing.want(FINE);
        choosing.want(EXACT);
        choosing.hear_joined(EXACT);
        assert_eq!(choosing.ask(), None);
        choosing.want(EXACT);
        assert_eq!(choosing.ask(), None);
        assert!(choosing.take_news());
        choosing.want(EXACT);
        assert_eq!(choosing.ask(), Some(EXACT));
    }

    #[test]
    fn a_move_answers_nothing_and_forbids_nothing() {
        let mut choosing = asking(FINE);
        choosing.hear_moved(FINE);
        choosing.hear_joined(FINE);
        assert!(choosing.is_asking(), "that was the move's snapshot");
        choosing.hear_joined(FINE);
        assert!(!choosing.is_asking());
        // What comes by a move is asked for all the same: a choice is the member's own.
        choosing.hear_moved(EXACT);
        choosing.hear_joined(EXACT);
        choosing.want(EXACT);
        assert_eq!(choosing.ask(), Some(EXACT));
    }

    #[test]
    fn a_snapshot_that_repairs_is_no_news() {
        let mut choosing = Choosing::new();
        choosing.hear_joined(FINE);
        assert!(!choosing.take_news());
        let mut choosing = asking(EXACT);
        choosing.hear_joined(FINE);
        assert!(choosing.is_asking() && !choosing.take_news());
        choosing.hear_joined(EXACT);
        choosing.hear_joined(EXACT);
        assert!(choosing.take_news());
    }
}
