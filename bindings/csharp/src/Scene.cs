// Scenes: bodies, commands, time, arrays, events, queries.

using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;
using Microsoft.Win32.SafeHandles;

namespace Rhumb
{
    /// <summary>
    /// A client of one scene. One thread at a time; a second one gets RhumbCode.Busy at once.
    ///
    /// The arrays of the view belong to this object. A span of one is valid for ever and never points to freed memory; the
    /// next Advance, Wait or Poll and a new read of the property write the next view into the same array.
    /// </summary>
    public sealed class Scene : IDisposable
    {
        private readonly SceneHandle handle;
        private readonly ViewArray<Body> bodies = new ViewArray<Body>();
        private readonly ViewArray<Vec3> positions = new ViewArray<Vec3>();
        private readonly ViewArray<Quat> rotations = new ViewArray<Quat>();
        private readonly ViewArray<Vec3> linearVelocities = new ViewArray<Vec3>();
        private readonly ViewArray<Vec3> angularVelocities = new ViewArray<Vec3>();
        private readonly ViewArray<byte> resting = new ViewArray<byte>();

        /// <summary>Counts the views, so that an array knows whether it holds the present one.</summary>
        private ulong view = 1;

        internal Scene(ulong id)
        {
            handle = new SceneHandle(id);
        }

        private delegate RhumbPoseBuffers Wanted(IntPtr array);

        /// <summary>Ids of the bodies of the view. All arrays have this order, which changes from view to view.</summary>
        public ReadOnlySpan<Body> Bodies
        {
            get { return Read(bodies, WantBodies); }
        }

        /// <summary>Centres of mass.</summary>
        public ReadOnlySpan<Vec3> Positions
        {
            get { return Read(positions, WantPositions); }
        }

        /// <summary>Rotations body to world.</summary>
        public ReadOnlySpan<Quat> Rotations
        {
            get { return Read(rotations, WantRotations); }
        }

        public ReadOnlySpan<Vec3> LinearVelocities
        {
            get { return Read(linearVelocities, WantLinear); }
        }

        /// <summary>rad/s about world axes.</summary>
        public ReadOnlySpan<Vec3> AngularVelocities
        {
            get { return Read(angularVelocities, WantAngular); }
        }

        /// <summary>Not zero for each body that rests.</summary>
        public ReadOnlySpan<byte> Resting
        {
            get { return Read(resting, WantResting); }
        }

        public Body Add(BodyDesc desc)
        {
            return Add(new[] { desc })[0];
        }

        /// <summary>Adds bodies in one call; ids in the same order. If one is wrong, none is added.</summary>
        public unsafe Body[] Add(BodyDesc[] descs)
        {
            if (descs == null)
            {
                throw new RhumbException(RhumbCode.Null, "descs must not be null");
            }
            var raw = new RhumbBodyDesc[descs.Length];
            var ids = new Body[descs.Length];
            var pins = new List<GCHandle>();
            try
            {
                for (int i = 0; i < descs.Length; i++)
                {
                    BodyDesc desc = descs[i];
                    if (desc == null)
                    {
                        throw new RhumbException(RhumbCode.Null, "descs[" + i + "] must not be null");
                    }
                    raw[i] = desc.Raw();
                    raw[i].shape = desc.Shape.Pinned(pins);
                }
                fixed (RhumbBodyDesc* from = raw)
                fixed (Body* to = ids)
                {
                    RhumbException.Check(
                        Native.rhumb_scene_add_bodies(Raw(), from, (UIntPtr)descs.Length, (RhumbBody*)to));
                }
            }
            finally
            {
                foreach (GCHandle pin in pins)
                {
                    pin.Free();
                }
            }
            return ids;
        }

        /// <summary>Queues commands in one call, and returns the number of the last. If one is wrong, none is queued.</summary>
        public unsafe ulong Send(params Command[] commands)
        {
            if (commands == null)
            {
                throw new RhumbException(RhumbCode.Null, "commands must not be null");
            }
            ulong last = 0;
            fixed (Command* from = commands)
            {
                RhumbException.Check(
                    Native.rhumb_scene_command(Raw(), (RhumbCommand*)from, (UIntPtr)commands.Length, &last));
            }
            return last;
        }

        /// <summary>
        /// Queues the addition of a joint under a number that no joint of the scene has; returns the command's number.
        /// </summary>
        public unsafe ulong AddJoint(uint joint, JointDesc desc)
        {
            RhumbJointDesc raw = Checked(desc);
            ulong number;
            RhumbException.Check(Native.rhumb_scene_add_joint(Raw(), joint, &raw, &number));
            return number;
        }

        /// <summary>Queues the replacement of a joint, its limits and motors among others.</summary>
        public unsafe ulong ChangeJoint(uint joint, JointDesc desc)
        {
            RhumbJointDesc raw = Checked(desc);
            ulong number;
            RhumbException.Check(Native.rhumb_scene_change_joint(Raw(), joint, &raw, &number));
            return number;
        }

