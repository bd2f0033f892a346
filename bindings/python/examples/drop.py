"""Drops a ball on a floor, and prints its position and its error bound.

Without arguments, the physics is in this process. With the address and the fingerprint that `rhumb-server --open` prints,
it is on that server.
"""

import sys

import rhumb

if len(sys.argv) not in (1, 3):
    sys.exit("the server's host:port and its fingerprint, or neither")
with rhumb.connect(sys.argv[1], fingerprint=sys.argv[2]).join("drop") if sys.argv[1:] else rhumb.local() as scene:
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))
    for _ in range(180):
        tick = scene.advance()
        x, y, z = scene.positions[scene.place(ball)]
        print(f"tick {tick}: {x:.3f} {y:.3f} {z:.3f}, within {scene.error_bound(ball):.3f} m")
    scene.delete()
