"""Arrays of a view, which refuse None as the place of a body."""

from typing import Any, Optional

import numpy as np


class BodyArray(np.ndarray[Any, Any]):
    """An array of a view, or made from one: an element or a row for each body.

    It indexes as any array of NumPy does, except that None is no place: NumPy reads array[None] as all rows, and place
    returns None for a body that is not in the view. Slices and results of arithmetic refuse it too, as long as they have as
    many rows. A row is a plain array.
    """

    _bodies: Optional[int]

    def __array_finalize__(self, source: Any) -> None:
        self._bodies = self.shape[0] if source is None else getattr(source, "_bodies", None)

    def __getitem__(self, key: Any) -> Any:
        first, rest = (key[0], key[1:]) if isinstance(key, tuple) and key else (key, ())
        if first is None and self.ndim > 0 and self.shape[0] == self._bodies:
            if all(isinstance(part, (int, np.integer)) for part in rest):
                raise IndexError(
                    "None is the place of no body: it is not in the view yet, or was removed; array[None, :] adds an axis"
                )
        if isinstance(first, (int, np.integer)) and not isinstance(first, bool):
            return np.ndarray.__getitem__(self.view(np.ndarray), key)
        return super().__getitem__(key)
