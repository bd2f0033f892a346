"""Scenes that continue from a checkpoint."""

from ._native import Checkpoint, LocalServer, Scene
from .errors import InvalidError

__all__ = ["restore"]

_OF_A_NEW_SCENE = {"stepping", "ticks_per_second", "substeps", "publish_interval", "gravity", "sleep"}


def restore(checkpoint: Checkpoint, scene: str = "main", **options: object) -> Scene:
    """Makes a scene in this process that continues from a checkpoint, on a server of its own, and joins it.

    The options are those of Connection.join; those of a new scene are the checkpoint's, and refused here. Bodies keep their
    ids. What the scene does next is what the saved one did, to the bit, given the same commands before the same ticks.
    """
    fixed = sorted(_OF_A_NEW_SCENE & options.keys())
    if fixed:
        raise InvalidError(f"{', '.join(fixed)}: a scene that is restored has those of its checkpoint; leave them out")
    server = LocalServer()
    server.restore(scene, checkpoint)
    return server.connect().join(scene, condition="join", **options)  # type: ignore[arg-type]
