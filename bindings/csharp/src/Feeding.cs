// Scenes that the program feeds by an engine of its own.

using System;
using System.Runtime.InteropServices;

namespace Rhumb
{
    /// <summary>
    /// A command of another member of a scene that this program feeds; it has changed nothing yet. What its kind does not name
    /// is zero or empty.
    /// </summary>
    public struct Request
    {
        public RhumbRequestKind Kind;

        /// <summary>The number of the member's command.</summary>
        public ulong Number;
        public Body Body;

        /// <summary>Of a body or a pose: the centre of mass.</summary>
        public Vec3 Position;

        /// <summary>Of a body or a pose: body to world.</summary>
        public Quat Rotation;
        public Vec3 LinearVelocity;

        /// <summary>rad/s about world axes.</summary>
        public Vec3 AngularVelocity;

        /// <summary>The force, torque, impulse or gravity.</summary>
        public Vec3 Vector;

        /// <summary>Where a force or an impulse acts; null for the centre of mass.</summary>
        public Vec3? Point;

        /// <summary>The client that the member's token names.</summary>
        public string Client;

        internal ulong Answer;

        internal static unsafe Request Of(RhumbRequest* raw)
        {
            return new Request
            {
                Kind = (RhumbRequestKind)raw->kind,
                Number = raw->number,
                Body = new Body(raw->body.Item1),
                Position = Triple(raw->position),
                Rotation = new Quat(raw->rotation[0], raw->rotation[1], raw->rotation[2], raw->rotation[3]),
                LinearVelocity = Triple(raw->linear_velocity),
                AngularVelocity = Triple(raw->angular_velocity),
                Vector = Triple(raw->vector),
                Point = raw->has_point != 0 ? Triple(raw->point) : (Vec3?)null,
                Client = Utf8.Read((byte*)raw->client),
                Answer = raw->request,
            };
        }

        private static unsafe Vec3 Triple(float* of)
        {
            return new Vec3(of[0], of[1], of[2]);
        }
    }

    public sealed partial class Scene
    {
        /// <summary>
        /// Hands over the states of one tick of a scene that this client feeds, has the scene step, and returns the tick: see
        /// LocalServer.Feed. A row for each body, each once, in any order; a body that is left out rests where it is.
        ///
        /// Without rotations, no body is turned. Without any velocities, they follow from the poses. tick: from 1 on; null: the
        /// next one. Up to 600 ticks may be left out: bodies then go evenly from one state to the next. Throws
        /// RhumbRefusedException for what the scene refused since the last call, after the states are fed.
        /// </summary>
        public unsafe ulong Feed(
            ReadOnlySpan<Body> bodies,
            ReadOnlySpan<Vec3> positions,
            ReadOnlySpan<Quat> rotations = default(ReadOnlySpan<Quat>),
            ReadOnlySpan<Vec3> linearVelocities = default(ReadOnlySpan<Vec3>),
            ReadOnlySpan<Vec3> angularVelocities = default(ReadOnlySpan<Vec3>),
            ulong? tick = null)
        {
            if (tick == 0)
            {
                throw new RhumbException(RhumbCode.Invalid, "tick is 0, and must be 1 or later");
            }
            CheckRows(positions.Length, bodies.Length, nameof(positions));
            CheckOptionalRows(rotations.Length, bodies.Length, nameof(rotations));
            CheckOptionalRows(linearVelocities.Length, bodies.Length, nameof(linearVelocities));
            CheckOptionalRows(angularVelocities.Length, bodies.Length, nameof(angularVelocities));
            ulong fed;
            fixed (Body* ids = &MemoryMarshal.GetReference(bodies))
            fixed (Vec3* at = &MemoryMarshal.GetReference(positions))
            fixed (Quat* turned = &MemoryMarshal.GetReference(rotations))
            fixed (Vec3* linear = &MemoryMarshal.GetReference(linearVelocities))
            fixed (Vec3* angular = &MemoryMarshal.GetReference(angularVelocities))
            {
                var states = new RhumbFedStates
                {
                    tick = tick ?? 0,
                    count = (UIntPtr)bodies.Length,
                    bodies = (RhumbBody*)ids,
                    positions = (float*)at,
                    rotations = rotations.IsEmpty ? null : (float*)turned,
                    linear_velocities = linearVelocities.IsEmpty ? null : (float*)linear,
                    angular_velocities = angularVelocities.IsEmpty ? null : (float*)angular,
                };
                RhumbRefusedException.CheckDone(Native.rhumb_scene_feed(Raw(), &states, &fed), Raw());
            }
            return fed;
        }

        /// <summary>
        /// Takes the oldest unread request of another member of a scene that this client feeds; false if there is none. One that
        /// moves a body is answered by what is fed; the others change the scene once they are accepted.
        /// </summary>
        public unsafe bool TryNextRequest(out Request next)
        {
            RhumbRequest raw;
            RhumbException.Check(Native.rhumb_scene_poll_request(Raw(), &raw));
            next = Request.Of(&raw);
            return next.Kind != RhumbRequestKind.None;
        }

        /// <summary>
        /// Changes the scene as another member asked; that one, and this client by its next Feed, is refused after all if the
        /// scene cannot.
        /// </summary>
        public void Accept(Request request)
        {
            RhumbException.Check(Native.rhumb_scene_accept_request(Raw(), request.Answer));
        }

        /// <summary>Refuses what another member asked for.</summary>
        public void Refuse(Request request)
        {
            RhumbException.Check(Native.rhumb_scene_refuse_request(Raw(), request.Answer));
        }

        private static void CheckRows(int rows, int count, string what)
        {
            if (rows != count)
            {
                string needed = " rows, and must have " + count + ": as many as there are bodies";
                throw new RhumbException(RhumbCode.Invalid, what + " has " + rows + needed);
            }
        }

        private static void CheckOptionalRows(int rows, int count, string what)
        {
            if (rows != 0)
            {
                CheckRows(rows, count, what);
            }
        }
    }
}
