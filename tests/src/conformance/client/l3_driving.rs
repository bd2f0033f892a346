//! L3.51: what a client drives is where it says, as far as it promised.
//!
//! The client moves a body along a course that is stated as a function of the tick. A member of the full stream sees where
//! the server had it, to the engine's bit, at each tick.

use std::collections::BTreeSet;

use rhumb_protocol::message::{ClientMessage, DriveError, ServerMessage};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{Divergence, LengthBound, Tick, Tolerance};
use rhumb_server::DriveStatistics;

use super::table;
use crate::conformance::case::{Case, Feature, Row};
use crate::conformance::outcome::{Play, Stop, ensure};
use crate::conformance::peer::{Feed, Setting};
use crate::conformance::trial::Trial;
use crate::testee::{COURSE_TICKS, course};

/// Micrometres that the body may be off.
const WITHIN: u32 = 20_000;
/// What rounding to the engine's f32 may add, as a share of the tolerance.
const ROUNDING: f64 = 0.001;

const CASES: &[Row] = &[
    (
        1,
        "a driven body is within the driver's tolerance of its course at each tick",
        "PROTOCOL 4.11-1, 6.14-1, 6.14-3, 6.14-4, 6.14-5, 6.14-8, 6.14-10",
        |trial| keeps_to_its_course(trial, 20),
    ),
    (
        2,
        "a driver vouches for its silence",
        "PROTOCOL 6.14-11",
        vouches,
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
    cases.map(|case| case.needs(&[Feature::Driving])).collect()
}

/// A client that drives, and where the server had its body.
struct Ride {
    feed: Feed,
    scene: String,
    judged: BTreeSet<Tick>,
    worst: f64,
    /// The newest tick of which the driver said everything, at its oldest beside the server's newest.
    behind: u64,
}

impl Ride {
    fn begin(trial: &mut Trial<'_>, before: u64) -> Result<Self, Stop> {
        let setting = Setting::of("free-fall", 4).wishing(&format!("drive {WITHIN}"));
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

    fn statistics(&self) -> Option<DriveStatistics> {
        let scene = self.scene.parse().ok()?;
        self.feed.server.drives(&scene).next()
    }

    /// Goes on until the scene has come to a tick, and looks at each on the way.
    fn ride(&mut self, to: u64) -> Play {
        let (judged, worst, behind) = (&mut self.judged, &mut self.worst, &mut self.behind);
        let scene = self.scene.parse();
        let scene = scene.map_err(|_| Stop::Inconclusive("the suite errs: no name".into()))?;
        self.feed.until(&format!("driven tick {to}"), |feed| {
            let drive = feed.server.drives(&scene).next();
            if let Some((tick, share)) = share_now(feed)
                && judged.insert(tick)
            {
                *worst = worst.max(share);
                let vouched = drive.map_or(tick, |drive| drive.vouched);
                *behind = (*behind).max(tick.value().saturating_sub(vouched.value()));
            }
            feed.mirror()
                .is_ok_and(|copy| copy.stream().complete().value() >= to)
        })
    }

    /// That all that was said was good, and the body where it was said to be.
    fn judge(&self, at_least: usize) -> Play {
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
        let spoken = |said: &&ClientMessage| matches!(said, ClientMessage::Upstream(_));
        let packets = self.feed.said.iter().filter(spoken).count();
        ensure(
            packets > 4,
            format!("it says its course by upstream, in {packets} packets"),
        )
    }
}

/// The newest tick, and what share of the tolerance the driven body is off its course then.
fn share_now(feed: &Feed) -> Option<(Tick, f64)> {
    let replica = feed.mirror().ok()?;
    let (stream, tick) = (replica.stream(), replica.stream().complete());
    let terms = replica
        .bodies()
        .find(|terms| terms.kind == BodyKind::Kinematic)?;
    let there = stream.believed(terms.id, tick)?.pose();
    let radius = replica.shape(terms.shape)?.bounding_radius();
    let tolerance = Tolerance::Surface(LengthBound::from_micrometres(WITHIN).ok()?);
    let apart = Divergence::between(&course(tick).motion().pose(), &there);
    Some((tick, tolerance.share(&apart, radius)))
}

fn keeps_to_its_course(trial: &mut Trial<'_>, before: u64) -> Play {
    let mut ride = Ride::begin(trial, before)?;
    ride.ride(COURSE_TICKS)?;
    ride.judge(usize::try_from((COURSE_TICKS - before) / 2).unwrap_or_default())
}

fn vouches(trial: &mut Trial<'_>) -> Play {
    let mut ride = Ride::begin(trial, 20)?;
    // It stands from its tick 80 to 120.
    ride.ride(118)?;
    ride.judge(40)?;
    let said = ride.statistics().map_or(0, |drive| drive.vouched.value());
    // After 4 ticks of silence, then each time that it has doubled: 84, 88, 96, 112 and so on, or one later each.
    ensure(
        said >= 110,
        format!("it vouches for the ticks in which it stands, not up to {said} at 118"),
    )?;
    ensure(
        ride.behind <= 18,
        format!(
            "it vouches when its silence has doubled, not after {}",
            ride.behind
        ),
    )
}

fn asks_again(trial: &mut Trial<'_>) -> Play {
    let mut ride = Ride::begin(trial, 20)?;
    ride.ride(60)?;
    let lost = DriveError::LostTouch;
    ride.feed.host.say(&ServerMessage::NotDriving(lost));
    let wishes = |feed: &Feed| {
        let wish = |said: &&ClientMessage| matches!(said, ClientMessage::Drive(_));
        feed.said.iter().filter(wish).count()
    };
    ride.feed
        .until("second wish to drive", |feed| wishes(feed) >= 2)?;
    ride.ride(COURSE_TICKS)?;
    ride.judge(100)?;
    let wishes = wishes(&ride.feed);
    ensure(
        wishes == 2,
        format!("it asks once for each time it was refused, not {wishes} times in all"),
    )
}
