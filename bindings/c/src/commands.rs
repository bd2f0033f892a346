//! Requests of an application: commands, joints, authority over bodies.
//!
//! Characters and wheels, which commands take, have the defaults of the scene's coordinates.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    Command, Joint, JointFrame, JointId, JointLimits, JointStrength, LockedAxes, Motor,
};
use rhumb_bindings::{
    BindingError, Coordinates, JointFreedom, JointParams, StateRecord, parse_packed_id,
};

use crate::border::{RhumbCode, elements, guard, one_of, value, write, write_if_wanted};
use crate::descriptions::RhumbBody;
use crate::generated::{RhumbCharacter, RhumbCommand, RhumbWheel};
use crate::kinds::{COORDINATES, JOINT_KINDS};
use crate::scene::{RhumbScene, send, send_all, with};

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
/// `RHUMB_CODE_INVALID`. For a member by cells, the grant of a body waits until a cell that it takes has had the body.
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

/// Makes a plain character in a scene of these `RhumbCoordinates`: of 80 kg, that climbs slopes of up to 45 degrees, slides
/// down steeper ones, climbs no steps, and follows the ground down by 0.2 m.
///
/// # Safety
///
/// `character` points to memory for a `RhumbCharacter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_character_init(
    character: *mut RhumbCharacter,
    coordinates: u32,
) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe {
        let coordinates = one_of(&COORDINATES, coordinates, "coordinates")?;
        write(
            character,
            RhumbCharacter::from(coordinates.plain_character()),
            "character",
        )
    })
}

/// Makes a plain wheel in a scene of these `RhumbCoordinates`: of radius 0.3 m at the chassis' origin, on a suspension
/// of 0.3 m that points down. Its axle is along x, in Unreal's coordinates along y.
///
/// A vehicle of such wheels rolls forward along -z in Rhumb's coordinates, z in Unity's, x in Unreal's, and y where z is up.
/// Four of them let a chassis sink by 5 cm.
///
/// # Safety
///
/// `wheel` points to memory for a `RhumbWheel`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_wheel_init(wheel: *mut RhumbWheel, coordinates: u32) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe {
        let coordinates = one_of(&COORDINATES, coordinates, "coordinates")?;
        write(wheel, plain_wheel(coordinates), "wheel")
    })
}

/// A plain wheel at the chassis' origin.
fn plain_wheel(coordinates: Coordinates) -> RhumbWheel {
    let radius = coordinates.length_out(RADIUS);
    coordinates.plain_wheel(Vec3::ZERO, radius).into()
}

/// Radius of a plain wheel, metres: that of a small car.
const RADIUS: f32 = 0.3;

/// Frame of a joint in one of its bodies.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbJointFrame {
    /// From the origin of the body's shape, along its axes, in the scene's unit of length.
    pub anchor: [f32; 3],
    /// Unit quaternion x, y, z, w: frame to body.
    pub rotation: [f32; 4],
}

/// A joint of two bodies. Begin with `rhumb_joint_desc_init`.
///
/// Arrays of six have translations along x, y and z of the frames first, then rotations about them. Bits of a set of axes
/// have the same order.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbJointDesc {
    /// A `RhumbJointKind`.
    pub kind: u32,
    /// Not zero: the two bodies also collide with each other.
    pub collide: u8,
    /// Not zero: the joint breaks at `break_force` or `break_torque`.
    pub has_strength: u8,
    /// The first body.
    pub first: RhumbBody,
    /// The second body, another one.
    pub second: RhumbBody,
    /// Frame in the first body.
    pub first_frame: RhumbJointFrame,
    /// Frame in the second body.
    pub second_frame: RhumbJointFrame,
    /// Of a generic joint: bits of the axes without motion.
    pub locked_axes: u32,
    /// Bits of the axes that `least` and `most` limit.
    pub limited_axes: u32,
    /// Bits of the axes with a motor.
    pub motor_axes: u32,
    /// Units of length, or radians.
    pub least: [f32; 6],
    /// Units of length, or radians.
    pub most: [f32; 6],
    /// Position that the motor drives to: units of length, or radians.
    pub motor_position: [f32; 6],
    /// Velocity that the motor drives to: units of length per second, or rad/s.
    pub motor_velocity: [f32; 6],
    /// Acceleration for what the position lacks, 1/s²; zero for a motor that drives the velocity alone.
    pub motor_stiffness: [f32; 6],
    /// Acceleration for what the velocity lacks, 1/s.
    pub motor_damping: [f32; 6],
    /// Greatest force or torque of the motor.
    pub motor_force: [f32; 6],
    /// Of a rope: most distance of the anchors. Of a spring: the distance at which it does not pull.
    pub length: f32,
    /// Of a spring: N/m.
    pub stiffness: f32,
    /// Of a spring: N s/m.
    pub damping: f32,
    /// Force at which the joint breaks, kg times units of length per s².
    pub break_force: f32,
    /// Torque at which the joint breaks, kg times units of length² per s².
    pub break_torque: f32,
}

