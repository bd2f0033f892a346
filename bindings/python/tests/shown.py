"""Random calls of a scene; writes the poses that are shown, with their bounds.

Arguments: address, fingerprint, scene, seed, calls, stepping, extent. Each line: tick, fraction, body, position, rotation, bound.
The same in C, C# and JavaScript; the tests of the workspace compare the lines with the server's truth.
"""

import sys

import rhumb


class Numbers:
    """The generator of all languages: Knuth's, its upper 31 bits."""

    def __init__(self, seed):
        self.state = seed

    def pick(self, count):
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self.state >> 33) % count

    def real(self, least, most):
        return least + (most - least) * self.pick(1_000_000) / 1e6


def show(scene):
    tick, fraction = scene.time
    assert len(set(scene.bodies.tolist())) == len(scene)
    rows = zip(scene.bodies, scene.positions, scene.rotations, scene.error_bounds)
    for body, position, rotation, bound in rows:
        assert scene.error_bound(body) == bound and scene.bodies[scene.place(body)] == body
        numbers = " ".join(f"{number:.9g}" for number in (*position, *rotation, bound))
        print(tick, f"{fraction:.9g}", body, numbers)


def add(scene, numbers):
    shape = rhumb.Shape.ball(0.5) if numbers.pick(2) else rhumb.Shape.cuboid(0.5, 0.5, 0.5)
    at = (numbers.real(-4, 4), numbers.real(1, 8), numbers.real(-4, 4))
    return scene.add_body(shape, at, "kinematic" if numbers.pick(5) == 0 else "dynamic")


def call(scene, numbers, bodies):
    choice = numbers.pick(8)
    if not bodies or (choice == 0 and len(bodies) < 12):
        bodies.append(add(scene, numbers))
        return
    place = numbers.pick(len(bodies))
    body = bodies[place]
    vector = (numbers.real(-6, 6), numbers.real(0, 6), numbers.real(-6, 6))
    if choice == 1 and len(bodies) > 4:
        scene.remove(bodies.pop(place))
    elif choice == 2:
        scene.set_pose(body, (vector[0], 1 + vector[1], vector[2]))
    elif choice == 3:
        scene.set_velocity(body, vector, (0, vector[0], 0))
    elif choice == 4:
        scene.flush()
    elif choice == 5:
        scene.idle(numbers.pick(20) * 0.001)


def take_cells(scene, numbers):
    at = (numbers.real(-6, 6), 0, numbers.real(-6, 6))
    scene.take_cells_around(at, [(1, None), (3, 0.01), (numbers.pick(8), 0.2)])


def step(scene, numbers, stepping):
    if stepping == "free running":
        scene.idle(numbers.pick(12) * 0.001)
        scene.poll()
    elif numbers.pick(4) == 0:
        scene.poll()
    else:
        scene.advance(depth=numbers.pick(2))


def main():
    address, fingerprint, name, seed, calls, stepping, extent = sys.argv[1:]
    numbers = Numbers(int(seed))
    options = {
        "stepping": stepping,
        "delay_ticks": numbers.pick(4) * 3.0,
        "smooth": numbers.pick(2) == 1,
        "whole_ticks": numbers.pick(2) == 1,
        "cells": extent == "cells",
    }
    with rhumb.connect(address, fingerprint=fingerprint).join(name, **options) as scene:
        scene.add_body(rhumb.Shape.cuboid(20, 0.5, 20), (0, -0.5, 0), "fixed")
        bodies = []
        for _ in range(int(calls)):
            call(scene, numbers, bodies)
            if extent == "cells" and numbers.pick(8) == 0:
                take_cells(scene, numbers)
            step(scene, numbers, stepping)
            show(scene)
        scene.idle(0.1)


main()
