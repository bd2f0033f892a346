// Settings of a region: the section [Rhumb] of OpenSim.ini.

using System;
using System.Globalization;
using System.IO;
using Nini.Config;

namespace Rhumb.Plugin
{
    /// <summary>What [Rhumb] says. A value that cannot be used is an exception that names key, value and what is needed.</summary>
    internal sealed class RegionSettings
    {
        private readonly IConfig section;

        internal RegionSettings(IConfigSource source, string regionName)
        {
            section = source.Configs["Rhumb"];
            if (section == null)
            {
                throw new ArgumentException("OpenSim.ini has no section [Rhumb]: add it, with Address and Fingerprint");
            }
            Address = section.GetString("Address", "");
            if (Address.Length == 0)
            {
                throw Wrong("Address", Address, "the server's host:port, which rhumb-server prints");
            }
            string fingerprint = section.GetString("Fingerprint", ""), roots = section.GetString("Roots", "");
            if ((fingerprint.Length == 0) == (roots.Length == 0))
            {
                throw Wrong("Fingerprint", fingerprint,
                    "the SHA-256 that rhumb-server prints; or Roots, the path of a PEM file; not both");
            }
            if (roots.Length == 0 && (fingerprint.Length != 64 || !IsHex(fingerprint)))
            {
                throw Wrong("Fingerprint", fingerprint, "the 64 hexadecimal digits that rhumb-server prints");
            }
            if (roots.Length != 0 && !HasCertificate(roots, out string reason))
            {
                throw Wrong("Roots", roots, "the path of a PEM file with certificates; " + reason);
            }
            Trust = roots.Length == 0 ? Trust.Fingerprint(fingerprint) : Trust.Roots(roots);
            string token = section.GetString("Token", "");
            Token = token.Length == 0 ? null : token;
            Scene = section.GetString("Scene", "opensim/" + regionName);
            Tolerance = Number("Tolerance", 0.02, 0.001, 10);
            Timeout = Number("Timeout", 2, 0.05, 60);
            RetryAfter = Number("RetryAfter", 5, 0.05, 3600);
            Gravity = (float)Number("Gravity", -9.80665, -1000, 1000);
            TicksPerSecond = (uint)Whole("TicksPerSecond", 56, 10, 1000);
            PublishInterval = (uint)Whole("PublishInterval", 5, 1, 60);
            PipelineDepth = (uint)Whole("PipelineDepth", 1, 0, 8);
        }

        internal string Address { get; }

        internal Trust Trust { get; }

        /// <summary>Null without a token.</summary>
        internal string Token { get; }

        internal string Scene { get; }

        /// <summary>Metres.</summary>
        internal double Tolerance { get; }

        /// <summary>Seconds for which a call waits for the server.</summary>
        internal double Timeout { get; }

        /// <summary>Seconds between two attempts to connect.</summary>
        internal double RetryAfter { get; }

        /// <summary>m/s², upwards.</summary>
        internal float Gravity { get; }

        internal uint TicksPerSecond { get; }

        internal uint PublishInterval { get; }

        /// <summary>Frames by which the region shows the scene later; with 0, Simulate waits for the step.</summary>
        internal uint PipelineDepth { get; }

        /// <summary>Seconds of one Advance.</summary>
        internal double Frame
        {
            get { return (double)PublishInterval / TicksPerSecond; }
        }

        private static bool IsHex(string text)
        {
            foreach (char digit in text)
            {
                if (!Uri.IsHexDigit(digit))
                {
                    return false;
                }
            }
            return true;
        }

        private static bool HasCertificate(string path, out string reason)
        {
            try
            {
                reason = "it holds none";
                return File.ReadAllText(path).Contains("-----BEGIN CERTIFICATE-----");
            }
            catch (Exception error) when (error is IOException || error is UnauthorizedAccessException
                || error is ArgumentException || error is NotSupportedException)
            {
                reason = error.Message;
                return false;
            }
        }

        private double Number(string key, double plain, double least, double most)
        {
            string text = section.GetString(key, plain.ToString(CultureInfo.InvariantCulture));
            if (!double.TryParse(text, NumberStyles.Float, CultureInfo.InvariantCulture, out double value)
                || !(value >= least && value <= most))
            {
                throw Wrong(key, text, FormattableString.Invariant($"a number from {least} to {most}"));
            }
            return value;
        }

        private int Whole(string key, int plain, int least, int most)
        {
            double value = Number(key, plain, least, most);
            if (value != Math.Floor(value))
            {
                throw Wrong(key, section.GetString(key, ""), "a whole number");
            }
            return (int)value;
        }

        private static ArgumentException Wrong(string key, string value, string needed)
        {
            return new ArgumentException("[Rhumb] " + key + " = \"" + value + "\" in OpenSim.ini: it must be " + needed);
        }
    }
}
