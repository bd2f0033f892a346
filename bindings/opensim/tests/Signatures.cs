// Stand-ins for OpenSimulator's types, so that tests run without it.

// Declared anew from the names and types that a physics plug-in has to implement or call, with as little behaviour as the
// tests need. With OpenSimulator's own assemblies this file is left out.

using System;
using System.Collections.Generic;
using System.IO;

namespace OpenMetaverse
{
    public struct Vector3 : IEquatable<Vector3>
    {
        public static readonly Vector3 Zero;
        public float X, Y, Z;

        public Vector3(float x, float y, float z) { X = x; Y = y; Z = z; }

        public static Vector3 operator +(Vector3 a, Vector3 b) { return new Vector3(a.X + b.X, a.Y + b.Y, a.Z + b.Z); }

        public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.X - b.X, a.Y - b.Y, a.Z - b.Z); }

        public static Vector3 operator *(Vector3 a, float b) { return new Vector3(a.X * b, a.Y * b, a.Z * b); }

        public static bool operator ==(Vector3 a, Vector3 b) { return a.X == b.X && a.Y == b.Y && a.Z == b.Z; }

        public static bool operator !=(Vector3 a, Vector3 b) { return !(a == b); }

        public bool Equals(Vector3 other) { return this == other; }

        public override bool Equals(object other) { return other is Vector3 v && this == v; }

        public override int GetHashCode() { return X.GetHashCode() ^ (Y.GetHashCode() << 8) ^ (Z.GetHashCode() << 16); }

        public override string ToString() { return FormattableString.Invariant($"<{X}, {Y}, {Z}>"); }
    }

    public struct Quaternion
    {
        public static readonly Quaternion Identity = new Quaternion(0, 0, 0, 1);
        public float X, Y, Z, W;

        public Quaternion(float x, float y, float z, float w) { X = x; Y = y; Z = z; W = w; }

        public static bool operator ==(Quaternion a, Quaternion b)
        {
            return a.X == b.X && a.Y == b.Y && a.Z == b.Z && a.W == b.W;
        }

        public static bool operator !=(Quaternion a, Quaternion b) { return !(a == b); }

        public override bool Equals(object other) { return other is Quaternion q && this == q; }

        public override int GetHashCode() { return X.GetHashCode() ^ W.GetHashCode(); }
    }
}

namespace OpenSim.Framework
{
    public enum ProfileShape : byte { Circle = 0, Square = 1, HalfCircle = 5 }

    public enum Extrusion : byte { Straight = 16, Curve1 = 32 }

    public class PrimitiveBaseShape
    {
        public ushort ProfileBegin { get; set; }
        public ushort ProfileEnd { get; set; }
        public ushort ProfileHollow { get; set; }
        public ushort PathBegin { get; set; }
        public ushort PathEnd { get; set; }
        public byte PathCurve { get; set; } = (byte)Extrusion.Straight;
        public sbyte PathTwist { get; set; }
        public sbyte PathTwistBegin { get; set; }
        public sbyte PathTaperX { get; set; }
        public sbyte PathTaperY { get; set; }
        public byte PathScaleX { get; set; } = 100;
        public byte PathScaleY { get; set; } = 100;
        public byte PathShearX { get; set; }
        public byte PathShearY { get; set; }
        public bool SculptEntry { get; set; }
        public ProfileShape ProfileShape { get; set; } = ProfileShape.Square;
    }
}

namespace OpenSim.Region.Physics.Manager
{
    using OpenMetaverse;
    using OpenSim.Framework;

    public delegate void RaycastCallback(bool hitYN, Vector3 collisionPoint, uint localid, float distance, Vector3 normal);

    public delegate void RayCallback(List<ContactResult> list);

    public enum ActorTypes { Unknown, Agent, Prim, Ground }

    public enum PIDHoverType { Ground, GroundAndWater, Water, Absolute }

    public enum LevelOfDetail { High = 32, Medium = 16, Low = 8, VeryLow = 4 }

    public interface IPhysicsPlugin
    {
        bool Init();
        PhysicsScene GetScene(string sceneIdentifier);
        string GetName();
        void Dispose();
    }

    public interface IMesher
    {
        IMesh CreateMesh(string primName, PrimitiveBaseShape primShape, Vector3 size, float lod);
        IMesh CreateMesh(string primName, PrimitiveBaseShape primShape, Vector3 size, float lod, bool isPhysical);
        IMesh CreateMesh(string primName, PrimitiveBaseShape primShape, Vector3 size, float lod, bool isPhysical, bool shouldCache);
    }

