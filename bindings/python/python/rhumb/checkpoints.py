"""Scenes that continue from a checkpoint."""

from ._native import Checkpoint, LocalServer, Scene

__all__ = ["restore"]


def restore(checkpoint: Checkpoint, scene: str = "main", **options: object) -> Scene:
    """Makes a scene in this process that continues from a checkpoint, on a server of its own, and joins it.

    The options are those of Connection.join; those of a new scene are the checkpoint's. Bodies keep their ids. What the scene
    does next is what the saved one did, to the bit, given the same commands before the same ticks.
    """
    server = LocalServer()
    server.restore(scene, checkpoint)
    return server.connect().join(scene, condition="join", **options)  # type: ignore[arg-type]
