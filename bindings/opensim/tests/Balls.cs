// Balls that fall into a pit: a region's frame time with a plug-in.

// Arguments: the plug-in's assembly, its name, the number of balls, seconds, the server's address and fingerprint for the
// truth, the scene's name there, and the lines of the plug-in's settings. It prints one line of figures.

using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Linq;
using System.Threading;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

internal static class Balls
{
    private const float Radius = 0.5f;

    /// <summary>Frames before the balls, in which terrain and connections come to be.</summary>
    private const int Before = 45;

    private static int Main(string[] arguments)
    {
        int count = int.Parse(arguments[2]);
        double seconds = double.Parse(arguments[3]);
        GiveConsole();
        PhysicsScene scene = Host.Load(arguments[0], arguments[1], arguments.Skip(7).ToArray());
        // A pit with dimples two metres apart, in which balls come to rest.
        scene.SetTerrain(Host.Terrain((x, y) => x < 95 || x > 160 || y < 95 || y > 160 ? 40 : 20 + (x % 2 + y % 2) * 0.3f));
        var clock = Stopwatch.StartNew();
        var frames = new List<double>();
        var steps = new List<double>();
        double due = 0;
        for (int i = 0; i < Before; i++)
        {
            Frame(scene, clock, ref due, null, null);
        }
        int updates = 0;
        var balls = new List<PhysicsActor>();
        for (int i = 0; i < count; i++)
        {
            var at = new Vector3(100 + i % 40 * 1.3f + i % 7 * 0.04f, 100 + i / 40 % 40 * 1.3f + i % 5 * 0.04f, 24 + i / 1600 * 1.5f);
            PhysicsActor ball = scene.AddPrimShape("ball", Host.Prim(ProfileShape.HalfCircle, Extrusion.Curve1), at,
                new Vector3(2 * Radius, 2 * Radius, 2 * Radius), Quaternion.Identity, true, (uint)(1000 + i));
            ball.OnRequestTerseUpdate += () => updates++;
            balls.Add(ball);
        }
        TimeSpan processor = Process.GetCurrentProcess().TotalProcessorTime;
        Console.WriteLine("begin");
        due = clock.Elapsed.TotalSeconds;
        for (double end = due + seconds; due < end;)
        {
            Frame(scene, clock, ref due, frames, steps);
        }
        Console.WriteLine("end");
        processor = Process.GetCurrentProcess().TotalProcessorTime - processor;
        Console.WriteLine(FormattableString.Invariant($"frame ms p50 {Quantile(frames, 0.5):F2} p99 {Quantile(frames, 0.99):F2} max {Quantile(frames, 1):F1}; ")
            + FormattableString.Invariant($"reported step ms p50 {Quantile(steps, 0.5):F0} p99 {Quantile(steps, 0.99):F0}; ")
            + FormattableString.Invariant($"frames {frames.Count}; updates to viewers {updates}; processor s {processor.TotalSeconds:F1}; ")
            + Off(balls, arguments[4], arguments[5], arguments[6]));
        Console.Out.Flush();
        // The published plug-in's threads never end.
        Environment.Exit(0);
        return 0;
    }

    /// <summary>OpenSimulator's own assemblies expect a console; ours have none.</summary>
    private static void GiveConsole()
    {
        Type console = Type.GetType("OpenSim.Framework.Console.MockConsole, OpenSim.Framework.Console");
        Type.GetType("OpenSim.Framework.MainConsole, OpenSim.Framework")?.GetProperty("Instance")
            .SetValue(null, Activator.CreateInstance(console), null);
    }

    /// <summary>One frame at the region's pace.</summary>
    private static void Frame(PhysicsScene scene, Stopwatch clock, ref double due, List<double> frames, List<double> steps)
    {
        double wait = due - clock.Elapsed.TotalSeconds;
        if (wait > 0)
        {
            Thread.Sleep((int)(wait * 1000));
        }
        double began = clock.Elapsed.TotalSeconds;
        float step = scene.Simulate(Host.Frame);
        frames?.Add((clock.Elapsed.TotalSeconds - began) * 1000);
        steps?.Add(step * 1000);
        due += Host.Frame;
    }

    /// <summary>How far the region has each ball from the nearest one of the server.</summary>
    private static string Off(List<PhysicsActor> balls, string address, string fingerprint, string name)
    {
        var options = new Rhumb.JoinOptions
        {
            Condition = Rhumb.RhumbJoinCondition.Join, ToleranceInMetres = 0.001,
            // A scene of APP has the axes of its client; such a scene is z up in its own numbers.
            Coordinates = name.StartsWith("app/") ? Rhumb.RhumbCoordinates.Rhumb : Rhumb.RhumbCoordinates.ZUp,
        };
        try
        {
            return Compared(balls, Positions(address, fingerprint, name, options));
        }
        catch (Rhumb.RhumbException error)
        {
            return "no truth: " + error.Message;
        }
    }

    private static List<Vector3> Positions(string address, string fingerprint, string name, Rhumb.JoinOptions options)
    {
        using (Rhumb.Connection connection = Rhumb.Connection.Open(address, Rhumb.Trust.Fingerprint(fingerprint)))
        using (Rhumb.Scene truth = connection.Join(name, options))
        {
            var places = new List<Vector3>();
            foreach (Rhumb.Vec3 at in truth.Positions)
            {
                places.Add(new Vector3(at.X, at.Y, at.Z));
            }
            return places;
        }
    }

    private static string Compared(List<PhysicsActor> balls, List<Vector3> places)
    {
        var off = balls.Select(ball => places.Min(place => Distance(place, ball.Position)) * 1000).ToList();
        int lost = off.Count(distance => distance > 1000 * Radius);
        return FormattableString.Invariant($"bodies {places.Count}; mm off p50 {Quantile(off, 0.5):F1} p99 {Quantile(off, 0.99):F1} max {Quantile(off, 1):F0}; ")
            + FormattableString.Invariant($"further off than a radius {lost}");
    }

    private static double Distance(Vector3 a, Vector3 b)
    {
        Vector3 d = a - b;
        return Math.Sqrt(d.X * d.X + d.Y * d.Y + d.Z * d.Z);
    }

    private static double Quantile(List<double> values, double part)
    {
        var sorted = values.OrderBy(value => value).ToList();
        return sorted[Math.Min((int)(part * sorted.Count), sorted.Count - 1)];
    }
}
