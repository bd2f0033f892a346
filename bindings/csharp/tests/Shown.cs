// Random calls of a scene; writes the poses that are shown, with their bounds.
//
// Arguments: address, fingerprint, scene, seed, calls, stepping, extent. Each line: tick, fraction, body, position, rotation, bound.
// The same in Python, C and JavaScript; the tests of the workspace compare the lines with the server's truth.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using Rhumb;

internal static class Shown
{
    private static readonly List<Body> bodies = new List<Body>();
    private static readonly StreamWriter output = new StreamWriter(Console.OpenStandardOutput());
    private static ulong state;

    private static int Main(string[] arguments)
    {
        state = ulong.Parse(arguments[3]);
        bool freeRunning = arguments[5] == "free running";
        bool cells = arguments[6] == "cells";
        var options = new JoinOptions
        {
            Stepping = freeRunning ? RhumbStepping.FreeRunning : RhumbStepping.Lockstep,
            DelayTicks = Pick(4) * 3.0,
            Smooth = Pick(2) == 1,
            WholeTicks = Pick(2) == 1,
            Cells = cells,
        };
        using (Connection connection = Connection.Open(arguments[0], Trust.Fingerprint(arguments[1]), null, 30))
        using (Scene scene = connection.Join(arguments[2], options))
        {
            scene.Add(BodyDesc.Fixed(Shape.Cuboid(20, 0.5f, 20)).At(0, -0.5f, 0));
            for (int left = int.Parse(arguments[4]); left > 0; left--)
            {
                Call(scene);
                if (cells && Pick(8) == 0)
                {
                    TakeCells(scene);
                }
                Step(scene, freeRunning);
                Show(scene);
            }
            scene.Idle(0.1);
        }
        output.Flush();
        return 0;
    }

    /// <summary>The generator of all languages: Knuth's, its upper 31 bits.</summary>
    private static int Pick(ulong count)
    {
        state = unchecked((state * 6364136223846793005UL) + 1442695040888963407UL);
        return (int)((state >> 33) % count);
    }

    private static float Real(float least, float most)
    {
        return least + ((most - least) * Pick(1000000) / 1e6f);
    }

    private static void Show(Scene scene)
    {
        RenderTime time = scene.Time;
        ReadOnlySpan<Body> shown = scene.Bodies;
        float[] bounds = scene.ErrorBounds(shown);
        for (int i = 0; i < shown.Length; i++)
        {
            Vec3 p = scene.Positions[i];
            Quat q = scene.Rotations[i];
            output.Write(time.Tick + " " + Text(time.Fraction) + " " + shown[i].Word);
            foreach (float number in new[] { p.X, p.Y, p.Z, q.X, q.Y, q.Z, q.W, bounds[i] })
            {
                output.Write(" " + Text(number));
            }
            output.WriteLine();
        }
    }

    private static string Text(double number)
    {
        return double.IsInfinity(number) ? "inf" : number.ToString("R", CultureInfo.InvariantCulture);
    }

    private static void Add(Scene scene)
    {
        Shape shape = Pick(2) == 1 ? Shape.Ball(0.5f) : Shape.Cuboid(0.5f, 0.5f, 0.5f);
        float x = Real(-4, 4);
        float y = Real(1, 8);
        float z = Real(-4, 4);
        BodyDesc desc = Pick(5) == 0 ? BodyDesc.Kinematic(shape) : BodyDesc.Dynamic(shape);
        bodies.Add(scene.Add(desc.At(x, y, z)));
    }

    private static void Call(Scene scene)
    {
        int choice = Pick(8);
        if (bodies.Count == 0 || (choice == 0 && bodies.Count < 12))
        {
            Add(scene);
            return;
        }
        int place = Pick((ulong)bodies.Count);
        Body body = bodies[place];
        float x = Real(-6, 6);
        float y = Real(0, 6);
        float z = Real(-6, 6);
        if (choice == 1 && bodies.Count > 4)
        {
            bodies.RemoveAt(place);
            scene.Send(Command.RemoveBody(body));
        }
        else if (choice == 2)
        {
            scene.Send(Command.SetPose(body, new Vec3(x, 1 + y, z), Quat.Identity));
        }
        else if (choice == 3)
        {
            scene.Send(Command.SetVelocity(body, new Vec3(x, y, z), new Vec3(0, x, 0)));
        }
        else if (choice == 4)
        {
            scene.Flush();
        }
        else if (choice == 5)
        {
            scene.Idle(Pick(20) * 0.001);
        }
    }

    private static void TakeCells(Scene scene)
    {
        float x = Real(-6, 6);
        float z = Real(-6, 6);
        scene.TakeCellsAround(
            new Vec3(x, 0, z), new CellBand(1, 0), new CellBand(3, 0.01), new CellBand(Pick(8), 0.2));
    }

    private static void Step(Scene scene, bool freeRunning)
    {
        if (freeRunning)
        {
            scene.Idle(Pick(12) * 0.001);
            scene.Poll();
        }
        else if (Pick(4) == 0)
        {
            scene.Poll();
        }
        else
        {
            scene.Advance((uint)Pick(2));
        }
    }
}
