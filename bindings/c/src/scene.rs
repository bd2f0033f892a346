//! Calls of a scene, and the arrays of a view: lent, or written to buffers.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::Command;
use rhumb_bindings::rhumb_client::{PipelineDepth, Tick};
use rhumb_bindings::{
    BindingError, JoinParams, OpenRequests, RemoteScene, packed_id, parse_packed_id,
};

use crate::border::{
    HandleTable, RhumbCode, check_out, copy_out, copy_text, elements, guard, one_of, text, value,
    write, write_if_wanted,
};
use crate::connection::{
    CHECKPOINTS, HeldConnection, RhumbAddress, RhumbCheckpoint, RhumbConnection, seconds, take_for,
};
use crate::descriptions::{RhumbBody, RhumbBodyDesc, sleep};
use crate::kinds::{CONDITIONS, COORDINATES, REFUSALS, RhumbSleep, STEPPINGS};

/// A client of one scene. All zeros is none.
///
/// One thread at a time may use it, any thread; a call beside another one is `RHUMB_CODE_BUSY`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbScene {
    /// Its number.
    pub id: u64,
}

/// How to join a scene. Begin with `rhumb_join_options_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbJoinOptions {
    /// A `RhumbCoordinates`: of every position, velocity, length and force of this client.
    pub coordinates: u32,
    /// A `RhumbJoinCondition`.
    pub condition: u32,
    /// How far any point of a copied body may be off, metres in any coordinates: 0.001 to 10.
    pub tolerance_m: f64,
    /// A `RhumbStepping`, for a new scene.
    pub stepping: u32,
    /// Ticks per second of a new scene.
    pub ticks_per_second: u32,
    /// Substeps in each tick of a new scene.
    pub substeps: u32,
    /// Published ticks of a new scene are the multiples of this number.
    pub publish_interval: u32,
    /// Not zero: `gravity` replaces the earth's in a new scene.
    pub has_gravity: u8,
    /// Free running only. Not zero: corrections are shown as short glides.
    pub smooth: u8,
    /// Not zero: `resume_within_s` replaces what the scene suggests.
    pub has_resume_within: u8,
    /// Not zero: the scene is taken by cells, if its server divides it: `rhumb_scene_take_cells_around`. `tolerance_m` is then
    /// of the bodies that are in no cell.
    pub cells: u8,
    /// Units of length per s².
    pub gravity: [f32; 3],
    /// Free running only: ticks by which the view stays behind the server's clock.
    pub delay_ticks: f64,
    /// Free running only: ticks ahead of the server's clock by which bodies under authority are published. With the
    /// network's delay and a little more, the server need not predict them.
    pub lead_ticks: f64,
    /// Free running only. Not zero: only whole ticks are shown, for an application with ticks of its own.
    pub whole_ticks: u8,
    /// A `RhumbRefusals`.
    pub refusals: u32,
    /// Seconds for which a client tries to continue over another connection.
    pub resume_within_s: f64,
    /// A `RhumbSleep`: of the bodies of a new scene that have none of their own.
    pub sleep: u32,
    /// Speed of a body's fastest point, units of length per second.
    pub sleep_speed: f32,
    /// rad/s.
    pub sleep_angular_speed: f32,
    /// Seconds for which a body must be as slow as that.
    pub sleep_seconds: f32,
}

/// A moment of a scene between two ticks.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbTime {
    /// The tick at or before the moment.
    pub tick: u64,
    /// Part of the step to the next tick, 0 to 1.
    pub fraction: f64,
}

