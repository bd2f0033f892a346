//! L4.51: a client's predictions are bit-exact in live scenes of each kind.
//!
//! Golden streams go to decoders only (L4.81). They rely on an order between control stream and datagrams that a
//! connection does not guarantee.

use core::num::NonZeroU32;

use super::table::table;
use crate::case::Case;
use crate::outcome::{CaseResult, ensure};
use crate::peer::Setting;
use crate::trial::Trial;

/// A publish interval of three ticks.
const EACH_THIRD: NonZeroU32 = NonZeroU32::new(3).expect("three is not zero");

pub(super) fn cases() -> Vec<Case> {
    let mut cases = scenes();
    cases.extend(table(
        "L4.51",
        &[(
            20,
            "a client follows a scene that publishes every third tick bit-exactly",
            "PROTOCOL 5.6-18, 6.2-1, 6.3-1, 6.4-4",
            each_third_tick,
        )],
    ));
    cases
}

/// Scripts, their body counts, and the requirements of RECKONING that each exercises most.
const SCENES: [(&str, u32, &str); 8] = [
    ("ball-pit", 40, "RECKONING 1.3-1, 2.1-1, 3.4-1, 4.4-4"),
    ("asteroids-plain", 16, "RECKONING 3.1-1, 3.3-1"),
    ("asteroids", 16, "RECKONING 2.6-1, 3.7-1"),
    ("free-fall", 8, "RECKONING 2.2-1, 2.4-1, 3.4-1"),
    ("dominoes", 16, "RECKONING 4.4-4, 4.6-1, 4.7-1"),
    ("ragdolls", 3, "RECKONING 4.4-4, 4.5-1"),
    ("tumbler", 24, "RECKONING 3.8-1"),
    ("zoo", 20, "RECKONING 1.6-1, 4.1-1, 4.2-1"),
];

fn scenes() -> Vec<Case> {
    let of = |(place, (script, bodies, cites)): (usize, (&'static str, u32, &str))| {
        let name = format!("a client predicts {script} bit-exactly at every tick");
        let cites = format!("PROTOCOL 6.1-2, 6.1-4, 6.2-4, 6.2-6; {cites}");
        Case::client(&format!("L4.51.{}", place + 1), &name)
            .cites(&cites)
            .play(move |trial| {
                let mut interceptor = trial.interceptor(Setting::of(script, bodies))?;
                interceptor.enter()?;
                interceptor.step(80)?;
                interceptor.must_follow()?;
                let reported = interceptor.ticks_reported();
                ensure(
                    reported >= 20,
                    format!("it reports ticks as they come, not {reported} of 80"),
                )
            })
    };
    SCENES.into_iter().enumerate().map(of).collect()
}

/// Corrections name revisions by age, and an age counts published ticks only.
fn each_third_tick(trial: &mut Trial<'_>) -> CaseResult {
    let setting = Setting::of("tumbler", 20).each(EACH_THIRD);
    let mut interceptor = trial.interceptor(setting)?;
    interceptor.enter()?;
    interceptor.step(60)?;
    interceptor.must_follow()?;
    let reported = interceptor.ticks_reported();
    ensure(
        reported >= 15,
        format!("it reports ticks as they come, not {reported} of 60"),
    )
}
