"""A ball that falls, or a robot from a file, in a browser."""

import argparse
import sys
import time
from typing import Tuple

from . import InvalidError, LocalServer, Scene, Shape
from .files import load
from .page import view

#: Seconds from one fall of the ball to the next.
FALL_S = 4.0


def _join(**options: object) -> Scene:
    return LocalServer(own_thread=True).connect().join("main", stepping="free running", **options)  # type: ignore[arg-type]


def _ball() -> Tuple[Scene, int]:
    scene = _join()
    scene.add_body(Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    return scene, scene.add_body(Shape.ball(0.5), (0, 10, 0), material=(0.5, 0.6, 1000))


def _robot(file: str) -> Scene:
    scene, loaded = load(file, _join)
    for note in loaded.left_out:
        print(note)
    return scene


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rhumb", description="A ball that falls, or a file, in a browser.")
    parser.add_argument("file", nargs="?", help="URDF, MJCF, glTF, or a JSON scene; without one a ball falls, again and again")
    parser.add_argument("--no-browser", action="store_true", help="prints the address of the page and opens none")
    parser.add_argument("--seconds", type=float, default=None, help="ends after so long, not at Ctrl-C")
    asked = parser.parse_args()
    try:
        scene, ball = (_robot(asked.file), None) if asked.file else _ball()
    except InvalidError as error:
        sys.exit(f"error: {error}")
    with scene:
        print(f"{view(scene, browser=not asked.no_browser)} shows the scene; Ctrl-C ends it", flush=True)
        began = fell = time.monotonic()
        while asked.seconds is None or time.monotonic() < began + asked.seconds:
            scene.idle(0.25)
            tick, _ = scene.poll()
            if ball is not None and ball in scene:
                height = scene.positions[scene.place(ball)][1]
                print(f"tick {tick}: the ball is {height:.2f} m high", flush=True)
                if time.monotonic() > fell + FALL_S:
                    fell = time.monotonic()
                    scene.set_pose(ball, (0, 10, 0), (0, 0, 0, 1))
                    scene.set_velocity(ball, (0, 0, 0), (0, 0, 0))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
