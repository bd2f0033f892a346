// A region's physics scene: what OpenSimulator calls, as a scene of Rhumb.

using System;
using System.Collections.Generic;
using log4net;
using Nini.Config;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>
    /// The region's clock leads: each frame sends what changed, advances the server, and shows the frame before. The server
    /// computes beside the region's other work, so a frame does not wait for its step. The region is the source of everything but
    /// motion: a server that was lost gets all bodies anew.
    /// </summary>
    public sealed class RegionScene : PhysicsScene
    {
        private const float LowestHeight = -100;

        private static readonly ILog Log = LogManager.GetLogger(typeof(RegionScene));

        /// <summary>Guards the sets of actors and what the region set of each, for moments. Calls on the server hold the
        /// other one.</summary>
        internal readonly object Gate = new object();
        private readonly object wire = new object();
        private readonly HashSet<RegionActor> actors = new HashSet<RegionActor>();
        private readonly HashSet<RegionActor> forms = new HashSet<RegionActor>();
        private readonly HashSet<RegionActor> changes = new HashSet<RegionActor>();
        private readonly HashSet<RegionActor> events = new HashSet<RegionActor>();
        private readonly HashSet<RegionActor> pushing = new HashSet<RegionActor>();
        private readonly List<Body> removals = new List<Body>();
        private readonly Dictionary<Body, RegionActor> bodies = new Dictionary<Body, RegionActor>();
        private readonly List<RegionActor> moved = new List<RegionActor>();
        private readonly string region;
        private RegionSettings settings;
        private RegionLink link;
        private RegionTerrain terrain;
        private Scene scene;
        private Body anchor;
        private uint joints;
        private ulong shown;
        private ulong asked;
        private double owed;
        /// <summary>Bodies were removed whose shapes the scene may still hold.</summary>
        private bool leftShapes;
        private double time;

        internal RegionScene(string region)
        {
            this.region = region;
            Name = EngineType = "Rhumb";
        }

        internal IMesher Mesher { get; private set; }

        internal uint Depth
        {
            get { return settings.PipelineDepth; }
        }

        internal float Gravity
        {
            get { return settings.Gravity; }
        }

        public override bool IsThreaded
        {
            get { return false; }
        }

        public override void Initialise(IMesher meshmerizer, IConfigSource config)
        {
            Initialise(meshmerizer, config, new Vector3(256, 256, 0));
        }

        public override void Initialise(IMesher meshmerizer, IConfigSource config, Vector3 regionExtent)
        {
            settings = new RegionSettings(config, region);
            Mesher = meshmerizer;
            terrain = new RegionTerrain((int)regionExtent.X, (int)regionExtent.Y);
            link = new RegionLink(settings);
        }

        public override void Dispose()
        {
            lock (wire)
            {
                link?.Dispose();
                scene = null;
            }
        }

        public override PhysicsActor AddAvatar(string avName, Vector3 position, Vector3 velocity, Vector3 size, bool isFlying)
        {
            return AddAvatar(0, avName, position, velocity, size, isFlying);
        }

        public override PhysicsActor AddAvatar(
            uint localID, string avName, Vector3 position, Vector3 velocity, Vector3 size, bool isFlying)
        {
            return Added(new RegionAvatar(this, localID, avName, position, velocity, size, isFlying));
        }

        public override PhysicsActor AddPrimShape(string primName, PrimitiveBaseShape pbs, Vector3 position, Vector3 size,
            Quaternion rotation, bool isPhysical, uint localid)
        {
            return Added(new RegionPrim(this, localid, primName, pbs, position, rotation, size, isPhysical));
        }

        public override void RemoveAvatar(PhysicsActor actor)
        {
            Drop(actor as RegionActor);
        }

        public override void RemovePrim(PhysicsActor prim)
        {
            (prim as RegionPrim)?.Unlink();
            Drop(prim as RegionActor);
        }

        public override void SetTerrain(float[] heightMap)
        {
            terrain.Set(heightMap);
        }

        public override void DeleteTerrain()
        {
            terrain.Set(null);
        }

        /// <summary>One frame. The value is the simulated time of the frame in seconds, zero without a server.</summary>
        public override float Simulate(float timeStep)
        {
            lock (wire)
            {
                Scene now = link.Take(out bool fresh);
                if (now == null)
                {
                    return 0;
                }
                scene = now;
                try
                {
                    if (fresh)
                    {
                        Restart();
                    }
                    Tell(timeStep);
                    owed += timeStep;
                    // A frame after a long pause does not step for seconds.
                    owed = Math.Min(owed, Math.Max(timeStep, 4 * settings.Frame));
                    ulong tick = shown;
                    while (owed >= settings.Frame && !IsLate())
                    {
                        owed -= settings.Frame;
                        asked += settings.PublishInterval;
                        tick = scene.Advance(Depth);
                    }
                    if (tick != shown)
                    {
                        Read((tick - shown) / (float)settings.TicksPerSecond);
                        shown = tick;
                    }
                    RegionEvents.Read(scene, bodies, terrain);
                }
                catch (RhumbException error)
                {
                    link.Failed(error);
                    scene = null;
                    return 0;
                }
            }
            time += timeStep;
            Raise();
            return timeStep;
        }

        public override void GetResults()
        {
        }

        public override void AddPhysicsActorTaint(PhysicsActor prim)
        {
        }

        public override void SetWaterLevel(float baseheight)
        {
        }

        public override Dictionary<uint, float> GetTopColliders()
        {
            return new Dictionary<uint, float>();
        }

        public override bool SupportsRayCast()
        {
            return true;
        }

        public override void RaycastWorld(Vector3 position, Vector3 direction, float length, RaycastCallback retMethod)
        {
            List<ContactResult> hits = RaycastWorld(position, direction, length, 1);
            ContactResult hit = hits.Count > 0 ? hits[0] : default(ContactResult);
            retMethod?.Invoke(hits.Count > 0, hit.Pos, hit.ConsumerID, hit.Depth, hit.Normal);
        }

        public override void RaycastWorld(Vector3 position, Vector3 direction, float length, int Count, RayCallback retMethod)
        {
            retMethod?.Invoke(RaycastWorld(position, direction, length, Count));
        }

        /// <summary>The nearest bodies along a line. It waits for the server's answer; none while there is no server.</summary>
        public override List<ContactResult> RaycastWorld(Vector3 position, Vector3 direction, float length, int Count)
        {
            var results = new List<ContactResult>();
            float scale = length / (float)Math.Sqrt(Math.Max(Geometry.Dot(direction, direction), 1e-12f));
            lock (wire)
            {
                if (scene == null)
                {
                    return results;
                }
                try
                {
                    uint hits = (uint)Math.Min(Math.Max(Count, 1), 64);
                    foreach (Hit hit in scene.Ask(Query.Ray(position.ToVec3(), (direction * scale).ToVec3(), hits)))
                    {
                        bodies.TryGetValue(hit.Body, out RegionActor actor);
                        results.Add(new ContactResult
                        {
                            Pos = hit.Point.ToVector3(),
                            Depth = hit.Distance,
                            ConsumerID = actor == null ? 0 : actor.LocalID,
                            Normal = hit.Normal.ToVector3(),
                        });
                    }
                }
                catch (RhumbException error)
                {
                    Log.WarnFormat("[RHUMB]: no answer to a ray from {0}: {1}", position, error.Message);
                }
            }
            return results;
        }

        /// <summary>An actor says its state at the next frame.</summary>
        internal void Changed(RegionActor actor)
        {
            lock (Gate)
            {
                changes.Add(actor);
            }
        }

        /// <summary>An actor gets a new body at the next frame.</summary>
        internal void Rebuild(RegionActor actor)
        {
            lock (Gate)
            {
                forms.Add(actor);
            }
        }

        internal void ChangeEvents(RegionActor actor)
        {
            lock (Gate)
            {
                events.Add(actor);
            }
        }

        /// <summary>Makes or changes the joint that drives an avatar.</summary>
        internal void Drive(RegionAvatar avatar)
        {
            try
            {
                if (avatar.Joint != 0)
                {
                    scene.ChangeJoint(avatar.Joint, avatar.Motors(anchor));
                    return;
                }
                scene.AddJoint(joints + 1, avatar.Motors(anchor));
                avatar.Joint = ++joints;
            }
            catch (RhumbException error) when (RegionLink.IsOfOneCall(error))
            {
                Log.WarnFormat("[RHUMB]: {0} ({1}) does not walk as the region wants: {2}", avatar.Name, avatar.LocalID,
                    error.Message);
            }
        }

        private RegionActor Added(RegionActor actor)
        {
            lock (Gate)
            {
                actors.Add(actor);
                forms.Add(actor);
            }
            return actor;
        }

        private void Drop(RegionActor actor)
        {
            if (actor == null)
            {
                return;
            }
            lock (Gate)
            {
                actor.IsDropped = true;
                actors.Remove(actor);
                forms.Remove(actor);
                if (!actor.Body.IsNone)
                {
                    removals.Add(actor.Body);
                    actor.Body = default(Body);
                }
            }
        }

        /// <summary>True if the next Advance would wait; a region that chose depth 0 waits.</summary>
        private bool IsLate()
        {
            if (Depth == 0)
            {
                return false;
            }
            // Takes what has arrived.
            scene.Idle(0);
            return scene.CompleteTick + Depth * settings.PublishInterval < asked + settings.PublishInterval;
        }

        /// <summary>Everything of the region is new to the server.</summary>
        private void Restart()
        {
            lock (Gate)
            {
                bodies.Clear();
                removals.Clear();
                joints = 0;
                shown = asked = 0;
                leftShapes = false;
                owed = 0;
                terrain.Forget();
                foreach (RegionActor actor in actors)
                {
                    actor.Forget();
                    forms.Add(actor);
                }
            }
            anchor = default(Body);
        }

        /// <summary>Sends what changed since the last frame; after an exception, the next frame sends it.</summary>
        private void Tell(float seconds)
        {
            List<RegionActor> formed, changed, reporters;
            lock (Gate)
            {
                formed = new List<RegionActor>(forms);
                forms.Clear();
                changes.ExceptWith(formed);
                changes.UnionWith(pushing);
                changed = new List<RegionActor>(changes);
                changes.Clear();
                reporters = new List<RegionActor>(events);
                events.Clear();
            }
            try
            {
                if (anchor.IsNone)
                {
                    anchor = scene.Add(BodyDesc.Fixed(Shape.Compound()));
                }
                leftShapes |= Remove(formed);
                leftShapes |= terrain.Remove(scene);
                // Before new shapes, which may need the room.
                if (leftShapes)
                {
                    scene.RemoveUnusedShapes();
                    leftShapes = false;
                }
                terrain.Tell(scene, anchor);
                Form(formed);
                Speak(formed, changed, reporters, seconds);
            }
            catch
            {
                lock (Gate)
                {
                    forms.UnionWith(formed.FindAll(actor => actor.Body.IsNone && !actor.IsDropped));
                    changes.UnionWith(formed);
                    changes.UnionWith(changed);
                    events.UnionWith(formed);
                    events.UnionWith(reporters);
                }
                throw;
            }
        }

        /// <summary>
        /// Removes the bodies of actors that get new ones, and of those that were removed; true if there were any.
        /// </summary>
        private bool Remove(List<RegionActor> formed)
        {
            var commands = new List<Command>();
            lock (Gate)
            {
                foreach (RegionActor actor in formed)
                {
                    if (!actor.Body.IsNone)
                    {
                        removals.Add(actor.Body);
                        actor.Forget();
                    }
                }
                foreach (Body body in removals)
                {
                    commands.Add(Command.RemoveBody(body));
                    bodies.Remove(body);
                }
                removals.Clear();
            }
            RegionLink.Send(scene, commands);
            return commands.Count > 0;
        }

        private void Speak(
            List<RegionActor> formed, List<RegionActor> changed, List<RegionActor> reporters, float seconds)
        {
            var commands = new List<Command>();
            foreach (RegionActor actor in changed)
            {
                if (actor.IsRefused && !actor.IsDropped)
                {
                    Rebuild(actor);
                }
                Speak(actor, commands, seconds);
            }
            foreach (RegionActor actor in formed)
            {
                Speak(actor, commands, seconds);
            }
            reporters.AddRange(formed);
            foreach (RegionActor actor in reporters)
            {
                if (!actor.Reports)
                {
                    actor.ForgetTouches();
                }
                if (!actor.Body.IsNone && !actor.IsDropped)
                {
                    uint bits = actor.Reports ? Native.RHUMB_EVENTS_CONTACTS | Native.RHUMB_EVENTS_SENSORS : 0;
                    commands.Add(Command.SetEvents(actor.Body, bits, 0));
                }
            }
            RegionLink.Send(scene, commands);
        }

        private void Speak(RegionActor actor, List<Command> commands, float seconds)
        {
            if (actor.Body.IsNone || actor.IsDropped)
            {
                pushing.Remove(actor);
                return;
            }
            actor.Speak(commands, seconds);
            if (actor.IsPushing)
            {
                pushing.Add(actor);
            }
            else
            {
                pushing.Remove(actor);
            }
        }

        /// <summary>Adds the bodies of actors in one call; a body that is refused is added as a box of its size.</summary>
        private void Form(List<RegionActor> formed)
        {
            var owners = new List<RegionActor>();
            var descs = new List<BodyDesc>();
            foreach (RegionActor actor in formed)
            {
                BodyDesc desc = actor.IsDropped ? null : actor.Describe(false);
                actor.IsRefused = false;
                if (desc != null)
                {
                    owners.Add(actor);
                    descs.Add(desc);
                }
            }
            try
            {
                Body[] ids = scene.Add(descs.ToArray());
                for (int i = 0; i < ids.Length; i++)
                {
                    Own(owners[i], ids[i]);
                }
            }
            catch (RhumbException error) when (RegionLink.IsOfOneCall(error))
            {
                for (int i = 0; i < owners.Count; i++)
                {
                    FormAlone(owners[i], descs[i]);
                }
            }
        }

        private void FormAlone(RegionActor actor, BodyDesc desc)
        {
            try
            {
                Own(actor, scene.Add(desc));
                return;
            }
            catch (RhumbException error) when (RegionLink.IsOfOneCall(error))
            {
                Log.WarnFormat("[RHUMB]: {0} ({1}) becomes a box of its size: {2}", actor.Name, actor.LocalID, error.Message);
            }
            try
            {
                Own(actor, scene.Add(actor.Describe(true)));
            }
            catch (RhumbException error) when (RegionLink.IsOfOneCall(error))
            {
                actor.IsRefused = true;
                Log.ErrorFormat("[RHUMB]: {0} ({1}) has no body: {2}. Change its size or position, and it is tried again",
                    actor.Name, actor.LocalID, error.Message);
            }
        }

        private void Own(RegionActor actor, Body body)
        {
            lock (Gate)
            {
                bodies[body] = actor;
                if (actor.IsDropped)
                {
                    removals.Add(body);
                    return;
                }
                actor.Body = body;
            }
        }

        /// <summary>Moves actors to where the view has their bodies, some seconds after the last view.</summary>
        private void Read(float seconds)
        {
            ReadOnlySpan<Body> ids = scene.Bodies;
            ReadOnlySpan<Vec3> positions = scene.Positions, linear = scene.LinearVelocities, angular = scene.AngularVelocities;
            ReadOnlySpan<Quat> rotations = scene.Rotations;
            ReadOnlySpan<byte> resting = scene.Resting;
            for (int i = 0; i < ids.Length; i++)
            {
                if (bodies.TryGetValue(ids[i], out RegionActor actor) && actor.IsDynamic
                    && actor.Hear(positions[i], rotations[i], linear[i], angular[i], resting[i] != 0, seconds))
                {
                    moved.Add(actor);
                }
            }
        }

        /// <summary>Calls the region, which may call back from here.</summary>
        private void Raise()
        {
            List<RegionActor> reporting = new List<RegionActor>();
            lock (Gate)
            {
                foreach (RegionActor actor in actors)
                {
                    if (actor.Reports)
                    {
                        reporting.Add(actor);
                    }
                }
            }
            foreach (RegionActor actor in reporting)
            {
                CollisionEventUpdate update = actor.Report(time);
                if (update != null)
                {
                    actor.SendCollisionUpdate(update);
                }
            }
            foreach (RegionActor actor in moved)
            {
                if (actor.Position.Z < LowestHeight)
                {
                    actor.RaiseOutOfBounds(actor.Position);
                }
                actor.RequestPhysicsterseUpdate();
            }
            moved.Clear();
        }
    }
}
