//! What a client displays is the same to the bit in every run and build.
//!
//! Continuous integration runs it again in release mode; an executable of its own makes that build short.

use rhumb_netsim::LinkConfig;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::Stepping;
use rhumb_reckoning::Tolerance;
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, Stage, copy_digest};

/// Digest of the copy of a member of the 5 cm tier in 300 lockstep ticks.
fn displayed_digest(scene: &str) -> u64 {
    let script = by_name(scene, 60, 1).expect("an existing script");
    let normal = StreamChoice::Within(Tolerance::NORMAL);
    let mut stage = Stage::new(script, Stepping::Lockstep, normal, LinkConfig::PERFECT, 1);
    let mut digest = 0;
    for _ in 0..300 {
        stage.tick();
        digest = copy_digest(digest, stage.copy(COMMANDER));
    }
    digest
}

/// Recorded values. Another value means that some client displays another scene than this build; if that is intended,
/// record the new value and state the change in the commit.
#[test]
fn what_a_client_sees_is_the_same_to_the_bit_in_every_run_and_build() {
    let recorded = [
        ("ball-pit", 0x6b97_44aa_6751_8da9_u64),
        ("free-fall", 0x6287_abe3_8e78_a995),
        ("zoo", 0x67ed_3080_fb04_8361),
    ];
    let digests = recorded.map(|(scene, _)| (scene, displayed_digest(scene)));
    for (scene, digest) in digests {
        assert_eq!(digest, displayed_digest(scene), "{scene}: two runs");
    }
    assert_eq!(digests, recorded, "{digests:#018x?}");
}
