"""Five tasks in Rhumb, PyBullet and MuJoCo: the code of each, run and timed.

    pip install rhumb-physics mujoco==4.0.0 pybullet==3.2.7
    python beside.py [PAGE]

An engine that is not installed is left out. With the path of a page, it writes "Five tasks" of the book: this code and the times.
z is up, in metres.
"""

import inspect
import math
import pathlib
import re
import sys
import textwrap
import time

import numpy as np


class InRhumb:
    def falling_ball(self):
        import rhumb

        with rhumb.local(coordinates="z-up") as scene:
            scene.add_body(rhumb.Shape.cuboid(50, 50, 0.5), (0, 0, -0.5), "fixed")
            ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 0, 3))
            for _ in range(120):
                scene.advance()
            return scene.positions[scene.place(ball)][2]

    def thousand_boxes(self):
        import rhumb

        grid = np.mgrid[0:10, 0:10, 0:10].reshape(3, -1).T + (0, 0, 1)
        with rhumb.local(coordinates="z-up") as scene:
            scene.add_body(rhumb.Shape.cuboid(50, 50, 0.5), (0, 0, -0.5), "fixed")
            boxes = scene.add_bodies(rhumb.Shape.cuboid(0.25, 0.25, 0.25), grid)
            for _ in range(60):
                scene.advance()
                poses = scene.positions[scene.places(boxes)]
            return poses

    def ray(self):
        import rhumb

        with rhumb.local(coordinates="z-up") as scene:
            floor = scene.add_body(rhumb.Shape.cuboid(50, 50, 0.5), (0, 0, -0.5), "fixed")
            scene.advance()
            _, [hits] = scene.query([rhumb.Query.ray((0, 0, 10), (0, 0, -20))])
            assert hits[0].body == floor
            return hits[0].distance

    def hinge_with_motor(self):
        import rhumb

        half = math.sqrt(0.5)
        along_z = (0, -half, 0, half)  # A hinge turns about x of its frames.
        with rhumb.local(coordinates="z-up") as scene:
            post = scene.add_body(rhumb.Shape.cuboid(0.1, 0.1, 0.1), (0, 0, 1), "fixed")
            arm = scene.add_body(rhumb.Shape.cuboid(0.5, 0.05, 0.05), (0.6, 0, 1))
            hinge = rhumb.Joint("revolute", post, arm, second_anchor=(-0.6, 0, 0), first_rotation=along_z,
                                second_rotation=along_z, motors={3: (0, 1, 0, 1000, None)})
            scene.add_joint(0, hinge)
            for _ in range(60):
                scene.advance()
            x, y, _ = scene.positions[scene.place(arm)]
            return math.atan2(y, x)

    def contacts_now(self):
        import rhumb

        with rhumb.local(coordinates="z-up") as scene:
            scene.add_body(rhumb.Shape.cuboid(50, 50, 0.5), (0, 0, -0.5), "fixed")
            box = scene.add_body(rhumb.Shape.cuboid(0.5, 0.5, 0.5), (0, 0, 0.51))
            scene.report_events(box, contacts=True, force=0.0)
            for _ in range(30):
                scene.advance()
            return sum(contact.force for contact in scene.contacts(box))


