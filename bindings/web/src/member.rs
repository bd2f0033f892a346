//! A member of a scene: bytes and moments in; bytes, JSON and columns out.
//!
//! Opens no socket and reads no clock. The session, the subscriber and the view are those of the Rust client.
//!
//! Columns are numbers that JavaScript reads in place. Invariant: after an update, each column has one entry per body of the
//! view, in its order. The words of a digest are those of `spec/vectors/README.md`.

use glam::{Quat, Vec3};
use rhumb_protocol::message::{SessionKey, StreamChoice, TierPolicy, Token};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{
    BodyBuilder, BodyKind, CellGrid, Command, IdRange, Invalid, Query, SceneName, Stepping,
};
use rhumb_protocol::session::{ClientSession, CloseCode, Event, Misuse, Replica};
use rhumb_protocol::stream::Subscriber;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};
use rhumb_view::{
    BodyCentres, ClientIds, JoinError, Joining, LiveView, RESUME_WITHIN, RefusedRequest,
    RenderTime, UpstreamClock, View, may_resume,
};
use serde_json::{Value, json};

use crate::argument::{Argument, Failure, id_number, object};
use crate::scene_argument::{CellArguments, JoinArguments, session_key};
use crate::scene_json;

/// The one peer of a client.
const SERVER: Peer = Peer(0);

/// Largest packet of an upstream. Browsers take datagrams of 1,024 bytes at least, header included.
const LARGEST_PACKET: Option<LargestPacket> = LargestPacket::new(1_000);

/// A member, or a session that is to become one.
#[derive(Debug)]
pub(crate) struct WebMember {
    session: ClientSession,
    options: JoinArguments,
    joining: Option<Joining>,
    joined: Option<Membership>,
    events: Vec<Value>,
    /// The latest moment of a call.
    latest: Instant,
}

/// The state of a member.
#[derive(Debug)]
struct Membership {
    live_view: LiveView,
    ids: ClientIds,
    upstream_clock: UpstreamClock,
    columns: Columns,
    /// The tick up to which a lockstep scene is to step.
    requested: Tick,
    /// The newest command before the last advance, until it is answered.
    unanswered: Option<u64>,
    /// The newest command that is answered.
    answered: Option<u64>,
}

impl WebMember {
    pub(crate) fn new(options: MemberOptions) -> Self {
        let MemberOptions {
            scene,
            token,
            key,
            join,
        } = options;
        let mut session = ClientSession::new(scene);
        if let Some(token) = token {
            session.set_token(token);
        }
        if let Some(largest_packet) = LARGEST_PACKET {
            session.set_largest_packet(largest_packet);
        }
        Self {
            session,
            joining: Some(match join.cells {
                true => Joining::new(join.mode, join.stream, key).by_cells(),
                false => Joining::new(join.mode, join.stream, key),
            }),
            options: join,
            joined: None,
            events: Vec::new(),
            latest: Instant::ZERO,
        }
    }

    pub(crate) fn handle_opened(&mut self, now: Instant) {
        self.session.handle_opened(now, SERVER);
        self.take_events();
    }

    pub(crate) fn handle_control(&mut self, now: Instant, bytes: &[u8]) {
        self.session.handle_control(now, SERVER, bytes);
        self.take_events();
    }

    pub(crate) fn handle_datagram(&mut self, now: Instant, bytes: &[u8]) {
        self.session.handle_datagram(now, SERVER, bytes);
        self.take_events();
    }

    pub(crate) fn handle_timeout(&mut self, now: Instant) {
        self.session.handle_timeout(now);
        self.take_events();
    }

    pub(crate) fn handle_ended(&mut self, now: Instant, ending: Ending) {
        self.session.handle_ended(now, SERVER, ending);
        self.take_events();
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Transmit> {
        self.session.poll_transmit()
    }

    pub(crate) fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout().map(|wake| wake.at)
    }

