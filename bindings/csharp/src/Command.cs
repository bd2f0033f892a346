// Commands.

namespace Rhumb
{
    /// <summary>A command, for Scene.Send.</summary>
    public struct Command
    {
        internal RhumbCommand Raw;

        public static Command RemoveBody(Body body)
        {
            return Make(RhumbCommandKind.RemoveBody, body, default(Vec3));
        }

        /// <summary>
        /// Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick. If poses of a
        /// kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next and carries
        /// what lies on it. A pose beyond 100 m/s or a quarter of a turn in a tick is a jump that shoves nothing.
        /// </summary>
        public static unsafe Command SetPose(Body body, Vec3 position, Quat rotation)
        {
            Command command = Make(RhumbCommandKind.SetPose, body, position);
            rotation.CopyTo(command.Raw.rotation);
            return command;
        }

        public static unsafe Command SetVelocity(Body body, Vec3 linear, Vec3 angular)
        {
            Command command = Make(RhumbCommandKind.SetVelocity, body, linear);
            angular.CopyTo(command.Raw.angular);
            return command;
        }

        public static Command Force(Body body, Vec3 force)
        {
            return Make(RhumbCommandKind.Force, body, force);
        }

        public static Command Torque(Body body, Vec3 torque)
        {
            return Make(RhumbCommandKind.Torque, body, torque);
        }

        public static Command Impulse(Body body, Vec3 impulse)
        {
            return Make(RhumbCommandKind.Impulse, body, impulse);
        }

        public static Command TorqueImpulse(Body body, Vec3 impulse)
        {
            return Make(RhumbCommandKind.TorqueImpulse, body, impulse);
        }

        public static unsafe Command ForceAt(Body body, Vec3 force, Vec3 point)
        {
            Command command = Make(RhumbCommandKind.ForceAt, body, force);
            point.CopyTo(command.Raw.point);
            return command;
        }

        public static unsafe Command ImpulseAt(Body body, Vec3 impulse, Vec3 point)
        {
            Command command = Make(RhumbCommandKind.ImpulseAt, body, impulse);
            point.CopyTo(command.Raw.point);
            return command;
        }

        public static Command SetGravity(Vec3 gravity)
        {
            return Make(RhumbCommandKind.SetGravity, default(Body), gravity);
        }

        public static Command Sleep(Body body)
        {
            return Make(RhumbCommandKind.Sleep, body, default(Vec3));
        }

        public static Command Wake(Body body)
        {
            return Make(RhumbCommandKind.Wake, body, default(Vec3));
        }

        /// <summary>Has a body report events: Native.RHUMB_EVENTS_ bits, and contacts from the force on.</summary>
        public static Command SetEvents(Body body, uint events, float force)
        {
            Command command = Make(RhumbCommandKind.SetEvents, body, default(Vec3));
            command.Raw.events = events;
            command.Raw.event_force = force;
            return command;
        }

        private static unsafe Command Make(RhumbCommandKind kind, Body body, Vec3 vector)
        {
            var command = default(Command);
            command.Raw.kind = (uint)kind;
            command.Raw.body.Item1 = body.Word;
            vector.CopyTo(command.Raw.vector);
            Quat.Identity.CopyTo(command.Raw.rotation);
            return command;
        }
    }
}
