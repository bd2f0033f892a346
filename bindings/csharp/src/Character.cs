// Characters.

namespace Rhumb
{
    /// <summary>
    /// A character, for Scene.SetCharacter: a kinematic body that walks by its velocity, as far as the world lets it, and
    /// falls. Each method changes it and returns it.
    /// </summary>
    public sealed class Character
    {
        private RhumbCharacter raw;

        /// <summary>
        /// Of 80 kg. It climbs slopes of up to 45 degrees, slides down steeper ones, climbs no steps, and follows the ground
        /// down by 0.2 m. The coordinates are those of its scene.
        /// </summary>
        public unsafe Character(RhumbCoordinates coordinates = RhumbCoordinates.Rhumb)
        {
            RhumbCharacter plain;
            RhumbException.Check(Native.rhumb_character_init(&plain, (uint)coordinates));
            raw = plain;
        }

        /// <summary>Direction away from the ground, instead of the one against gravity; of unit length.</summary>
        public unsafe Character Up(Vec3 direction)
        {
            raw.has_up = 1;
            fixed (float* to = raw.up)
            {
                direction.CopyTo(to);
            }
            return this;
        }

        /// <summary>The gap that it keeps to its surroundings, units of length.</summary>
        public Character Offset(float gap)
        {
            raw.offset = gap;
            return this;
        }

        /// <summary>
        /// The steepest slope that it climbs, and the one from which on it slides down, radians from level ground.
        /// </summary>
        public Character Slope(float climbAngle, float slideAngle)
        {
            raw.climb_angle = climbAngle;
            raw.slide_angle = slideAngle;
            return this;
        }

        /// <summary>The mass with which it pushes dynamic bodies, kilograms; at zero it pushes none.</summary>
        public Character Mass(float kilograms)
        {
            raw.mass = kilograms;
            return this;
        }

        /// <summary>The greatest height of a step that it climbs, and the free width that it needs there.</summary>
        public Character Step(float height, float width)
        {
            raw.has_step = 1;
            raw.step_height = height;
            raw.step_width = width;
            return this;
        }

        /// <summary>It also climbs onto dynamic bodies; otherwise it pushes them.</summary>
        public Character OntoDynamic()
        {
            raw.steps_onto_dynamic = 1;
            return this;
        }

        /// <summary>The greatest drop of the ground that it follows without a fall; null: it follows none.</summary>
        public Character Snap(float? drop)
        {
            raw.has_snap = (byte)(drop.HasValue ? 1 : 0);
            raw.snap = drop.GetValueOrDefault();
            return this;
        }

        internal RhumbCharacter Raw()
        {
            return raw;
        }
    }
}
