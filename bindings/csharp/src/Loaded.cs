// Robots and scenes from files.

using System;
using System.Collections.Generic;

namespace Rhumb
{
    /// <summary>Fixes the root of a robot, or leaves it free.</summary>
    public enum FileBase : uint
    {
        AsFile,
        Fixed,
        Free,
    }

    /// <summary>Lets parts of one robot touch each other, or not.</summary>
    public enum OwnContacts : uint
    {
        /// <summary>As other programs read the file.</summary>
        AsFile,

        /// <summary>All that no joint connects.</summary>
        All,
    }

    /// <summary>How a file is read, and where its bodies are added.</summary>
    public sealed class LoadOptions
    {
        /// <summary>All as in the file, at the origin.</summary>
        public unsafe LoadOptions()
        {
            RhumbLoadOptions plain;
            RhumbException.Check(Native.rhumb_load_options_init(&plain));
            Position = new Vec3(plain.position[0], plain.position[1], plain.position[2]);
            Rotation = new Quat(plain.rotation[0], plain.rotation[1], plain.rotation[2], plain.rotation[3]);
            Base = (FileBase)plain.@base;
            OwnContacts = (OwnContacts)plain.own_contacts;
            Density = plain.density;
            Group = plain.group;
        }

        /// <summary>Where the root or the world of the file begins.</summary>
        public Vec3 Position { get; set; }

        /// <summary>The file's axes, its up upward, to the world.</summary>
        public Quat Rotation { get; set; }

        public FileBase Base { get; set; }

        public OwnContacts OwnContacts { get; set; }

        /// <summary>Folders that are searched for package:// names.</summary>
        public List<string> Packages { get; } = new List<string>();

        /// <summary>Of bodies whose file gives shapes but no mass, kg/m³.</summary>
        public float Density { get; set; }

        /// <summary>Number of the collision group, below 32, that the parts of a robot share.</summary>
        public uint Group { get; set; }

        /// <summary>Number of the first joint; null: the least that are free.</summary>
        public uint? FirstJoint { get; set; }

        internal unsafe RhumbLoadOptions Raw(byte* packages)
        {
            var raw = new RhumbLoadOptions
            {
                @base = (uint)Base,
                own_contacts = (uint)OwnContacts,
                packages = packages,
                density = Density,
                group = Group,
                has_first_joint = (byte)(FirstJoint.HasValue ? 1 : 0),
                first_joint = FirstJoint ?? 0,
            };
            Position.CopyTo(raw.position);
            Rotation.CopyTo(raw.rotation);
            return raw;
        }
    }

    /// <summary>Where the file's frame of a body is, from its centre of mass and in its axes.</summary>
    public struct LoadedFrame
    {
        public Vec3 Position;
        public Quat Rotation;
    }

    /// <summary>A file that was added. A name that the file has twice, or not at all, has a number.</summary>
    public sealed class Loaded
    {
        internal unsafe Loaded(ulong id)
        {
            var handle = new RhumbLoaded { id = id };
            RhumbLoadedCounts counts;
            RhumbException.Check(Native.rhumb_loaded_counts(handle, &counts));
            for (ulong place = 0; place < (ulong)counts.bodies; place++)
            {
                RhumbLoadedBody body;
                RhumbException.Check(Native.rhumb_loaded_body(handle, (UIntPtr)place, &body));
                string name = Utf8.Read((byte*)body.name);
                Bodies[name] = new Body(body.body.Item1);
                Frames[name] = new LoadedFrame
                {
                    Position = new Vec3(body.frame_position[0], body.frame_position[1], body.frame_position[2]),
                    Rotation = new Quat(
                        body.frame_rotation[0], body.frame_rotation[1], body.frame_rotation[2], body.frame_rotation[3]),
                };
            }
            for (ulong place = 0; place < (ulong)counts.joints; place++)
            {
                RhumbLoadedJoint joint;
                RhumbException.Check(Native.rhumb_loaded_joint(handle, (UIntPtr)place, &joint));
                Joints[Utf8.Read((byte*)joint.name)] = joint.joint;
            }
            for (ulong place = 0; place < (ulong)counts.left_out; place++)
            {
                RhumbNote note;
                RhumbException.Check(Native.rhumb_loaded_note(handle, (UIntPtr)place, &note));
                LeftOut.Add(Utf8.Read((byte*)note.text));
            }
        }

        public Dictionary<string, Body> Bodies { get; } = new Dictionary<string, Body>();

        public Dictionary<string, LoadedFrame> Frames { get; } = new Dictionary<string, LoadedFrame>();

        /// <summary>Numbers of joints.</summary>
        public Dictionary<string, uint> Joints { get; } = new Dictionary<string, uint>();

        /// <summary>A sentence for each thing that the file says and the scene has not, or has by something near to it.</summary>
        public List<string> LeftOut { get; } = new List<string>();
    }
}
