// A short life of a region: every promise of the plug-in, checked.

// Arguments: the plug-in's assembly, the server's address and fingerprint. A line on standard input answers that the server
// was stopped, continues, died or is back, after this program has asked for it on standard output.

using System;
using System.Collections.Generic;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

internal static class Region
{
    private static readonly Vector3 AvatarSize = new Vector3(0.45f, 0.6f, 1.9f);
    private static readonly PrimitiveBaseShape Box = Host.Prim(ProfileShape.Square, Extrusion.Straight);
    private static readonly PrimitiveBaseShape Sphere = Host.Prim(ProfileShape.HalfCircle, Extrusion.Curve1);
    private static readonly PrimitiveBaseShape Cylinder = Host.Prim(ProfileShape.Circle, Extrusion.Straight);
    private static PhysicsScene scene;
    private static uint ids = 1000;

    private static int Main(string[] arguments)
    {
        Settings(arguments);
        scene = Host.Load(arguments[0], "Rhumb", "[Rhumb]", "Address = " + arguments[1], "Fingerprint = " + arguments[2],
            "RetryAfter = 0.1", "Timeout = 5", "PipelineDepth = 0");
        // Two plateaus: the ground is where the map says, in both directions.
        scene.SetTerrain(Host.Terrain((x, y) => x < 100 ? 20 : y < 100 ? 30 : 25));
        Connect();
        Drop();
        Walk();
        Links();
        Forms();
        Refusals();
        Ray();
        Grounds();
        Silence();
        Death();
        scene.Dispose();
        scene.Dispose();
        System.Threading.Thread.Sleep(200);
        Check(scene.Simulate(Host.Frame) == 0, "a region that ended does not connect again");
        Console.WriteLine("the region kept every promise");
        return 0;
    }

    private static void Settings(string[] arguments)
    {
        string roots = System.IO.Path.Combine(System.IO.Path.GetTempPath(), "no-such-file.pem");
        foreach (string wrong in new[] { "Fingerprint = " + arguments[2].Substring(1), "Fingerprint = " + arguments[2].Substring(1)
            + "x", "Roots = " + roots, "Roots = " + arguments[0] })
        {
            string said = "";
            try
            {
                Host.Load(arguments[0], "Rhumb", "[Rhumb]", "Address = " + arguments[1], wrong).Dispose();
            }
            catch (ArgumentException error)
            {
                said = error.Message;
            }
            Check(said.Contains(wrong.Split(' ')[0] + " = "), "a wrong value is named: " + wrong + ": " + said);
        }
    }

    private static void Connect()
    {
        var ticking = System.Diagnostics.Stopwatch.StartNew();
        while (scene.Simulate(Host.Frame) == 0)
        {
            Check(ticking.Elapsed.TotalSeconds < 60, "no server within a minute");
            System.Threading.Thread.Sleep(5);
        }
    }

    private static void Run(double seconds)
    {
        for (double done = 0; done < seconds; done += Host.Frame)
        {
            Check(scene.Simulate(Host.Frame) > 0, "a frame without physics");
        }
    }

    private static PhysicsActor Add(PrimitiveBaseShape shape, Vector3 at, Vector3 size, bool physical)
    {
        return scene.AddPrimShape("prim", shape, at, size, Quaternion.Identity, physical, ++ids);
    }

    private static Vector3 Cube(float side)
    {
        return new Vector3(side, side, side);
    }

