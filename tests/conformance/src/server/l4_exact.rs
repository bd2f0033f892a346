//! L4.3: motions are bit-exact results of this project's physics engine.
//!
//! Profile `bit-exact`, for servers with the same engine only. The full stream carries the engine's own numbers, so no
//! tolerance matters here.

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind};
use rhumb_reckoning::{Tick, Ticks};
use rhumb_sims::Script;

use super::l4_tolerance::rename;
use super::scenery::NORMAL;
use crate::case::Case;
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::LossyClient;
use crate::trial::Trial;
use crate::truths::{BodyDigests, GROUND, PIT, ReferenceScene, TICKS, checksums};

pub(super) fn cases() -> Vec<Case> {
    let case = |number: usize, name: &str, cites: &str| {
        Case::server(&format!("L4.3.{number}"), name)
            .cites(cites)
            .needs(&[Feature::Lockstep])
            .bit_exact()
    };
    let each = ReferenceScene::ALL
        .into_iter()
        .enumerate()
        .map(|(place, subject)| {
            let name = format!("{}: every body moves bit-exactly as recorded", subject.name);
            case(place + 1, &name, "PROTOCOL 6.10-1, 6.10-3")
                .play(move |trial| moves(trial, subject))
        });
    let others = [
        case(
            31,
            "balls move bit-exactly as recorded when ten ticks are requested ahead",
            "PROTOCOL 4.9-1",
        )
        .play(moves_ahead),
        case(
            32,
            "a late joiner receives the recorded motions bit-exactly",
            "PROTOCOL 6.10-3, 6.11-1",
        )
        .play(joins_late),
        case(
            33,
            "sleeping bodies have the recorded poses bit-exactly, on a stream with a tolerance too",
            "PROTOCOL 6.3-9",
        )
        .play(sleeps),
    ];
    each.chain(others).collect()
}

/// A member that sends the commands of a script and advances its scene.
struct LeadMember {
    subscriber: LossyClient,
    subject: ReferenceScene,
    script: Box<dyn Script>,
    tick: Tick,
}

impl LeadMember {
    fn begin(
        trial: &mut Trial<'_>,
        subject: ReferenceScene,
        choice: StreamChoice,
    ) -> Result<Self, Stop> {
        let script = subject.script();
        let mut subscriber = trial.subscriber()?;
        subscriber.create(script.config())?;
        subscriber.join(choice)?;
        Ok(Self {
            subscriber,
            subject,
            script,
            tick: Tick::ZERO,
        })
    }

    /// Sends the commands of the newest tick.
    fn command(&mut self) -> CaseResult {
        let mut commands = Vec::new();
        self.script.commands(self.tick, &mut commands);
        for mut command in commands {
            rename(&mut command, self.subscriber.granted)?;
            self.subscriber.task(|session| session.command(command))?;
        }
        Ok(())
    }

    /// Advances to a tick, one by one.
    fn go(&mut self, to: Tick) -> CaseResult {
        while self.tick < to {
            self.command()?;
            self.tick = self.tick.next();
            self.subscriber.advance(self.tick)?;
        }
        Ok(())
    }
}

/// Fails unless every dynamic body of a copy has the recorded motion of the tick.
fn judge(copy: &LossyClient, subject: ReferenceScene, first: u32, tick: Tick) -> CaseResult {
    let unrecorded = || Stop::Inconclusive(format!("{tick} of {} is not recorded", subject.name));
    let recorded = subject.recorded(tick).ok_or_else(unrecorded)?;
    let replica = copy.replica()?;
    let stream = replica.stream();
    let can_move = |desc: &BodyDesc| desc.kind != BodyKind::Fixed;
    let here = replica.bodies().filter(can_move).filter_map(|desc| {
        let motion = stream.predicted_motion(desc.id, tick)?;
        Some((desc.id.index().checked_sub(first)?, checksums(&motion)))
    });
    let here: BodyDigests = here.collect();
    ensure(
        here.keys().eq(recorded.keys()),
        format!("there are {} bodies at {tick}", recorded.len()),
    )?;
    let otherwise = here.iter().filter(|(place, is)| recorded[*place] != **is);
    let otherwise: Vec<_> = otherwise.map(|(place, _)| *place).collect();
    ensure(
        otherwise.is_empty(),
        format!("at {tick} each body is bit-exactly as recorded, except {otherwise:?}"),
    )
}

fn moves(trial: &mut Trial<'_>, subject: ReferenceScene) -> CaseResult {
    let mut lead = LeadMember::begin(trial, subject, StreamChoice::Full)?;
    for tick in TICKS.map(Tick::new) {
        lead.go(tick)?;
        judge(
            &lead.subscriber,
            subject,
            lead.subscriber.granted.first(),
            tick,
        )?;
    }
    Ok(())
}

fn moves_ahead(trial: &mut Trial<'_>) -> CaseResult {
    // This script has no commands after the first step.
    let mut lead = LeadMember::begin(trial, GROUND, StreamChoice::Full)?;
    lead.command()?;
    let first = lead.subscriber.granted.first();
    let recorded = TICKS.into_iter().filter(|tick| tick % 10 == 0);
    for tick in recorded.map(Tick::new) {
        while lead.tick < tick {
            lead.tick = lead.tick + Ticks::new(10);
            lead.subscriber.ask_for(lead.tick)?;
        }
        lead.subscriber.complete(tick)?;
        judge(&lead.subscriber, GROUND, first, tick)?;
    }
    Ok(())
}

fn joins_late(trial: &mut Trial<'_>) -> CaseResult {
    let mut lead = LeadMember::begin(trial, PIT, NORMAL)?;
    let (joins, later) = (Tick::new(60), Tick::new(120));
    lead.go(joins)?;
    let scene = lead.subscriber.scene.clone();
    let mut late = trial.subscriber_of(&scene)?;
    late.greet()?;
    late.join(StreamChoice::Full)?;
    let first = lead.subscriber.granted.first();
    judge(&late, PIT, first, joins)?;
    lead.go(later)?;
    late.complete(later)?;
    judge(&late, PIT, first, later)
}

fn sleeps(trial: &mut Trial<'_>) -> CaseResult {
    let mut lead = LeadMember::begin(trial, GROUND, NORMAL)?;
    let tick = Tick::new(TICKS[TICKS.len() - 1]);
    lead.go(tick)?;
    let first = lead.subscriber.granted.first();
    let recorded = lead.subject.recorded(tick).unwrap_or_default();
    let replica = lead.subscriber.replica()?;
    let stream = replica.stream();
    let mut asleep = 0;
    for desc in replica.bodies() {
        let (id, place) = (desc.id, desc.id.index().wrapping_sub(first));
        let rests = stream.track(id).is_some_and(|track| track.is_exact_rest());
        if desc.kind == BodyKind::Fixed || !rests {
            continue;
        }
        let is = stream
            .predicted_motion(id, tick)
            .map(|motion| checksums(&motion));
        ensure(
            is == recorded.get(&place).copied(),
            format!("the body at index {place} sleeps at {tick} at its recorded pose"),
        )?;
        asleep += 1;
    }
    ensure(asleep > 0, "some balls sleep by then")
}
