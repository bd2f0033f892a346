//! Sessions of clients that went away, in a simulated network.

use rhumb_netsim::LinkConfig;
use rhumb_protocol::Ending;
use rhumb_protocol::limits::{GRANT, INDICES_MAX};
use rhumb_protocol::message::{SessionKey, StreamChoice};
use rhumb_protocol::scene::Stepping;
use rhumb_reckoning::Tolerance;
use rhumb_sims::by_name;
use rhumb_tests::Stage;

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Each crashed client leaves a session that keeps its indices, for a client that may come back.
#[test]
fn clients_that_are_away_do_not_keep_others_out() {
    let script = by_name("free-fall", 1, 1).expect("an existing script");
    let mut stage = Stage::new(script, Stepping::Lockstep, NORMAL, LinkConfig::PERFECT, 1);
    for number in 0..INDICES_MAX / GRANT {
        let away = stage.connect();
        let key = SessionKey(u128::from(number).to_le_bytes());
        let session = stage.network.client_mut(away);
        session.begin_session(key).expect("it is in the lobby");
        stage.join(away, NORMAL);
        stage.network.sever(away, Ending::TimedOut);
        stage.tick();
    }
    let here = stage.enter(NORMAL);
    stage.tick();
    assert!(stage.copy(here).stream().is_converged());
}