    /// All events since the last call, as a list.
    pub(crate) fn poll_events(&mut self) -> Option<Value> {
        self.take_events();
        let events = std::mem::take(&mut self.events);
        (!events.is_empty()).then_some(Value::Array(events))
    }

    /// Makes the session ready for another connection.
    pub(crate) fn reconnect(&mut self) -> Result<(), Failure> {
        Ok(self.session.reconnect()?)
    }

    /// Leaves the scene and closes the connection.
    pub(crate) fn close(&mut self) {
        self.session.close(CloseCode::DONE);
        self.take_events();
    }

    fn take_events(&mut self) {
        while let Some(event) = self.session.poll_event() {
            self.take_event(&event);
        }
    }

    fn take_event(&mut self, event: &Event) {
        if let Some(mut joining) = self.joining.take() {
            match joining.handle(&mut self.session, event) {
                Ok(None) => self.joining = Some(joining),
                Ok(Some(granted)) => self.begin(granted),
                Err(error) => {
                    let failure = match error {
                        JoinError::Denied(denial) => Failure::denied(denial),
                        JoinError::Misuse(misuse) => misuse.into(),
                    };
                    let failed = object!({"kind": "joinFailed", "error": failure.to_json()});
                    self.events.push(failed);
                }
            }
        }
        if let Some(joined) = &mut self.joined {
            joined.live_view.note(event);
            joined.upstream_clock.note(event);
            joined.columns.centres.note(event);
            joined.columns.described_anew |= matches!(
                event,
                Event::BodyPlaced(_) | Event::SubscriptionChanged(_) | Event::Resumed(_)
            );
            joined.note_answers(event);
            let is_handled = !joined.ids.note(event, &mut self.session);
            // A call that needs more ids waits for this event.
            if is_handled && !matches!(event, Event::Reserved(_)) {
                return;
            }
        }
        if let Some(mut json) = scene_json::event(event) {
            json["complete"] = json!(self.complete().value());
            let refusal = self
                .joined
                .as_ref()
                .and_then(|joined| joined.ids.refusal(event));
            if let Some(refusal) = refusal {
                json["reason"] = json!(refusal.reason.word());
                if let Some(body) = refusal.body {
                    json["body"] = id_number(body).into();
                }
                json["message"] = json!(with_number(&refusal));
            }
            if let Event::Ended(ending) = event {
                let resumes = may_resume(*ending) && self.session.can_reconnect();
                json["mayResume"] = json!(resumes);
                if let Some(place) = self.session.elsewhere() {
                    json["elsewhere"] = json!(place);
                }
                json["message"] = json!(scene_json::sentence(*ending));
            }
            self.events.push(json);
        }
    }

    /// The session has joined.
    fn begin(&mut self, granted: IdRange) {
        let Some(config) = self.session.config().copied() else {
            return;
        };
        let watermark_tick = self.stream().map_or(Tick::ZERO, Subscriber::watermark_tick);
        let rate = config.integrator.rate;
        let mut joined = Membership {
            live_view: LiveView::new(config, self.options.view),
            ids: ClientIds::new(granted),
            upstream_clock: UpstreamClock::new(rate, self.options.lead_ticks),
            columns: Columns::default(),
            requested: watermark_tick,
            unanswered: None,
            answered: None,
        };
        let at = RenderTime::at(watermark_tick);
        joined.show(&mut self.session, Instant::ZERO, at, false);
        self.joined = Some(joined);
    }

    fn joined(&mut self) -> Result<(&mut Membership, &mut ClientSession), Failure> {
        let joined = self.joined.as_mut().ok_or(Failure::from(Misuse::NotNow))?;
        Ok((joined, &mut self.session))
    }

    fn replica(&self) -> Option<&Replica> {
        self.session.replica()
    }

    fn stream(&self) -> Option<&Subscriber> {
        self.replica().map(Replica::stream)
    }

    fn complete(&self) -> Tick {
        self.session.complete().unwrap_or_default()
    }

