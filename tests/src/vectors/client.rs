//! Vectors of client messages: every message and command.

use super::message_case::MessageCase;
use super::pieces::{
    CaseList, TURNED, bad_shapes, body, cell_places, choices, config, config_of, extensions, f,
    hinges, id, joints, motion, properties, shapes, v,
};

pub(super) fn cases() -> Vec<MessageCase> {
    let mut cases = CaseList::default();
    hellos(&mut cases);
    for (stepping, word) in [(0, "lockstep"), (1, "free running")] {
        for sleep in [false, true] {
            let name = format!("Create, {word}, sleep {sleep}");
            cases.add(2, name, &[&config(stepping, sleep)]);
        }
    }
    for (word, publish_schedule) in [("every third tick", [3, 0]), ("with lookahead", [1, 1])] {
        let name = format!("Create, lockstep, {word}");
        cases.add(2, name, &[&config_of(0, false, publish_schedule)]);
    }
    choosing(&mut cases);
    moves(&mut cases);
    for (kind, name) in [(4, "Leave"), (5, "Delete"), (11, "Inspect")] {
        cases.add(kind, name, &[]);
    }
    cases.add(6, "Reserve", &[&v(4_096)]);
    cases.add(8, "Advance", &[&v(300)]);
    cases.add(9, "Resync, lost sync", &[&[0]]);
    cases.add(9, "Resync, checksum mismatch", &[&[1]]);
    cases.add(10, "Ping", &[&v(123_456_789_012)]);
    cases.add(13, "Subscribed", &[&v(5)]);
    cases.add(15, "Upstream, nothing", &[]);
    cases.add(15, "Upstream", &[&[2, 5, 0, 0, 9, 0, 0, 0]]);
    cases.add(15, "Upstream, the longest", &[&[1; 1_150]]);
    cases.add(15, "Upstream, too long", &[&[1; 1_151]]);
    commands(&mut cases);
    queries(&mut cases);
    sessions(&mut cases);
    cells(&mut cases);
    cases.add_unknown(18);
    cases.0
}

fn choosing(cases: &mut CaseList) {
    for (word, choice) in choices() {
        cases.add(3, format!("Join, {word}"), &[&choice]);
        cases.add(12, format!("Subscribe, {word}"), &[&choice]);
        if choice != [1] {
            let size = v(1_100);
            cases.add(
                14,
                format!("TakeAuthority none, {word}"),
                &[&choice, &size, &[0]],
            );
            let (one, other) = (id(3, 0), id(300, 2));
            cases.add(
                14,
                format!("TakeAuthority two, {word}"),
                &[&choice, &size, &[2], &one, &other],
            );
            let later = id(3, 1);
            cases.add(
                14,
                format!("TakeAuthority by generation, {word}"),
                &[&choice, &size, &[2], &one, &later],
            );
            cases.add(
                14,
                format!("TakeAuthority one twice, {word}"),
                &[&choice, &size, &[2], &one, &one],
            );
            cases.add(
                14,
                format!("TakeAuthority in falling order, {word}"),
                &[&choice, &size, &[2], &other, &one],
            );
        }
    }
    cases.add(
        14,
        "TakeAuthority by a full stream",
        &[&[1], &v(1_100), &[0]],
    );
    for size in [699, 700, 1_150, 1_151] {
        cases.add(
            14,
            format!("TakeAuthority, packets of at most {size} bytes"),
            &[&choices()[0].1, &v(size), &[0]],
        );
    }
    let all: Vec<u8> = (0..256).flat_map(|index| id(index, 0)).collect();
    cases.add(
        14,
        "TakeAuthority the most",
        &[&choices()[0].1, &v(1_100), &v(256), &all],
    );
    cases.add(
        14,
        "TakeAuthority one more than the most",
        &[&choices()[0].1, &v(1_100), &v(257), &all, &id(256, 0)],
    );
}

/// Tier policies, and invalid budgets.
fn moves(cases: &mut CaseList) {
    cases.add(16, "TierPolicy, never", &[&[0]]);
    for most in [999, 1_000, 200_000, 10_000_000, 10_000_001] {
        cases.add(16, format!("TierPolicy, up to {most}"), &[&[1], &v(most)]);
    }
    cases.add(16, "TierPolicy, no such word", &[&[2]]);
    cases.add(16, "TierPolicy, nothing", &[]);
    let budget = [v(8_000), v(2_000)].concat();
    cases.add(3, "Join, a full stream in a budget", &[&[3], &budget, &[1]]);
    let twice = [&[3][..], &budget, &[0], &v(50_000)].concat();
    cases.add(3, "Join, a budget in a budget", &[&[3], &budget, &twice]);
}

