"""Scenes as environments of Gymnasium, whose package this module needs.

    pip install gymnasium
"""

from typing import Any, Dict, List, Optional, Sequence, Tuple, Union

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, MultiBinary, MultiDiscrete
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ._native import Checkpoint
from .errors import InvalidError
from .forks import Forks

__all__ = ["VectorEnv"]

_Array = npt.NDArray[Any]
_Stepped = Tuple[_Array, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], Dict[str, Any]]


class VectorEnv(gymnasium.vector.VectorEnv[_Array, _Array, Any]):
    """Many episodes of one task, stepped together: each is a fork of a checkpoint.

    A task is a class of its own with these methods; forks has the scenes.

        class Hop(rhumb.learning.VectorEnv):
            def begin(self, which): ...         # commands that make a new episode differ from the others
            def act(self, which, actions): ...  # commands, before a step
            def observe(self): ...              # an observation of each fork, in the space's type
            def reward(self): ...               # a number for each fork
            def terminated(self): ...           # a truth for each fork

    which are the numbers of forks, for commands of Forks; generators[fork] is the random generator of a fork's episodes, whose
    seeds reset gives: the seed, the seed and one, and so on. An episode depends on its own seed and actions alone.

    A new episode begins with the checkpoint and one tick, in which the commands of begin act. Autoreset is Gymnasium's: in the
    next step, in the same step (the last observation is infos["final_obs"]), or disabled (reset takes options["reset_mask"]).

    An episode whose scene lost a body, as one that fell out of the world, is terminated with infos["lost_body"] and a reward of
    0. Its observation is that of a new beginning: the arrays of forks need the same bodies in all of them.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        num_envs: int,
        *,
        observation_space: gymnasium.Space[Any],
        action_space: gymnasium.Space[Any],
        ticks: int = 1,
        max_steps: Optional[int] = None,
        autoreset_mode: Union[AutoresetMode, str] = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        """observation_space and action_space: of one episode. ticks: of the scene in each step. max_steps: after so many an
        episode is truncated; None: never. The options are those of Forks."""
        if ticks < 1:
            raise InvalidError(f"ticks is {ticks}, and must be at least 1")
        if max_steps is not None and max_steps < 1:
            raise InvalidError(f"max_steps is {max_steps}, and must be at least 1, or None")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.single_observation_space = observation_space
        self.single_action_space = action_space
        self.observation_space = batch_space(observation_space, num_envs)
        self.action_space = batch_space(action_space, num_envs)
        for name, batch in (("observation_space", self.observation_space), ("action_space", self.action_space)):
            if not isinstance(batch, (Box, MultiBinary, MultiDiscrete)):
                raise InvalidError(f"{name} is of {type(batch).__name__}, and must be of arrays: flatten it to a Box")
        self.ticks = ticks
        self.max_steps = max_steps
        self.forks = Forks(checkpoint, num_envs, **options)
        self.generators: List[np.random.Generator] = [np.random.default_rng() for _ in range(num_envs)]
        # The bodies with which each episode began.
        self._begun: List[npt.NDArray[np.uint64]] = [scene.bodies for scene in self.forks]
        self._steps = np.zeros(num_envs, np.int64)
        # All of them: nothing has begun.
        self._over = np.ones(num_envs, np.bool_)
        # Episodes that lost a body have begun anew at once, since what is left of them cannot be observed.
        self._begun_early = np.zeros(num_envs, np.bool_)

    def begin(self, which: npt.NDArray[np.intp]) -> None:
        """Queues commands in forks whose episodes begin. Without it, all episodes begin alike."""

    def act(self, which: npt.NDArray[np.intp], actions: Any) -> None:
        """Queues the commands of actions: one for each of these forks, as the action space has them."""
        raise NotImplementedError("act: a task says what its actions do")

    def observe(self) -> _Array:
        """The observation of each fork, in an array of its own."""
        raise NotImplementedError("observe: a task says what is seen of it")

    def reward(self) -> npt.ArrayLike:
        """The reward of the last step in each fork."""
        raise NotImplementedError("reward: a task says what is good")

    def terminated(self) -> npt.ArrayLike:
        """True for each fork whose episode is over. Without it, only max_steps ends one."""
        return np.zeros(self.num_envs, np.bool_)

    def reset(
        self, *, seed: Union[int, Sequence[Optional[int]], None] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[_Array, Dict[str, Any]]:
        """Begins all episodes anew, or those of options["reset_mask"]. seed: of the first fork, or one for each."""
        mask = (options or {}).get("reset_mask")
        which = np.ones(self.num_envs, np.bool_) if mask is None else np.asarray(mask)
        if which.dtype != np.bool_ or which.shape != (self.num_envs,) or not which.any():
            raise InvalidError(f"reset_mask is {mask!r}, and must have a truth for each of {self.num_envs} forks, one of them true")
        seeds = [seed + fork for fork in range(self.num_envs)] if isinstance(seed, (int, np.integer)) else seed
        if seeds is not None:
            if len(seeds) != self.num_envs:
                raise InvalidError(f"seed has {len(seeds)} seeds, and must have one for each of {self.num_envs} forks")
            for fork, own in enumerate(seeds):
                if which[fork] and own is not None:
                    self.generators[fork] = np.random.default_rng(own)
        self._begin(which)
        return self.observe(), {}

    def step(self, actions: _Array) -> _Stepped:
        """One step of each episode; those that are over begin anew, if that is the mode. Their actions are not used then."""
        over = self._over.copy()
        if over.any() and self.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise gymnasium.error.ResetNeeded(f"the episodes of forks {np.flatnonzero(over).tolist()} are over: call reset")
        stepped = ~over
        which = np.flatnonzero(stepped)
        if len(which) > 0:
            self.act(which, actions if stepped.all() else np.asarray(actions)[which])
            self.forks.advance(self.ticks, which=which)
        self._steps[which] += 1
        lost = stepped & self._lost()
        due = over & ~self._begun_early | lost
        if due.any():
            self._begin(due)
        observation = self.observe()
        reward = np.where(stepped & ~lost, np.asarray(self.reward(), np.float64), 0.0)
        terminated = stepped & np.asarray(self.terminated(), np.bool_) | lost
        is_long = np.zeros_like(over) if self.max_steps is None else self._steps >= self.max_steps
        truncated = stepped & is_long & ~terminated
        self._over = terminated | truncated
        self._begun_early = lost
        infos: Dict[str, Any] = {}
        for fork in np.flatnonzero(lost):
            infos = self._add_info(infos, {"lost_body": True}, int(fork))
        if self._over.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            for fork in np.flatnonzero(self._over):
                last = {"final_obs": observation[fork].copy(), "final_info": {}}
                infos = self._add_info(infos, last, int(fork))
            if (self._over & ~lost).any():
                self._begin(self._over & ~lost)
            self._over[:] = False
            observation = self.observe()
        return observation, reward, terminated, truncated, infos

    def close_extras(self, **_options: Any) -> None:
        """Ends the forks."""
        self.forks.close()

    def _lost(self) -> npt.NDArray[np.bool_]:
        """The forks that no longer have all bodies with which their episodes began."""
        def has_lost(begun: npt.NDArray[np.uint64], bodies: npt.NDArray[np.uint64]) -> bool:
            return not np.array_equal(begun, bodies) and not np.isin(begun, bodies).all()

        return np.array([has_lost(*bodies) for bodies in zip(self._begun, (scene.bodies for scene in self.forks))], np.bool_)

    def _begin(self, over: npt.NDArray[np.bool_]) -> None:
        which = np.flatnonzero(over)
        self.forks.restore(which)
        self.begin(which)
        self.forks.advance(which=which)
        for fork in which:
            self._begun[fork] = self.forks[int(fork)].bodies
        self._steps[which] = 0
        self._over = self._over & ~over
