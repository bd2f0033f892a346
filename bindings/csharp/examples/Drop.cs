// Drops a ball on a floor, and prints its position and its error bound.
//
// Without arguments, the physics is in this process. With the address and the fingerprint that `rhumb-server --open` prints,
// it is on that server.

using System;
using System.Globalization;
using Rhumb;

internal static class Drop
{
    private static int Main(string[] arguments)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        if (arguments.Length != 0 && arguments.Length != 2)
        {
            Console.Error.WriteLine("the server's host:port and its fingerprint, or neither");
            return 1;
        }
        using (Connection connection = arguments.Length == 0
            ? Connection.Local()
            : Connection.Open(arguments[0], Trust.Fingerprint(arguments[1])))
        using (Scene scene = connection.Join("drop"))
        {
            scene.Add(BodyDesc.Fixed(Shape.Cuboid(10, 0.5f, 10)).At(0, -0.5f, 0));
            Body ball = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(0, 10, 0));
            for (int i = 0; i < 180; i++)
            {
                ulong tick = scene.Advance();
                Vec3 at = scene.Positions[scene.Place(ball)];
                Console.WriteLine("tick {0}: {1:f3} {2:f3} {3:f3}, within {4:f3} m", tick, at.X, at.Y, at.Z, scene.ErrorBound(ball));
            }
            scene.Delete();
        }
        return 0;
    }
}
