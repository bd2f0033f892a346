"""Drops a ball on a floor, and prints its position and its error bound.

Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments.
"""

import sys

import rhumb

if len(sys.argv) != 3:
    sys.exit("the server's host:port and its fingerprint are missing")
with rhumb.connect(sys.argv[1], fingerprint=sys.argv[2]).join("drop") as scene:
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))
    for _ in range(180):
        tick = scene.advance()
        x, y, z = scene.positions[scene.place(ball)]
        print(f"tick {tick}: {x:.3f} {y:.3f} {z:.3f}, within {scene.error_bound(ball):.3f} m")
    scene.delete()
