//! News beside motion that a member by cells receives.
//!
//! Joints, silence, restoration, sessions, denials. A member of the whole scene acts, and another one takes cells. Raw peers
//! ask what no session would.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{CELLS_PER_MEMBER_MAX, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{
    CellNews, CellRequest, ClientMessage, Denial, ResyncCause, ServerMessage, SessionKey,
    StreamChoice,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Cell, CellGrid, Command, Joint, JointFrame, JointId, JointKind,
    SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::{CloseCode, Event};
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tolerance};
use rhumb_scene::SceneSettings;
use rhumb_scene::engine::Engines;
use rhumb_tests::{FailingEngine, Fails, RawPeer, TICK, Table, failing_body};
use rhumb_view::{LiveView, RenderTime, ViewOptions};

pub(super) const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
pub(super) const BALL: ShapeId = ShapeId(0);
/// Two cells side by side, and one that is never taken.
pub(super) const HERE: Cell = Cell([0, 0, 0]);
pub(super) const BESIDE: Cell = Cell([1, 0, 0]);
pub(super) const AWAY: f32 = 95.0;

/// A scene of cells of ten metres, its owner, and a member that takes two cells.
pub(super) struct Divided {
    pub(super) table: Table,
    pub(super) owner: Peer,
    pub(super) member: Peer,
}

impl Divided {
    pub(super) fn new(stepping: Stepping, engines: Engines) -> Self {
        let config = SceneConfig {
            stepping,
            gravity: Vec3::ZERO,
            ..SceneConfig::default()
        };
        let mut table = Table::with(SceneSettings {
            cells: CellGrid::columns(Metres::new(10.0)),
            engines,
            ..SceneSettings::new(|| Instant::ZERO)
        });
        let owner = table.create("divided", config, NORMAL);
        let member = table.connect("divided");
        let mut divided = Self {
            table,
            owner,
            member,
        };
        let shape = Shape::ball(0.5);
        divided.command(Command::AddShape { id: BALL, shape });
        for (index, x) in [2.0, 5.0, 15.0].into_iter().enumerate() {
            divided.add(index as u32, BodyKind::Dynamic, x);
        }
        divided
    }

    /// The member joins, and takes both cells.
    pub(super) fn enter(&mut self, key: Option<SessionKey>) {
        let session = self.table.session(self.member);
        if let Some(key) = key {
            session.begin_session(key).expect("in the lobby");
        }
        session.join_cells().expect("in the lobby");
        session.join(NORMAL).expect("in the lobby");
        self.table.run_until_idle();
        let wanted = BTreeMap::from([(HERE, NORMAL), (BESIDE, NORMAL)]);
        let session = self.table.session(self.member);
        session.take_cells(&wanted).expect("a member by cells");
        self.step();
        self.step();
    }

    pub(super) fn command(&mut self, command: Command) {
        let session = self.table.session(self.owner);
        session.command(command).expect("a member");
        self.table.run_until_idle();
    }

    fn add(&mut self, index: u32, kind: BodyKind, x: f32) {
        let desc = BodyDesc::plain(body(index), kind, BALL);
        let motion = still(x);
        self.command(Command::AddBody { desc, motion });
    }

    pub(super) fn put(&mut self, index: u32, x: f32) {
        self.command(Command::SetPose {
            id: body(index),
            position: Vec3::new(x, 1.0, 5.0),
            rotation: Quat::IDENTITY,
        });
    }

    /// Lets a tick pass.
    pub(super) fn step(&mut self) {
        let copy = self.table.session(self.owner).replica();
        let next = copy.expect("a member").stream().complete().next();
        let now = self.table.now();
        let owner = self.table.session(self.owner);
        if owner.config().expect("a scene").stepping == Stepping::Lockstep {
            owner.advance(now, next).expect("a member");
        }
        self.table.run_until_idle();
        self.table.pass(TICK);
    }