    pub(crate) fn complete_tick(&self) -> f64 {
        self.complete().value() as f64
    }

    /// A moment of JavaScript's clock, milliseconds. One before the latest counts as that.
    pub(crate) fn at(&mut self, milliseconds: f64) -> Instant {
        let moment = Instant::ZERO + Span::from_nanos((milliseconds * 1e6) as u64);
        self.latest = self.latest.max(moment);
        self.latest
    }

    /// Computes the view of the present moment; returns it in ticks.
    pub(crate) fn poll(&mut self, now: Instant) -> Option<f64> {
        let (joined, session) = self.joined().ok()?;
        let at = joined.live_view.show_present(session, now);
        joined.columns.update(&joined.live_view, session);
        Some(at.ticks())
    }

    /// Computes the view of a moment in ticks, unsmoothed.
    pub(crate) fn show(&mut self, now: Instant, at: RenderTime) {
        if let Ok((joined, session)) = self.joined() {
            joined.show(session, now, at, false);
        }
    }

    pub(crate) fn live_view(&self) -> Option<&LiveView> {
        self.joined.as_ref().map(|joined| &joined.live_view)
    }

    pub(crate) fn set_delay_ticks(&mut self, ticks: f64) -> Result<(), Failure> {
        self.joined()?.0.live_view.options.delay_ticks = ticks;
        Ok(())
    }

    pub(crate) fn set_lead_ticks(&mut self, ticks: f64) -> Result<(), Failure> {
        self.joined()?.0.upstream_clock.lead_ticks = ticks;
        Ok(())
    }

    pub(crate) fn set_smooth(&mut self, smooth: bool) -> Result<(), Failure> {
        self.joined()?.0.live_view.options.smooth = smooth;
        Ok(())
    }

    pub(crate) fn columns(&self) -> Option<&Columns> {
        self.joined.as_ref().map(|joined| &joined.columns)
    }

    /// Computes the columns that are not computed with each view.
    pub(crate) fn compute(&mut self, column: fn(&mut Columns, &LiveView, &ClientSession)) {
        if let Some(joined) = &mut self.joined {
            column(&mut joined.columns, &joined.live_view, &self.session);
        }
    }

    pub(crate) fn error_bound(&self, id: BodyId) -> Option<f64> {
        let bound = self.live_view()?.error_bound(&self.session, id)?;
        Some(bound.metres())
    }

    pub(crate) fn tick_error_bound(&self, id: BodyId, tick: Tick) -> Option<f64> {
        if self.replica().is_none() {
            return self.error_bound(id);
        }
        let (copy, local) = self.session.copy_of(id)?;
        Some(copy.stream().bound_at(local, tick)?.metres())
    }

    pub(crate) fn body_json(&self, id: BodyId) -> Option<Value> {
        Some(scene_json::body(&self.session.body(id)?))
    }

    pub(crate) fn shape_json(&self, number: u32) -> Option<Value> {
        let shape = self
            .replica()?
            .shape(rhumb_protocol::scene::ShapeId(number))?;
        Some(scene_json::shape(shape))
    }

    pub(crate) fn track_json(&self, id: BodyId) -> Option<Value> {
        let (copy, local) = self.session.copy_of(id)?;
        let track = copy.stream().track(local)?;
        // At its origin the prediction is the published state.
        let state = copy.stream().published_motion(local)?;
        Some(scene_json::track(&track, &state))
    }

    pub(crate) fn joints_json(&self) -> Option<Value> {
        let of_cells = self.session.cells().map(|(_, copy)| copy);
        let copies = std::iter::once(self.replica()?).chain(of_cells);
        let joints = copies.flat_map(|copy| copy.joints().iter().map(move |of| (copy, of)));
        let pairs = joints.map(|(copy, (id, joint))| {
            let mut joint = *joint;
            let named = |body| copy.id_in_scene(body).unwrap_or(body);
            joint.bodies = joint.bodies.map(named);
            json!([id.0, scene_json::joint(&joint)])
        });
        Some(pairs.collect())
    }

