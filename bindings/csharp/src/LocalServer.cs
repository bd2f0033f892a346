// Servers in the process of the caller.

using System;

namespace Rhumb
{
    /// <summary>A server in this process for several clients. It ends with the last of its connections and scenes.</summary>
    public sealed class LocalServer : IDisposable
    {
        private readonly NativeHandle handle;

        /// <summary>
        /// Without a thread of its own, it steps within the calls of its clients, which take turns if they are on several
        /// threads. With one, a free-running scene moves on between calls.
        /// </summary>
        public LocalServer(bool ownThread = false)
            : this(Opened(ownThread))
        {
        }

        private LocalServer(RhumbLocalServer server)
        {
            handle = new NativeHandle(server.id, number => Native.rhumb_local_server_close(new RhumbLocalServer { id = number }));
        }

        private static unsafe RhumbLocalServer Opened(bool ownThread)
        {
            RhumbLocalServer server;
            RhumbException.Check(Native.rhumb_local_server_open((byte)(ownThread ? 1 : 0), &server));
            return server;
        }

        /// <summary>
        /// A server that other processes join too, by Address. It has threads of its own. listen: IP address and port; port 0
        /// is a free one, and null a free port of this machine. There are no tokens: an address that other machines reach must
        /// be meant to be open.
        /// </summary>
        public static unsafe LocalServer Serve(string listen = null, bool openToNetwork = false)
        {
            RhumbLocalServer server;
            fixed (byte* at = Utf8.Bytes(listen))
            {
                CheckServed(Native.rhumb_serve(at, (byte)(openToNetwork ? 1 : 0), &server));
            }
            return new LocalServer(server);
        }

        /// <summary>
        /// A server of a scene that this program feeds, by this name, and that other processes join: see Feed. listen and
        /// openToNetwork are as those of Serve.
        /// </summary>
        public static unsafe LocalServer ServeFed(string scene, string listen = null, bool openToNetwork = false)
        {
            RhumbLocalServer server;
            fixed (byte* name = Utf8.Bytes(scene))
            fixed (byte* at = Utf8.Bytes(listen))
            {
                CheckServed(Native.rhumb_serve_fed(name, at, (byte)(openToNetwork ? 1 : 0), &server));
            }
            return new LocalServer(server);
        }

        private static void CheckServed(RhumbCode code)
        {
            if (code != RhumbCode.Ok)
            {
                // The option has the name of this language.
                string reason = RhumbException.LastError().Replace("open_to_network", "openToNetwork");
                throw new RhumbException(code, reason);
            }
        }

        /// <summary>
        /// The one text by which other processes connect, with Trust.ByAddress. Empty for a server without sockets.
        /// </summary>
        public unsafe string Address
        {
            get
            {
                RhumbAddress address;
                RhumbException.Check(Native.rhumb_local_server_address(Raw, &address));
                return Utf8.Read((byte*)address.text);
            }
        }

        /// <summary>Connects one more client. The time limit in seconds holds for every later call that waits.</summary>
        public unsafe Connection Connect(double timeout = 5.0)
        {
            RhumbConnection connection;
            RhumbException.Check(Native.rhumb_local_server_connect(Raw, timeout, &connection));
            return new Connection(connection.id);
        }

        /// <summary>
        /// Connects the client that will feed a scene: one whose engine is this program's. It makes the scene when it joins by
        /// this name, adds bodies, and hands their states over by Scene.Feed. The scene ends with it.
        /// </summary>
        public unsafe Connection Feed(string scene, double timeout = 5.0)
        {
            RhumbConnection connection;
            fixed (byte* name = Utf8.Bytes(scene))
            {
                RhumbException.Check(Native.rhumb_local_server_feed(Raw, name, timeout, &connection));
            }
            return new Connection(connection.id);
        }

        /// <summary>
        /// Makes a scene that continues from a checkpoint, to be joined by its name. Bodies keep their ids. The scene has no
        /// members at first: it ends if none joins for ten minutes.
        /// </summary>
        public unsafe void Restore(string scene, Checkpoint checkpoint)
        {
            if (checkpoint == null)
            {
                throw new ArgumentNullException(nameof(checkpoint));
            }
            fixed (byte* name = Utf8.Bytes(scene))
            {
                RhumbException.Check(Native.rhumb_local_server_restore(Raw, name, checkpoint.Raw));
            }
        }

        /// <summary>Its connections and scenes stay. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }

        private RhumbLocalServer Raw
        {
            get { return new RhumbLocalServer { id = handle.Id }; }
        }
    }
}
