//! A node that joins a scene, moves its bodies' nodes, and tells its events.
//!
//! Nothing that may run a script is called while this node or the membership is borrowed: the script may call both.

use std::cell::RefCell;
use std::rc::Rc;

use godot::builtin::{VarDictionary, Variant, vdict};
use godot::classes::notify::Node3DNotification;
use godot::classes::object::ConnectFlags;
use godot::classes::{Engine, INode3D, Node3D};
use godot::global::Error;
use godot::meta::ToGodot as _;
use godot::meta::error::ConvertError;
use godot::obj::Gd;
use godot::prelude::*;
use godot::signal::ConnectHandle;
use rhumb_bindings::{
    BindingError, CellBand, CellChoice, CellRecord, EventKind, EventRecord, JoinParams,
    ObjectChange, StateRecord, TakenState, packed_id, parse_packed_id,
};
use rhumb_client::glam::Vec3;
use rhumb_client::scene::{
    Answer, Command, Query, QueryFilter, QueryKind, SleepThresholds, Stepping,
};
use rhumb_client::{
    BodyId, Client, ClientError, Event, Misuse, PipelineDepth, QueryError, QueryResult,
};

use crate::body::{BodyNode, NodeSleep, SharedMembership, add, set_node, warn_of_other_rate};
use crate::conversion::{AXES, vec3, vector};
use crate::membership::{JoinRequest, PendingJoin, SceneMembership, outcome};

/// Source of the ticks of a new scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeStepping {
    /// The server's clock.
    #[default]
    FreeRunning,
    /// A physics frame of this member is a tick.
    Lockstep,
}

/// When the children that are `RhumbBody` nodes become bodies of a scene that is joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum AddChildren {
    /// If the scene has no bodies; else the nodes are freed.
    #[default]
    IfSceneIsEmpty,
    /// In any scene.
    Always,
}

/// A node that joins a scene of a Rhumb server.
///
/// Its children that are `RhumbBody` nodes become bodies of the scene, and every other body of the scene becomes a child.
#[derive(GodotClass)]
#[class(init, base = Node3D, rename = RhumbScene)]
pub(crate) struct SceneNode {
    /// Host and port of the server.
    #[export]
    address: GString,
    /// SHA-256 of the server's certificate, as the server prints it; empty if `roots` names a file.
    #[export]
    fingerprint: GString,
    /// A PEM file with the roots that sign the server's certificate.
    #[export(global_file = "*.pem")]
    roots: GString,
    /// Token of access; empty for a server that needs none.
    #[export]
    token: GString,
    /// Name of the scene, which is created unless it exists.
    #[export]
    #[init(val = "main".into())]
    scene_name: GString,
    /// Joins when the node is in the tree and ready. A node that goes out of the tree leaves.
    #[export]
    #[init(val = true)]
    join_at_start: bool,
    /// When the children become bodies of the scene.
    #[export]
    add_children: AddChildren,
    /// How far any point of a copied body may be off, metres.
    #[export(range = (0.0001, 1.0, suffix = "m"))]
    #[init(val = 0.05)]
    tolerance: f64,
    /// True if the scene is taken by cells, where its server divides it: see `take_cells_around`. The tolerance is then of the
    /// bodies that are in no cell, and the children become bodies only with `AddChildren.Always`.
    #[export]
    cells: bool,
    /// Source of the ticks of a new scene. In lockstep it has as many in a second as Godot has physics frames.
    #[export]
    stepping: NodeStepping,
    /// Gravity of a new scene, m/s².
    #[export]
    #[init(val = Vector3::new(0.0, -9.81, 0.0))]
    gravity: Vector3,
    /// Condition under which bodies of a new scene fall asleep that have none of their own.
    #[export]
    sleep: NodeSleep,
    /// With `Below`: speed of its fastest point, m/s.
    #[export(range = (0.0, 10.0, or_greater, suffix = "m/s"))]
    #[init(val = 0.1)]
    sleep_speed: f32,
    /// With `Below`: rad/s.
    #[export(range = (0.0, 10.0, or_greater, suffix = "rad/s"))]
    #[init(val = 1.0)]
    sleep_angular_speed: f32,
    /// With `Below`: time for which it must be as slow as that.
    #[export(range = (0.0, 10.0, or_greater, suffix = "s"))]
    #[init(val = 0.5)]
    sleep_seconds: f32,
    /// Lockstep: ticks by which the scene may be ahead of what is shown. At 0 a physics frame waits for its tick.
    #[export(range = (0.0, 8.0))]
    #[init(val = 1)]
    depth: u32,
    /// Free running: ticks by which the view stays behind the server's clock.
    #[export(range = (0.0, 30.0))]
    delay_ticks: f64,
    /// Free running: whether only whole ticks are shown.
    #[export]
    whole_ticks: bool,
    /// Free running: whether corrections are shown as short glides.
    #[export]
    #[init(val = true)]
    smooth: bool,
    joining: Option<PendingJoin>,
    membership: Option<SharedMembership>,
    /// While the node is in the tree.
    connections: Vec<ConnectHandle>,
    base: Base<Node3D>,
}

