"""A fall, a thousand boxes, a ray, a hinge with a motor, the contacts of now.

Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments. Coordinates are
those of PyBullet: z is up, in metres.
"""

import math
import sys

import numpy as np

import rhumb
from rhumb import Joint, Query, Scene, Shape


def join(address: str, fingerprint: str, name: str) -> Scene:
    connection = rhumb.connect(address, fingerprint=fingerprint)
    return connection.join(name, coordinates="z-up", condition="create")


def ground(scene: Scene) -> int:
    return scene.add_body(Shape.cuboid(50, 50, 0.5), (0, 0, -0.5), "fixed")


def falling_ball(scene: Scene) -> float:
    """Height of a ball after a fall of two seconds."""
    ground(scene)
    ball = scene.add_body(Shape.ball(0.5), (0, 0, 3), material=(0.5, 0.0, 1000.0))
    scene.advance(ticks=120)
    height: float = scene.positions[scene.place(ball)][2]
    return height


def thousand_boxes(scene: Scene) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
    """Positions of a thousand boxes, half a second after they were let go: an array of one row for each."""
    ground(scene)
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10), np.arange(10)), axis=-1).reshape(-1, 3)
    boxes = scene.add_bodies(Shape.cuboid(0.25, 0.25, 0.25), grid + (0, 0, 1))
    scene.advance(ticks=30)
    return scene.positions[scene.places(boxes)]


def ray(scene: Scene) -> "tuple[int, float]":
    """The first body below a point, and how far it is."""
    floor = ground(scene)
    scene.advance()
    _, [hits] = scene.query([Query.ray((0, 0, 10), (0, 0, -20))])
    assert hits[0].body == floor
    return hits[0].body, hits[0].distance


def hinge_with_motor(scene: Scene) -> float:
    """Angle of an arm about z, which a motor has turned at a radian a second for a second."""
    post = scene.add_body(Shape.cuboid(0.1, 0.1, 0.1), (0, 0, 1), "fixed")
    arm = scene.add_body(Shape.cuboid(0.5, 0.05, 0.05), (0.6, 0, 1), gravity_scale=0.0)
    # A hinge turns about x of its frames: a turn of -90 degrees about y lays x along z.
    x_up = (0, -math.sqrt(0.5), 0, math.sqrt(0.5))
    hinge = Joint(
        "revolute",
        post,
        arm,
        second_anchor=(-0.6, 0, 0),
        first_rotation=x_up,
        second_rotation=x_up,
        motors={3: (0.0, 1.0, 0.0, 1000.0, None)},
    )
    scene.add_joint(0, hinge)
    scene.advance(ticks=60)
    x, y, _ = scene.positions[scene.place(arm)]
    return math.atan2(y, x)


def contacts_now(scene: Scene) -> "list[rhumb.Contact]":
    """The bodies that a box on the ground touches."""
    ground(scene)
    box = scene.add_body(Shape.cuboid(0.5, 0.5, 0.5), (0, 0, 0.51))
    scene.report_events(box, contacts=True, force=0.0)
    scene.advance(ticks=30)
    return scene.contacts(box)


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit("the server's host:port and its fingerprint are missing")
    for task in (falling_ball, thousand_boxes, ray, hinge_with_motor, contacts_now):
        with join(sys.argv[1], sys.argv[2], task.__name__) as scene:
            result = task(scene)
            print(f"{task.__name__}: {result.shape if isinstance(result, np.ndarray) else result}")
            scene.delete()


if __name__ == "__main__":
    main()
