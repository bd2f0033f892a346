// A prim of a region: fixed, or physical, or part of a physical link set.

using System.Collections.Generic;
using OpenMetaverse;
using OpenSim.Framework;
using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>
    /// A prim. A change of form, and selection in the editor, make a new body in place of the old one. The children of a
    /// physical link set have no bodies: they are parts of their root's.
    /// </summary>
    internal sealed class RegionPrim : RegionActor
    {
        private readonly List<RegionPrim> children = new List<RegionPrim>();
        private PrimitiveBaseShape shape;
        private RegionPrim root;

        /// <summary>Of a child, in the axes of its root.</summary>
        private Vector3 offset;
        private Quaternion turn;
        private bool isPhysical;
        private bool isSelected;
        private bool isSensor;
        private uint locked;

        internal RegionPrim(RegionScene scene, uint id, string name, PrimitiveBaseShape shape, Vector3 position,
            Quaternion rotation, Vector3 size, bool physical)
            : base(scene, id, name, position, rotation, size)
        {
            this.shape = shape;
            isPhysical = physical;
        }

        internal override bool IsDynamic
        {
            get { return isPhysical && !isSelected && root == null; }
        }

        internal override BodyDesc Describe(bool plain)
        {
            var parts = new List<RegionPrim> { this };
            var places = new List<Vector3> { Vector3.Zero };
            var rotations = new List<Quaternion> { Quaternion.Identity };
            lock (Scene.Gate)
            {
                if (root != null)
                {
                    return null;
                }
                foreach (RegionPrim child in children)
                {
                    parts.Add(child);
                    places.Add(child.offset);
                    rotations.Add(child.turn);
                }
            }
            // Outside the gate: a mesh takes its time.
            List<Solid> solids = parts.ConvertAll(part => part.Form(plain));
            BodyDesc desc = Described(solids.Count == 1 ? solids[0] : Solid.Compound(solids, places, rotations));
            if (IsDynamic && locked != 0)
            {
                desc.LockedAxes(locked);
            }
            return isSensor ? desc.Sensor() : desc;
        }

        private Solid Form(bool plain)
        {
            // The parts of a link set have an inside, as those of a dynamic body must.
            return plain ? Solid.Box(Size) : Solid.OfPrim(Name, shape, Size, isPhysical || root != null, Scene.Mesher);
        }

        public override void link(PhysicsActor obj)
        {
            lock (Scene.Gate)
            {
                if (obj is RegionPrim parent && parent != this && root == null)
                {
                    Quaternion back = Geometry.Inverse(parent.Orientation);
                    offset = Geometry.Rotated(Position - parent.Position, back);
                    turn = Geometry.Product(back, Orientation);
                    root = parent;
                    parent.children.Add(this);
                    Rebuild();
                    parent.Rebuild();
                }
            }
        }

        public override void delink()
        {
            lock (Scene.Gate)
            {
                RegionPrim parent = root;
                if (parent != null)
                {
                    parent.children.Remove(this);
                    root = null;
                    Position = parent.Position + Geometry.Rotated(offset, parent.Orientation);
                    Orientation = Geometry.Product(parent.Orientation, turn);
                    Rebuild();
                    parent.Rebuild();
                }
            }
        }

        /// <summary>Leaves its link set, and frees its children, before it is removed.</summary>
        internal void Unlink()
        {
            lock (Scene.Gate)
            {
                delink();
                foreach (RegionPrim child in children.ToArray())
                {
                    child.delink();
                }
            }
        }

        public override PrimitiveBaseShape Shape
        {
            set { shape = value; RebuildSet(); }
        }

        public override bool Selected
        {
            set
            {
                if (value != isSelected)
                {
                    isSelected = value;
                    if (isPhysical)
                    {
                        Rebuild();
                    }
                }
            }
        }

        public override bool IsPhysical
        {
            get { return isPhysical; }
            set
            {
                if (value != isPhysical)
                {
                    isPhysical = value;
                    Rebuild();
                }
            }
        }

        public override int PhysicsActorType
        {
            get { return (int)ActorTypes.Prim; }
            set { }
        }

        public override void SetVolumeDetect(int param)
        {
            if (isSensor != (param != 0))
            {
                isSensor = param != 0;
                Rebuild();
            }
        }

        /// <summary>A component of zero locks the rotation about that axis.</summary>
        public override void LockAngularMotion(Vector3 axis)
        {
            locked = (axis.X == 0 ? 8u : 0) | (axis.Y == 0 ? 16u : 0) | (axis.Z == 0 ? 32u : 0);
            Rebuild();
        }

        private void RebuildSet()
        {
            Rebuild();
            lock (Scene.Gate)
            {
                root?.Rebuild();
            }
        }
    }
}