    private static void Drop()
    {
        PhysicsActor low = Add(Sphere, new Vector3(50, 50, 24), Cube(0.5f), true);
        PhysicsActor high = Add(Sphere, new Vector3(150.5f, 50.5f, 34), Cube(0.5f), true);
        PhysicsActor far = Add(Cylinder, new Vector3(150, 200, 27), new Vector3(1, 1, 2), true);
        PhysicsActor edge = Add(Box, new Vector3(255.7f, 200, 27), Cube(0.5f), true);
        int updates = 0, touches = 0;
        low.OnRequestTerseUpdate += () => updates++;
        low.OnCollisionUpdate += e => touches += ((CollisionEventUpdate)e).m_objCollisionList.ContainsKey(0) ? 1 : 0;
        low.SubscribeEvents(200);
        Run(0.5);
        Check(low.Velocity.Z < -1 && updates > 2, "a falling ball is reported: " + low.Velocity + ", " + updates);
        Run(9);
        Near(low.Position, new Vector3(50, 50, 20.25f), 0.05f, "a ball on the low ground");
        Near(high.Position, new Vector3(150.5f, 50.5f, 30.25f), 0.05f, "a ball on the high ground");
        Near(far.Position, new Vector3(150, 200, 26), 0.05f, "a cylinder stands on its base");
        Near(edge.Position, new Vector3(255.7f, 200, 25.25f), 0.05f, "the ground reaches the border");
        Check(touches > 0 && low.CollidingGround, "contacts with the ground are reported");
        Check(low.Stopped && low.Velocity == Vector3.Zero, "a ball at rest has no velocity");
        int before = updates;
        Run(1);
        Check(updates == before, "a ball at rest is not reported");
        Check(Math.Abs(low.Mass - 65.45f) < 0.1f, "the mass of a sphere of half a metre: " + low.Mass);
        scene.RemovePrim(low);
        Run(0.3);
        PhysicsActor next = Add(Box, new Vector3(50, 50, 20.6f), Cube(1), true);
        Run(3);
        Near(next.Position, new Vector3(50, 50, 20.5f), 0.05f, "a box where a ball was removed");
        next.Position = new Vector3(60, 60, 21);
        next.Velocity = new Vector3(0, 0, 3);
        Check(next.Position == new Vector3(60, 60, 21), "a set position is read back at once");
        Run(0.3);
        Check(Math.Abs(next.Position.X - 60) < 0.1f && next.Position.Z > 21.3f, "a thrown box rises: " + next.Position);
        Run(4);
        Near(next.Position, new Vector3(60, 60, 20.5f), 0.05f, "a box that was put elsewhere");
        next.AddForce(new Vector3(next.Mass * 3, 0, next.Mass * 3), true);
        Run(2);
        Check(next.Position.X > 60.2f, "an impulse moves a box: " + next.Position);
        scene.SetTerrain(Host.Terrain((x, y) => x < 100 ? 18 : y < 100 ? 30 : 25));
        Run(3);
        Check(Math.Abs(next.Position.Z - 18.5f) < 0.05f, "new terrain: " + next.Position);
    }

    private static void Walk()
    {
        PhysicsActor avatar = scene.AddAvatar(7, "A B", new Vector3(40, 40, 20), Vector3.Zero, AvatarSize, false);
        PhysicsActor ball = Add(Sphere, new Vector3(44, 40, 18.5f), Cube(0.5f), true);
        ball.Density = 100;
        int reports = 0;
        avatar.OnCollisionUpdate += e => reports++;
        Run(2);
        Near(avatar.Position, new Vector3(40, 40, 18.95f), 0.05f, "an avatar on its feet");
        Check(avatar.IsColliding && avatar.CollidingGround && reports > 10, "the region hears of an avatar's contacts");
        avatar.TargetVelocity = new Vector3(3, 0, 0);
        Run(1);
        Check(Math.Abs(avatar.Velocity.X - 3 * 0.77f) < 0.2f, "it walks as fast as the region wants: " + avatar.Velocity);
        Run(2);
        Check(ball.Position.X > 44.5f, "it pushes a ball: " + ball.Position);
        avatar.TargetVelocity = Vector3.Zero;
        Run(1);
        float stood = avatar.Position.X;
        Run(1);
        Check(Math.Abs(avatar.Position.X - stood) < 0.05f, "it stops");
        avatar.TargetVelocity = new Vector3(0, 0, 5);
        Run(0.5);
        Check(avatar.Position.Z > 19.2f, "it jumps: " + avatar.Position);
        avatar.TargetVelocity = Vector3.Zero;
        Run(2);
        avatar.Flying = true;
        avatar.TargetVelocity = new Vector3(0, 0, 4);
        Run(2);
        float height = avatar.Position.Z;
        Check(height > 23, "it flies: " + avatar.Position);
        avatar.TargetVelocity = Vector3.Zero;
        Run(2);
        Check(Math.Abs(avatar.Position.Z - height) < 1, "it hovers: " + avatar.Position);
        avatar.Flying = false;
        Run(4);
        Check(Math.Abs(avatar.Position.Z - 18.95f) < 0.05f, "it lands: " + avatar.Position);
        scene.RemoveAvatar(avatar);
        Run(0.3);
    }