/// A script on the node replaces the methods that Godot calls, such as `_process`. So the node follows notifications and the
/// signals of the tree, which no script replaces.
#[godot_api]
impl INode3D for SceneNode {
    fn on_notification(&mut self, what: Node3DNotification) {
        match what {
            Node3DNotification::ENTER_TREE => {
                self.connect();
                if self.join_at_start && self.base().is_node_ready() {
                    self.join();
                }
            }
            Node3DNotification::READY if self.join_at_start => {
                self.join();
            }
            Node3DNotification::EXIT_TREE => {
                self.connections
                    .drain(..)
                    .for_each(ConnectHandle::disconnect);
                self.leave();
            }
            _ => {}
        }
    }
}

#[godot_api]
impl SceneNode {
    /// The scene is joined, and has the bodies of the children.
    #[signal]
    fn joined();

    /// The scene was not joined.
    #[signal]
    fn join_failed(reason: GString);

    /// The scene has ended. Its nodes stay where they are.
    #[signal]
    fn ended(reason: GString);

    /// A body of another member has a node now. Give it something to draw.
    #[signal]
    fn body_appeared(body: Gd<BodyNode>);

    /// A body was removed, or is in no cell that is taken. Its node is freed at the end of the frame.
    #[signal]
    fn body_removed(body: Gd<BodyNode>);

    /// An event of the scene. Its kind is such as `contact began`; the fields that a kind does not name are zero or null.
    #[signal]
    fn event(kind: GString, details: VarDictionary);

    /// The answer to [`Self::cast_ray`]: the nearest body as in an event, and `distance`; empty if no body was hit.
    #[signal]
    fn ray_answered(number: i64, hit: VarDictionary);

    /// Begins to join. The signal `joined` or `join_failed` follows.
    #[func]
    fn join(&mut self) -> Error {
        if self.joining.is_some() || self.membership.is_some() {
            let _free_for_scripts = self.base_mut();
            godot_error!("join: the node has a scene already; call leave() first");
            return Error::ERR_ALREADY_IN_USE;
        }
        let request = JoinRequest {
            address: self.address.to_string(),
            fingerprint: self.fingerprint.to_string(),
            roots: self.roots.to_string(),
            token: self.token.to_string(),
            scene: self.scene_name.to_string(),
            params: self.params(),
        };
        match PendingJoin::start(request) {
            Ok(joining) => {
                self.joining = Some(joining);
                Error::OK
            }
            Err(error) => {
                let _free_for_scripts = self.base_mut();
                godot_error!("join: no thread: {error}");
                Error::ERR_CANT_CREATE
            }
        }
    }