/// Statistics of a client since it connected.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbStatistics {
    /// Bytes in UDP datagrams to the server.
    pub sent_bytes: u64,
    /// Bytes in UDP datagrams from the server.
    pub received_bytes: u64,
    /// Updates of bodies that the stream carried.
    pub updates: u64,
    /// The newest tick at which every copy is within its tolerance.
    pub complete_tick: u64,
    /// Updates of bodies that this client published under its authority, since it was granted.
    pub upstream_updates: u64,
    /// Packets of these updates.
    pub upstream_packets: u64,
    /// Bytes of these packets.
    pub upstream_bytes: u64,
    /// Events that were dropped unread: 65,536 are kept.
    pub events_left_out: u64,
    /// Pairs of bodies that touch and that the calls about contacts lack: a client knows 32,768.
    pub contacts_left_out: u64,
}

/// The scene that a handle names, and its requests.
struct HeldScene {
    remote: RemoteScene,
    requests: OpenRequests,
}

static SCENES: HandleTable<HeldScene> = HandleTable::new();

/// Calls with a scene.
pub(crate) fn with<R>(
    scene: RhumbScene,
    call: impl FnOnce(&mut RemoteScene) -> Result<R, BindingError>,
) -> Result<R, BindingError> {
    SCENES.with(scene.id, |open| call(&mut open.remote))
}

/// Calls with a scene, and with the requests of other members that may still be answered.
pub(crate) fn with_requests<R>(
    scene: RhumbScene,
    call: impl FnOnce(&mut RemoteScene, &mut OpenRequests) -> Result<R, BindingError>,
) -> Result<R, BindingError> {
    SCENES.with(scene.id, |open| call(&mut open.remote, &mut open.requests))
}

/// Makes plain options: the scene is created unless it exists, with 60 ticks a second in lockstep, under the earth's
/// gravity; copies are within 5 cm; coordinates are Rhumb's.
///
/// # Safety
///
/// `options` points to memory for a `RhumbJoinOptions`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_join_options_init(options: *mut RhumbJoinOptions) -> RhumbCode {
    let plain = JoinParams::default();
    let plain = RhumbJoinOptions {
        coordinates: 0,
        condition: 0,
        tolerance_m: plain.tolerance_m,
        stepping: 0,
        ticks_per_second: plain.ticks_per_second,
        substeps: plain.substeps,
        publish_interval: plain.publish_interval,
        has_gravity: 0,
        smooth: u8::from(plain.smooth),
        has_resume_within: 0,
        cells: u8::from(plain.cells),
        gravity: [0.0; 3],
        delay_ticks: plain.delay_ticks,
        lead_ticks: plain.lead_ticks,
        whole_ticks: u8::from(plain.whole_ticks),
        refusals: 0,
        resume_within_s: 0.0,
        sleep: RhumbSleep::Default as u32,
        sleep_speed: 0.0,
        sleep_angular_speed: 0.0,
        sleep_seconds: 0.0,
    };
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(options, plain, "options") })
}

impl RhumbJoinOptions {
    fn params(&self) -> Result<JoinParams, BindingError> {
        let resume_within = match self.has_resume_within {
            0 => None,
            _ => Some(seconds(self.resume_within_s, "options.resume_within_s")?),
        };
        let thresholds = [
            self.sleep_speed,
            self.sleep_angular_speed,
            self.sleep_seconds,
        ];
        Ok(JoinParams {
            coordinates: one_of(&COORDINATES, self.coordinates, "options.coordinates")?,
            condition: one_of(&CONDITIONS, self.condition, "options.condition")?,
            tolerance_m: self.tolerance_m,
            cells: self.cells != 0,
            stepping: one_of(&STEPPINGS, self.stepping, "options.stepping")?,
            ticks_per_second: self.ticks_per_second,
            substeps: self.substeps,
            publish_interval: self.publish_interval,
            gravity: (self.has_gravity != 0).then_some(Vec3::from_array(self.gravity)),
            delay_ticks: self.delay_ticks,
            lead_ticks: self.lead_ticks,
            whole_ticks: self.whole_ticks != 0,
            refusals: one_of(&REFUSALS, self.refusals, "options.refusals")?,
            smooth: self.smooth != 0,
            resume_within,
            sleep: sleep(self.sleep, thresholds, "options.sleep")?.unwrap_or_default(),
        })
    }
}

