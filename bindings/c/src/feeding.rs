//! Scenes that the caller feeds: states in, requests of other members out.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::{BodyId, Tick};
use rhumb_bindings::{BindingError, FedArrays, OwnServer, RequestRecord, Rows, packed_id};

use crate::border::{
    RhumbCode, check_out, copy_text, elements, guard, optional_text, text, value, write,
    write_if_wanted,
};
use crate::connection::{FREE_PORT, RhumbLocalServer, insert_server, reach, server_of};
use crate::connection::{RhumbConnection, insert, time_limit};
use crate::descriptions::RhumbBody;
use crate::files::RHUMB_NAME_BYTES;
use crate::generated::RhumbRequestKind;
use crate::scene::{RhumbScene, with, with_requests};

/// Connects the client that will feed a scene: one whose engine is the caller's.
///
/// The client makes the scene when it joins by this name, adds bodies, and hands their states over by
/// `rhumb_scene_feed`, once for each step of its engine. Other clients follow the scene as any other, each within its
/// own tolerance. The scene ends with the client. A server of `rhumb_serve` is `RHUMB_CODE_INVALID`: use
/// `rhumb_serve_fed`. `timeout_s` is as that of RhumbConnectOptions.
///
/// # Safety
///
/// `name` is a text that ends with a zero byte; `connection` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local_server_feed(
    server: RhumbLocalServer,
    name: *const c_char,
    timeout_s: f64,
    connection: *mut RhumbConnection,
) -> RhumbCode {
    guard(|| {
        check_out(connection, "connection")?;
        // SAFETY: the caller promises the text.
        let name = unsafe { text(name, "name") }?;
        let timeout = time_limit(timeout_s, "timeout_s")?;
        let server = server_of(server)?;
        let id = insert(server.feed(name, timeout)?, Some(server));
        // SAFETY: the caller promises the memory.
        unsafe { write(connection, RhumbConnection { id }, "connection") }
    })
}

/// Makes a server in this process of a scene that the caller will feed, by this name, and that other processes join. It has
/// threads of its own. `listen` and `open_to_network` are as those of `rhumb_serve`.
///
/// # Safety
///
/// `name` is a text that ends with a zero byte, `listen` null or such a text; `server` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_serve_fed(
    name: *const c_char,
    listen: *const c_char,
    open_to_network: u8,
    server: *mut RhumbLocalServer,
) -> RhumbCode {
    guard(|| {
        check_out(server, "server")?;
        // SAFETY: the caller promises the texts.
        let (name, listen) = unsafe { (text(name, "name")?, optional_text(listen, "listen")?) };
        let reach = reach(open_to_network)?;
        let made = OwnServer::fed(listen.unwrap_or(FREE_PORT), reach, name)?;
        let id = insert_server(made);
        // SAFETY: the caller promises the memory.
        unsafe { write(server, RhumbLocalServer { id }, "server") }
    })
}

/// States of bodies after a step of the caller's engine, as arrays. Begin with zeros.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbFedStates {
    /// The tick of the states, from 1 on; zero for the next one. Up to 600 ticks may be left out: bodies then go evenly from
    /// one state to the next.
    pub tick: u64,
    /// Number of bodies.
    pub count: usize,
    /// The bodies, each once, in any order.
    pub bodies: *const RhumbBody,
    /// Centres of mass, or origins of hulls and compounds that this client added: x, y, z for each body.
    pub positions: *const f32,
    /// Rotations body to world: x, y, z, w for each body. Null: none is turned.
    pub rotations: *const f32,
    /// Velocities of centres of mass: x, y, z for each body, units of length per second. Null: zero, or both follow from the
    /// poses where `angular_velocities` is null too.
    pub linear_velocities: *const f32,
    /// Spins about world axes: x, y, z for each body, rad/s. Null as above.
    pub angular_velocities: *const f32,
}

