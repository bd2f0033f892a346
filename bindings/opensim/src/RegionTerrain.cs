// The ground of a region: height fields of at most 256 metres a side.

using System;
using System.Collections.Generic;
using log4net;

namespace Rhumb.Plugin
{
    /// <summary>
    /// Heights of one post a metre. The last row and column are repeated, so that the ground reaches the region's border. The
    /// old ground stays until the server has the new one.
    /// </summary>
    internal sealed class RegionTerrain
    {
        private static readonly ILog Log = LogManager.GetLogger(typeof(RegionTerrain));
        private const int Tile = 256;
        private readonly int sizeX;
        private readonly int sizeY;
        private readonly object gate = new object();
        private float[] heights;
        private bool isNew;

        /// <summary>The ground, and the tiles that take its place once the server has placed all of them.</summary>
        private readonly List<Body> tiles = new List<Body>();
        private readonly List<Body> coming = new List<Body>();
        private readonly HashSet<Body> placed = new HashSet<Body>();
        private readonly HashSet<Body> refused = new HashSet<Body>();
        private readonly List<Body> removals = new List<Body>();

        /// <summary>The tiles' commands have numbers between these.</summary>
        private ulong before;
        private ulong after;

        /// <summary>The server refused a ground, some of whose shapes it may have taken.</summary>
        private bool wasRefused;

        internal RegionTerrain(int sizeX, int sizeY)
        {
            this.sizeX = sizeX;
            this.sizeY = sizeY;
        }

        /// <summary>Heights in OpenSimulator's order, x fastest; null for no ground.</summary>
        internal void Set(float[] map)
        {
            if (map != null && map.Length != sizeX * sizeY)
            {
                throw new ArgumentException("the terrain has " + map.Length + " heights; a region of " + sizeX + " by " + sizeY
                    + " m needs " + (sizeX * sizeY));
            }
            lock (gate)
            {
                heights = map == null ? null : (float[])map.Clone();
                isNew = true;
            }
        }

        /// <summary>The scene holds nothing of the ground.</summary>
        internal void Forget()
        {
            tiles.Clear();
            coming.Clear();
            placed.Clear();
            refused.Clear();
            removals.Clear();
            wasRefused = false;
            lock (gate)
            {
                isNew = heights != null;
            }
        }

        /// <summary>Removes the bodies of old grounds; true if shapes of grounds may be without a body.</summary>
        internal bool Remove(Scene scene)
        {
            bool leavesShapes = removals.Count > 0 || wasRefused;
            RegionLink.Send(scene, removals.ConvertAll(body => Command.RemoveBody(body)));
            removals.Clear();
            wasRefused = false;
            return leavesShapes;
        }

        /// <summary>Adds the ground to the scene, if it changed and the server has answered for the last one.</summary>
        internal void Tell(Scene scene, Body anchor)
        {
            float[] map;
            lock (gate)
            {
                if (!isNew || coming.Count > 0)
                {
                    return;
                }
                map = heights;
                isNew = false;
            }
            try
            {
                Add(scene, anchor, map);
            }
            catch (RhumbException error) when (RegionLink.IsOfOneCall(error))
            {
                Log.ErrorFormat("[RHUMB]: the ground stays as it was: {0}. Set another terrain", error.Message);
            }
            catch
            {
                lock (gate)
                {
                    isNew = true;
                }
                throw;
            }
        }

        private void Add(Scene scene, Body anchor, float[] map)
        {
            if (map == null)
            {
                removals.AddRange(tiles);
                tiles.Clear();
                return;
            }
            var descs = new List<BodyDesc>();
            for (int x = 0; x < sizeX; x += Tile)
            {
                for (int y = 0; y < sizeY; y += Tile)
                {
                    descs.Add(Described(map, x, y, Math.Min(Tile, sizeX - x), Math.Min(Tile, sizeY - y)));
                }
            }
            // Two commands that change nothing, for their numbers.
            Command nothing = Command.SetEvents(anchor, 0, 0);
            before = scene.Send(nothing);
            coming.AddRange(scene.Add(descs.ToArray()));
            after = scene.Send(nothing);
        }

        /// <summary>Takes the server's answers for the coming tiles.</summary>
        internal void Hear(Event next)
        {
            if (next.Kind == RhumbEventKind.BodyPlaced && refused.Remove(next.Body))
            {
                removals.Add(next.Body);
            }
            else if (next.Kind == RhumbEventKind.BodyPlaced && coming.Contains(next.Body))
            {
                placed.Add(next.Body);
                if (placed.Count == coming.Count)
                {
                    removals.AddRange(tiles);
                    tiles.Clear();
                    tiles.AddRange(coming);
                    coming.Clear();
                    placed.Clear();
                }
            }
            else if (next.Kind == RhumbEventKind.CommandRefused && coming.Count > 0 && next.Number > before && next.Number < after)
            {
                removals.AddRange(placed);
                refused.UnionWith(coming);
                refused.ExceptWith(placed);
                coming.Clear();
                placed.Clear();
                wasRefused = true;
                Log.ErrorFormat("[RHUMB]: the ground stays as it was: {0}. Reduce the meshes of the region", next.Text);
            }
        }

        /// <summary>A tile: its rows run along x, its columns along y.</summary>
        private BodyDesc Described(float[] map, int x, int y, int width, int depth)
        {
            var field = new float[width + 1, depth + 1];
            for (int i = 0; i <= width; i++)
            {
                for (int j = 0; j <= depth; j++)
                {
                    float height = map[Math.Min(y + j, sizeY - 1) * sizeX + Math.Min(x + i, sizeX - 1)];
                    field[i, j] = float.IsNaN(height) || float.IsInfinity(height) ? 0 : height;
                }
            }
            return BodyDesc.Fixed(Shape.Heights(field, 1, 1)).At(x, y, 0).Material(0.8f, 0, 1000);
        }
    }
}