    /// Leaves the scene. The nodes of its bodies stay, and stand for no bodies any more.
    #[func]
    fn leave(&mut self) {
        // A join that is under way ends on its thread, which then leaves.
        self.joining = None;
        self.membership = None;
    }

    /// True from `joined` until the node leaves or the scene ends.
    #[func]
    fn is_joined(&self) -> bool {
        let is_live = |membership: &SharedMembership| !membership.borrow().follower.is_ended();
        self.membership.as_ref().is_some_and(is_live)
    }

    /// The node of a body; null for a number that no shown body has.
    #[func]
    fn get_body(&self, id: i64) -> Option<Gd<BodyNode>> {
        let id = parse_packed_id(id as u64).ok()?;
        let membership = self.membership.as_ref()?.borrow();
        let node = membership.follower.object(id)?;
        node.is_instance_valid().then(|| node.clone())
    }

    /// The nodes of all bodies that are shown.
    #[func]
    fn get_bodies(&self) -> Array<Gd<BodyNode>> {
        let Some(membership) = &self.membership else {
            return Array::new();
        };
        let membership = membership.borrow();
        let nodes = membership.follower.objects().into_iter();
        nodes
            .map(|(_, node)| node)
            .filter(|node| node.is_instance_valid())
            .cloned()
            .collect()
    }

    /// The tick that is shown, with its fraction; zero before the first one.
    #[func]
    fn get_tick(&self) -> f64 {
        let time = (self.membership.as_ref())
            .and_then(|membership| membership.borrow().client.view().time());
        time.map_or(0.0, |time| time.tick.value() as f64 + time.fraction)
    }

    /// Lockstep: physics frames at which the requested tick was not there yet. The bodies then stood still.
    #[func]
    fn get_late_steps(&self) -> i64 {
        let late = |membership: &SharedMembership| membership.borrow().follower.late_steps() as i64;
        self.membership.as_ref().map_or(0, late)
    }

    /// Bytes that were received in datagrams, without the headers of UDP and IP.
    #[func]
    fn get_received_bytes(&self) -> i64 {
        let received = |membership: &SharedMembership| {
            membership.borrow().client.statistics().wire.received_bytes as i64
        };
        self.membership.as_ref().map_or(0, received)
    }

    /// Edges of the scene's cells along x, y and z, metres; 0 along an axis that is not divided. All are 0 for a scene that is not
    /// divided, and without the property `cells`.
    #[func]
    fn get_cell_grid(&self) -> Vector3 {
        let grid = |membership: &SharedMembership| membership.borrow().client.cell_grid();
        let grid = self.membership.as_ref().and_then(grid);
        grid.map_or(Vector3::ZERO, |grid| Vector3::from_array(grid.edges()))
    }

    /// Takes the cells around a point and no others, each by the nearest band that reaches it. Each band is a radius and a
    /// tolerance in metres, as in `[Vector2(40, 0.01), Vector2(150, 0.2)]`; a tolerance of 0 is exact. Call it as the point moves:
    /// what is taken already costs nothing. The bodies of these cells have nodes, and those that are in no cell: bodies whose
    /// bounding radius is more than half of the shortest edge, such as floors.
    #[func]
    fn take_cells_around(&self, point: Vector3, bands: PackedVector2Array) -> Error {
        let bands = bands.as_slice().iter().map(|band| CellBand {
            radius: band.x,
            tolerance_m: f64::from(band.y),
        });
        let bands: Vec<_> = bands.collect();
        self.take("take_cells_around", |client| {
            let bands = bands.iter().map(|band| band.of_client(AXES));
            let bands: Vec<_> = bands.collect::<Result<_, _>>()?;
            Ok(client.take_cells_around(vec3(point), &bands)?)
        })
    }

