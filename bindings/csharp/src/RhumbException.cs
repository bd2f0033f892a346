// Errors as exceptions.

using System;
using System.Text;

namespace Rhumb
{
    /// <summary>A call failed: the code says which kind of error it is, the message says it in a sentence.</summary>
    public sealed class RhumbException : Exception
    {
        public RhumbException(RhumbCode code, string message)
            : base(message)
        {
            Code = code;
        }

        public RhumbCode Code { get; }

        /// <summary>Throws unless the call did what it says.</summary>
        internal static void Check(RhumbCode code)
        {
            if (code != RhumbCode.Ok)
            {
                throw new RhumbException(code, LastError());
            }
        }

        private static unsafe string LastError()
        {
            return Utf8.Read(Native.rhumb_last_error());
        }
    }

    /// <summary>Texts of C: UTF-8 that ends with a zero byte.</summary>
    internal static class Utf8
    {
        internal static byte[] Bytes(string text)
        {
            if (text == null)
            {
                return null;
            }
            if (text.IndexOf('\0') >= 0)
            {
                throw new RhumbException(RhumbCode.Invalid, "a text must not contain a zero character");
            }
            return Encoding.UTF8.GetBytes(text + "\0");
        }

        internal static unsafe string Read(byte* text)
        {
            int length = 0;
            while (text[length] != 0)
            {
                length++;
            }
            return Encoding.UTF8.GetString(text, length);
        }
    }
}
