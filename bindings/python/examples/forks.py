"""Steps a second of many copies of one scene, beside MuJoCo and PyBullet.

A task for Gymnasium follows.

    pip install rhumb-physics gymnasium mujoco==4.0.0 pybullet==3.2.7
    python forks.py [COPIES]

A step is 1/60 s of a pile of twelve boxes: one step in Rhumb (four substeps of the engine) and PyBullet, four in MuJoCo. In each
copy a box is pushed at random before each step, and the poses of all are read as one array. What is not installed is left out.
"""

import sys
import time

import numpy as np

import rhumb

BOXES = 12
STEPS = 120
RADIUS = 0.25


def places():
    return [(0.1 * (number % 3), 0.0, 0.3 + 0.55 * number) for number in range(BOXES)]


def pile():
    """A checkpoint of the pile, and its boxes."""
    with rhumb.local(coordinates="z-up") as scene:
        scene.add_body(rhumb.Shape.cuboid(20, 20, 0.5), (0, 0, -0.5), "fixed")
        boxes = scene.add_bodies(rhumb.Shape.cuboid(RADIUS, RADIUS, RADIUS), places(), mass=1.0)
        scene.advance()
        return scene.save(), boxes


def in_rhumb(pushes):
    saved, boxes = pile()
    with rhumb.Forks(saved, pushes.shape[1], coordinates="z-up") as forks:
        began = time.perf_counter()
        for each in pushes:
            forks.apply_impulse(boxes[5], each)
            forks.advance()
            poses = forks.positions
        return time.perf_counter() - began, poses.shape


def in_mujoco(pushes):
    import mujoco

    boxes = "".join(
        f'<body pos="{x} {y} {z}"><freejoint/><geom type="box" size="{RADIUS} {RADIUS} {RADIUS}" mass="1"/></body>' for x, y, z in places()
    )
    option = '<option timestep="0.004166666" gravity="0 0 -9.80665"/>'
    model = mujoco.MjModel.from_xml_string(f'<mujoco>{option}<worldbody><geom type="plane" size="20 20 1"/>{boxes}</worldbody></mujoco>')
    copies = [mujoco.MjData(model) for _ in range(pushes.shape[1])]
    began = time.perf_counter()
    for each in pushes:
        for data, push in zip(copies, each):
            data.qvel[30:33] += push
            mujoco.mj_step(model, data, 4)
        poses = np.stack([data.xpos for data in copies])
    return time.perf_counter() - began, poses.shape


def in_pybullet(pushes):
    import pybullet

    copies = []
    for _ in range(pushes.shape[1]):
        client = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.80665, physicsClientId=client)
        pybullet.setTimeStep(1 / 60, physicsClientId=client)
        floor = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=(20, 20, 0.5), physicsClientId=client)
        pybullet.createMultiBody(0, floor, basePosition=(0, 0, -0.5), physicsClientId=client)
        box = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=(RADIUS,) * 3, physicsClientId=client)
        copies.append((client, [pybullet.createMultiBody(1, box, basePosition=place, physicsClientId=client) for place in places()]))
    began = time.perf_counter()
    for each in pushes:
        poses = []
        for (client, boxes), push in zip(copies, each):
            linear, angular = pybullet.getBaseVelocity(boxes[5], physicsClientId=client)
            pybullet.resetBaseVelocity(boxes[5], np.add(linear, push).tolist(), angular, physicsClientId=client)
            pybullet.stepSimulation(physicsClientId=client)
            poses.append([pybullet.getBasePositionAndOrientation(box, physicsClientId=client)[0] for box in boxes])
        poses = np.array(poses)
    seconds = time.perf_counter() - began
    for client, _ in copies:
        pybullet.disconnect(client)
    return seconds, poses.shape


def task(copies):
    """An environment: push a box of the pile, which must stay up."""
    import gymnasium

    from rhumb.learning import VectorEnv

    saved, boxes = pile()

    class KeepUp(VectorEnv):
        def begin(self, which):
            pushes = [self.generators[fork].normal(scale=0.3, size=3) for fork in which]
            self.forks.apply_impulse(boxes[-1], pushes, which=which)

        def act(self, which, actions):
            self.forks.apply_impulse(boxes[-1], actions, which=which)

        def observe(self):
            return self.forks.positions[:, self.forks.place(boxes[-1])]

        def reward(self):
            return self.observe()[:, 2]

        def terminated(self):
            return self.observe()[:, 2] < 4

    return KeepUp(
        saved,
        copies,
        observation_space=gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32),
        action_space=gymnasium.spaces.Box(-0.2, 0.2, (3,), np.float32),
        max_steps=300,
        coordinates="z-up",
    )


def in_gymnasium(pushes):
    env = task(pushes.shape[1])
    env.reset(seed=1)
    began = time.perf_counter()
    for each in pushes:
        observation, *_ = env.step(each)
    seconds = time.perf_counter() - began
    env.close()
    return seconds, observation.shape


def main():
    copies = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    pushes = np.random.default_rng(1).normal(scale=0.2, size=(STEPS, copies, 3))
    print(f"| {copies} copies | steps a second | array |\n|---|---:|---|")
    for name, run in (
        ("Rhumb, `Forks`", in_rhumb),
        ("Rhumb, `learning.VectorEnv`", in_gymnasium),
        ("MuJoCo", in_mujoco),
        ("PyBullet", in_pybullet),
    ):
        try:
            runs = [run(pushes) for _ in range(3)]
        except ImportError as missing:
            print(f"| {name} | {missing.name} is not installed | |")
            continue
        seconds, shape = min(runs)
        print(f"| {name} | {copies * STEPS / seconds:,.0f} | {shape} |")


if __name__ == "__main__":
    main()
