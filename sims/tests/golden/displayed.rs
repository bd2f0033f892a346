//! A client displays the same poses, to the bit, in every run and build.

use rhumb_netsim::{LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tolerance;
use rhumb_server::Front;
use rhumb_sims::by_name;

/// Longer than any answer takes over a perfect link.
const ANSWERED: Span = Span::from_millis(10);

/// The only client of a server.
struct Commander(SimNetwork<Front, ClientSession>);

impl Commander {
    /// Makes a call and waits for the answer.
    fn call<E: std::fmt::Debug>(&mut self, call: impl FnOnce(&mut ClientSession) -> Result<(), E>) {
        call(self.0.client_mut(0)).expect("the session is in the state of this call");
        let answered = self.0.now() + ANSWERED;
        self.0.run_until(answered);
        while self.0.client_mut(0).poll_event().is_some() {}
    }

    fn replica(&self) -> &Replica {
        self.0.client(0).replica().expect("it has joined the scene")
    }
}

/// FNV-1a over the state of a copy at its complete tick: the tick, then for each body in order of index its index,
/// generation and the bits of position and rotation in f32.
fn fold(digest: &mut u64, replica: &Replica) {
    let mut fold = |word: u32| {
        for byte in word.to_le_bytes() {
            *digest = (*digest ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    let tick = replica.stream().complete();
    fold(tick.value() as u32);
    for desc in replica.bodies() {
        fold(desc.id.index());
        fold(u32::from(desc.id.generation()));
        let motion = replica.stream().predicted_motion(desc.id, tick);
        let pose = motion
            .expect("every body of the copy has a prediction")
            .pose();
        let parts = [
            &pose.position.as_vec3().to_array()[..],
            &pose.rotation.as_quat().to_array(),
        ];
        parts.concat().iter().for_each(|part| fold(part.to_bits()));
    }
}

/// Digest of the copy of a member of the 5 cm tier in 300 lockstep ticks.
fn displayed_digest(scene: &str) -> u64 {
    let mut script = by_name(scene, 60, 1).expect("an existing script");
    let server = Front::on_one_thread(|| Instant::ZERO);
    let mut commander = Commander(SimNetwork::new(server, LinkConfig::PERFECT, 1));
    let name = "golden".parse().expect("a valid scene name");
    commander.0.connect(ClientSession::new(name));
    commander.call(|_| Ok::<_, ()>(()));
    commander.call(|session| session.create(script.config()));
    commander.call(|session| session.join(StreamChoice::Within(Tolerance::NORMAL)));
    let mut digest = 0xcbf2_9ce4_8422_2325;
    let mut commands = Vec::new();
    for _ in 0..300 {
        let next = commander.replica().stream().complete().next();
        commands.clear();
        script.commands(commander.replica().stream().complete(), &mut commands);
        let now = commander.0.now();
        commander.call(|session| {
            for command in commands.drain(..) {
                session
                    .command(command)
                    .expect("scripts send valid commands");
            }
            session.advance(now, next)
        });
        assert_eq!(commander.replica().stream().complete(), next);
        fold(&mut digest, commander.replica());
    }
    digest
}

/// Recorded values. Another value means that some client displays another scene than this build; if that is intended,
/// record the new value and state the change in the commit.
#[test]
fn what_a_client_sees_is_the_same_to_the_bit_in_every_run_and_build() {
    let recorded = [
        ("ball-pit", 0x1593_9859_c2d4_c3bb_u64),
        ("free-fall", 0x6287_abe3_8e78_a995),
        ("zoo", 0x8e86_a770_da4f_7d05),
    ];
    let digests = recorded.map(|(scene, _)| (scene, displayed_digest(scene)));
    for (scene, digest) in digests {
        assert_eq!(digest, displayed_digest(scene), "{scene}: two runs");
    }
    assert_eq!(digests, recorded, "{digests:#018x?}");
}
