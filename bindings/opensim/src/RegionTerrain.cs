// The ground of a region: height fields of at most 256 metres a side.

using System;
using System.Collections.Generic;

namespace Rhumb.Plugin
{
    /// <summary>
    /// Heights of one post a metre. The last row and column are repeated, so that the ground reaches the region's border.
    /// </summary>
    internal sealed class RegionTerrain
    {
        private const int Tile = 256;
        private readonly int sizeX;
        private readonly int sizeY;
        private readonly List<Body> tiles = new List<Body>();
        private float[] heights;
        private bool isNew;

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
            heights = map == null ? null : (float[])map.Clone();
            isNew = true;
        }

        internal void Forget()
        {
            tiles.Clear();
            isNew = heights != null;
        }

        /// <summary>Replaces the ground on the server, if it changed.</summary>
        internal void Tell(Scene scene, List<Command> commands)
        {
            if (!isNew)
            {
                return;
            }
            isNew = false;
            foreach (Body tile in tiles)
            {
                commands.Add(Command.RemoveBody(tile));
            }
            tiles.Clear();
            if (heights == null)
            {
                return;
            }
            var descs = new List<BodyDesc>();
            for (int x = 0; x < sizeX; x += Tile)
            {
                for (int y = 0; y < sizeY; y += Tile)
                {
                    descs.Add(Described(x, y, Math.Min(Tile, sizeX - x), Math.Min(Tile, sizeY - y)));
                }
            }
            tiles.AddRange(scene.Add(descs.ToArray()));
        }

        /// <summary>
        /// In these coordinates a field's rows run against x and its columns against y, so both are filled from the far end.
        /// </summary>
        private BodyDesc Described(int x, int y, int width, int depth)
        {
            var field = new float[width + 1, depth + 1];
            for (int i = 0; i <= width; i++)
            {
                for (int j = 0; j <= depth; j++)
                {
                    float height = heights[Math.Min(y + j, sizeY - 1) * sizeX + Math.Min(x + i, sizeX - 1)];
                    field[width - i, depth - j] = float.IsNaN(height) || float.IsInfinity(height) ? 0 : height;
                }
            }
            return BodyDesc.Fixed(Shape.Heights(field, 1, 1)).At(x, y + depth, 0).Material(0.8f, 0, 1000);
        }
    }
}
