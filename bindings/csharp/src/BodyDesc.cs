// Bodies to add.

namespace Rhumb
{
    /// <summary>A body to add. Each method changes it and returns it.</summary>
    public sealed class BodyDesc
    {
        private RhumbBodyDesc raw;

        private BodyDesc(RhumbBodyKind kind, Shape shape)
        {
            if (shape == null)
            {
                throw new RhumbException(RhumbCode.Null, "shape must not be null");
            }
            raw = Plain();
            raw.kind = (uint)kind;
            Shape = shape;
        }

        internal Shape Shape { get; }

        /// <summary>A body that the engine moves.</summary>
        public static BodyDesc Dynamic(Shape shape)
        {
            return new BodyDesc(RhumbBodyKind.Dynamic, shape);
        }

        /// <summary>A body that nothing moves, such as a floor.</summary>
        public static BodyDesc Fixed(Shape shape)
        {
            return new BodyDesc(RhumbBodyKind.Fixed, shape);
        }

        /// <summary>A body that commands move; it pushes others and is not pushed.</summary>
        public static BodyDesc Kinematic(Shape shape)
        {
            return new BodyDesc(RhumbBodyKind.Kinematic, shape);
        }

        public BodyDesc At(float x, float y, float z)
        {
            return At(new Vec3(x, y, z));
        }

        public unsafe BodyDesc At(Vec3 position)
        {
            fixed (float* to = raw.position)
            {
                position.CopyTo(to);
            }
            return this;
        }

        public unsafe BodyDesc Rotation(Quat rotation)
        {
            fixed (float* to = raw.rotation)
            {
                rotation.CopyTo(to);
            }
            return this;
        }

        public unsafe BodyDesc LinearVelocity(Vec3 velocity)
        {
            fixed (float* to = raw.linear_velocity)
            {
                velocity.CopyTo(to);
            }
            return this;
        }

        /// <summary>rad/s about world axes.</summary>
        public unsafe BodyDesc AngularVelocity(Vec3 velocity)
        {
            fixed (float* to = raw.angular_velocity)
            {
                velocity.CopyTo(to);
            }
            return this;
        }

        /// <summary>Density in kg/m³.</summary>
        public BodyDesc Material(float friction, float restitution, float density)
        {
            raw.has_material = 1;
            raw.friction = friction;
            raw.restitution = restitution;
            raw.density = density;
            return this;
        }

        /// <summary>1/s.</summary>
        public BodyDesc Damping(float linear, float angular)
        {
            raw.has_damping = 1;
            raw.linear_damping = linear;
            raw.angular_damping = angular;
            return this;
        }

        public BodyDesc Mass(float kilograms)
        {
            raw.has_mass = 1;
            raw.mass = kilograms;
            return this;
        }

        /// <summary>
        /// Moments of inertia about the body's axes, kg·m², in place of those of its shape; needs a mass.
        /// </summary>
        public unsafe BodyDesc Moments(Vec3 moments)
        {
            raw.has_moments = 1;
            fixed (float* to = raw.moments)
            {
                moments.CopyTo(to);
            }
            return this;
        }

        public BodyDesc GravityScale(float factor)
        {
            raw.gravity_scale = factor;
            return this;
        }

        /// <summary>Bits: translations along x, y, z, then rotations about them.</summary>
        public BodyDesc LockedAxes(uint bits)
        {
            raw.locked_axes = bits;
            return this;
        }

        /// <summary>One bit for each group of the body, and one for each that it touches.</summary>
        public BodyDesc Groups(uint members, uint touches)
        {
            raw.group_members = members;
            raw.group_touches = touches;
            return this;
        }

        /// <summary>Power of two on the tolerance of its copies, -3 to 3.</summary>
        public BodyDesc ToleranceExponent(int exponent)
        {
            raw.tolerance_exponent = exponent;
            return this;
        }

        /// <summary>Bodies pass through it.</summary>
        public BodyDesc Sensor()
        {
            raw.sensor = 1;
            return this;
        }

        /// <summary>Sweeps it against moving bodies, so that it does not pass through them.</summary>
        public BodyDesc Swept()
        {
            raw.swept = 1;
            return this;
        }

        /// <summary>Keeps the axis of its spin, though its moments of inertia differ.</summary>
        public BodyDesc WithoutGyroscopicForces()
        {
            raw.gyroscopic = 0;
            return this;
        }

        /// <summary>Its own conditions of sleep in place of the scene's.</summary>
        public BodyDesc Sleep(Sleep sleep)
        {
            raw.sleep = (uint)sleep.Rule;
            raw.sleep_speed = sleep.Speed;
            raw.sleep_angular_speed = sleep.AngularSpeed;
            raw.sleep_seconds = sleep.Seconds;
            return this;
        }

        internal static unsafe RhumbBodyDesc Plain()
        {
            RhumbBodyDesc desc;
            RhumbException.Check(Native.rhumb_body_desc_init(&desc));
            return desc;
        }

        /// <summary>The struct of C, without its shape.</summary>
        internal RhumbBodyDesc Raw()
        {
            return raw;
        }
    }
}