class InPyBullet:
    def falling_ball(self):
        import pybullet as p

        p.connect(p.DIRECT)
        p.setGravity(0, 0, -9.80665)
        p.setTimeStep(1 / 60)
        p.createMultiBody(0, p.createCollisionShape(p.GEOM_BOX, halfExtents=(50, 50, 0.5)), basePosition=(0, 0, -0.5))
        ball = p.createMultiBody(500, p.createCollisionShape(p.GEOM_SPHERE, radius=0.5), basePosition=(0, 0, 3))
        for _ in range(120):
            p.stepSimulation()
        height = p.getBasePositionAndOrientation(ball)[0][2]
        p.disconnect()
        return height

    def thousand_boxes(self):
        import pybullet as p

        grid = np.mgrid[0:10, 0:10, 0:10].reshape(3, -1).T + (0, 0, 1)
        p.connect(p.DIRECT)
        p.setGravity(0, 0, -9.80665)
        p.setTimeStep(1 / 60)
        p.createMultiBody(0, p.createCollisionShape(p.GEOM_BOX, halfExtents=(50, 50, 0.5)), basePosition=(0, 0, -0.5))
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(0.25, 0.25, 0.25))
        boxes = [p.createMultiBody(125, shape, basePosition=at) for at in grid.tolist()]
        for _ in range(60):
            p.stepSimulation()
            poses = np.array([p.getBasePositionAndOrientation(box)[0] for box in boxes])
        p.disconnect()
        return poses

    def ray(self):
        import pybullet as p

        p.connect(p.DIRECT)
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(50, 50, 0.5))
        floor = p.createMultiBody(0, shape, basePosition=(0, 0, -0.5))
        body, _, fraction, _, _ = p.rayTest((0, 0, 10), (0, 0, -10))[0]
        assert body == floor
        p.disconnect()
        return fraction * 20

    def hinge_with_motor(self):
        import pybullet as p

        p.connect(p.DIRECT)
        p.setTimeStep(1 / 60)
        post = p.createCollisionShape(p.GEOM_BOX, halfExtents=(0.1, 0.1, 0.1))
        arm = p.createCollisionShape(p.GEOM_BOX, halfExtents=(0.5, 0.05, 0.05), collisionFramePosition=(0.6, 0, 0))
        robot = p.createMultiBody(
            0, post, basePosition=(0, 0, 1), linkMasses=[10], linkCollisionShapeIndices=[arm], linkVisualShapeIndices=[-1],
            linkPositions=[(0, 0, 0)], linkOrientations=[(0, 0, 0, 1)], linkInertialFramePositions=[(0.6, 0, 0)],
            linkInertialFrameOrientations=[(0, 0, 0, 1)], linkParentIndices=[0], linkJointTypes=[p.JOINT_REVOLUTE],
            linkJointAxis=[(0, 0, 1)])
        p.setJointMotorControl2(robot, 0, p.VELOCITY_CONTROL, targetVelocity=1, force=1000)
        for _ in range(60):
            p.stepSimulation()
        angle = p.getJointState(robot, 0)[0]
        p.disconnect()
        return angle

    def contacts_now(self):
        import pybullet as p

        p.connect(p.DIRECT)
        p.setGravity(0, 0, -9.80665)
        p.setTimeStep(1 / 60)
        p.createMultiBody(0, p.createCollisionShape(p.GEOM_BOX, halfExtents=(50, 50, 0.5)), basePosition=(0, 0, -0.5))
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(0.5, 0.5, 0.5))
        box = p.createMultiBody(1000, shape, basePosition=(0, 0, 0.51))
        for _ in range(30):
            p.stepSimulation()
        force = sum(contact[9] for contact in p.getContactPoints(bodyA=box))
        p.disconnect()
        return force


class InMuJoCo:
    def falling_ball(self):
        import mujoco

        model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.004166666" gravity="0 0 -9.80665"/><worldbody><geom type="plane" size="50 50 1"/>
              <body name="ball" pos="0 0 3"><freejoint/><geom size="0.5"/></body></worldbody></mujoco>""")
        data = mujoco.MjData(model)
        for _ in range(120):
            mujoco.mj_step(model, data, 4)
        return data.body("ball").xpos[2]

    def thousand_boxes(self):
        import mujoco

        model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.004166666" gravity="0 0 -9.80665"/><size memory="1G"/><worldbody>
              <geom type="plane" size="50 50 1"/>
              <replicate count="10" offset="1 0 0"><replicate count="10" offset="0 1 0"><replicate count="10" offset="0 0 1">
                <body pos="0 0 1"><freejoint/><geom type="box" size="0.25 0.25 0.25"/></body>
              </replicate></replicate></replicate></worldbody></mujoco>""")
        data = mujoco.MjData(model)
        for _ in range(60):
            mujoco.mj_step(model, data, 4)
            poses = data.xpos[1:]
        return poses

    def ray(self):
        import mujoco

        model = mujoco.MjModel.from_xml_string("""
            <mujoco><worldbody><geom name="floor" type="box" size="50 50 0.5" pos="0 0 -0.5"/></worldbody></mujoco>""")
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        geom = np.zeros(1, np.int32)
        distance = mujoco.mj_ray(model, data, np.array([0.0, 0, 10]), np.array([0.0, 0, -1]), None, 1, -1, geom)
        assert geom[0] == model.geom("floor").id
        return distance

    def hinge_with_motor(self):
        import mujoco

        model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.004166666"/><worldbody><body pos="0 0 1">
              <joint name="hinge" axis="0 0 1"/><geom type="box" size="0.5 0.05 0.05" pos="0.6 0 0"/></body></worldbody>
              <actuator><velocity joint="hinge" kv="1000"/></actuator></mujoco>""")
        data = mujoco.MjData(model)
        data.ctrl[0] = 1
        for _ in range(60):
            mujoco.mj_step(model, data, 4)
        return data.joint("hinge").qpos[0]

    def contacts_now(self):
        import mujoco

        model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.004166666" gravity="0 0 -9.80665"/><worldbody><geom type="plane" size="50 50 1"/>
              <body pos="0 0 0.51"><freejoint/><geom type="box" size="0.5 0.5 0.5"/></body></worldbody></mujoco>""")
        data = mujoco.MjData(model)
        for _ in range(30):
            mujoco.mj_step(model, data, 4)
        force, total = np.zeros(6), 0.0
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, force)
            total += force[0]
        return total