/// Queries of each kind, filters, and the limit of the cost.
fn queries(cases: &mut CaseList) {
    let one = |kind: Vec<u8>, filter: &[u8], hits: u8| [&[1], &kind[..], filter, &[hits]].concat();
    let ray = || [vec![0], f(&[1.0, 2.0, 3.0, 0.0, -20.0, 0.0])].concat();
    cases.add(17, "Query, a ray", &[&one(ray(), &[0], 1)]);
    cases.add(17, "Query, no hits", &[&one(ray(), &[0], 0)]);
    cases.add(17, "Query, the most hits", &[&one(ray(), &[0], 64)]);
    let except = [&[16][..], &id(300, 2)].concat();
    let groups = [32, 5, 0, 0, 0x80];
    let all = [32, 0xff, 0xff, 0xff, 0xff];
    for (word, filter) in [
        ("kinds and sensors", &[15][..]),
        ("an excepted body", &except),
        ("groups", &groups),
        ("all groups", &all),
        ("an unknown flag", &[64]),
    ] {
        let name = format!("Query, a ray with {word}");
        cases.add(17, name, &[&one(ray(), filter, 2)]);
    }
    for (word, shape) in shapes() {
        let at = [shape, f(&[1.0, 2.0, 3.0]), f(&TURNED)].concat();
        let cast = [&[1], &at[..], &f(&[5.0, 0.0, 0.0])].concat();
        cases.add(17, format!("Query, cast of {word}"), &[&one(cast, &[0], 1)]);
        let overlap = [&[3], &at[..]].concat();
        let name = format!("Query, overlap of {word}");
        cases.add(17, name, &[&one(overlap, &[0], 64)]);
    }
    let projection = [vec![2], f(&[1.0, 2.0, 3.0, 0.5])].concat();
    cases.add(17, "Query, a projection", &[&one(projection, &[0], 1)]);
    cases.add(17, "Query, nothing", &[&[0]]);
    let contacts = [&[4][..], &id(300, 2)].concat();
    cases.add(17, "Query, contacts", &[&one(contacts, &[0], 64)]);
    cases.add(17, "Query, no such kind", &[&one(vec![5], &[0], 1)]);
    for (word, count) in [("the greatest cost", 64), ("one more", 65)] {
        let rays = [ray(), vec![0, 64]].concat().repeat(count);
        let name = format!("Query, {word}");
        cases.add(17, name, &[&v(count as u64), &rays]);
    }
}

/// Requests for a session.
fn sessions(cases: &mut CaseList) {
    let key: Vec<u8> = (0..16).collect();
    cases.add(32, "Session, a new one", &[&[0], &key]);
    cases.add(32, "Session, after 300 commands", &[&v(300), &key]);
    cases.add(32, "Session, a short key", &[&[0], &key[..15]]);
    cases.add(32, "Session, a long key", &[&[0], &key, &[16]]);
}

fn hellos(cases: &mut CaseList) {
    let offer = |versions: &[u16]| {
        let mut bytes = [b"RHMB".to_vec(), v(versions.len() as u64)].concat();
        bytes.extend(versions.iter().flat_map(|version| version.to_le_bytes()));
        bytes
    };
    let pit = [&[3], &b"pit"[..]].concat();
    for (name, versions, ids) in [
        ("Hello", &[1][..], &[][..]),
        ("Hello, greased", &[0x1a1a, 1], &[27]),
        ("Hello from the future", &[2, 1], &[2, 3, 89]),
        (
            "Hello with the most of all",
            &[7; 16],
            &[1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31],
        ),
        ("Hello with too many versions", &[7; 17], &[]),
        ("Hello without versions", &[], &[]),
        ("Hello with extensions that fall", &[1], &[27, 3]),
        ("Hello with an extension twice", &[1], &[27, 27]),
    ] {
        cases.add(1, name, &[&offer(versions), &pit, &extensions(ids)]);
    }
    let magic = [b"RHMC", &offer(&[1])[4..], &pit, &[0]].concat();
    cases.add(1, "Hello of another protocol", &[&magic]);
    let longest = [&[64], &[b'x'; 64][..]].concat();
    for (name, scene) in [
        ("Hello, the longest name", &longest[..]),
        ("Hello, every kind of letter", b"\x08aZ0-_./9"),
        ("Hello, a name of nothing", &[0]),
        ("Hello, a space in the name", b"\x03a b"),
        ("Hello, a name that is not ASCII", b"\x02\xc3\xa4"),
        ("Hello, a name that is no text", b"\x01\xff"),
        ("Hello, a name too long", &[&[65], &[b'x'; 65][..]].concat()),
    ] {
        cases.add(1, name, &[&offer(&[1]), scene, &[0]]);
    }
}

