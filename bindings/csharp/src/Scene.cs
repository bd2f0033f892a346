// Scenes: bodies, commands, time, arrays, events, queries.

using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace Rhumb
{
    /// <summary>
    /// A client of one scene. One thread at a time; a second one gets RhumbCode.Busy at once.
    ///
    /// The arrays of the view belong to this object. A span of one is valid for ever and never points to freed memory; the
    /// next Advance, Wait or Poll and a new read of the property write the next view into the same array.
    /// </summary>
    public sealed partial class Scene : IDisposable
    {
        private readonly NativeHandle handle;
        private readonly ViewArrays arrays;

        internal Scene(ulong id)
        {
            handle = new NativeHandle(id, number => Native.rhumb_scene_close(new RhumbScene { id = number }));
            arrays = new ViewArrays(handle);
        }

        /// <summary>Ids of the bodies of the view. All arrays have this order, which changes from view to view.</summary>
        public ReadOnlySpan<Body> Bodies
        {
            get { return arrays.Bodies; }
        }

        /// <summary>Centres of mass, or origins of this client's hulls and compounds.</summary>
        public ReadOnlySpan<Vec3> Positions
        {
            get { return arrays.Positions; }
        }

        /// <summary>Rotations body to world.</summary>
        public ReadOnlySpan<Quat> Rotations
        {
            get { return arrays.Rotations; }
        }

        public ReadOnlySpan<Vec3> LinearVelocities
        {
            get { return arrays.LinearVelocities; }
        }

        /// <summary>rad/s about world axes.</summary>
        public ReadOnlySpan<Vec3> AngularVelocities
        {
            get { return arrays.AngularVelocities; }
        }

        /// <summary>Not zero for each body that rests.</summary>
        public ReadOnlySpan<byte> Resting
        {
            get { return arrays.Resting; }
        }

        /// <summary>
        /// Places, in the arrays, of the bodies whose pose differs from that of the last view: each place once, in any order.
        /// A body that is new in the view is among them once it has a pose.
        ///
        /// The first read of Changed, Removed or Time after a view also converts the view's arrays if the coordinates are not
        /// Rhumb's own.
        /// </summary>
        public ReadOnlySpan<int> Changed
        {
            get { return arrays.Changed; }
        }

        /// <summary>
        /// Bodies of the last view that are not in this one: removed, or in no cell that is taken. They have no place in the arrays.
        /// </summary>
        public ReadOnlySpan<Body> Removed
        {
            get { return arrays.Removed; }
        }

        /// <summary>
        /// The moment of the view, in lockstep too, where it is a whole tick. Tick zero before the first view.
        /// </summary>
        public RenderTime Time
        {
            get { return arrays.Time; }
        }

        public Body Add(BodyDesc desc)
        {
            return Add(new[] { desc })[0];
        }

        /// <summary>Adds bodies in one call; ids in the same order. If one is wrong, none is added.</summary>
        public unsafe Body[] Add(BodyDesc[] descs)
        {
            if (descs == null)
            {
                throw new RhumbException(RhumbCode.Null, "descs must not be null");
            }
            var raw = new RhumbBodyDesc[descs.Length];
            var ids = new Body[descs.Length];
            var pins = new List<GCHandle>();
            try
            {
                for (int i = 0; i < descs.Length; i++)
                {
                    BodyDesc desc = descs[i];
                    if (desc == null)
                    {
                        throw new RhumbException(RhumbCode.Null, "descs[" + i + "] must not be null");
                    }
                    raw[i] = desc.Raw();
                    raw[i].shape = desc.Shape.Pinned(pins);
                }
                fixed (RhumbBodyDesc* from = raw)
                fixed (Body* to = ids)
                {
                    RhumbException.Check(
                        Native.rhumb_scene_add_bodies(Raw(), from, (UIntPtr)descs.Length, (RhumbBody*)to));
                }
            }
            finally
            {
                foreach (GCHandle pin in pins)
                {
                    pin.Free();
                }
            }
            return ids;
        }

        /// <summary>Queues commands in one call, and returns the number of the last. If one is wrong, none is queued.</summary>
        public unsafe ulong Send(params Command[] commands)
        {
            if (commands == null)
            {
                throw new RhumbException(RhumbCode.Null, "commands must not be null");
            }
            ulong last = 0;
            fixed (Command* from = commands)
            {
                RhumbException.Check(
                    Native.rhumb_scene_command(Raw(), (RhumbCommand*)from, (UIntPtr)commands.Length, &last));
            }
            return last;
        }

        /// <summary>
        /// Queues the addition of a joint under a number that no joint of the scene has; returns the command's number.
        /// </summary>
        public unsafe ulong AddJoint(uint joint, JointDesc desc)
        {
            RhumbJointDesc raw = Checked(desc);
            ulong number;
            RhumbException.Check(Native.rhumb_scene_add_joint(Raw(), joint, &raw, &number));
            return number;
        }

        /// <summary>Queues the replacement of a joint, its limits and motors among others.</summary>
        public unsafe ulong ChangeJoint(uint joint, JointDesc desc)
        {
            RhumbJointDesc raw = Checked(desc);
            ulong number;
            RhumbException.Check(Native.rhumb_scene_change_joint(Raw(), joint, &raw, &number));
            return number;
        }

        /// <summary>Queues the removal of a joint. A joint goes with either of its bodies too.</summary>
        public unsafe ulong RemoveJoint(uint joint)
        {
            ulong number;
            RhumbException.Check(Native.rhumb_scene_remove_joint(Raw(), joint, &number));
            return number;
        }

        /// <summary>
        /// Requests authority over kinematic bodies, 256 at most, in place of those of now; none ends it. The server's bodies
        /// are within the tolerance of what Publish sends, and the tolerance of a stream adds to it. It is sent at once. An
        /// event, AuthorityGranted or AuthorityDenied, answers; a denial is a RhumbRefusedException too. A second request
        /// before the answer is an error of the call. For a member by cells, the grant of a body waits until a cell that it
        /// takes has had the body.
        /// </summary>
        public unsafe void TakeAuthority(Body[] bodies, double toleranceInMetres = 0.02)
        {
            if (bodies == null)
            {
                throw new RhumbException(RhumbCode.Null, "bodies must not be null");
            }
            fixed (Body* from = bodies)
            {
                RhumbException.Check(Native.rhumb_scene_take_authority(
                    Raw(), (RhumbBody*)from, (UIntPtr)bodies.Length, toleranceInMetres));
            }
        }

        /// <summary>
        /// Publishes the states of all bodies under this client's authority, once per frame. The tick of the states, or null
        /// while nothing is published: before the authority is granted, before the server's clock is known, and for a second
        /// frame of one tick. A body that is left out stands still.
        /// </summary>
        public unsafe ulong? Publish(params BodyState[] states)
        {
            if (states == null)
            {
                throw new RhumbException(RhumbCode.Null, "states must not be null");
            }
            var raw = new RhumbBodyState[states.Length];
            for (int i = 0; i < raw.Length; i++)
            {
                raw[i] = states[i].Raw();
            }
            byte published;
            ulong tick;
            fixed (RhumbBodyState* from = raw)
            {
                RhumbException.Check(
                    Native.rhumb_scene_publish(Raw(), from, (UIntPtr)raw.Length, &published, &tick));
            }
            return published != 0 ? tick : (ulong?)null;
        }

        /// <summary>
        /// Queues the removal of the shapes that came with this client's bodies and that no body has any more; returns their
        /// number. Queued additions, changes and removals of bodies count.
        /// </summary>
        public unsafe int RemoveUnusedShapes()
        {
            UIntPtr count;
            RhumbException.Check(Native.rhumb_scene_remove_unused_shapes(Raw(), &count));
            return checked((int)count);
        }

        /// <summary>Ticks ahead of the server's clock by which Publish is, in place of JoinOptions.LeadTicks.</summary>
        public void SetLeadTicks(double ticks)
        {
            RhumbException.Check(Native.rhumb_scene_set_lead_ticks(Raw(), ticks));
        }

        /// <summary>Sends the queued commands at once.</summary>
        public void Flush()
        {
            RhumbException.Check(Native.rhumb_scene_flush(Raw()));
        }

        /// <summary>
        /// Steps a lockstep scene once, computes the view, and returns its tick. Throws RhumbRefusedException for what the
        /// server refused, after the tick is done; the next call continues.
        /// </summary>
        public unsafe ulong Advance(uint depth = 0)
        {
            ulong tick;
            using (arrays.BeginView())
            {
                RhumbRefusedException.CheckDone(Native.rhumb_scene_advance(Raw(), depth, &tick), Raw());
            }
            return tick;
        }

        /// <summary>Waits again for the tick of an Advance that timed out.</summary>
        public unsafe ulong Wait(uint depth = 0)
        {
            ulong tick;
            using (arrays.BeginView())
            {
                RhumbRefusedException.CheckDone(Native.rhumb_scene_wait(Raw(), depth, &tick), Raw());
            }
            return tick;
        }

        /// <summary>
        /// Computes the view of a free-running scene for now, in ticks since the scene's first. A lockstep scene stands still
        /// until a client advances it. Throws RhumbRefusedException as Advance does.
        /// </summary>
        public unsafe double Poll()
        {
            RhumbTime shown;
            using (arrays.BeginView())
            {
                RhumbRefusedException.CheckDone(Native.rhumb_scene_poll(Raw(), &shown), Raw());
            }
            return shown.tick + shown.fraction;
        }

        /// <summary>Handles what arrives for a time in seconds, without computing the view.</summary>
        public void Idle(double duration)
        {
            RhumbException.Check(Native.rhumb_scene_idle(Raw(), duration));
        }

        /// <summary>The newest tick at which every copy is within its tolerance, of what has arrived.</summary>
        public ulong CompleteTick
        {
            get { return Statistics.CompleteTick; }
        }

        /// <summary>Statistics of this client since it connected.</summary>
        public unsafe Statistics Statistics
        {
            get
            {
                RhumbStatistics raw;
                RhumbException.Check(Native.rhumb_scene_statistics(Raw(), &raw));
                return new Statistics
                {
                    SentBytes = raw.sent_bytes,
                    ReceivedBytes = raw.received_bytes,
                    Updates = raw.updates,
                    CompleteTick = raw.complete_tick,
                    UpstreamUpdates = raw.upstream_updates,
                    UpstreamPackets = raw.upstream_packets,
                    UpstreamBytes = raw.upstream_bytes,
                    EventsLeftOut = raw.events_left_out,
                    ContactsLeftOut = raw.contacts_left_out,
                };
            }
        }

        /// <summary>Place of a body in the arrays; -1 for a body that is not in the view, as Array.IndexOf says it.</summary>
        public unsafe int Place(Body body)
        {
            UIntPtr place;
            RhumbCode code = Native.rhumb_scene_place(Raw(), Raw(body), &place);
            if (code == RhumbCode.Invalid)
            {
                return -1;
            }
            RhumbException.Check(code);
            return (int)place;
        }

        /// <summary>
        /// How far any point of a body as the view shows it may be from its true place at the moment of the view; infinite
        /// while that is not known.
        /// </summary>
        public unsafe float ErrorBound(Body body)
        {
            float bound;
            RhumbBody raw = Raw(body);
            RhumbException.Check(Native.rhumb_scene_error_bounds(Raw(), &raw, (UIntPtr)1, &bound));
            return bound;
        }

        /// <summary>
        /// How far any point of each body as the view shows it may be from its true place at the moment of the view, in the
        /// scene's unit of length. Infinite while nothing finite is known: a packet is missing, or a free-running view shows a
        /// moment of which the news has not arrived; DelayTicks of the network's delay and a little more make it finite. In
        /// the order of the bodies, such as Bodies. A body that is not in the view is an error of the call.
        /// </summary>
        public unsafe float[] ErrorBounds(ReadOnlySpan<Body> bodies)
        {
            var bounds = new float[bodies.Length];
            fixed (Body* from = &MemoryMarshal.GetReference(bodies))
            fixed (float* to = bounds)
            {
                RhumbException.Check(
                    Native.rhumb_scene_error_bounds(Raw(), (RhumbBody*)from, (UIntPtr)bounds.Length, to));
            }
            return bounds;
        }

        /// <summary>
        /// How far any point of a body may be off at a tick by what is known of it, whatever the view shows.
        /// </summary>
        public unsafe float TickErrorBound(Body body, ulong tick)
        {
            float bound;
            RhumbBody raw = Raw(body);
            RhumbException.Check(Native.rhumb_scene_tick_error_bounds(Raw(), tick, &raw, (UIntPtr)1, &bound));
            return bound;
        }

        /// <summary>
        /// Takes the oldest unread event; false if there is none. At most 65,536 unread events are kept; EventsLeftOut of the
        /// statistics counts those that were dropped, the oldest first.
        /// </summary>
        public unsafe bool TryNextEvent(out Event next)
        {
            RhumbEvent raw;
            RhumbException.Check(Native.rhumb_scene_poll_event(Raw(), &raw));
            next = Event.Of(&raw);
            return next.Kind != RhumbEventKind.None;
        }

        /// <summary>Asks the server, and waits; hits are in the order of the queries.</summary>
        public Hit[] Ask(params Query[] queries)
        {
            return Ask(out ulong unused, queries);
        }

        /// <summary>Asks the server, and waits; the same with the tick whose scene was asked.</summary>
        public unsafe Hit[] Ask(out ulong tick, params Query[] queries)
        {
            if (queries == null)
            {
                throw new RhumbException(RhumbCode.Null, "queries must not be null");
            }
            long capacity = 0;
            foreach (Query query in queries)
            {
                // A query of more is an error of the call.
                capacity += Math.Min(query.Raw.hits, 65);
            }
            var raw = new RhumbHit[capacity];
            UIntPtr count;
            ulong asked;
            fixed (Query* from = queries)
            fixed (RhumbHit* to = raw)
            {
                RhumbException.Check(Native.rhumb_scene_query(
                    Raw(), (RhumbQuery*)from, (UIntPtr)queries.Length, to, (UIntPtr)capacity, &count, &asked));
            }
            tick = asked;
            var hits = new Hit[(int)count];
            for (int i = 0; i < hits.Length; i++)
            {
                RhumbHit hit = raw[i];
                hits[i] = new Hit
                {
                    Query = (int)hit.query,
                    Body = new Body(hit.body.Item1),
                    Distance = hit.distance,
                    Point = new Vec3(hit.point[0], hit.point[1], hit.point[2]),
                    Normal = new Vec3(hit.normal[0], hit.normal[1], hit.normal[2]),
                };
            }
            return hits;
        }

        /// <summary>
        /// Adds a robot or a scene from a file: URDF, MJCF with their meshes, glTF, or Rhumb's JSON. Gravity and ticks are the
        /// scene's.
        /// </summary>
        public unsafe Loaded Load(string path, LoadOptions options = null)
        {
            options = options ?? new LoadOptions();
            RhumbLoaded loaded;
            fixed (byte* file = Utf8.Bytes(path))
            fixed (byte* packages = Utf8.Bytes(string.Join(";", options.Packages)))
            {
                RhumbLoadOptions raw = options.Raw(packages);
                RhumbException.Check(Native.rhumb_scene_load(Raw(), file, &raw, &loaded));
            }
            try
            {
                return new Loaded(loaded.id);
            }
            finally
            {
                RhumbException.Check(Native.rhumb_loaded_close(loaded));
            }
        }

        /// <summary>
        /// The address of the page that shows the scene to browsers of this machine. The server must be in this process.
        /// </summary>
        public unsafe string Page()
        {
            RhumbAddress address;
            RhumbException.Check(Native.rhumb_scene_page(Raw(), &address));
            return Utf8.Read((byte*)address.text);
        }

        /// <summary>
        /// The whole state of the scene, with everything that this client has sent. The server must be in this process, without
        /// sockets.
        /// </summary>
        public unsafe Checkpoint Save()
        {
            RhumbCheckpoint checkpoint;
            RhumbException.Check(Native.rhumb_scene_save(Raw(), &checkpoint));
            return new Checkpoint(checkpoint);
        }

        /// <summary>Deletes the scene for all of its clients.</summary>
        public void Delete()
        {
            RhumbException.Check(Native.rhumb_scene_delete(Raw()));
        }

        /// <summary>Leaves the scene. A second time does nothing.</summary>
        public void Dispose()
        {
            handle.Dispose();
        }

        private static RhumbJointDesc Checked(JointDesc desc)
        {
            if (desc == null)
            {
                throw new RhumbException(RhumbCode.Null, "desc must not be null");
            }
            return desc.Raw();
        }

        private static RhumbBody Raw(Body body)
        {
            return new RhumbBody { Item1 = body.Word };
        }

        private RhumbScene Raw()
        {
            return new RhumbScene { id = handle.Id };
        }
    }
}