    /// Takes these cells and no others: a tolerance in metres, or 0 for exact states, for each `Vector3i` of places. A cell reaches
    /// from place times edge to place + 1 times edge; along an axis that is not divided its place is 0.
    #[func]
    fn take_cells(&self, cells: VarDictionary) -> Error {
        let choices = cells.iter_shared().map(|(places, tolerance_m)| {
            let places = places.try_to::<Vector3i>()?;
            Ok(CellChoice {
                places: [places.x, places.y, places.z],
                tolerance_m: tolerance_m.try_to_relaxed()?,
            })
        });
        let choices: Vec<_> = match choices.collect::<Result<_, ConvertError>>() {
            Ok(choices) => choices,
            Err(error) => {
                godot_error!("take_cells: {error}");
                return Error::ERR_INVALID_PARAMETER;
            }
        };
        self.take("take_cells", |client| {
            let grid = client.cell_grid().ok_or(Misuse::NotDivided);
            let grid = grid.map_err(ClientError::from)?;
            let cells = choices.iter().map(|choice| choice.of_client(grid, AXES));
            Ok(client.take_cells(&cells.collect::<Result<_, _>>()?)?)
        })
    }

    /// States of the cells that are taken: for each `Vector3i` of places `awaited`, `shown`, or why it is denied. A cell is awaited
    /// until its snapshot has come, once more after a resumed session, which shows it until then as it was.
    #[func]
    fn get_taken_cells(&self) -> VarDictionary {
        let mut found = VarDictionary::new();
        let Some(membership) = &self.membership else {
            return found;
        };
        let membership = membership.borrow();
        let Some(grid) = membership.client.cell_grid() else {
            return found;
        };
        for taken in membership.client.cells() {
            let record = CellRecord::new(taken, grid, AXES);
            let [x, y, z] = record.places;
            let what = match record.state {
                TakenState::Denied => record.text,
                state => state.word().to_owned(),
            };
            found.set(Vector3i::new(x, y, z), what.as_str());
        }
        found
    }

    /// Asks the server for the nearest body on a line. Returns the number that `ray_answered` will have; negative if the
    /// question was not sent.
    #[func]
    fn cast_ray(&self, from: Vector3, to: Vector3) -> i64 {
        let Some(membership) = self.membership.clone() else {
            godot_error!("cast_ray: no scene is joined");
            return -1;
        };
        let (origin, end) = (vec3(from), vec3(to));
        let kind = QueryKind::Ray {
            origin,
            translation: end - origin,
        };
        let query = AXES.query_in(Query {
            kind,
            filter: QueryFilter::DEFAULT,
            hits: 1,
        });
        let asked = match query {
            Ok(query) => membership.borrow_mut().client.query(vec![query]),
            Err(invalid) => Err(ClientError::Misuse(Misuse::Invalid(invalid))),
        };
        match asked {
            Ok(number) => number as i64,
            Err(error) => {
                outcome("cast_ray", Err(error));
                -1
            }
        }
    }

    /// Deletes the scene for all members, and waits for the answer. The signal `ended` follows.
    #[func]
    fn delete(&self) -> Error {
        let Some(membership) = self.membership.clone() else {
            godot_error!("delete: no scene is joined");
            return Error::ERR_UNCONFIGURED;
        };
        let deleted = membership.borrow_mut().client.delete();
        outcome("delete", deleted)
    }
}

impl SceneNode {
    /// Queues a command about the scene.
    pub(crate) fn command(&self, call: &str, command: Command) -> Error {
        let Some(membership) = self.membership.clone() else {
            godot_error!("{call}: no scene is joined");
            return Error::ERR_UNCONFIGURED;
        };
        let queued = membership.borrow_mut().command(command);
        outcome(call, queued)
    }

    /// Takes cells of the scene; a failure is logged under the name of the call.
    fn take(
        &self,
        call: &str,
        take: impl FnOnce(&mut Client) -> Result<(), BindingError>,
    ) -> Error {
        let Some(membership) = self.membership.clone() else {
            godot_error!("{call}: no scene is joined");
            return Error::ERR_UNCONFIGURED;
        };
        let taken = take(&mut membership.borrow_mut().client);
        match taken {
            Ok(()) => Error::OK,
            Err(BindingError::Client(error)) => outcome(call, Err(error)),
            Err(error) => {
                godot_error!("{call}: {error}");
                Error::ERR_INVALID_PARAMETER
            }
        }
    }

