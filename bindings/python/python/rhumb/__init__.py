"""Remote rigid-body physics: copies of bodies within a chosen tolerance.

Make a scene in this process, add bodies, and step it; the poses of all bodies are NumPy arrays:

    with rhumb.local() as scene:
        scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
        ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))
        for _ in range(180):
            tick = scene.advance()
            print(tick, scene.positions[scene.place(ball)], scene.error_bound(ball))

The scene of a server elsewhere is rhumb.connect(address, fingerprint=fingerprint).join("drop"), with the same calls.

Units are kilograms, seconds, radians, and the unit of length of the scene's coordinates. Quaternions are x, y, z, w.
"""

from . import errors
from ._native import (
    Character,
    Connection,
    Contact,
    Event,
    Hit,
    Joint,
    LocalServer,
    Query,
    Scene,
    Shape,
    Wheel,
    WheelInput,
    __version__,
    connect,
    local,
)
from .errors import (
    BusyError,
    ClosedError,
    ConnectError,
    DeniedError,
    EndedError,
    Error,
    FaultError,
    InvalidError,
    NotInViewError,
    Refusal,
    RefusedError,
    SceneGoneError,
    Timeout,
)

__all__ = [
    "BusyError",
    "Character",
    "ClosedError",
    "ConnectError",
    "Connection",
    "Contact",
    "DeniedError",
    "EndedError",
    "Error",
    "Event",
    "FaultError",
    "Hit",
    "InvalidError",
    "Joint",
    "LocalServer",
    "NotInViewError",
    "Query",
    "Refusal",
    "RefusedError",
    "Scene",
    "SceneGoneError",
    "Shape",
    "Timeout",
    "Wheel",
    "WheelInput",
    "__version__",
    "connect",
    "errors",
    "local",
]
