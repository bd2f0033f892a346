//! L3.51: what a client drives is where it says, as far as it promised.
//!
//! The client moves a body along a trajectory that is stated as a function of the tick. A member of the full stream sees where
//! the server had it, to the engine's bit, at each tick.

use std::collections::BTreeSet;

use rhumb_protocol::message::{AuthorityError, ClientMessage, ServerMessage};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{Divergence, LengthBound, Tick, Tolerance};
use rhumb_server::UpstreamStatistics;

use super::table;
use crate::conformance::case::{Case, CaseRow, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure};
use crate::conformance::peer::{Interceptor, Setting};
use crate::conformance::trial::Trial;
use crate::testee::{COURSE_TICKS, trajectory};

/// Micrometres that the body may be off.
const WITHIN: u32 = 20_000;
/// What rounding to the engine's f32 may add, as a share of the tolerance.
const ROUNDING: f64 = 0.001;

const CASES: &[CaseRow] = &[
    (
        1,
        "a driven body is within the driver's tolerance of its trajectory at each tick",
        "PROTOCOL 4.11-1, 6.14-1, 6.14-3, 6.14-4, 6.14-5, 6.14-8, 6.14-10",
        |trial| keeps_to_its_course(trial, 20),
    ),
    (
        2,
        "a driver watermarks for its silence",
        "PROTOCOL 6.14-11",
        watermarks,
    ),
    (
        3,
        "a driver that the server lost touch with asks again, once, and goes on",
        "PROTOCOL 4.11-4, 4.11-5",
        asks_again,
    ),
    (
        4,
        "a driver that comes late begins its stream at the tick of its grant",
        "PROTOCOL 6.14-3, 6.14-10",
        |trial| keeps_to_its_course(trial, 110),
    ),
];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L3.51", CASES).into_iter();
    cases
        .map(|case| case.needs(&[Feature::AuthorityGrant]))
        .collect()
}

/// A client that drives, and where the server had its body.
struct UpstreamTrial {
    feed: Interceptor,
    scene: String,
    judged: BTreeSet<Tick>,
    worst: f64,
    /// The newest tick of which the driver sent everything, at its oldest beside the server's newest.
    behind: u64,
}

impl UpstreamTrial {
    fn begin(trial: &mut Trial<'_>, before: u64) -> Result<Self, Stop> {
        let setting = Setting::of("free-fall", 4).wishing(&format!("upstream {WITHIN}"));
        let mut feed = trial.feed(setting.after(before))?;
        let scene = format!("conformance/{}", trial.id());
        feed.enter()?;
        Ok(Self {
            feed,
            scene,
            judged: BTreeSet::new(),
            worst: 0.0,
            behind: 0,
        })
    }

    fn statistics(&self) -> Option<UpstreamStatistics> {
        let scene = self.scene.parse().ok()?;
        self.feed.server.drives(&scene).next()
    }

    /// Goes on until the scene has come to a tick, and looks at each on the way.
    fn upstream_trial(&mut self, to: u64) -> CaseResult {
        let (judged, worst, behind) = (&mut self.judged, &mut self.worst, &mut self.behind);
        let scene = self.scene.parse();
        let scene = scene.map_err(|_| Stop::Inconclusive("the suite errs: no name".into()))?;
        self.feed.until(&format!("driven tick {to}"), |feed| {
            let drive = feed.server.drives(&scene).next();
            if let Some((tick, share)) = share_now(feed)
                && judged.insert(tick)
            {
                *worst = worst.max(share);
                let watermark_tick = drive.map_or(tick, |drive| drive.watermark_tick);
                *behind = (*behind).max(tick.value().saturating_sub(watermark_tick.value()));
            }
            feed.mirror()
                .is_ok_and(|copy| copy.stream().complete().value() >= to)
        })
    }