    /// The edges of the grid of the scene's cells.
    pub(crate) fn grid_json(&self) -> Option<Value> {
        Some(json!(self.session.cell_grid()?.edges()))
    }

    /// The cells that are taken, and the state of each.
    pub(crate) fn cells_json(&self) -> Value {
        let cells = self.session.taken_cells();
        let each = cells.map(|(cell, state)| scene_json::taken_cell(cell, state));
        each.collect()
    }

    pub(crate) fn config_json(&self) -> Option<Value> {
        Some(scene_json::config(self.session.config()?))
    }

    pub(crate) fn stream_json(&self) -> Option<Value> {
        Some(scene_json::stream(self.replica()?.choice()))
    }

    pub(crate) fn gravity_json(&self) -> Option<Value> {
        Some(scene_json::vector(self.replica()?.gravity()))
    }

    pub(crate) fn digest_json(&self) -> Option<Value> {
        Some(digest(self.replica()?))
    }

    pub(crate) fn authority_json(&self) -> Value {
        let bodies = self.session.authority_bodies();
        bodies.map(id_number).collect()
    }

    /// Milliseconds for which the client tries to resume by default.
    pub(crate) fn resume_within(&self) -> f64 {
        match self.session.is_durable() {
            true => RESUME_WITHIN.as_secs_f64() * 1e3,
            false => 0.0,
        }
    }

    pub(crate) fn statistics_json(&self, now: Instant) -> Value {
        let stream = self.stream();
        let counted = stream.map(Subscriber::statistics).unwrap_or_default();
        let upstream = self.session.upstream().unwrap_or_default();
        let watermark_tick = stream.map(Subscriber::watermark_tick).unwrap_or_default();
        let scale = stream.and_then(|stream| stream.error_scale_at(watermark_tick));
        json!({
            "roundTrip": self.session.round_trip().as_nanos() as f64 / 1e6,
            "packets": counted.packets,
            "updates": counted.updates,
            "missed": counted.missed,
            "rebuilt": counted.rebuilt,
            "repairSymbols": counted.repair_symbols,
            "refreshes": counted.refreshes,
            "disordered": counted.disordered,
            "duplicates": counted.duplicates,
            "malformed": counted.malformed,
            "checksumsCompared": counted.compared,
            "checksumMismatches": counted.mismatches,
            "missing": stream.map_or(0, Subscriber::missing),
            "watermarkTick": watermark_tick.value(),
            "completeTick": self.complete().value(),
            "errorScale": scale,
            "behindTicks": self.live_view().and_then(|view| view.behind_ticks(now)),
            "upstream": {
                "updates": upstream.updates, "packets": upstream.packets, "bytes": upstream.bytes
            },
        })
    }

    pub(crate) fn change_stream(&mut self, choice: StreamChoice) -> Result<(), Failure> {
        Ok(self.session.subscribe(choice)?)
    }

    pub(crate) fn take_cells(&mut self, cells: &CellArguments) -> Result<(), Failure> {
        let grid = self.session.cell_grid().ok_or(Misuse::NotDivided)?;
        Ok(self.session.take_cells(&cells.of(grid)?)?)
    }

    pub(crate) fn set_tier_policy(&mut self, policy: TierPolicy) -> Result<(), Failure> {
        Ok(self.session.set_tier_policy(policy)?)
    }

    pub(crate) fn command(&mut self, command: Command) -> Result<u64, Failure> {
        let (joined, session) = self.joined()?;
        let command = joined.columns.centres.command_in(command);
        Ok(joined.ids.command(session, command)?)
    }

    pub(crate) fn remove_unused_shapes(&mut self) -> Result<usize, Failure> {
        let (joined, session) = self.joined()?;
        Ok(joined.ids.remove_unused_shapes(session)?)
    }

