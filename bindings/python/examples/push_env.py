"""An environment for reinforcement learning: push a box onto a mark, remotely.

The environment has the interface of Gymnasium's `Env`, and needs only NumPy. If gymnasium is installed, it is a
`gymnasium.Env` with spaces, and `gymnasium.utils.env_checker.check_env` passes. One environment is one scene of a server; as
many as you like share the server.

Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments.
"""

import sys

import numpy as np

import rhumb

try:
    from gymnasium import Env, spaces
except ImportError:
    Env, spaces = object, None

HALF_WIDTH = 5.0
"""The box starts on a floor that ends here, metres from the middle."""
TICKS_PER_STEP = 6
"""A tenth of a second of the scene."""
PUSH = 400.0
"""Greatest impulse of a step, N·s: the box weighs 125 kg."""


class PushEnv(Env):
    """Push a box onto a mark.

    Action: an impulse along x and z, each in [-1, 1] of the greatest one. Observation: the box's position and velocity
    along x and z, and the mark, metres and m/s. Reward: how much nearer the box came to the mark, and 10 on the mark.
    """

    metadata = {"render_modes": []}

    def __init__(self, address, fingerprint, scene="push", steps=200):
        self.scene = rhumb.connect(address, fingerprint=fingerprint).join(scene, condition="create", tolerance=0.005)
        self.scene.add_body(rhumb.Shape.cuboid(HALF_WIDTH, 0.5, HALF_WIDTH), (0, -0.5, 0), "fixed")
        self.steps = steps
        self.box = None
        self.np_random = np.random.default_rng()
        if spaces is not None:
            self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
            self.observation_space = spaces.Box(-np.inf, np.inf, (6,), np.float32)

    def reset(self, *, seed=None, options=None):
        """Begins an episode: a new box in the middle, and a new mark. A seed makes it the same one each time."""
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        if self.box is not None:
            self.scene.remove(self.box)
        self.box = self.scene.add_body(rhumb.Shape.cuboid(0.25, 0.25, 0.25), (0, 0.25, 0))
        self.mark = self.np_random.uniform(-3.0, 3.0, 2).astype(np.float32)
        self.step_count = 0
        self.scene.advance()
        observation = self._observe()
        self.distance = self._distance(observation)
        return observation, {"error_bound": self.scene.error_bound(self.box)}

    def step(self, action):
        """Pushes the box, and lets a tenth of a second pass."""
        x, z = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0) * PUSH
        self.scene.apply_impulse(self.box, (x, 0, z))
        self.scene.advance(ticks=TICKS_PER_STEP)
        self.step_count += 1
        observation = self._observe()
        distance = self._distance(observation)
        reward = self.distance - distance
        self.distance = distance
        reached = distance < 0.25
        fell = bool(np.abs(observation[:2]).max() > HALF_WIDTH)
        reward += 10.0 if reached else 0.0
        info = {"error_bound": self.scene.error_bound(self.box)}
        return observation, float(reward), reached or fell, self.step_count >= self.steps, info

    def close(self):
        """Deletes the scene."""
        if not self.scene.closed:
            self.scene.delete()
            self.scene.close()

    def _observe(self):
        place = self.scene.place(self.box)
        x, _, z = self.scene.positions[place]
        u, _, w = self.scene.linear_velocities[place]
        return np.array([x, z, u, w, *self.mark], dtype=np.float32)

    @staticmethod
    def _distance(observation):
        return float(np.hypot(*(observation[:2] - observation[4:])))


def push_towards_mark(observation):
    """A policy that knows enough: towards the mark, less the faster the box already is."""
    return np.clip(0.5 * (observation[4:] - observation[:2]) - 0.3 * observation[2:4], -1, 1)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("the server's host:port and its fingerprint are missing")
    env = PushEnv(sys.argv[1], sys.argv[2])
    for episode in range(3):
        observation, info = env.reset(seed=episode)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(push_towards_mark(observation))
            total, over = total + reward, terminated or truncated
        print(f"episode {episode}: {env.step_count} steps, reward {total:.2f}, box within {info['error_bound']:.3f} m")
    env.close()
