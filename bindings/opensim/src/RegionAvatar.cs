// An avatar of a region: an upright capsule that a motor drives.

using System;
using System.Collections.Generic;
using OpenMetaverse;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>
    /// The server keeps the wanted velocity by the motors of a joint to an anchor without a shape, so a walk needs one
    /// command and not one for each frame. Walking leaves the vertical axis to gravity; flying drives it too.
    /// </summary>
    internal sealed class RegionAvatar : RegionActor
    {
        /// <summary>1/s: friction with the ground costs a walker some 0.06 m/s.</summary>
        private const float Damping = 100;

        /// <summary>m/s²: more than a slope of any walkable steepness needs, and less than moves a building.</summary>
        private const float Strength = 60;
        private const float WalkFactor = 0.77f, RunFactor = 1.25f;
        private const uint NoRotation = 8 | 16 | 32;

        private Vector3 wanted;
        private bool isFlying;
        private bool isRunning;
        private bool drives;

        internal RegionAvatar(
            RegionScene scene, uint id, string name, Vector3 position, Vector3 velocity, Vector3 size, bool flying)
            : base(scene, id, name, position, Quaternion.Identity, size)
        {
            isFlying = flying;
            wanted = Geometry.IsFinite(velocity) ? velocity : Vector3.Zero;
            SubscribeEvents(1);
        }

        /// <summary>The number of the joint that drives it; zero before it has one.</summary>
        internal uint Joint;

        internal override bool IsDynamic
        {
            get { return true; }
        }

        protected override bool KeepsOrientation
        {
            get { return true; }
        }

        internal override BodyDesc Describe(bool plain)
        {
            drives = true;
            Joint = 0;
            return Described(Solid.Capsule(Size)).Rotation(Quat.Identity).LockedAxes(NoRotation);
        }

        internal override void Speak(List<Command> commands, float seconds)
        {
            base.Speak(commands, seconds);
            bool changed;
            lock (Scene.Gate)
            {
                changed = drives;
                drives = false;
            }
            if (changed)
            {
                Scene.Drive(this);
            }
        }

        internal JointDesc Motors(Body anchor)
        {
            Vector3 wanted;
            lock (Scene.Gate)
            {
                wanted = this.wanted;
            }
            float pace = isFlying ? 1 : isRunning ? RunFactor : WalkFactor, force = Mass * Strength;
            var joint = new JointDesc(RhumbJointKind.Generic, anchor, Body);
            joint.Motor(0, 0, wanted.X * pace, 0, Damping, force).Motor(1, 0, wanted.Y * pace, 0, Damping, force);
            if (isFlying)
            {
                // The lack of velocity at which the motor bears the weight.
                joint.Motor(2, 0, wanted.Z - Scene.Gravity / Damping, 0, Damping, force);
            }
            return joint;
        }

        internal override CollisionEventUpdate Report(double now)
        {
            // The region animates its avatars by this report, also by an empty one.
            TouchesChanged = true;
            return base.Report(now);
        }

        /// <summary>The velocity that the region wants; the present one is read from the base.</summary>
        public override Vector3 Velocity
        {
            get { return base.Velocity; }
            set
            {
                if (!Geometry.IsFinite(value) || value == wanted)
                {
                    return;
                }
                if (!isFlying && value.Z > 0 && wanted.Z <= 0 && IsColliding)
                {
                    // A jump.
                    AddForce(new Vector3(0, 0, Mass * value.Z), true);
                }
                lock (Scene.Gate)
                {
                    wanted = value;
                    Redrive();
                }
            }
        }

        public override bool Flying
        {
            get { return isFlying; }
            set { isFlying = value; Redrive(); }
        }

        public override bool SetAlwaysRun
        {
            get { return isRunning; }
            set { isRunning = value; Redrive(); }
        }

        public override void SetMomentum(Vector3 momentum)
        {
            Push(momentum, Vector3.Zero);
        }

        public override bool IsPhysical
        {
            get { return true; }
            set { }
        }

        public override int PhysicsActorType
        {
            get { return (int)ActorTypes.Agent; }
            set { }
        }

        private void Redrive()
        {
            drives = true;
            Scene.Changed(this);
        }
    }
}
