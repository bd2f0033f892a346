// The native library that runs.

using System;

namespace Rhumb
{
    /// <summary>The native library under these sources.</summary>
    public static class RhumbLibrary
    {
        /// <summary>
        /// Its version: major, minor, and the patch as Build. Until version 1, the interface may change with each minor
        /// version; after it, with each major version.
        /// </summary>
        public static Version Version
        {
            get
            {
                uint packed = Native.rhumb_version();
                return new Version((int)(packed >> 16), (int)(packed >> 8 & 0xff), (int)(packed & 0xff));
            }
        }
    }
}