/// Joins a scene, and returns when the copy of the scene is complete. The connection's handle is closed from then on, also
/// after an error of the server; wrong arguments leave it open.
///
/// `options` may be null: then they are as from `rhumb_join_options_init`.
///
/// # Safety
///
/// `name` is a text that ends with a zero byte; `options` and `scene` point to what their types say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_join(
    connection: RhumbConnection,
    name: *const c_char,
    options: *const RhumbJoinOptions,
    scene: *mut RhumbScene,
) -> RhumbCode {
    guard(|| {
        check_out(scene, "scene")?;
        // SAFETY: the caller promises what the pointers point to.
        let name = unsafe { text(name, "name") }?;
        let params = match options.is_null() {
            true => JoinParams::default(),
            // SAFETY: as above.
            false => unsafe { value(options, "options") }?.params()?,
        };
        params.options()?;
        let HeldConnection { connection, server } = take_for(connection, name)?;
        let mut joined = RemoteScene::join(connection, name, &params)?;
        if let Some(server) = server {
            joined = joined.of(server, name);
        }
        let id = SCENES.insert(HeldScene {
            remote: joined,
            requests: OpenRequests::default(),
        });
        // SAFETY: as above.
        unsafe { write(scene, RhumbScene { id }, "scene") }
    })
}

/// Leaves the scene and closes its connection and handle. Commands that were sent before are delivered.
///
/// A call of another thread with the same handle ends as if nothing had happened.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_close(scene: RhumbScene) -> RhumbCode {
    guard(|| SCENES.remove(scene.id).map(drop))
}

/// Deletes the scene for all of its clients, and waits for the answer. The handle stays open until it is closed.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_delete(scene: RhumbScene) -> RhumbCode {
    guard(|| with(scene, RemoteScene::delete))
}

/// Queues the addition of `count` bodies, and writes their ids to `bodies` in the same order. If one is wrong, none is
/// added.
///
/// Queued commands are sent together, by the next call that waits or by `rhumb_scene_flush`. If the server refuses one, the
/// next advance, wait or poll is `RHUMB_CODE_REFUSED`. An event reports what became of each. Equal shapes are sent once.
///
/// # Safety
///
/// `descs` points to `count` descriptions, each with the points and triangles that its shape names; `bodies` points to
/// memory for `count` ids.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_add_bodies(
    scene: RhumbScene,
    descs: *const RhumbBodyDesc,
    count: usize,
    bodies: *mut RhumbBody,
) -> RhumbCode {
    guard(|| {
        if count > 0 {
            check_out(bodies, "bodies")?;
        }
        // SAFETY: the caller promises the descriptions, and what their shapes point to.
        let params = unsafe {
            let descs = elements(descs, count, "descs")?;
            let params = descs.iter().map(|desc| desc.params());
            params.collect::<Result<Vec<_>, _>>()?
        };
        let ids = with(scene, |scene| scene.add_bodies(&params))?;
        let words: Vec<_> = ids.into_iter().map(|id| RhumbBody(packed_id(id))).collect();
        // SAFETY: the caller promises memory for `count` ids.
        unsafe { copy_out(bodies, count, &words, "bodies") }
    })
}

/// Queues the removal of the shapes that came with this client's bodies and that no body has any more. A scene holds a
/// limited number of bytes of shapes, and keeps them until they are removed.
///
/// Queued additions, changes and removals of bodies count. `count` may be null; otherwise it receives the number of shapes.
///
/// # Safety
///
/// `count` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_remove_unused_shapes(
    scene: RhumbScene,
    count: *mut usize,
) -> RhumbCode {
    guard(|| {
        let removed = with(scene, RemoteScene::remove_unused_shapes)?;
        // SAFETY: the caller promises the memory.
        unsafe { write_if_wanted(count, removed, "count") }
    })
}