    /// The bodies of each cell that the member takes, by index in the scene.
    pub(super) fn bodies(&mut self) -> BTreeMap<Cell, Vec<u32>> {
        let cells = self.table.session(self.member).cells();
        let named = cells.map(|(cell, copy)| {
            let names = copy.bodies().map(|desc| copy.id_in_scene(desc.id));
            let mut names: Vec<_> = names.map(|id| id.expect("it has a name").index()).collect();
            names.sort_unstable();
            (cell, names)
        });
        named.collect()
    }

    /// The bodies that a member of the whole scene has in each cell.
    pub(super) fn true_bodies(&mut self) -> BTreeMap<Cell, Vec<u32>> {
        let copy = self.table.session(self.owner).replica();
        let copy = copy.expect("a member");
        let mut bodies = cells([], []);
        for desc in copy.bodies() {
            let motion = (copy.stream()).predicted_motion(desc.id, copy.stream().complete());
            let x = motion.expect("it has the body").pose().position.x;
            let cell = match x {
                ..10.0 => HERE,
                10.0..20.0 => BESIDE,
                _ => continue,
            };
            bodies.entry(cell).or_default().push(desc.id.index());
        }
        bodies
    }

    /// Where the member has a body of its cells.
    pub(super) fn shown_by_member(&mut self, index: u32) -> f32 {
        let mut cells = self.table.session(self.member).cells();
        let place = cells.find_map(|(_, copy)| {
            let stream = copy.stream();
            let named = |desc: &BodyDesc| copy.id_in_scene(desc.id) == Some(body(index));
            let local = copy.bodies().find(named)?.id;
            stream.predicted_motion(local, stream.complete())
        });
        place.expect("it has the body").pose().position.x as f32
    }

    /// The joints that each cell tells, with the indices of their bodies in the scene.
    fn joints(&mut self) -> Vec<(Cell, JointId, [u32; 2])> {
        let cells = self.table.session(self.member).cells();
        let joints = cells.flat_map(|(cell, copy)| {
            let name = |id| copy.id_in_scene(id).expect("it has a name").index();
            let joints = copy.joints().iter();
            joints.map(move |(id, joint)| (cell, id, joint.bodies.map(name)))
        });
        joints.collect()
    }

    fn bound(&mut self, index: u32) -> ErrorBound {
        let mut cells = self.table.session(self.member).cells();
        let bound = cells.find_map(|(_, copy)| {
            let named = |desc: &BodyDesc| copy.id_in_scene(desc.id) == Some(body(index));
            let local = copy.bodies().find(named)?.id;
            copy.stream().bound(local)
        });
        bound.expect("a body of a cell")
    }
}

pub(super) fn body(index: u32) -> BodyId {
    BodyId::new(index, 0)
}

pub(super) fn still(x: f32) -> BodyState {
    let state = BodyState::new([x, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    state.expect("finite")
}

pub(super) fn cells<const N: usize, const M: usize>(
    here: [u32; N],
    beside: [u32; M],
) -> BTreeMap<Cell, Vec<u32>> {
    BTreeMap::from([(HERE, here.to_vec()), (BESIDE, beside.to_vec())])
}

#[test]
fn a_cell_that_has_both_bodies_of_a_joint_has_the_joint() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    let rope = JointKind::Rope(200.0);
    let frames = [JointFrame::at(Vec3::ZERO); 2];
    let joint = |bodies: [u32; 2]| Box::new(Joint::plain(rope, bodies.map(body), frames));
    let (inside, across) = (JointId(1), JointId(2));
    divided.command(Command::AddJoint {
        id: inside,
        joint: joint([0, 1]),
    });
    divided.enter(None);
    assert_eq!(divided.bodies(), cells([0, 1], [2]));
    assert_eq!(
        divided.joints(),
        [(HERE, inside, [0, 1])],
        "from the snapshot"
    );
    divided.command(Command::AddJoint {
        id: across,
        joint: joint([1, 2]),
    });
    divided.step();
    assert_eq!(divided.joints(), [(HERE, inside, [0, 1])]);
    // One of them crosses: it leaves one joint behind, and comes to another.
    divided.put(1, 15.0);
    divided.step();
    divided.step();
    assert_eq!(divided.bodies(), cells([0], [1, 2]));
    assert_eq!(divided.joints(), [(BESIDE, across, [1, 2])]);
    // Both of a joint cross at one tick.
    divided.put(0, 12.0);
    divided.step();
    divided.put(0, 3.0);
    divided.put(1, 4.0);
    divided.step();
    divided.step();
    assert_eq!(divided.joints(), [(HERE, inside, [0, 1])]);
    divided.command(Command::RemoveJoint { id: inside });
    divided.step();
    assert_eq!(divided.joints(), []);
    assert_eq!(divided.table.closed(divided.member), None);
}

#[test]
fn a_body_that_leaves_the_cells_is_not_removed_and_one_that_is_removed_says_so() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    divided.enter(None);
    let session = divided.table.session(divided.member);
    while session.poll_event().is_some() {}
    divided.put(0, AWAY);
    divided.step();
    divided.step();
    assert_eq!(divided.bodies(), cells([1], [2]));
    divided.command(Command::RemoveBody { id: body(0) });
    divided.command(Command::RemoveBody { id: body(2) });
    divided.step();
    assert_eq!(divided.bodies(), cells([1], []));
    let session = divided.table.session(divided.member);
    let events = std::iter::from_fn(|| session.poll_event());
    let removed: Vec<_> = events
        .filter_map(|event| match event {
            Event::BodyRemoved { id, .. } => Some(id),
            _ => None,
        })
        .collect();
    assert_eq!(removed, [body(2)]);
}

