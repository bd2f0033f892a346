// Shapes of prims as shapes of Rhumb.

using System;
using System.Collections.Generic;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>
    /// A shape whose origin is its centre of mass. Boxes, spheres and round cylinders are exact. Any other prim is the convex
    /// hull of its mesh if it is physical, otherwise the mesh; without a mesh it is a box of its size.
    /// </summary>
    internal struct Solid
    {
        /// <summary>Most points of a hull on the wire.</summary>
        private const int HullPoints = 255;
        private const float Thinnest = 0.01f;

        internal Shape Shape;

        /// <summary>From the prim's origin, in the prim's axes.</summary>
        internal Vector3 Centre;

        /// <summary>m³.</summary>
        internal float Volume;

        internal static Solid Box(Vector3 size)
        {
            Vector3 half = new Vector3(Math.Max(size.X, Thinnest), Math.Max(size.Y, Thinnest), Math.Max(size.Z, Thinnest)) * 0.5f;
            return new Solid { Shape = Shape.Cuboid(half.X, half.Y, half.Z), Volume = 8 * half.X * half.Y * half.Z };
        }

        internal static Solid Capsule(Vector3 size)
        {
            float radius = Math.Max(Math.Min(size.X, size.Y), 0.1f) / 2, straight = Math.Max(size.Z / 2 - radius, Thinnest);
            float round = (float)Math.PI * radius * radius;
            return new Solid { Shape = Shape.Capsule(straight, radius), Volume = round * (2 * straight + radius * 4 / 3) };
        }

        internal static Solid OfPrim(string name, PrimitiveBaseShape prim, Vector3 size, bool physical, IMesher mesher)
        {
            bool uncut = prim.ProfileBegin == 0 && prim.ProfileEnd == 0 && prim.ProfileHollow == 0 && prim.PathBegin == 0
                && prim.PathEnd == 0 && prim.PathTwist == 0 && prim.PathTwistBegin == 0 && prim.PathTaperX == 0
                && prim.PathTaperY == 0 && prim.PathScaleX == 100 && prim.PathScaleY == 100 && prim.PathShearX == 0
                && prim.PathShearY == 0 && !prim.SculptEntry;
            bool straight = prim.PathCurve == (byte)Extrusion.Straight, round = size.X == size.Y;
            float across = Math.Max(size.X, Thinnest) / 2;
            if (uncut && straight && prim.ProfileShape == ProfileShape.Square)
            {
                return Box(size);
            }
            if (uncut && prim.PathCurve == (byte)Extrusion.Curve1 && prim.ProfileShape == ProfileShape.HalfCircle
                && round && size.X == size.Z)
            {
                return new Solid { Shape = Shape.Ball(across), Volume = (float)(4 * Math.PI / 3 * across * across * across) };
            }
            if (uncut && straight && prim.ProfileShape == ProfileShape.Circle && round)
            {
                float half = Math.Max(size.Z, Thinnest) / 2;
                return new Solid { Shape = Shape.Cylinder(half, across), Volume = (float)(2 * Math.PI * across * across * half) };
            }
            IMesh mesh = mesher.CreateMesh(name, prim, size, (float)LevelOfDetail.Medium, physical);
            return mesh == null ? Box(size) : OfMesh(mesh.getVertexList(), mesh.getIndexListAsInt(), size, physical);
        }

        /// <summary>Several solids at places in one another's axes as one, around their common centre of mass.</summary>
        internal static Solid Compound(List<Solid> solids, List<Vector3> places, List<Quaternion> rotations)
        {
            Vector3 centre = Vector3.Zero;
            float volume = 0;
            for (int i = 0; i < solids.Count; i++)
            {
                volume += solids[i].Volume;
                centre += (places[i] + Geometry.Rotated(solids[i].Centre, rotations[i])) * solids[i].Volume;
            }
            centre *= 1 / volume;
            var parts = new Part[solids.Count];
            for (int i = 0; i < parts.Length; i++)
            {
                Vector3 at = places[i] + Geometry.Rotated(solids[i].Centre, rotations[i]) - centre;
                parts[i] = new Part(solids[i].Shape, at.ToVec3(), rotations[i].ToQuat());
            }
            return new Solid { Shape = Shape.Compound(parts), Centre = centre, Volume = volume };
        }

        private static Solid OfMesh(List<Vector3> points, int[] corners, Vector3 size, bool physical)
        {
            if (points.Count < 4 || corners.Length < 12)
            {
                return Box(size);
            }
            if (!physical)
            {
                return new Solid { Shape = Shape.Mesh(Moved(points, Vector3.Zero), Array.ConvertAll(corners, c => (uint)c)) };
            }
            // Tetrahedra from the origin to each triangle: those of a closed surface add up to its inside.
            Vector3 centre = Vector3.Zero;
            float volume = 0;
            for (int i = 0; i + 2 < corners.Length; i += 3)
            {
                Vector3 a = points[corners[i]], b = points[corners[i + 1]], c = points[corners[i + 2]];
                float part = Geometry.Dot(a, Geometry.Cross(b, c)) / 6;
                volume += part;
                centre += (a + b + c) * (part / 4);
            }
            if (Math.Abs(volume) < 1e-6f)
            {
                return Box(size);
            }
            centre *= 1 / volume;
            return new Solid { Shape = Shape.Hull(Moved(Outermost(points), centre)), Centre = centre, Volume = Math.Abs(volume) };
        }

        /// <summary>Points without repetition; of too many, the farthest in directions spread evenly over a sphere.</summary>
        private static IEnumerable<Vector3> Outermost(List<Vector3> points)
        {
            var kept = new HashSet<Vector3>(points);
            if (kept.Count <= HullPoints)
            {
                return kept;
            }
            kept.Clear();
            for (int i = 0; i < HullPoints; i++)
            {
                double z = 1 - (2 * i + 1.0) / HullPoints, turn = i * Math.PI * (3 - Math.Sqrt(5)), r = Math.Sqrt(1 - z * z);
                var direction = new Vector3((float)(r * Math.Cos(turn)), (float)(r * Math.Sin(turn)), (float)z);
                Vector3 farthest = points[0];
                foreach (Vector3 point in points)
                {
                    if (Geometry.Dot(point, direction) > Geometry.Dot(farthest, direction))
                    {
                        farthest = point;
                    }
                }
                kept.Add(farthest);
            }
            return kept;
        }

        private static Vec3[] Moved(IEnumerable<Vector3> points, Vector3 centre)
        {
            var moved = new List<Vec3>();
            foreach (Vector3 point in points)
            {
                moved.Add((point - centre).ToVec3());
            }
            return moved.ToArray();
        }
    }
}
