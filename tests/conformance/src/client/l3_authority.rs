//! L3.51: a body under a client's authority stays within tolerance.
//!
//! The client moves a body along a trajectory that is a function of the tick. A subscriber to the full stream knows
//! the server's state at each tick, bit for bit.

use std::collections::BTreeSet;

use rhumb_protocol::message::{AuthorityError, ClientMessage, ServerMessage};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{Divergence, LengthBound, Tick, Tolerance};
use rhumb_scene::UpstreamStatistics;

use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{Interceptor, Setting};
use crate::testee::{TRAJECTORY_TICKS, trajectory};
use crate::trial::Trial;

/// Allowed position error, in micrometres.
const WITHIN: u32 = 20_000;
/// Allowance for rounding to the engine's f32, as a fraction of the tolerance.
const ROUNDING: f64 = 0.001;

const CASES: &[CaseRow] = &[
    (
        1,
        "a body under client authority is within tolerance of its trajectory at each tick",
        "PROTOCOL 4.11-1, 6.14-1, 6.14-3, 6.14-4, 6.14-5, 6.14-8, 6.14-10",
        |trial| keeps_to_its_trajectory(trial, 20),
    ),
    (
        2,
        "a publishing client sends watermarks while its body needs no updates",
        "PROTOCOL 6.14-11",
        watermarks,
    ),
    (
        3,
        "a client whose authority was withdrawn requests it again, once, and continues",
        "PROTOCOL 4.11-4, 4.11-5",
        asks_again,
    ),
    (
        4,
        "a late client begins its upstream at the tick of its grant",
        "PROTOCOL 6.14-3, 6.14-10",
        |trial| keeps_to_its_trajectory(trial, 110),
    ),
];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L3.51", CASES).into_iter();
    cases
        .map(|case| case.needs(&[Feature::Authority]))
        .collect()
}

/// A client with authority, and the server's states of its body.
struct PublishingClient {
    interceptor: Interceptor,
    scene: String,
    judged: BTreeSet<Tick>,
    worst: f64,
    /// Greatest distance, in ticks, from the server's newest tick back to the newest tick that the upstream covers
    /// completely.
    behind: u64,
}

impl PublishingClient {
    fn begin(trial: &mut Trial<'_>, before: u64) -> Result<Self, Stop> {
        let setting = Setting::of("free-fall", 4).with_task(&format!("upstream {WITHIN}"));
        let mut interceptor = trial.interceptor(setting.after(before))?;
        let scene = format!("conformance/{}", trial.id());
        interceptor.enter()?;
        let by = trial.round_trips(TRAJECTORY_TICKS);
        interceptor.raw_server.wait_longer(by);
        Ok(Self {
            interceptor,
            scene,
            judged: BTreeSet::new(),
            worst: 0.0,
            behind: 0,
        })
    }

    fn statistics(&self) -> Option<UpstreamStatistics> {
        let scene = self.scene.parse().ok()?;
        self.interceptor.server.upstreams(&scene).next()
    }

    /// Runs until the scene reaches a tick, and checks each tick on the way.
    fn run_to(&mut self, to: u64) -> CaseResult {
        let (judged, worst, behind) = (&mut self.judged, &mut self.worst, &mut self.behind);
        let scene = self.scene.parse();
        let scene = scene.map_err(|_| Stop::Inconclusive("error of the suite: no name".into()))?;
        self.interceptor
            .until(&format!("published tick {to}"), |interceptor| {
                let upstream = interceptor.server.upstreams(&scene).next();
                if let Some((tick, share)) = share_now(interceptor)
                    && judged.insert(tick)
                {
                    *worst = worst.max(share);
                    let watermark_tick = upstream.map_or(tick, |upstream| upstream.watermark_tick);
                    *behind = (*behind).max(tick.value().saturating_sub(watermark_tick.value()));
                }
                interceptor
                    .mirror()
                    .is_ok_and(|copy| copy.stream().complete().value() >= to)
            })
    }

    /// Checks that all packets were accepted, and that the body was where the client published it.
    fn judge(&self, at_least: usize) -> CaseResult {
        let (ticks, worst) = (self.judged.len(), self.worst);
        ensure(
            ticks >= at_least,
            format!("it publishes for at least {at_least} ticks, not for {ticks}"),
        )?;
        ensure(
            worst <= 1.0 + ROUNDING,
            format!("the error is within the tolerance, not {worst:.3} times it"),
        )?;
        let lost_authority = || Stop::Fail("it has no authority any more".into());
        let upstream = self.statistics().ok_or_else(lost_authority)?;
        ensure(upstream.bodies == 1, "it has authority over its own body")?;
        let (malformed, refused) = (upstream.received.malformed, upstream.refused);
        ensure(
            (malformed, refused) == (0, 0),
            format!("all its packets are accepted: {malformed} malformed, {refused} refused"),
        )?;
        let is_upstream = |sent: &&ClientMessage| matches!(sent, ClientMessage::Upstream(_));
        let packets = self.interceptor.messages.iter().filter(is_upstream).count();
        ensure(
            packets > 4,
            format!("it publishes its trajectory, in {packets} packets"),
        )
    }
}

/// The newest tick, and the error of the body at that tick as a fraction of the tolerance.
fn share_now(interceptor: &Interceptor) -> Option<(Tick, f64)> {
    let replica = interceptor.mirror().ok()?;
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

fn keeps_to_its_trajectory(trial: &mut Trial<'_>, before: u64) -> CaseResult {
    let mut publishing = PublishingClient::begin(trial, before)?;
    publishing.run_to(TRAJECTORY_TICKS)?;
    publishing.judge(usize::try_from((TRAJECTORY_TICKS - before) / 2).unwrap_or_default())
}

fn watermarks(trial: &mut Trial<'_>) -> CaseResult {
    let mut publishing = PublishingClient::begin(trial, 20)?;
    // The trajectory stands still from its tick 80 to 120.
    publishing.run_to(118)?;
    publishing.judge(40)?;
    let sent = publishing
        .statistics()
        .map_or(0, |upstream| upstream.watermark_tick.value());
    // Watermarks come after 4 ticks of silence, then at each doubling: 84, 88, 96, 112 and so on, or one tick later
    // each.
    ensure(
        sent >= 110,
        format!("at tick 118 its watermarks cover the standstill, not only up to {sent}"),
    )?;
    ensure(
        publishing.behind <= 18,
        format!(
            "it sends a watermark when the silence has doubled, not after {}",
            publishing.behind
        ),
    )
}

fn asks_again(trial: &mut Trial<'_>) -> CaseResult {
    let mut publishing = PublishingClient::begin(trial, 20)?;
    publishing.run_to(60)?;
    let lost = AuthorityError::LostSync;
    publishing
        .interceptor
        .raw_server
        .send(&ServerMessage::AuthorityDenied(lost));
    let requests = |interceptor: &Interceptor| {
        let is_request = |sent: &&ClientMessage| matches!(sent, ClientMessage::TakeAuthority(_));
        interceptor.messages.iter().filter(is_request).count()
    };
    publishing
        .interceptor
        .until("second request for authority", |interceptor| {
            requests(interceptor) >= 2
        })?;
    publishing.run_to(TRAJECTORY_TICKS)?;
    publishing.judge(100)?;
    let requests = requests(&publishing.interceptor);
    ensure(
        requests == 2,
        format!("it requests authority once per refusal, not {requests} times in total"),
    )
}
