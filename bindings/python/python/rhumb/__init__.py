"""Remote rigid-body physics: copies of bodies within a chosen tolerance.

Make a scene in this process, add bodies, and step it; the poses of all bodies are NumPy arrays:

    with rhumb.local() as scene:
        scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
        ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))
        for _ in range(180):
            tick = scene.advance()
            print(tick, scene.positions[scene.place(ball)], scene.error_bound(ball))

rhumb.view(scene) shows it in a browser. scene.load("robot.urdf") adds what a file has: URDF, MJCF, glTF or a scene in JSON;
rhumb.load makes a scene of a file. rhumb.serve() makes a scene that other processes join, by the address that it prints. The
scene of a server elsewhere is rhumb.connect(address, fingerprint=fingerprint).join("drop"), with the same calls.

Units are kilograms, seconds, radians, and the unit of length of the scene's coordinates. Quaternions are x, y, z, w.
"""

from . import errors
from ._native import (
    Character,
    Checkpoint,
    Connection,
    Contact,
    Event,
    Hit,
    Joint,
    Loaded,
    LocalServer,
    Query,
    Request,
    Scene,
    Shape,
    Wheel,
    WheelInput,
    __version__,
    connect,
    local,
    serve,
)
from .checkpoints import restore
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
from .files import load
from .forks import Forks
from .page import view

__all__ = [
    "BusyError",
    "Character",
    "Checkpoint",
    "ClosedError",
    "ConnectError",
    "Connection",
    "Contact",
    "DeniedError",
    "EndedError",
    "Error",
    "Event",
    "FaultError",
    "Forks",
    "Hit",
    "InvalidError",
    "Joint",
    "Loaded",
    "LocalServer",
    "NotInViewError",
    "Query",
    "Refusal",
    "RefusedError",
    "Request",
    "Scene",
    "SceneGoneError",
    "Shape",
    "Timeout",
    "Wheel",
    "WheelInput",
    "__version__",
    "connect",
    "errors",
    "load",
    "local",
    "restore",
    "serve",
    "view",
]
