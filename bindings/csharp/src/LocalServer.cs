// Servers in the process of the caller.

using System;
using Microsoft.Win32.SafeHandles;

namespace Rhumb
{
    /// <summary>A server in this process for several clients. It ends with the last of its connections and scenes.</summary>
    public sealed class LocalServer : IDisposable
    {
        private readonly ServerHandle handle;

        /// <summary>
        /// Without a thread of its own, it steps within the calls of its clients, which take turns if they are on several
        /// threads. With one, a free-running scene moves on between calls.
        /// </summary>
        public unsafe LocalServer(bool ownThread = false)
        {
            RhumbLocalServer server;
            RhumbException.Check(Native.rhumb_local_server_open((byte)(ownThread ? 1 : 0), &server));
            handle = new ServerHandle(server.id);
        }

        /// <summary>Connects one more client. The time limit in seconds holds for every later call that waits.</summary>
        public unsafe Connection Connect(double timeout = 5.0)
        {
            RhumbConnection connection;
            RhumbException.Check(Native.rhumb_local_server_connect(handle.Server, timeout, &connection));
            return new Connection(connection.id);
        }

        /// <summary>Its connections and scenes stay. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }

        /// <summary>The number of a server, which is closed with it.</summary>
        private sealed class ServerHandle : SafeHandleZeroOrMinusOneIsInvalid
        {
            internal ServerHandle(ulong id)
                : base(true)
            {
                SetHandle((IntPtr)(long)id);
            }

            /// <summary>Zero, which no server has, once it is closed.</summary>
            internal RhumbLocalServer Server
            {
                get { return new RhumbLocalServer { id = IsClosed ? 0 : (ulong)(long)handle }; }
            }

            protected override bool ReleaseHandle()
            {
                return Native.rhumb_local_server_close(new RhumbLocalServer { id = (ulong)(long)handle }) == RhumbCode.Ok;
            }
        }
    }
}
