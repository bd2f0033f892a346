//! Robots and scenes from files.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::{Base, BindingError, LoadParams, LoadedFile, OwnContacts, packed_id};

use crate::border::{
    HandleTable, RhumbCode, check_out, copy_text, guard, one_of, optional_text, text, value, write,
};
use crate::descriptions::RhumbBody;
use crate::scene::{RhumbScene, with};

/// Bytes of a name, with the zero byte that ends it.
pub const RHUMB_NAME_BYTES: usize = 128;
/// Bytes of a note, with the zero byte that ends it.
pub const RHUMB_NOTE_BYTES: usize = 512;

/// How a file is read, and where its bodies are added. Begin with `rhumb_load_options_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLoadOptions {
    /// Where the root or the world of the file begins.
    pub position: [f32; 3],
    /// The file's axes, its up upward, to the world.
    pub rotation: [f32; 4],
    /// Root of a robot: 0 as in the file, 1 fixed, 2 free.
    pub base: u32,
    /// Contacts between parts of one robot: 0 as other programs read the file, 1 all that no joint connects.
    pub own_contacts: u32,
    /// Folders that are searched for package:// names, with a semicolon between them; or null.
    pub packages: *const c_char,
    /// Of bodies whose file gives shapes but no mass, kg/m³.
    pub density: f32,
    /// Number of the collision group, below 32, that the parts of a robot share.
    pub group: u32,
    /// Not zero: `first_joint` is the number of the first joint. Zero: the least that are free.
    pub has_first_joint: u8,
    /// Number of the first joint.
    pub first_joint: u32,
}

/// A file that was added to a scene. All zeros is none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLoaded {
    /// Its number.
    pub id: u64,
}

/// How much a file became.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLoadedCounts {
    /// Bodies.
    pub bodies: usize,
    /// Joints.
    pub joints: usize,
    /// Notes on what the file says and the scene has not.
    pub left_out: usize,
}

/// A body of a file.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLoadedBody {
    /// The body.
    pub body: RhumbBody,
    /// Where the file's frame of it is, from its centre of mass and in its axes.
    pub frame_position: [f32; 3],
    /// The file's frame of it to the body.
    pub frame_rotation: [f32; 4],
    /// Its name in the file, in UTF-8; a longer one is cut, and ends with # and its place.
    pub name: [c_char; 128],
}

/// A joint of a file.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLoadedJoint {
    /// Its number.
    pub joint: u32,
    /// Its name in the file, in UTF-8; a longer one is cut, and ends with # and its place.
    pub name: [c_char; 128],
}

/// A sentence about what a file says and a scene has not, or has by something near to it.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbNote {
    /// UTF-8 that ends with a zero byte; a longer one is cut.
    pub text: [c_char; 512],
}

/// A name; one that has no room is cut and ends with its place, so that no two become equal.
fn name_at(name: &str, place: usize) -> [c_char; RHUMB_NAME_BYTES] {
    if name.len() < RHUMB_NAME_BYTES {
        return copy_text(name);
    }
    let mark = format!("#{place}");
    let end = name.floor_char_boundary(RHUMB_NAME_BYTES - 1 - mark.len());
    copy_text(&format!("{}{mark}", &name[..end]))
}

static LOADED: HandleTable<LoadedFile> = HandleTable::new();
const BASES: [Base; 3] = [Base::AsFile, Base::Fixed, Base::Free];
const OWN_CONTACTS: [OwnContacts; 2] = [OwnContacts::AsFile, OwnContacts::All];

/// Makes plain options: at the origin, all as in the file.
///
/// # Safety
///
/// `options` points to memory for a `RhumbLoadOptions`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_load_options_init(options: *mut RhumbLoadOptions) -> RhumbCode {
    let plain = LoadParams::default();
    let plain = RhumbLoadOptions {
        position: plain.position.to_array(),
        rotation: plain.rotation.to_array(),
        base: 0,
        own_contacts: 0,
        packages: std::ptr::null(),
        density: plain.density,
        group: u32::from(plain.group),
        has_first_joint: 0,
        first_joint: 0,
    };
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(options, plain, "options") })
}

impl RhumbLoadOptions {
    /// # Safety
    ///
    /// `packages` is null or a text that ends with a zero byte.
    unsafe fn params(&self) -> Result<LoadParams, BindingError> {
        // SAFETY: the caller promises the text.
        let packages = unsafe { optional_text(self.packages, "options.packages") }?;
        let group = u8::try_from(self.group).unwrap_or(u8::MAX);
        Ok(LoadParams {
            position: Vec3::from_array(self.position),
            rotation: Quat::from_array(self.rotation),
            base: one_of(&BASES, self.base, "options.base")?,
            own_contacts: one_of(&OWN_CONTACTS, self.own_contacts, "options.own_contacts")?,
            packages: packages
                .into_iter()
                .flat_map(|all| all.split(';').filter(|one| !one.is_empty()))
                .map(str::to_owned)
                .collect(),
            density: self.density,
            group,
            first_joint: (self.has_first_joint != 0).then_some(self.first_joint),
        })
    }
}

