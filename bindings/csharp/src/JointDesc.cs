// Joints to add.

namespace Rhumb
{
    /// <summary>
    /// A joint of two bodies. Each method changes it and returns it. Axes: 0 to 2 along x, y, z of its frames, 3 to 5 about
    /// them.
    /// </summary>
    public sealed class JointDesc
    {
        private RhumbJointDesc raw;

        public unsafe JointDesc(RhumbJointKind kind, Body first, Body second)
        {
            RhumbJointDesc plain;
            RhumbException.Check(Native.rhumb_joint_desc_init(&plain));
            raw = plain;
            raw.kind = (uint)kind;
            raw.first.Item1 = first.Word;
            raw.second.Item1 = second.Word;
        }

        /// <summary>From the centres of mass of the bodies, along their axes.</summary>
        public unsafe JointDesc Anchors(Vec3 first, Vec3 second)
        {
            fixed (float* to = raw.first_frame.anchor)
            {
                first.CopyTo(to);
            }
            fixed (float* to = raw.second_frame.anchor)
            {
                second.CopyTo(to);
            }
            return this;
        }

        /// <summary>Frames to bodies.</summary>
        public unsafe JointDesc Rotations(Quat first, Quat second)
        {
            fixed (float* to = raw.first_frame.rotation)
            {
                first.CopyTo(to);
            }
            fixed (float* to = raw.second_frame.rotation)
            {
                second.CopyTo(to);
            }
            return this;
        }

        /// <summary>Of a generic joint: bits of the axes without motion.</summary>
        public JointDesc LockedAxes(uint bits)
        {
            raw.locked_axes = bits;
            return this;
        }

        /// <summary>Units of length, or radians.</summary>
        public unsafe JointDesc Limit(int axis, float least, float most)
        {
            raw.limited_axes |= Bit(axis);
            fixed (RhumbJointDesc* to = &raw)
            {
                to->least[axis] = least;
                to->most[axis] = most;
            }
            return this;
        }

        /// <summary>
        /// The position and velocity that the motor drives to, its stiffness in 1/s², its damping in 1/s, and its greatest
        /// force or torque; none means any.
        /// </summary>
        public unsafe JointDesc Motor(
            int axis, float position, float velocity, float stiffness, float damping, float? force = null)
        {
            raw.motor_axes |= Bit(axis);
            fixed (RhumbJointDesc* to = &raw)
            {
                to->motor_position[axis] = position;
                to->motor_velocity[axis] = velocity;
                to->motor_stiffness[axis] = stiffness;
                to->motor_damping[axis] = damping;
                if (force.HasValue)
                {
                    to->motor_force[axis] = force.Value;
                }
            }
            return this;
        }

        /// <summary>Of a rope: most distance of the anchors. Of a spring: the distance at which it does not pull.</summary>
        public JointDesc Length(float length)
        {
            raw.length = length;
            return this;
        }

        /// <summary>Of a spring: N/m and N s/m.</summary>
        public JointDesc Spring(float stiffness, float damping)
        {
            raw.stiffness = stiffness;
            raw.damping = damping;
            return this;
        }

        /// <summary>The two bodies also collide with each other.</summary>
        public JointDesc Colliding()
        {
            raw.collide = 1;
            return this;
        }

        /// <summary>The load at which the joint breaks.</summary>
        public JointDesc BreaksAt(float force, float torque)
        {
            raw.has_strength = 1;
            raw.break_force = force;
            raw.break_torque = torque;
            return this;
        }

        internal RhumbJointDesc Raw()
        {
            return raw;
        }

        private static uint Bit(int axis)
        {
            if (axis < 0 || axis > 5)
            {
                throw new RhumbException(RhumbCode.Invalid, "an axis of a joint must be 0 to 5");
            }
            return 1u << axis;
        }
    }
}
