"""Arrays of a view, which refuse None as the place of a body."""

from typing import Any

import numpy as np


class BodyArray(np.ndarray[Any, Any]):
    """An array of a view: an element or a row for each body.

    It indexes as any array of NumPy does, except that None is no place: NumPy reads array[None] as all rows, and place
    returns None for a body that is not in the view. Rows, slices and results of arithmetic are plain arrays.
    """

    def __getitem__(self, key: Any) -> Any:
        first, rest = (key[0], key[1:]) if isinstance(key, tuple) and key else (key, ())
        if first is None and all(isinstance(part, (int, np.integer)) for part in rest):
            raise IndexError(
                "None is the place of no body: it is not in the view yet, or was removed; array[None, :] adds an axis"
            )
        return np.ndarray.__getitem__(self.view(np.ndarray), key)

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain
