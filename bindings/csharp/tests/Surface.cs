// The whole C interface is reached from C#, and each part has its effect.
//
// Arguments: the server's address and fingerprint. The first test reads the code of the binding, so that a function or a
// field that the C interface gains is missed here until a member of C# reaches it.

using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using Rhumb;
using static Expectation;

internal static class Surface
{
    private const BindingFlags Declared = BindingFlags.DeclaredOnly | BindingFlags.Instance | BindingFlags.Static
        | BindingFlags.Public | BindingFlags.NonPublic;

    /// <summary>rhumb_scene_copy_poses copies these arrays, so that the ones that are lent are not needed.</summary>
    private static readonly string[] NotNeeded =
    {
        "RhumbPoses.count", "RhumbPoses.bodies", "RhumbPoses.positions", "RhumbPoses.rotations",
        "RhumbPoses.linear_velocities", "RhumbPoses.angular_velocities", "RhumbPoses.resting",
    };

    private static string address;
    private static string fingerprint;

    private static int Main(string[] arguments)
    {
        address = arguments[0];
        fingerprint = arguments[1];
        EveryFunctionAndFieldIsUsed();
        EveryKindHasAMember();
        AServerInTheProcess();
        AServerThatOthersJoin();
        ASceneThatTheProgramFeeds();
        AForkOfAScene();
        ARobotFromAFile();
        TheVersion();
        PlainOptionsAreThoseOfC();
        OptionsArriveInC();
        SubstepsChangeTheScene();
        DelayTicksHoldTheViewBack();
        TheTimeOfTheView();
        ChangedAndRemoved();
        ChangedInUnity();
        ARotatedQuery();
        ARotatedQueryInUnity();
        GroupsOfAQuery();
        TheTickOfAnAnswer();
        ErrorBounds();
        TheStatistics();
        TheIdOfABody();
        Console.WriteLine("the whole interface is reached");
        return 0;
    }