#[test]
fn cells_show_a_restored_scene() {
    let mut divided = Divided::new(Stepping::Lockstep, FailingEngine::engines());
    divided.enter(None);
    for _ in 0..20 {
        divided.step();
    }
    // Of the commands of one tick only the culprit is undone.
    let desc = failing_body(body(7), BALL, Fails::Step(1));
    let motion = still(17.0);
    divided.command(Command::AddBody { desc, motion });
    divided.put(0, 16.0);
    for _ in 0..3 {
        divided.step();
    }
    let session = divided.table.session(divided.member);
    let events: Vec<_> = std::iter::from_fn(|| session.poll_event()).collect();
    let is_restored = |event: &Event| matches!(event, Event::SceneRestored(_));
    assert!(events.iter().any(is_restored), "{events:?}");
    assert_eq!(divided.bodies(), cells([1], [0, 2]));
    assert_eq!(divided.bodies(), divided.true_bodies());
    assert_eq!(divided.table.closed(divided.member), None);
}

#[test]
fn a_resumed_session_takes_its_cells_again() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    divided.enter(Some(SessionKey([7; 16])));
    divided.table.end_connection(divided.member);
    divided.put(2, AWAY);
    divided.step();
    divided.member = divided.table.reconnect(divided.member);
    divided.step();
    divided.step();
    assert_eq!(divided.bodies(), cells([0, 1], []));
    divided.put(2, 15.0);
    divided.step();
    divided.step();
    assert_eq!(divided.bodies(), cells([0, 1], [2]));
}

#[test]
fn a_resumed_session_shows_its_cells_as_they_were_until_their_snapshots_come() {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    divided.enter(Some(SessionKey([7; 16])));
    let options = ViewOptions {
        delay_ticks: 0.0,
        whole_ticks: false,
        smooth: true,
    };
    let mut live = LiveView::new(SceneConfig::default(), options);
    let mut shown = |divided: &mut Divided| {
        let now = divided.table.now();
        let member = divided.table.session(divided.member);
        if let Some(copy) = member.replica() {
            let at = RenderTime::at(copy.stream().complete());
            live.show(member, now, at, false);
        }
        let ids = live.view().ids().iter();
        let mut bodies: Vec<_> = ids
            .map(|id| (id.index(), live.cell_of(*id).expect("of a cell")))
            .collect();
        bodies.sort_unstable();
        let known = |index| live.error_bound(member, body(index));
        (bodies, known(0).expect("it is shown"))
    };
    let before = [(0, HERE), (1, HERE), (2, BESIDE)];
    let (bodies, bound) = shown(&mut divided);
    assert_eq!(bodies, before);
    assert!(matches!(bound, ErrorBound::Within(_)), "{bound}");
    divided.table.end_connection(divided.member);
    divided.member = divided.table.reconnect_until(divided.member, |session| {
        session.replica().is_some() && session.cells().next().is_none()
    });
    let (bodies, bound) = shown(&mut divided);
    assert_eq!(bodies, before);
    assert!(matches!(bound, ErrorBound::Unknown { .. }), "{bound}");
    divided.table.run_until_idle();
    divided.put(1, AWAY);
    divided.step();
    divided.step();
    let (bodies, bound) = shown(&mut divided);
    assert_eq!(bodies, [(0, HERE), (2, BESIDE)]);
    assert!(matches!(bound, ErrorBound::Within(_)), "{bound}");
}

