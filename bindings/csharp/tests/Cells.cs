// A member by cells: what it takes, what is denied, what it shows.
//
// Arguments: address and fingerprint of a server that divides its scenes into columns of ten metres.

using System;
using System.Linq;
using Rhumb;
using static Expectation;

internal static class Cells
{
    private static int Main(string[] arguments)
    {
        Func<Connection> connect = () => Connection.Open(arguments[0], Trust.Fingerprint(arguments[1]), null, 30);
        using (Scene owner = connect().Join("around", JoinOptions.ForUnity()))
        using (Scene walker = connect().Join("around", ByCells()))
        {
            Body[] balls = new[] { 5.0f, 95.0f }
                .Select(x => owner.Add(BodyDesc.Fixed(Shape.Ball(0.5f)).At(x, 5, -5)))
                .ToArray();
            owner.Advance();
            Expect(owner.CellGrid == null && owner.Cells.Length == 0, "the owner has the whole scene");
            Expect(walker.CellGrid.Equals(new Vec3(10, 0, 10)), "columns of ten metres");
            walker.TakeCellsAround(new Vec3(5, 0, -5), new CellBand(1, 0.02));
            Arrive(walker);
            Expect(walker.Cells.Single().Cell.Equals(new Cell(0, 0, -1)), "places are along the axes of Unity");
            Expect(walker.Bodies.ToArray().SequenceEqual(new[] { balls[0] }), "the near ball alone");
            Expect(walker.ErrorBound(balls[0]) <= 0.0201f, "within the tolerance of its cell");
            walker.TakeCells(new CellChoice(new Cell(9, 0, -1), 0), new CellChoice(new Cell(0, 1, 0), 0.1));
            Arrive(walker);
            Expect(walker.Bodies.ToArray().SequenceEqual(new[] { balls[1] }), "the other ball alone");
            Expect(walker.ErrorBound(balls[1]) < 0.0011f, "exact states");
            TakenCell denied = walker.Cells.Single(cell => cell.State == RhumbCellState.Denied);
            Expect(denied.Cell.Equals(new Cell(0, 1, 0)) && denied.Text.Contains("no such cell"), denied.Text);
            ExpectError(RhumbCode.Invalid, "a whole scene", () => owner.TakeCells());
            ExpectError(RhumbCode.Invalid, "too many cells", () => walker.TakeCellsAround(new Vec3(0, 0, 0), new CellBand(500, 0.1)));
            ExpectError(RhumbCode.Invalid, "a radius", () => walker.TakeCellsAround(new Vec3(0, 0, 0), new CellBand(-1, 0.1)));
            walker.TakeCells();
            walker.Advance();
            Expect(walker.Removed.ToArray().SequenceEqual(new[] { balls[1] }), "it is shown no more");
        }
        Console.WriteLine("the cells around were shown");
        return 0;
    }

    private static JoinOptions ByCells()
    {
        JoinOptions options = JoinOptions.ForUnity();
        options.Cells = true;
        return options;
    }

    private static void Arrive(Scene walker)
    {
        while (walker.Cells.Any(cell => cell.State == RhumbCellState.Awaited))
        {
            walker.Advance();
        }
    }
}
