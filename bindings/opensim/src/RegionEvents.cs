// Events of the server as contacts of actors, and as lines of the log.

using System;
using System.Collections.Generic;
using log4net;
using OpenMetaverse;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>The server reports that contacts begin and end; an actor keeps those of now.</summary>
    internal static class RegionEvents
    {
        private static readonly ILog Log = LogManager.GetLogger(typeof(RegionEvents));

        /// <summary>Reads what the server reports, contacts above all.</summary>
        internal static void Read(Scene scene, Dictionary<Body, RegionActor> bodies, RegionTerrain terrain)
        {
            while (scene.TryNextEvent(out Event next))
            {
                terrain.Hear(next);
                switch (next.Kind)
                {
                    case RhumbEventKind.ContactBegan:
                    case RhumbEventKind.SensorEntered:
                        Touch(bodies, next.Body, next.Other, next, 1);
                        Touch(bodies, next.Other, next.Body, next, -1);
                        break;
                    case RhumbEventKind.ContactEnded:
                    case RhumbEventKind.SensorLeft:
                        Part(bodies, next.Body, next.Other);
                        Part(bodies, next.Other, next.Body);
                        break;
                    case RhumbEventKind.CommandRefused:
                    case RhumbEventKind.BodyFault:
                    case RhumbEventKind.SceneRestored:
                    case RhumbEventKind.SceneFaulted:
                        bodies.TryGetValue(next.Body, out RegionActor actor);
                        Log.WarnFormat("[RHUMB]: {0} {1} {2}", next.Kind, actor == null ? "" : actor.Name, next.Text);
                        break;
                    case RhumbEventKind.EventsMissed:
                        Log.WarnFormat("[RHUMB]: {0} contacts were not kept: fewer prims should listen", next.Number);
                        break;
                }
            }
        }

        private static void Touch(Dictionary<Body, RegionActor> bodies, Body body, Body other, Event contact, float side)
        {
            if (bodies.TryGetValue(body, out RegionActor actor) && actor.Reports)
            {
                // The ground has no actor, and the id 0 in OpenSimulator.
                uint id = bodies.TryGetValue(other, out RegionActor neighbour) ? neighbour.LocalID : 0;
                Vector3 normal = contact.Normal.ToVector3() * side;
                actor.Touching[other] = new KeyValuePair<uint, ContactPoint>(
                    id, new ContactPoint(contact.Point.ToVector3(), normal, Math.Max(-contact.Separation, 0)));
                actor.TouchesChanged = true;
                actor.CollidingGround |= id == 0;
            }
        }

        private static void Part(Dictionary<Body, RegionActor> bodies, Body body, Body other)
        {
            if (bodies.TryGetValue(body, out RegionActor actor) && actor.Touching.Remove(other))
            {
                actor.TouchesChanged = true;
                actor.CollidingGround = false;
                foreach (KeyValuePair<uint, ContactPoint> touch in actor.Touching.Values)
                {
                    actor.CollidingGround |= touch.Key == 0;
                }
            }
        }
    }
}
