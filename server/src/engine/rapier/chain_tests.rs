//! A chain without motors gains no energy, at the limits of its joints too.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Joint, JointFrame, JointKind, JointLimits, Shape,
};
use rhumb_reckoning::BodyId;

use super::tests::TestWorld;

const GRAVITY: f32 = 9.81;
/// Half the length of a link, metres.
const HALF: f32 = 0.2;

/// Five links that hang on a post, along x; the links touch nothing.
fn chain(link: &Shape, limit: Option<f32>, is_spherical: bool) -> (TestWorld, Vec<BodyId>) {
    let mut world = TestWorld::new(Vec3::NEG_Y * GRAVITY);
    let groups = CollisionGroups {
        members: 1,
        touches: 2,
    };
    let apart = |desc: &mut BodyDesc| desc.groups = groups;
    let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, apart);
    let (mut before, mut end, mut links) = (post, Vec3::ZERO, Vec::new());
    for number in 0..5 {
        let at = Vec3::X * HALF * (2 * number + 1) as f32;
        let link = world.add(BodyKind::Dynamic, link.clone(), at, apart);
        // The axis of a hinge is level, and across the chain.
        let rotation = Quat::from_rotation_y(-std::f32::consts::FRAC_PI_2);
        let frames = [end, Vec3::NEG_X * HALF].map(|anchor| JointFrame { anchor, rotation });
        let range = limit.map(|most| JointLimits { least: -most, most });
        let kind = match is_spherical {
            true => JointKind::Spherical(range.map(|range| [range; 3])),
            false => JointKind::Revolute(range),
        };
        world.join(&Joint::plain(kind, [before, link], frames));
        (before, end) = (link, Vec3::X * HALF);
        links.push(link);
    }
    (world, links)
}

/// Kinetic energy, and that of height, J.
fn energies(world: &TestWorld, links: &[BodyId]) -> [f32; 2] {
    let of_link = |link: &BodyId| {
        let place = world.engine.place(*link).expect("the link is there");
        let body = &world.engine.world.bodies[place.handle];
        let height = world.position(*link).y;
        [body.kinetic_energy(), body.mass() * GRAVITY * height]
    };
    let each = links.iter().map(of_link);
    each.fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]])
}

#[test]
fn a_chain_that_swings_for_ten_seconds_gains_no_energy() {
    let links = [
        Shape::cuboid(HALF, 0.03, 0.03),
        Shape::cuboid(HALF, 0.005, 0.005),
    ];
    for link in &links {
        for limit in [None, Some(0.7), Some(0.1)] {
            for is_spherical in [false, true] {
                let (mut world, links) = chain(link, limit, is_spherical);
                let (mut most, mut fastest) = (0.0_f32, 0.0_f32);
                for _ in 0..600 {
                    world.step();
                    let [kinetic, height] = energies(&world, &links);
                    most = most.max(kinetic + height);
                    fastest = fastest.max(kinetic);
                }
                let about = format!("{link:?}, {limit:?}, spherical: {is_spherical}");
                assert!(most <= fastest * 0.01, "{about}: {most} of {fastest} J");
            }
        }
    }
}
