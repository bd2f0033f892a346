// The arrays of the view, copied when they are first read.

using System;
using System.Runtime.InteropServices;
using System.Threading;

namespace Rhumb
{
    /// <summary>
    /// The arrays of a scene's view. Each is copied when it is first read after a view, into memory of .NET, so that no span
    /// ever points to memory of the library.
    /// </summary>
    internal sealed class ViewArrays
    {
        private readonly NativeHandle handle;
        private readonly ViewArray<Body> bodies = new ViewArray<Body>();
        private readonly ViewArray<Vec3> positions = new ViewArray<Vec3>();
        private readonly ViewArray<Quat> rotations = new ViewArray<Quat>();
        private readonly ViewArray<Vec3> linearVelocities = new ViewArray<Vec3>();
        private readonly ViewArray<Vec3> angularVelocities = new ViewArray<Vec3>();
        private readonly ViewArray<byte> resting = new ViewArray<byte>();
        private readonly ViewArray<int> changed = new ViewArray<int>();
        private readonly ViewArray<Body> removed = new ViewArray<Body>();
        private readonly Turn turn = new Turn();
        private RenderTime time;

        /// <summary>Counts the views, so that an array knows whether it holds the present one.</summary>
        private ulong view = 1;

        internal ViewArrays(NativeHandle handle)
        {
            this.handle = handle;
        }

        private RhumbScene Raw
        {
            get { return new RhumbScene { id = handle.Id }; }
        }

        private delegate RhumbPoseBuffers Wanted(IntPtr array);

        internal ReadOnlySpan<Body> Bodies
        {
            get { return Read(bodies, WantBodies); }
        }

        internal ReadOnlySpan<Vec3> Positions
        {
            get { return Read(positions, WantPositions); }
        }

        internal ReadOnlySpan<Quat> Rotations
        {
            get { return Read(rotations, WantRotations); }
        }

        internal ReadOnlySpan<Vec3> LinearVelocities
        {
            get { return Read(linearVelocities, WantLinear); }
        }

        internal ReadOnlySpan<Vec3> AngularVelocities
        {
            get { return Read(angularVelocities, WantAngular); }
        }

        internal ReadOnlySpan<byte> Resting
        {
            get { return Read(resting, WantResting); }
        }

        internal ReadOnlySpan<int> Changed
        {
            get { return ReadLent(changed); }
        }

        internal ReadOnlySpan<Body> Removed
        {
            get { return ReadLent(removed); }
        }

        internal RenderTime Time
        {
            get
            {
                ReadLent(removed);
                return time;
            }
        }

        /// <summary>
        /// To be called before the library computes a view, and to be disposed of after it: the arrays are read anew, and no
        /// other thread copies what the library lends meanwhile.
        /// </summary>
        internal IDisposable BeginView()
        {
            IDisposable taken = turn.Take();
            view++;
            return taken;
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

        /// <summary>An array that the library copies.</summary>
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
                    code = Native.rhumb_scene_copy_poses(Raw, &buffers, &count);
                }
                finally
                {
                    pin.Free();
                }
                if (code == RhumbCode.TooSmall)
                {
                    array.Grow((int)count);
                    continue;
                }
                RhumbException.Check(code);
                array.Count = (int)count;
                array.View = view;
            }
            return Span(array);
        }

        /// <summary>An array that the library only lends; the first read after a view copies all of these.</summary>
        private ReadOnlySpan<T> ReadLent<T>(ViewArray<T> array)
            where T : struct
        {
            if (array.View != view)
            {
                CopyLent();
            }
            return Span(array);
        }

        /// <summary>
        /// Copies what the library only lends: valid until a call computes a view or closes the scene. The turn keeps other
        /// threads from the first, and the reference to the handle from the second.
        /// </summary>
        private unsafe void CopyLent()
        {
            bool isHeld = false;
            using (turn.Take())
            {
                try
                {
                    handle.DangerousAddRef(ref isHeld);
                    RhumbPoses lent;
                    RhumbException.Check(Native.rhumb_scene_poses(Raw, &lent));
                    time = new RenderTime(lent.tick, lent.fraction);
                    // Places are below 2³¹, as in arrays of .NET, so that they are read as int.
                    changed.Fill(new ReadOnlySpan<int>(lent.changed, (int)lent.changed_count), view);
                    removed.Fill(new ReadOnlySpan<Body>(lent.removed, (int)lent.removed_count), view);
                }
                catch (ObjectDisposedException)
                {
                    throw new RhumbException(RhumbCode.Closed, "it is closed, or was never open");
                }
                finally
                {
                    if (isHeld)
                    {
                        handle.DangerousRelease();
                    }
                }
            }
        }

        /// <summary>What an array holds, unless the scene is closed.</summary>
        private ReadOnlySpan<T> Span<T>(ViewArray<T> array)
            where T : struct
        {
            if (handle.IsClosed)
            {
                RhumbException.Check(Native.rhumb_scene_flush(Raw));
            }
            return new ReadOnlySpan<T>(array.Values, 0, array.Count);
        }

        /// <summary>An array, and the view that it holds.</summary>
        private sealed class ViewArray<T>
            where T : struct
        {
            internal T[] Values = new T[1];
            internal int Count;
            internal ulong View;

            /// <summary>A quarter more, so that a scene that grows does not make a new array for each view.</summary>
            internal void Grow(int count)
            {
                Values = new T[count + count / 4];
            }

            internal void Fill(ReadOnlySpan<T> values, ulong view)
            {
                if (values.Length > Values.Length)
                {
                    Grow(values.Length);
                }
                values.CopyTo(Values);
                Count = values.Length;
                View = view;
            }
        }

        /// <summary>
        /// One thread at a time computes a view or copies arrays that are lent. A second one is refused at once, as by every
        /// call of the library.
        /// </summary>
        private sealed class Turn : IDisposable
        {
            private int isTaken;

            internal Turn Take()
            {
                if (Interlocked.Exchange(ref isTaken, 1) != 0)
                {
                    throw new RhumbException(
                        RhumbCode.Busy, "another thread is inside a call of it; one thread at a time may use a scene");
                }
                return this;
            }

            public void Dispose()
            {
                Volatile.Write(ref isTaken, 0);
            }
        }
    }
}
