"""Publishes the bodies of any engine, and prints what a follower gets.

    python3 feed.py numpy 10000        balls that fall and bounce, in a few lines of NumPy
    python3 feed.py mujoco 500         boxes that fall in a heap: pip install mujoco
    python3 feed.py mujoco MODEL.xml   the bodies of a model, whose actuators swing
    python3 feed.py pybullet 500       the boxes again: pip install pybullet
    python3 feed.py mujoco-warp 500    the boxes again, by MuJoCo-Warp: pip install mujoco-warp
    python3 feed.py newton 500         the boxes again: pip install newton
    python3 feed.py jolt 500           the boxes again: pip install culverin

MuJoCo-Warp and Newton run on the CPU, or with --device cuda:0 on a GPU. With --free-running, the program keeps the time.

The follower is a client as any other. Naive are 52 bytes for each body that moves and each tick: position, rotation, velocities.
"""

import argparse
import time

import numpy as np

import rhumb

RATE = 60
# Of a float at 100 m, in three coordinates.
ROUNDING = 1e-5
SUBSTEPS = 4
# Of the view of a free-running scene, so that what it shows has arrived.
DELAY = 30
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
    """A heap of boxes, or copies of a model from a file, side by side. MuJoCo's quaternions begin with w."""

    substeps = SUBSTEPS

    def __init__(self, source, copies=1):
        import mujoco

        self.mujoco = mujoco
        if source.isdigit():
            self.model = mujoco.MjModel.from_xml_string(heap(int(source)))
        else:
            whole = mujoco.MjSpec.from_file(source)
            for copy in range(1, copies):
                frame = whole.worldbody.add_frame(pos=(2 * copy, 0, 0))
                whole.attach(mujoco.MjSpec.from_file(source), frame=frame, prefix=f"{copy}-")
            self.model = whole.compile()
        random = np.random.default_rng(7)
        self.swing = random.uniform(0.5, 2, self.model.nu), random.uniform(0, 2 * np.pi, self.model.nu)
        limited = self.model.actuator_ctrllimited.astype(bool)[:, None]
        self.controls = np.where(limited, self.model.actuator_ctrlrange, (-1, 1))
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

    def swung(self):
        rate, phase = self.swing
        share = 0.5 + 0.3 * np.sin(2 * np.pi * rate * self.data.time + phase)
        return self.controls[:, 0] + share * (self.controls[:, 1] - self.controls[:, 0])

    def step(self):
        self.data.ctrl = self.swung()
        self.mujoco.mj_step(self.model, self.data, SUBSTEPS)

    def state(self):
        velocity, rotation = np.empty((len(self.moving), 6)), np.empty((len(self.moving), 4))
        for row, body in enumerate(self.moving):
            self.mujoco.mju_mat2Quat(rotation[row], self.data.ximat[body])
            self.mujoco.mj_objectVelocity(self.model, self.data, self.mujoco.mjtObj.mjOBJ_BODY, body, velocity[row], 0)
        return self.data.xipos[self.moving], rotation[:, [1, 2, 3, 0]], velocity[:, 3:], velocity[:, :3]


class MujocoWarp(Mujoco):
    """The same heap or models, stepped by MuJoCo-Warp. States come back to MuJoCo's own data once a tick."""

    def __init__(self, source, copies=1, device="cpu"):
        import mujoco_warp
        import warp

        super().__init__(source, copies)
        self.warp, self.engine, self.device = warp, mujoco_warp, device
        warp.config.quiet = True
        with warp.ScopedDevice(device):
            # Boxes in a heap touch at many points; without these, room is made for those of the start.
            room = {"nconmax": 32 * self.model.nbody, "njmax": 128 * self.model.nbody}
            self.there = mujoco_warp.put_model(self.model), mujoco_warp.put_data(self.model, self.data, **room)

    def step(self):
        model, data = self.there
        with self.warp.ScopedDevice(self.device):
            self.warp.copy(data.ctrl, self.warp.array(self.swung()[None], dtype=float))
            for _ in range(SUBSTEPS):
                self.engine.step(model, data)
            self.engine.get_data_into(self.data, self.model, data)


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


