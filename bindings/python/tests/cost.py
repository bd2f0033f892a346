"""The cost of a frame of 10,000 moving bodies in Python.

Arguments: the server's address and fingerprint. Prints medians in microseconds.
"""

import statistics
import sys
import time

import numpy as np

import rhumb

BODIES = 10_000
FRAMES = 300

with rhumb.connect(sys.argv[1], fingerprint=sys.argv[2], timeout=60).join(
    "cost-python", condition="create", gravity=(0, 0, 0)
) as scene:
    grid = np.stack([np.arange(BODIES) % 100 * 2, np.zeros(BODIES), np.arange(BODIES) // 100 * 2], axis=1)
    scene.add_bodies(rhumb.Shape.ball(0.25), grid, linear_velocities=(0, 1, 0))
    scene.advance(ticks=30)
    advances, reads, again, calls = [], [], [], []
    for _ in range(FRAMES):
        begun = time.perf_counter()
        scene.advance(depth=1)
        advanced = time.perf_counter()
        positions, rotations = scene.positions, scene.rotations
        read = time.perf_counter()
        positions, rotations = scene.positions, scene.rotations
        reread = time.perf_counter()
        scene.flush()
        done = time.perf_counter()
        advances.append(advanced - begun)
        reads.append(read - advanced)
        again.append(reread - read)
        calls.append(done - reread)
    figures = [1e6 * statistics.median(times) for times in (advances, reads, again, calls)]
    print("Python: advance {:.1f}, positions and rotations {:.1f}, again {:.2f}, a call {:.2f}".format(*figures))
    scene.delete()
