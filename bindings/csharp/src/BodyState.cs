// States of bodies that the application moves.

namespace Rhumb
{
    /// <summary>State of a body that the application moves, for Scene.Publish.</summary>
    public struct BodyState
    {
        public Body Body;

        /// <summary>Centre of mass, or the origin of a hull or compound that this client added.</summary>
        public Vec3 Position;

        /// <summary>Body to world.</summary>
        public Quat Rotation;

        public Vec3 LinearVelocity;

        /// <summary>rad/s about world axes.</summary>
        public Vec3 AngularVelocity;

        public BodyState(Body body, Vec3 position, Quat rotation, Vec3 linearVelocity, Vec3 angularVelocity)
        {
            Body = body;
            Position = position;
            Rotation = rotation;
            LinearVelocity = linearVelocity;
            AngularVelocity = angularVelocity;
        }

        internal unsafe RhumbBodyState Raw()
        {
            RhumbBodyState raw = default(RhumbBodyState);
            raw.body.Item1 = Body.Word;
            Position.CopyTo(raw.position);
            Rotation.CopyTo(raw.rotation);
            LinearVelocity.CopyTo(raw.linear_velocity);
            AngularVelocity.CopyTo(raw.angular_velocity);
            return raw;
        }
    }
}
