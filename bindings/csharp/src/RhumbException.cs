// Errors as exceptions.

using System;
using System.Collections.Generic;
using System.Text;

namespace Rhumb
{
    /// <summary>A call failed: the code says which kind of error it is, the message says it in a sentence.</summary>
    public class RhumbException : Exception
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

        internal static unsafe string LastError()
        {
            return Utf8.Read(Native.rhumb_last_error());
        }
    }

    /// <summary>A request that the server refused, and that changed nothing.</summary>
    public struct Refusal
    {
        /// <summary>The command's number; null for a request for authority, or of another member.</summary>
        public ulong? Number;

        /// <summary>The body that the request is about; none if that is not known.</summary>
        public Body Body;

        /// <summary>The reason in one or a few words, for programs, such as "unknown body".</summary>
        public string Reason;

        /// <summary>The reason, a sentence.</summary>
        public string Text;
    }

    /// <summary>
    /// The server refused requests of earlier calls, which changed nothing. Advance, Wait and Poll throw it after they have
    /// done their work: the tick is done, the view is computed, and the next call continues. With JoinOptions.Refusals they are
    /// events alone.
    /// </summary>
    public sealed class RhumbRefusedException : RhumbException
    {
        internal RhumbRefusedException(string message, Refusal[] refusals)
            : base(RhumbCode.Refused, message)
        {
            Refusals = refusals;
        }

        /// <summary>At least one, the oldest first.</summary>
        public Refusal[] Refusals { get; }

        /// <summary>Throws unless the call did what it says; with what the server refused, if that is why.</summary>
        internal static void CheckDone(RhumbCode code, RhumbScene scene)
        {
            if (code != RhumbCode.Refused)
            {
                Check(code);
                return;
            }
            string message = LastError();
            throw new RhumbRefusedException(message, Taken(scene));
        }

        private static unsafe Refusal[] Taken(RhumbScene scene)
        {
            var taken = new List<Refusal>();
            while (true)
            {
                RhumbRefusal raw;
                Check(Native.rhumb_scene_poll_refusal(scene, &raw));
                if (raw.exists == 0)
                {
                    return taken.ToArray();
                }
                taken.Add(new Refusal
                {
                    Number = raw.is_command != 0 ? raw.number : (ulong?)null,
                    Body = new Body(raw.body.Item1),
                    Reason = Utf8.Read((byte*)raw.reason),
                    Text = Utf8.Read((byte*)raw.text),
                });
            }
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
