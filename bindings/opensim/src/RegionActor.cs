// The common part of the prims and avatars of a region.

using System;
using System.Collections.Generic;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>
    /// An actor and what is to be said of it at the next frame. The region sets properties from any thread; the scene takes
    /// them in Simulate. Both hold the scene's gate. Vehicles, hovering, move-to-target and turn-to-target do nothing.
    /// </summary>
    internal abstract class RegionActor : PhysicsActor
    {
        private Vector3 position;
        private Quaternion orientation;
        private Vector3 velocity;
        private Vector3 spin;
        private Vector3 force;
        private Vector3 torque;
        private Vector3 size;
        private float density = 1000, friction = 0.6f, restitution = 0.3f, gravity = 1, buoyancy;
        private int interval;
        private double reported;

        protected RegionActor(RegionScene scene, uint id, string name, Vector3 position, Quaternion orientation, Vector3 size)
        {
            Scene = scene;
            LocalID = id;
            Name = name;
            this.position = position;
            this.orientation = Geometry.IsRotation(orientation) ? orientation : Quaternion.Identity;
            this.size = Geometry.IsFinite(size) ? size : Vector3.Zero;
        }

        protected RegionScene Scene { get; }

        /// <summary>The body, or none while it is to be added.</summary>
        internal Body Body;

        /// <summary>Frames for which the view does not show the region's last command yet.</summary>
        internal uint Muted;

        internal bool Placed;
        internal bool Pushed;
        internal bool Resting;
        internal bool IsDropped;

        /// <summary>True if the server has no body of it, because it refused both of its forms.</summary>
        internal bool IsRefused;

        /// <summary>Contacts by the body that it touches, and whether they changed since the last report.</summary>
        internal readonly Dictionary<Body, KeyValuePair<uint, ContactPoint>> Touching =
            new Dictionary<Body, KeyValuePair<uint, ContactPoint>>();
        internal bool TouchesChanged;

        /// <summary>Impulses and angular impulses of calls, summed.</summary>
        internal Vector3 Impulse;
        internal Vector3 Twist;

        internal bool IsPushing
        {
            get { return force != Vector3.Zero || torque != Vector3.Zero; }
        }

        /// <summary>The centre of mass, in the prim's axes.</summary>
        internal Vector3 Centre;

        protected float Volume;

        internal bool Reports
        {
            get { return interval > 0; }
        }

        /// <summary>The body to add; null for an actor that has none of its own.</summary>
        internal abstract BodyDesc Describe(bool plain);

        /// <summary>Commands for the state that the region set.</summary>
        internal virtual void Speak(List<Command> commands, float seconds)
        {
            lock (Scene.Gate)
            {
                if (Placed)
                {
                    Vector3 at = position + Geometry.Rotated(Centre, orientation);
                    commands.Add(Command.SetPose(Body, at.ToVec3(), orientation.ToQuat()));
                    Muted = Scene.Depth;
                }
                if (IsDynamic)
                {
                    if (Pushed)
                    {
                        commands.Add(Command.SetVelocity(Body, velocity.ToVec3(), spin.ToVec3()));
                        Muted = Scene.Depth;
                    }
                    Vector3 impulse = Impulse + force * seconds, twist = Twist + torque * seconds;
                    if (impulse != Vector3.Zero)
                    {
                        commands.Add(Command.Impulse(Body, impulse.ToVec3()));
                    }
                    if (twist != Vector3.Zero)
                    {
                        commands.Add(Command.TorqueImpulse(Body, twist.ToVec3()));
                    }
                }
                Placed = Pushed = false;
                Impulse = Twist = Vector3.Zero;
            }
        }

        /// <summary>
        /// The state in a view, some seconds after the last one; true if the region has to hear of it. A copy is predicted to
        /// stand still also while the server's body moves, if no other prediction lasts longer; it then jumps from frame to
        /// frame, and the velocity follows from the jump.
        /// </summary>
        internal bool Hear(Vec3 at, Quat rotation, Vec3 linear, Vec3 angular, bool stands, float seconds)
        {
            lock (Scene.Gate)
            {
                return HearInGate(at, rotation, linear, angular, stands, seconds);
            }
        }

        private bool HearInGate(Vec3 at, Quat rotation, Vec3 linear, Vec3 angular, bool stands, float seconds)
        {
            if (Muted > 0)
            {
                Muted--;
                return false;
            }
            if (Placed || Pushed)
            {
                // Set since this frame's commands: the next frame sends it.
                return false;
            }
            Quaternion turned = KeepsOrientation ? orientation : rotation.ToQuaternion();
            Vector3 placed = at.ToVector3() - Geometry.Rotated(Centre, turned);
            bool shifted = placed != position || turned != orientation;
            if (!shifted && stands && Resting)
            {
                return false;
            }
            Vector3 moving = stands ? (placed - position) * (1 / seconds) : linear.ToVector3();
            Vector3 turning = stands ? Vector3.Zero : angular.ToVector3();
            bool changed = shifted || moving != velocity || turning != spin;
            position = placed;
            orientation = turned;
            velocity = moving;
            spin = turning;
            Resting = stands && !shifted;
            return changed;
        }

        /// <summary>The contacts to report in this frame, or null.</summary>
        internal virtual CollisionEventUpdate Report(double now)
        {
            bool due = (now - reported) * 1000 >= interval && Touching.Count > 0;
            if (!Reports || !(due || TouchesChanged))
            {
                return null;
            }
            reported = now;
            TouchesChanged = false;
            var update = new CollisionEventUpdate();
            foreach (KeyValuePair<uint, ContactPoint> touch in Touching.Values)
            {
                update.AddCollider(touch.Key, touch.Value);
            }
            return update;
        }

        /// <summary>Forgets the server's body; a new one is added at the next frame.</summary>
        internal void Forget()
        {
            Body = default(Body);
            ForgetTouches();
            Resting = false;
        }

        internal void ForgetTouches()
        {
            Touching.Clear();
            TouchesChanged = true;
            CollidingGround = false;
        }

        protected void Rebuild()
        {
            Scene.Rebuild(this);
        }

        protected virtual bool KeepsOrientation
        {
            get { return false; }
        }

        internal abstract bool IsDynamic { get; }

        protected BodyDesc Described(Solid solid)
        {
            Centre = solid.Centre;
            Volume = solid.Volume;
            lock (Scene.Gate)
            {
                BodyDesc desc = IsDynamic ? BodyDesc.Dynamic(solid.Shape) : BodyDesc.Fixed(solid.Shape);
                desc.At((position + Geometry.Rotated(Centre, orientation)).ToVec3()).Rotation(orientation.ToQuat());
                desc.Material(Math.Max(friction, 0), Math.Min(Math.Max(restitution, 0), 1), Math.Max(density, 1));
                if (IsDynamic)
                {
                    desc.LinearVelocity(velocity.ToVec3()).AngularVelocity(spin.ToVec3());
                    desc.GravityScale(gravity * (1 - buoyancy));
                }
                Placed = Pushed = false;
                return desc;
            }
        }

        private void Change(ref float field, float value)
        {
            if (field != value && !float.IsNaN(value) && !float.IsInfinity(value))
            {
                field = value;
                Rebuild();
            }
        }

        public override Vector3 Position
        {
            get { return position; }
            set
            {
                lock (Scene.Gate)
                {
                    if (Geometry.IsFinite(value) && value != position)
                    {
                        position = value;
                        Placed = true;
                        Scene.Changed(this);
                    }
                }
            }
        }

        public override Quaternion Orientation
        {
            get { return orientation; }
            set
            {
                lock (Scene.Gate)
                {
                    if (value == orientation || !Geometry.IsRotation(value))
                    {
                        return;
                    }
                    orientation = value;
                    if (!KeepsOrientation)
                    {
                        Placed = true;
                        Scene.Changed(this);
                    }
                }
            }
        }

        public override Vector3 Velocity
        {
            get { return velocity; }
            set { lock (Scene.Gate) { Push(value, spin); } }
        }

        public override Vector3 RotationalVelocity
        {
            get { return spin; }
            set { lock (Scene.Gate) { Push(velocity, value); } }
        }

        protected void Push(Vector3 linear, Vector3 angular)
        {
            lock (Scene.Gate)
            {
                if (Geometry.IsFinite(linear) && Geometry.IsFinite(angular) && (linear != velocity || angular != spin))
                {
                    velocity = linear;
                    spin = angular;
                    Pushed = true;
                    Scene.Changed(this);
                }
            }
        }

        public override Vector3 Size
        {
            get { return size; }
            set
            {
                if (Geometry.IsFinite(value) && value != size)
                {
                    size = value;
                    Rebuild();
                }
            }
        }

        public override float Density
        {
            get { return density; }
            set { Change(ref density, value); }
        }

        public override float Friction
        {
            get { return friction; }
            set { Change(ref friction, value); }
        }

        public override float Restitution
        {
            get { return restitution; }
            set { Change(ref restitution, value); }
        }

        public override float GravModifier
        {
            get { return gravity; }
            set { Change(ref gravity, value); }
        }

        public override float Buoyancy
        {
            get { return buoyancy; }
            set { Change(ref buoyancy, value); }
        }

        public override float Mass
        {
            get { return Volume * density; }
        }

        public override Vector3 Force
        {
            get { return force; }
            set { lock (Scene.Gate) { force = Geometry.IsFinite(value) ? value : force; Scene.Changed(this); } }
        }

        public override Vector3 Torque
        {
            get { return torque; }
            set { lock (Scene.Gate) { torque = Geometry.IsFinite(value) ? value : torque; Scene.Changed(this); } }
        }

        /// <summary>An impulse: N s.</summary>
        public override void AddForce(Vector3 impulse, bool pushforce)
        {
            if (Geometry.IsFinite(impulse))
            {
                lock (Scene.Gate)
                {
                    Impulse += impulse;
                    Scene.Changed(this);
                }
            }
        }

        public override void AddAngularForce(Vector3 impulse, bool pushforce)
        {
            if (Geometry.IsFinite(impulse))
            {
                lock (Scene.Gate)
                {
                    Twist += impulse;
                    Scene.Changed(this);
                }
            }
        }

        public override void SetMomentum(Vector3 momentum)
        {
            lock (Scene.Gate)
            {
                Push(momentum, spin);
            }
        }

        public override void SubscribeEvents(int ms)
        {
            interval = Math.Max(ms, 1);
            Scene.ChangeEvents(this);
        }

        public override void UnSubscribeEvents()
        {
            interval = 0;
            Scene.ChangeEvents(this);
        }

        public override bool SubscribedEvents()
        {
            return Reports;
        }

        public override bool IsColliding
        {
            get { return Touching.Count > 0; }
            set { }
        }

        public override bool CollidingGround { get; set; }

        public override bool CollidingObj
        {
            get { return Touching.Count > 0 && !CollidingGround; }
            set { }
        }

        public override bool Stopped
        {
            get { return Resting; }
        }

        public override Vector3 GeometricCenter
        {
            get { return position; }
        }

        public override Vector3 CenterOfMass
        {
            get { return position + Geometry.Rotated(Centre, orientation); }
        }

        public override Vector3 Acceleration { get; set; }

        public override float CollisionScore { get; set; }

        public override bool Flying { get; set; }

        public override bool SetAlwaysRun { get; set; }

        public override bool ThrottleUpdates { get; set; }

        public override bool Kinematic { get; set; }

        public override bool PIDActive { get; set; }

        public override bool APIDActive { set { } }

        public override int VehicleType { get; set; }

        public override bool Grabbed { set { } }

        public override bool Selected { set { } }

        public override bool FloatOnWater { set { } }

        public override PrimitiveBaseShape Shape { set { } }

        public override Vector3 PIDTarget { set { } }

        public override float PIDTau { set { } }

        public override bool PIDHoverActive { set { } }

        public override float PIDHoverHeight { set { } }

        public override PIDHoverType PIDHoverType { set { } }

        public override float PIDHoverTau { set { } }

        public override Quaternion APIDTarget { set { } }

        public override float APIDStrength { set { } }

        public override float APIDDamping { set { } }

        public override void VehicleFloatParam(int param, float value) { }

        public override void VehicleVectorParam(int param, Vector3 value) { }

        public override void VehicleRotationParam(int param, Quaternion rotation) { }

        public override void VehicleFlags(int param, bool remove) { }

        public override void CrossingFailure() { }

        public override void LockAngularMotion(Vector3 axis) { }

        public override void SetVolumeDetect(int param) { }

        public override void link(PhysicsActor obj) { }

        public override void delink() { }
    }
}
