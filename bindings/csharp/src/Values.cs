// Vectors, rotations and bodies.

using System;
using System.Runtime.InteropServices;

namespace Rhumb
{
    /// <summary>
    /// A vector, laid out as UnityEngine.Vector3 and System.Numerics.Vector3 are: MemoryMarshal.Cast turns a span of one
    /// into a span of the other without a copy.
    /// </summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct Vec3 : IEquatable<Vec3>
    {
        public float X;
        public float Y;
        public float Z;

        public Vec3(float x, float y, float z)
        {
            X = x;
            Y = y;
            Z = z;
        }

        public bool Equals(Vec3 other)
        {
            return X.Equals(other.X) && Y.Equals(other.Y) && Z.Equals(other.Z);
        }

        public override bool Equals(object other)
        {
            return other is Vec3 vector && Equals(vector);
        }

        public override int GetHashCode()
        {
            return X.GetHashCode() ^ (Y.GetHashCode() << 8) ^ (Z.GetHashCode() << 16);
        }

        public override string ToString()
        {
            return FormattableString.Invariant($"({X}, {Y}, {Z})");
        }

        internal unsafe void CopyTo(float* to)
        {
            to[0] = X;
            to[1] = Y;
            to[2] = Z;
        }
    }

    /// <summary>A unit quaternion, laid out as UnityEngine.Quaternion and System.Numerics.Quaternion are.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct Quat : IEquatable<Quat>
    {
        public float X;
        public float Y;
        public float Z;
        public float W;

        public Quat(float x, float y, float z, float w)
        {
            X = x;
            Y = y;
            Z = z;
            W = w;
        }

        public static Quat Identity
        {
            get { return new Quat(0, 0, 0, 1); }
        }

        public bool Equals(Quat other)
        {
            return X.Equals(other.X) && Y.Equals(other.Y) && Z.Equals(other.Z) && W.Equals(other.W);
        }

        public override bool Equals(object other)
        {
            return other is Quat rotation && Equals(rotation);
        }

        public override int GetHashCode()
        {
            return X.GetHashCode() ^ (Y.GetHashCode() << 8) ^ (Z.GetHashCode() << 16) ^ (W.GetHashCode() << 24);
        }

        public override string ToString()
        {
            return FormattableString.Invariant($"({X}, {Y}, {Z}, {W})");
        }

        internal unsafe void CopyTo(float* to)
        {
            to[0] = X;
            to[1] = Y;
            to[2] = Z;
            to[3] = W;
        }
    }

    /// <summary>Conditions under which a body falls asleep. The default value is the scene's, of a scene Settled.</summary>
    public readonly struct Sleep
    {
        internal readonly RhumbSleep Rule;
        internal readonly float Speed;
        internal readonly float AngularSpeed;
        internal readonly float Seconds;

        internal Sleep(RhumbSleep rule, float speed, float angularSpeed, float seconds)
        {
            Rule = rule;
            Speed = speed;
            AngularSpeed = angularSpeed;
            Seconds = seconds;
        }

        /// <summary>It sleeps once it has settled: it is slow, and neither gravity nor a motor still moves it.</summary>
        public static Sleep Settled
        {
            get { return new Sleep(RhumbSleep.Settled, 0, 0, 0); }
        }

        /// <summary>It never falls asleep by itself, and neither does what it touches.</summary>
        public static Sleep Never
        {
            get { return new Sleep(RhumbSleep.Never, 0, 0, 0); }
        }

        /// <summary>
        /// It sleeps once it is slow for so many seconds, whatever moves it: units of length per second of its fastest point,
        /// and rad/s.
        /// </summary>
        public static Sleep Below(float speed, float angularSpeed, float seconds)
        {
            return new Sleep(RhumbSleep.Below, speed, angularSpeed, seconds);
        }
    }

    /// <summary>A body of a scene, for as long as the scene lives. The default value is no body.</summary>
    [StructLayout(LayoutKind.Sequential)]
    public struct Body : IEquatable<Body>
    {
        internal ulong Word;

        internal Body(ulong word)
        {
            Word = word;
        }

        /// <summary>
        /// Its number, the same for all members of the scene and in every language. Zero for no body. It is to be sent or
        /// stored; a program does not compute with it.
        /// </summary>
        public ulong Id
        {
            get { return Word; }
        }

        public bool IsNone
        {
            get { return Word == 0; }
        }

        /// <summary>
        /// The body with a number that Id gave, to this member of the scene or another one. A number that no body has is an
        /// error of the calls that take the body.
        /// </summary>
        public static Body FromId(ulong id)
        {
            return new Body(id);
        }

        public bool Equals(Body other)
        {
            return Word == other.Word;
        }

        public override bool Equals(object other)
        {
            return other is Body body && Equals(body);
        }

        public override int GetHashCode()
        {
            return Word.GetHashCode();
        }

        public override string ToString()
        {
            return IsNone ? "no body" : "body " + Word;
        }
    }
}
