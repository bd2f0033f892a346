//! Every copy has the joints of its scene, whenever its member joined.
//!
//! One session sends the commands of the zoo, which adds and removes joints and bodies with joints; other sessions
//! join late. A local scene with the same commands is the truth.

use rhumb_protocol::Peer;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Joint, JointId, Joints};
use rhumb_reckoning::Tick;
use rhumb_scene::Scene;
use rhumb_sims::{Script, Zoo};
use rhumb_tests::Table;

const TICKS: u64 = 700;

fn listed(joints: &Joints) -> Vec<(JointId, Joint)> {
    joints.iter().map(|(id, joint)| (id, *joint)).collect()
}

fn copied(table: &mut Table, peer: Peer) -> Vec<(JointId, Joint)> {
    let copy = table.session(peer).replica().expect("a member");
    listed(copy.joints())
}

#[test]
fn a_copy_has_the_joints_of_its_scene_from_the_first_tick_to_the_last() {
    let mut script = Zoo::new(5, 3);
    let mut scene = Scene::new(script.config()).expect("a valid configuration");
    let mut table = Table::default();
    let peer = table.create("zoo", script.config(), StreamChoice::Full);
    let mut late = Vec::new();
    let mut ticks_with = [0_usize; 3];
    for tick in 0..TICKS {
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        let now = table.now();
        for command in &commands {
            scene.apply(command).expect("a valid command");
            let session = table.session(peer);
            session.command(command.clone()).expect("a member");
        }
        scene.step().expect("the engine does not fail");
        let session = table.session(peer);
        session.advance(now, Tick::new(tick + 1)).expect("a member");
        table.run_until_idle();
        // Before a joint is removed, while it is missing, and after it was added again with another body.
        if [10, 210, 460].contains(&tick) {
            let peer = table.connect("zoo");
            let session = table.session(peer);
            session
                .join(StreamChoice::Full)
                .expect("the session is in the lobby");
            table.run_until_idle();
            late.push(peer);
        }
        let truth = listed(scene.joints());
        ticks_with[truth.len()] += 1;
        for peer in late.iter().chain([&peer]) {
            assert_eq!(copied(&mut table, *peer), truth, "at tick {tick}");
        }
    }
    assert!(ticks_with[1] > 0 && ticks_with[2] > 0, "{ticks_with:?}");
}