    private static void AServerThatOthersJoin()
    {
        using (LocalServer server = LocalServer.Serve())
        using (Scene one = server.Connect().Join("shared"))
        using (Scene other = Connection.Open(server.Address, Trust.ByAddress).Join("shared"))
        {
            Body ball = one.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(0, 10, 0));
            one.Advance();
            for (int i = 0; i < 10 && other.Place(ball) < 0; i++)
            {
                other.Advance();
            }
            Expect(other.Place(ball) >= 0, "a client of the network sees the ball");
            ExpectError(RhumbCode.Denied, "a page of another process", () => other.Page());
        }
        using (var server = new LocalServer())
        {
            Expect(server.Address == "", "a server without sockets has no address");
        }
        ExpectError(RhumbCode.Invalid, "an address beyond this machine", () => LocalServer.Serve("0.0.0.0:0"));
        using (Scene scene = Connection.Local().Join("shown"))
        {
            try
            {
                Expect(scene.Page().StartsWith("http://127.0.0.1:"), "the page is of this machine");
            }
            catch (RhumbException missing)
            {
                // A build without the web client.
                Expect(missing.Code == RhumbCode.Denied, missing.Message);
            }
        }
    }

    private static void AForkOfAScene()
    {
        using (var server = new LocalServer())
        using (Scene scene = server.Connect().Join("one"))
        {
            Body ball = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(0, 10, 0));
            scene.Advance();
            byte[] bytes;
            using (Checkpoint saved = scene.Save())
            {
                bytes = saved.ToBytes();
            }
            using (Checkpoint read = Checkpoint.Read(bytes))
            {
                server.Restore("two", read);
                ExpectError(RhumbCode.Denied, "a second scene of that name", () => server.Restore("two", read));
            }
            using (Scene two = server.Connect().Join("two"))
            {
                for (int i = 0; i < 30; i++)
                {
                    scene.Advance();
                    two.Advance();
                }
                Expect(two.Place(ball) >= 0, "the id stays");
                using (Checkpoint one = scene.Save())
                using (Checkpoint other = two.Save())
                {
                    Expect(Convert.ToBase64String(one.ToBytes()) == Convert.ToBase64String(other.ToBytes()), "a fork runs alike");
                }
            }
            bytes[bytes.Length / 2] ^= 1;
            ExpectError(RhumbCode.Invalid, "a damaged checkpoint", () => Checkpoint.Read(bytes));
        }
    }

    private static void ARobotFromAFile()
    {
        string path = System.IO.Path.GetTempFileName();
        System.IO.File.WriteAllText(path, "<robot name='arm'><link name='world'/><link name='arm'><inertial><mass value='2'/>"
            + "<inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
            + "<joint name='hinge' type='continuous'><parent link='world'/><child link='arm'/><mimic joint='other'/></joint></robot>");
        using (Scene scene = Connection.Local().Join("robots"))
        {
            var options = new LoadOptions { Position = new Vec3(0, 3, 0), FirstJoint = 7, Base = FileBase.Fixed };
            options.Packages.Add("nowhere");
            Loaded robot = scene.Load(path, options);
            scene.Advance();
            Expect(robot.Joints["hinge"] == 7 && robot.Bodies.Count == 2, "names are those of the file");
            Expect(robot.Frames["arm"].Rotation.W > 0.99f && robot.LeftOut.Count > 0, "frames and notes");
            Expect(scene.Positions[scene.Place(robot.Bodies["arm"])].Y > 2.9f, "the place of the file");
            Expect(scene.Load(path).Joints["hinge"] != 7, "numbers of joints that are free");
            ExpectError(RhumbCode.Invalid, "a file that is not there", () => scene.Load("nothing.urdf"));
        }
        System.IO.File.Delete(path);
    }

    private static Request NextRequest(Scene owner, Scene follower)
    {
        Request next = default(Request);
        for (int i = 0; i < 5000 && !owner.TryNextRequest(out next); i++)
        {
            follower.Idle(0.001);
        }
        return next;
    }

    private static void ASceneThatTheProgramFeeds()
    {
        using (LocalServer server = LocalServer.ServeFed("fed"))
        using (Scene owner = server.Feed("fed").Join("fed"))
        {
            Body ball = owner.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)));
            var bodies = new[] { ball };
            owner.Feed(bodies, new[] { new Vec3(1, 2, 3) });
            var options = new JoinOptions { Refusals = RhumbRefusals.Events };
            using (Scene follower = Connection.Open(server.Address, Trust.ByAddress).Join("fed", options))
            {
                follower.Send(Command.ImpulseAt(ball, new Vec3(1, 0, 0), new Vec3(0, 1, 0)));
                follower.Send(Command.SetGravity(new Vec3(0, -3, 0)));
                follower.Flush();
                Request push = NextRequest(owner, follower), gravity = NextRequest(owner, follower), none;
                Expect(push.Kind == RhumbRequestKind.ApplyImpulse && push.Body.Equals(ball), "a push");
                Expect(push.Vector.X == 1 && push.Point.Value.Y == 1 && push.Client == "", "with its numbers");
                Expect(gravity.Kind == RhumbRequestKind.SetGravity && gravity.Point == null, "another gravity");
                owner.Accept(push);
                owner.Refuse(gravity);
                ExpectError(RhumbCode.Invalid, "an answer twice", () => owner.Refuse(gravity));
                Expect(!owner.TryNextRequest(out none), "there is no further request");
                ulong tick = owner.Feed(bodies, new[] { new Vec3(4, 5, 6) }, tick: 7);
                Expect(tick == 7, "the tick that was given");
                for (int i = 0; i < 5000 && follower.CompleteTick < tick; i++)
                {
                    follower.Idle(0.001);
                }
                follower.Poll();
                Expect(Math.Abs(follower.Positions[follower.Place(ball)].X - 4) < 0.06, "the follower sees what is fed");
                Event refused;
                while (follower.TryNextEvent(out refused) && refused.Kind != RhumbEventKind.CommandRefused)
                {
                }
                Expect(refused.Number == gravity.Number, "the refusal names the command");
            }
            ExpectError(RhumbCode.Invalid, "too few rows", () => owner.Feed(bodies, new Vec3[0]));
            ExpectError(RhumbCode.Invalid, "tick 0", () => owner.Feed(bodies, new Vec3[1], tick: 0));
        }
        using (LocalServer server = LocalServer.Serve())
        {
            ExpectError(RhumbCode.Invalid, "a feed of a server with sockets", () => server.Feed("fed"));
        }
    }

    private static void AServerInTheProcess()
    {
        foreach (bool ownThread in new[] { false, true })
        {
            var server = new LocalServer(ownThread);
            using (Scene one = server.Connect().Join("shared"))
            using (Scene other = server.Connect(30).Join("shared"))
            {
                Body ball = one.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(0, 10, 0));
                server.Dispose();
                server.Dispose();
                one.Advance();
                for (int i = 0; i < 10 && other.Place(ball) < 0; i++)
                {
                    other.Advance();
                }
                Expect(other.Place(ball) >= 0, "the other member sees the ball");
            }
            try
            {
                server.Connect();
                Expect(false, "a closed server refuses");
            }
            catch (RhumbException error)
            {
                Expect(error.Code == RhumbCode.Closed, error.Message);
            }
        }
        using (Connection connection = Connection.Local())
        using (Scene scene = connection.Join("drop"))
        {
            Expect(scene.Advance() == 1, "a scene on a server of its own");
        }
    }

    private static Connection Connected()
    {
        return Connection.Open(address, Trust.Fingerprint(fingerprint), null, 30);
    }

    private static Scene Joined(string name, JoinOptions options)
    {
        using (Connection connection = Connected())
        {
            return connection.Join(name, options);
        }
    }

    /// <summary>A new scene in which nothing falls.</summary>
    private static Scene Weightless(string name, JoinOptions options = null)
    {
        options = options ?? new JoinOptions();
        options.Condition = RhumbJoinCondition.Create;
        options.Gravity = default(Vec3);
        return Joined(name, options);
    }

    /// <summary>A turn about the axis that points up, in radians.</summary>
    private static Quat AboutUp(double angle)
    {
        return new Quat(0, (float)Math.Sin(angle / 2), 0, (float)Math.Cos(angle / 2));
    }

    /// <summary>Types of Native.g.cs, which have the names of C.</summary>
    private static bool IsOfC(Type type)
    {
        return type == typeof(Native) || (type.IsValueType && type.Name.StartsWith("Rhumb", StringComparison.Ordinal));
    }

    private static void EveryFunctionAndFieldIsUsed()
    {
        Type[] all = typeof(Scene).Assembly.GetTypes().Where(type => type.Namespace == "Rhumb").ToArray();
        var used = new HashSet<int>();
        foreach (Type type in all.Where(type => !IsOfC(type)))
        {
            foreach (MethodBase method in type.GetMethods(Declared).Concat<MethodBase>(type.GetConstructors(Declared)))
            {
                MethodBody body = method.GetMethodBody();
                Gather(body == null ? new byte[0] : body.GetILAsByteArray(), used);
            }
        }
        var missed = new List<string>();
        foreach (MethodInfo function in typeof(Native).GetMethods(Declared))
        {
            Note(used.Contains(function.MetadataToken), function.Name, missed);
        }
        foreach (Type type in all.Where(type => IsOfC(type) && type.IsValueType && !type.IsEnum && !type.IsNested))
        {
            foreach (FieldInfo field in type.GetFields(Declared))
            {
                Note(used.Contains(field.MetadataToken), type.Name + "." + field.Name, missed);
            }
        }
        Expect(used.Count > 100, "the code of the binding is read");
        Expect(missed.Count == 0, "used by a member of C#, or listed as not needed: " + string.Join(", ", missed));
    }

    private static void Note(bool isUsed, string name, List<string> missed)
    {
        if (isUsed == NotNeeded.Contains(name))
        {
            missed.Add(name);
        }
    }

    /// <summary>Tokens of the methods that code calls and of the fields that it reads and writes (ECMA-335, III).</summary>
    private static void Gather(byte[] code, HashSet<int> used)
    {
        const byte Call = 0x28, LoadField = 0x7b, LoadFieldAddress = 0x7c, StoreField = 0x7d;
        const int Method = 0x06, Field = 0x04;
        for (int i = 0; i + 4 < code.Length; i++)
        {
            bool isField = code[i] == LoadField || code[i] == LoadFieldAddress || code[i] == StoreField;
            int token = BitConverter.ToInt32(code, i + 1);
            if ((isField && token >> 24 == Field) || (code[i] == Call && token >> 24 == Method))
            {
                used.Add(token);
            }
        }
    }

    private static void EveryKindHasAMember()
    {
        foreach (KeyValuePair<Type, Type> pair in new Dictionary<Type, Type>
        {
            { typeof(RhumbBodyKind), typeof(BodyDesc) },
            { typeof(RhumbShapeKind), typeof(Shape) },
            { typeof(RhumbCommandKind), typeof(Command) },
            { typeof(RhumbQueryKind), typeof(Query) },
        })
        {
            foreach (string kind in Enum.GetNames(pair.Key))
            {
                Expect(pair.Value.GetMethod(kind, BindingFlags.Static | BindingFlags.Public) != null, pair.Value + "." + kind);
            }
        }
    }

    private static void TheVersion()
    {
        Version version = RhumbLibrary.Version;
        Expect(version.Major * 65536 + version.Minor * 256 + version.Build == Native.rhumb_version(), "version " + version);
    }

    private static unsafe void PlainOptionsAreThoseOfC()
    {
        RhumbJoinOptions plain;
        Expect(Native.rhumb_join_options_init(&plain) == RhumbCode.Ok, "plain options");
        var options = new JoinOptions();
        Expect(options.Substeps == plain.substeps && options.Substeps == 4, "substeps: " + options.Substeps);
        Expect(options.Smooth && plain.smooth != 0, "corrections are smooth");
        Expect(options.DelayTicks.Equals(plain.delay_ticks) && options.DelayTicks.Equals(0.0), "no delay");
        Expect(options.ResumeWithin == null && plain.has_resume_within == 0, "the scene suggests how long to resume");
        Expect(options.LeadTicks.Equals(0.0) && !options.WholeTicks, "no lead, and moments between ticks");
        Expect(options.Refusals == RhumbRefusals.Errors && plain.refusals == 0, "refusals are exceptions");
    }

    private static void OptionsArriveInC()
    {
        var options = new JoinOptions
        {
            Substeps = 7,
            Smooth = false,
            DelayTicks = 2.5,
            LeadTicks = 1.5,
            WholeTicks = true,
            Refusals = RhumbRefusals.Events,
            ResumeWithin = TimeSpan.FromSeconds(1.25),
        };
        RhumbJoinOptions raw = options.Raw();
        Expect(raw.substeps == 7 && options.Substeps == 7, "substeps");
        Expect(raw.smooth == 0 && !options.Smooth, "smooth");
        Expect(raw.delay_ticks.Equals(2.5) && options.DelayTicks.Equals(2.5), "delay");
        Expect(raw.lead_ticks.Equals(1.5) && options.LeadTicks.Equals(1.5), "lead");
        Expect(raw.whole_ticks == 1 && options.WholeTicks, "whole ticks");
        Expect(raw.refusals == 1 && options.Refusals == RhumbRefusals.Events, "refusals");
        Expect(raw.has_resume_within == 1 && raw.resume_within_s.Equals(1.25), "resume within");
        Expect(options.ResumeWithin == TimeSpan.FromSeconds(1.25), "resume within");
        options.Smooth = true;
        options.ResumeWithin = TimeSpan.Zero;
        Expect(options.Raw().smooth == 1 && options.Raw().has_resume_within == 1, "not to resume is a choice");
        options.ResumeWithin = null;
        Expect(options.Raw().has_resume_within == 0 && options.ResumeWithin == null, "the scene suggests again");
        using (Connection connection = Connected())
        {
            ExpectError(RhumbCode.Invalid, "no substeps", () => connection.Join("wrong", new JoinOptions { Substeps = 0 }));
            ExpectError(RhumbCode.Invalid, "a delay", () => connection.Join("wrong", new JoinOptions { DelayTicks = -1 }));
            ExpectError(RhumbCode.Invalid, "a lead", () => connection.Join("wrong", new JoinOptions { LeadTicks = -1 }));
            ExpectError(RhumbCode.Invalid, "no delay", () => connection.Join("wrong", new JoinOptions { DelayTicks = double.NaN }));
            ExpectError(RhumbCode.Invalid, "a time", () => connection.Join("wrong", new JoinOptions { ResumeWithin = TimeSpan.FromTicks(-1) }));
            // None of these used the connection up.
            connection.Join("right", options).Dispose();
        }
    }

    /// <summary>Where a pendulum is after a second, in a scene of so many substeps.</summary>
    private static Vec3 Pendulum(string name, uint substeps)
    {
        var options = new JoinOptions { Condition = RhumbJoinCondition.Create, Substeps = substeps, ToleranceInMetres = 0.001 };
        using (Scene scene = Joined(name, options))
        {
            Body[] bodies = scene.Add(new[]
            {
                BodyDesc.Fixed(Shape.Ball(0.25f)).At(0, 10, 0),
                BodyDesc.Dynamic(Shape.Ball(0.25f)).At(4, 10, 0),
            });
            scene.AddJoint(1, new JointDesc(RhumbJointKind.Spherical, bodies[0], bodies[1]).Anchors(default(Vec3), new Vec3(-4, 0, 0)));
            for (int tick = 0; tick < 60; tick++)
            {
                scene.Advance();
            }
            Vec3 at = scene.Positions[scene.Place(bodies[1])];
            scene.Delete();
            return at;
        }
    }

    private static void SubstepsChangeTheScene()
    {
        Vec3 coarse = Pendulum("one-substep", 1);
        Vec3 fine = Pendulum("eight-substeps", 8);
        Vec3 again = Pendulum("eight-substeps-again", 8);
        Expect(fine.Equals(again), "the same substeps are the same scene: " + fine + ", " + again);
        Expect(!coarse.Equals(fine), "other substeps are another scene: " + coarse);
    }

    private static void DelayTicksHoldTheViewBack()
    {
        var live = new JoinOptions { Stepping = RhumbStepping.FreeRunning, Condition = RhumbJoinCondition.Create };
        var late = new JoinOptions { Condition = RhumbJoinCondition.Join, DelayTicks = 60 };
        using (Scene first = Joined("delay", live))
        using (Scene second = Joined("delay", late))
        {
            // Long enough for both to know the server's clock, and for the view that is late to have a moment to show.
            while (first.Poll() < 90)
            {
                first.Idle(0.05);
                second.Idle(0);
            }
            double before = first.Poll(), shown = second.Poll(), after = first.Poll();
            Expect(shown > before - 80 && shown < after - 40, "60 ticks behind: " + before + ", " + shown + ", " + after);
            // In a free-running scene, the time of the view is what Poll returned, in two parts.
            Expect((second.Time.Tick + second.Time.Fraction).Equals(shown), "the time of the view: " + second.Time);
            Expect(second.Time.Fraction >= 0 && second.Time.Fraction < 1, "a part of a step");
            first.Delete();
        }
    }

    private static void TheTimeOfTheView()
    {
        using (Scene scene = Weightless("time", new JoinOptions { PublishInterval = 4 }))
        {
            Expect(scene.Time.Tick == 0 && scene.Time.Fraction.Equals(0.0), "before the first view: " + scene.Time);
            ulong tick = scene.Advance();
            Expect(tick > 0 && scene.Time.Tick == tick && scene.Time.Fraction.Equals(0.0), "a view: " + scene.Time);
            RenderTime kept = scene.Time;
            // At depth 1, the view stays a published tick behind what was requested.
            ulong behind = scene.Advance(1);
            Expect(scene.Time.Tick == behind, "a view of the tick before: " + scene.Time);
            ulong next = scene.Advance();
            Expect(scene.Time.Tick == next && next > tick && kept.Tick == tick, "a new view: " + scene.Time);
            Expect(scene.Time.Equals(scene.Time) && !scene.Time.Equals(kept), "times are compared");
            Expect(kept.ToString() == "tick 4", kept.ToString());
            scene.Delete();
        }
    }

    private static void ChangedAndRemoved()
    {
        using (Scene scene = Weightless("changes"))
        {
            Body[] bodies = scene.Add(new[]
            {
                BodyDesc.Fixed(Shape.Ball(0.5f)),
                BodyDesc.Dynamic(Shape.Ball(0.5f)).At(4, 0, 0).LinearVelocity(new Vec3(0, 1, 0)),
                BodyDesc.Fixed(Shape.Ball(0.5f)).At(8, 0, 0),
            });
            scene.Advance();
            Expect(Shown(scene).SetEquals(bodies) && scene.Removed.IsEmpty, "each body is new");
            scene.Advance();
            Expect(Shown(scene).SetEquals(new[] { bodies[1] }), "one moves: " + string.Join(", ", Shown(scene)));
            Expect(scene.Removed.IsEmpty, "none is removed");

            scene.Send(Command.RemoveBody(bodies[0]), Command.RemoveBody(bodies[2]));
            scene.Advance();
            ReadOnlySpan<int> changed = scene.Changed;
            ReadOnlySpan<Body> removed = scene.Removed;
            Expect(removed.Length == 2 && removed.ToArray().Contains(bodies[0]), "two are removed");
            Expect(removed.ToArray().Contains(bodies[2]) && scene.Place(bodies[2]) == -1, "two are removed");
            Expect(scene.Bodies.Length == 1 && scene.Bodies[0].Equals(bodies[1]), "one is left");
            Expect(changed.Length == 1 && changed[0] == scene.Place(bodies[1]), "the last one moves in its new place");
            Expect(scene.Removed.Length == 2 && scene.Changed.Length == 1, "reading changes nothing");

            scene.Advance();
            Expect(scene.Removed.IsEmpty && scene.Changed.Length == 1, "a removal is in one view alone");
            // Many bodies need larger arrays; the spans of the old ones are still good.
            var more = new BodyDesc[500];
            for (int i = 0; i < more.Length; i++)
            {
                more[i] = BodyDesc.Fixed(Shape.Ball(0.5f)).At(2 * i, -9, 0);
            }
            Body[] added = scene.Add(more);
            scene.Advance();
            Expect(scene.Changed.Length == 501, "all are new: " + scene.Changed.Length);
            scene.Send(added.Select(Command.RemoveBody).ToArray());
            scene.Advance();
            Expect(new HashSet<Body>(scene.Removed.ToArray()).SetEquals(added), "all are removed");
            GC.Collect();
            Expect(removed.Length == 2 && removed[0].Id != 0 && changed[0] == 0, "old spans are good");
            scene.Delete();
        }
    }

    /// <summary>The bodies whose pose changed.</summary>
    private static HashSet<Body> Shown(Scene scene)
    {
        var shown = new HashSet<Body>();
        foreach (int place in scene.Changed)
        {
            Expect(shown.Add(scene.Bodies[place]), "a place is there once");
        }
        return shown;
    }

    private static void ChangedInUnity()
    {
        using (Scene scene = Weightless("changes-in-unity", JoinOptions.ForUnity()))
        {
            Body body = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).At(1, 2, 3).LinearVelocity(new Vec3(0, 0, 1)));
            Body other = scene.Add(BodyDesc.Fixed(Shape.Ball(0.5f)).At(9, 0, 0));
            scene.Advance();
            scene.Send(Command.RemoveBody(other));
            ulong tick = scene.Advance();
            Expect(scene.Time.Tick == tick, "the time of the view");
            Expect(scene.Removed.Length == 1 && scene.Removed[0].Equals(other), "one is removed");
            Expect(scene.Changed.Length == 1 && scene.Bodies[scene.Changed[0]].Equals(body), "the other moves");
            Expect(scene.Positions[scene.Changed[0]].Z > 3, "it moves forward: " + scene.Positions[0]);
            scene.Delete();
        }
    }

    private static void ARotatedQuery()
    {
        using (Scene scene = Weightless("rotated"))
        {
            Body ball = scene.Add(BodyDesc.Fixed(Shape.Ball(0.25f)).At(10, 12, 1.5f));
            scene.Advance();
            // A beam along x, which passes the ball; turned by a right angle about y, it lies along z and hits.
            Shape beam = Shape.Cuboid(2, 0.1f, 0.1f);
            Query straight = Query.ShapeCast(beam, new Vec3(10, 10, 0), new Vec3(0, 5, 0));
            Query turned = straight.Rotation(AboutUp(Math.PI / 2));
            Hit[] hits = scene.Ask(straight, turned, straight.Rotation(Quat.Identity));
            Expect(hits.Length == 1 && hits[0].Query == 1 && hits[0].Body.Equals(ball), "the turned beam alone hits");
            Expect(Math.Abs(hits[0].Distance - 1.65f) < 0.01f, "after 1.65 m: " + hits[0].Distance);
            Query over = Query.Overlap(beam, new Vec3(10, 12, 0));
            hits = scene.Ask(over, over.Rotation(AboutUp(Math.PI / 2)));
            Expect(hits.Length == 1 && hits[0].Query == 1 && hits[0].Body.Equals(ball), "the turned beam alone overlaps");
            ExpectError(RhumbCode.Invalid, "not a unit quaternion", () => scene.Ask(straight.Rotation(new Quat(1, 1, 1, 1))));
            ExpectError(RhumbCode.Invalid, "no rotation", () => scene.Ask(straight.Rotation(default(Quat))));
            scene.Delete();
        }
    }

    private static void ARotatedQueryInUnity()
    {
        using (Scene scene = Weightless("rotated-in-unity", JoinOptions.ForUnity()))
        {
            Body ball = scene.Add(BodyDesc.Fixed(Shape.Ball(0.25f)).At(1, 5, 1));
            scene.Advance();
            // A beam along z; a turn to the right by half a right angle takes its far end to where x and z are positive.
            Query ahead = Query.ShapeCast(Shape.Cuboid(0.1f, 0.1f, 2), new Vec3(0, 2, 0), new Vec3(0, 5, 0));
            Hit[] hits = scene.Ask(ahead, ahead.Rotation(AboutUp(-Math.PI / 4)), ahead.Rotation(AboutUp(Math.PI / 4)));
            Expect(hits.Length == 1 && hits[0].Query == 2 && hits[0].Body.Equals(ball), "the beam that is turned right hits");
            scene.Delete();
        }
    }

    private static void GroupsOfAQuery()
    {
        using (Scene scene = Weightless("groups"))
        {
            Body near = scene.Add(BodyDesc.Fixed(Shape.Ball(0.5f)).At(0, 5, 0).Groups(2, uint.MaxValue));
            Body far = scene.Add(BodyDesc.Fixed(Shape.Ball(0.5f)).At(0, 10, 0).Groups(4, uint.MaxValue));
            scene.Advance();
            Query up = Query.Ray(default(Vec3), new Vec3(0, 20, 0), 8);
            Expect(Found(scene, up).SequenceEqual(new[] { near, far }), "every group counts");
            Expect(Found(scene, up.Groups(4)).SequenceEqual(new[] { far }), "the nearer one is left out");
            Expect(Found(scene, up.Groups(2)).SequenceEqual(new[] { near }), "the farther one is left out");
            Expect(Found(scene, up.Groups(6)).SequenceEqual(new[] { near, far }), "either group counts");
            Expect(Found(scene, up.Groups(1)).Length == 0 && Found(scene, up.Groups(0)).Length == 0, "none is in these groups");
            Expect(Found(scene, up.Groups(6).Except(near).Among()).SequenceEqual(new[] { far }), "with another condition");
            scene.Delete();
        }
    }

    private static Body[] Found(Scene scene, Query query)
    {
        return scene.Ask(query).Select(hit => hit.Body).ToArray();
    }

    private static void TheTickOfAnAnswer()
    {
        using (Scene scene = Weightless("answer"))
        {
            Body body = scene.Add(BodyDesc.Fixed(Shape.Ball(0.5f)).At(0, 5, 0));
            Query up = Query.Ray(default(Vec3), new Vec3(0, 20, 0));
            for (int i = 0; i < 3; i++)
            {
                ulong shown = scene.Advance();
                Hit[] hits = scene.Ask(out ulong asked, up, up);
                Expect(asked == shown, "the scene of tick " + shown + " was asked: " + asked);
                Expect(hits.Length == 2 && hits[1].Query == 1 && hits[1].Body.Equals(body), "both are answered");
            }
            // An answer without hits has its tick too.
            ulong last = scene.Advance();
            Expect(scene.Ask(out ulong tick, up.Except(body)).Length == 0 && tick == last, "tick " + tick);
            scene.Delete();
        }
    }

    private static void ErrorBounds()
    {
        using (Scene scene = Weightless("bounds"))
        {
            Body[] bodies = scene.Add(Enumerable.Range(0, 40).Select(i => BodyDesc.Dynamic(Shape.Ball(0.5f)).At(2 * i, 0, 0)).ToArray());
            scene.Advance();
            float[] bounds = scene.ErrorBounds(bodies);
            Expect(bounds.Length == bodies.Length, "one bound for each");
            for (int i = 0; i < bodies.Length; i++)
            {
                Expect(bounds[i].Equals(scene.ErrorBound(bodies[i])) && bounds[i] >= 0 && bounds[i] <= 0.05f, "bound " + bounds[i]);
            }
            Expect(scene.ErrorBounds(scene.Bodies).Length == bodies.Length, "of all bodies of the view");
            Expect(scene.ErrorBounds(new Body[0]).Length == 0, "of none");
            ExpectError(RhumbCode.Invalid, "one that is not there", () => scene.ErrorBounds(new[] { bodies[0], default(Body) }));
            scene.Delete();
        }
    }

    private static void TheStatistics()
    {
        using (Scene scene = Weightless("statistics"))
        {
            Body body = scene.Add(BodyDesc.Dynamic(Shape.Ball(0.5f)).Mass(1));
            scene.Advance();
            Statistics before = scene.Statistics;
            Expect(before.SentBytes > 0 && before.ReceivedBytes > 0, "bytes were sent and received");
            Expect(before.CompleteTick == scene.CompleteTick && before.CompleteTick >= 1, "complete to tick " + before.CompleteTick);
            // A change that no prediction knows of needs an update.
            scene.Send(Command.Impulse(body, new Vec3(20, 0, 0)));
            scene.Advance();
            scene.Advance();
            Statistics after = scene.Statistics;
            Expect(after.SentBytes > before.SentBytes && after.ReceivedBytes > before.ReceivedBytes, "more bytes");
            Expect(after.Updates > before.Updates, "the stream carried updates: " + after.Updates);
            scene.Delete();
        }
    }

    private static void TheIdOfABody()
    {
        using (Scene scene = Weightless("ids"))
        {
            Body body = scene.Add(BodyDesc.Fixed(Shape.Ball(0.5f)));
            scene.Advance();
            // The number is the same for every member of the scene, so that it can be sent to another one.
            using (Scene other = Joined("ids", new JoinOptions { Condition = RhumbJoinCondition.Join }))
            {
                Expect(other.Place(Body.FromId(body.Id)) == 0 && other.Bodies[0].Id == body.Id, "the body of another member");
            }
            Expect(Body.FromId(body.Id).Equals(body) && Body.FromId(0).IsNone && default(Body).Id == 0, "ids");
            scene.Delete();
        }
    }
}
