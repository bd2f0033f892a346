//! What a scene knows of one of its members.
//!
//! The streams that it hears, and what it waits for. Follows streams by name only; who begins and ends them is the room's matter.

use rhumb_protocol::message::{Drive, StreamChoice};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{Command, CommandError};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;

use crate::thin_link::ThinLink;

/// A client that takes part.
#[derive(Debug)]
pub(crate) struct Member {
    following: Following,
    /// The stream before, until the member has caught up with the present one.
    former: Option<Following>,
    /// Number of its last command that was looked at, and is not answered yet.
    pub(crate) unanswered: Option<u64>,
    /// The snapshot that it is to hear when all that it said at once was looked at; the last one counts.
    pub(crate) wants: Option<Want>,
    /// Whether its link carries its stream.
    pub(crate) link: ThinLink,
}

/// Which snapshot a member waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Want {
    /// That of its stream, again.
    Again,
    /// That of another stream.
    Other(StreamChoice),
}

/// What acts in the order in which it was said: a command said after an advance acts after its steps.
#[derive(Clone, Debug)]
pub(crate) enum Wish {
    Command {
        number: u64,
        command: Result<Command, CommandError>,
    },
    Advance {
        to: Tick,
    },
    Drive(Drive),
    /// A packet of the stream on which it says how its bodies move.
    Upstream(Vec<u8>),
}

/// A stream that a member hears.
#[derive(Clone, Copy, Debug)]
struct Following {
    stream: StreamId,
    /// When the last echo of it was answered.
    echoed: Option<Instant>,
    /// When the last doubt about it was answered.
    doubted: Option<Instant>,
}

impl Following {
    const fn new(stream: StreamId) -> Self {
        Self {
            stream,
            echoed: None,
            doubted: None,
        }
    }
}

/// The least time between two echoes of a stream by a member that are answered: half of what a member's patience begins
/// with.
const ECHO_PAUSE: Span = Span::from_millis(2);

/// The least time between two doubts about a stream by a member that are answered: each may cost a sum over all tracks.
const DOUBT_PAUSE: Span = Span::from_millis(20);

/// Whether a pause since the last time is over; if so, this is the last time.
fn is_due(last: &mut Option<Instant>, now: Instant, pause: Span) -> bool {
    let due = last.is_none_or(|last| now >= last + pause);
    if due {
        *last = Some(now);
    }
    due
}

impl Member {
    /// Who has just joined and follows a stream.
    pub(crate) const fn new(stream: StreamId, choice: StreamChoice) -> Self {
        Self {
            following: Following::new(stream),
            former: None,
            unanswered: None,
            wants: None,
            link: ThinLink::new(choice),
        }
    }

    /// The stream that it follows.
    pub(crate) const fn stream(&self) -> StreamId {
        self.following.stream
    }

    /// All streams whose datagrams it gets, each once.
    pub(crate) fn streams(&self) -> impl Iterator<Item = StreamId> + use<> {
        let former = self.former.map(|former| former.stream);
        [Some(self.following.stream), former].into_iter().flatten()
    }

    /// Changes to a stream that it does not follow, but may be leaving; returns the one that it hears no more, if there is
    /// one. It goes on hearing the one that it has a whole copy of.
    pub(crate) fn change(&mut self, to: StreamId) -> Option<StreamId> {
        let before = std::mem::replace(&mut self.following, Following::new(to));
        match self.former {
            None => {
                self.former = Some(before);
                None
            }
            Some(former) => {
                self.former = (former.stream != to).then_some(former);
                Some(before.stream)
            }
        }
    }

    /// It has caught up with a stream; returns the one that it needs no more, if there is one.
    pub(crate) fn caught_up(&mut self, with: StreamId) -> Option<StreamId> {
        if with != self.following.stream {
            return None;
        }
        self.former.take().map(|former| former.stream)
    }

    /// Whether an echo of a stream is to be answered now; if so, the next one is not for a while.
    pub(crate) fn answers_echo(&mut self, of: StreamId, now: Instant) -> bool {
        let heard = self.heard(of);
        heard.is_some_and(|heard| is_due(&mut heard.echoed, now, ECHO_PAUSE))
    }

    /// Whether a doubt about a stream is to be answered now; if so, the next one is not for a while.
    pub(crate) fn answers_doubt(&mut self, of: StreamId, now: Instant) -> bool {
        let heard = self.heard(of);
        heard.is_some_and(|heard| is_due(&mut heard.doubted, now, DOUBT_PAUSE))
    }

    fn heard(&mut self, stream: StreamId) -> Option<&mut Following> {
        let former = self.former.as_mut();
        let heard = [Some(&mut self.following), former].into_iter().flatten();
        heard.into_iter().find(|heard| heard.stream == stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: StreamId = StreamId(1);
    const B: StreamId = StreamId(2);
    const C: StreamId = StreamId(3);

    fn heard(member: &Member) -> Vec<StreamId> {
        member.streams().collect()
    }

    #[test]
    fn the_former_stream_is_heard_until_the_new_one_is_caught_up_with() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(heard(&member), [B, A]);
        assert_eq!(member.caught_up(A), None);
        assert_eq!(member.caught_up(B), Some(A));
        assert_eq!(heard(&member), [B]);
    }

    #[test]
    fn who_changes_twice_keeps_what_it_has_a_copy_of() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(C), Some(B));
        assert_eq!(heard(&member), [C, A]);
        assert_eq!(member.caught_up(C), Some(A));
    }

    #[test]
    fn who_changes_back_hears_one_stream_once() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(A), Some(B));
        assert_eq!(heard(&member), [A]);
    }

    #[test]
    fn echoes_of_each_stream_have_a_pause_of_their_own() {
        let mut member = Member::new(A, StreamChoice::Full);
        member.change(B);
        let now = Instant::from_nanos(7);
        assert!(member.answers_echo(A, now) && member.answers_echo(B, now));
        assert!(!member.answers_echo(A, now) && !member.answers_echo(C, now));
        assert!(member.answers_echo(A, now + ECHO_PAUSE));
    }
}
