// Expectations of the test programs: one that does not hold ends the program.

using System;
using Rhumb;

internal static class Expectation
{
    internal static void Expect(bool holds, string what)
    {
        if (!holds)
        {
            Console.Error.WriteLine("does not hold: " + what);
            Environment.Exit(1);
        }
    }

    internal static void ExpectError(RhumbCode code, string what, Action call)
    {
        try
        {
            call();
        }
        catch (RhumbException error)
        {
            Expect(error.Code == code && error.Message.Length > 0, what + ": " + error.Code + ": " + error.Message);
            return;
        }
        Expect(false, what + " is an error");
    }
}
