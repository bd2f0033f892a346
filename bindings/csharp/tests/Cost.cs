// The cost of a frame of 10,000 moving bodies in C#.
//
// Arguments: the server's address and fingerprint. Prints medians in microseconds.

using System;
using System.Diagnostics;
using System.Globalization;
using Rhumb;

internal static class Cost
{
    private const int Bodies = 10000;
    private const int Frames = 300;

    private static int Main(string[] arguments)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        var options = new JoinOptions { Condition = RhumbJoinCondition.Create, Gravity = default(Vec3) };
        using (Connection connection = Connection.Open(arguments[0], Trust.Fingerprint(arguments[1]), null, 60))
        using (Scene scene = connection.Join("cost-csharp", options))
        {
            Shape ball = Shape.Ball(0.25f);
            var descs = new BodyDesc[Bodies];
            for (int i = 0; i < Bodies; i++)
            {
                descs[i] = BodyDesc.Dynamic(ball).At(i % 100 * 2, 0, i / 100 * 2).LinearVelocity(new Vec3(0, 1, 0));
            }
            scene.Add(descs);
            for (int i = 0; i < 30; i++)
            {
                scene.Advance();
            }
            double[] advances = new double[Frames], reads = new double[Frames], again = new double[Frames], calls = new double[Frames];
            float used = 0;
            for (int i = 0; i < Frames; i++)
            {
                long begun = Stopwatch.GetTimestamp();
                scene.Advance(1);
                long advanced = Stopwatch.GetTimestamp();
                used += scene.Positions[0].X + scene.Rotations[0].W;
                long read = Stopwatch.GetTimestamp();
                used += scene.Positions[1].X + scene.Rotations[1].W;
                long reread = Stopwatch.GetTimestamp();
                scene.Flush();
                long done = Stopwatch.GetTimestamp();
                advances[i] = Microseconds(advanced - begun);
                reads[i] = Microseconds(read - advanced);
                again[i] = Microseconds(reread - read);
                calls[i] = Microseconds(done - reread);
            }
            Console.WriteLine(
                "C#: advance {0:f1}, positions and rotations {1:f1}, again {2:f2}, a call {3:f2}",
                Median(advances), Median(reads), Median(again), Median(calls));
            scene.Delete();
            return float.IsNaN(used) ? 1 : 0;
        }
    }

    private static double Microseconds(long ticks)
    {
        return ticks * 1e6 / Stopwatch.Frequency;
    }

    private static double Median(double[] times)
    {
        Array.Sort(times);
        return times[times.Length / 2];
    }
}
