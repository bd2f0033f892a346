"""Arrays of a view, which refuse None as the place of a body."""

from typing import Any, Optional

import numpy as np


class BodyArray(np.ndarray[Any, Any]):
    """An array of a view, or made from one: an element or a row for each body.

    It indexes as any array of NumPy does, except that None and a truth value are no place: NumPy reads array[None] and
    array[None, :2] as all rows, and place returns None for a body that is not in the view. Slices and results of NumPy
    refuse it too, as long as they have as many rows. np.expand_dims(array, 0) adds an axis. A row is a plain array.
    """

    _bodies: Optional[int]

    def __array_finalize__(self, source: Any) -> None:
        self._bodies = self.shape[0] if source is None else getattr(source, "_bodies", None)

    def __getitem__(self, key: Any) -> Any:
        first = key[0] if isinstance(key, tuple) and key else key
        if isinstance(first, np.ndarray) and first.ndim == 0:
            first = first[()]
        if first is None or isinstance(first, (bool, np.bool_)):
            if self.ndim > 0 and self.shape[0] == self._bodies:
                raise IndexError(
                    f"{first} is the place of no body. A body that is not in the view, because it is still to come or was"
                    " removed, has the place None; np.expand_dims(array, 0) adds an axis."
                )
        elif isinstance(first, (int, np.integer)):
            return np.ndarray.__getitem__(self.view(np.ndarray), key)
        return super().__getitem__(key)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        # Functions of NumPy index with None, and mean an axis.
        result = function(*_plain(args), **_plain(kwargs))
        if type(result) is np.ndarray and result.ndim > 0 and result.shape[0] == self._bodies:
            shared = result.view(BodyArray)
            shared._bodies = self._bodies
            return shared
        return result


def _plain(argument: Any) -> Any:
    """The argument with plain arrays in place of those of a view."""
    if isinstance(argument, BodyArray):
        return argument.view(np.ndarray)
    if type(argument) in (list, tuple):
        return type(argument)(_plain(part) for part in argument)
    if type(argument) is dict:
        return {name: _plain(part) for name, part in argument.items()}
    return argument
