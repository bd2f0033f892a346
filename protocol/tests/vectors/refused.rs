//! Refused datagrams: truncated, not canonical, undefined, out of range.

use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::packet::{
    Low16, RefreshRecord, RefreshWriter, StreamId, Tables, TestEncoder, Update, Watermark,
};
use rhumb_reckoning::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, BodyId, RESIDUAL_LIMIT, TURN_LIMIT, Ticks,
    VELOCITY_LIMIT,
};

use crate::accepted::{attached_keyframe, every_form, packet};
use crate::case::{NamedPacket, PacketRng};
use crate::document::meaning;
use crate::plain;

/// Contexts by number: gaps, ages by kind, a parent's age, the first of positions.
const GAP: [usize; 2] = [0, 1];
const AGE: usize = 2;
const PARENT_AGE: usize = 6;
const POSITION: usize = 8;
const TURN: usize = POSITION + 5;
const VELOCITY: usize = TURN + 9;
const COARSENESS: usize = VELOCITY + 40;
const LENGTH: usize = COARSENESS + 4;
const REST_AGE: usize = 7;
const ACCELERATION_EXPONENT: usize = LENGTH + 5;
const ACCELERATION: usize = ACCELERATION_EXPONENT + 1;

/// Codes of forms.
const SAME: usize = 0;
const SAME_MOVED: usize = 1;
const REST: usize = 2;
const ATTACHED: usize = 11;
const KEYFRAME: usize = 12;
const RESTING: usize = 13;
const ACCELERATED: usize = 14;
const ASSIGN_ALIAS: usize = 16;
const END: usize = 17;
const INDEX_BITS: u32 = 20;

/// All refused cases.
pub(crate) fn cases() -> Vec<NamedPacket> {
    let mut cases = Vec::new();
    heads(&mut cases);
    repair_symbols(&mut cases);
    codes(&mut cases);
    numbers(&mut cases);
    keyframes(&mut cases);
    tails(&mut cases);
    refreshes(&mut cases);
    cases.extend(plain::refused());
    cases
}

/// A packet with the same head as the accepted ones.
fn state(updates: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x51, 0x70, 0x11, 0x2c, 1, 12, 0];
    bytes.extend_from_slice(updates);
    bytes
}

fn heads(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, bytes: &[u8]| cases.push((name.to_owned(), bytes.to_vec()));
    case("nothing", &[]);
    for kind in [13, 14, 15] {
        case("a kind without a meaning", &[0x50 | kind, 1, 2, 3]);
    }
    case("a kind that never gets a meaning", &[0x5a, 1, 2, 3]);
    case("a stream id that ends too soon", &[0xf1, 0x80]);
    let long = [0xf1, 0x85, 0, 0, 0, 0, 0, 0, 0, 0];
    case("a stream id in a longer form", &long);
    let wide = [0xf1, 0x80, 0x80, 0x80, 0x80, 0x10, 0, 0, 0, 0, 0, 0, 0];
    case("a stream id of 33 bits", &wide);
    let large = [0xf1, 0xf1, 0xff, 0xff, 0xff, 0x0f, 0, 0, 0, 0, 0, 0, 0];
    case("a stream id that is too large", &large);
    let none = state(&TestEncoder::default().code(0, END).into_bytes());
    for cut in 1..7 {
        case("a head that ends too soon", &none[..cut]);
    }
    case("updates without an end", &none[..7]);
    case("bytes behind no updates", &[&none[..], &[1]].concat());
    case("a zero behind no updates", &[&none[..], &[0]].concat());
    let mut many = all_still(TestEncoder::default().code(0, SAME).number(GAP[0], 0));
    for _ in 1..=400 {
        many = all_still(many.code(1, SAME).number(GAP[1], 0));
    }
    case("401 updates", &state(&many.code(1, END).into_bytes()));
    let watermark = Watermark {
        next: Low16(1),
        tick: Low16(2),
        scene_events: Low16(3),
    }
    .encode(StreamId(5));
    case(
        "a watermark that ends too soon",
        &watermark[..watermark.len() - 1],
    );
    case("bytes behind a watermark", &[&watermark[..], &[0]].concat());
    case(
        "a watermark over budget without an error scale",
        &[0x5c, 0, 1, 0, 2, 0, 3, 0],
    );
    case(
        "a packet over budget without an error scale",
        &[0x5b, 0, 1, 0, 2, 0, 3, 0, 0],
    );
    case(
        "a watermark over budget that ends too soon",
        &[0x5c, 9, 1, 0, 2, 0, 3],
    );
    case("a loss report of 65 numbers", &[0x56, 0, 0, 0, 0, 0, 65]);
    case(
        "a loss report that ends too soon",
        &[0x56, 0, 0, 0, 0, 0, 2, 1, 0],
    );
    case(
        "a loss report that requests 33 repair symbols",
        &[0x56, 0, 0, 0, 0, 33, 0],
    );
}

