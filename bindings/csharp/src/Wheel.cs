// Wheels of vehicles.

namespace Rhumb
{
    /// <summary>
    /// A wheel of a vehicle, for Scene.SetVehicle: a ray with a spring, in the axes of its chassis and from its centre of
    /// mass. Each method changes it and returns it.
    /// </summary>
    public sealed class Wheel
    {
        private RhumbWheel raw;

        /// <summary>
        /// On a suspension of 0.3 m that points down. Its axle points to the right: forward is -z in Rhumb's coordinates, z in
        /// Unity's, x in Unreal's, and y where z is up. The coordinates are those of its scene.
        /// </summary>
        public unsafe Wheel(Vec3 position, float radius, RhumbCoordinates coordinates = RhumbCoordinates.Rhumb)
        {
            RhumbWheel plain;
            RhumbException.Check(Native.rhumb_wheel_init(&plain, (uint)coordinates));
            position.CopyTo(plain.position);
            plain.radius = radius;
            raw = plain;
        }

        /// <summary>
        /// Directions of the suspension, towards the ground, and of the axle, to the right of the way forward; of unit length.
        /// </summary>
        public unsafe Wheel Axes(Vec3 direction, Vec3 axle)
        {
            fixed (RhumbWheel* to = &raw)
            {
                direction.CopyTo(to->direction);
                axle.CopyTo(to->axle);
            }
            return this;
        }

        /// <summary>Length without load, from the position to the wheel's centre, and the greatest change of it.</summary>
        public Wheel Suspension(float restLength, float travel)
        {
            raw.rest_length = restLength;
            raw.travel = travel;
            return this;
        }

        /// <summary>
        /// Stiffness in 1/s², and damping while the spring is compressed and while it relaxes, 1/s.
        /// </summary>
        public Wheel Spring(float stiffness, float compression, float relaxation)
        {
            raw.stiffness = stiffness;
            raw.compression = compression;
            raw.relaxation = relaxation;
            return this;
        }

        /// <summary>Greatest force of the suspension; any without this.</summary>
        public Wheel ForceMax(float force)
        {
            raw.force_max = force;
            return this;
        }

        /// <summary>
        /// Greatest force along the ground, as a share of the suspension's force, of which the part along the way forward
        /// counts half; and the factor of the force that keeps the wheel from sliding sideways.
        /// </summary>
        public Wheel Friction(float slip, float side)
        {
            raw.friction_slip = slip;
            raw.side_friction = side;
            return this;
        }

        internal RhumbWheel Raw()
        {
            return raw;
        }
    }

    /// <summary>Steering, force and brake of a wheel, for Scene.SetWheels. The default value rolls freely.</summary>
    public struct WheelInput
    {
        /// <summary>Radians: a positive one steers left, in left-handed coordinates such as Unity's right.</summary>
        public float Steering;

        /// <summary>Force forward; a negative one acts backward.</summary>
        public float Force;

        /// <summary>Greatest force that stops it. A wheel with a force does not brake.</summary>
        public float Brake;

        public WheelInput(float steering, float force, float brake)
        {
            Steering = steering;
            Force = force;
            Brake = brake;
        }

        internal RhumbWheelInput Raw()
        {
            return new RhumbWheelInput { steering = Steering, force = Force, brake = Brake };
        }
    }
}