/// Sends all queued commands at once.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_flush(scene: RhumbScene) -> RhumbCode {
    guard(|| {
        with(scene, |scene| {
            scene.flush();
            Ok(())
        })
    })
}

/// Steps a lockstep scene once, and computes the view.
///
/// At depth 0, the view is of the tick that this call requests. At depth 1, it is of the tick before, and the server
/// computes the requested one meanwhile. A greater depth, up to 64, hides a link whose round trip is longer than a
/// tick. `tick` may be null; otherwise it receives the tick of the view.
///
/// After `RHUMB_CODE_TIMEOUT`, `rhumb_scene_wait` continues to wait for the same tick. After `RHUMB_CODE_REFUSED`, the tick
/// is done and its view computed.
///
/// # Safety
///
/// `tick` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_advance(
    scene: RhumbScene,
    depth: u32,
    tick: *mut u64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the memory.
        unsafe {
            step(scene, tick, |scene| {
                scene.advance(PipelineDepth::new(depth))
            })
        }
    })
}

/// Waits for the tick that the last `rhumb_scene_advance` requested, and computes the view.
///
/// # Safety
///
/// `tick` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_wait(
    scene: RhumbScene,
    depth: u32,
    tick: *mut u64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the memory.
        unsafe { step(scene, tick, |scene| scene.wait(PipelineDepth::new(depth))) }
    })
}

/// Steps a scene, and writes the tick of the view: also beside refusals, for its view is computed then.
///
/// # Safety
///
/// `tick` is null or points to memory for a number.
unsafe fn step(
    scene: RhumbScene,
    tick: *mut u64,
    call: impl FnOnce(&mut RemoteScene) -> Result<Tick, BindingError>,
) -> Result<(), BindingError> {
    let (stepped, shown) = with(scene, |scene| {
        let stepped = call(scene);
        Ok((stepped, scene.time().tick))
    })?;
    if matches!(stepped, Ok(_) | Err(BindingError::Refused { .. })) {
        // SAFETY: the caller promises the memory.
        unsafe { write_if_wanted(tick, shown.value(), "tick") }?;
    }
    stepped.map(|_| ())
}

/// Computes the view of a free-running scene for the present moment, and does not wait. A lockstep scene stands still until
/// a client advances it. `time` may be null. After `RHUMB_CODE_REFUSED`, the view is computed.
///
/// # Safety
///
/// `time` is null or points to memory for a `RhumbTime`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll(scene: RhumbScene, time: *mut RhumbTime) -> RhumbCode {
    guard(|| {
        let (polled, shown) = with(scene, |scene| {
            let polled = scene.poll();
            Ok((polled, scene.time()))
        })?;
        let shown = RhumbTime {
            tick: shown.tick.value(),
            fraction: shown.fraction,
        };
        if matches!(polled, Ok(_) | Err(BindingError::Refused { .. })) {
            // SAFETY: the caller promises the memory.
            unsafe { write_if_wanted(time, shown, "time") }?;
        }
        polled.map(|_| ())
    })
}

/// Handles what arrives for a time in seconds, without computing the view.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_idle(scene: RhumbScene, duration_s: f64) -> RhumbCode {
    guard(|| {
        let duration = seconds(duration_s, "duration_s")?;
        with(scene, |scene| scene.idle(duration))
    })
}

/// Writes how far any point of each of `count` bodies, as the view shows them, may be from its true place at the moment of
/// the view, in the scene's unit of length. `rhumb_scene_poses` lends the bodies of the view.
///
/// A bound is infinite while nothing finite is known: a packet that may hold an update of the body is missing, or a
/// free-running view shows a moment of which the news has not arrived. With `delay_ticks` of the network's delay and a
/// little more, it is finite. A body that is not in the view is `RHUMB_CODE_INVALID`.
///
/// # Safety
///
/// `bodies` points to `count` ids, `bounds` to memory for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_error_bounds(
    scene: RhumbScene,
    bodies: *const RhumbBody,
    count: usize,
    bounds: *mut f32,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the ids.
        let bodies = unsafe { elements(bodies, count, "bodies") }?;
        let values = with(scene, |scene| {
            let bound = |body: &RhumbBody| scene.error_bound(parse_packed_id(body.0)?);
            bodies.iter().map(bound).collect::<Result<Vec<_>, _>>()
        })?;
        // SAFETY: the caller promises memory for `count` numbers.
        unsafe { copy_out(bounds, count, &values, "bounds") }
    })
}