fn repair_symbols(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, bytes: &[u8]| cases.push((name.to_owned(), bytes.to_vec()));
    let repair_symbol = [0x59, 0x71, 0x11, 3, 7, 1, 2, 3];
    for cut in 1..5 {
        case("a repair symbol that ends too soon", &repair_symbol[..cut]);
    }
    case("a repair symbol of row 128", &[0x59, 0x71, 0x11, 3, 128, 1]);
    let over = [0x59, 0x71, 0x11, 0x80, 0x80, 0x80, 0x80, 8, 7, 1];
    case("a repair symbol over 33 numbers", &over);
    case(
        "a repair symbol that ends in a zero",
        &[&repair_symbol[..], &[0]].concat(),
    );
    let sums = [&repair_symbol[..5], &[1; 1137]].concat();
    case("a repair symbol of 1137 bytes", &sums);
}

fn codes(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    let assignment = || TestEncoder::default().code(0, ASSIGN_ALIAS);
    let placed = |test_encoder: TestEncoder| test_encoder.number(GAP[0], 0).raw(3, INDEX_BITS);
    case(
        "an alias taken twice",
        placed(assignment().code(0, ASSIGN_ALIAS)),
    );
    let keyframe = placed(assignment().code(0, KEYFRAME));
    case("an alias taken before a keyframe track", keyframe);
    case("an alias taken before the end", assignment().code(0, END));
    let held = |test_encoder: TestEncoder| {
        test_encoder
            .number(AGE + 2, 0)
            .raw(7, INDEX_BITS)
            .number(PARENT_AGE, 0)
    };
    let still = |test_encoder: TestEncoder| {
        let mut test_encoder = unmoved(test_encoder, POSITION);
        for context in [4, 0, 0] {
            test_encoder = test_encoder.number(TURN + context, 0);
        }
        test_encoder
    };
    let first = still(held(first_update(ATTACHED)));
    let again = first.code(3, ATTACHED).number(GAP[1], 0).number(AGE + 2, 0);
    case(
        "the same parent named anew",
        again.raw(0, 1).raw(7, INDEX_BITS).raw(1, 8),
    );
    for predictor in 5..8 {
        let test_encoder = first_update(KEYFRAME)
            .raw(3, INDEX_BITS)
            .raw(predictor, 3)
            .raw(1, 8);
        case("a predictor without a meaning", test_encoder);
    }
}

fn numbers(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    let aliased = |gap| all_still(TestEncoder::default().code(0, SAME).number(GAP[0], gap));
    case(
        "an alias beyond the last",
        aliased(INDICES_MAX).code(1, END),
    );
    let after = aliased(INDICES_MAX - 1).code(1, SAME).number(GAP[1], 0);
    case("an alias after the last", all_still(after).code(1, END));
    case(
        "an age beyond the greatest",
        first_update(SAME).number(AGE, 1 << 30).raw(1, 8),
    );
    let parent = first_update(REST).number(AGE + 2, 0).raw(1, 1);
    case(
        "a parent's age beyond the greatest",
        parent.number(PARENT_AGE, (1 << 30) + 1).raw(1, 8),
    );
    let same = |code| first_update(code).number(AGE + code, 0);
    let position = same(SAME)
        .number(POSITION, RESIDUAL_LIMIT as u32 + 1)
        .raw(1, 1);
    let position = position.number(POSITION + 4, 0).number(POSITION + 4, 0);
    let position = position.number(TURN + 8, 0).number(TURN, 0).number(TURN, 0);
    case("a position beyond its limit", position);
    let turn = unmoved(same(SAME), POSITION)
        .number(TURN + 4, TURN_LIMIT as u32 + 1)
        .raw(0, 1);
    case(
        "a turn beyond its limit",
        turn.number(TURN + 3, 0).number(TURN + 3, 0),
    );
    velocities(cases);
    endless_numbers(cases);
    rest_corrections(cases);
    accelerations(cases);
}

