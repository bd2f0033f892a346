// Scenes as bytes, from which scenes continue.

using System;

namespace Rhumb
{
    /// <summary>
    /// The whole state of a scene: Scene.Save makes it, and LocalServer.Restore makes scenes of it, which run to the same bits,
    /// given the same commands before the same ticks.
    /// </summary>
    public sealed class Checkpoint : IDisposable
    {
        private readonly NativeHandle handle;

        internal Checkpoint(RhumbCheckpoint checkpoint)
        {
            handle = new NativeHandle(
                checkpoint.id,
                number => Native.rhumb_checkpoint_close(new RhumbCheckpoint { id = number }));
        }

        /// <summary>
        /// Reads it from its bytes. Damaged bytes, and those of another version, are refused. The checksum finds damage and no malice.
        /// </summary>
        public static unsafe Checkpoint Read(byte[] bytes)
        {
            if (bytes == null)
            {
                throw new ArgumentNullException(nameof(bytes));
            }
            RhumbCheckpoint checkpoint;
            fixed (byte* first = bytes)
            {
                RhumbException.Check(Native.rhumb_checkpoint_read(first, (UIntPtr)(ulong)bytes.Length, &checkpoint));
            }
            return new Checkpoint(checkpoint);
        }

        /// <summary>Its bytes, for a file.</summary>
        public unsafe byte[] ToBytes()
        {
            UIntPtr count;
            RhumbCode code = Native.rhumb_checkpoint_bytes(Raw, null, UIntPtr.Zero, &count);
            if (code != RhumbCode.TooSmall)
            {
                RhumbException.Check(code);
            }
            var bytes = new byte[(ulong)count];
            fixed (byte* first = bytes)
            {
                RhumbException.Check(Native.rhumb_checkpoint_bytes(Raw, first, count, &count));
            }
            return bytes;
        }

        /// <summary>Scenes that were made of it stay. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }

        internal RhumbCheckpoint Raw
        {
            get { return new RhumbCheckpoint { id = handle.Id }; }
        }
    }
}