class Newton:
    """The same heap, by Newton's solver XPBD. Its bodies are placed by their origins, here their centres of mass."""

    substeps = SUBSTEPS

    def __init__(self, count, device="cpu"):
        import newton
        import warp

        warp.config.quiet = True
        builder = newton.ModelBuilder()
        builder.add_ground_plane()
        volume = 8 * HALF[0] * HALF[1] * HALF[2]
        of_a_kilogram = newton.ModelBuilder.ShapeConfig(density=1 / volume)
        for at, turn in places(int(count)):
            body = builder.add_body(xform=warp.transform(at, turn))
            builder.add_shape_box(body, hx=HALF[0], hy=HALF[1], hz=HALF[2], cfg=of_a_kilogram)
        self.moments = np.diagonal(np.array(builder.body_inertia[0]).reshape(3, 3))
        model = builder.finalize(device=device)
        self.now, self.next, self.control = model.state(), model.state(), model.control()
        self.solver = newton.solvers.SolverXPBD(model)
        self.collisions = newton.CollisionPipeline(model)
        self.contacts = self.collisions.contacts()

    def add(self, scene):
        position, rotation, *_ = self.state()
        return scene.add_bodies(rhumb.Shape.cuboid(*HALF), position, rotations=rotation, mass=1, moments=self.moments)

    def step(self):
        for _ in range(SUBSTEPS):
            self.now.clear_forces()
            self.collisions.collide(self.now, self.contacts)
            self.solver.step(self.now, self.next, self.control, self.contacts, 1 / RATE / SUBSTEPS)
            self.now, self.next = self.next, self.now

    def state(self):
        pose, velocity = self.now.body_q.numpy(), self.now.body_qd.numpy()
        return pose[:, :3].copy(), pose[:, 3:].copy(), velocity[:, :3].copy(), velocity[:, 3:].copy()


class Jolt:
    """The same heap, by Jolt in the package culverin. Jolt takes a share of a velocity a second, and has no gyroscopic term."""

    substeps = SUBSTEPS

    def __init__(self, count):
        import culverin

        settings = {"gravity": (0, 0, -9.81), "max_bodies": int(count) + 1, "num_threads": 1}
        self.world = culverin.PhysicsWorld(settings=settings)
        ground = {"shape": culverin.SHAPE_PLANE, "motion": culverin.MOTION_STATIC}
        self.world.create_body(pos=(0, 0, 0), size=(0, 0, 1, 0), **ground)
        box = {"size": HALF, "shape": culverin.SHAPE_BOX, "mass": 1.0}
        self.boxes = [self.world.create_body(pos=at, rot=tuple(turn), **box) for at, turn in places(int(count))]
        self.world.step(1e-9)
        self.rows = [self.world.get_index(box) for box in self.boxes]
        of_a_substep = 0.05 / RATE / SUBSTEPS
        self.damping = (0.05 / (1 - of_a_substep),) * 2

    def add(self, scene):
        position, rotation, *_ = self.state()
        options = {"mass": 1, "damping": self.damping, "gyroscopic": False}
        return scene.add_bodies(rhumb.Shape.cuboid(*HALF), position, rotations=rotation, **options)

    def step(self):
        for _ in range(SUBSTEPS):
            self.world.step(1 / RATE / SUBSTEPS)

    def state(self):
        world = self.world
        arrays = world.positions, world.rotations, world.velocities, world.angular_velocities
        position, rotation, linear, angular = (np.asarray(array).reshape(-1, 4)[self.rows] for array in arrays)
        return position[:, :3], rotation, linear[:, :3], angular[:, :3]


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