/// Writes how far any point of each of `count` bodies may be off at a tick by what is known of them, whatever the view
/// shows, in the scene's unit of length. A body that the copy does not have is `RHUMB_CODE_INVALID`.
///
/// # Safety
///
/// `bodies` points to `count` ids, `bounds` to memory for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_tick_error_bounds(
    scene: RhumbScene,
    tick: u64,
    bodies: *const RhumbBody,
    count: usize,
    bounds: *mut f32,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the ids.
        let bodies = unsafe { elements(bodies, count, "bodies") }?;
        let values = with(scene, |scene| {
            let bound = |body: &RhumbBody| {
                scene.tick_error_bound(parse_packed_id(body.0)?, Tick::new(tick))
            };
            bodies.iter().map(bound).collect::<Result<Vec<_>, _>>()
        })?;
        // SAFETY: the caller promises memory for `count` numbers.
        unsafe { copy_out(bounds, count, &values, "bounds") }
    })
}

/// Sets the ticks by which bodies under authority are published ahead of the server's clock, in place of `lead_ticks` of
/// the options: 0 to 3,600.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_set_lead_ticks(scene: RhumbScene, ticks: f64) -> RhumbCode {
    guard(|| with(scene, |scene| scene.set_lead_ticks(ticks)))
}

/// Writes the statistics of the client.
///
/// # Safety
///
/// `statistics` points to memory for a `RhumbStatistics`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_statistics(
    scene: RhumbScene,
    statistics: *mut RhumbStatistics,
) -> RhumbCode {
    guard(|| {
        let now = with(scene, |scene| Ok(scene.statistics()))?;
        let now = RhumbStatistics {
            sent_bytes: now.wire.sent_bytes,
            received_bytes: now.wire.received_bytes,
            updates: now.stream.updates,
            complete_tick: now.complete.value(),
            upstream_updates: now.upstream.updates,
            upstream_packets: now.upstream.packets,
            upstream_bytes: now.upstream.bytes,
            events_left_out: now.events_left_out,
            contacts_left_out: now.contacts_left_out,
        };
        // SAFETY: the caller promises the memory.
        unsafe { write(statistics, now, "statistics") }
    })
}

/// Queues a command, and writes its number.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
pub(crate) unsafe fn send(
    scene: RhumbScene,
    command: Command,
    last: *mut u64,
) -> Result<(), BindingError> {
    // SAFETY: the caller promises the memory.
    unsafe { send_all(scene, vec![command], last) }
}

/// Queues commands, and writes the number of the last, if there are any.
///
/// # Safety
///
/// As [`send`].
pub(crate) unsafe fn send_all(
    scene: RhumbScene,
    commands: Vec<Command>,
    last: *mut u64,
) -> Result<(), BindingError> {
    match with(scene, |scene| scene.command(commands))? {
        // SAFETY: the caller promises the memory.
        Some(number) => unsafe { write_if_wanted(last, number, "last") },
        None => Ok(()),
    }
}

/// The address of the page that shows the scene to browsers of this machine, until the scene is closed. Its server must be in
/// this process.
///
/// # Safety
///
/// `address` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_page(
    scene: RhumbScene,
    address: *mut RhumbAddress,
) -> RhumbCode {
    guard(|| {
        check_out(address, "address")?;
        let text = copy_text(&with(scene, RemoteScene::page)?);
        // SAFETY: the caller promises the memory.
        unsafe { write(address, RhumbAddress { text }, "address") }
    })
}