#[test]
fn cells_learn_of_a_silent_publisher_whose_body_crosses() {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    divided.add(9, BodyKind::Kinematic, 8.0);
    divided.enter(None);
    let id = body(9);
    let owner = divided.table.session(divided.owner);
    owner
        .take_authority(Tolerance::NORMAL, &[id])
        .expect("a member");
    divided.step();
    for step in 0..60_u16 {
        let owner = divided.table.session(divided.owner);
        let tick = owner
            .replica()
            .expect("a member")
            .stream()
            .complete()
            .next();
        let at = still(8.0 + f32::from(step.min(40)) / 10.0);
        owner.publish(tick, &[(id, at)]).expect("its body");
        divided.step();
    }
    assert_eq!(divided.bodies(), cells([0, 1], [2, 9]));
    assert!(matches!(divided.bound(9), ErrorBound::Within(_)));
    divided.table.pass(Span::from_millis(3_000));
    assert!(matches!(divided.bound(9), ErrorBound::Unknown { .. }));
    // A cell that is taken meanwhile says it in its snapshot.
    let wanted = BTreeMap::from([(HERE, NORMAL)]);
    let member = divided.table.session(divided.member);
    member.take_cells(&wanted).expect("a member by cells");
    divided.step();
    let wanted = BTreeMap::from([(HERE, NORMAL), (BESIDE, NORMAL)]);
    let member = divided.table.session(divided.member);
    member.take_cells(&wanted).expect("a member by cells");
    divided.table.pass(Span::from_millis(100));
    assert!(matches!(divided.bound(9), ErrorBound::Unknown { .. }));
}

/// A tolerance in millimetres.
pub(super) fn within(millimetres: u32) -> StreamChoice {
    let metres = Metres::new(f64::from(millimetres) / 1_000.0);
    StreamChoice::Within(Tolerance::from_metres(metres).expect("within the limits"))
}

/// A raw member by cells of the scene.
fn raw(table: &mut Table) -> RawPeer {
    RawPeer::enter_by_cells(table, "divided")
}

fn ask(
    raw: &mut RawPeer,
    table: &mut Table,
    requests: &[(Cell, CellRequest)],
) -> Vec<(Cell, CellNews)> {
    let mut bytes = Vec::new();
    for (cell, request) in requests {
        let (cell, request) = (*cell, *request);
        ClientMessage::OfCell { cell, request }.encode(&mut bytes);
    }
    let answers = raw.send_bytes(table, &bytes).into_iter();
    let news = answers.filter_map(|message| match message {
        ServerMessage::OfCell { cell, news } => Some((cell, news)),
        _ => None,
    });
    news.collect()
}

fn denials(news: &[(Cell, CellNews)]) -> Vec<Denial> {
    let denied = news.iter().filter_map(|(_, news)| match news {
        CellNews::Denied(denial) => Some(*denial),
        _ => None,
    });
    denied.collect()
}

fn snapshots(news: &[(Cell, CellNews)]) -> usize {
    let ends = news
        .iter()
        .filter(|(_, news)| *news == CellNews::SnapshotEnd);
    ends.count()
}