    pub(crate) fn query(&mut self, queries: Vec<Query>) -> Result<u64, Failure> {
        Ok(self.session.query(queries)?)
    }

    /// Queues bodies, all or none; fails with `noIds` after it has requested more ids.
    pub(crate) fn add_bodies(&mut self, bodies: &[BodyBuilder]) -> Result<Vec<BodyId>, Failure> {
        let (centred, centres) = BodyCentres::centred(bodies.iter().cloned());
        let mut checked = Vec::with_capacity(bodies.len());
        for body in centred {
            body.check().map_err(Misuse::Invalid)?;
            let state = body.state().map_err(Misuse::Invalid)?;
            checked.push((body, state));
        }
        let (joined, session) = self.joined()?;
        let count = u32::try_from(bodies.len()).unwrap_or(u32::MAX);
        let missing = joined.ids.missing_ids(count);
        if missing > 0 {
            session.reserve(missing)?;
            let why = "the server must grant more body ids first: repeat the call after the event reserved";
            return Err(Failure::of("noIds", why));
        }
        let ids = joined.ids.add_bodies(session, &checked)?;
        joined.columns.centres.keep(&ids, &centres);
        Ok(ids)
    }

    pub(crate) fn take_authority(
        &mut self,
        tolerance: Tolerance,
        bodies: &[BodyId],
    ) -> Result<(), Failure> {
        Ok(self.session.take_authority(tolerance, bodies)?)
    }

    /// Publishes states of bodies under authority; returns their tick, if they were published.
    pub(crate) fn publish(
        &mut self,
        now: Instant,
        states: &[(BodyId, BodyState)],
    ) -> Result<Option<Tick>, Failure> {
        let (joined, session) = self.joined()?;
        let centres = &joined.columns.centres;
        let centred = states.iter().map(|(id, state)| {
            let state = centres.state_in(*id, *state).map_err(Invalid::from);
            Ok((*id, state.map_err(Misuse::Invalid)?))
        });
        let states = &centred.collect::<Result<Vec<_>, Misuse>>()?;
        let config = *joined.live_view.config();
        match config.stepping {
            Stepping::FreeRunning => Ok(joined.upstream_clock.publish(session, now, states)?),
            Stepping::Lockstep => {
                let watermark = session
                    .replica()
                    .map(|replica| replica.stream().watermark_tick());
                let newest = joined.requested.max(watermark.unwrap_or_default());
                let tick = config.publish_schedule.next_published(newest);
                Ok(session.publish(tick, states)?.then_some(tick))
            }
        }
    }

    /// Lets a lockstep scene step to its next published tick, which is returned.
    pub(crate) fn advance(&mut self, now: Instant) -> Result<Tick, Failure> {
        let (joined, session) = self.joined()?;
        let schedule = joined.live_view.config().publish_schedule;
        let next = schedule.next_published(joined.requested);
        session.advance(now, next)?;
        joined.requested = next;
        let newest = joined.ids.last_command();
        joined.unanswered = newest.filter(|number| Some(*number) > joined.answered);
        Ok(next)
    }

    /// True while the server has not answered all commands before the last advance.
    pub(crate) fn awaits_answers(&self) -> bool {
        let joined = self.joined.as_ref();
        joined.is_some_and(|joined| joined.unanswered.is_some())
    }

    /// The scene will not step as far as was requested.
    pub(crate) fn give_up_advance(&mut self) {
        let complete = self.complete();
        if let Some(joined) = &mut self.joined {
            joined.requested = complete;
        }
    }

    pub(crate) fn inspect(&mut self) -> Result<(), Failure> {
        Ok(self.session.inspect()?)
    }

    pub(crate) fn delete(&mut self) -> Result<(), Failure> {
        Ok(self.session.delete()?)
    }
}

impl Membership {
    fn note_answers(&mut self, event: &Event) {
        match *event {
            Event::Applied { through, .. } => {
                self.answered = Some(through);
                self.unanswered = self.unanswered.filter(|number| *number > through);
            }
            Event::Resumed(_) => self.unanswered = None,
            _ => {}
        }
    }