/// Saves a scene with everything that this client has sent. Scenes that `rhumb_local_server_restore` makes of it run to the
/// same bits, given the same commands before the same ticks. The scene's server must be in this process.
///
/// # Safety
///
/// `checkpoint` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_save(
    scene: RhumbScene,
    checkpoint: *mut RhumbCheckpoint,
) -> RhumbCode {
    guard(|| {
        check_out(checkpoint, "checkpoint")?;
        let id = CHECKPOINTS.insert(with(scene, RemoteScene::save)?);
        // SAFETY: the caller promises the memory.
        unsafe { write(checkpoint, RhumbCheckpoint { id }, "checkpoint") }
    })
}

/// The arrays of a view. They have one order, which changes from view to view.
///
/// The pointers are valid until the next call with this scene that computes a view (advance, wait, poll) or closes it.
/// Copy what you keep longer. All are aligned for their type, and not null, also for no bodies.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbPoses {
    /// The tick at or before the moment of the view.
    pub tick: u64,
    /// Part of the step to the next tick, 0 to 1.
    pub fraction: f64,
    /// Number of bodies.
    pub count: usize,
    /// The bodies.
    pub bodies: *const RhumbBody,
    /// Centres of mass, or origins of this client's hulls and compounds: x, y, z for each body, in the scene's unit of
    /// length.
    pub positions: *const f32,
    /// Rotations body to world: x, y, z, w for each body.
    pub rotations: *const f32,
    /// Velocities of centres of mass: x, y, z for each body, units of length per second.
    pub linear_velocities: *const f32,
    /// Spins about world axes: x, y, z for each body, rad/s.
    pub angular_velocities: *const f32,
    /// One byte for each body; not zero: it rests, and its pose does not change until it wakes.
    pub resting: *const u8,
    /// Places of the bodies whose pose differs from that of the last view.
    pub changed: *const u32,
    /// Number of these places.
    pub changed_count: usize,
    /// Bodies of the last view that are not in this one: removed, or in no cell that is taken.
    pub removed: *const RhumbBody,
    /// Number of these bodies.
    pub removed_count: usize,
}

/// Buffers of a caller for the arrays of a view. A null pointer leaves an array out.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbPoseBuffers {
    /// Bodies that each buffer has room for.
    pub capacity: usize,
    /// One for each body.
    pub bodies: *mut RhumbBody,
    /// Three for each body.
    pub positions: *mut f32,
    /// Four for each body.
    pub rotations: *mut f32,
    /// Three for each body.
    pub linear_velocities: *mut f32,
    /// Three for each body.
    pub angular_velocities: *mut f32,
    /// One for each body.
    pub resting: *mut u8,
}

/// Lends the arrays of the view that the last advance, wait or poll computed.
///
/// In Rhumb's own coordinates, these are the client's own arrays of poses. In others, they are converted by this call.
///
/// # Safety
///
/// `poses` points to memory for a `RhumbPoses`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poses(scene: RhumbScene, poses: *mut RhumbPoses) -> RhumbCode {
    guard(|| {
        check_out(poses, "poses")?;
        let lent = with(scene, |scene| Ok(lend(scene)))?;
        // SAFETY: the caller promises the memory.
        unsafe { write(poses, lent, "poses") }
    })
}

fn lend(scene: &mut RemoteScene) -> RhumbPoses {
    let time = scene.time();
    RhumbPoses {
        tick: time.tick.value(),
        fraction: time.fraction,
        count: scene.count(),
        bodies: scene.bodies().as_ptr().cast(),
        positions: scene.positions().as_ptr().cast(),
        rotations: scene.rotations().as_ptr().cast(),
        linear_velocities: scene.linear_velocities().as_ptr().cast(),
        angular_velocities: scene.angular_velocities().as_ptr().cast(),
        resting: scene.resting().as_ptr().cast(),
        changed_count: scene.changed().len(),
        changed: scene.changed().as_ptr(),
        removed_count: scene.removed().len(),
        removed: scene.removed().as_ptr().cast(),
    }
}