/// Velocities and the exponents of their steps.
fn velocities(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    let accepted = |velocity_exponent| {
        first_update(SAME_MOVED)
            .number(AGE + SAME_MOVED, 0)
            .number(COARSENESS, velocity_exponent)
    };
    let moved = |velocity_exponent| {
        unmoved(accepted(velocity_exponent), POSITION)
            .number(TURN + 4, 0)
            .number(TURN, 0)
            .number(TURN, 0)
    };
    for velocity_exponent in [0, 5] {
        let beyond = (VELOCITY_LIMIT >> velocity_exponent) as u32 + 1;
        let fast = moved(velocity_exponent).number(VELOCITY, beyond).raw(1, 1);
        let fast = fast.number(VELOCITY + 4, 0).number(VELOCITY + 4, 0);
        let name = format!("a velocity beyond its limit, doubled {velocity_exponent} times");
        case(&name, unmoved(fast, VELOCITY + 5));
    }
    let coarse = unmoved(unmoved(moved(13), VELOCITY), VELOCITY + 5);
    case("steps doubled too often", coarse);
}

/// Accelerations, in updates and in keyframes.
fn accelerations(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    let accepted = |exponent| {
        let test_encoder = first_update(ACCELERATED).number(AGE + 2, 0).raw(0, 1);
        test_encoder.number(ACCELERATION_EXPONENT, exponent)
    };
    case(
        "a push beyond its limit",
        accepted(0)
            .number(ACCELERATION, ACCELERATION_LIMIT as u32 + 1)
            .raw(1, 8),
    );
    let often = accepted(u32::from(ACCELERATION_EXPONENT_MAX) + 1).number(ACCELERATION, 0);
    let often = often
        .number(ACCELERATION + 1, 0)
        .number(ACCELERATION + 1, 0);
    case("a push of steps doubled too often", often.raw(1, 8));
    let keyframe = || {
        first_update(KEYFRAME)
            .raw(3, INDEX_BITS)
            .raw(5, 3)
            .raw(0, 1)
    };
    let none = |test_encoder: TestEncoder| test_encoder.raw(0, 1).raw(0, 6);
    case(
        "a keyframe track accelerated by steps doubled too often",
        none(none(none(keyframe().raw(13, 4)))).raw(0xff, 8),
    );
    // 2048, signed 1024, is 64 less than 2^11 + 2^6.
    let beyond = keyframe().raw(0, 4).raw(0x1f, 5).raw(0, 1).raw(64, 11);
    case(
        "a keyframe track accelerated beyond the limit",
        none(none(beyond)).raw(0xff, 8),
    );
    let unturned = [0, 0, 0, 0, 0, 0, 1.0_f32.to_bits(), 0, 0, 0, 0, 0, 0];
    let exact = none(none(none(keyframe().raw(0, 4)))).raw(1, 1);
    let exact = unturned.into_iter().fold(exact, |test_encoder, part| {
        test_encoder.raw(part & 0xffff, 16).raw(part >> 16, 16)
    });
    case("a track accelerated to the bit", exact.code(1, END));
    case(
        "a predictor without a meaning",
        first_update(KEYFRAME)
            .raw(3, INDEX_BITS)
            .raw(6, 3)
            .raw(0xff, 8),
    );
}

fn rest_corrections(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    let resting = || first_update(RESTING).number(REST_AGE, 0).raw(0, 1);
    case(
        "a rest_correction of a track that is too old",
        first_update(RESTING).number(REST_AGE, 1 << 30).raw(1, 8),
    );
    case(
        "a step of 32 bits",
        resting().number(LENGTH, 2 * (32 - 14)).raw(1, 8),
    );
    case(
        "a step of less than no bits",
        resting().number(LENGTH, 2 * 14 + 1).raw(1, 8),
    );
}

