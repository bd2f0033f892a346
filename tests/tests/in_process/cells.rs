//! Members that take a scene by cells.
//!
//! The truth is a member of the whole scene with exact states over a perfect link. At every tick that the copies are
//! complete up to, each taken cell has exactly the bodies that the truth has there, each within its tolerance.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rhumb_netsim::{Direction, Lane, LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, Cell, CellGrid, Command, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::{ClientSession, Event, Misuse};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Metres, Tick, Ticks, Tolerance};
use rhumb_scene::{SceneRouter, SceneSettings};
use rhumb_tests::{Dice, TICK, seed};
use rhumb_view::{LiveView, RenderTime, ViewOptions};

const EDGE: f64 = 10.0;
/// Cells along the way.
const CELLS: u32 = 100;
const BODIES: u32 = 400;
const NEAR: f64 = 0.01;
const FAR: f64 = 0.2;
/// Delay, disorder, and one datagram of twenty lost.
const LOSSY: &str = "delay=40ms,jitter=8ms,loss=5%";

fn within(metres: f64) -> StreamChoice {
    StreamChoice::Within(Tolerance::from_metres(Metres::new(metres)).expect("within the limits"))
}

fn grid() -> CellGrid {
    CellGrid::columns(Metres::new(EDGE)).expect("an edge within the limits")
}

/// The commands that fill a long corridor: two walls, too large for a cell, and balls that fly between them.
fn corridor(dice: &mut Dice) -> Vec<Command> {
    let length = EDGE as f32 * CELLS as f32;
    let wall = Shape::cuboid(length / 2.0 + 50.0, 5.0, 0.5);
    let shapes = [wall, Shape::ball(0.3)];
    let mut commands = Vec::new();
    for (id, shape) in (0..).map(ShapeId).zip(shapes.clone()) {
        commands.push(Command::AddShape { id, shape });
    }
    let mut add = |index, body: rhumb_protocol::scene::BodyBuilder, shape| {
        let desc = body.desc(BodyId::new(index, 0), ShapeId(shape));
        let motion = body.state().expect("finite");
        commands.push(Command::AddBody { desc, motion });
    };
    for (index, z) in [(0, -15.5), (1, 15.5)] {
        add(
            index,
            BodyDesc::fixed(shapes[0].clone()).at(length / 2.0, 0.0, z),
            0,
        );
    }
    let mut signed = || dice.below(20_001) as f32 / 10_000.0 - 1.0;
    for index in 2..BODIES {
        let x = (signed() + 1.0) * length / 2.0;
        let ball = BodyDesc::dynamic(shapes[1].clone()).at(x, signed(), signed() * 14.0);
        let ball = ball.linear_velocity(Vec3::new(signed(), 0.1 * signed(), signed()) * 8.0);
        add(index, ball, 1);
    }
    commands
}

fn live_view(stepping: Stepping) -> LiveView {
    let options = ViewOptions {
        delay_ticks: 240.0,
        whole_ticks: false,
        smooth: false,
    };
    let config = SceneConfig {
        stepping,
        ..SceneConfig::default()
    };
    LiveView::new(config, options)
}

/// Indices of the clients.
const TRUTH: usize = 0;
const WALKER: usize = 1;

/// The picture of a member of cells, beside the truth.
struct CellStage {
    network: SimNetwork<SceneRouter, ClientSession>,
    /// Positions at each tick.
    truth: BTreeMap<Tick, BTreeMap<BodyId, Vec3>>,
    /// The tick at which the member joined.
    joined: Option<Tick>,
    homes: BTreeMap<Tick, BTreeMap<BodyId, Cell>>,
    live: LiveView,
    /// The tick from which on a cell is compared.
    since: BTreeMap<Cell, Tick>,
    compared: u64,
    /// True if the member asks for the watermarks of its cells.
    asks: bool,
    last: Option<Tick>,
    worst: f64,
    events: Vec<Event>,
}

impl CellStage {
    fn new(stepping: Stepping, links: LinkConfig, seed: u64) -> Self {
        let settings = SceneSettings {
            cells: Some(grid()),
            ..SceneSettings::new(|| Instant::ZERO)
        };
        let mut stage = Self {
            network: SimNetwork::new(SceneRouter::new(settings), LinkConfig::PERFECT, seed),
            truth: BTreeMap::new(),
            joined: None,
            homes: BTreeMap::new(),
            live: live_view(stepping),
            since: BTreeMap::new(),
            compared: 0,
            asks: false,
            last: None,
            worst: 0.0,
            events: Vec::new(),
        };
        let config = SceneConfig {
            stepping,
            gravity: Vec3::ZERO,
            ..SceneConfig::default()
        };
        let create = |client: &mut ClientSession| client.create(config);
        stage.enter(StreamChoice::Full, create);
        for command in corridor(&mut Dice::new(seed)) {
            let sent = stage.network.client_mut(TRUTH).command(command);
            sent.expect("a valid command");
        }
        stage.run();
        stage.enter(within(FAR), ClientSession::join_cells);
        for direction in [Direction::Up, Direction::Down] {
            stage.network.set_config_of(WALKER, direction, links);
        }
        stage
    }

