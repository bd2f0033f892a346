"""Publishes the bodies of any engine, and prints what a follower gets.

    python3 feed.py numpy 10000        balls that fall and bounce, in a few lines of NumPy
    python3 feed.py mujoco 500         boxes that fall in a heap: pip install mujoco
    python3 feed.py mujoco MODEL.xml   the bodies of a model
    python3 feed.py pybullet 500       the boxes again: pip install pybullet

The follower is a client as any other. Naive are 52 bytes for each body that moves and each tick: position, rotation, velocities.
"""

import sys
import time

import numpy as np

import rhumb

RATE, SECONDS, TOLERANCE = 60, 10, 0.05
# Of a float at 100 m, in three coordinates.
ROUNDING = 1e-5
SUBSTEPS = 4
UP = {"coordinates": "z-up", "gravity": (0, 0, -9.81), "ticks_per_second": RATE}


class Numpy:
    """Balls that fall on the ground and bounce: one step of Euler's method a tick."""

    substeps = 1

    def __init__(self, count):
        random = np.random.default_rng(7)
        self.position = random.uniform((-100, -100, 2), (100, 100, 22), (int(count), 3)).astype(np.float32)
        self.linear = np.zeros_like(self.position)
        self.rotation, self.angular = np.float32((0, 0, 0, 1)), np.float32((0, 0, 0))

    def add(self, scene):
        return scene.add_bodies(rhumb.Shape.ball(0.1), self.position)

    def step(self):
        self.linear[:, 2] -= np.float32(9.81 / RATE)
        self.position += self.linear * np.float32(1 / RATE)
        low = self.position[:, 2] < 0.1
        self.position[low, 2] = 0.1
        speed = -0.5 * self.linear[low, 2]
        self.linear[low, 2] = np.where(speed < 0.3, 0, speed)

    def state(self):
        return self.position, self.rotation, self.linear, self.angular


class Mujoco:
    """A heap of boxes, or a model from a file. MuJoCo's quaternions begin with w."""

    substeps = SUBSTEPS

    def __init__(self, source):
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(heap(int(source))) if source.isdigit() else mujoco.MjModel.from_xml_path(source)
        self.model.opt.timestep = 1 / RATE / SUBSTEPS
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.moving = np.flatnonzero(self.model.body_weldid > 0)

    def add(self, scene):
        model, ids = self.model, []
        position, rotation, *_ = self.state()
        for body, at, turn in zip(self.moving, position, rotation):
            geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body]
            reach = [np.linalg.norm(model.geom_pos[geom] - model.body_ipos[body]) + model.geom_rbound[geom] for geom in geoms]
            # Moments about the axes of inertia: those are the axes that are fed.
            mass = {"mass": model.body_mass[body], "moments": model.body_inertia[body]}
            ids.append(scene.add_body(rhumb.Shape.ball(max(reach, default=0.05)), at, rotation=turn, **mass))
        return ids

    def step(self):
        self.mujoco.mj_step(self.model, self.data, SUBSTEPS)

    def state(self):
        velocity, rotation = np.empty((len(self.moving), 6)), np.empty((len(self.moving), 4))
        for row, body in enumerate(self.moving):
            self.mujoco.mju_mat2Quat(rotation[row], self.data.ximat[body])
            self.mujoco.mj_objectVelocity(self.model, self.data, self.mujoco.mjtObj.mjOBJ_BODY, body, velocity[row], 0)
        return self.data.xipos[self.moving], rotation[:, [1, 2, 3, 0]], velocity[:, 3:], velocity[:, :3]


