// The script that every language runs; it prints the hash of all poses.
//
// Arguments: the server's address and fingerprint. tests/tests/processes/bindings/script.rs is the same script in Rust.

using System;
using System.Linq;
using Rhumb;

internal static class Script
{
    private const int Piled = 60;
    private const int Ticks = 150;
    private const uint Hinge = 7;

    private static int Main(string[] arguments)
    {
        using (Connection connection = Connection.Open(arguments[0], Trust.Fingerprint(arguments[1]), null, 30))
        using (Scene scene = connection.Join("script", new JoinOptions { Condition = RhumbJoinCondition.Create }))
        {
            BodyDesc floor = BodyDesc.Fixed(Shape.Cuboid(10, 0.5f, 10)).At(0, -0.5f, 0);
            BodyDesc[] piled = Enumerable.Range(0, Piled).Select(PiledBody).ToArray();
            Body[] bodies = scene.Add(new[] { floor }.Concat(piled).Concat(Built()).ToArray());
            scene.AddJoint(Hinge, HingeOf(bodies).Motor(3, 0, 1, 0, 4, 2000));
            SetMoving(scene, bodies);
            for (int tick = 0; tick < Ticks; tick++)
            {
                Interfere(scene, tick, bodies);
                scene.Advance();
            }
            ulong hash = 0xcbf29ce484222325;
            foreach (Body body in bodies)
            {
                int place = scene.Place(body);
                if (place >= 0)
                {
                    Vec3 at = scene.Positions[place];
                    Quat turned = scene.Rotations[place];
                    hash = Fold(hash, at.X, at.Y, at.Z, turned.X, turned.Y, turned.Z, turned.W);
                }
            }
            Hit[] hits = scene.Ask(Query.Ray(new Vec3(-0.625f, 50, -0.625f), new Vec3(0, -100, 0), 8));
            hash = Fold(hash, hits.Select(hit => hit.Distance).ToArray());
            Console.WriteLine("{0} bodies, {1} hits, hash {2:x16}", scene.Bodies.Length, hits.Length, hash);
            scene.Delete();
        }
        return 0;
    }

    private static BodyDesc PiledBody(int i)
    {
        float x = i % 2 * 1.25f - 0.625f;
        float y = 1 + 1.5f * (i / 4);
        float z = i / 2 % 2 * 1.25f - 0.625f;
        return BodyDesc.Dynamic(ShapeOf(i)).At(x, y, z).AngularVelocity(new Vec3(0, 0.5f * (i % 3), 0));
    }

    /// <summary>A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car.</summary>
    private static BodyDesc[] Built()
    {
        Shape dumbbell = Shape.Compound(
            new Part(Shape.Ball(0.25f), new Vec3(-0.5f, 0, 0)),
            new Part(Shape.Ball(0.25f), new Vec3(0.5f, 0, 0)),
            new Part(Shape.Cuboid(0.125f, 0.5f, 0.25f), new Vec3(0, 0, 0.25f), new Quat(0.5f, 0.5f, 0.5f, 0.5f)));
        return new[]
        {
            BodyDesc.Dynamic(dumbbell).At(-4, 2, 0),
            BodyDesc.Fixed(Shape.Cuboid(0.25f, 0.25f, 0.25f)).At(4, 4, 0),
            BodyDesc.Dynamic(Shape.Cuboid(0.25f, 1, 0.25f)).At(4, 2.5f, 0),
            BodyDesc.Kinematic(Shape.Capsule(0.5f, 0.25f)).At(7, 1, 3),
            BodyDesc.Dynamic(Shape.Cuboid(0.75f, 0.25f, 1.5f)).At(-7, 1, 5),
        };
    }

    /// <summary>Lets the walker walk and the car roll.</summary>
    private static void SetMoving(Scene scene, Body[] bodies)
    {
        scene.SetCharacter(bodies[Piled + 4], new Character().Step(0.5f, 0.125f));
        scene.Send(Command.SetVelocity(bodies[Piled + 4], new Vec3(-1, 0, -0.5f), default(Vec3)));
        scene.SetVehicle(bodies[Piled + 5], Enumerable.Range(0, 4).Select(WheelOf).ToArray());
    }

    private static Wheel WheelOf(int i)
    {
        return new Wheel(new Vec3(i % 2 == 0 ? -0.75f : 0.75f, -0.125f, i < 2 ? -1.25f : 1.25f), 0.25f);
    }

    private static JointDesc HingeOf(Body[] bodies)
    {
        return new JointDesc(RhumbJointKind.Revolute, bodies[Piled + 2], bodies[Piled + 3])
            .Anchors(new Vec3(0, -0.5f, 0), new Vec3(0, 1, 0))
            .Limit(3, -0.5f, 1);
    }

    private static Shape ShapeOf(int i)
    {
        switch (i % 5)
        {
            case 0:
                return Shape.Ball(0.25f);
            case 1:
                return Shape.Cuboid(0.5f, 0.25f, 0.5f);
            case 2:
                return Shape.Capsule(0.5f, 0.25f);
            case 3:
                return Shape.Cylinder(0.5f, 0.25f);
            default:
                return Shape.Cone(0.5f, 0.25f);
        }
    }

    private static void Interfere(Scene scene, int tick, Body[] bodies)
    {
        if (tick == 20)
        {
            WheelInput front = new WheelInput(0.25f, 0, 0), rear = new WheelInput(0, 2000, 0);
            scene.SetWheels(bodies[Piled + 5], front, front, rear, rear);
        }
        else if (tick == 30)
        {
            scene.Send(
                Command.Impulse(bodies[1], new Vec3(200, 100, 0)),
                Command.SetVelocity(bodies[6], new Vec3(0, 4, 1), new Vec3(1, 0, 0)));
        }
        else if (tick == 40)
        {
            scene.Send(Command.Jump(bodies[Piled + 4], 4));
        }
        else if (tick == 60)
        {
            scene.Send(Command.RemoveBody(bodies[4]));
            if (scene.RemoveUnusedShapes() != 0)
            {
                throw new Exception("the other cones have the shape");
            }
        }
        else if (tick == 75)
        {
            scene.ChangeJoint(Hinge, HingeOf(bodies).Motor(3, 0.75f, 0, 30, 5));
        }
        else if (tick == 90)
        {
            scene.Send(Command.SetGravity(new Vec3(1, -9.75f, 0)));
        }
    }

    /// <summary>FNV-1a of 64 bits.</summary>
    private static ulong Fold(ulong hash, params float[] numbers)
    {
        foreach (float number in numbers)
        {
            foreach (byte part in BitConverter.GetBytes(number))
            {
                hash = unchecked((hash ^ part) * 0x100000001b3);
            }
        }
        return hash;
    }
}