#[test]
fn many_requests_for_a_cell_in_one_read_get_one_snapshot() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    let mut raw = raw(&mut divided.table);
    let take = (HERE, CellRequest::Subscribe(NORMAL));
    let again = (HERE, CellRequest::Resync(ResyncCause::ChecksumMismatch));
    let requests = [[take, again]; 200].concat();
    let news = ask(&mut raw, &mut divided.table, &requests);
    assert_eq!(snapshots(&news), 1);
    // The link says what it takes: the next snapshot waits for its time.
    divided.table.pace(raw.peer);
    divided.table.pass(Span::from_millis(1_000));
    let first = ask(&mut raw, &mut divided.table, &[again]);
    let next = ask(&mut raw, &mut divided.table, &[again]);
    assert_eq!([snapshots(&first), snapshots(&next)], [1, 0]);
    divided.table.pass(Span::from_millis(1_000));
    assert_eq!(snapshots(&ask(&mut raw, &mut divided.table, &[])), 1);
    let gone = [take, (HERE, CellRequest::Leave), again];
    assert_eq!(ask(&mut raw, &mut divided.table, &gone), []);
}

/// A hundred ticks of a free-running scene in which a member floods it: the snapshots of cells that each tick had for it, and
/// the ticks after which a member that asks once had its answer.
fn flooded(flood: &[Vec<(Cell, CellRequest)>]) -> (Vec<usize>, usize) {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    let table = &mut divided.table;
    let (mut flooding, mut other) = (raw(table), raw(table));
    table.pace(flooding.peer);
    table.pace(other.peer);
    let first = tick_of(&mut other, table);
    let mut in_tick = Vec::new();
    let mut waited = 0;
    for tick in 0..100 {
        let mut count = 0;
        for requests in flood.iter().cycle().take(8) {
            count += snapshots(&ask(&mut flooding, table, requests));
            table.pass(Span::from_nanos(TICK.as_nanos() / 8));
        }
        in_tick.push(count);
        if tick >= 50 && waited == 0 {
            let take = (HERE, CellRequest::Subscribe(NORMAL));
            let asked = if tick == 50 { &[take][..] } else { &[] };
            let news = ask(&mut other, table, asked);
            waited = if news.is_empty() { 0 } else { tick - 49 };
        }
    }
    let ticks = tick_of(&mut other, table) - first;
    assert!(ticks >= 99, "{ticks}");
    (in_tick, waited)
}

/// The tick of the scene of a member.
fn tick_of(raw: &mut RawPeer, table: &mut Table) -> u64 {
    let answers = raw.send(table, &ClientMessage::Inspect).into_iter();
    let mut ticks = answers.filter_map(|message| match message {
        ServerMessage::Inspection(inspection) => Some(inspection.tick.value()),
        _ => None,
    });
    ticks.next().expect("an answer")
}

#[test]
fn a_member_that_floods_a_scene_with_requests_about_cells_pays_by_waiting() {
    let cells = (0..CELLS_PER_MEMBER_MAX as i32).map(|x| Cell([x, 0, -7]));
    let of_all = |request: CellRequest| cells.clone().map(|cell| (cell, request)).collect();
    let take: Vec<_> = of_all(CellRequest::Subscribe(NORMAL));
    let leave: Vec<_> = of_all(CellRequest::Leave);
    let again: Vec<_> = of_all(CellRequest::Resync(ResyncCause::LostSync));
    let other: Vec<_> = of_all(CellRequest::Subscribe(StreamChoice::Full));
    let floods = [
        vec![take.clone(), leave],
        vec![take.clone(), again.clone(), again.clone(), again],
        vec![take, other],
    ];
    for flood in floods {
        let (in_tick, waited) = flooded(&flood);
        let most = in_tick.iter().max().expect("ticks");
        assert!(*most <= 48, "{in_tick:?}");
        let all: usize = in_tick.iter().sum();
        assert!((100..=2_000).contains(&all), "{in_tick:?}");
        assert_eq!(waited, 1, "of another member");
    }
}

