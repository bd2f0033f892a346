// How to join a scene.

using System;

namespace Rhumb
{
    /// <summary>How to join a scene; plain when made.</summary>
    public sealed class JoinOptions
    {
        private RhumbJoinOptions raw;

        public unsafe JoinOptions()
        {
            RhumbJoinOptions plain;
            RhumbException.Check(Native.rhumb_join_options_init(&plain));
            raw = plain;
        }

        /// <summary>
        /// Options for Unity: left-handed, y up, z forward, metres. Positions, rotations, velocities and forces then go in
        /// and out as they are; up and forward are Vector3.up and Vector3.forward. Angles are radians, where Unity's
        /// inspector shows degrees.
        /// </summary>
        public static JoinOptions ForUnity()
        {
            return new JoinOptions { Coordinates = RhumbCoordinates.Unity };
        }

        /// <summary>Axes and unit of every position, velocity, length and force of this client.</summary>
        public RhumbCoordinates Coordinates
        {
            get { return (RhumbCoordinates)raw.coordinates; }
            set { raw.coordinates = (uint)value; }
        }

        public RhumbJoinCondition Condition
        {
            get { return (RhumbJoinCondition)raw.condition; }
            set { raw.condition = (uint)value; }
        }

        /// <summary>How far any point of a copied body may be off, metres in any coordinates.</summary>
        public double ToleranceInMetres
        {
            get { return raw.tolerance_m; }
            set { raw.tolerance_m = value; }
        }

        /// <summary>
        /// True if the scene is taken by cells, where its server divides it: see Scene.TakeCellsAround. The tolerance is then of the
        /// bodies that are in no cell.
        /// </summary>
        public bool Cells
        {
            get { return raw.cells != 0; }
            set { raw.cells = (byte)(value ? 1 : 0); }
        }

        public RhumbStepping Stepping
        {
            get { return (RhumbStepping)raw.stepping; }
            set { raw.stepping = (uint)value; }
        }

        public uint TicksPerSecond
        {
            get { return raw.ticks_per_second; }
            set { raw.ticks_per_second = value; }
        }

        /// <summary>
        /// Substeps in each tick of a new scene, 4 in plain options. More of them make joints and piles stiffer, and a tick
        /// costlier. Join refuses zero.
        /// </summary>
        public uint Substeps
        {
            get { return raw.substeps; }
            set { raw.substeps = value; }
        }

        /// <summary>Published ticks of a new scene are the multiples of this number; Advance steps to the next one.</summary>
        public uint PublishInterval
        {
            get { return raw.publish_interval; }
            set { raw.publish_interval = value; }
        }

        /// <summary>Gravity of a new scene; the earth's if it is not set.</summary>
        public unsafe Vec3 Gravity
        {
            set
            {
                raw.has_gravity = 1;
                fixed (float* to = raw.gravity)
                {
                    value.CopyTo(to);
                }
            }
        }

        /// <summary>Conditions under which bodies of a new scene fall asleep that have none of their own.</summary>
        public Sleep Sleep
        {
            get { return new Sleep((RhumbSleep)raw.sleep, raw.sleep_speed, raw.sleep_angular_speed, raw.sleep_seconds); }
            set
            {
                raw.sleep = (uint)value.Rule;
                raw.sleep_speed = value.Speed;
                raw.sleep_angular_speed = value.AngularSpeed;
                raw.sleep_seconds = value.Seconds;
            }
        }

        /// <summary>
        /// Free running only: ticks by which the view stays behind the server's clock, zero in plain options. Join refuses a
        /// number that is negative or not finite.
        /// </summary>
        public double DelayTicks
        {
            get { return raw.delay_ticks; }
            set { raw.delay_ticks = value; }
        }

        /// <summary>
        /// Free running only: ticks ahead of the server's clock by which bodies under authority are published, zero in plain
        /// options. With the network's delay and a little more, the server need not predict them.
        /// </summary>
        public double LeadTicks
        {
            get { return raw.lead_ticks; }
            set { raw.lead_ticks = value; }
        }

        /// <summary>Free running only: only whole ticks are shown, for an application with ticks of its own.</summary>
        public bool WholeTicks
        {
            get { return raw.whole_ticks != 0; }
            set { raw.whole_ticks = (byte)(value ? 1 : 0); }
        }

        /// <summary>
        /// Way in which the server's refusals arrive: the next Advance, Wait or Poll throws them, as in plain options, or they
        /// are only events.
        /// </summary>
        public RhumbRefusals Refusals
        {
            get { return (RhumbRefusals)raw.refusals; }
            set { raw.refusals = (uint)value; }
        }

        /// <summary>Free running only: corrections are shown as short glides, and not as jumps; true in plain options.</summary>
        public bool Smooth
        {
            get { return raw.smooth != 0; }
            set { raw.smooth = (byte)(value ? 1 : 0); }
        }

        /// <summary>
        /// How long the client tries to continue over another connection when its own one ends. Zero: it does not try. Null, as
        /// in plain options: what the scene suggests. Join refuses a negative time.
        /// </summary>
        public TimeSpan? ResumeWithin { get; set; }

        internal RhumbJoinOptions Raw()
        {
            RhumbJoinOptions whole = raw;
            whole.has_resume_within = (byte)(ResumeWithin.HasValue ? 1 : 0);
            whole.resume_within_s = ResumeWithin.GetValueOrDefault().TotalSeconds;
            return whole;
        }
    }
}
