// Cells of a scene: those that a client takes, and their states.

using System;

namespace Rhumb
{
    /// <summary>A cell by its places along the axes: from place times edge to place + 1 times edge.</summary>
    public struct Cell : IEquatable<Cell>
    {
        public int X;
        public int Y;
        public int Z;

        /// <summary>Along an axis that is not divided, the place is 0.</summary>
        public Cell(int x, int y, int z)
        {
            X = x;
            Y = y;
            Z = z;
        }

        public bool Equals(Cell other)
        {
            return X == other.X && Y == other.Y && Z == other.Z;
        }

        public override bool Equals(object other)
        {
            return other is Cell cell && Equals(cell);
        }

        public override int GetHashCode()
        {
            return X ^ (Y << 8) ^ (Z << 16);
        }

        public override string ToString()
        {
            return FormattableString.Invariant($"cell {X} {Y} {Z}");
        }
    }

    /// <summary>All cells within a distance of a point, and the tolerance of their streams.</summary>
    public struct CellBand
    {
        /// <summary>From the point to the nearest point of a cell, units of length.</summary>
        public float Radius;

        /// <summary>Metres in any coordinates, 0.001 to 10; 0: exact states.</summary>
        public double ToleranceInMetres;

        public CellBand(float radius, double toleranceInMetres)
        {
            Radius = radius;
            ToleranceInMetres = toleranceInMetres;
        }
    }

    /// <summary>A cell to take, and the tolerance of its stream.</summary>
    public struct CellChoice
    {
        public Cell Cell;

        /// <summary>Metres in any coordinates, 0.001 to 10; 0: exact states.</summary>
        public double ToleranceInMetres;

        public CellChoice(Cell cell, double toleranceInMetres)
        {
            Cell = cell;
            ToleranceInMetres = toleranceInMetres;
        }
    }

    /// <summary>A cell that is taken.</summary>
    public struct TakenCell
    {
        public Cell Cell;
        public RhumbCellState State;

        /// <summary>Why it is denied; otherwise empty.</summary>
        public string Text;
    }

    public sealed partial class Scene
    {
        /// <summary>Cells that a client takes at most.</summary>
        private const int CellsMax = 256;

        /// <summary>
        /// Edges of the scene's cells, units of length; 0 along an axis that is not divided. Null for a scene that is not divided,
        /// and for one that was joined without JoinOptions.Cells.
        /// </summary>
        public unsafe Vec3? CellGrid
        {
            get
            {
                Vec3 edges;
                RhumbException.Check(Native.rhumb_scene_cell_grid(Raw(), (float*)&edges));
                return edges.Equals(default(Vec3)) ? (Vec3?)null : edges;
            }
        }

        /// <summary>The cells that are taken, and the state of each.</summary>
        public unsafe TakenCell[] Cells
        {
            get
            {
                var raw = new RhumbTakenCell[CellsMax];
                UIntPtr count;
                fixed (RhumbTakenCell* to = raw)
                {
                    RhumbException.Check(Native.rhumb_scene_cells(Raw(), to, (UIntPtr)raw.Length, &count));
                    var cells = new TakenCell[(int)count];
                    for (int i = 0; i < cells.Length; i++)
                    {
                        RhumbTakenCell* cell = to + i;
                        cells[i] = new TakenCell
                        {
                            Cell = new Cell(cell->places[0], cell->places[1], cell->places[2]),
                            State = (RhumbCellState)cell->state,
                            Text = Utf8.Read((byte*)cell->text),
                        };
                    }
                    return cells;
                }
            }
        }

        /// <summary>
        /// Takes the cells around a point and no others, each by the nearest band that reaches it. Call it as the point moves:
        /// what is taken already costs nothing. It does not wait. A radius of 0 takes the cell that has the point.
        ///
        /// The arrays have the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is
        /// more than half of the shortest edge, such as floors. A body that leaves the cells is in Removed, and no event tells of
        /// it. A scene that is not divided, more than 256 cells, a point that is in no world, and a radius that is negative or not
        /// finite are errors of the call; then all stays as it was.
        /// </summary>
        public unsafe void TakeCellsAround(Vec3 point, params CellBand[] bands)
        {
            if (bands == null)
            {
                throw new RhumbException(RhumbCode.Null, "bands must not be null");
            }
            var raw = new RhumbCellBand[bands.Length];
            for (int i = 0; i < raw.Length; i++)
            {
                raw[i].radius = bands[i].Radius;
                raw[i].tolerance_m = bands[i].ToleranceInMetres;
            }
            fixed (RhumbCellBand* from = raw)
            {
                RhumbException.Check(
                    Native.rhumb_scene_take_cells_around(Raw(), (float*)&point, from, (UIntPtr)raw.Length));
            }
        }

        /// <summary>Takes these cells and no others, as TakeCellsAround.</summary>
        public unsafe void TakeCells(params CellChoice[] choices)
        {
            if (choices == null)
            {
                throw new RhumbException(RhumbCode.Null, "choices must not be null");
            }
            var raw = new RhumbCellChoice[choices.Length];
            fixed (RhumbCellChoice* from = raw)
            {
                for (int i = 0; i < raw.Length; i++)
                {
                    Cell cell = choices[i].Cell;
                    from[i].places[0] = cell.X;
                    from[i].places[1] = cell.Y;
                    from[i].places[2] = cell.Z;
                    from[i].tolerance_m = choices[i].ToleranceInMetres;
                }
                RhumbException.Check(Native.rhumb_scene_take_cells(Raw(), from, (UIntPtr)raw.Length));
            }
        }
    }
}