        /// <summary>Queues the removal of a joint. A joint goes with either of its bodies too.</summary>
        public unsafe ulong RemoveJoint(uint joint)
        {
            ulong number;
            RhumbException.Check(Native.rhumb_scene_remove_joint(Raw(), joint, &number));
            return number;
        }

        /// <summary>
        /// Requests authority over kinematic bodies in place of those of now; none ends it. It is sent at once. An event,
        /// AuthorityGranted or AuthorityDenied, answers.
        /// </summary>
        public unsafe void TakeAuthority(Body[] bodies, double toleranceInMetres = 0.02)
        {
            if (bodies == null)
            {
                throw new RhumbException(RhumbCode.Null, "bodies must not be null");
            }
            fixed (Body* from = bodies)
            {
                RhumbException.Check(Native.rhumb_scene_take_authority(
                    Raw(), (RhumbBody*)from, (UIntPtr)bodies.Length, toleranceInMetres));
            }
        }

        /// <summary>
        /// Publishes the states of all bodies under this client's authority, once per frame. The tick of the states, or null
        /// while nothing is published: before the authority is granted, before the server's clock is known, and for a second
        /// frame of one tick. A body that is left out stands still.
        /// </summary>
        public unsafe ulong? Publish(params BodyState[] states)
        {
            if (states == null)
            {
                throw new RhumbException(RhumbCode.Null, "states must not be null");
            }
            var raw = new RhumbBodyState[states.Length];
            for (int i = 0; i < raw.Length; i++)
            {
                raw[i] = states[i].Raw();
            }
            byte published;
            ulong tick;
            fixed (RhumbBodyState* from = raw)
            {
                RhumbException.Check(
                    Native.rhumb_scene_publish(Raw(), from, (UIntPtr)raw.Length, &published, &tick));
            }
            return published != 0 ? tick : (ulong?)null;
        }

        /// <summary>
        /// Queues the removal of the shapes that came with this client's bodies and that no body has any more; returns their
        /// number. Queued additions, changes and removals of bodies count.
        /// </summary>
        public unsafe int RemoveUnusedShapes()
        {
            UIntPtr count;
            RhumbException.Check(Native.rhumb_scene_remove_unused_shapes(Raw(), &count));
            return checked((int)count);
        }

        /// <summary>Sends the queued commands at once.</summary>
        public void Flush()
        {
            RhumbException.Check(Native.rhumb_scene_flush(Raw()));
        }

        /// <summary>Steps a lockstep scene once, computes the view, and returns its tick.</summary>
        public unsafe ulong Advance(uint depth = 0)
        {
            ulong tick;
            view++;
            RhumbException.Check(Native.rhumb_scene_advance(Raw(), depth, &tick));
            return tick;
        }

        /// <summary>Goes on waiting for the tick of an Advance that timed out.</summary>
        public unsafe ulong Wait(uint depth = 0)
        {
            ulong tick;
            view++;
            RhumbException.Check(Native.rhumb_scene_wait(Raw(), depth, &tick));
            return tick;
        }

        /// <summary>Computes the view of a free-running scene for now, in ticks since the scene's first.</summary>
        public unsafe double Poll()
        {
            RhumbTime time;
            view++;
            RhumbException.Check(Native.rhumb_scene_poll(Raw(), &time));
            return time.tick + time.fraction;
        }

        /// <summary>Handles what arrives for a time in seconds, without computing the view.</summary>
        public void Idle(double duration)
        {
            RhumbException.Check(Native.rhumb_scene_idle(Raw(), duration));
        }

        /// <summary>The newest tick at which every copy is within its tolerance, of what has arrived.</summary>
        public unsafe ulong CompleteTick
        {
            get
            {
                RhumbStatistics statistics;
                RhumbException.Check(Native.rhumb_scene_statistics(Raw(), &statistics));
                return statistics.complete_tick;
            }
        }

        /// <summary>Place of a body in the arrays; -1 for a body that is not in the view, as Array.IndexOf says it.</summary>
        public unsafe int Place(Body body)
        {
            UIntPtr place;
            RhumbCode code = Native.rhumb_scene_place(Raw(), new RhumbBody { Item1 = body.Word }, &place);
            if (code == RhumbCode.Invalid)
            {
                return -1;
            }
            RhumbException.Check(code);
            return (int)place;
        }

        /// <summary>How far any point of a body may be off; infinite while that is not known.</summary>
        public unsafe float ErrorBound(Body body)
        {
            float bound;
            var raw = new RhumbBody { Item1 = body.Word };
            RhumbException.Check(Native.rhumb_scene_error_bounds(Raw(), &raw, (UIntPtr)1, &bound));
            return bound;
        }

        /// <summary>Takes the oldest unread event; false if there is none.</summary>
        public unsafe bool TryNextEvent(out Event next)
        {
            RhumbEvent raw;
            RhumbException.Check(Native.rhumb_scene_poll_event(Raw(), &raw));
            next = Event.Of(&raw);
            return next.Kind != RhumbEventKind.None;
        }