class Pybullet:
    """The same heap. PyBullet damps exponentially by a share a second; Rhumb's formula with the same effect in a tick."""

    substeps = SUBSTEPS

    def __init__(self, count):
        import pybullet

        self.engine, damping = pybullet, 0.04
        pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.81)
        pybullet.setTimeStep(1 / RATE / SUBSTEPS)
        pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE))
        self.damping = (((1 - damping) ** (-1 / RATE) - 1) * RATE,) * 2
        box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=HALF)
        self.boxes = [pybullet.createMultiBody(1, box, basePosition=at, baseOrientation=turn) for at, turn in places(int(count))]

    def add(self, scene):
        position, rotation, *_ = self.state()
        moments = self.engine.getDynamicsInfo(self.boxes[0], -1)[2]
        options = {"mass": 1, "moments": moments, "damping": self.damping}
        return scene.add_bodies(rhumb.Shape.cuboid(*HALF), position, rotations=rotation, **options)

    def step(self):
        for _ in range(SUBSTEPS):
            self.engine.stepSimulation()

    def state(self):
        poses = [self.engine.getBasePositionAndOrientation(box) for box in self.boxes]
        velocities = [self.engine.getBaseVelocity(box) for box in self.boxes]
        position, rotation = map(np.array, zip(*poses))
        linear, angular = map(np.array, zip(*velocities))
        return position, rotation, linear, angular


HALF = (0.15, 0.1, 0.05)


def places(count):
    """Places above the ground, in layers of 36, and turns."""
    random = np.random.default_rng(7)
    for box in range(count):
        layer, place = divmod(box, 36)
        turn = random.normal(size=4)
        yield (place % 6 * 0.5 - 1.25, place // 6 * 0.5 - 1.25, 0.5 + 0.4 * layer), turn / np.linalg.norm(turn)


def heap(count):
    def text(numbers):
        return " ".join(f"{number:.6f}" for number in numbers)

    boxes = (
        f'<body pos="{text(at)}" quat="{text(turn)}"><freejoint/><geom type="box" size="{text(HALF)}"/></body>'
        for at, turn in places(count)
    )
    return f'<mujoco><worldbody><geom type="plane" size="50 50 1"/>{"".join(boxes)}</worldbody></mujoco>'


def main(engine, source):
    engine = {"numpy": Numpy, "mujoco": Mujoco, "pybullet": Pybullet}[engine](source)
    server = rhumb.LocalServer(own_thread=True)
    options = {**UP, "substeps": engine.substeps, "tolerance": TOLERANCE}
    owner = server.connect(feed="engine").join("engine", **options)
    bodies = np.array(engine.add(owner), dtype=np.uint64)
    # The follower joins a scene that is running.
    owner.feed(bodies, *engine.state())
    follower = server.connect().join("engine", coordinates="z-up", tolerance=TOLERANCE)
    begun, worst, beyond, moving, calls = follower.statistics, 0.0, 0, 0, []
    before = engine.state()[0].copy()
    for _ in range(SECONDS * RATE):
        engine.step()
        state = engine.state()
        moving += int(np.any(state[0] != before, axis=1).sum())
        before = state[0].copy()
        start = time.perf_counter()
        tick = owner.feed(bodies, *state)
        calls.append(time.perf_counter() - start)
        while follower.poll()[0] < tick:
            follower.idle(0.0005)
        order = np.argsort(follower.bodies)
        truth = state[0][np.argsort(bodies)]
        error = np.linalg.norm(follower.positions[order] - truth, axis=1)
        worst, beyond = max(worst, float(error.max())), beyond + int((error > TOLERANCE + ROUNDING).sum())
    ended = follower.statistics
    received = ended["received_bytes"] - begun["received_bytes"]
    updates = ended["updates"] - begun["updates"]
    print(f"bodies                        {len(bodies)}")
    print(f"follower, kB/s                {received / SECONDS / 1e3:.1f}")
    print(f"naive, kB/s                   {52 * moving / SECONDS / 1e3:.1f}")
    print(f"updates/s                     {updates / SECONDS:.0f}")
    print(f"greatest error, mm            {1e3 * worst:.1f} of {1e3 * TOLERANCE:.0f}")
    print(f"body-ticks beyond             {beyond}")
    print(f"feed, ms: median, 99 %        {1e3 * np.median(calls):.2f}, {1e3 * np.quantile(calls, 0.99):.2f}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