    public interface IMesh
    {
        List<Vector3> getVertexList();
        int[] getIndexListAsInt();
        int[] getIndexListAsIntLocked();
        float[] getVertexListAsFloat();
        float[] getVertexListAsFloatLocked();
        void getIndexListAsPtrToIntArray(out IntPtr indices, out int triStride, out int indexCount);
        void getVertexListAsPtrToFloatArray(out IntPtr vertexList, out int vertexStride, out int vertexCount);
        void releaseSourceMeshData();
        void releasePinned();
        void Append(IMesh newMesh);
        void TransformLinear(float[,] matrix, float[] offset);
    }

    public struct ContactResult
    {
        public Vector3 Pos;
        public float Depth;
        public uint ConsumerID;
        public Vector3 Normal;
    }

    public struct ContactPoint
    {
        public Vector3 Position, SurfaceNormal;
        public float PenetrationDepth;

        public ContactPoint(Vector3 position, Vector3 surfaceNormal, float penetrationDepth)
        {
            Position = position;
            SurfaceNormal = surfaceNormal;
            PenetrationDepth = penetrationDepth;
        }
    }

    public class CollisionEventUpdate : EventArgs
    {
        public Dictionary<uint, ContactPoint> m_objCollisionList = new Dictionary<uint, ContactPoint>();

        public void AddCollider(uint localID, ContactPoint contact) { m_objCollisionList[localID] = contact; }
    }

    public abstract class PhysicsScene
    {
        public string Name { get; protected set; }
        public string EngineType { get; protected set; }
        public abstract bool IsThreaded { get; }

        public abstract void Initialise(IMesher meshmerizer, Nini.Config.IConfigSource config);
        public abstract PhysicsActor AddAvatar(string avName, Vector3 position, Vector3 velocity, Vector3 size, bool isFlying);
        public abstract void RemoveAvatar(PhysicsActor actor);
        public abstract void RemovePrim(PhysicsActor prim);
        public abstract PhysicsActor AddPrimShape(string primName, PrimitiveBaseShape pbs, Vector3 position, Vector3 size,
            Quaternion rotation, bool isPhysical, uint localid);
        public abstract void AddPhysicsActorTaint(PhysicsActor prim);
        public abstract float Simulate(float timeStep);
        public abstract void GetResults();
        public abstract void SetTerrain(float[] heightMap);
        public abstract void SetWaterLevel(float baseheight);
        public abstract void DeleteTerrain();
        public abstract void Dispose();
        public abstract Dictionary<uint, float> GetTopColliders();

        public virtual void Initialise(IMesher meshmerizer, Nini.Config.IConfigSource config, Vector3 regionExtent)
        {
            Initialise(meshmerizer, config);
        }

        public virtual PhysicsActor AddAvatar(
            uint localID, string avName, Vector3 position, Vector3 velocity, Vector3 size, bool isFlying)
        {
            return AddAvatar(avName, position, velocity, size, isFlying);
        }

        public virtual bool SupportsRayCast() { return false; }

        public virtual void RaycastWorld(Vector3 position, Vector3 direction, float length, RaycastCallback retMethod) { }

        public virtual void RaycastWorld(Vector3 position, Vector3 direction, float length, int Count, RayCallback retMethod) { }

        public virtual List<ContactResult> RaycastWorld(Vector3 position, Vector3 direction, float length, int Count)
        {
            return new List<ContactResult>();
        }
    }

    public abstract class PhysicsActor
    {
        protected Vector3 m_targetVelocity;

        public delegate void RequestTerseUpdate();

        public delegate void CollisionUpdate(EventArgs e);

        public delegate void OutOfBounds(Vector3 pos);

        public event RequestTerseUpdate OnRequestTerseUpdate;
        public event CollisionUpdate OnCollisionUpdate;
        public event OutOfBounds OnOutOfBounds;

