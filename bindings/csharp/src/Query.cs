// Queries and what they find.

namespace Rhumb
{
    /// <summary>A question about where the bodies are, for Scene.Ask.</summary>
    public struct Query
    {
        internal RhumbQuery Raw;

        /// <summary>The nearest bodies along a line. One whose surface the line only reaches with its end is not hit.</summary>
        public static Query Ray(Vec3 origin, Vec3 translation, uint hits = 1)
        {
            return Make(RhumbQueryKind.Ray, origin, translation, hits);
        }

        /// <summary>The nearest bodies that a simple shape touches on its way.</summary>
        public static Query ShapeCast(Shape shape, Vec3 position, Vec3 translation, uint hits = 1)
        {
            return Make(RhumbQueryKind.ShapeCast, position, translation, hits).With(shape);
        }

        /// <summary>The bodies whose surfaces are nearest to a point, within a distance.</summary>
        public static Query Projection(Vec3 point, float distance, uint hits = 1)
        {
            Query query = Make(RhumbQueryKind.Projection, point, default(Vec3), hits);
            query.Raw.distance = distance;
            return query;
        }

        /// <summary>The bodies that a simple shape overlaps.</summary>
        public static Query Overlap(Shape shape, Vec3 position, uint hits = 64)
        {
            return Make(RhumbQueryKind.Overlap, position, default(Vec3), hits).With(shape);
        }

        /// <summary>
        /// The bodies that touch a body after the last step, the deepest contact first: the points of its hits lie on the body
        /// that is asked about.
        /// </summary>
        public static Query Contacts(Body body, uint hits = 64)
        {
            Query query = Make(RhumbQueryKind.Contacts, default(Vec3), default(Vec3), hits);
            query.Raw.body.Item1 = body.Word;
            return query;
        }

        /// <summary>The same question about other bodies.</summary>
        public Query Among(bool fixedBodies = true, bool dynamic = true, bool kinematic = true, bool sensors = false)
        {
            Query query = this;
            query.Raw.without_fixed = (byte)(fixedBodies ? 0 : 1);
            query.Raw.without_dynamic = (byte)(dynamic ? 0 : 1);
            query.Raw.without_kinematic = (byte)(kinematic ? 0 : 1);
            query.Raw.with_sensors = (byte)(sensors ? 1 : 0);
            return query;
        }

        /// <summary>
        /// The same question with its shape turned: a unit quaternion, shape to world. A shape is not turned unless this is
        /// called. A ray and a projection have no shape, and ignore it. Ask refuses a quaternion that is not of unit length.
        /// </summary>
        public unsafe Query Rotation(Quat rotation)
        {
            Query query = this;
            rotation.CopyTo(query.Raw.rotation);
            return query;
        }

        /// <summary>
        /// The same question about the bodies in any of these collision groups: one bit for each, as in BodyDesc.Groups. Every
        /// group counts unless this is called.
        /// </summary>
        public Query Groups(uint groups)
        {
            Query query = this;
            query.Raw.groups = groups;
            return query;
        }

        /// <summary>The same question without one body.</summary>
        public Query Except(Body body)
        {
            Query query = this;
            query.Raw.except.Item1 = body.Word;
            return query;
        }

        private static unsafe Query Make(RhumbQueryKind kind, Vec3 position, Vec3 translation, uint hits)
        {
            var query = default(Query);
            RhumbException.Check(Native.rhumb_query_init(&query.Raw));
            query.Raw.kind = (uint)kind;
            query.Raw.hits = hits;
            position.CopyTo(query.Raw.position);
            translation.CopyTo(query.Raw.translation);
            return query;
        }

        private unsafe Query With(Shape shape)
        {
            if (shape == null)
            {
                throw new RhumbException(RhumbCode.Null, "shape must not be null");
            }
            if (!shape.IsSimple)
            {
                throw new RhumbException(RhumbCode.Invalid, "the shape of a query must be of a simple kind");
            }
            Query query = this;
            query.Raw.shape = shape.Raw();
            return query;
        }
    }

    /// <summary>A body that a query found.</summary>
    public struct Hit
    {
        /// <summary>Place of the query in the call.</summary>
        public int Query;
        public Body Body;

        /// <summary>
        /// Units of length along the way, from the point to the surface, or from surface to surface, negative inside; zero
        /// for an overlap.
        /// </summary>
        public float Distance;

        /// <summary>On the body's surface, of a contact on that of the body that is asked about, in world axes; zero for an overlap.</summary>
        public Vec3 Point;

        /// <summary>Outward from the surface, in world axes, unit; zero where there is none.</summary>
        public Vec3 Normal;
    }
}