TASKS = ("falling_ball", "thousand_boxes", "ray", "hinge_with_motor", "contacts_now")


def shown(result):
    return f"array {result.shape}" if isinstance(result, np.ndarray) else f"{result:.3f}"


ENGINES = (("Rhumb", InRhumb), ("PyBullet", InPyBullet), ("MuJoCo", InMuJoCo))
TITLES = {
    "falling_ball": "A ball falls for two seconds",
    "thousand_boxes": "A thousand boxes for a second, with an array of all positions in each step",
    "ray": "What is below, and how far",
    "hinge_with_motor": "A motor turns an arm at a radian a second, for a second",
    "contacts_now": "The force on a box that lies on the ground",
}

PAGE = """# Five tasks, three engines

The same five tasks in Rhumb, PyBullet 3.2.7 and MuJoCo 4.0.0. `bindings/python/examples/beside.py` runs them and writes this page. Each
begins with nothing and ends with nothing, in steps of 1/60 s: four substeps in Rhumb, four steps in MuJoCo, one in PyBullet.

{table}
The times are the best of five on {machine}, with what makes and ends the scene: take
them as proportions. Rhumb's have the server, the packets and the copy in them; with `rhumb.serve()` in place of `rhumb.local()`,
other processes read the same scene.
{tasks}"""


IMPORTS = (("math", "import math\n"), ("np", "import numpy as np\n"))


def code(engine, task):
    """The task as a program of its own."""
    lines = inspect.getsource(getattr(engine, task)).split("\n", 1)[1]
    body = re.sub(r"return (.+)", r"print(\1)", textwrap.dedent(lines).strip())
    return "".join(line for name, line in IMPORTS if re.search(rf"\b{name}\.", body)) + body


def timed(engine, task):
    """The result and the best of five times, as a cell of a table."""
    try:
        getattr(engine(), task)()
    except ImportError:
        return "not installed"
    best = math.inf
    for _ in range(5):
        began = time.perf_counter()
        result = getattr(engine(), task)()
        best = min(best, time.perf_counter() - began)
    return f"{shown(result)}, {best * 1e3:.1f} ms"


def main():
    table = "| task | " + " | ".join(name for name, _ in ENGINES) + " |\n|---|---:|---:|---:|\n"
    tasks = ""
    for task in TASKS:
        cells = " | ".join(timed(engine, task) for _, engine in ENGINES)
        table += f"| {TITLES[task].split(',')[0].lower()} | {cells} |\n"
        tasks += f"\n## {TITLES[task]}\n"
        for name, engine in ENGINES:
            tasks += f"\n{name}:\n\n```python\n{code(engine, task)}\n```\n"
    print(table)
    if len(sys.argv) > 1:
        machine = "two busy cores, Rhumb in a build with little optimisation"
        pathlib.Path(sys.argv[1]).write_text(PAGE.format(table=table, tasks=tasks, machine=machine))


if __name__ == "__main__":
    main()
