// Numbers of what the native library holds, which are closed with handles.

using System;
using Microsoft.Win32.SafeHandles;

namespace Rhumb
{
    /// <summary>The number of a connection, a server, a checkpoint or a scene, which is closed with it.</summary>
    internal sealed class NativeHandle : SafeHandleZeroOrMinusOneIsInvalid
    {
        private readonly Func<ulong, RhumbCode> close;

        internal NativeHandle(ulong id, Func<ulong, RhumbCode> close)
            : base(true)
        {
            this.close = close;
            SetHandle((IntPtr)(long)id);
        }

        /// <summary>Zero, which nothing has, once it is closed.</summary>
        internal ulong Id
        {
            get { return IsClosed ? 0 : (ulong)(long)handle; }
        }

        protected override bool ReleaseHandle()
        {
            RhumbCode code = close((ulong)(long)handle);
            // A connection that has joined is closed already.
            return code == RhumbCode.Ok || code == RhumbCode.Closed;
        }
    }
}