        /// <summary>Asks the server, and waits; hits are in the order of the queries.</summary>
        public unsafe Hit[] Ask(params Query[] queries)
        {
            if (queries == null)
            {
                throw new RhumbException(RhumbCode.Null, "queries must not be null");
            }
            long capacity = 0;
            foreach (Query query in queries)
            {
                // A query of more is an error of the call.
                capacity += Math.Min(query.Raw.hits, 65);
            }
            var raw = new RhumbHit[capacity];
            UIntPtr count;
            ulong tick;
            fixed (Query* from = queries)
            fixed (RhumbHit* to = raw)
            {
                RhumbException.Check(Native.rhumb_scene_query(
                    Raw(), (RhumbQuery*)from, (UIntPtr)queries.Length, to, (UIntPtr)capacity, &count, &tick));
            }
            var hits = new Hit[(int)count];
            for (int i = 0; i < hits.Length; i++)
            {
                RhumbHit hit = raw[i];
                hits[i] = new Hit
                {
                    Query = (int)hit.query,
                    Body = new Body(hit.body.Item1),
                    Distance = hit.distance,
                    Point = new Vec3(hit.point[0], hit.point[1], hit.point[2]),
                    Normal = new Vec3(hit.normal[0], hit.normal[1], hit.normal[2]),
                };
            }
            return hits;
        }

        /// <summary>Deletes the scene for all of its clients.</summary>
        public void Delete()
        {
            RhumbException.Check(Native.rhumb_scene_delete(Raw()));
        }

        /// <summary>Leaves the scene. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }

        private static RhumbJointDesc Checked(JointDesc desc)
        {
            if (desc == null)
            {
                throw new RhumbException(RhumbCode.Null, "desc must not be null");
            }
            return desc.Raw();
        }

        private static unsafe RhumbPoseBuffers WantBodies(IntPtr array)
        {
            return new RhumbPoseBuffers { bodies = (RhumbBody*)array };
        }

        private static unsafe RhumbPoseBuffers WantPositions(IntPtr array)
        {
            return new RhumbPoseBuffers { positions = (float*)array };
        }

        private static unsafe RhumbPoseBuffers WantRotations(IntPtr array)
        {
            return new RhumbPoseBuffers { rotations = (float*)array };
        }

        private static unsafe RhumbPoseBuffers WantLinear(IntPtr array)
        {
            return new RhumbPoseBuffers { linear_velocities = (float*)array };
        }

        private static unsafe RhumbPoseBuffers WantAngular(IntPtr array)
        {
            return new RhumbPoseBuffers { angular_velocities = (float*)array };
        }

        private static unsafe RhumbPoseBuffers WantResting(IntPtr array)
        {
            return new RhumbPoseBuffers { resting = (byte*)array };
        }

        /// <summary>The array of the present view, which the first read after a view fills.</summary>
        private unsafe ReadOnlySpan<T> Read<T>(ViewArray<T> array, Wanted wanted)
            where T : struct
        {
            while (array.View != view)
            {
                UIntPtr count;
                RhumbCode code;
                GCHandle pin = GCHandle.Alloc(array.Values, GCHandleType.Pinned);
                try
                {
                    RhumbPoseBuffers buffers = wanted(pin.AddrOfPinnedObject());
                    buffers.capacity = (UIntPtr)array.Values.Length;
                    code = Native.rhumb_scene_copy_poses(Raw(), &buffers, &count);
                }
                finally
                {
                    pin.Free();
                }
                if (code == RhumbCode.TooSmall)
                {
                    // A quarter more, so that a scene that grows does not make a new array for each view.
                    array.Values = new T[(int)count + (int)count / 4];
                    continue;
                }
                RhumbException.Check(code);
                array.Count = (int)count;
                array.View = view;
            }
            if (handle.IsClosed)
            {
                RhumbException.Check(Native.rhumb_scene_flush(Raw()));
            }
            return new ReadOnlySpan<T>(array.Values, 0, array.Count);
        }

        private RhumbScene Raw()
        {
            return new RhumbScene { id = handle.Id };
        }

        /// <summary>An array, and the view that it holds.</summary>
        private sealed class ViewArray<T>
        {
            internal T[] Values = new T[1];
            internal int Count;
            internal ulong View;
        }

        /// <summary>The number of a scene, which is closed with it.</summary>
        private sealed class SceneHandle : SafeHandleZeroOrMinusOneIsInvalid
        {
            internal SceneHandle(ulong id)
                : base(true)
            {
                SetHandle((IntPtr)(long)id);
            }

            /// <summary>Zero, which no scene has, once it is closed.</summary>
            internal ulong Id
            {
                get { return IsClosed ? 0 : (ulong)(long)handle; }
            }

            protected override bool ReleaseHandle()
            {
                return Native.rhumb_scene_close(new RhumbScene { id = (ulong)(long)handle }) == RhumbCode.Ok;
            }
        }
    }
}
