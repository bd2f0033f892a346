//! The arrays of a view, lent or written to buffers of the caller.

use rhumb_bindings::{BindingError, RemoteScene, parse_packed_id};

use crate::border::{RhumbCode, check_out, copy_out, guard, value, write};
use crate::descriptions::RhumbBody;
use crate::scene::{RhumbScene, with};

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
    /// Bodies that were removed since the last view.
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
