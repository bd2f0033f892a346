// The connection of a region to its server, made and made again.

using System;
using System.Collections.Generic;
using System.Threading.Tasks;
using log4net;

namespace Rhumb.Plugin
{
    /// <summary>
    /// A scene of the server while there is one. Connecting and waiting for a slow server happen in a task beside the
    /// region's frames, which continue without physics.
    /// </summary>
    internal sealed class RegionLink : IDisposable
    {
        private static readonly ILog Log = LogManager.GetLogger(typeof(RegionLink));

        private readonly RegionSettings settings;
        private Scene scene;
        private Task<Scene> task;
        private bool isFresh;
        private string refusal;
        private DateTime notBefore = DateTime.MinValue;
        private volatile bool isDisposed;

        internal RegionLink(RegionSettings settings)
        {
            this.settings = settings;
            task = Task.Run(() => Join());
        }

        /// <summary>The scene, or null while there is none. Never waits; fresh if it holds nothing of the region yet.</summary>
        internal Scene Take(out bool fresh)
        {
            fresh = false;
            if (isDisposed)
            {
                return null;
            }
            if (task != null && task.IsCompleted)
            {
                Settle();
            }
            if (task == null && scene == null && DateTime.UtcNow >= notBefore)
            {
                task = Task.Run(() => Join());
            }
            if (task != null || scene == null)
            {
                return null;
            }
            fresh = isFresh;
            isFresh = false;
            return scene;
        }

        /// <summary>True if one call was wrong or denied, and the scene continues.</summary>
        internal static bool IsOfOneCall(RhumbException error)
        {
            return error.Code == RhumbCode.Invalid || error.Code == RhumbCode.Denied;
        }

        /// <summary>Queues commands; if one is wrong, it alone is left out.</summary>
        internal static void Send(Scene scene, List<Command> commands)
        {
            if (commands.Count == 0)
            {
                return;
            }
            try
            {
                scene.Send(commands.ToArray());
            }
            catch (RhumbException error) when (IsOfOneCall(error) && commands.Count > 1)
            {
                foreach (Command command in commands)
                {
                    Send(scene, new List<Command> { command });
                }
            }
            catch (RhumbException error) when (IsOfOneCall(error))
            {
                Log.WarnFormat("[RHUMB]: a command is left out: {0}", error.Message);
            }
        }

        /// <summary>What a call on the scene threw: a slow server is waited for, a lost one is connected to again.</summary>
        internal void Failed(RhumbException error)
        {
            Scene failed = scene;
            if (error.Code == RhumbCode.Timeout)
            {
                Log.WarnFormat("[RHUMB]: {0} did not answer for {1} s; the region continues without physics until it does",
                    settings.Address, settings.Timeout);
                task = Task.Run(() => Await(failed));
                return;
            }
            Log.ErrorFormat("[RHUMB]: lost {0}: {1}. Physics stands still: see that rhumb-server runs there; the region "
                + "tries again every {2} s and adds its bodies anew", settings.Address, error.Message, settings.RetryAfter);
            scene = null;
            failed.Dispose();
            Pause();
        }

        /// <summary>Deletes the scene, so that the server keeps nothing of a region that has ended.</summary>
        public void Dispose()
        {
            isDisposed = true;
            if (task != null)
            {
                try
                {
                    scene = task.Result;
                }
                catch (AggregateException error)
                {
                    Log.WarnFormat("[RHUMB]: {0} at the end: {1}", settings.Address, error.InnerException.Message);
                    scene?.Dispose();
                    scene = null;
                }
                task = null;
            }
            if (scene == null)
            {
                return;
            }
            try
            {
                scene.Delete();
            }
            catch (RhumbException error)
            {
                Log.WarnFormat("[RHUMB]: {0} did not delete scene {1}: {2}", settings.Address, settings.Scene, error.Message);
            }
            scene.Dispose();
            scene = null;
        }

        /// <summary>Takes the end of the task over.</summary>
        private void Settle()
        {
            Task<Scene> ended = task;
            task = null;
            if (!ended.IsFaulted)
            {
                isFresh |= scene == null;
                scene = ended.Result;
                refusal = null;
                return;
            }
            Exception error = ended.Exception.InnerException;
            if (scene != null)
            {
                scene.Dispose();
                scene = null;
            }
            Pause();
            // Once for each reason: an attempt every few seconds would fill the log.
            if (refusal != error.Message)
            {
                refusal = error.Message;
                Log.ErrorFormat("[RHUMB]: no physics from {0}: {1}. Start rhumb-server there, or change [Rhumb] Address and "
                    + "Fingerprint in OpenSim.ini; the region tries again every {2} s", settings.Address, refusal,
                    settings.RetryAfter);
            }
        }

        private void Pause()
        {
            notBefore = DateTime.UtcNow.AddSeconds(settings.RetryAfter);
        }

        /// <summary>A new scene of the region's name, in place of one that an earlier run left.</summary>
        private Scene Join()
        {
            var options = new JoinOptions
            {
                Condition = RhumbJoinCondition.Create,
                Coordinates = RhumbCoordinates.ZUp,
                ToleranceInMetres = settings.Tolerance,
                TicksPerSecond = settings.TicksPerSecond,
                PublishInterval = settings.PublishInterval,
                Gravity = new Vec3(0, 0, settings.Gravity),
                // Each actor learns of its own refusal by an event.
                Refusals = RhumbRefusals.Events,
            };
            Scene joined;
            try
            {
                joined = Join(options);
            }
            catch (RhumbException error) when (error.Code == RhumbCode.Denied)
            {
                using (Scene left = Join(new JoinOptions { Condition = RhumbJoinCondition.Join }))
                {
                    left.Delete();
                }
                joined = Join(options);
            }
            Log.InfoFormat("[RHUMB]: scene {0} at {1}, {2} ticks a second, one in {3} published, within {4} m",
                settings.Scene, settings.Address, settings.TicksPerSecond, settings.PublishInterval, settings.Tolerance);
            return joined;
        }

        private Scene Await(Scene slow)
        {
            while (true)
            {
                try
                {
                    slow.Wait(settings.PipelineDepth);
                    return slow;
                }
                catch (RhumbException error) when (error.Code == RhumbCode.Timeout && !isDisposed)
                {
                    // Ends with an answer, with the region, or with the error of a connection that ended.
                    continue;
                }
            }
        }

        private Scene Join(JoinOptions options)
        {
            using (Connection open = Connection.Open(settings.Address, settings.Trust, settings.Token, settings.Timeout))
            {
                return open.Join(settings.Scene, options);
            }
        }
    }
}
