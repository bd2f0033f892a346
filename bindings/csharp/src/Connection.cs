// Connections, before they join a scene.

using System;

namespace Rhumb
{
    /// <summary>Which server to trust.</summary>
    public sealed class Trust
    {
        private Trust()
        {
        }

        internal string Sha256 { get; private set; }

        internal string RootsPath { get; private set; }

        /// <summary>The server whose certificate has this SHA-256, as the server prints it.</summary>
        public static Trust Fingerprint(string fingerprint)
        {
            return new Trust { Sha256 = fingerprint };
        }

        /// <summary>The server whose fingerprint the address ends with, behind a #.</summary>
        public static readonly Trust ByAddress = new Trust();

        /// <summary>A server whose certificate one of the roots in this PEM file signed.</summary>
        public static Trust Roots(string path)
        {
            return new Trust { RootsPath = path };
        }
    }

    /// <summary>A connection to a server that has joined no scene.</summary>
    public sealed class Connection : IDisposable
    {
        private readonly NativeHandle handle;

        internal Connection(ulong id)
        {
            handle = new NativeHandle(id, number => Native.rhumb_connection_close(new RhumbConnection { id = number }));
        }

        /// <summary>
        /// Connects within the time limit in seconds, which holds for every later call that waits. No token for a server
        /// that needs none.
        /// </summary>
        public static unsafe Connection Open(string address, Trust trust, string token = null, double timeout = 5.0)
        {
            if (trust == null)
            {
                throw new RhumbException(RhumbCode.Null, "trust must not be null");
            }
            RhumbConnection connection;
            fixed (byte* host = Utf8.Bytes(address))
            fixed (byte* fingerprint = Utf8.Bytes(trust.Sha256))
            fixed (byte* roots = Utf8.Bytes(trust.RootsPath))
            fixed (byte* shown = Utf8.Bytes(token))
            {
                var options = new RhumbConnectOptions
                {
                    address = host,
                    fingerprint = fingerprint,
                    roots = roots,
                    token = shown,
                    timeout_s = timeout,
                };
                RhumbException.Check(Native.rhumb_connect(&options, &connection));
            }
            return new Connection(connection.id);
        }

        /// <summary>
        /// Connects to a server of the connection's own, in this process and without sockets. It steps within the calls of
        /// the scene that is joined, and ends with it.
        /// </summary>
        public static unsafe Connection Local()
        {
            RhumbConnection connection;
            RhumbException.Check(Native.rhumb_local(&connection));
            return new Connection(connection.id);
        }

        /// <summary>Joins a scene, and uses the connection up; wrong arguments do not.</summary>
        public unsafe Scene Join(string name, JoinOptions options = null)
        {
            RhumbJoinOptions raw = (options ?? new JoinOptions()).Raw();
            RhumbScene scene;
            fixed (byte* text = Utf8.Bytes(name))
            {
                RhumbException.Check(Native.rhumb_join(new RhumbConnection { id = handle.Id }, text, &raw, &scene));
            }
            handle.Dispose();
            return new Scene(scene.id);
        }

        /// <summary>Closes the connection, unless it has joined. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }
    }
}
