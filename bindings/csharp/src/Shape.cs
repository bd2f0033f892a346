// Shapes.

using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace Rhumb
{
    /// <summary>
    /// A shape; long axes point up. Its origin is its body's centre of mass, but for hulls and compounds: see
    /// <see cref="Centre"/>. Lengths are in the scene's unit. It does not change once it is made.
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
        private float[] Points { get; set; } = Array.Empty<float>();

        /// <summary>Three places of points for each triangle.</summary>
        private uint[] Corners { get; set; } = Array.Empty<uint>();

        private Part[] Parts { get; set; } = Array.Empty<Part>();

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

        /// <summary>Everything behind a plane, whose normal points out of it. For fixed and kinematic bodies.</summary>
        public static unsafe Shape HalfSpace(Vec3 normal)
        {
            var shape = new Shape(RhumbShapeKind.HalfSpace);
            fixed (float* to = shape.raw.normal)
            {
                normal.CopyTo(to);
            }
            return shape;
        }

        /// <summary>
        /// The convex hull of points, which may be given from anywhere: see <see cref="Centre"/>. It has 255 corners at most;
        /// other points are left out.
        /// </summary>
        public static Shape Hull(params Vec3[] points)
        {
            var shape = new Shape(RhumbShapeKind.Hull);
            shape.SetPoints(points);
            return shape;
        }

        /// <summary>
        /// Three places of points for each triangle. For fixed and kinematic bodies. Over smooth edges bodies slide and roll as over one face.
        /// </summary>
        public static Shape Mesh(Vec3[] points, uint[] corners, RhumbEdges? edges = null)
        {
            if (corners == null || corners.Length % 3 != 0)
            {
                throw new RhumbException(RhumbCode.Invalid, "the corners of a mesh must be three for each triangle");
            }
            var shape = new Shape(RhumbShapeKind.Mesh);
            shape.SetPoints(points);
            shape.SetEdges(edges);
            shape.Corners = (uint[])corners.Clone();
            return shape;
        }

        /// <summary>
        /// Heights by row and column. The first post is at the body's origin; the rows follow each other along x, the columns
        /// along the other axis of the ground. For fixed and kinematic bodies. With smooth edges they are touched from above only.
        /// </summary>
        public static Shape Heights(
            float[,] heights, float rowSpacing, float columnSpacing, RhumbEdges? edges = null)
        {
            if (heights == null)
            {
                throw new RhumbException(RhumbCode.Null, "heights must not be null");
            }
            var shape = new Shape(RhumbShapeKind.Heights);
            shape.raw.rows = (uint)heights.GetLength(0);
            shape.raw.row_spacing = rowSpacing;
            shape.raw.column_spacing = columnSpacing;
            shape.SetEdges(edges);
            shape.Points = new float[heights.Length];
            Buffer.BlockCopy(heights, 0, shape.Points, 0, heights.Length * sizeof(float));
            shape.raw.point_count = (UIntPtr)heights.Length;
            return shape;
        }

        private void SetEdges(RhumbEdges? edges)
        {
            if (edges.HasValue)
            {
                raw.edges = (uint)edges.Value;
            }
        }

        /// <summary>Several shapes, none of which is a compound.</summary>
        public static Shape Compound(params Part[] parts)
        {
            if (parts == null)
            {
                throw new RhumbException(RhumbCode.Null, "parts must not be null");
            }
            foreach (Part part in parts)
            {
                if (part.Shape == null)
                {
                    throw new RhumbException(RhumbCode.Null, "the shape of a part must not be null");
                }
            }
            var shape = new Shape(RhumbShapeKind.Compound);
            shape.Parts = (Part[])parts.Clone();
            return shape;
        }

        /// <summary>
        /// The centre of mass, from the origin in the axes of the shape: another for hulls and compounds alone. Poses of a
        /// body of such a shape are those of its origin, for the client that added it.
        /// </summary>
        public unsafe Vec3 Centre
        {
            get
            {
                var pins = new List<GCHandle>();
                try
                {
                    RhumbShape shape = Pinned(pins);
                    float* centre = stackalloc float[3];
                    RhumbException.Check(Native.rhumb_shape_centre(&shape, centre));
                    return new Vec3(centre[0], centre[1], centre[2]);
                }
                finally
                {
                    pins.ForEach(pin => pin.Free());
                }
            }
        }

        /// <summary>True if it points to nothing: simple shapes do.</summary>
        internal bool IsSimple
        {
            get { return Points.Length == 0 && Parts.Length == 0; }
        }

        /// <summary>The struct of C of a simple shape.</summary>
        internal RhumbShape Raw()
        {
            return raw;
        }

        /// <summary>The struct of C, with pointers that are valid until the pins are freed.</summary>
        internal unsafe RhumbShape Pinned(List<GCHandle> pins)
        {
            RhumbShape copy = raw;
            copy.points = (float*)Pin(Points, pins);
            copy.triangles = (uint*)Pin(Corners, pins);
            copy.triangle_count = (UIntPtr)(Corners.Length / 3);
            if (Parts.Length > 0)
            {
                var shapes = new RhumbShape[Parts.Length];
                var parts = new RhumbPart[Parts.Length];
                var first = (RhumbShape*)Pin(shapes, pins);
                for (int i = 0; i < parts.Length; i++)
                {
                    shapes[i] = Parts[i].Shape.Pinned(pins);
                    parts[i] = Parts[i].Raw(first + i);
                }
                copy.parts = (RhumbPart*)Pin(parts, pins);
                copy.part_count = (UIntPtr)parts.Length;
            }
            return copy;
        }

        private static IntPtr Pin(object array, List<GCHandle> pins)
        {
            // Equal shapes are one object more often than not; pinning one twice does no harm.
            GCHandle pin = GCHandle.Alloc(array, GCHandleType.Pinned);
            pins.Add(pin);
            return pin.AddrOfPinnedObject();
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

    /// <summary>A shape in a compound, in the axes of the body, from the origin of the compound.</summary>
    public struct Part
    {
        public Shape Shape;
        public Vec3 Position;

        /// <summary>Part to body. The default value, four zeros, is no rotation.</summary>
        public Quat Rotation;

        public Part(Shape shape, Vec3 position)
            : this(shape, position, Quat.Identity)
        {
        }

        public Part(Shape shape, Vec3 position, Quat rotation)
        {
            Shape = shape;
            Position = position;
            Rotation = rotation;
        }

        internal unsafe RhumbPart Raw(RhumbShape* shape)
        {
            RhumbPart raw = default(RhumbPart);
            Position.CopyTo(raw.position);
            Quat rotation = Rotation.Equals(default(Quat)) ? Quat.Identity : Rotation;
            rotation.CopyTo(raw.rotation);
            raw.shape = shape;
            return raw;
        }
    }
}
