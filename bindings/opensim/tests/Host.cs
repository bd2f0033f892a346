// A region as far as physics sees it: a plug-in, its settings and a mesher.

using System;
using System.Collections.Generic;
using System.IO;
using System.Reflection;
using Nini.Config;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

/// <summary>Loads a plug-in as OpenSimulator does: by its assembly and its name.</summary>
internal static class Host
{
    internal const float Frame = 0.089f;
    internal const int Side = 256;

    internal static PhysicsScene Load(string assembly, string name, params string[] settings)
    {
        foreach (Type type in Assembly.LoadFrom(assembly).GetExportedTypes())
        {
            if (!type.IsAbstract && typeof(IPhysicsPlugin).IsAssignableFrom(type))
            {
                var plugin = (IPhysicsPlugin)Activator.CreateInstance(type);
                if (plugin.Init() && plugin.GetName() == name)
                {
                    PhysicsScene scene = plugin.GetScene("test");
                    string path = Path.GetTempFileName();
                    try
                    {
                        File.WriteAllLines(path, settings);
                        scene.Initialise(new WedgeMesher(), new IniConfigSource(path), new Vector3(Side, Side, Side));
                    }
                    finally
                    {
                        File.Delete(path);
                    }
                    return scene;
                }
            }
        }
        throw new ArgumentException(assembly + " has no physics plug-in named " + name);
    }

    /// <summary>An uncut prim; a round one along a circular path is a sphere.</summary>
    internal static PrimitiveBaseShape Prim(ProfileShape profile, Extrusion path)
    {
        return new PrimitiveBaseShape
        {
            ProfileShape = profile, PathCurve = (byte)path, PathScaleX = 100, PathScaleY = 100,
        };
    }

    /// <summary>Heights in OpenSimulator's order.</summary>
    internal static float[] Terrain(Func<int, int, float> height)
    {
        var map = new float[Side * Side];
        for (int y = 0; y < Side; y++)
        {
            for (int x = 0; x < Side; x++)
            {
                map[y * Side + x] = height(x, y);
            }
        }
        return map;
    }
}

/// <summary>Meshes every prim as the lower half of its box, cut along a diagonal: its centre of mass is off its origin.</summary>
internal sealed class WedgeMesher : IMesher
{
    public IMesh CreateMesh(string primName, PrimitiveBaseShape primShape, Vector3 size, float lod)
    {
        return new Wedge(size);
    }

    public IMesh CreateMesh(string primName, PrimitiveBaseShape primShape, Vector3 size, float lod, bool isPhysical)
    {
        return new Wedge(size);
    }

    public IMesh CreateMesh(
        string primName, PrimitiveBaseShape primShape, Vector3 size, float lod, bool isPhysical, bool shouldCache)
    {
        return new Wedge(size);
    }

    private sealed class Wedge : IMesh
    {
        private readonly List<Vector3> points = new List<Vector3>();

        internal Wedge(Vector3 size)
        {
            foreach (float y in new[] { -size.Y / 2, size.Y / 2 })
            {
                points.Add(new Vector3(-size.X / 2, y, -size.Z / 2));
                points.Add(new Vector3(size.X / 2, y, -size.Z / 2));
                points.Add(new Vector3(-size.X / 2, y, size.Z / 2));
            }
        }

        public List<Vector3> getVertexList()
        {
            return points;
        }

        public int[] getIndexListAsInt()
        {
            return new[] { 0, 1, 2, 3, 5, 4, 0, 3, 4, 0, 4, 1, 1, 4, 5, 1, 5, 2, 2, 5, 3, 2, 3, 0 };
        }

        public int[] getIndexListAsIntLocked()
        {
            throw new NotSupportedException();
        }

        public float[] getVertexListAsFloat()
        {
            throw new NotSupportedException();
        }

        public float[] getVertexListAsFloatLocked()
        {
            throw new NotSupportedException();
        }

        public void getIndexListAsPtrToIntArray(out IntPtr indices, out int triStride, out int indexCount)
        {
            throw new NotSupportedException();
        }

        public void getVertexListAsPtrToFloatArray(out IntPtr vertexList, out int vertexStride, out int vertexCount)
        {
            throw new NotSupportedException();
        }

        public void releaseSourceMeshData()
        {
        }

        public void releasePinned()
        {
        }

        public void Append(IMesh newMesh)
        {
            throw new NotSupportedException();
        }

        public void TransformLinear(float[,] matrix, float[] offset)
        {
            throw new NotSupportedException();
        }
    }
}
