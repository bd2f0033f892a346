"""Scenes that are made from a file."""

import inspect
from os import PathLike
from typing import Callable, Tuple, Union

from ._native import Loaded, Scene, file_settings, local

__all__ = ["load"]

_OF_A_FILE = [name for name in inspect.signature(Scene.load).parameters if name not in ("self", "file")]


def load(file: Union[str, "PathLike[str]"], make: Callable[..., Scene] = local, **options: object) -> Tuple[Scene, Loaded]:
    """Makes a scene from a file, and returns it with what the file became in it.

    make is local or serve. The options are those of Scene.load and of make; where they leave it open, gravity, ticks and
    substeps are those that the file asks for.
    """
    of_file = {name: options.pop(name) for name in _OF_A_FILE if name in options}
    read = {name: value for name, value in of_file.items() if name != "position"}
    gravity, ticks_per_second, substeps = file_settings(file, str(options.get("coordinates", "rhumb")), **read)
    options.setdefault("gravity", gravity)
    if ticks_per_second is not None and not {"ticks_per_second", "substeps"} & options.keys():
        options.update(ticks_per_second=ticks_per_second, substeps=substeps)
    scene = make(**options)
    try:
        return scene, scene.load(file, **of_file)  # type: ignore[arg-type]
    except BaseException:
        scene.close()
        raise