/// Writes the arrays of the view to buffers of the caller. `count` receives the number of bodies, also if the buffers are
/// too small; then nothing is written to them.
///
/// # Safety
///
/// `buffers` points to a `RhumbPoseBuffers` whose pointers are null or have room for `capacity` bodies; `count` points to
/// memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_copy_poses(
    scene: RhumbScene,
    buffers: *const RhumbPoseBuffers,
    count: *mut usize,
) -> RhumbCode {
    guard(|| {
        check_out(count, "count")?;
        // SAFETY: the caller promises the buffers.
        let buffers = unsafe { value(buffers, "buffers") }?;
        with(scene, |scene| {
            // SAFETY: the caller promises memory for a number, and the buffers.
            unsafe {
                write(count, scene.count(), "count")?;
                copy(scene, buffers)
            }
        })
    })
}

/// # Safety
///
/// The pointers of `buffers` are null or have room for `capacity` bodies.
unsafe fn copy(scene: &mut RemoteScene, buffers: &RhumbPoseBuffers) -> Result<(), BindingError> {
    let capacity = buffers.capacity;
    let is_wanted = |pointer: *mut f32| !pointer.is_null();
    // An array of an odd buffer would otherwise be written before the error of the next one.
    if scene.count() > capacity {
        let needed = scene.count();
        return Err(BindingError::TooSmall { capacity, needed });
    }
    // SAFETY: each buffer has room for `capacity` bodies, and for as many numbers of each body as its array type has.
    unsafe {
        if !buffers.bodies.is_null() {
            let to = buffers.bodies.cast();
            copy_out(to, capacity, scene.bodies(), "buffers.bodies")?;
        }
        if is_wanted(buffers.positions) {
            copy_floats(buffers.positions, scene.positions(), "buffers.positions")?;
        }
        if is_wanted(buffers.rotations) {
            copy_floats(buffers.rotations, scene.rotations(), "buffers.rotations")?;
        }
        if is_wanted(buffers.linear_velocities) {
            let to = buffers.linear_velocities;
            copy_floats(to, scene.linear_velocities(), "buffers.linear_velocities")?;
        }
        if is_wanted(buffers.angular_velocities) {
            let to = buffers.angular_velocities;
            copy_floats(to, scene.angular_velocities(), "buffers.angular_velocities")?;
        }
        if !buffers.resting.is_null() {
            let to = buffers.resting.cast();
            copy_out(to, capacity, scene.resting(), "buffers.resting")?;
        }
    }
    Ok(())
}

/// Copies vectors or quaternions as floats.
///
/// # Safety
///
/// A pointer that is not misaligned points to memory for all floats of `values`.
unsafe fn copy_floats<T: Copy>(
    pointer: *mut f32,
    values: &[T],
    argument: &'static str,
) -> Result<(), BindingError> {
    let count = size_of_val(values) / size_of::<f32>();
    // SAFETY: glam's vectors and quaternions are three or four floats in memory, without a gap and initialised.
    let floats = unsafe { std::slice::from_raw_parts(values.as_ptr().cast::<f32>(), count) };
    // SAFETY: the caller promises the memory.
    unsafe { copy_out(pointer, count, floats, argument) }
}

/// Writes the place of a body in the arrays of the view. A body that is not in it is `RHUMB_CODE_INVALID`.
///
/// # Safety
///
/// `place` points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_place(
    scene: RhumbScene,
    body: RhumbBody,
    place: *mut usize,
) -> RhumbCode {
    guard(|| {
        check_out(place, "place")?;
        let id = parse_packed_id(body.0)?;
        let found = with(scene, |scene| scene.place(id))?;
        // SAFETY: the caller promises the memory.
        unsafe { write(place, found, "place") }
    })
}
