// Misuse in C#: each is an exception with a code, and none does harm.
//
// Arguments: the server's address, its fingerprint, and its process id. The program ends the server's process.

using System;
using System.Diagnostics;
using System.Reflection;
using System.Runtime.InteropServices;
using System.Threading;
using Rhumb;
using static Expectation;

internal static class Misuse
{
    private static string address;
    private static string fingerprint;

    private static int Main(string[] arguments)
    {
        address = arguments[0];
        fingerprint = arguments[1];
        Connecting();
        using (Scene scene = Joined("misuse", 5))
        {
            Body body = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)));
            scene.Advance();
            Numbers(scene, body);
            Arrays(scene);
            Events(scene, body);
            TwoThreads(scene);
            LentArrays(scene);
        }
        Closed();
        Unity();
        ServerGone(arguments[2]);
        Console.WriteLine("every misuse was an exception");
        return 0;
    }

    private static Connection Connected(double timeout)
    {
        return Connection.Open(address, Trust.Fingerprint(fingerprint), null, timeout);
    }

    private static Scene Joined(string name, double timeout)
    {
        using (Connection connection = Connected(timeout))
        {
            return connection.Join(name);
        }
    }

    private static void Connecting()
    {
        Trust trust = Trust.Fingerprint(fingerprint);
        ExpectError(RhumbCode.Null, "no address", () => Connection.Open(null, trust));
        ExpectError(RhumbCode.Null, "no trust", () => Connection.Open(address, null));
        ExpectError(RhumbCode.Invalid, "trust in nothing", () => Connection.Open(address, Trust.Fingerprint(null)));
        ExpectError(RhumbCode.Invalid, "a fingerprint", () => Connection.Open(address, Trust.Fingerprint("17")));
        ExpectError(RhumbCode.Invalid, "a zero character", () => Connection.Open("127.0.0.1\0:4433", trust));
        ExpectError(RhumbCode.Connect, "no port", () => Connection.Open("no port", trust));
        ExpectError(RhumbCode.Connect, "no roots", () => Connection.Open(address, Trust.Roots("/no/such/file.pem")));
        ExpectError(RhumbCode.Invalid, "no time", () => Connection.Open(address, trust, null, double.NaN));
        using (Connection connection = Connected(5))
        {
            ExpectError(RhumbCode.Null, "no name", () => connection.Join(null));
            ExpectError(RhumbCode.Invalid, "no tolerance", () => connection.Join("wrong", new JoinOptions { ToleranceInMetres = -1 }));
            ExpectError(RhumbCode.Invalid, "axes", () => connection.Join("wrong", new JoinOptions { Coordinates = (RhumbCoordinates)9 }));
            connection.Join("once").Dispose();
            ExpectError(RhumbCode.Closed, "a connection joins once", () => connection.Join("twice"));
        }
        Connection closed = Connected(5);
        closed.Dispose();
        closed.Dispose();
        ExpectError(RhumbCode.Closed, "a closed connection", () => closed.Join("late"));
    }

    private static void Numbers(Scene scene, Body body)
    {
        ExpectError(RhumbCode.Null, "no body", () => scene.Add((BodyDesc)null));
        ExpectError(RhumbCode.Null, "no bodies", () => scene.Add((BodyDesc[])null));
        ExpectError(RhumbCode.Null, "no shape", () => BodyDesc.Dynamic(null));
        ExpectError(RhumbCode.Invalid, "a radius", () => scene.Add(BodyDesc.Dynamic(Shape.Ball(-1))));
        ExpectError(RhumbCode.Invalid, "a place", () => scene.Add(BodyDesc.Dynamic(Shape.Ball(1)).At(0, float.NaN, 0)));
        ExpectError(RhumbCode.Invalid, "axes", () => scene.Add(BodyDesc.Dynamic(Shape.Ball(1)).LockedAxes(64)));
        ExpectError(RhumbCode.Invalid, "corners", () => Shape.Mesh(new Vec3[3], new uint[2]));
        ExpectError(RhumbCode.Invalid, "a corner", () => scene.Add(BodyDesc.Fixed(Shape.Mesh(new Vec3[1], new uint[] { 0, 0, 1 }))));
        ExpectError(RhumbCode.Null, "no commands", () => scene.Send(null));
        ExpectError(RhumbCode.Invalid, "one wrong command of two", () => scene.Send(Command.RemoveBody(body), Command.RemoveBody(default(Body))));
        ExpectError(RhumbCode.Invalid, "a force", () => scene.Send(Command.Force(body, new Vec3(0, float.PositiveInfinity, 0))));
        ExpectError(RhumbCode.Invalid, "no time", () => scene.Idle(-1));
        ExpectError(RhumbCode.Invalid, "no bound", () => scene.ErrorBound(default(Body)));
        ExpectError(RhumbCode.Invalid, "one bound of two", () => scene.ErrorBounds(new[] { body, default(Body) }));
        ExpectError(RhumbCode.Null, "no queries", () => scene.Ask(null));
        ExpectError(RhumbCode.Null, "no queries", () => scene.Ask(out ulong unused, null));
        ExpectError(RhumbCode.Invalid, "empty queries", () => scene.Ask());
        ExpectError(RhumbCode.Invalid, "hits", () => scene.Ask(Query.Ray(default(Vec3), new Vec3(0, 1, 0), 1000)));
        ExpectError(RhumbCode.Invalid, "a hull is not cast", () => Query.Overlap(Shape.Hull(new Vec3[4]), default(Vec3)));
        Expect(scene.Place(default(Body)) == -1, "no body has no place");
        // After all these errors the scene continues, and nothing of them was queued.
        scene.Send();
        scene.Advance();
        Expect(scene.Bodies.Length == 1 && scene.Place(body) == 0, "the body is there");
    }

    private static void Arrays(Scene scene)
    {
        ReadOnlySpan<Vec3> positions = scene.Positions;
        bool refused = false;
        try
        {
            Expect(positions[positions.Length].X < 0, "there is no such place");
        }
        catch (IndexOutOfRangeException)
        {
            refused = true;
        }
        Expect(refused, "a place beyond the arrays is an exception");
        // More bodies make larger arrays; the span of the old one is still good.
        var more = new BodyDesc[300];
        for (int i = 0; i < more.Length; i++)
        {
            more[i] = BodyDesc.Fixed(Shape.Cuboid(0.5f, 0.5f, 0.5f)).At(2 * i, -9, 0);
        }
        scene.Add(more);
        scene.Advance();
        Expect(scene.Positions.Length == 301 && scene.Rotations.Length == 301 && scene.Resting.Length == 301, "arrays grow");
        Expect(scene.LinearVelocities.Length == 301 && scene.AngularVelocities.Length == 301, "arrays grow");
        GC.Collect();
        Expect(positions.Length == 1 && !float.IsNaN(positions[0].Y), "an old span is good");
        // Shapes with arrays of their own.
        scene.Add(BodyDesc.Fixed(Shape.Heights(new float[3, 4], 2, 2)).At(0, -50, 0));
        scene.Add(BodyDesc.Dynamic(Shape.Hull(default(Vec3), new Vec3(1, 0, 0), new Vec3(0, 1, 0), new Vec3(0, 0, 1))).At(0, 20, 0));
        scene.Add(BodyDesc.Fixed(Shape.Mesh(new[] { default(Vec3), new Vec3(1, 0, 0), new Vec3(0, 0, 1) }, new uint[] { 0, 1, 2 })).At(9, 9, 9));
        scene.Advance();
        Expect(scene.Positions.Length == 304, "three more");
    }

    private static void Events(Scene scene, Body body)
    {
        ulong number = scene.Send(Command.SetEvents(body, Native.RHUMB_EVENTS_CONTACTS, 0), Command.RemoveBody(body), Command.Wake(body));
        try
        {
            scene.Advance();
            Expect(false, "a refusal is an exception");
        }
        catch (RhumbRefusedException error)
        {
            Refusal refusal = error.Refusals[0];
            Expect(error.Code == RhumbCode.Refused && error.Refusals.Length == 1, "one refusal");
            Expect(refusal.Number == number && refusal.Body.Equals(body), "of this command and body");
            Expect(refusal.Reason == "unknown body" && refusal.Text.Contains("no body"), "with its reason: " + refusal.Text);
            Expect(error.Message.Contains(refusal.Text), error.Message);
        }
        ulong tick = (ulong)scene.Time.Tick;
        Expect(scene.Advance() == tick + 1, "the next call continues");
        bool removed = false, refused = false;
        while (scene.TryNextEvent(out Event next))
        {
            removed |= next.Kind == RhumbEventKind.BodyRemoved && next.Body.Equals(body) && next.Text.Length > 0;
            refused |= next.Kind == RhumbEventKind.CommandRefused && next.Number == number && next.Text.Contains("no body");
        }
        Expect(removed && refused, "events say what became of commands");
    }

    private static void TwoThreads(Scene scene)
    {
        Thread other = Inside(scene, () => scene.Idle(1));
        ExpectError(RhumbCode.Busy, "advance", () => scene.Advance());
        ExpectError(RhumbCode.Busy, "positions", () => { ReadOnlySpan<Vec3> unused = scene.Positions; });
        ExpectError(RhumbCode.Busy, "changed", () => { ReadOnlySpan<int> unused = scene.Changed; });
        ExpectError(RhumbCode.Busy, "removed", () => { ReadOnlySpan<Body> unused = scene.Removed; });
        ExpectError(RhumbCode.Busy, "time", () => { RenderTime unused = scene.Time; });
        ExpectError(RhumbCode.Busy, "statistics", () => { Statistics unused = scene.Statistics; });
        ExpectError(RhumbCode.Busy, "add", () => scene.Add(BodyDesc.Dynamic(Shape.Ball(1))));
        ExpectError(RhumbCode.Busy, "ask", () => scene.Ask(Query.Ray(default(Vec3), new Vec3(0, 1, 0))));
        ExpectError(RhumbCode.Busy, "delete", scene.Delete);
        other.Join();
        scene.Advance();
    }

    /// <summary>While one thread computes a view, no other one does, and none copies arrays that the library only lends.</summary>
    private static void LentArrays(Scene scene)
    {
        FieldInfo arrays = typeof(Scene).GetField("arrays", BindingFlags.Instance | BindingFlags.NonPublic);
        using (((ViewArrays)arrays.GetValue(scene)).BeginView())
        {
            ExpectError(RhumbCode.Busy, "advance", () => scene.Advance());
            ExpectError(RhumbCode.Busy, "wait", () => scene.Wait());
            ExpectError(RhumbCode.Busy, "poll", () => scene.Poll());
            ExpectError(RhumbCode.Busy, "changed", () => { ReadOnlySpan<int> unused = scene.Changed; });
        }
        scene.Advance();
        Expect(scene.Changed.Length > 0, "the next calls have their turn");
    }

    /// <summary>Runs a call in another thread, and returns once that thread is inside it.</summary>
    private static Thread Inside(Scene scene, Action call)
    {
        while (true)
        {
            var other = new Thread(() =>
            {
                // This thread may be the one that is refused, while the other one looks whether it is inside.
                while (CodeOf(call) == RhumbCode.Busy)
                {
                }
            });
            other.Start();
            while (other.IsAlive)
            {
                if (CodeOf(scene.Flush) == RhumbCode.Busy)
                {
                    return other;
                }
            }
        }
    }

    private static RhumbCode CodeOf(Action call)
    {
        try
        {
            call();
        }
        catch (RhumbException error)
        {
            return error.Code;
        }
        return RhumbCode.Ok;
    }

    private static void Closed()
    {
        Scene scene = Joined("closed", 5);
        Body body = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)));
        scene.Advance();
        Expect(scene.Positions.Length == 1 && scene.Changed.Length == 1, "one body");
        scene.Dispose();
        scene.Dispose();
        ExpectError(RhumbCode.Closed, "advance", () => scene.Advance());
        ExpectError(RhumbCode.Closed, "wait", () => scene.Wait());
        ExpectError(RhumbCode.Closed, "poll", () => scene.Poll());
        ExpectError(RhumbCode.Closed, "idle", () => scene.Idle(0));
        ExpectError(RhumbCode.Closed, "flush", scene.Flush);
        ExpectError(RhumbCode.Closed, "delete", scene.Delete);
        ExpectError(RhumbCode.Closed, "positions", () => { ReadOnlySpan<Vec3> unused = scene.Positions; });
        ExpectError(RhumbCode.Closed, "rotations", () => { ReadOnlySpan<Quat> unused = scene.Rotations; });
        ExpectError(RhumbCode.Closed, "changed", () => { ReadOnlySpan<int> unused = scene.Changed; });
        ExpectError(RhumbCode.Closed, "removed", () => { ReadOnlySpan<Body> unused = scene.Removed; });
        ExpectError(RhumbCode.Closed, "time", () => { RenderTime unused = scene.Time; });
        ExpectError(RhumbCode.Closed, "statistics", () => { Statistics unused = scene.Statistics; });
        ExpectError(RhumbCode.Closed, "bounds", () => scene.ErrorBounds(new[] { body }));
        ExpectError(RhumbCode.Closed, "add", () => scene.Add(BodyDesc.Dynamic(Shape.Ball(1))));
        ExpectError(RhumbCode.Closed, "send", () => scene.Send(Command.SetGravity(default(Vec3))));
        ExpectError(RhumbCode.Closed, "place", () => scene.Place(body));
        ExpectError(RhumbCode.Closed, "bound", () => scene.ErrorBound(body));
        ExpectError(RhumbCode.Closed, "events", () => scene.TryNextEvent(out Event unused));
        ExpectError(RhumbCode.Closed, "ask", () => scene.Ask(Query.Ray(default(Vec3), new Vec3(0, 1, 0))));
        // One that is forgotten is closed by its handle.
        Forget();
        GC.Collect();
        GC.WaitForPendingFinalizers();
    }

    private static void Forget()
    {
        Joined("forgotten", 5).Advance();
        Connected(5);
    }

    /// <summary>Unity's axes: forward is z, a turn about y to the right is positive.</summary>
    private static void Unity()
    {
        using (Connection connection = Connected(5))
        using (Scene scene = connection.Join("unity", JoinOptions.ForUnity()))
        {
            scene.Send(Command.SetGravity(default(Vec3)));
            Body body = scene.Add(
                BodyDesc.Dynamic(Shape.Cuboid(0.5f, 1, 2)).At(1, 2, 3).LinearVelocity(new Vec3(0, 0, 2)).AngularVelocity(new Vec3(0, 1, 0)));
            for (int i = 0; i < 60; i++)
            {
                scene.Advance();
            }
            Vec3 at = scene.Positions[scene.Place(body)];
            Quat turned = scene.Rotations[scene.Place(body)];
            Expect(Near(at.X, 1) && Near(at.Y, 2) && Near(at.Z, 5), "it went forward: " + at);
            // Half of a radian: the quaternion of a second at 1 rad/s.
            Expect(Near(turned.Y, (float)Math.Sin(0.5)) && Near(turned.W, (float)Math.Cos(0.5)), "it turned right: " + turned);
            Hit[] hits = scene.Ask(Query.Ray(new Vec3(1, 2, 10), new Vec3(0, 0, -10)));
            Expect(hits.Length == 1 && hits[0].Body.Equals(body) && hits[0].Normal.Z > 0, "a ray from the front finds it");
            Expect(Marshal.SizeOf(typeof(Vec3)) == 12 && Marshal.SizeOf(typeof(Quat)) == 16, "laid out as Unity's own");
            ReadOnlySpan<float> numbers = MemoryMarshal.Cast<Vec3, float>(scene.Positions);
            Expect(numbers.Length == 3 && numbers[2].Equals(at.Z), "a span is cast without a copy");
            scene.Delete();
            ExpectError(RhumbCode.SceneGone, "a deleted scene", () => scene.Advance());
        }
    }

    private static bool Near(float number, float expected)
    {
        return Math.Abs(number - expected) < 0.06f;
    }

    private static void ServerGone(string server)
    {
        Scene scene = Joined("gone", 1);
        Body body = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(0, 2, 0));
        scene.Advance();
        // The server stands still, so that the call waits; then it is gone.
        Signal("STOP", server);
        RhumbCode code = RhumbCode.Ok;
        Thread other = Inside(scene, () =>
        {
            code = CodeOf(() => scene.Advance());
            if (code == RhumbCode.Busy)
            {
                throw new RhumbException(code, "refused");
            }
        });
        Signal("KILL", server);
        other.Join();
        Expect(code == RhumbCode.Timeout || code == RhumbCode.Ended, "a call without a server: " + code);
        // The copies are there still.
        Expect(Near(scene.Positions[scene.Place(body)].Y, 2), "the copy is there");
        scene.Dispose();
        RhumbCode again = CodeOf(() => Connected(0.25));
        Expect(again == RhumbCode.Connect || again == RhumbCode.Timeout, "connecting again: " + again);
    }

    private static void Signal(string name, string process)
    {
        using (Process kill = Process.Start("kill", "-" + name + " " + process))
        {
            kill.WaitForExit();
            Expect(kill.ExitCode == 0, "the signal " + name);
        }
    }
}
