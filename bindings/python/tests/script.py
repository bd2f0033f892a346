"""The script that every language runs; it prints the hash of all poses.

Arguments: the server's address and fingerprint. tests/tests/processes/bindings/script.rs is the same script in Rust.
"""

import sys

import numpy as np

import rhumb

PILED = 60
TICKS = 150


def fold(hashed, numbers):
    """FNV-1a of 64 bits."""
    for byte in np.ascontiguousarray(numbers, dtype="<f4").tobytes():
        hashed = (hashed ^ byte) * 0x100000001B3 % 2**64
    return hashed


SHAPES = [
    rhumb.Shape.ball(0.25),
    rhumb.Shape.cuboid(0.5, 0.25, 0.5),
    rhumb.Shape.capsule(0.5, 0.25),
    rhumb.Shape.cylinder(0.5, 0.25),
    rhumb.Shape.cone(0.5, 0.25),
]


def add_piled(scene, i):
    position = (i % 2 * 1.25 - 0.625, 1 + 1.5 * (i // 4), i // 2 % 2 * 1.25 - 0.625)
    return scene.add_body(SHAPES[i % 5], position, angular_velocity=(0, 0.5 * (i % 3), 0))


def add_built(scene):
    """A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car."""
    dumbbell = rhumb.Shape.compound([
        (rhumb.Shape.ball(0.25), (-0.5, 0, 0)),
        (rhumb.Shape.ball(0.25), (0.5, 0, 0)),
        (rhumb.Shape.cuboid(0.125, 0.5, 0.25), (0, 0, 0.25), (0.5, 0.5, 0.5, 0.5)),
    ])
    return [
        scene.add_body(dumbbell, (-4, 2, 0)),
        scene.add_body(rhumb.Shape.cuboid(0.25, 0.25, 0.25), (4, 4, 0), "fixed"),
        scene.add_body(rhumb.Shape.cuboid(0.25, 1, 0.25), (4, 2.5, 0)),
        scene.add_body(rhumb.Shape.capsule(0.5, 0.25), (7, 1, 3), "kinematic"),
        scene.add_body(rhumb.Shape.cuboid(0.75, 0.25, 1.5), (-7, 1, 5)),
    ]


def set_moving(scene, walker, car):
    """Lets the walker walk and the car roll."""
    scene.set_character(walker, rhumb.Character(step=(0.5, 0.125)))
    scene.set_velocity(walker, (-1, 0, -0.5))
    places = [(x, -0.125, z) for z in (-1.25, 1.25) for x in (-0.75, 0.75)]
    scene.set_vehicle(car, [rhumb.Wheel(place, 0.25) for place in places])


def hinge(bodies, motor):
    anchor, arm = bodies[PILED + 2], bodies[PILED + 3]
    return rhumb.Joint(
        "revolute", anchor, arm, first_anchor=(0, -0.5, 0), second_anchor=(0, 1, 0), limits={3: (-0.5, 1)}, motors={3: motor}
    )


def interfere(scene, tick, bodies):
    if tick == 20:
        front, rear = rhumb.WheelInput(steering=0.25), rhumb.WheelInput(force=2000)
        scene.set_wheels(bodies[PILED + 5], [front, front, rear, rear])
    elif tick == 30:
        scene.apply_impulse(bodies[1], (200, 100, 0))
        scene.set_velocity(bodies[6], (0, 4, 1), (1, 0, 0))
    elif tick == 40:
        scene.jump(bodies[PILED + 4], 4)
    elif tick == 60:
        scene.remove(bodies[4])
    elif tick == 75:
        scene.change_joint(7, hinge(bodies, (0.75, 0, 30, 5, None)))
    elif tick == 90:
        scene.set_gravity((1, -9.75, 0))


def main(address, fingerprint):
    connection = rhumb.connect(address, fingerprint=fingerprint, timeout=30)
    with connection.join("script", condition="create") as scene:
        bodies = [scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")]
        bodies += [add_piled(scene, i) for i in range(PILED)]
        bodies += add_built(scene)
        scene.add_joint(7, hinge(bodies, (0, 1, 0, 4, 2000)))
        set_moving(scene, bodies[PILED + 4], bodies[PILED + 5])
        for tick in range(TICKS):
            interfere(scene, tick, bodies)
            scene.advance()
        hashed = 0xCBF29CE484222325
        for body in bodies:
            if body in scene:
                place = scene.place(body)
                hashed = fold(hashed, scene.positions[place])
                hashed = fold(hashed, scene.rotations[place])
        ray = rhumb.Query.ray((-0.625, 50, -0.625), (0, -100, 0), hits=8)
        _, [hits] = scene.query([ray])
        hashed = fold(hashed, [hit.distance for hit in hits])
        print(f"{len(scene)} bodies, {len(hits)} hits, hash {hashed:016x}")
        scene.delete()


if __name__ == "__main__":
    main(*sys.argv[1:])
