//! Commands as flat structs of C.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{ActiveEvents, Command};
use rhumb_bindings::{BindingError, parse_body_word};

use crate::border::{elements, guard, one_of, write_if_wanted};
use crate::descriptions::RhumbBody;
use crate::kinds::RhumbCommandKind;
use crate::scene::{RhumbScene, with};
use crate::status::RhumbCode;

/// Bit of `events`: contacts of the body begin and end.
pub const RHUMB_EVENTS_CONTACTS: u32 = 1;
/// Bit of `events`: the force of a contact is at least `event_force`, in each tick.
pub const RHUMB_EVENTS_FORCE: u32 = 2;
/// Bit of `events`: bodies enter and leave the sensor, or the body enters and leaves sensors.
pub const RHUMB_EVENTS_SENSORS: u32 = 4;
/// Bit of `events`: the body falls asleep and wakes.
pub const RHUMB_EVENTS_SLEEP: u32 = 8;

/// A command. Fields that its kind does not name are ignored. Units are kilograms, seconds, radians, and the scene's unit
/// of length.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCommand {
    /// A `RhumbCommandKind`.
    pub kind: u32,
    /// Bits of events.
    pub events: u32,
    /// The body.
    pub body: RhumbBody,
    /// Position, velocity, force, torque, impulse or gravity, in world axes.
    pub vector: [f32; 3],
    /// Where a force or an impulse acts, in world axes.
    pub point: [f32; 3],
    /// Angular velocity, rad/s about world axes.
    pub angular: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// Force from which on contacts are reported.
    pub event_force: f32,
}

/// Queues `count` commands, which are applied in this order before the next tick. If one is wrong, none is queued.
///
/// They are sent together, by the next call that waits or by `rhumb_scene_flush`. `last` may be null; otherwise it receives
/// the number of the last command: those before it have the numbers below it, and events name them.
///
/// # Safety
///
/// `commands` points to `count` commands; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_command(
    scene: RhumbScene,
    commands: *const RhumbCommand,
    count: usize,
    last: *mut u64,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the commands.
        let commands = unsafe { elements(commands, count, "commands") }?;
        let commands: Vec<_> = commands
            .iter()
            .map(RhumbCommand::command)
            .collect::<Result<_, _>>()?;
        // SAFETY: the caller promises the memory.
        unsafe { send_all(scene, commands, last) }
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
unsafe fn send_all(
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

impl RhumbCommand {
    fn command(&self) -> Result<Command, BindingError> {
        let kind = one_of(&RhumbCommandKind::EACH, self.kind, "command.kind")?;
        let (vector, point) = (Vec3::from_array(self.vector), Vec3::from_array(self.point));
        if kind == RhumbCommandKind::SetGravity {
            return Ok(Command::SetGravity { gravity: vector });
        }
        let id = parse_body_word(self.body.0)?;
        Ok(match kind {
            RhumbCommandKind::RemoveBody => Command::RemoveBody { id },
            RhumbCommandKind::SetPose => Command::SetPose {
                id,
                position: vector,
                rotation: Quat::from_array(self.rotation),
            },
            RhumbCommandKind::SetVelocity => Command::SetVelocity {
                id,
                linear: vector,
                angular: Vec3::from_array(self.angular),
            },
            RhumbCommandKind::Force => Command::Force { id, force: vector },
            RhumbCommandKind::Torque => Command::Torque { id, torque: vector },
            RhumbCommandKind::Impulse => Command::Impulse {
                id,
                impulse: vector,
            },
            RhumbCommandKind::TorqueImpulse => Command::TorqueImpulse {
                id,
                impulse: vector,
            },
            RhumbCommandKind::ForceAt => Command::ForceAt {
                id,
                force: vector,
                point,
            },
            RhumbCommandKind::ImpulseAt => Command::ImpulseAt {
                id,
                impulse: vector,
                point,
            },
            RhumbCommandKind::SetGravity => Command::SetGravity { gravity: vector },
            RhumbCommandKind::Sleep => Command::Sleep { id },
            RhumbCommandKind::Wake => Command::Wake { id },
            RhumbCommandKind::SetEvents => Command::SetEvents {
                id,
                events: self.active_events()?,
            },
        })
    }

    fn active_events(&self) -> Result<ActiveEvents, BindingError> {
        let is_on = |bit: u32| self.events & bit != 0;
        let known =
            RHUMB_EVENTS_CONTACTS | RHUMB_EVENTS_FORCE | RHUMB_EVENTS_SENSORS | RHUMB_EVENTS_SLEEP;
        if self.events & !known != 0 {
            let (bits, needed) = (self.events, "bits that the header names: 0 to 15");
            return Err(BindingError::value("command.events", bits, needed));
        }
        Ok(ActiveEvents {
            contacts: is_on(RHUMB_EVENTS_CONTACTS),
            force: is_on(RHUMB_EVENTS_FORCE).then_some(self.event_force),
            sensors: is_on(RHUMB_EVENTS_SENSORS),
            sleep: is_on(RHUMB_EVENTS_SLEEP),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: RhumbCommand = RhumbCommand {
        kind: 0,
        events: 0,
        body: RhumbBody(1),
        vector: [1.0, 2.0, 3.0],
        point: [4.0, 5.0, 6.0],
        angular: [7.0, 8.0, 9.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
        event_force: 10.0,
    };

    fn error(command: RhumbCommand) -> String {
        let result = command.command();
        result.expect_err("the command is wrong").to_string()
    }

    #[test]
    fn each_kind_reads_the_fields_that_the_header_names() {
        let id = parse_body_word(1).unwrap();
        let of_kind = |kind: RhumbCommandKind| RhumbCommand {
            kind: kind as u32,
            ..PLAIN
        };
        let command = |kind| of_kind(kind).command().unwrap();
        let expected = Command::SetVelocity {
            id,
            linear: Vec3::new(1.0, 2.0, 3.0),
            angular: Vec3::new(7.0, 8.0, 9.0),
        };
        assert_eq!(command(RhumbCommandKind::SetVelocity), expected);
        let expected = Command::ImpulseAt {
            id,
            impulse: Vec3::new(1.0, 2.0, 3.0),
            point: Vec3::new(4.0, 5.0, 6.0),
        };
        assert_eq!(command(RhumbCommandKind::ImpulseAt), expected);
        let events = RhumbCommand {
            events: RHUMB_EVENTS_FORCE | RHUMB_EVENTS_SLEEP,
            ..of_kind(RhumbCommandKind::SetEvents)
        };
        let expected = ActiveEvents {
            force: Some(10.0),
            sleep: true,
            ..ActiveEvents::NONE
        };
        let command = events.command().unwrap();
        assert_eq!(
            command,
            Command::SetEvents {
                id,
                events: expected
            }
        );
    }

    #[test]
    fn unknown_kinds_bodies_and_bits_are_errors() {
        let unknown = RhumbCommand { kind: 13, ..PLAIN };
        assert!(error(unknown).starts_with("command.kind is "));
        let nothing = RhumbCommand {
            body: RhumbBody(0),
            ..PLAIN
        };
        assert_eq!(error(nothing), "0x0 is the id of no body");
        let bits = RhumbCommand {
            kind: RhumbCommandKind::SetEvents as u32,
            events: 16,
            ..PLAIN
        };
        assert!(error(bits).starts_with("command.events is "));
    }
}