    fn params(&self) -> JoinParams {
        let ticks_per_second = Engine::singleton().get_physics_ticks_per_second();
        JoinParams {
            coordinates: AXES,
            tolerance_m: self.tolerance,
            cells: self.cells,
            stepping: match self.stepping {
                NodeStepping::FreeRunning => Stepping::FreeRunning,
                NodeStepping::Lockstep => Stepping::Lockstep,
            },
            ticks_per_second: ticks_per_second.unsigned_abs(),
            gravity: Some(vec3(self.gravity)),
            sleep: self
                .sleep
                .rule(SleepThresholds {
                    speed: self.sleep_speed,
                    angular_speed: self.sleep_angular_speed,
                    seconds: self.sleep_seconds,
                })
                .unwrap_or_default(),
            delay_ticks: self.delay_ticks,
            whole_ticks: self.whole_ticks,
            smooth: self.smooth,
            ..JoinParams::default()
        }
    }

    /// Connects to the tree, which calls the node in each frame before the scripts of all nodes.
    fn connect(&mut self) {
        let Some(tree) = self.base().get_tree_or_null() else {
            return;
        };
        let this = self.to_gd();
        let [in_frame, in_physics_frame, scene] = [this.clone(), this.clone(), this.clone()];
        self.connections = vec![
            tree.signals()
                .process_frame()
                .connect(move || Self::frame(in_frame.clone(), Stepping::FreeRunning)),
            tree.signals()
                .physics_frame()
                .connect(move || Self::frame(in_physics_frame.clone(), Stepping::Lockstep)),
            this.signals()
                .child_entered_tree()
                .connect(move |child| Self::notice_child(&scene, child)),
        ];
    }

    fn frame(this: Gd<Self>, stepping: Stepping) {
        if !this.can_process() {
            return;
        }
        if stepping == Stepping::FreeRunning {
            Self::finish_join(this.clone());
        }
        if this.is_instance_valid() {
            Self::step_if(this, stepping);
        }
    }

    /// Adds the body of a child that comes after the scene was joined, once its script is ready.
    fn notice_child(this: &Gd<Self>, child: Gd<Node>) {
        let Ok(child) = child.try_cast::<BodyNode>() else {
            return;
        };
        if child.is_node_ready() {
            return Self::add_late(this, child);
        }
        let (scene, body) = (this.clone(), child.clone());
        child
            .signals()
            .ready()
            .builder()
            .flags(ConnectFlags::ONE_SHOT)
            .connect(move || Self::add_late(&scene, body.clone()));
    }

    fn add_late(this: &Gd<Self>, child: Gd<BodyNode>) {
        let membership = this.bind().membership.clone();
        if let Some(membership) = membership.filter(|_| child.bind().id().is_none()) {
            add(&membership, vec![child]);
        }
    }

    /// True while the node is a member of this scene: a script that a signal runs may leave it, or free the node.
    fn is_member(this: &Gd<Self>, membership: &SharedMembership) -> bool {
        this.is_instance_valid()
            && (this.bind().membership.as_ref()).is_some_and(|own| Rc::ptr_eq(own, membership))
    }

    /// Takes over the client of a thread that has ended.
    fn finish_join(mut this: Gd<Self>) {
        let joining = this
            .bind_mut()
            .joining
            .take_if(|joining| joining.is_finished());
        let Some(joining) = joining else { return };
        match joining.take() {
            Ok(client) => Self::begin(this, client),
            Err(reason) => this.signals().join_failed().emit(&GString::from(&reason)),
        }
    }

