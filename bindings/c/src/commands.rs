//! Commands of C: they are queued, in batches.

use crate::border::{elements, guard};
use crate::generated::RhumbCommand;
use crate::scene::{RhumbScene, send_all};
use crate::status::RhumbCode;

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

#[cfg(test)]
mod tests {
    use rhumb_bindings::parse_packed_id;
    use rhumb_bindings::rhumb_client::glam::Vec3;
    use rhumb_bindings::rhumb_client::scene::{ActiveEvents, Command, JumpFrom};

    use super::*;
    use crate::descriptions::RhumbBody;
    use crate::generated::{
        RHUMB_EVENTS_FORCE, RHUMB_EVENTS_SLEEP, RhumbCommandKind, RhumbJumpFrom,
    };

    const PLAIN: RhumbCommand = RhumbCommand {
        kind: 0,
        events: 0,
        body: RhumbBody(1),
        vector: [1.0, 2.0, 3.0],
        point: [4.0, 5.0, 6.0],
        angular: [7.0, 8.0, 9.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
        number: 10.0,
        choice: 1,
    };

    fn error(command: RhumbCommand) -> String {
        let result = command.command();
        result.expect_err("the command is wrong").to_string()
    }

    #[test]
    fn each_kind_reads_the_fields_that_the_header_names() {
        let id = parse_packed_id(1).unwrap();
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
        let jump = Command::Jump {
            id,
            speed: 10.0,
            from: JumpFrom::Anywhere,
        };
        assert_eq!(PLAIN.choice, RhumbJumpFrom::Anywhere as u32);
        assert_eq!(command(RhumbCommandKind::Jump), jump);
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
        let unknown = RhumbCommand { kind: 0, ..PLAIN };
        assert!(error(unknown).starts_with("command.kind is "));
        let nothing = RhumbCommand {
            kind: RhumbCommandKind::RemoveBody as u32,
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
        let choice = RhumbCommand {
            kind: RhumbCommandKind::Jump as u32,
            choice: 2,
            ..PLAIN
        };
        assert!(error(choice).starts_with("command.choice is "));
    }
}
