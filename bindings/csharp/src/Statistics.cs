// Statistics of a client.

namespace Rhumb
{
    /// <summary>Statistics of a client since it connected.</summary>
    public struct Statistics
    {
        /// <summary>Bytes in UDP datagrams to the server.</summary>
        public ulong SentBytes;

        /// <summary>Bytes in UDP datagrams from the server.</summary>
        public ulong ReceivedBytes;

        /// <summary>Updates of bodies that the stream carried.</summary>
        public ulong Updates;

        /// <summary>The newest tick at which every copy is within its tolerance.</summary>
        public ulong CompleteTick;

        /// <summary>Updates of bodies that this client published under its authority, since it was granted.</summary>
        public ulong UpstreamUpdates;

        /// <summary>Packets of these updates.</summary>
        public ulong UpstreamPackets;

        /// <summary>Bytes of these packets.</summary>
        public ulong UpstreamBytes;

        /// <summary>Events that were dropped unread: 65,536 are kept.</summary>
        public ulong EventsLeftOut;

        /// <summary>Pairs of bodies that touch and that the calls about contacts lack: a client knows 32,768.</summary>
        public ulong ContactsLeftOut;
    }
}