    fn begin(mut this: Gd<Self>, client: Client) {
        // Of a scene that is taken by cells nothing else is known.
        let is_empty = client.cell_grid().is_none() && client.view().ids().is_empty();
        let membership = Rc::new(RefCell::new(SceneMembership::new(client)));
        warn_of_other_rate(&membership);
        this.bind_mut().membership = Some(Rc::clone(&membership));
        let adds = is_empty || this.bind().add_children == AddChildren::Always;
        let mut own = Vec::new();
        for child in this.get_children().iter_shared() {
            let Ok(mut body) = child.try_cast::<BodyNode>() else {
                continue;
            };
            if body.is_queued_for_deletion() {
                continue;
            }
            // Nodes that an earlier membership made stand for nothing any more.
            let is_own = body.bind_mut().forget();
            match is_own && adds {
                true => own.push(body),
                false => body.queue_free(),
            }
        }
        add(&membership, own);
        Self::follow(&this, &membership);
        if Self::is_member(&this, &membership) {
            this.signals().joined().emit();
        }
    }

    /// Advances a scene that steps like this.
    fn step_if(this: Gd<Self>, stepping: Stepping) {
        let (membership, depth) = {
            let scene = this.bind();
            (scene.membership.clone(), scene.depth)
        };
        let Some(membership) = membership else { return };
        let advanced = {
            let SceneMembership { client, follower } = &mut *membership.borrow_mut();
            if follower.stepping() != stepping || follower.is_ended() {
                return;
            }
            let advanced = follower.advance(client, PipelineDepth::new(depth));
            if let Some(refused) = follower.take_refused() {
                godot_error!("{refused}");
            }
            advanced
        };
        if let Ok(true) = advanced {
            Self::follow(&this, &membership);
        }
        Self::emit_events(&this, &membership);
        let Err(error) = advanced else { return };
        membership.borrow_mut().follower.end();
        if Self::is_member(&this, &membership) {
            this.signals()
                .ended()
                .emit(&GString::from(&error.to_string()));
        }
    }

    /// Makes the nodes show the view.
    fn follow(this: &Gd<Self>, membership: &SharedMembership) {
        let changes = {
            let SceneMembership { client, follower } = &mut *membership.borrow_mut();
            follower.changes(client.view())
        };
        for change in changes {
            if !Self::is_member(this, membership) {
                return;
            }
            match change {
                ObjectChange::Destroy(body) => Self::free(this, body),
                ObjectChange::Show(state) => Self::show(this, membership, &state),
            }
        }
    }

    /// Frees the node of a body that was removed; the project may have freed it before.
    fn free(this: &Gd<Self>, mut body: Gd<BodyNode>) {
        if body.is_instance_valid() {
            this.signals().body_removed().emit(&body);
        }
        if body.is_instance_valid() {
            body.queue_free();
        }
    }

    fn show(this: &Gd<Self>, membership: &SharedMembership, state: &StateRecord) {
        // A freed node can be neither cloned nor called.
        let known = {
            let membership = membership.borrow();
            let known = membership.follower.object(state.body);
            known.map(|body| body.is_instance_valid().then(|| body.clone()))
        };
        match known {
            Some(Some(mut body)) => BodyNode::show(&mut body, state),
            // The project has freed the node, which hides the body.
            Some(None) => {}
            None => Self::appear(this, membership, state),
        }
    }

