//! Plans whose sums can be done by hand, and arguments out of range.

use clap::Parser;

use super::*;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    plan: PlanArguments,
}

fn arguments(line: &str) -> PlanArguments {
    let words = std::iter::once("plan").chain(line.split_whitespace());
    Line::try_parse_from(words)
        .expect("a line that is right")
        .plan
}

fn planned(line: &str) -> Plan {
    let arguments = arguments(line);
    Plan::of(
        &arguments,
        &Shares::of(&arguments.costs, &arguments.machine),
    )
}

#[test]
fn all_members_have_a_scene_whatever_the_law() {
    for (members, scenes) in [(1, 1), (7, 3), (3, 7), (100_000, 10_000), (10, 100_000)] {
        for popularity in [0.0, 0.5, 0.8, 1.0, 3.0] {
            let sizes = sizes(members, scenes, popularity);
            assert_eq!(sizes.len(), scenes as usize);
            assert_eq!(sizes.iter().sum::<u32>(), members);
        }
    }
    assert_eq!(sizes(300, 3, 0.0), [100, 100, 100]);
    assert_eq!(sizes(1_100, 2, 10.0_f64.log2()), [1_000, 100]);
}

#[test]
fn members_are_drawn_by_their_shares() {
    let scenes = draw(
        &arguments("--regions 3,0,1 --at-home 0.5 --observers 0.25").service,
        1,
    );
    let all: u32 = scenes.iter().map(Scene::members).sum();
    let observing: u32 = scenes.iter().flat_map(|scene| &scene.observing).sum();
    let second: u32 = scenes
        .iter()
        .map(|scene| scene.acting[1] + scene.observing[1])
        .sum();
    let abroad: u32 = scenes
        .iter()
        .map(|scene| scene.abroad(&scene.acting) + scene.abroad(&scene.observing))
        .sum();
    assert_eq!((all, second), (100_000, 0));
    assert!((24_500..25_500).contains(&observing), "{observing}");
    // Half are anywhere, of these 3/4 · 1/4 + 1/4 · 3/4 not in the region of their scene.
    assert!((17_000..20_500).contains(&abroad), "{abroad}");
}

#[test]
fn the_sum_of_one_scene_can_be_done_by_hand() {
    // A datagram is 1 ms of a processor, a member one of them in a second; half of everything may be used.
    let one = "--scenes 1 --regions 1 --observers 1 --datagrams 1 --datagram-us 1000 --full 0.5 --cores 4 --gb 1 --gbit 1 \
               --scene-cores 0.101 --scene-mb 100 --member-mb 1 --member-kbit 999.776";
    let plan = planned(&format!("--members 100 {one}"));
    let direct = &plan.direct;
    assert_eq!(
        (
            plan.largest_scene,
            direct.servers.number,
            direct.edges.number
        ),
        (100, 1, 0)
    );
    assert!((direct.servers.cores - 0.2).abs() < 1e-9);
    assert!((direct.gbit_s - 0.1).abs() < 1e-9 && direct.between_gbit_s == 0.0);
    assert_eq!(direct.datagrams_s, 100.0);
    // Memory: (500 − 100) / 1 members; sockets: 0.5 / 0.001 members; network: 0.5 / 0.001 members.
    let first = direct.breaks.as_ref().expect("a limit");
    assert_eq!(
        (first.times, first.members, &*first.limit),
        (5, 500, "memory")
    );
    // At edges: a mirror and 499 members fill one; each is one link, so that 400 edges fill the server.
    assert_eq!(
        (plan.edges.edges.number, plan.edges.datagrams_s),
        (1, 101.0)
    );
    assert_eq!(
        planned(&format!("--members 500 {one}")).edges.edges.number,
        2
    );
    let first = plan.edges.breaks.expect("a limit");
    assert_eq!(
        (first.times, &*first.limit),
        (400 * 499 / 100 + 1, "memory")
    );
}

#[test]
fn connections_are_a_limit_of_servers_and_streams_of_edges() {
    let free =
        "--datagram-us 0 --scene-cores 0 --scene-mb 0 --member-mb 0 --regions 1 --popularity 0";
    let plan = planned(&format!("--members 3000 --scenes 3 --observers 0 {free}"));
    assert_eq!(plan.direct.servers.number, 3);
    let first = plan.direct.breaks.expect("a limit");
    assert_eq!((first.times, &*first.limit), (2, "connections"));
    let few = planned(&format!("--members 600 --scenes 300 --observers 1 {free}"));
    assert_eq!(few.edges.edges.number, 2, "300 streams, 256 at an edge");
    assert_eq!(few.edges.breaks, None);
    assert_eq!(few.limits()[2][3], "> 65536");
}

#[test]
fn machines_hold_no_more_than_they_may() {
    let arguments = arguments("--members 20000 --scenes 300 --popularity 1.2");
    let shares = Shares::of(&arguments.costs, &arguments.machine);
    let mut filling = Filling::default();
    let mut links = 0;
    for scene in draw(&arguments.service, 3) {
        assert!(filling.put(shares.scene));
        links += filling.observe(scene.members(), &shares);
    }
    assert!(
        links >= 300
            && filling
                .machines
                .iter()
                .all(|machine| machine.0.iter().all(|share| *share <= 1.0 + 1e-9))
    );
}

#[test]
fn a_scene_beyond_every_server_is_counted_and_has_no_machine() {
    let plan = planned("--members 30000 --scenes 2 --regions 1 --popularity 0 --observers 0");
    assert_eq!((plan.direct.too_large, plan.direct.servers.number), (2, 0));
    assert_eq!(plan.direct.breaks.expect("a limit").times, 1);
}

#[test]
fn what_is_out_of_range_is_refused_with_its_range() {
    for (line, range) in [
        ("--at-home 1.5", "a share from 0 to 1"),
        ("--full 0", "a share above 0"),
        ("--cores nan", "a number above 0"),
        ("--regions 1,-1", "a number of at least 0"),
        ("--members 0", "1..=10000000"),
    ] {
        let words = std::iter::once("plan").chain(line.split_whitespace());
        let refused = Line::try_parse_from(words).expect_err(line).to_string();
        assert!(refused.contains(range), "{refused}");
    }
    let empty = run(&arguments("--regions 0,0")).expect_err("no region has members");
    assert!(empty.to_string().starts_with("--regions"));
    let small = run(&arguments("--gbit 0.000001")).expect_err("no member fits");
    assert!(small.to_string().contains("--gbit"));
}