/// Makes a plain description: a fixed joint of no bodies at their centres, without limits and motors, that never breaks.
///
/// # Safety
///
/// `desc` points to memory for a `RhumbJointDesc`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_joint_desc_init(desc: *mut RhumbJointDesc) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(desc, RhumbJointDesc::PLAIN, "desc") })
}

/// Queues the addition of a joint under a number of the application's, below 65,536, that no joint of the scene has.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `desc` points to a description; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_add_joint(
    scene: RhumbScene,
    joint: u32,
    desc: *const RhumbJointDesc,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the description and the memory.
    guard(|| unsafe {
        let (id, joint) = (JointId(joint), Box::new(value(desc, "desc")?.joint()?));
        send(scene, Command::AddJoint { id, joint }, last)
    })
}

/// Queues the replacement of a joint, its limits and motors among others. The description is whole.
///
/// # Safety
///
/// As `rhumb_scene_add_joint`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_change_joint(
    scene: RhumbScene,
    joint: u32,
    desc: *const RhumbJointDesc,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the description and the memory.
    guard(|| unsafe {
        let (id, joint) = (JointId(joint), Box::new(value(desc, "desc")?.joint()?));
        send(scene, Command::ChangeJoint { id, joint }, last)
    })
}

/// Queues the removal of a joint. A joint goes with either of its bodies too.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_remove_joint(
    scene: RhumbScene,
    joint: u32,
    last: *mut u64,
) -> RhumbCode {
    let id = JointId(joint);
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { send(scene, Command::RemoveJoint { id }, last) })
}

impl RhumbJointFrame {
    const PLAIN: Self = Self {
        anchor: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };

    const fn frame(&self) -> JointFrame {
        JointFrame {
            anchor: Vec3::from_array(self.anchor),
            rotation: Quat::from_array(self.rotation),
        }
    }
}

impl RhumbJointDesc {
    const PLAIN: Self = Self {
        kind: 0,
        collide: 0,
        has_strength: 0,
        first: RhumbBody(0),
        second: RhumbBody(0),
        first_frame: RhumbJointFrame::PLAIN,
        second_frame: RhumbJointFrame::PLAIN,
        locked_axes: 0,
        limited_axes: 0,
        motor_axes: 0,
        least: [0.0; 6],
        most: [0.0; 6],
        motor_position: [0.0; 6],
        motor_velocity: [0.0; 6],
        motor_stiffness: [0.0; 6],
        motor_damping: [0.0; 6],
        // Any force.
        motor_force: [Motor::with_velocity(0.0, 0.0).force; 6],
        length: 1.0,
        stiffness: 0.0,
        damping: 0.0,
        break_force: 0.0,
        break_torque: 0.0,
    };

    fn joint(&self) -> Result<Joint, BindingError> {
        let kind: JointFreedom = one_of(&JOINT_KINDS, self.kind, "desc.kind")?;
        let bodies = [
            parse_packed_id(self.first.0)?,
            parse_packed_id(self.second.0)?,
        ];
        let limited = axes(self.limited_axes, "desc.limited_axes")?;
        let driven = axes(self.motor_axes, "desc.motor_axes")?;
        let params = JointParams {
            frames: [self.first_frame.frame(), self.second_frame.frame()],
            locked: axes(self.locked_axes, "desc.locked_axes")?,
            limits: std::array::from_fn(|axis| {
                limited.locks(axis).then_some(JointLimits {
                    least: self.least[axis],
                    most: self.most[axis],
                })
            }),
            motors: std::array::from_fn(|axis| {
                driven.locks(axis).then_some(Motor {
                    position: self.motor_position[axis],
                    velocity: self.motor_velocity[axis],
                    stiffness: self.motor_stiffness[axis],
                    damping: self.motor_damping[axis],
                    force: self.motor_force[axis],
                })
            }),
            length: self.length,
            stiffness: self.stiffness,
            damping: self.damping,
            collide: self.collide != 0,
            strength: (self.has_strength != 0).then_some(JointStrength {
                force: self.break_force,
                torque: self.break_torque,
            }),
            ..JointParams::new(kind, bodies)
        };
        params.joint()
    }
}

/// A set of axes.
fn axes(bits: u32, argument: &'static str) -> Result<LockedAxes, BindingError> {
    let set = u8::try_from(bits).ok().and_then(LockedAxes::new);
    set.ok_or_else(|| BindingError::value(argument, bits, "six bits: 0 to 63"))
}