    /// Gives a body its node.
    fn appear(this: &Gd<Self>, membership: &SharedMembership, state: &StateRecord) {
        let reserved = membership.borrow_mut().follower.take_reserved(state.body);
        if let Some(mut body) = reserved {
            if !body.is_instance_valid() {
                let follower = &mut membership.borrow_mut().follower;
                return follower.set_object(state.body, body);
            }
            set_node(membership, state, &body);
            BodyNode::show(&mut body, state);
            body.reset_physics_interpolation();
            return;
        }
        let (desc, shape) = {
            let membership = membership.borrow();
            let client = &membership.client;
            let desc = client.body(state.body);
            let shape = desc.and_then(|desc| client.replica()?.shape(desc.shape).cloned());
            (desc, shape)
        };
        let mut body = BodyNode::new_alloc();
        {
            let mut node = body.bind_mut();
            node.stand_for(membership, state.body, Vec3::ZERO);
            node.make_spawned();
            if let Some(desc) = desc {
                node.describe(&desc, shape.as_ref());
            }
        }
        set_node(membership, state, &body);
        BodyNode::show(&mut body, state);
        this.clone().add_child(&body);
        if this.is_instance_valid() && body.is_instance_valid() {
            this.signals().body_appeared().emit(&body);
        }
    }

    fn emit_events(this: &Gd<Self>, membership: &SharedMembership) {
        while Self::is_member(this, membership) {
            let next = membership.borrow_mut().client.poll_event();
            match next {
                None => return,
                Some((_, Event::QueryResult(result))) => {
                    Self::emit_answer(this, membership, result);
                }
                Some((after, event)) => {
                    let record = EventRecord::new(after, event, AXES);
                    let details = details(&membership.borrow(), &record);
                    let kind = GString::from(record.kind.word());
                    this.signals().event().emit(&kind, &details);
                    let removed = (record.body).filter(|_| record.kind == EventKind::BodyRemoved);
                    // A body that was never shown has a node that waits.
                    let waiting =
                        removed.and_then(|id| membership.borrow_mut().follower.take_reserved(id));
                    if let Some(body) = waiting.filter(|_| this.is_instance_valid()) {
                        Self::free(this, body);
                    }
                }
            }
        }
    }

    fn emit_answer(this: &Gd<Self>, membership: &SharedMembership, result: QueryResult) {
        let number = result.number as i64;
        let hit = ray_hit(&membership.borrow(), result);
        let hit = hit.unwrap_or_else(|error| {
            godot_error!("cast_ray {number}: {error}");
            VarDictionary::new()
        });
        if this.is_instance_valid() {
            this.signals().ray_answered().emit(number, &hit);
        }
    }
}

/// The fields of an event. `body` and `other` are nodes, or null; `body_id` and `other_id` are numbers, or zero.
fn details(membership: &SceneMembership<Gd<BodyNode>>, record: &EventRecord) -> VarDictionary {
    let node = |id: Option<BodyId>| {
        let node = id.and_then(|id| membership.follower.object(id));
        let node = node.filter(|node| node.is_instance_valid());
        node.map_or_else(Variant::nil, Gd::to_variant)
    };
    let word = |id: Option<BodyId>| id.map_or(0, |id| packed_id(id) as i64);
    vdict! {
        "tick" => record.tick.value() as i64,
        "number" => record.number as i64,
        "body" => &node(record.body),
        "body_id" => word(record.body),
        "other" => &node(record.other),
        "other_id" => word(record.other),
        "point" => vector(record.point),
        "normal" => vector(record.normal),
        "separation" => record.separation,
        "force" => record.force,
        "text" => record.text.as_str(),
    }
}

/// The nearest body of the answer to a ray, as in an event, and its `distance`; empty if there is none.
fn ray_hit(
    membership: &SceneMembership<Gd<BodyNode>>,
    result: QueryResult,
) -> Result<VarDictionary, QueryError> {
    let Some(Answer::Hits(hits)) = result.answers?.pop() else {
        return Ok(VarDictionary::new());
    };
    let Some(found) = hits.into_iter().next().map(|hit| AXES.hit_out(hit)) else {
        return Ok(VarDictionary::new());
    };
    let record = EventRecord {
        body: Some(found.body),
        point: found.point,
        normal: found.normal,
        ..EventRecord::plain(EventKind::Other, result.tick)
    };
    let mut hit = details(membership, &record);
    hit.set("distance", found.distance);
    Ok(hit)
}