#[test]
fn a_member_that_comes_by_cells_again_and_again_pays_for_the_bodies() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    for index in 10..2_010 {
        let desc = BodyDesc::plain(body(index), BodyKind::Kinematic, BALL);
        let motion = still(5.0);
        let owner = divided.table.session(divided.owner);
        let added = owner.command(Command::AddBody { desc, motion });
        added.expect("a member");
    }
    divided.table.run_until_idle();
    let mut raw = raw(&mut divided.table);
    divided.table.pace(raw.peer);
    divided.table.pass(Span::from_millis(1_000));
    let again = [
        ClientMessage::Leave,
        ClientMessage::JoinCells,
        ClientMessage::Join(NORMAL),
    ];
    let mut bytes = Vec::new();
    for message in again.iter().cycle().take(8 * again.len()) {
        message.encode(&mut bytes);
    }
    let answers = raw.send_bytes(&mut divided.table, &bytes);
    let joined = answers
        .iter()
        .filter(|answer| matches!(answer, ServerMessage::Joined(_)));
    assert_eq!(joined.count(), 1, "the next one waits");
}

#[test]
fn a_cell_off_an_axis_that_is_not_divided_is_denied() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    let mut raw = raw(&mut divided.table);
    let take = (Cell([0, 1, 0]), CellRequest::Subscribe(NORMAL));
    let news = ask(&mut raw, &mut divided.table, &[take]);
    assert_eq!(
        (denials(&news), snapshots(&news)),
        (vec![Denial::NoSuchScene], 0)
    );
}

#[test]
fn a_member_takes_so_many_cells_and_a_cell_has_so_many_streams() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    let table = &mut divided.table;
    let mut many = raw(table);
    let requests: Vec<_> = (0..=CELLS_PER_MEMBER_MAX as i32)
        .map(|x| (Cell([x, 0, -7]), CellRequest::Subscribe(NORMAL)))
        .collect();
    let news = ask(&mut many, table, &requests);
    assert_eq!(denials(&news), [Denial::TooManyStreams]);
    assert_eq!(snapshots(&news), CELLS_PER_MEMBER_MAX);
    let instead = [
        (Cell([3, 0, -7]), CellRequest::Leave),
        requests[CELLS_PER_MEMBER_MAX],
    ];
    let news = ask(&mut many, table, &instead);
    assert_eq!((denials(&news), snapshots(&news)), (vec![], 1));
    let mut members: Vec<_> = (0..=STREAMS_PER_SCENE_MAX).map(|_| raw(table)).collect();
    let answers: Vec<_> = (members.iter_mut().zip(2..))
        .map(|(member, millimetres)| {
            let request = CellRequest::Subscribe(within(millimetres));
            denials(&ask(member, table, &[(HERE, request)]))
        })
        .collect();
    let (last, others) = answers.split_last().expect("some");
    assert!(others.iter().all(Vec::is_empty), "{answers:?}");
    assert_eq!(*last, [Denial::TooManyStreams]);
}

#[test]
fn requests_about_cells_are_those_of_members_by_cells() {
    let mut divided = Divided::new(Stepping::Lockstep, Engines::default());
    let table = &mut divided.table;
    let take = (HERE, CellRequest::Subscribe(NORMAL));
    let mut whole = RawPeer::enter(table, "divided");
    assert_eq!(
        denials(&ask(&mut whole, table, &[take])),
        [Denial::NoSuchScene]
    );
    let others = [
        CellRequest::Leave,
        CellRequest::Subscribed(StreamId(3)),
        CellRequest::Resync(ResyncCause::LostSync),
    ];
    let others = others.map(|request| (HERE, request));
    assert_eq!(ask(&mut whole, table, &others), []);
    let mut member = raw(table);
    assert_eq!(ask(&mut member, table, &others), []);
    member.send(table, &ClientMessage::JoinCells);
    assert_eq!(member.closed(table), Some(CloseCode::VIOLATION));
    // Before a welcome no client is in the lobby.
    let peer = table.connect_raw_peer();
    let mut bytes = Vec::new();
    ClientMessage::JoinCells.encode(&mut bytes);
    table.control(peer, &bytes);
    assert_eq!(table.closed(peer), Some(CloseCode::VIOLATION));
}
