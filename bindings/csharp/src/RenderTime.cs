// Moments of a scene.

using System;

namespace Rhumb
{
    /// <summary>A moment of a scene, at a tick or between two ticks.</summary>
    public struct RenderTime : IEquatable<RenderTime>
    {
        /// <summary>The tick at or before the moment.</summary>
        public ulong Tick;

        /// <summary>Part of the step to the next tick, 0 to 1. Zero in the view of an Advance or a Wait.</summary>
        public double Fraction;

        public RenderTime(ulong tick, double fraction)
        {
            Tick = tick;
            Fraction = fraction;
        }

        public bool Equals(RenderTime other)
        {
            return Tick == other.Tick && Fraction.Equals(other.Fraction);
        }

        public override bool Equals(object other)
        {
            return other is RenderTime time && Equals(time);
        }

        public override int GetHashCode()
        {
            return Tick.GetHashCode() ^ Fraction.GetHashCode();
        }

        public override string ToString()
        {
            return FormattableString.Invariant($"tick {Tick + Fraction}");
        }
    }
}