fn commands(cases: &mut CaseList) {
    for (word, shape) in shapes() {
        cases.add(7, format!("AddShape, {word}"), &[&[0], &v(1), &shape]);
    }
    let points = |count: u8| -> Vec<u8> {
        let numbers =
            (0..count).flat_map(|n| [f32::from(n % 2), f32::from(n / 2 % 2), f32::from(n / 4)]);
        [vec![4, count], f(&numbers.collect::<Vec<_>>())].concat()
    };
    cases.add(7, "AddShape, the most points", &[&[0], &v(1), &points(255)]);
    cases.add(7, "AddShape, too few points", &[&[0], &v(1), &points(3)]);
    cases.add(
        7,
        "AddShape, a flat hull",
        &[&[0], &v(1), &[4, 4], &f(&[0.0; 12])],
    );
    for (word, shape) in bad_shapes() {
        cases.add(7, format!("AddShape, {word}"), &[&[0], &v(1), &shape]);
    }
    cases.add(7, "RemoveShape", &[&[1], &v(1)]);
    for flags in [0, 1, 2, 4, 8, 16, 32, 60, 61, 64, 128, 193, 254, 255] {
        let config = body(300, flags);
        cases.add(
            7,
            format!("AddBody, flags {flags}"),
            &[&[2], &config, &motion(0)],
        );
    }
    for present in 1..8 {
        let config = body(3, 1);
        cases.add(
            7,
            format!("AddBody, present {present}"),
            &[&[2], &config, &motion(present)],
        );
    }
    pushes(cases);
}

/// Commands that change existing bodies and joints.
fn changes(cases: &mut CaseList) {
    for (word, properties) in properties() {
        cases.add(7, format!("ChangeBody, {word}"), &[&[13], &properties]);
    }
    let (_, joint) = &joints()[0];
    cases.add(7, "ChangeJoint", &[&[14], &v(7), joint]);
    let nothing = [v(0x80), joint[1..].to_vec(), vec![0]].concat();
    cases.add(
        7,
        "ChangeJoint, no motors though they follow",
        &[&[14], &v(7), &nothing],
    );
    for (code, name) in [(15, "ForceAt"), (16, "ImpulseAt")] {
        let vectors = f(&[0.0, 2.5, 0.0, 1.0, -1.0, 0.5]);
        cases.add(7, name, &[&[code], &id(300, 2), &vectors]);
    }
    cases.add(7, "Sleep", &[&[17], &id(300, 2)]);
    cases.add(7, "Wake", &[&[18], &id(300, 2)]);
}

