// The number of a scene, which is closed with it.

using System;
using Microsoft.Win32.SafeHandles;

namespace Rhumb
{
    /// <summary>The number of a scene, which is closed with it.</summary>
    internal sealed class SceneHandle : SafeHandleZeroOrMinusOneIsInvalid
    {
        internal SceneHandle(ulong id)
            : base(true)
        {
            SetHandle((IntPtr)(long)id);
        }

        /// <summary>Zero, which no scene has, once it is closed.</summary>
        internal RhumbScene Scene
        {
            get { return new RhumbScene { id = IsClosed ? 0 : (ulong)(long)handle }; }
        }

        protected override bool ReleaseHandle()
        {
            return Native.rhumb_scene_close(new RhumbScene { id = (ulong)(long)handle }) == RhumbCode.Ok;
        }
    }
}