    /// That all that was sent was good, and the body where it was sent to be.
    fn judge(&self, at_least: usize) -> CaseResult {
        let (seen, worst) = (self.judged.len(), self.worst);
        ensure(
            seen >= at_least,
            format!("it drives for {at_least} ticks and more, not for {seen}"),
        )?;
        ensure(
            worst <= 1.0 + ROUNDING,
            format!("its body is within the tolerance, not {worst:.3} times that off"),
        )?;
        let gone = || Stop::Fail("it drives nothing any more".into());
        let drive = self.statistics().ok_or_else(gone)?;
        ensure(drive.bodies == 1, "it drives the body that is its own")?;
        let (malformed, refused) = (drive.heard.malformed, drive.refused);
        ensure(
            (malformed, refused) == (0, 0),
            format!("all it says is good: {malformed} malformed, {refused} refused"),
        )?;
        let spoken = |sent: &&ClientMessage| matches!(sent, ClientMessage::Upstream(_));
        let packets = self.feed.said.iter().filter(spoken).count();
        ensure(
            packets > 4,
            format!("it says its trajectory by upstream, in {packets} packets"),
        )
    }
}

/// The newest tick, and what share of the tolerance the driven body is off its trajectory then.
fn share_now(feed: &Interceptor) -> Option<(Tick, f64)> {
    let replica = feed.mirror().ok()?;
    let (stream, tick) = (replica.stream(), replica.stream().complete());
    let desc = replica
        .bodies()
        .find(|desc| desc.kind == BodyKind::Kinematic)?;
    let there = stream.predicted_motion(desc.id, tick)?.pose();
    let radius = replica.shape(desc.shape)?.bounding_radius();
    let tolerance = Tolerance::Surface(LengthBound::from_micrometres(WITHIN).ok()?);
    let apart = Divergence::between(&trajectory(tick).motion().pose(), &there);
    Some((tick, tolerance.share(&apart, radius)))
}

fn keeps_to_its_course(trial: &mut Trial<'_>, before: u64) -> CaseResult {
    let mut upstream_trial = UpstreamTrial::begin(trial, before)?;
    upstream_trial.upstream_trial(COURSE_TICKS)?;
    upstream_trial.judge(usize::try_from((COURSE_TICKS - before) / 2).unwrap_or_default())
}

fn watermarks(trial: &mut Trial<'_>) -> CaseResult {
    let mut upstream_trial = UpstreamTrial::begin(trial, 20)?;
    // It stands from its tick 80 to 120.
    upstream_trial.upstream_trial(118)?;
    upstream_trial.judge(40)?;
    let sent = upstream_trial
        .statistics()
        .map_or(0, |drive| drive.watermark_tick.value());
    // After 4 ticks of silence, then each time that it has doubled: 84, 88, 96, 112 and so on, or one later each.
    ensure(
        sent >= 110,
        format!("it watermarks for the ticks in which it stands, not up to {sent} at 118"),
    )?;
    ensure(
        upstream_trial.behind <= 18,
        format!(
            "it watermarks when its silence has doubled, not after {}",
            upstream_trial.behind
        ),
    )
}

fn asks_again(trial: &mut Trial<'_>) -> CaseResult {
    let mut upstream_trial = UpstreamTrial::begin(trial, 20)?;
    upstream_trial.upstream_trial(60)?;
    let lost = AuthorityError::LostSync;
    upstream_trial
        .feed
        .host
        .say(&ServerMessage::AuthorityDenied(lost));
    let tasks = |feed: &Interceptor| {
        let task = |sent: &&ClientMessage| matches!(sent, ClientMessage::TakeAuthority(_));
        feed.said.iter().filter(task).count()
    };
    upstream_trial
        .feed
        .until("second task to drive", |feed| tasks(feed) >= 2)?;
    upstream_trial.upstream_trial(COURSE_TICKS)?;
    upstream_trial.judge(100)?;
    let tasks = tasks(&upstream_trial.feed);
    ensure(
        tasks == 2,
        format!("it asks once for each time it was refused, not {tasks} times in all"),
    )
}