/// Adds a robot or a scene from a file: URDF, MJCF with their meshes, glTF, or Rhumb's JSON.
///
/// The result lists what the file says and a scene has not. A file that cannot be read is `RHUMB_CODE_INVALID`, with
/// file and line in `rhumb_last_error`, and nothing is added. Gravity and ticks are the scene's. `options` may be null.
///
/// # Safety
///
/// `path` and the texts of `options` end with a zero byte; `options` and `loaded` point to what their types say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_load(
    scene: RhumbScene,
    path: *const c_char,
    options: *const RhumbLoadOptions,
    loaded: *mut RhumbLoaded,
) -> RhumbCode {
    guard(|| {
        check_out(loaded, "loaded")?;
        // SAFETY: the caller promises what the pointers point to.
        let path = unsafe { text(path, "path") }?;
        let params = match options.is_null() {
            true => LoadParams::default(),
            // SAFETY: as above.
            false => unsafe { value(options, "options")?.params() }?,
        };
        let id = LOADED.insert(with(scene, |scene| scene.load(path, &params))?);
        // SAFETY: as above.
        unsafe { write(loaded, RhumbLoaded { id }, "loaded") }
    })
}

/// The numbers of bodies, joints and notes.
///
/// # Safety
///
/// `counts` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_loaded_counts(
    loaded: RhumbLoaded,
    counts: *mut RhumbLoadedCounts,
) -> RhumbCode {
    guard(|| {
        check_out(counts, "counts")?;
        let found = LOADED.with(loaded.id, |file| {
            Ok(RhumbLoadedCounts {
                bodies: file.bodies.len(),
                joints: file.joints.len(),
                left_out: file.left_out.len(),
            })
        })?;
        // SAFETY: the caller promises the memory.
        unsafe { write(counts, found, "counts") }
    })
}

/// One of several of a file, by its place.
fn at<T>(all: &[T], place: usize) -> Result<&T, BindingError> {
    let needed = || BindingError::value("place", place, format_args!("below {}", all.len()));
    all.get(place).ok_or_else(needed)
}

/// A body by its place; those that others hold come after them.
///
/// # Safety
///
/// `body` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_loaded_body(
    loaded: RhumbLoaded,
    place: usize,
    body: *mut RhumbLoadedBody,
) -> RhumbCode {
    guard(|| {
        check_out(body, "body")?;
        let found = LOADED.with(loaded.id, |file| {
            let one = at(&file.bodies, place)?;
            Ok(RhumbLoadedBody {
                body: RhumbBody(packed_id(one.id)),
                frame_position: one.frame_position.to_array(),
                frame_rotation: one.frame_rotation.to_array(),
                name: name_at(&one.name, place),
            })
        })?;
        // SAFETY: the caller promises the memory.
        unsafe { write(body, found, "body") }
    })
}

/// A joint by its place.
///
/// # Safety
///
/// `joint` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_loaded_joint(
    loaded: RhumbLoaded,
    place: usize,
    joint: *mut RhumbLoadedJoint,
) -> RhumbCode {
    guard(|| {
        check_out(joint, "joint")?;
        let found = LOADED.with(loaded.id, |file| {
            let one = at(&file.joints, place)?;
            Ok(RhumbLoadedJoint {
                joint: one.id.0,
                name: name_at(&one.name, place),
            })
        })?;
        // SAFETY: the caller promises the memory.
        unsafe { write(joint, found, "joint") }
    })
}

/// A note by its place.
///
/// # Safety
///
/// `note` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_loaded_note(
    loaded: RhumbLoaded,
    place: usize,
    note: *mut RhumbNote,
) -> RhumbCode {
    guard(|| {
        check_out(note, "note")?;
        let text = LOADED.with(loaded.id, |file| Ok(copy_text(at(&file.left_out, place)?)))?;
        // SAFETY: the caller promises the memory.
        unsafe { write(note, RhumbNote { text }, "note") }
    })
}

/// Closes the handle of a file. Its bodies stay in the scene.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_loaded_close(loaded: RhumbLoaded) -> RhumbCode {
    guard(|| LOADED.remove(loaded.id).map(drop))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_have_no_room_stay_apart() {
        let read = |place| {
            let name = name_at(&"ä".repeat(100), place);
            let bytes: Vec<u8> = name.iter().map(|sign| sign.cast_unsigned()).collect();
            let end = bytes
                .iter()
                .position(|byte| *byte == 0)
                .expect("a zero byte ends it");
            String::from_utf8(bytes[..end].to_vec()).expect("UTF-8")
        };
        assert_eq!(read(7), format!("{}#7", "ä".repeat(62)));
        assert!(read(7) != read(8) && read(1_000_000).ends_with("ä#1000000"));
        assert_eq!(name_at("arm", 3), copy_text::<RHUMB_NAME_BYTES>("arm"));
    }
}
