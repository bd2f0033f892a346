//! Authority over bodies that the application moves.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::{BindingError, StateRecord, parse_packed_id};

use crate::border::{elements, guard, write_if_wanted};
use crate::descriptions::RhumbBody;
use crate::scene::{RhumbScene, with};
use crate::status::RhumbCode;

/// State of a body that the application moves.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbBodyState {
    /// The body.
    pub body: RhumbBody,
    /// Centre of mass, or the origin of a hull or compound that this client added, in the scene's unit of length.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// Velocity of the centre of mass, units of length per second.
    pub linear_velocity: [f32; 3],
    /// Spin about world axes, rad/s.
    pub angular_velocity: [f32; 3],
}

/// Requests authority over `count` kinematic bodies, in place of the bodies that this client has authority over now. None
/// ends the authority.
///
/// One client has authority over 256 bodies at most; more are `RHUMB_CODE_INVALID`. The server's bodies are then within the
/// tolerance, metres in any coordinates, of the states of `rhumb_scene_publish`. The tolerance of a stream adds to it: a
/// client that follows these bodies within 0.05 m sees them within 0.07 m of the publisher's if that one's is 0.02 m.
///
/// It is sent at once. An event, `RHUMB_EVENT_KIND_AUTHORITY_GRANTED` or `RHUMB_EVENT_KIND_AUTHORITY_DENIED`, answers; a
/// denial is also `RHUMB_CODE_REFUSED` of the next advance, wait or poll. A second request before the answer is
/// `RHUMB_CODE_INVALID`.
///
/// # Safety
///
/// `bodies` points to `count` ids.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_take_authority(
    scene: RhumbScene,
    bodies: *const RhumbBody,
    count: usize,
    tolerance_m: f64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the ids.
        let bodies = unsafe { elements(bodies, count, "bodies") }?;
        let ids = bodies.iter().map(|body| parse_packed_id(body.0));
        let ids = ids.collect::<Result<Vec<_>, _>>()?;
        with(scene, |scene| scene.take_authority(&ids, tolerance_m))
    })
}

/// Publishes the present states of the bodies under this client's authority; call it once per frame. A body that is left
/// out stands still.
///
/// `published` may be null; otherwise it receives zero if nothing is published yet: before the authority is granted, before
/// the server's clock is known, and for a second frame of one tick. `tick` may be null; otherwise it receives the tick of
/// the states if they are published: in lockstep that of the next `rhumb_scene_advance`.
///
/// # Safety
///
/// `states` points to `count` states; `published` and `tick` are null or point to memory for their types.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_publish(
    scene: RhumbScene,
    states: *const RhumbBodyState,
    count: usize,
    published: *mut u8,
    tick: *mut u64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the states.
        let states = unsafe { elements(states, count, "states") }?;
        let records = states.iter().map(RhumbBodyState::record);
        let records = records.collect::<Result<Vec<_>, _>>()?;
        let at = with(scene, |scene| scene.publish(&records))?;
        // SAFETY: the caller promises the memory.
        unsafe {
            write_if_wanted(published, u8::from(at.is_some()), "published")?;
            match at {
                Some(at) => write_if_wanted(tick, at.value(), "tick"),
                None => Ok(()),
            }
        }
    })
}

impl RhumbBodyState {
    fn record(&self) -> Result<StateRecord, BindingError> {
        Ok(StateRecord {
            body: parse_packed_id(self.body.0)?,
            position: Vec3::from_array(self.position),
            rotation: Quat::from_array(self.rotation),
            linear_velocity: Vec3::from_array(self.linear_velocity),
            angular_velocity: Vec3::from_array(self.angular_velocity),
        })
    }
}