fn endless_numbers(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, test_encoder: TestEncoder| {
        cases.push((name.to_owned(), state(&test_encoder.into_bytes())));
    };
    for bits in [31, 40] {
        let mut endless = TestEncoder::default()
            .code(0, SAME)
            .escape(shape_of_first_gap());
        for _ in 0..bits {
            endless = endless.raw(1, 1);
        }
        case("a number of too many bits", endless.raw(1, 8));
    }
    let mut wide = TestEncoder::default()
        .code(0, SAME)
        .escape(shape_of_first_gap());
    for _ in 0..30 {
        wide = wide.raw(1, 1);
    }
    case(
        "a number beyond 32 bits, or an alias beyond the last",
        wide.raw(0, 1).raw(0x3fff_ffff, 30).raw(1, 8),
    );
}

/// The start of a first update, of alias 0.
fn first_update(code: usize) -> TestEncoder {
    TestEncoder::default().code(0, code).number(GAP[0], 0)
}

/// A correction of zero in the same mode, of a track with age 1.
fn all_still(test_encoder: TestEncoder) -> TestEncoder {
    unmoved(test_encoder.number(AGE, 0), POSITION)
        .number(TURN + 4, 0)
        .number(TURN, 0)
        .number(TURN, 0)
}

/// The class of the first gap of a packet, by PROTOCOL 5.4.
fn shape_of_first_gap() -> usize {
    let sixteenths = u32::from(Tables::ALL.expected[GAP[0]]) / 16 + 1;
    let octave = sixteenths.ilog2();
    let raw = (octave + 1).saturating_sub(7);
    let quarter = (((sixteenths >> raw) << 2) >> (octave - raw)) & 3;
    ((octave - raw) * 4 + quarter) as usize
}

fn exact_keyframes(case: &mut impl FnMut(&str, &[(u32, u32)])) {
    let rest: [(u32, u32); 3] = [(0, 3), (0, 1), (1, 1)];
    let zeros = |count: usize| vec![(0_u32, 32_u32); count];
    let nan = [
        &rest[..],
        &[(0x7fc0_0000, 32)],
        &zeros(5),
        &[(0x3f80_0000, 32)],
    ]
    .concat();
    case("a position that is no number", &nan);
    case("a rotation of no length", &[&rest[..], &zeros(7)].concat());
}

fn keyframes(cases: &mut Vec<NamedPacket>) {
    let mut case = |name: &str, bits: &[(u32, u32)]| {
        let mut test_encoder = first_update(KEYFRAME).raw(3, INDEX_BITS);
        for (value, count) in bits {
            test_encoder = test_encoder.raw(*value, *count);
        }
        // Ones follow, so that the case is refused before the bytes end.
        cases.push((
            name.to_owned(),
            state(&test_encoder.raw(0xff, 8).into_bytes()),
        ));
    };
    exact_keyframes(&mut case);
    let mut moving = vec![(1, 3), (1, 1), (9, 20), (0, 16), (0, 1)];
    moving.extend([(0, 1), (0, 14)].repeat(3));
    moving.extend([(3, 2), (524_288, 20), (524_288, 20), (524_288, 20)]);
    moving.extend([(0, 1), (0, 6)].repeat(6));
    case("a parent, and not at rest", &moving);
    let far = [(0, 3), (0, 1), (0, 1)];
    let mut ones = far.to_vec();
    ones.extend([(1, 1); 18]);
    case("a position of too many bits", &ones);
    let still = [(0_u32, 1_u32), (0, 14)];
    let origin: Vec<_> = far
        .iter()
        .chain(&still)
        .chain(&still)
        .chain(&still)
        .copied()
        .collect();
    case(
        "a packed rotation whose largest is another",
        &[
            &origin[..],
            &[
                (3, 2),
                (524_288 + 370_728, 20),
                (524_288 + 370_728, 20),
                (524_288 + 370_728, 20),
            ],
        ]
        .concat(),
    );
    case(
        "a packed rotation beyond its limit",
        &[
            &origin[..],
            &[(3, 2), (0, 20), (524_288, 20), (524_288, 20)],
        ]
        .concat(),
    );
    // One more than the limit of positions is 2³⁰ + 1, doubled.
    let shifted = (2_u32 << 30) + 2 + (1 << 14);
    let extra = shifted.ilog2() - 14;
    let mut beyond = far.to_vec();
    beyond.extend((0..extra).map(|_| (1, 1)));
    beyond.extend([(0, 1), (shifted & !(1 << shifted.ilog2()), extra + 14)]);
    beyond.extend(still.iter().chain(&still));
    beyond.extend([(3, 2), (524_288, 20), (524_288, 20), (524_288, 20)]);
    case("a position beyond its limit, in a keyframe track", &beyond);
}