    fn show(&mut self, session: &mut ClientSession, now: Instant, at: RenderTime, smooth: bool) {
        self.live_view.show(session, now, at, smooth);
        self.columns.update(&self.live_view, session);
    }
}

/// The reason of a refusal, which names a body by its number in JavaScript.
fn with_number(refusal: &RefusedRequest) -> String {
    let sentence = refusal.reason.to_string();
    match refusal.body {
        Some(id) => sentence.replace(&id.to_string(), &format!("body {}", id_number(id))),
        None => sentence,
    }
}

/// The options of a new member.
#[derive(Debug)]
pub(crate) struct MemberOptions {
    pub(crate) scene: SceneName,
    pub(crate) token: Option<Token>,
    /// The key of a session that may resume.
    pub(crate) key: Option<SessionKey>,
    pub(crate) join: JoinArguments,
}

impl MemberOptions {
    pub(crate) fn read(from: &Argument<'_>) -> Result<Self, Failure> {
        let scene = from.field("scene")?;
        let token = from.optional("token").map(|from| {
            let token = from.text()?.parse();
            token.map_err(|why| from.refused(why))
        });
        let key = from.optional("key").map(|from| session_key(&from));
        Ok(Self {
            scene: scene.text()?.parse().map_err(|why| scene.refused(why))?,
            token: token.transpose()?,
            key: key.transpose()?,
            join: JoinArguments::read(&from.field("join")?)?,
        })
    }
}

/// Columns of one view.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    known: Vec<BodyId>,
    pub(crate) ids: Vec<f64>,
    pub(crate) shapes: Vec<u32>,
    pub(crate) kinds: Vec<u8>,
    pub(crate) resting: Vec<u8>,
    pub(crate) changed: Vec<u32>,
    pub(crate) removed: Vec<f64>,
    pub(crate) update_ticks: Vec<f64>,
    pub(crate) error_bounds: Vec<f32>,
    pub(crate) tolerances: Vec<f32>,
    /// Origins of the bodies, if one of them is not its centre of mass; otherwise empty.
    pub(crate) origins: Vec<Vec3>,
    /// Of the bodies that this page added from elsewhere than their centres of mass.
    pub(crate) centres: BodyCentres,
    pub(crate) generation: u32,
    /// True if the description of a body may have changed since the last update.
    pub(crate) described_anew: bool,
    /// True if the view has not come to a known change of a body.
    changing: bool,
}

impl Columns {
    fn put_origins(&mut self, view: &View, grid: Option<CellGrid>) {
        self.centres.forget(view, grid);
        self.origins.clear();
        if !self.centres.is_empty() {
            let bodies = view
                .ids()
                .iter()
                .zip(view.positions())
                .zip(view.rotations());
            let origin = |((id, position), rotation): ((&BodyId, &Vec3), &Quat)| {
                self.centres.position_out(*id, *position, *rotation)
            };
            self.origins.extend(bodies.map(origin));
        }
    }

    /// Follows the view; costs little unless bodies came or went.
    pub(crate) fn update(&mut self, live_view: &LiveView, session: &ClientSession) {
        let view = live_view.view();
        self.resting.clear();
        self.resting
            .extend(view.resting().iter().map(|rests| u8::from(*rests)));
        self.changed.clear();
        self.changed
            .extend(view.changed().map(|place| place as u32));
        self.removed.clear();
        self.removed
            .extend(view.removed().iter().map(|id| id_number(*id)));
        self.put_origins(view, session.cell_grid());
        // A delayed view comes to a change of a body later than its description.
        let of_cells = session.cells().map(|(_, copy)| copy);
        let mut copies = session.replica().into_iter().chain(of_cells);
        let is_changing = copies.any(|copy| copy.stream().is_changing());
        let was_changing = std::mem::replace(&mut self.changing, is_changing);
        let same = self.known == view.ids() && !was_changing && !self.changing;
        if same && !std::mem::take(&mut self.described_anew) {
            return;
        }
        self.generation = self.generation.wrapping_add(1);
        self.known.clear();
        self.known.extend_from_slice(view.ids());
        self.ids.clear();
        self.ids.extend(self.known.iter().map(|id| id_number(*id)));
        self.described_anew = false;
        self.shapes.clear();
        self.kinds.clear();
        for id in &self.known {
            let desc = live_view.body(session, *id);
            self.shapes.push(desc.map_or(u32::MAX, |desc| desc.shape.0));
            self.kinds.push(match desc.map(|desc| desc.kind) {
                Some(BodyKind::Dynamic) => 1,
                Some(BodyKind::Kinematic) => 2,
                Some(BodyKind::Fixed) | None => 0,
            });
        }
    }

