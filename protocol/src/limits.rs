//! Every bound of the protocol, with assertions that relate them.
//!
//! No peer may exceed them; a server with lower limits reports each refusal (PROTOCOL 7-3).

/// Bytes of a state datagram: fits a QUIC packet of 1,200 bytes with its header and tag.
pub const DATAGRAM_BYTES_MAX: usize = 1_150;
/// Least size that a stream may state for its largest packet, bytes: a refresh of any packet fits its parts.
pub const LARGEST_PACKET_MIN: usize = 700;
/// Updates in one packet.
pub const UPDATES_PER_PACKET_MAX: usize = 400;
/// Bytes of one control message, without its length and type.
pub const MESSAGE_BYTES_MAX: usize = 16 * 1024;
/// Bytes of one control message sent in pieces: a mesh at its limits.
pub const LONG_MESSAGE_BYTES_MAX: usize = 2 << 20;
/// Bytes of a scene's name in UTF-8.
pub const SCENE_NAME_BYTES_MAX: usize = 64;
/// Versions that one `Hello` may offer.
pub const VERSIONS_MAX: usize = 16;
/// Extensions of one message.
pub const EXTENSIONS_MAX: usize = 16;
/// Bytes of one extension's value: a signed token fits it.
pub const EXTENSION_BYTES_MAX: usize = 768;

/// Least bytes that a second of a stream with a budget may take; see [`BUDGET_MAX`].
pub const BUDGET_MIN: u32 = 256;
/// See [`BUDGET_MIN`].
pub const BUDGET_MAX: u32 = 1 << 30;
/// Most bytes that such a stream may take at once; the least is a full datagram.
pub const BUDGET_BURST_MAX: u32 = 1 << 24;

/// Bodies in one scene at one time.
pub const BODIES_MAX: u32 = 131_072;
/// Bound on body indices: more than bodies, since each member has some in reserve.
pub const INDICES_MAX: u32 = 1 << 20;
/// Shapes in one scene. Shape ids are below it.
pub const SHAPES_MAX: u32 = 8_192;
/// Joints in one scene. Joint ids are below it.
pub const JOINTS_MAX: u32 = 65_536;
/// Streams of one scene: different choices with subscribers.
pub const STREAMS_PER_SCENE_MAX: usize = 8;
/// The shortest edge of a cell, metres.
pub const CELL_EDGE_MIN: f32 = 1.0;
/// Cells that a member takes at one time.
pub const CELLS_PER_MEMBER_MAX: usize = 256;
/// Scenes of one server.
pub const SCENES_MAX: usize = 256;
/// Members of one scene.
pub const MEMBERS_PER_SCENE_MAX: usize = 256;
/// Different dampings of one scene's bodies, each of which needs a table at both ends.
pub const DAMPINGS_MAX: usize = 64;
/// Kinematic bodies under one member's authority.
pub const AUTHORITY_BODIES_MAX: usize = 256;
/// Milliseconds of silence before an upstream's first watermark. Loss is then found in time for a refresh, and a body
/// with a few updates a second costs a watermark or two for each.
pub const UPSTREAM_WATERMARK_MS: u32 = 67;
/// Milliseconds that a body under authority moves on after a watermark of its upstream is overdue.
pub const UPSTREAM_GRACE_MS: u32 = 1_000;
/// Body indices that a member is granted when it joins.
pub const GRANT: u32 = 4_096;
/// Body indices that one `Reserve` may request.
pub const RESERVE_MAX: u32 = BODIES_MAX;
/// Body indices of one member, at most: tables by index are as long as the highest index with a body.
pub const GRANTED_MAX: u32 = GRANT + RESERVE_MAX;

/// Commands and advances that wait for an earlier advance, at most.
pub const PENDING_COMMANDS_MAX: usize = 65_536;
/// Control bytes beyond its newest snapshot that wait for a peer; beyond that the server closes the connection.
pub const CONTROL_WAITING_BYTES_MAX: usize = 12 << 20;
/// Index ranges of one member, at most.
pub const RANGES_PER_MEMBER_MAX: usize = 64;
/// Ticks that an `Advance` may lead ahead of the scene.
pub const ADVANCE_TICKS_MAX: u64 = 1_024;