fn tails(cases: &mut Vec<NamedPacket>) {
    let forms: Vec<_> = (0..)
        .zip(every_form())
        .map(|(alias, payload)| Update {
            alias,
            body: Some(alias + 9),
            payload,
        })
        .collect();
    let bytes = packet(&forms);
    let mut rng = PacketRng::new(5);
    let (mut cuts, mut flips) = (0, 0);
    while cuts < 10 {
        let cut = &bytes[..7 + rng.below(bytes.len() as u32 - 7) as usize];
        if meaning(cut).is_err() {
            cases.push(("cut short".to_owned(), cut.to_vec()));
            cuts += 1;
        }
    }
    while flips < 10 {
        let mut flipped = bytes.clone();
        let place = 7 + rng.below(bytes.len() as u32 - 7) as usize;
        flipped[place] ^= 1 << rng.below(8);
        if meaning(&flipped).is_err() {
            cases.push(("a bit changed".to_owned(), flipped));
            flips += 1;
        }
    }
    let followed = |more: &[u8]| [&bytes, more].concat();
    let tails: [&[u8]; 6] = [&[0], &[1], &[2], &[0, 0, 0, 0, 1], &[0xff; 9], &[0xff; 12]];
    // Some tails make a packet with other updates.
    let refused = tails.map(followed).into_iter();
    let refused = refused.filter(|packet| meaning(packet).is_err()).take(4);
    cases.extend(refused.map(|packet| ("bytes behind the updates".to_owned(), packet)));
    // A raw field of 16 bits reads part 2^16 (5.3-4). A decoder that takes the last part instead, and whose offset has 32
    // bits, loses the bit above them, and the rest is well-formed.
    for string in [
        [0x5f, 0xce, 0xce, 0x1b, 0xfc, 0x94, 0x5e, 0x96],
        [0x6b, 0xc2, 0x95, 0x46, 0xfc, 0x64, 0xea, 0xa7],
        [0x5d, 0xeb, 0x30, 0x21, 0x4d, 0x0b, 0xa3, 0x48],
    ] {
        cases.push(("a part behind the last".to_owned(), state(&string)));
    }
    for tail in [&[0xff; 4][..], &[0xff; 40]] {
        cases.push(("all ones".to_owned(), state(tail)));
    }
}

fn refreshes(cases: &mut Vec<NamedPacket>) {
    let record = RefreshRecord {
        index: 5,
        alias: Some(3),
        age: Ticks::new(4),
        keyframe: attached_keyframe(&mut PacketRng::new(3), BodyId::new(8, 1)),
    };
    let mut writer = RefreshWriter::default();
    writer.push(&record);
    let bytes = writer.finish(StreamId(5), 1, 2, 3).remove(0);
    let mut case = |name: &str, bytes: &[u8]| cases.push((name.to_owned(), bytes.to_vec()));
    case("a refresh that ends too soon", &bytes[..bytes.len() - 1]);
    case("bytes behind a refresh", &[&bytes[..], &[0]].concat());
    let with = |place: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[place] = value;
        bytes
    };
    case("a part that is none of the parts", &with(7, 1));
    case("more parts than there may be", &with(8, 65));
    let mut filled = bytes.clone();
    *filled.last_mut().expect("it has bytes") |= 0x80;
    case("filling that is not zero", &filled);
}

/// A triple of zeros, whose contexts begin at `first`: a position or a velocity.
fn unmoved(test_encoder: TestEncoder, first: usize) -> TestEncoder {
    let test_encoder = test_encoder.number(first, 0);
    test_encoder.number(first + 1, 0).number(first + 1, 0)
}
