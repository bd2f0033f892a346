// OpenSimulator's entry: the physics engine named Rhumb.

using OpenSim.Region.Physics.Manager;

namespace Rhumb.Plugin
{
    /// <summary>Found by OpenSimulator in bin/Physics; chosen with "physics = Rhumb" in [Startup].</summary>
    public sealed class RhumbPlugin : IPhysicsPlugin
    {
        public bool Init()
        {
            return true;
        }

        public string GetName()
        {
            return "Rhumb";
        }

        /// <summary>A scene of its own for each region of the process.</summary>
        public PhysicsScene GetScene(string sceneIdentifier)
        {
            return new RegionScene(sceneIdentifier);
        }

        public void Dispose()
        {
        }
    }
}
