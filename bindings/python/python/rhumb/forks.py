"""Many scenes that continue from one checkpoint, stepped together."""

import operator
import os
from typing import Any, Callable, Dict, List, Literal, Optional, Sequence, Type, Union, overload

import numpy as np
import numpy.typing as npt

from ._native import (
    Checkpoint,
    Joint,
    Scene,
    advance_scenes,
    numbers_of_scenes,
    resting_of_scenes,
)
from .checkpoints import restore
from .errors import Error, InvalidError, NotInViewError

__all__ = ["Forks"]

_Which = Optional[npt.ArrayLike]


class Forks(Sequence[Scene]):
    """Scenes that continue from one checkpoint, each on a server of its own in this process: Forks(scene.save(), 64).

    One call steps all of them, on several threads and without the interpreter's lock. The poses of all bodies of all forks are
    one array. forks[3] is a Scene with all of its calls. Given the same commands before the same ticks, forks are equal to the
    bit, whatever the number of threads.

    Numbers of commands are one row for all forks, or an array with one axis more, whose first is that of the forks:

        forks = rhumb.Forks(saved, 64)
        forks.apply_impulse(ball, np.random.normal(size=(64, 3)))   # one of its own in each fork
        forks.advance()
        heights = forks.positions[:, forks.place(ball), 1]          # 64 numbers
        forks.restore(heights < 0)                                  # begin these anew

    A call that is refused names the first fork that refuses it, and does nothing in that one and those after it. Masked
    numbers and those that are not finite are refused before any fork has the command.

    which chooses forks: a mask, a row of numbers, or None for all; an array of numbers has a row for each of the chosen ones.
    """

    def __init__(
        self, checkpoint: Checkpoint, count: int, *, threads: Optional[int] = None, tolerance: float = 0.001, **options: Any
    ) -> None:
        """threads: how many step them; None: as many as the process has processors. The options are those of Connection.join,
        with a tolerance of a millimetre if none is given."""
        try:
            count = operator.index(count)
        except TypeError:
            raise TypeError(f"count is {count!r}, and must be a whole number") from None
        if count < 1:
            raise InvalidError(f"count is {count}, and must be at least 1")
        self._checkpoint = checkpoint
        self._options: Dict[str, Any] = {"tolerance": tolerance, **options}
        self._threads = _processors() if threads is None else threads
        self._scenes: List[Scene] = []
        try:
            for _ in range(count):
                self._scenes.append(restore(checkpoint, **self._options))
        except BaseException:
            self.close()
            raise

    @overload
    def __getitem__(self, place: int) -> Scene: ...
    @overload
    def __getitem__(self, place: slice) -> List[Scene]: ...
    def __getitem__(self, place: Union[int, slice]) -> Union[Scene, List[Scene]]:
        return self._scenes[place]

    def __len__(self) -> int:
        return len(self._scenes)

    def __repr__(self) -> str:
        return f"<rhumb.Forks, {len(self)} of tick {self._checkpoint.tick}>"

    def __enter__(self) -> "Forks":
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: object, traceback: object) -> Literal[False]:
        self.close()
        return False

    def close(self) -> None:
        """Ends all forks. A second time does nothing."""
        for scene in self._scenes:
            scene.close()

    def advance(self, ticks: int = 1, which: _Which = None) -> None:
        """Steps forks by some ticks, and computes their views.

        An error names its fork, and comes after the others were stepped; that of the first fork which has one is raised.
        """
        chosen = self._chosen(which)
        advance_scenes([self._scenes[fork] for fork in chosen], chosen, ticks, self._threads)

    def restore(self, which: _Which = None, checkpoint: Optional[Checkpoint] = None) -> None:
        """Restarts forks from the checkpoint, or from another one. A Scene taken of such a fork before is closed."""
        for fork in self._chosen(which):
            scene = restore(self._checkpoint if checkpoint is None else checkpoint, **self._options)
            self._scenes[fork].close()
            self._scenes[fork] = scene

    @property
    def bodies(self) -> npt.NDArray[np.uint64]:
        """The ids of the bodies, in the order of the arrays: those of the first fork."""
        return self._scenes[0].bodies

    def place(self, body: int) -> int:
        """Place of a body in the arrays: forks.positions[:, forks.place(body)]. Raises NotInViewError if the first fork does not
        have the body."""
        place = self._scenes[0].place(body)
        if place is None:
            raise NotInViewError(f"body {body} is not in fork 0: it is still to come, was removed, or was never there")
        return place

    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Forks, bodies, x y z: as of a Scene.

        This array and the next ones are made by each reading, and raise InvalidError if the forks do not have the same bodies,
        as after one of them has left the world.
        """
        return self._numbers("positions", 3)

    @property
    def rotations(self) -> npt.NDArray[np.float32]:
        """Forks, bodies, x y z w: body to world."""
        return self._numbers("rotations", 4)

    @property
    def linear_velocities(self) -> npt.NDArray[np.float32]:
        """Forks, bodies, x y z: units of length per second."""
        return self._numbers("linear_velocities", 3)

    @property
    def angular_velocities(self) -> npt.NDArray[np.float32]:
        """Forks, bodies, x y z: rad/s about world axes."""
        return self._numbers("angular_velocities", 3)

    @property
    def resting(self) -> npt.NDArray[np.bool_]:
        """Forks, bodies: True for each that rests."""
        resting: npt.NDArray[np.bool_] = resting_of_scenes(self._scenes).reshape(len(self), -1)
        return resting

    def set_pose(
        self, body: Any, position: npt.ArrayLike, rotation: Optional[npt.ArrayLike] = None, *, which: _Which = None
    ) -> None:
        """Scene.set_pose in each fork."""
        self._each(Scene.set_pose, body, which, position, rotation)

    def set_velocity(
        self, body: Any, linear: npt.ArrayLike, angular: Optional[npt.ArrayLike] = None, *, which: _Which = None
    ) -> None:
        """Scene.set_velocity in each fork."""
        self._each(Scene.set_velocity, body, which, linear, angular)

    def apply_force(
        self, body: Any, force: npt.ArrayLike, point: Optional[npt.ArrayLike] = None, *, which: _Which = None
    ) -> None:
        """Scene.apply_force in each fork: for one tick."""
        self._each(Scene.apply_force, body, which, force, point)

    def apply_torque(self, body: Any, torque: npt.ArrayLike, *, which: _Which = None) -> None:
        """Scene.apply_torque in each fork: for one tick."""
        self._each(Scene.apply_torque, body, which, torque)

    def apply_impulse(
        self, body: Any, impulse: npt.ArrayLike, point: Optional[npt.ArrayLike] = None, *, which: _Which = None
    ) -> None:
        """Scene.apply_impulse in each fork."""
        self._each(Scene.apply_impulse, body, which, impulse, point)

    def apply_torque_impulse(self, body: Any, impulse: npt.ArrayLike, *, which: _Which = None) -> None:
        """Scene.apply_torque_impulse in each fork."""
        self._each(Scene.apply_torque_impulse, body, which, impulse)

    def change_joint(self, id: int, joint: Union[Joint, Sequence[Joint]], *, which: _Which = None) -> None:
        """Scene.change_joint in each fork: with the same joint, or a row of them with one for each fork."""
        chosen = self._chosen(which)
        joints = [joint] * len(chosen) if isinstance(joint, Joint) else list(joint)
        if len(joints) != len(chosen):
            raise InvalidError(f"joint has {len(joints)} joints, and must have one for each of {len(chosen)} forks")
        for fork, own in zip(chosen, joints):
            self._scenes[fork].change_joint(id, own)

    def _numbers(self, what: str, width: int) -> npt.NDArray[np.float32]:
        numbers: npt.NDArray[np.float32] = numbers_of_scenes(self._scenes, what).reshape(len(self), -1, width)
        return numbers

    def _each(self, command: Callable[..., object], body: Any, which: _Which, *numbers: Optional[npt.ArrayLike]) -> None:
        chosen = self._chosen(which)
        # One axis for the numbers of a body, one for a row of bodies, one for the forks.
        shared = 1 if np.ndim(body) == 0 else 2
        rows: List[Sequence[Any]] = []
        for values in numbers:
            # Not as numbers of another kind: a scene refuses masked and complex ones.
            array = None if values is None else np.asanyarray(values)
            if array is None or array.ndim <= shared:
                rows.append([values] * len(chosen))
            elif len(array) == len(chosen):
                rows.append(list(array))
            else:
                raise InvalidError(f"an array has {len(array)} rows, and must have one for each of {len(chosen)} forks")
            _check_each(rows[-1], chosen)
        for done, (fork, own) in enumerate(zip(chosen, zip(*rows))):
            try:
                command(self._scenes[fork], body, *own)
            except Error as error:
                before = f". Forks before it have the command: {chosen[:done]}" if done > 0 else ""
                raise type(error)(f"fork {fork}: {error}{before}") from error

    def _chosen(self, which: _Which) -> List[int]:
        """The numbers of the chosen forks, without doubles."""
        if which is None:
            return list(range(len(self)))
        chosen = np.asarray(which)
        if chosen.dtype == np.bool_:
            if chosen.shape != (len(self),):
                raise InvalidError(f"which is a mask of shape {chosen.shape}, and must have one truth for each of {len(self)} forks")
            return [int(fork) for fork in np.flatnonzero(chosen)]
        if chosen.size == 0:
            return []
        if chosen.ndim > 1 or not np.issubdtype(chosen.dtype, np.integer):
            raise InvalidError(f"which is {which!r}, and must be a mask, a row of whole numbers, or None for all forks")
        forks = [int(fork) for fork in np.atleast_1d(chosen)]
        if len(set(forks)) < len(forks) or min(forks) < 0 or max(forks) >= len(self):
            raise InvalidError(f"which has a fork twice or one that is not: each must be from 0 to {len(self) - 1}, once")
        return forks


def _check_each(rows: Sequence[Any], chosen: Sequence[int]) -> None:
    for fork, row in zip(chosen, rows):
        numbers = np.asanyarray(row)
        if np.ma.is_masked(numbers):
            raise InvalidError(f"fork {fork}: the numbers are {row}, and must be without masked entries")
        if np.issubdtype(numbers.dtype, np.floating) and not np.isfinite(numbers).all():
            raise InvalidError(f"fork {fork}: the numbers are {row}, and must be finite")


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
