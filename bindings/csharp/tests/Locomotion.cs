// A character and a vehicle in Unity's axes.
//
// Arguments: the server's address and fingerprint.

using System;
using Rhumb;
using static Expectation;

internal static class Locomotion
{
    private const RhumbCoordinates Unity = RhumbCoordinates.Unity;

    private static int Main(string[] arguments)
    {
        using (Connection connection = Connection.Open(arguments[0], Trust.Fingerprint(arguments[1]), null, 30))
        using (Scene scene = connection.Join("locomotion-cs", JoinOptions.ForUnity()))
        {
            scene.Add(BodyDesc.Fixed(Shape.Cuboid(50, 0.5f, 50)).At(0, -0.5f, 0));
            Walks(scene);
            Drives(scene);
            Misuse(scene);
            scene.Delete();
        }
        Console.WriteLine("the character walked and the vehicle drove");
        return 0;
    }

    private static bool Near(float number, float expected, float within)
    {
        return Math.Abs(number - expected) <= within;
    }

    private static Vec3 After(Scene scene, int ticks, Body body)
    {
        for (int tick = 0; tick < ticks; tick++)
        {
            scene.Advance();
        }
        return scene.Positions[scene.Place(body)];
    }

    /// <summary>Events of this kind about the body since the last call.</summary>
    private static int Count(Scene scene, RhumbEventKind kind, Body body)
    {
        int count = 0;
        while (scene.TryNextEvent(out Event next))
        {
            Expect(next.Kind != RhumbEventKind.CommandRefused, "a command is refused: " + next.Text);
            count += next.Kind == kind && next.Body.Equals(body) ? 1 : 0;
        }
        return count;
    }

    private static void Walks(Scene scene)
    {
        scene.Add(BodyDesc.Fixed(Shape.Cuboid(2, 0.1f, 1)).At(0, 0.1f, 3));
        Body body = scene.Add(BodyDesc.Kinematic(Shape.Capsule(0.6f, 0.3f)).At(0, 0.92f, 0));
        Character character = new Character(Unity).Step(0.3f, 0.1f, true).ClimbAngle(0.8f).SlideAngle(0.8f).Mass(70)
            .Up(new Vec3(0, 1, 0)).Offset(0.02f).Snap(0.2f);
        Expect(scene.SetCharacter(body, character) > 0, "the number of a command");
        scene.Send(Command.SetVelocity(body, new Vec3(0, 0, 2), default(Vec3)));
        Vec3 at = After(scene, 80, body);
        Expect(Near(at.Z, 2.67f, 0.35f) && Near(at.Y, 1.12f, 0.08f), "it is on the step: " + at);
        Expect(Count(scene, RhumbEventKind.ReachedGround, body) > 0, "it reached the ground");
        scene.Send(Command.SetVelocity(body, default(Vec3), default(Vec3)));
        Vec3 stood = After(scene, 10, body);
        Expect(Near(After(scene, 30, body).Z, stood.Z, 0.05f), "it stands");
        scene.Send(Command.Jump(body, 5));
        Expect(After(scene, 30, body).Y > 2, "it jumps");
        Expect(Count(scene, RhumbEventKind.LeftGround, body) > 0, "it left the ground");
        scene.Send(Command.Jump(body, 5, RhumbJumpFrom.Anywhere));
        Expect(After(scene, 20, body).Y > 3, "it jumps in the air");
        scene.ClearLocomotion(body);
        Expect(After(scene, 60, body).Y > 3, "an ordinary kinematic body does not fall");
    }

    private static void Drives(Scene scene)
    {
        Body body = scene.Add(BodyDesc.Dynamic(Shape.Cuboid(0.8f, 0.2f, 1.6f)).At(20, 0.7f, 0).Mass(1000));
        var wheels = new Wheel[4];
        for (int i = 0; i < wheels.Length; i++)
        {
            var at = new Vec3(i % 2 == 0 ? -0.8f : 0.8f, -0.1f, i < 2 ? 1.2f : -1.2f);
            wheels[i] = new Wheel(at, 0.3f, Unity).RestLength(0.3f).Travel(0.25f).Stiffness(50).Compression(4)
                .Relaxation(6).FrictionSlip(2).SideFriction(1);
        }
        // The same axes again, by hand, and a force that is enough.
        wheels[0].Direction(new Vec3(0, -1, 0)).Axle(new Vec3(1, 0, 0)).ForceMax(100000);
        scene.SetVehicle(body, wheels);
        Expect(Near(After(scene, 60, body).Y, 0.65f, 0.08f), "it stands on its springs");
        WheelInput front = new WheelInput(0.1f, 0, 0), rear = new WheelInput(0, 1000, 0);
        scene.SetWheels(body, front, front, rear, rear);
        Vec3 driven = After(scene, 90, body);
        // In Unity forward is z, and a positive turn about y is to the right.
        Expect(Near(driven.Z, 2.25f, 0.6f), "it drives forward: " + driven);
        Expect(driven.X > 20.05f, "it steers to the right: " + driven);
        var brake = new WheelInput(0, 0, 3000);
        scene.SetWheels(body, brake, brake, brake, brake);
        Vec3 stopped = After(scene, 120, body);
        Expect(Near(After(scene, 60, body).Z, stopped.Z, 0.1f), "it stops");
        Expect(Count(scene, RhumbEventKind.CommandRefused, body) == 0, "nothing is refused");
    }

    private static void Misuse(Scene scene)
    {
        Body body = scene.Bodies[0];
        var plain = new Wheel(default(Vec3), 0.3f);
        ExpectError(RhumbCode.Null, "no character", () => scene.SetCharacter(body, null));
        ExpectError(RhumbCode.Null, "wheels", () => scene.SetVehicle(body, null));
        ExpectError(RhumbCode.Null, "a wheel", () => scene.SetVehicle(body, plain, null));
        ExpectError(RhumbCode.Null, "inputs", () => scene.SetWheels(body, null));
        ExpectError(RhumbCode.Invalid, "coordinates", () => new Character((RhumbCoordinates)4));
        ExpectError(RhumbCode.Invalid, "a mass", () => scene.SetCharacter(body, new Character().Mass(-1)));
        ExpectError(RhumbCode.Invalid, "a snap", () => scene.SetCharacter(body, new Character().Snap(float.NaN)));
        ExpectError(RhumbCode.Invalid, "no body", () => scene.SetCharacter(default(Body), new Character()));
        ExpectError(RhumbCode.Invalid, "no wheels", () => scene.SetVehicle(body));
        ExpectError(RhumbCode.Invalid, "many wheels", () => scene.SetVehicle(body, Repeated(plain, 17)));
        ExpectError(RhumbCode.Invalid, "a radius", () => scene.SetVehicle(body, new Wheel(default(Vec3), 0)));
        ExpectError(RhumbCode.Invalid, "a brake", () => scene.SetWheels(body, new WheelInput(0, 0, -1)));
        ExpectError(RhumbCode.Invalid, "a ground", () => scene.Send(Command.Jump(body, 1, (RhumbJumpFrom)2)));
        ExpectError(RhumbCode.Invalid, "a speed", () => scene.Send(Command.Jump(body, float.NaN)));
        scene.SetCharacter(body, new Character().Snap(null));
    }

    private static Wheel[] Repeated(Wheel wheel, int count)
    {
        var wheels = new Wheel[count];
        for (int i = 0; i < count; i++)
        {
            wheels[i] = wheel;
        }
        return wheels;
    }
}
