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
        if first is None or _is_truth(first):
            self._refuse(first)
        elif isinstance(first, slice) and any(map(_is_truth, (first.start, first.stop, first.step))):
            self._refuse(first)
        elif isinstance(first, (int, np.integer)):
            return np.ndarray.__getitem__(self.view(np.ndarray), key)
        return super().__getitem__(key)

    def take(self, indices: Any, *arguments: Any, **options: Any) -> Any:
        """As of any array, but None and truth values are no places."""
        return np.take(self, indices, *arguments, **options)

    def item(self, *places: Any) -> Any:
        """As of any array, but a truth value is no place."""
        for place in places:
            if _has_truth(place):
                self._refuse(place)
        return super().item(*places)

    def _refuse(self, place: Any) -> None:
        if self.ndim > 0 and self.shape[0] == self._bodies:
            raise IndexError(
                f"{place} is the place of no body. A body that is not in the view, because it is still to come or was"
                " removed, has the place None; np.expand_dims(array, 0) adds an axis."
            )

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        name = _PLACES.get(function)
        if name is not None:
            places = args[1] if len(args) > 1 else kwargs.get(name, 0)
            if places is None or (_has_truth(places) if function is np.take else _is_truth(places)):
                self._refuse(places)
        # Functions of NumPy index with None, and mean an axis.
        result = function(*_plain(args), **_plain(kwargs))
        if type(result) is np.ndarray and result.ndim > 0 and result.shape[0] == self._bodies:
            shared = result.view(BodyArray)
            shared._bodies = self._bodies
            return shared
        return result


# Functions of NumPy that take places, as their second argument of this name.
_PLACES = {np.take: "indices", np.delete: "obj", np.insert: "obj"}


def _is_truth(place: Any) -> bool:
    return isinstance(place, (bool, np.bool_)) or isinstance(place, np.ndarray) and place.shape == () and place.dtype == bool


def _has_truth(places: Any) -> bool:
    if isinstance(places, (list, tuple)):
        return any(map(_has_truth, places))
    return isinstance(places, (bool, np.bool_)) or isinstance(places, np.ndarray) and places.dtype == bool


def _plain(argument: Any) -> Any:
    """The argument with plain arrays in place of those of a view."""
    if isinstance(argument, BodyArray):
        return argument.view(np.ndarray)
    if type(argument) in (list, tuple):
        return type(argument)(_plain(part) for part in argument)
    if type(argument) is dict:
        return {name: _plain(part) for name, part in argument.items()}
    return argument