    pub(crate) fn compute_update_ticks(&mut self, live_view: &LiveView, session: &ClientSession) {
        self.update_ticks.clear();
        self.update_ticks.extend(self.known.iter().map(|id| {
            let copy = live_view.copy_of(session, *id);
            let track = copy.and_then(|(copy, local)| copy.stream().track(local));
            track.map_or(0.0, |track| track.origin.value() as f64)
        }));
    }

    pub(crate) fn compute_error_bounds(&mut self, live_view: &LiveView, session: &ClientSession) {
        self.error_bounds.clear();
        let bounds = live_view.error_bounds(session);
        self.error_bounds
            .extend(bounds.map(|bound| bound.metres() as f32));
    }

    pub(crate) fn compute_tolerances(&mut self, live_view: &LiveView, session: &ClientSession) {
        self.tolerances.clear();
        self.tolerances.extend(self.known.iter().map(|id| {
            // A choice that is exact has none.
            let copy = live_view.copy_of(session, *id);
            let copy = copy.filter(|(copy, _)| !copy.choice().is_exact());
            let metres = match copy.and_then(|(copy, local)| copy.stream().tolerance_of(local)) {
                Some(
                    Tolerance::Surface(length)
                    | Tolerance::Parts {
                        position: length, ..
                    },
                ) => length.metres().metres(),
                None => 0.0,
            };
            metres as f32
        }));
    }
}

/// The state of a copy: equal for every implementation that has read the same bytes.
pub(crate) fn digest(replica: &Replica) -> Value {
    let stream = replica.stream();
    let watermark = stream.watermark_tick();
    let mut json = json!({
        "watermark": watermark.value(),
        "complete": stream.complete().value(),
        "converged": stream.is_converged(),
        "next": stream.loss_report().next.0,
        "missing": stream.missing(),
        "checksum": format!("{:016x}", stream.state_checksum()),
    });
    // The prediction of a body is not specified while something is missing (PROTOCOL 6.8). Before the origin of a body's
    // newest track, and while bodies come and go between two ticks of a view, it depends on what a view needs, so that
    // clients differ.
    let is_begun = |id| {
        let track = stream.track(id);
        track.is_some_and(|track| track.origin <= watermark)
    };
    if stream.is_converged()
        && !stream.is_changing()
        && replica.bodies().all(|desc| is_begun(desc.id))
    {
        json["poses"] = json!(format!("{:016x}", poses(replica)));
    }
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        // Error scales are multiples of one eighth.
        let scale = stream.error_scale_at(watermark);
        json["error_scale_eighths"] = json!(scale.map(|factor| (factor * 8.0) as u64));
    }
    json
}

/// FNV-1a over the doubles of each body's predicted motion at the watermark, in order of index.
fn poses(replica: &Replica) -> u64 {
    let stream = replica.stream();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for desc in replica.bodies() {
        let Some(motion) = stream.predicted_motion(desc.id, stream.watermark_tick()) else {
            continue;
        };
        for byte in motion.parts().into_iter().flat_map(f64::to_le_bytes) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    hash
}