ENGINES = {"numpy": Numpy, "mujoco": Mujoco, "mujoco-warp": MujocoWarp, "pybullet": Pybullet, "newton": Newton, "jolt": Jolt}
OPTIONS = {"mujoco": ["copies"], "mujoco-warp": ["copies", "device"], "newton": ["device"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engine", choices=ENGINES)
    parser.add_argument("source", help="number of bodies, or a model of MuJoCo")
    parser.add_argument("--copies", type=int, default=1, help="copies of a model (default: 1)")
    parser.add_argument("--seconds", type=int, default=10, help="duration (default: 10)")
    parser.add_argument("--tolerance", type=float, default=0.05, help="metres (default: 0.05)")
    parser.add_argument("--device", default="cpu", help="of MuJoCo-Warp and Newton: cpu or cuda:0 (default: cpu)")
    parser.add_argument("--free-running", action="store_true", help="60 ticks a second by the clock, not as fast as it goes")
    given = parser.parse_args()
    options = {name: getattr(given, name) for name in OPTIONS.get(given.engine, [])}
    publish(ENGINES[given.engine](given.source, **options), given.seconds, given.tolerance, given.free_running)


def publish(engine, seconds, tolerance, free_running):
    server = rhumb.LocalServer(own_thread=True)
    options = {**UP, "substeps": engine.substeps, "tolerance": tolerance}
    options["stepping"] = "free running" if free_running else "lockstep"
    owner = server.connect(feed="engine").join("engine", **options)
    bodies = np.array(engine.add(owner), dtype=np.uint64)
    # The follower joins a scene that is running.
    owner.feed(bodies, *engine.state())
    view = {"delay_ticks": DELAY, "whole_ticks": True, "smooth": False} if free_running else {}
    follower = server.connect().join("engine", coordinates="z-up", tolerance=tolerance, **view)
    while free_running and len(follower.bodies) < len(bodies):
        owner.feed(bodies, *engine.state())
        follower.idle(1 / RATE)
        follower.poll()
    begun, worst, beyond, moving, calls = follower.statistics, 0.0, 0, 0, []
    before, truths, compared = engine.state()[0].copy(), {}, 0
    start = time.monotonic()
    for step in range(seconds * RATE):
        engine.step()
        state = engine.state()
        moving += int(np.any(state[0] != before, axis=1).sum())
        before = state[0].copy()
        if free_running:
            follower.idle(max(0.0, start + step / RATE - time.monotonic()))
        called = time.thread_time()
        tick = owner.feed(bodies, *state)
        calls.append(time.thread_time() - called)
        truths[tick] = before[np.argsort(bodies)]
        truths.pop(tick - 60, None)
        shown, _ = follower.poll()
        while not free_running and shown < tick:
            follower.idle(0.0005)
            shown, _ = follower.poll()
        if shown not in truths:
            continue
        # Of a free-running view, what has not arrived has no bound.
        order = np.argsort(follower.bodies)
        known = np.isfinite(follower.error_bounds[order])
        compared += int(known.sum())
        error = np.linalg.norm(follower.positions[order] - truths[shown], axis=1)[known]
        if not known.any():
            continue
        worst, beyond = max(worst, float(error.max())), beyond + int((error > tolerance + ROUNDING).sum())
    elapsed = time.monotonic() - start if free_running else seconds
    ended = follower.statistics
    received = ended["received_bytes"] - begun["received_bytes"]
    updates = ended["updates"] - begun["updates"]
    print(f"bodies                        {len(bodies)}")
    print(f"follower, kB/s                {received / elapsed / 1e3:.1f}")
    print(f"naive, kB/s                   {52 * moving / elapsed / 1e3:.1f}")
    print(f"updates/s                     {updates / elapsed:.0f}")
    print(f"body-ticks compared           {100 * compared / len(bodies) / seconds / RATE:.0f} %")
    print(f"greatest error, mm            {1e3 * worst:.1f} of {1e3 * tolerance:.0f}")
    print(f"body-ticks beyond             {beyond}")
    print(f"feed, ms of its thread        {1e3 * np.median(calls):.2f} in the median, {1e3 * np.quantile(calls, 0.99):.2f} in 99 %")


if __name__ == "__main__":
    main()