/// Hands over the states of one tick of a scene that this client feeds, and has the scene step. All arrays are copied.
///
/// A body that is left out rests where it is. So does one that is fed at one pose without a velocity for five ticks; resting
/// bodies cost nothing. Commands that were queued before act first. `tick` may be null; otherwise it receives the tick of the
/// states. A wrong value is `RHUMB_CODE_INVALID`, and nothing of the call is fed. `RHUMB_CODE_REFUSED` names what the scene
/// refused since the last call, commands of this client and requests that it accepted; the states are fed.
///
/// Followers see every pose within their tolerance. How many bytes that takes depends on gravity and substeps of
/// RhumbJoinOptions, and on mass, moments, damping and gravity scale of RhumbBodyDesc.
///
/// # Safety
///
/// `states` points to a `RhumbFedStates` whose arrays have the elements that it says; `tick` is null or points to
/// memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_feed(
    scene: RhumbScene,
    states: *const RhumbFedStates,
    tick: *mut u64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the states.
        let states = unsafe { value(states, "states") }?;
        // SAFETY: the caller promises the arrays.
        let arrays = unsafe { states.arrays() }?;
        let at = (states.tick != 0).then_some(Tick::new(states.tick));
        let (fed, newest) = with(scene, |scene| {
            let fed = scene.feed(at, &arrays);
            Ok((fed, scene.fed_tick()))
        })?;
        // Beside refusals the states are fed, too.
        if let (Ok(_) | Err(BindingError::Refused { .. }), Some(newest)) = (&fed, newest) {
            // SAFETY: the caller promises the memory.
            unsafe { write_if_wanted(tick, newest.value(), "tick") }?;
        }
        fed.map(|_| ())
    })
}

impl RhumbFedStates {
    /// # Safety
    ///
    /// The arrays have the elements that the header says, or are null.
    unsafe fn arrays(&self) -> Result<FedArrays<'_>, BindingError> {
        let count = self.count;
        // SAFETY: the caller promises the arrays. A `RhumbBody` is a number, and rows are numbers one after the other.
        unsafe {
            let rotations = optional_rows(self.rotations, count, "states.rotations")?;
            let linear = self.linear_velocities;
            let angular = self.angular_velocities;
            Ok(FedArrays {
                bodies: elements(self.bodies.cast(), count, "states.bodies")?,
                positions: Rows::Each(elements(self.positions.cast(), count, "states.positions")?),
                rotations: rotations.unwrap_or(Rows::All([0.0, 0.0, 0.0, 1.0])),
                linear_velocities: optional_rows(linear, count, "states.linear_velocities")?,
                angular_velocities: optional_rows(angular, count, "states.angular_velocities")?,
            })
        }
    }
}

/// Rows of an array that may be null.
///
/// # Safety
///
/// As [`elements`], for `count` rows.
unsafe fn optional_rows<'a, const WIDTH: usize>(
    pointer: *const f32,
    count: usize,
    argument: &'static str,
) -> Result<Option<Rows<'a, WIDTH>>, BindingError> {
    if pointer.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller promises the rows.
    let rows = unsafe { elements(pointer.cast(), count, argument) }?;
    Ok(Some(Rows::Each(rows)))
}

/// A command of another member, which has changed nothing yet. Fields that its kind does not name are zero.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbRequest {
    /// A `RhumbRequestKind`.
    pub kind: u32,
    /// Not zero: `point` is where a force or an impulse acts, and not the centre of mass.
    pub has_point: u8,
    /// Its number, for the answer.
    pub request: u64,
    /// The number of the member's command.
    pub number: u64,
    /// The body.
    pub body: RhumbBody,
    /// Centre of mass.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// Units of length per second.
    pub linear_velocity: [f32; 3],
    /// rad/s about world axes.
    pub angular_velocity: [f32; 3],
    /// A force, torque, impulse or gravity, in world axes.
    pub vector: [f32; 3],
    /// A point of the world.
    pub point: [f32; 3],
    /// The client that the member's token names, a text that ends with a zero byte; empty without one. A longer one is cut.
    pub client: [c_char; 128],
}

impl RhumbRequest {
    const NONE: Self = Self {
        kind: RhumbRequestKind::None as u32,
        has_point: 0,
        request: 0,
        number: 0,
        body: RhumbBody(0),
        position: [0.0; 3],
        rotation: [0.0; 4],
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        vector: [0.0; 3],
        point: [0.0; 3],
        client: [0; RHUMB_NAME_BYTES],
    };

    fn of(request: u64, record: &RequestRecord) -> Self {
        let client = record.request.client.as_deref();
        let word = |id: BodyId| RhumbBody(packed_id(id));
        Self {
            kind: RhumbRequestKind::of(record.kind) as u32,
            has_point: u8::from(record.point.is_some()),
            request,
            number: record.request.number,
            body: record.body.map_or(RhumbBody(0), word),
            position: record.position.unwrap_or_default().to_array(),
            rotation: record.rotation.map_or([0.0; 4], |turn| turn.to_array()),
            linear_velocity: record.linear_velocity.unwrap_or_default().to_array(),
            angular_velocity: record.angular_velocity.unwrap_or_default().to_array(),
            vector: record.vector.unwrap_or_default().to_array(),
            point: record.point.unwrap_or_default().to_array(),
            client: copy_text(client.unwrap_or_default()),
        }
    }
}

