// OpenSimulator's vectors and rotations as Rhumb's, and their arithmetic.

using OpenMetaverse;

namespace Rhumb.Plugin
{
    /// <summary>Right-handed, z up, metres at both ends: only the types differ. Rotations are unit quaternions.</summary>
    internal static class Geometry
    {
        internal static Vec3 ToVec3(this Vector3 v)
        {
            return new Vec3(v.X, v.Y, v.Z);
        }

        internal static Vector3 ToVector3(this Vec3 v)
        {
            return new Vector3(v.X, v.Y, v.Z);
        }

        internal static Quat ToQuat(this Quaternion q)
        {
            return new Quat(q.X, q.Y, q.Z, q.W);
        }

        internal static Quaternion ToQuaternion(this Quat q)
        {
            return new Quaternion(q.X, q.Y, q.Z, q.W);
        }

        internal static Quaternion Inverse(Quaternion q)
        {
            return new Quaternion(-q.X, -q.Y, -q.Z, q.W);
        }

        /// <summary>The rotation b, and then the rotation a.</summary>
        internal static Quaternion Product(Quaternion a, Quaternion b)
        {
            return new Quaternion(
                a.W * b.X + a.X * b.W + a.Y * b.Z - a.Z * b.Y,
                a.W * b.Y - a.X * b.Z + a.Y * b.W + a.Z * b.X,
                a.W * b.Z + a.X * b.Y - a.Y * b.X + a.Z * b.W,
                a.W * b.W - a.X * b.X - a.Y * b.Y - a.Z * b.Z);
        }

        internal static Vector3 Rotated(Vector3 v, Quaternion q)
        {
            var axis = new Vector3(q.X, q.Y, q.Z);
            Vector3 twice = Cross(axis, v) * 2;
            return v + twice * q.W + Cross(axis, twice);
        }

        internal static Vector3 Cross(Vector3 a, Vector3 b)
        {
            return new Vector3(a.Y * b.Z - a.Z * b.Y, a.Z * b.X - a.X * b.Z, a.X * b.Y - a.Y * b.X);
        }

        internal static float Dot(Vector3 a, Vector3 b)
        {
            return a.X * b.X + a.Y * b.Y + a.Z * b.Z;
        }

        /// <summary>True for four finite numbers that are not all zero.</summary>
        internal static bool IsRotation(Quaternion q)
        {
            float squares = q.X * q.X + q.Y * q.Y + q.Z * q.Z + q.W * q.W;
            return squares > 0 && !float.IsInfinity(squares);
        }

        internal static bool IsFinite(Vector3 v)
        {
            float sum = v.X + v.Y + v.Z;
            return !float.IsNaN(sum) && !float.IsInfinity(sum);
        }
    }
}
