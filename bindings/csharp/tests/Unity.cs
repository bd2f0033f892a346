// The Unity code of the book, with stand-ins for the engine's types.
//
// Arguments: the server's address and fingerprint. The test compiles the book's code beside this file.

using System;
using System.Collections.Generic;
using System.Reflection;
using Rhumb;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x;
        public float y;
        public float z;
    }

    public struct Quaternion
    {
        public float x;
        public float y;
        public float z;
        public float w;
    }

    public static class Time
    {
        public static float fixedDeltaTime
        {
            get { return 0.02f; }
        }
    }

    public class Transform
    {
        public Vector3 position;
        public Quaternion rotation = new Quaternion { w = 1 };

        /// <summary>Counts the calls of SetPositionAndRotation.</summary>
        internal int Writes;

        public void SetPositionAndRotation(Vector3 at, Quaternion turned)
        {
            Writes++;
            position = at;
            rotation = turned;
        }
    }

    public class MonoBehaviour
    {
    }
}

internal static class Unity
{
    private static int Main(string[] arguments)
    {
        var world = new RhumbWorld { Address = arguments[0], Fingerprint = arguments[1] };
        Call(world, "Awake");
        var crate = new UnityEngine.Transform();
        crate.position = new UnityEngine.Vector3 { x = 1, y = 12, z = 2 };
        world.Add(crate, shape => BodyDesc.Dynamic(shape).AngularVelocity(new Vec3(0, 1, 0)), Shape.Cuboid(0.5f, 0.1f, 0.2f));
        for (int step = 0; step < 50; step++)
        {
            Call(world, "FixedUpdate");
        }
        // A second's fall; a turn of one radian about up, which takes forward to the right.
        ExpectNear(crate.position.x, 1, 0.06, "right");
        ExpectNear(crate.position.y, 12 - 4.9, 0.11, "up");
        ExpectNear(crate.position.z, 2, 0.06, "forward");
        ExpectNear(crate.rotation.y, Math.Sin(0.5), 0.1, "yaw, y");
        ExpectNear(crate.rotation.w, Math.Cos(0.5), 0.1, "yaw, w");
        // The same body in Rhumb's own axes: forward is where z is negative.
        using (Connection connection = Connection.Open(arguments[0], Trust.Fingerprint(arguments[1])))
        using (Scene scene = connection.Join("unity", new JoinOptions { Condition = RhumbJoinCondition.Join }))
        {
            ExpectNear(scene.Positions[0].Z, -crate.position.z, 0.11, "z");
            ExpectNear(scene.Rotations[0].Y, -crate.rotation.y, 0.1, "turn, y");
            RemovedBody(world, scene, crate);
            scene.Delete();
        }
        Call(world, "OnDestroy");
        Console.WriteLine("the crate fell and turned as in Unity");
        return 0;
    }

    /// <summary>Another client removes the crate's body; its transform is left alone, and a standing one is not written.</summary>
    private static void RemovedBody(RhumbWorld world, Scene other, UnityEngine.Transform crate)
    {
        var wall = new UnityEngine.Transform();
        world.Add(wall, BodyDesc.Fixed, Shape.Cuboid(0.5f, 0.5f, 0.5f));
        Call(world, "FixedUpdate");
        int written = wall.Writes;
        other.Send(Command.RemoveBody(other.Bodies[0]));
        other.Flush();
        for (int step = 0; Shown(world).Count > 1; step++)
        {
            if (step == 500)
            {
                throw new InvalidOperationException("the transform of a removed body is still shown");
            }
            Call(world, "FixedUpdate");
        }
        int last = crate.Writes;
        Call(world, "FixedUpdate");
        if (crate.Writes != last || written != 1 || wall.Writes != 1 || !Shown(world).Contains(wall))
        {
            throw new InvalidOperationException("written: the crate " + crate.Writes + ", the wall " + wall.Writes);
        }
    }

    /// <summary>The transforms that the book's code has for the bodies of the scene.</summary>
    private static List<UnityEngine.Transform> Shown(RhumbWorld world)
    {
        FieldInfo shown = typeof(RhumbWorld).GetField("shown", BindingFlags.Instance | BindingFlags.NonPublic);
        return new List<UnityEngine.Transform>(((Dictionary<Body, UnityEngine.Transform>)shown.GetValue(world)).Values);
    }

    /// <summary>Calls a message of Unity's, which may be private.</summary>
    private static void Call(RhumbWorld world, string message)
    {
        typeof(RhumbWorld).GetMethod(message, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(world, null);
    }

    private static void ExpectNear(double got, double expected, double within, string what)
    {
        if (!(Math.Abs(got - expected) <= within))
        {
            throw new InvalidOperationException(what + " is " + got + " and not " + expected);
        }
    }
}