/// Commands about characters and vehicles.
fn walking(cases: &mut CaseList) {
    let locomotion = |bytes: &[u8]| [&[20][..], &id(300, 2), bytes].concat();
    cases.add(7, "SetLocomotion, none", &[&locomotion(&[0])]);
    cases.add(7, "SetLocomotion, no such word", &[&locomotion(&[3])]);
    for flags in 0..=16_u8 {
        let mut numbers = vec![0.02, 0.75, 1.0, 80.0];
        for (bit, more) in [(1, &[0.0, 1.0, 0.0][..]), (2, &[0.3, 0.125]), (8, &[0.25])] {
            if flags & bit != 0 {
                numbers.extend(more);
            }
        }
        let name = format!("SetLocomotion, a character with flags {flags}");
        let character = [&[1, flags], &f(&numbers)[..]].concat();
        cases.add(7, name, &[&locomotion(&character)]);
    }
    let wheel = [
        0.75, -0.25, 1.5, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.3, 0.4, 0.2, 50.0, 4.0, 6.0, 9_000.0,
        2.0, 1.0,
    ];
    let input = [0.25, 500.0, 0.0];
    for count in [0, 1, 4, 16, 17] {
        let name = format!("SetLocomotion, a vehicle with {count} wheels");
        let wheels = f(&wheel).repeat(count);
        let vehicle = [&[2, count as u8], &wheels[..]].concat();
        cases.add(7, name, &[&locomotion(&vehicle)]);
        let name = format!("SetWheels, {count} inputs");
        let inputs = f(&input).repeat(count);
        cases.add(7, name, &[&[22], &id(300, 2), &[count as u8], &inputs]);
    }
    for (word, from) in [("the ground", 0), ("anywhere", 1), ("no such place", 2)] {
        let name = format!("Jump from {word}");
        cases.add(7, name, &[&[21], &id(300, 2), &f(&[5.0]), &[from]]);
    }
}

/// Requests about cells.
fn cells(cases: &mut CaseList) {
    cases.add(128, "JoinCells", &[]);
    cases.add(128, "JoinCells, a byte behind it", &[&[0]]);
    for (word, places) in cell_places() {
        cases.add(129, format!("OfCell, {word}, Leave"), &[&places, &[3]]);
    }
    let (_, cell) = &cell_places()[0];
    for (word, choice) in choices() {
        let name = format!("OfCell, Subscribe, {word}");
        cases.add(129, name, &[cell, &[0], &choice]);
    }
    cases.add(129, "OfCell, Subscribed", &[cell, &[1], &v(5)]);
    for cause in [0, 1, 2] {
        let name = format!("OfCell, Resync, cause {cause}");
        cases.add(129, name, &[cell, &[2, cause]]);
    }
    cases.add(129, "OfCell, no such request", &[cell, &[4]]);
}

/// Commands that move or constrain existing bodies.
fn pushes(cases: &mut CaseList) {
    cases.add(7, "RemoveBody", &[&[3], &id(300, 2)]);
    cases.add(
        7,
        "SetPose",
        &[&[4], &id(300, 2), &f(&[1.0, 2.0, 3.0]), &f(&TURNED)],
    );
    let unturned = f(&[0.0, 0.0, 0.0, 0.0]);
    cases.add(
        7,
        "SetPose, no rotation",
        &[&[4], &id(300, 2), &f(&[0.0; 3]), &unturned],
    );
    cases.add(
        7,
        "SetVelocity",
        &[&[5], &id(300, 2), &f(&[1.0, -1.0, 0.0, 0.0, 0.5, 99.0])],
    );
    for (code, name) in [
        (6, "Force"),
        (7, "Torque"),
        (8, "Impulse"),
        (9, "TorqueImpulse"),
    ] {
        cases.add(7, name, &[&[code], &id(300, 2), &f(&[0.0, 2.5, 0.0])]);
    }
    cases.add(7, "SetGravity", &[&[10], &f(&[0.0, -1.5, 0.0])]);
    for (word, joint) in joints() {
        cases.add(7, format!("AddJoint, {word}"), &[&[11], &v(7), &joint]);
    }
    for (word, joint) in hinges() {
        cases.add(7, format!("AddJoint, {word}"), &[&[11], &v(7), &joint]);
    }
    let fixed = [&[16][..], &joints()[0].1[1..], &f(&[0.0, 1.0])].concat();
    cases.add(7, "AddJoint, fixed with limits", &[&[11], &v(7), &fixed]);
    cases.add(7, "RemoveJoint", &[&[12], &v(7)]);
    for flags in [0, 1, 2, 12, 15, 16] {
        let force = if flags & 2 == 0 { vec![] } else { f(&[12.5]) };
        let name = format!("SetEvents, flags {flags}");
        cases.add(7, name, &[&[19], &id(300, 2), &[flags], &force]);
    }
    changes(cases);
    walking(cases);
    for code in [23, 0x7f] {
        cases.add(
            7,
            format!("a critical command {code} that is unknown"),
            &[&[code, 1]],
        );
    }
    for code in [0x80, 0x9a, 0xff] {
        cases.add(
            7,
            format!("an optional command {code} that is unknown"),
            &[&[code, 1]],
        );
    }
}