    fn enter<T>(
        &mut self,
        choice: StreamChoice,
        before: impl FnOnce(&mut ClientSession) -> Result<T, Misuse>,
    ) {
        let name = "corridor".parse().expect("a valid name");
        let index = self.network.connect(ClientSession::new(name));
        self.run();
        before(self.network.client_mut(index)).expect("a client in the lobby");
        let newest = self.truth.last_key_value().map(|(tick, _)| *tick);
        self.joined = self.joined.or(newest);
        let client = self.network.client_mut(index);
        client.join(choice).expect("a client in the lobby");
        self.run();
        assert!(self.network.client(index).replica().is_some());
    }

    /// Lets two milliseconds pass, and compares.
    fn run(&mut self) {
        let next = self.network.now() + Span::from_millis(2);
        self.network.run_until(next);
        self.note_truth();
        if self.network.clients() > WALKER {
            let now = self.network.now();
            if self.asks {
                // Cells where nothing happens say so seldom.
                self.network.client_mut(WALKER).query_watermark(now, TICK);
            }
            while let Some(event) = self.network.client_mut(WALKER).poll_event() {
                self.events.push(event);
            }
            self.compare();
        }
    }

    fn run_for(&mut self, span: Span) {
        let end = self.network.now() + span;
        while self.network.now() < end {
            self.run();
        }
    }

    fn note_truth(&mut self) {
        let Some(copy) = self.network.client(TRUTH).replica() else {
            return;
        };
        let (stream, tick) = (copy.stream(), copy.stream().complete());
        // Bodies are added at tick 0.
        if tick > Tick::ZERO && self.truth.contains_key(&tick) {
            return;
        }
        let position = |id| {
            Some((
                id,
                stream.predicted_motion(id, tick)?.pose().position.as_vec3(),
            ))
        };
        let bodies = copy.bodies().filter(|body| body.id.index() >= 2);
        let positions: BTreeMap<_, _> = bodies.filter_map(|body| position(body.id)).collect();
        self.truth.insert(tick, positions);
    }

    /// The cell of each body up to a tick, as the rules have it. The server gives bodies their cells when the first member
    /// takes the scene by cells.
    fn note_homes(&mut self, joined: Tick, until: Tick) {
        let last = self.homes.last_key_value();
        let mut before = last.map(|(_, homes)| homes.clone());
        let mut tick = last.map_or(joined, |(tick, _)| tick.next());
        while tick <= until {
            let home = |(id, at): (&BodyId, &Vec3)| {
                let before = before.as_ref().and_then(|before| before.get(id));
                let cell = before.map(|cell| grid().next_cell(*cell, *at));
                (*id, cell.unwrap_or_else(|| grid().cell_of(*at)))
            };
            let homes: BTreeMap<_, _> = self.truth[&tick].iter().map(home).collect();
            self.homes.insert(tick, homes.clone());
            before = Some(homes);
            tick = tick.next();
        }
    }

    /// Compares what the member shows at each tick that has become complete.
    fn compare(&mut self) {
        let client = self.network.client_mut(WALKER);
        let Some(complete) = client.complete() else {
            return;
        };
        let Some(joined) = self.joined else {
            return;
        };
        if self.last.is_some_and(|last| complete <= last) {
            return;
        }
        for (cell, copy) in client.cells_mut() {
            copy.stream_mut().set_history(Ticks::new(240));
            let since = copy.stream().start().max(complete);
            self.since.entry(cell).or_insert(since);
        }
        let cells: BTreeSet<Cell> = client.cells().map(|(cell, _)| cell).collect();
        self.since.retain(|cell, _| cells.contains(cell));
        self.note_homes(joined, complete);
        let mut tick = self.last.map_or(joined, Tick::next);
        while tick <= complete {
            self.compare_at(tick);
            tick = tick.next();
        }
        self.last = Some(complete);
    }

    fn compare_at(&mut self, tick: Tick) {
        let now = self.network.now();
        let client = self.network.client_mut(WALKER);
        self.live.show(client, now, RenderTime::at(tick), false);
        let (truth, homes) = (&self.truth[&tick], &self.homes[&tick]);
        let is_compared = |cell: &Cell| self.since.get(cell).is_some_and(|since| *since <= tick);
        let view = self.live.view();
        let in_cells: Vec<(BodyId, Cell)> = (view.ids().iter())
            .filter_map(|id| Some((*id, self.live.cell_of(*id)?)))
            .filter(|(_, cell)| is_compared(cell))
            .collect();
        let shown: BTreeMap<BodyId, Cell> = in_cells.iter().copied().collect();
        assert_eq!(shown.len(), in_cells.len(), "no body is double at {tick}");
        let expected: BTreeMap<BodyId, Cell> = (homes.iter())
            .filter(|(_, cell)| is_compared(cell))
            .map(|(id, cell)| (*id, *cell))
            .collect();
        assert_eq!(shown, expected, "at tick {tick}");
        let walls = view.ids().iter().filter(|id| id.index() < 2).count();
        assert_eq!(walls, 2, "every member has what is large");
        for (id, _) in expected {
            let error = view.position(id).expect("it is shown").distance(truth[&id]);
            let bound = self.live.error_bound(client, id).expect("it is shown");
            assert!(
                f64::from(error) <= bound.metres() + 1e-5,
                "{id} at {tick}: {error} beyond {bound}"
            );
            if bound.metres().is_finite() {
                self.worst = self.worst.max(f64::from(error));
            }
            self.compared += 1;
        }
    }

