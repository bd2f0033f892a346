//! A client displays the same poses, to the bit, in every run and build.

use rhumb_netsim::{LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tolerance;
use rhumb_scene::{SceneRouter, SceneSettings, StepThreads};
use rhumb_sims::by_name;

/// Longer than any answer takes over a perfect link.
const ANSWERED: Span = Span::from_millis(10);

/// The members of one scene: the first commands it, the others follow.
struct Members(SimNetwork<SceneRouter, ClientSession>);

impl Members {
    /// Makes a call of a member and waits for the answer.
    fn call<E: std::fmt::Debug>(
        &mut self,
        member: usize,
        call: impl FnOnce(&mut ClientSession) -> Result<(), E>,
    ) {
        call(self.0.client_mut(member)).expect("the session is in the state of this call");
        let answered = self.0.now() + ANSWERED;
        self.0.run_until(answered);
        for each in 0..self.0.clients() {
            while self.0.client_mut(each).poll_event().is_some() {}
        }
    }

    fn replica(&self, member: usize) -> &Replica {
        let session = self.0.client(member);
        session.replica().expect("it has joined the scene")
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

/// Digests of the copies of members, one for each tolerance, in 300 lockstep ticks.
pub(crate) fn displayed_digests(
    scene: &str,
    tolerances: &[Tolerance],
    threads: StepThreads,
) -> Vec<u64> {
    let mut script = by_name(scene, 60, 1).expect("an existing script");
    let server = SceneRouter::new(SceneSettings {
        threads,
        ..SceneSettings::new(|| Instant::ZERO)
    });
    let mut members = Members(SimNetwork::new(server, LinkConfig::PERFECT, 1));
    let name: SceneName = "golden".parse().expect("a valid scene name");
    for (member, &tolerance) in tolerances.iter().enumerate() {
        members.0.connect(ClientSession::new(name.clone()));
        members.call(member, |_| Ok::<_, ()>(()));
        if member == 0 {
            members.call(member, |session| session.create(script.config()));
        }
        members.call(member, |session| {
            session.join(StreamChoice::Within(tolerance))
        });
    }
    let mut digests = vec![0xcbf2_9ce4_8422_2325; tolerances.len()];
    let mut commands = Vec::new();
    for _ in 0..300 {
        let complete = members.replica(0).stream().complete();
        let next = complete.next();
        commands.clear();
        script.commands(complete, &mut commands);
        let now = members.0.now();
        members.call(0, |session| {
            for command in commands.drain(..) {
                session
                    .command(command)
                    .expect("scripts send valid commands");
            }
            session.advance(now, next)
        });
        for (member, digest) in digests.iter_mut().enumerate() {
            assert_eq!(members.replica(member).stream().complete(), next);
            fold(digest, members.replica(member));
        }
    }
    digests
}

/// Digest of the copy of a member of the 5 cm tier.
fn displayed_digest(scene: &str) -> u64 {
    displayed_digests(scene, &[Tolerance::NORMAL], StepThreads::default())[0]
}

/// Recorded values. Another value means that some client displays another scene than this build; if that is intended,
/// record the new value and state the change in the commit.
#[test]
fn what_a_client_sees_is_the_same_to_the_bit_in_every_run_and_build() {
    let recorded = [
        ("ball-pit", 0x1a20_dade_83e3_68b0_u64),
        ("free-fall", 0x653e_4e24_dd49_8e95),
        ("zoo", 0xd054_b802_8c8a_ab07),
    ];
    let digests = recorded.map(|(scene, _)| (scene, displayed_digest(scene)));
    for (scene, digest) in digests {
        assert_eq!(digest, displayed_digest(scene), "{scene}: two runs");
    }
    assert_eq!(digests, recorded, "{digests:#018x?}");
}