/// Cost of all queries of one message: a body that a ray finds costs 1.
pub const QUERY_COST_MAX: u32 = 4_096;
/// Cost of a body that a shape cast finds.
pub const SHAPE_CAST_COST: u32 = 10;
/// Bodies that one query may find.
pub const HITS_MAX: u8 = 64;
/// Body events of one tick; more are counted only.
pub const EVENTS_PER_TICK_MAX: usize = 1_024;
/// Body events that a client keeps until their tick is complete.
pub const EVENTS_HELD_MAX: usize = 16_384;
/// Pairs in contact, and bodies in sensors, that a client knows; it counts those beyond as missed.
pub const STANDING_PAIRS_MAX: usize = 32_768;

/// Largest coordinate, metres: at 1e5 m an f32 still resolves 8 mm.
pub const COORDINATE_MAX: f32 = 1e5;
/// Largest linear velocity in a command, m/s.
pub const LINEAR_MAX: f32 = 1e3;
/// Largest angular velocity in a command, rad/s.
pub const ANGULAR_MAX: f32 = 100.0;
/// Largest gravity, m/s².
pub const GRAVITY_MAX: f32 = 1e3;
/// Largest force (N), torque (N·m), impulse (N·s) and torque impulse (N·m·s).
pub const FORCE_MAX: f32 = 1e9;
/// Smallest and largest extent of a shape, metres.
pub const EXTENT_MIN: f32 = 1e-3;
/// See [`EXTENT_MIN`].
pub const EXTENT_MAX: f32 = 1e4;
/// Fewest points of a hull.
pub const HULL_POINTS_MIN: usize = 4;
/// Most points of a hull: their count is a byte.
pub const HULL_POINTS_MAX: usize = 255;
/// Least thickness of a hull, as a share of its bounding radius: f32 cannot resolve the faces of a flatter one.
pub const HULL_FLATNESS: f32 = 1e-3;
/// Most posts of a height field: 512 by 512.
pub const POSTS_MAX: usize = 512 * 512;
/// Most points of a mesh.
pub const MESH_POINTS_MAX: usize = 65_536;
/// Most triangles of a mesh: an engine builds a tree of them in some 60 ms.
pub const TRIANGLES_MAX: usize = 65_536;
/// Most parts of a compound.
pub const PARTS_MAX: usize = 64;
/// Bytes of a compound's parts in memory: on the wire they take no more, and fit a long message.
pub const PARTS_BYTES_MAX: usize = 1_664 * 1024;
/// Bytes of all shapes of a scene in memory.
pub const SHAPE_BYTES_PER_SCENE_MAX: usize = 8 << 20;
/// Smallest and largest density, kg/m³.
pub const DENSITY_MIN: f32 = 1e-3;
/// See [`DENSITY_MIN`].
pub const DENSITY_MAX: f32 = 1e6;
/// Smallest and largest mass of a body that has its own, kg.
pub const MASS_MIN: f32 = 1e-3;
/// See [`MASS_MIN`].
pub const MASS_MAX: f32 = 1e6;
/// Smallest and largest moment of inertia of such a body for each kilogram, m²: the squares of the extents.
pub const GYRATION_MIN: f32 = 1e-6;
/// See [`GYRATION_MIN`].
pub const GYRATION_MAX: f32 = 1e8;
/// Largest moment of inertia that a dynamic body has from its shape and density, kg·m²: at [`ANGULAR_MAX`] the square
/// of its angular momentum is a four-hundredth of the largest f32.
pub const MOMENT_MAX: f32 = 9_007_199_254_740_992.0;
/// Bodies of a scene that are swept against moving ones.
pub const SWEPT_BODIES_MAX: usize = 64;
/// Characters of a scene.
pub const CHARACTERS_MAX: usize = 256;
/// Vehicles of a scene.
pub const VEHICLES_MAX: usize = 256;
/// Wheels of a vehicle.
pub const WHEELS_MAX: usize = 16;
/// Joints of a scene beside [`JOINTS_PER_BODY`] for each body.
pub const JOINTS_BESIDE: usize = 64;
/// See [`JOINTS_BESIDE`].
pub const JOINTS_PER_BODY: usize = 4;
/// Largest stiffness and damping of a joint's motor or spring: 1/s² and 1/s, or N/m and N·s/m.
pub const STIFFNESS_MAX: f32 = 1e6;
/// Largest friction coefficient.
pub const FRICTION_MAX: f32 = 1e2;
/// Largest damping, 1/s.
pub const DAMPING_MAX: f32 = 1e3;
/// Largest gravity scale of a body.
pub const GRAVITY_SCALE_MAX: f32 = 1e2;
/// Largest speed at which a body may count as still, m/s.
pub const SLEEP_SPEED_MAX: f32 = 1e2;
/// Longest stillness before sleep, seconds.
pub const SLEEP_SECONDS_MAX: f32 = 1e3;
/// Most substeps of one tick.
pub const SUBSTEPS_MAX: u32 = 16;
/// Fastest tick, per second.
pub const RATE_MAX: u32 = 1_000;
/// Slowest tick, seconds.
pub const STEP_SECONDS_MAX: u32 = 1;
/// Greatest time between published ticks, seconds, unless every tick is published.
pub const PUBLISH_SECONDS_MAX: u32 = 1;
/// Greatest lookahead of a publisher, ticks.
pub const LOOKAHEAD_TICKS_MAX: u32 = 6;

