// Shapes.

using System;

namespace Rhumb
{
    /// <summary>
    /// A shape, centred on its body's centre of mass; long axes point up. Lengths are in the scene's unit. It does not
    /// change once it is made.
    /// </summary>
    public sealed class Shape
    {
        private RhumbShape raw;

        private Shape(RhumbShapeKind kind)
        {
            raw = BodyDesc.Plain().shape;
            raw.kind = (uint)kind;
        }

        /// <summary>Three numbers for each point, or heights.</summary>
        internal float[] Points { get; private set; } = Array.Empty<float>();

        /// <summary>Three places of points for each triangle.</summary>
        internal uint[] Corners { get; private set; } = Array.Empty<uint>();

        public static Shape Ball(float radius)
        {
            var shape = new Shape(RhumbShapeKind.Ball);
            shape.raw.radius = radius;
            return shape;
        }

        /// <summary>By half the edge lengths.</summary>
        public static Shape Cuboid(float x, float y, float z)
        {
            return Box(RhumbShapeKind.Cuboid, x, y, z, 0);
        }

        public static Shape RoundedCuboid(float x, float y, float z, float radius)
        {
            return Box(RhumbShapeKind.RoundedCuboid, x, y, z, radius);
        }

        public static Shape Capsule(float halfHeight, float radius)
        {
            return Round(RhumbShapeKind.Capsule, halfHeight, radius);
        }

        public static Shape Cylinder(float halfHeight, float radius)
        {
            return Round(RhumbShapeKind.Cylinder, halfHeight, radius);
        }

        public static Shape Cone(float halfHeight, float radius)
        {
            return Round(RhumbShapeKind.Cone, halfHeight, radius);
        }

        /// <summary>Everything behind a plane, whose normal points out of it. For fixed bodies.</summary>
        public static unsafe Shape HalfSpace(Vec3 normal)
        {
            var shape = new Shape(RhumbShapeKind.HalfSpace);
            fixed (float* to = shape.raw.normal)
            {
                normal.CopyTo(to);
            }
            return shape;
        }

        public static Shape Hull(params Vec3[] points)
        {
            var shape = new Shape(RhumbShapeKind.Hull);
            shape.SetPoints(points);
            return shape;
        }

        /// <summary>Three places of points for each triangle. For fixed bodies.</summary>
        public static Shape Mesh(Vec3[] points, uint[] corners)
        {
            if (corners == null || corners.Length % 3 != 0)
            {
                throw new RhumbException(RhumbCode.Invalid, "the corners of a mesh must be three for each triangle");
            }
            var shape = new Shape(RhumbShapeKind.Mesh);
            shape.SetPoints(points);
            shape.Corners = (uint[])corners.Clone();
            return shape;
        }

        /// <summary>Rows of heights. For fixed bodies.</summary>
        public static Shape Heights(float[,] heights, float rowSpacing, float columnSpacing)
        {
            if (heights == null)
            {
                throw new RhumbException(RhumbCode.Null, "heights must not be null");
            }
            var shape = new Shape(RhumbShapeKind.Heights);
            shape.raw.rows = (uint)heights.GetLength(0);
            shape.raw.row_spacing = rowSpacing;
            shape.raw.column_spacing = columnSpacing;
            shape.Points = new float[heights.Length];
            Buffer.BlockCopy(heights, 0, shape.Points, 0, heights.Length * sizeof(float));
            shape.raw.point_count = (UIntPtr)heights.Length;
            return shape;
        }

        /// <summary>The struct of C, with pointers that are valid while the two arrays are pinned.</summary>
        internal unsafe RhumbShape Raw(float* points, uint* corners)
        {
            RhumbShape copy = raw;
            copy.points = points;
            copy.triangles = corners;
            copy.triangle_count = (UIntPtr)(Corners.Length / 3);
            return copy;
        }

        private static unsafe Shape Box(RhumbShapeKind kind, float x, float y, float z, float radius)
        {
            var shape = new Shape(kind);
            shape.raw.radius = radius;
            fixed (float* to = shape.raw.half_extents)
            {
                new Vec3(x, y, z).CopyTo(to);
            }
            return shape;
        }

        private static Shape Round(RhumbShapeKind kind, float halfHeight, float radius)
        {
            var shape = new Shape(kind);
            shape.raw.half_height = halfHeight;
            shape.raw.radius = radius;
            return shape;
        }

        private void SetPoints(Vec3[] points)
        {
            if (points == null)
            {
                throw new RhumbException(RhumbCode.Null, "points must not be null");
            }
            Points = new float[3 * points.Length];
            for (int i = 0; i < points.Length; i++)
            {
                Points[3 * i] = points[i].X;
                Points[3 * i + 1] = points[i].Y;
                Points[3 * i + 2] = points[i].Z;
            }
            raw.point_count = (UIntPtr)points.Length;
        }
    }
}