    private static void Links()
    {
        PhysicsActor root = Add(Box, new Vector3(70, 40, 20), Cube(1), true);
        PhysicsActor child = Add(Box, new Vector3(71, 40, 20), Cube(1), true);
        child.link(root);
        Run(4);
        Near(root.Position, new Vector3(70, 40, 18.5f), 0.05f, "a link set rests flat");
        PhysicsActor probe = Add(Sphere, new Vector3(71, 40, 20.5f), Cube(0.3f), false);
        probe.IsPhysical = true;
        Run(0.7);
        Check(probe.Position.Z > 19.1f, "a ball lands on the child: " + probe.Position);
        child.delink();
        root.Position = new Vector3(75, 40, 18.5f);
        Run(2);
        Near(child.Position, new Vector3(71, 40, 18.5f), 0.05f, "a child that was unlinked stays where it was");
        root.Selected = true;
        root.Position = new Vector3(75, 40, 22);
        Run(1);
        Near(root.Position, new Vector3(75, 40, 22), 0.01f, "a selected prim does not fall");
        root.Selected = false;
        Run(3);
        Near(root.Position, new Vector3(75, 40, 18.5f), 0.1f, "a released prim falls");
        // A wall with an arm that is heavier: the centre of mass is beside the wall's foot.
        PhysicsActor tall = Add(Box, new Vector3(80, 60, 19), new Vector3(0.5f, 3, 2), true);
        PhysicsActor arm = Add(Box, new Vector3(81.5f, 60, 19.75f), new Vector3(2.5f, 3, 0.5f), true);
        arm.link(tall);
        Run(5);
        Check(tall.Position.X > 80.3f, "a link set tips over its centre of mass: " + tall.Position);
    }

    private static void Forms()
    {
        PrimitiveBaseShape cut = Host.Prim(ProfileShape.Square, Extrusion.Straight);
        cut.ProfileHollow = 100;
        PhysicsActor hull = Add(cut, new Vector3(70, 80, 20), new Vector3(2, 2, 2), true);
        PhysicsActor ramp = Add(cut, new Vector3(70, 90, 19), new Vector3(2, 2, 2), false);
        PhysicsActor ball = Add(Sphere, new Vector3(69.6f, 90, 20.4f), Cube(0.4f), true);
        Run(4);
        Near(hull.Position, new Vector3(70, 80, 19), 0.05f, "a hull stands on its base, though its centre of mass is lower");
        Check(Math.Abs(hull.Mass - 4000) < 5, "half of a cube of two metres: " + hull.Mass);
        Check(ball.Position.X > 70.5f, "a ball rolls down a ramp: " + ball.Position);
        ramp.Size = new Vector3(4, 4, 4);
        Run(1);
        Vector3 spread = new Vector3(70, 100, 22);
        PhysicsActor sensor = Add(Box, new Vector3(70, 100, 19), Cube(2), false);
        var seen = new HashSet<uint>();
        sensor.SetVolumeDetect(1);
        sensor.OnCollisionUpdate += e => seen.UnionWith(((CollisionEventUpdate)e).m_objCollisionList.Keys);
        sensor.SubscribeEvents(100);
        PhysicsActor falling = Add(Sphere, spread, Cube(0.5f), true);
        Run(4);
        Near(falling.Position, new Vector3(70, 100, 18.25f), 0.05f, "a ball falls through a volume");
        Check(seen.Contains(falling.LocalID), "a volume reports what enters it");
        PhysicsActor wrong = Add(Box, new Vector3(float.NaN, 0, 0), Cube(1), true);
        Run(0.5);
        Check(scene.Simulate(Host.Frame) > 0, "a prim nowhere does not stop the region");
        scene.RemovePrim(wrong);
    }

    private static void Refusals()
    {
        PhysicsActor lost = Add(Sphere, new Vector3(float.PositiveInfinity, 0, 0), Cube(0.5f), true);
        PhysicsActor avatar = scene.AddAvatar(8, "C D", new Vector3(90, 120, 19), Vector3.Zero, AvatarSize, false);
        Run(0.5);
        lost.Velocity = new Vector3(float.NaN, 0, 0);
        lost.Orientation = new Quaternion(0, 0, 0, 0);
        lost.Density = float.NaN;
        lost.Size = new Vector3(float.NaN, 1, 1);
        avatar.TargetVelocity = new Vector3(float.NaN, 0, 0);
        lost.Position = new Vector3(90, 110, 19);
        Run(3);
        Near(lost.Position, new Vector3(90, 110, 18.25f), 0.05f, "a refused prim that is put somewhere falls");
        Check(avatar.IsColliding && avatar.CollidingGround, "an avatar touches the ground");
        avatar.UnSubscribeEvents();
        Run(0.3);
        Check(!avatar.IsColliding && !avatar.CollidingGround, "an actor without events keeps no contacts");
        scene.RemoveAvatar(avatar);
        scene.RemovePrim(lost);
    }