/// Largest tick, packet number and count of scene events: nine thousand years at 1,000 a second.
pub const COUNT_MAX: u64 = 1 << 48;

/// Packets of a stream whose bodies the publisher keeps, so that it can refresh them.
pub const HISTORY_PACKETS: usize = 1_024;
/// Lost packets that one `LossReport` may name.
pub const LOST_NUMBERS_MAX: usize = 64;
/// Parts of one refresh.
pub const REFRESH_PARTS_MAX: u8 = 64;
/// The most consecutive packet numbers that a repair symbol covers; both ends keep this many packets for it.
pub const FEC_SPAN: u32 = 32;
/// Repair symbols of different coefficients: half of the elements of their field.
pub const FEC_ROWS: u8 = 128;
/// Repair symbols that a subscriber keeps until it can decode.
pub const REPAIR_SYMBOLS_KEPT: usize = 16;
/// Packets that a subscriber holds back while scene events are in transit.
pub const WAITING_DATAGRAMS_MAX: usize = 512;
/// Milliseconds after which a silent free-running stream must send a watermark. QUIC acknowledges each watermark, and
/// both together must stay below 60 bytes a second with all headers (measured: 126 bytes a watermark).
pub const SILENCE_MS_MAX: u32 = 2_500;
/// Greatest lead of a packet over the newest received tick, a minute at 60 Hz; beyond it the stream starts anew.
pub const TICK_JUMP_MAX: u64 = 3_600;

// A body's index fits the bits of a gap code, and every message fits its own length.
const _: () = assert!(BODIES_MAX <= INDICES_MAX && INDICES_MAX <= 1 << 24);
const _: () = assert!(
    SCENE_NAME_BYTES_MAX + 4 * VERSIONS_MAX + EXTENSIONS_MAX * (EXTENSION_BYTES_MAX + 7) + 256
        < MESSAGE_BYTES_MAX
);
const _: () = assert!(HULL_POINTS_MAX * 12 + 64 < MESSAGE_BYTES_MAX);
// A point index takes at most three bytes, a post four. Each shape fits a message in pieces, with its ids.
const _: () = assert!(MESH_POINTS_MAX * 12 + TRIANGLES_MAX * 9 + 64 < LONG_MESSAGE_BYTES_MAX);
const _: () = assert!(POSTS_MAX * 4 + 64 < LONG_MESSAGE_BYTES_MAX);
const _: () = assert!(MESH_POINTS_MAX * 12 + TRIANGLES_MAX * 12 < PARTS_BYTES_MAX);
const _: () = assert!(PARTS_BYTES_MAX + PARTS_MAX * 64 < LONG_MESSAGE_BYTES_MAX);
// A 16-bit packet number is unambiguous as long as the packet is kept.
const _: () = assert!(HISTORY_PACKETS < 1 << 15);
const _: () = assert!(TICK_JUMP_MAX < 1 << 15);
// All packets of a repair symbol have different coefficients, and the mask of covered packets fits its bits.
const _: () = assert!(FEC_SPAN <= FEC_ROWS as u32 && FEC_SPAN <= 32);
// Queries and events fit a message: a query takes at most 75 bytes, a found body 36, an event 45.
const _: () = assert!(QUERY_COST_MAX as usize * 75 + 16 < LONG_MESSAGE_BYTES_MAX);
const _: () = assert!(EVENTS_PER_TICK_MAX * 45 + 32 < LONG_MESSAGE_BYTES_MAX);