/// Takes the oldest unread request of another member of a scene that this client feeds. If there is none, the kind is
/// `RHUMB_REQUEST_KIND_NONE`. The last 65,536 that were read and not answered can still be answered.
///
/// # Safety
///
/// `request` points to memory for a `RhumbRequest`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll_request(
    scene: RhumbScene,
    request: *mut RhumbRequest,
) -> RhumbCode {
    guard(|| {
        check_out(request, "request")?;
        let read = with_requests(scene, |scene, open| {
            let record = scene.poll_request();
            Ok(record.map(|record| (open.keep(record.clone()), record)))
        })?;
        let read = read.map_or(RhumbRequest::NONE, |(number, record)| {
            RhumbRequest::of(number, &record)
        });
        // SAFETY: the caller promises the memory.
        unsafe { write(request, read, "request") }
    })
}

/// Changes the scene as another member asked; `request` is the field of that name. If the scene cannot, or the member
/// has left, the member is refused after all, and the next `rhumb_scene_feed` is `RHUMB_CODE_REFUSED`. A request that
/// was answered is `RHUMB_CODE_INVALID`.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_accept_request(scene: RhumbScene, request: u64) -> RhumbCode {
    guard(|| {
        with_requests(scene, |scene, open| {
            scene.accept_request(&open.take(request)?)
        })
    })
}

/// Refuses what another member asked for: it learns of it as of any refusal. A request that was answered is
/// `RHUMB_CODE_INVALID`.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_scene_refuse_request(scene: RhumbScene, request: u64) -> RhumbCode {
    guard(|| {
        with_requests(scene, |scene, open| {
            scene.refuse_request(&open.take(request)?)
        })
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use rhumb_bindings::Coordinates;
    use rhumb_bindings::rhumb_client::glam::Vec3;
    use rhumb_bindings::rhumb_client::scene::Command;
    use rhumb_bindings::rhumb_client::{FedRequest, FedVelocities, Peer};

    use super::*;

    #[test]
    fn a_request_keeps_its_numbers_and_its_client() {
        let (id, vector) = (BodyId::new(4, 1), Vec3::new(1.0, 2.0, 3.0));
        let command = Command::ImpulseAt {
            id,
            impulse: vector,
            point: -vector,
        };
        let request = FedRequest::new(Some("arm".into()), Peer(1), (9, command));
        let record = RequestRecord::new(request, Coordinates::Rhumb).expect("a request");
        let shown = RhumbRequest::of(5, &record);
        assert_eq!(shown.kind, RhumbRequestKind::ApplyImpulse as u32);
        assert_eq!((shown.request, shown.number), (5, 9));
        assert_eq!((shown.has_point, shown.body), (1, RhumbBody(packed_id(id))));
        assert_eq!(
            (shown.vector, shown.point),
            ([1.0, 2.0, 3.0], [-1.0, -2.0, -3.0])
        );
        // SAFETY: the text of a request ends with a zero byte.
        let client = unsafe { CStr::from_ptr(shown.client.as_ptr()) };
        assert_eq!(client, c"arm");
    }

    #[test]
    fn arrays_that_are_null_are_those_that_the_header_allows() {
        let (bodies, numbers) = ([RhumbBody(1), RhumbBody(2)], [0.0_f32; 8]);
        let mut states = RhumbFedStates {
            tick: 0,
            count: 2,
            bodies: bodies.as_ptr(),
            positions: numbers.as_ptr(),
            rotations: std::ptr::null(),
            linear_velocities: std::ptr::null(),
            angular_velocities: std::ptr::null(),
        };
        // SAFETY: each array is null or has numbers for two bodies.
        unsafe {
            let arrays = states.arrays().expect("they are right");
            assert_eq!(arrays.bodies, [1, 2]);
            assert_eq!(arrays.velocities(), FedVelocities::FromPoses);
            states.angular_velocities = numbers.as_ptr();
            let arrays = states.arrays().expect("they are right");
            assert_eq!(arrays.velocities(), FedVelocities::Given);
            states.positions = std::ptr::null();
            let error = states.arrays().expect_err("positions are needed");
            assert_eq!(error.to_string(), "states.positions must not be null");
        }
    }
}