        public string Name { get; protected set; }
        public virtual uint LocalID { get; set; }
        public virtual float Density { get; set; }
        public virtual float GravModifier { get; set; }
        public virtual float Friction { get; set; }
        public virtual float Restitution { get; set; }
        public abstract bool Stopped { get; }
        public abstract Vector3 Size { get; set; }
        public abstract PrimitiveBaseShape Shape { set; }
        public abstract bool Grabbed { set; }
        public abstract bool Selected { set; }
        public abstract Vector3 Position { get; set; }
        public abstract float Mass { get; }
        public abstract Vector3 Force { get; set; }
        public abstract int VehicleType { get; set; }
        public abstract Vector3 GeometricCenter { get; }
        public abstract Vector3 CenterOfMass { get; }
        public abstract Vector3 Velocity { get; set; }
        public abstract Vector3 Torque { get; set; }
        public abstract float CollisionScore { get; set; }
        public abstract Vector3 Acceleration { get; set; }
        public abstract Quaternion Orientation { get; set; }
        public abstract int PhysicsActorType { get; set; }
        public abstract bool IsPhysical { get; set; }
        public abstract bool Flying { get; set; }
        public abstract bool SetAlwaysRun { get; set; }
        public abstract bool ThrottleUpdates { get; set; }
        public abstract bool IsColliding { get; set; }
        public abstract bool CollidingGround { get; set; }
        public abstract bool CollidingObj { get; set; }
        public abstract bool FloatOnWater { set; }
        public abstract Vector3 RotationalVelocity { get; set; }
        public abstract bool Kinematic { get; set; }
        public abstract float Buoyancy { get; set; }
        public abstract Vector3 PIDTarget { set; }
        public abstract bool PIDActive { get; set; }
        public abstract float PIDTau { set; }
        public abstract bool PIDHoverActive { set; }
        public abstract float PIDHoverHeight { set; }
        public abstract PIDHoverType PIDHoverType { set; }
        public abstract float PIDHoverTau { set; }
        public abstract Quaternion APIDTarget { set; }
        public abstract bool APIDActive { set; }
        public abstract float APIDStrength { set; }
        public abstract float APIDDamping { set; }

        public virtual Vector3 TargetVelocity
        {
            get { return m_targetVelocity; }
            set { m_targetVelocity = value; Velocity = value; }
        }

        public abstract void CrossingFailure();
        public abstract void link(PhysicsActor obj);
        public abstract void delink();
        public abstract void LockAngularMotion(Vector3 axis);
        public abstract void VehicleFloatParam(int param, float value);
        public abstract void VehicleVectorParam(int param, Vector3 value);
        public abstract void VehicleRotationParam(int param, Quaternion rotation);
        public abstract void VehicleFlags(int param, bool remove);
        public abstract void SetVolumeDetect(int param);
        public abstract void AddForce(Vector3 force, bool pushforce);
        public abstract void AddAngularForce(Vector3 force, bool pushforce);
        public abstract void SetMomentum(Vector3 momentum);
        public abstract void SubscribeEvents(int ms);
        public abstract void UnSubscribeEvents();
        public abstract bool SubscribedEvents();

        public virtual void RequestPhysicsterseUpdate() { OnRequestTerseUpdate?.Invoke(); }

        public virtual void RaiseOutOfBounds(Vector3 pos) { OnOutOfBounds?.Invoke(pos); }

        public virtual void SendCollisionUpdate(EventArgs e) { OnCollisionUpdate?.Invoke(e); }
    }
}

namespace Nini.Config
{
    public interface IConfig
    {
        string GetString(string key, string defaultValue);
    }

    public class ConfigCollection
    {
        internal readonly Dictionary<string, IConfig> Sections = new Dictionary<string, IConfig>();

        public IConfig this[string name] { get { return Sections.TryGetValue(name, out IConfig found) ? found : null; } }
    }

    public interface IConfigSource
    {
        ConfigCollection Configs { get; }
    }

    public class IniConfigSource : IConfigSource
    {
        public IniConfigSource(string path)
        {
            Section section = null;
            foreach (string line in File.ReadAllLines(path))
            {
                string[] pair = line.Split(new[] { '=' }, 2);
                if (line.StartsWith("["))
                {
                    Configs.Sections[line.Trim('[', ']')] = section = new Section();
                }
                else if (pair.Length == 2)
                {
                    section.Values[pair[0].Trim()] = pair[1].Trim();
                }
            }
        }

        public ConfigCollection Configs { get; } = new ConfigCollection();

        private sealed class Section : IConfig
        {
            internal readonly Dictionary<string, string> Values = new Dictionary<string, string>();

            public string GetString(string key, string defaultValue)
            {
                return Values.TryGetValue(key, out string value) ? value : defaultValue;
            }
        }
    }
}

namespace log4net
{
    public interface ILog
    {
        void InfoFormat(string format, params object[] args);
        void WarnFormat(string format, params object[] args);
        void ErrorFormat(string format, params object[] args);
    }

    public static class LogManager
    {
        public static ILog GetLogger(Type type) { return new Lines(); }

        private sealed class Lines : ILog
        {
            public void InfoFormat(string format, params object[] args) { Write("INFO ", format, args); }

            public void WarnFormat(string format, params object[] args) { Write("WARN ", format, args); }

            public void ErrorFormat(string format, params object[] args) { Write("ERROR ", format, args); }

            private static void Write(string level, string format, object[] args)
            {
                Console.Error.WriteLine(level + string.Format(format, args));
            }
        }
    }
}