    /// <summary>More grounds, one after the other, than the shapes of one scene can be.</summary>
    private static void Grounds()
    {
        PhysicsActor box = Add(Box, new Vector3(50, 50, 25), Cube(1), true);
        for (int i = 0; i <= 40; i++)
        {
            float height = i % 2 == 0 ? 18 : 18 - i * 0.01f;
            scene.SetTerrain(Host.Terrain((x, y) => x < 100 ? height : y < 100 ? 30 : 25 + i * 0.01f));
            for (int frame = 0; frame < 4; frame++)
            {
                Check(scene.Simulate(Host.Frame) > 0, "old grounds make room for new ones");
            }
        }
        Run(5);
        Check(Math.Abs(box.Position.Z - 18.5f) < 0.05f, "a box on the last of many grounds: " + box.Position);
        Vector3 corner = scene.RaycastWorld(new Vector3(160, 210, 60), new Vector3(0, 0, -1), 100, 1)[0].Pos;
        Near(corner, new Vector3(160, 210, 25.4f), 0.02f, "the last of many grounds");
    }

    private static void Ray()
    {
        List<ContactResult> hits = scene.RaycastWorld(new Vector3(150, 50, 60), new Vector3(0, 0, -2), 100, 1);
        Check(hits.Count == 1 && hits[0].ConsumerID == 0, "a ray finds the ground");
        Near(hits[0].Pos, new Vector3(150, 50, 30), 0.01f, "where a ray meets the ground");
    }

    /// <summary>The server does not answer while the region needs more ids than it was granted.</summary>
    private static void Silence()
    {
        Ask("stop the server");
        for (int i = 0; i < 4200; i++)
        {
            Add(Box, new Vector3(110 + i % 100, 110 + i / 100, 28), Cube(0.5f), false);
        }
        PhysicsActor ball = Add(Sphere, new Vector3(35, 30, 20), Cube(0.5f), true);
        Check(scene.Simulate(Host.Frame) == 0 && ball.Position.Z == 20, "a frame ends without an answer");
        Ask("continue the server");
        Connect();
        Run(3);
        Check(Math.Abs(ball.Position.Z - 18.25f) < 0.05f, "a ball that was added in vain is added again: " + ball.Position);
        List<ContactResult> hits = scene.RaycastWorld(new Vector3(209, 151, 60), new Vector3(0, 0, -1), 100, 1);
        Near(hits[0].Pos, new Vector3(209, 151, 28.25f), 0.01f, "so is the last of many prims");
    }

    private static void Death()
    {
        PhysicsActor ball = Add(Sphere, new Vector3(30, 30, 40), Cube(0.5f), true);
        Run(0.5);
        Ask("kill the server");
        var ticking = System.Diagnostics.Stopwatch.StartNew();
        while (scene.Simulate(Host.Frame) > 0)
        {
            Check(ticking.Elapsed.TotalSeconds < 60, "the loss is noticed");
        }
        Vector3 stopped = ball.Position;
        for (int i = 0; i < 20; i++)
        {
            Check(scene.Simulate(Host.Frame) == 0 && ball.Position == stopped, "without a server nothing moves");
        }
        PhysicsActor late = Add(Sphere, new Vector3(32, 30, 20), Cube(0.5f), true);
        Ask("start the server");
        Connect();
        Run(6);
        Near(ball.Position, new Vector3(30, 30, 18.25f), 0.05f, "a ball falls on after the server came back");
        Near(late.Position, new Vector3(32, 30, 18.25f), 0.05f, "a ball that was added without a server");
    }

    private static void Ask(string what)
    {
        Console.WriteLine(what);
        Check(Console.ReadLine() != null, "no answer to: " + what);
    }

    private static void Near(Vector3 found, Vector3 expected, float within, string what)
    {
        Vector3 off = found - expected;
        Check(off.X * off.X + off.Y * off.Y + off.Z * off.Z <= within * within, what + ": " + found + ", not " + expected);
    }

    private static void Check(bool holds, string what)
    {
        if (!holds)
        {
            throw new InvalidOperationException(what);
        }
    }
}