#[cfg(test)]
mod tests {
    use rhumb_bindings::parse_packed_id;
    use rhumb_bindings::rhumb_client::glam::Vec3;
    use rhumb_bindings::rhumb_client::scene::{
        ActiveEvents, Character, CharacterStep, Command, JointKind, JumpFrom, Wheel,
    };

    use super::*;
    use crate::descriptions::RhumbBody;
    use crate::generated::{
        RHUMB_EVENTS_FORCE, RHUMB_EVENTS_SLEEP, RhumbCommandKind, RhumbJumpFrom,
    };
    use crate::kinds::RhumbJointKind;

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

    #[test]
    fn plain_structs_are_the_defaults_of_rust() {
        let character = RhumbCharacter::from(Coordinates::Rhumb.plain_character());
        assert_eq!(Character::from(&character), Character::default());
        let wheel = plain_wheel(Coordinates::Rhumb);
        assert_eq!(Wheel::from(&wheel), Wheel::at(Vec3::ZERO, 0.3));
        let in_centimetres = plain_wheel(Coordinates::Unreal);
        assert!((in_centimetres.radius - 30.0).abs() < 1e-4);
        assert_eq!(in_centimetres.direction, [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_step_a_snap_and_a_direction_are_read_where_their_flags_are() {
        let mut character = RhumbCharacter::from(Coordinates::Rhumb.plain_character());
        // Without their flags, these mean nothing.
        (character.step_height, character.step_width) = (0.3, 0.1);
        character.up = [1.0, 0.0, 0.0];
        assert_eq!(Character::from(&character), Character::default());
        (character.has_step, character.has_up) = (1, 1);
        (character.onto_dynamic, character.has_snap) = (1, 0);
        let step = CharacterStep {
            onto_dynamic: true,
            ..CharacterStep::new(0.3, 0.1)
        };
        let expected = Character {
            snap: None,
            ..Character::default()
        };
        assert_eq!(Character::from(&character), expected.up(Vec3::X).step(step));
    }

    #[test]
    fn unknown_coordinates_and_null_pointers_are_errors() {
        let mut wheel = plain_wheel(Coordinates::Rhumb);
        // SAFETY: each pointer is null or points to the wheel.
        unsafe {
            assert_eq!(rhumb_wheel_init(&raw mut wheel, 3), RhumbCode::Ok);
            assert_eq!(rhumb_wheel_init(&raw mut wheel, 4), RhumbCode::Invalid);
            let null = std::ptr::null_mut();
            assert_eq!(rhumb_wheel_init(null, 0), RhumbCode::Null);
            assert_eq!(
                rhumb_character_init(std::ptr::null_mut(), 0),
                RhumbCode::Null
            );
        }
        assert_eq!(wheel.direction, [0.0, 0.0, -1.0]);
    }

    const HINGE: RhumbJointDesc = RhumbJointDesc {
        kind: RhumbJointKind::Revolute as u32,
        first: RhumbBody(1),
        second: RhumbBody(2),
        ..RhumbJointDesc::PLAIN
    };

    fn joint_error(desc: RhumbJointDesc) -> String {
        desc.joint().expect_err("the joint is wrong").to_string()
    }

    #[test]
    fn limits_and_motors_are_read_where_their_bits_are() {
        let mut desc = RhumbJointDesc {
            limited_axes: 0b1000,
            motor_axes: 0b1000,
            ..HINGE
        };
        (desc.least[3], desc.most[3]) = (-0.5, 1.0);
        desc.motor_velocity[3] = 2.0;
        // Without their bits, these mean nothing.
        (desc.least[4], desc.motor_velocity[0]) = (1.0, 1.0);
        let joint = desc.joint().unwrap();
        let limits = JointLimits {
            least: -0.5,
            most: 1.0,
        };
        assert_eq!(joint.kind, JointKind::Revolute(Some(limits)));
        let motors = joint.motors.map(|motor| motor.map(|motor| motor.velocity));
        assert_eq!(motors, [None, None, None, Some(2.0), None, None]);
    }

    #[test]
    fn unknown_kinds_bodies_and_bits_of_joints_are_errors() {
        assert!(
            joint_error(RhumbJointDesc { kind: 7, ..HINGE })
                .starts_with("desc.kind is 7, and must be 0 to 6")
        );
        assert_eq!(
            joint_error(RhumbJointDesc::PLAIN),
            "0x0 is the id of no body"
        );
        let bits = RhumbJointDesc {
            limited_axes: 64,
            ..HINGE
        };
        assert!(joint_error(bits).starts_with("desc.limited_axes is "));
        let locked = RhumbJointDesc {
            limited_axes: 1,
            ..HINGE
        };
        assert!(joint_error(locked).starts_with("limits is of axis "));
    }
}
