// Events.

namespace Rhumb
{
    /// <summary>Something that happened, or the answer to a command. A field that its kind does not name is zero or empty.</summary>
    public struct Event
    {
        public RhumbEventKind Kind;

        /// <summary>The newest complete tick when the event was read: no view of an earlier tick shows its effect.</summary>
        public ulong After;

        /// <summary>The tick in which it happened, if the server says so; otherwise the same as After.</summary>
        public ulong Tick;
        public ulong Number;
        public Body Body;
        public Body Other;
        public Vec3 Point;
        public Vec3 Normal;
        public float Separation;
        public float Force;
        public string Text;

        internal static unsafe Event Of(RhumbEvent* raw)
        {
            return new Event
            {
                Kind = (RhumbEventKind)raw->kind,
                After = raw->after,
                Tick = raw->tick,
                Number = raw->number,
                Body = new Body(raw->body.Item1),
                Other = new Body(raw->other.Item1),
                Point = new Vec3(raw->point[0], raw->point[1], raw->point[2]),
                Normal = new Vec3(raw->normal[0], raw->normal[1], raw->normal[2]),
                Separation = raw->separation,
                Force = raw->force,
                Text = Utf8.Read((byte*)raw->text),
            };
        }
    }
}