    fn take(&mut self, x: f64, bands: &[(Metres, StreamChoice)]) {
        let cells = grid().within(Vec3::new(x as f32, 0.0, 5.0), bands);
        let client = self.network.client_mut(WALKER);
        client
            .take_cells(&cells.expect("a place").expect("few cells"))
            .expect("a member by cells");
    }

    fn received(&self, client: usize) -> u64 {
        let bytes = |lane| {
            self.network
                .counts(client, Direction::Down, lane)
                .pushed
                .bytes
        };
        bytes(Lane::State) + bytes(Lane::Control)
    }
}

/// Near 1 cm, far 20 cm.
fn bands() -> [(Metres, StreamChoice); 2] {
    [
        (Metres::new(8.0), within(NEAR)),
        (Metres::new(25.0), within(FAR)),
    ]
}

#[test]
fn a_member_that_crosses_a_hundred_cells_has_each_body_once_at_every_tick() {
    let mut stage = CellStage::new(
        Stepping::FreeRunning,
        LOSSY.parse().expect("links"),
        seed(1),
    );
    stage.asks = true;
    let ticks = 1_000;
    for tick in 0..ticks {
        if tick % 10 == 0 {
            stage.take(
                f64::from(tick) * EDGE * f64::from(CELLS) / f64::from(ticks),
                &bands(),
            );
        }
        stage.run_for(TICK);
    }
    stage.run_for(Span::from_millis(3_000));
    let last = stage.last.map_or(0, Tick::value);
    assert!(last > u64::from(ticks as u32), "{last}");
    assert!(stage.compared > 5_000, "{} bodies", stage.compared);
    assert!(stage.worst > 0.0 && stage.worst <= FAR, "{}", stage.worst);
    let removed = |event: &Event| matches!(event, Event::BodyRemoved { .. });
    assert!(
        !stage.events.iter().any(removed),
        "no body has left the scene"
    );
}

#[test]
fn in_lockstep_a_body_crosses_at_one_tick() {
    let mut stage = CellStage::new(Stepping::Lockstep, LinkConfig::PERFECT, seed(1));
    stage.take(300.0, &bands());
    stage.run();
    for tick in 1..=300 {
        let now = stage.network.now();
        let client = stage.network.client_mut(WALKER);
        client.advance(now, Tick::new(tick)).expect("a member");
        stage.run();
        assert_eq!(
            stage.network.client(WALKER).complete(),
            Some(Tick::new(tick))
        );
    }
    assert_eq!(stage.last, Some(Tick::new(300)));
    assert!(stage.compared > 5_000, "{} bodies", stage.compared);
}

#[test]
fn a_member_of_few_cells_pays_for_them_alone() {
    let mut stage = CellStage::new(Stepping::FreeRunning, LinkConfig::PERFECT, seed(1));
    stage.enter(within(NEAR), |_| Ok(()));
    stage.take(505.0, &[(Metres::new(9.0), within(NEAR))]);
    stage.run_for(Span::from_millis(500));
    let cells = stage.network.client(WALKER).cells().count();
    assert_eq!(cells, 9);
    let before = [WALKER, 2].map(|client| stage.received(client));
    stage.run_for(Span::from_millis(10_000));
    let after = [WALKER, 2].map(|client| stage.received(client));
    let [few, whole] = [after[0] - before[0], after[1] - before[1]];
    // They have a body each, so that nearly all of it is watermarks and heads.
    assert!(few * 4 < whole, "{few} of {whole} bytes");
}

#[test]
fn a_scene_without_a_grid_is_whole_for_a_member_that_asks_for_cells() {
    let settings = SceneSettings::new(|| Instant::ZERO);
    let network = SimNetwork::new(SceneRouter::new(settings), LinkConfig::PERFECT, 1);
    let mut stage = CellStage {
        network,
        truth: BTreeMap::new(),
        joined: None,
        homes: BTreeMap::new(),
        live: live_view(Stepping::Lockstep),
        since: BTreeMap::new(),
        compared: 0,
        asks: false,
        last: None,
        worst: 0.0,
        events: Vec::new(),
    };
    let config = SceneConfig::default();
    stage.enter(within(NEAR), |client| {
        client.create(config)?;
        client.join_cells()
    });
    let client = stage.network.client_mut(TRUTH);
    assert_eq!(client.cell_grid(), None);
    let wanted = BTreeMap::from([(Cell::default(), within(NEAR))]);
    assert_eq!(client.take_cells(&wanted), Err(Misuse::NotDivided));
}
