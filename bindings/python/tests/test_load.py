"""Robots and scenes from files: names, places, and what is left out."""

import json
import pathlib

import numpy as np
import pytest

import rhumb

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.5" rpy="0.1 0 0"/><mass value="2"/>
      <inertia ixx="0.2" iyy="0.2" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.5"/><geometry><box size="0.1 0.1 1"/></geometry></collision>
  </link>
  <link name="tip">
    <inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 2"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
  <joint name="wrist" type="continuous"><parent link="upper"/><child link="tip"/><origin xyz="0 0 -1.2"/>
    <axis xyz="1 0 0"/><mimic joint="shoulder"/></joint>
</robot>
"""

BALLS = {
    "version": 1,
    "scene": "balls",
    "gravity": [0, -3, 0],
    "step_s": 1 / 120,
    "substeps": 2,
    "bodies": [
        {"dynamic": True, "shape": {"ball": {"radius": 0.5}}, "position": [0, 10, 0]},
        {"dynamic": True, "shape": {"ball": {"radius": 0.5}}, "position": [3, 10, 0], "name": "second"},
        {"dynamic": True, "shape": {"ball": {"radius": 0.5}}, "position": [6, 10, 0], "name": "second", "colour": "red"},
    ],
}


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


@pytest.fixture
def balls(tmp_path):
    path = tmp_path / "balls.json"
    path.write_text(json.dumps(BALLS))
    return path


@pytest.mark.parametrize("coordinates, up", [("rhumb", (0, 1, 0)), ("z-up", (0, 0, 1)), ("unreal", (0, 0, 100))])
def test_a_robot_stands_upright_in_all_coordinates(arm, coordinates, up):
    with rhumb.local(coordinates=coordinates) as scene:
        robot = scene.load(arm)
        assert (robot.name, list(robot.bodies), list(robot.joints)) == ("arm", ["base", "upper", "tip"], ["shoulder", "wrist"])
        scene.advance()
        of = {name: scene.positions[scene.place(body)] for name, body in robot.bodies.items()}
        # The centre of mass of the upper arm is half a metre below its joint, which is two metres up.
        assert of["upper"] == pytest.approx(np.multiply(up, 1.5), abs=0.06 * np.abs(up).max())
        assert of["tip"] == pytest.approx(np.multiply(up, 0.8), abs=0.06 * np.abs(up).max())


def test_what_the_file_says_and_the_scene_has_not_is_listed(arm):
    with rhumb.local() as scene:
        robot = scene.load(str(arm))
        mimic = [note for note in robot.left_out if "mimic" in note]
        assert len(mimic) == 1 and f"{arm}:" in mimic[0]
        assert repr(robot) == f"<rhumb.Loaded \"arm\", 3 bodies, 2 joints, {len(robot.left_out)} notes>"
        position, rotation = robot.frames["upper"]
        assert np.linalg.norm(position) == pytest.approx(0.5, abs=1e-6) and np.linalg.norm(rotation) == pytest.approx(1)


def test_a_robot_is_placed_turned_and_loaded_twice_with_numbers_of_its_own(arm):
    with rhumb.local(coordinates="z-up") as scene:
        one = scene.load(arm)
        half = np.sqrt(0.5)
        other = scene.load(arm, (5, 0, 0), rotation=(0, half, 0, half), group=2)
        third = scene.load(arm, (9, 0, 0), first_joint=100)
        scene.advance()
        assert one.joints == {"shoulder": 0, "wrist": 1} and other.joints == {"shoulder": 2, "wrist": 3}
        assert third.joints == {"shoulder": 100, "wrist": 101}
        # Up of the file points along x.
        assert scene.positions[scene.place(other.bodies["upper"])] == pytest.approx((6.5, 0, 0), abs=0.06)
        assert len(scene) == 9 and not set(one.bodies.values()) & set(other.bodies.values())


def test_the_base_moves_or_stays_as_the_caller_says(arm):
    for base, falls in (("fixed", False), ("free", True)):
        with rhumb.local(coordinates="z-up") as scene:
            robot = scene.load(arm, (0, 0, 5), base=base)
            for _ in range(60):
                scene.advance()
            assert (scene.positions[scene.place(robot.bodies["base"])][2] < 4) == falls


def test_a_scene_is_made_with_the_gravity_and_the_ticks_of_its_file(balls):
    scene, file = rhumb.load(balls)
    with scene:
        assert file.name == "balls" and list(file.bodies) == ["body 0", "second", "second (2)"]
        assert [note for note in file.left_out if "colour" in note] == file.left_out
        for _ in range(120):
            scene.advance()
        # A second of a fall at 3 m/s².
        assert scene.positions[scene.place(file.bodies["second"])] == pytest.approx((3, 8.5, 0), abs=0.1)
    scene, file = rhumb.load(balls, rhumb.serve, quiet=True, gravity=(0, 0, 0), tolerance=0.01)
    with scene:
        assert scene.address and any("gravity" in note for note in file.left_out)


def test_gravity_and_ticks_that_a_scene_does_not_take_are_listed(balls):
    with rhumb.local(coordinates="z-up") as scene:
        notes = scene.load(balls).left_out
        assert any(note.startswith("gravity [0, 0, -3]") for note in notes), notes
        assert any(note.startswith("a step of 0.008333 s in 2 parts") for note in notes), notes


def test_a_wrong_file_is_an_error_that_names_the_place_and_adds_nothing(tmp_path, arm):
    bad = tmp_path / "bad.urdf"
    with rhumb.local() as scene:
        for text, words in (
            (ARM[:300], "bad.urdf"),
            (ARM.replace('value="2"', 'value="nan"'), "bad.urdf:4"),
            (ARM.replace('child link="tip"', 'child link="upper"'), "hangs on itself"),
            ("<sdf/>", "URDF"),
        ):
            bad.write_text(text)
            with pytest.raises(rhumb.InvalidError, match=words):
                scene.load(bad)
        with pytest.raises(rhumb.InvalidError, match="no such file"):
            scene.load(tmp_path / "nothing.xml")
        for options, words in (
            ({"base": "loose"}, "base is"),
            ({"group": 32}, "group is 32"),
            ({"density": -1}, "density is -1"),
            ({"rotation": (0, 0, 0, 0)}, "rotation is"),
            ({"first_joint": 4_294_967_295}, "first_joint is 4294967295"),
        ):
            with pytest.raises(rhumb.InvalidError, match=words):
                scene.load(arm, **options)
        with pytest.raises(TypeError, match="lossy"):
            scene.load(arm, lossy=True)
        scene.advance()
        assert len(scene) == 0
    with pytest.raises(rhumb.InvalidError, match="no such file"):
        rhumb.load(pathlib.Path("nothing.urdf"))
    for folder in (tmp_path, str(tmp_path), "."):
        with pytest.raises(rhumb.InvalidError, match="is a folder"):
            rhumb.load(folder)

WALKER = """<mujoco model="walker">
  <option timestep="0.005"/>
  <default><geom type="capsule" size="0.06"/><joint damping="5" stiffness="10" limited="true"/></default>
  <worldbody>
    <geom type="plane" size="10 10 1"/>
    <body name="torso" pos="0 0 1.5"><freejoint/>
      <geom fromto="0 -.07 0 0 .07 0" size=".07"/>
      <body name="waist" pos="-.01 0 -.26">
        <joint name="abdomen_z" pos="0 0 .065" axis="0 0 1" range="-45 45" stiffness="20"/>
        <joint name="abdomen_y" pos="0 0 .065" axis="0 1 0" range="-75 30"/>
        <geom fromto="0 -.06 0 0 .06 0"/>
        <body name="pelvis" pos="0 0 -.165">
          <joint name="abdomen_x" pos="0 0 .1" axis="1 0 0" range="-35 35"/>
          <geom fromto="-.02 -.07 0 -.02 .07 0" size=".09"/>
          <body name="thigh" pos="0 -.1 -.04">
            <joint name="hip_x" axis="1 0 0" range="-25 5"/>
            <joint name="hip_z" axis="0 0 1" range="-60 35"/>
            <joint name="hip_y" axis="0 1 0" range="-110 20" stiffness="20"/>
            <geom fromto="0 0 0 0 .01 -.34"/>
            <body name="shin" pos="0 .01 -.403">
              <joint name="knee" pos="0 0 .02" axis="0 -1 0" range="-160 2" damping="0.2" stiffness="1"/>
              <geom fromto="0 0 0 0 0 -.3" size=".049"/>
              <body name="foot" pos="0 0 -.39">
                <joint name="ankle_y" pos="0 0 .08" axis="0 1 0" range="-50 50" damping="0.2" stiffness="6"/>
                <joint name="ankle_x" pos="0 0 .04" axis="1 0 .5" range="-50 50" damping="0.2" stiffness="3"/>
                <geom fromto="-.07 -.02 0 .14 -.04 0" size=".027"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def capsule_mass(length, radius, density=1000.0):
    return density * np.pi * radius**2 * (length + 4.0 / 3.0 * radius)


def walker_masses():
    """Kilograms by name; the foot has two joints that are no one, and gives a tenth to the light body between them."""
    masses = {
        "torso": capsule_mass(0.14, 0.07),
        "waist": capsule_mass(0.12, 0.06),
        "pelvis": capsule_mass(0.14, 0.09),
        "thigh": capsule_mass(np.hypot(0.01, 0.34), 0.06),
        "shin": capsule_mass(0.3, 0.049),
    }
    foot = capsule_mass(np.hypot(0.21, 0.02), 0.027)
    return {**masses, "foot before ankle_y": 0.1 * foot, "foot": 0.9 * foot}


def test_a_limp_robot_of_light_parts_and_stiff_joints_falls_and_gains_no_energy(tmp_path):
    path = tmp_path / "walker.xml"
    path.write_text(WALKER)
    scene, robot = rhumb.load(path, coordinates="z-up")
    with scene:
        masses = walker_masses()
        assert masses.keys() == robot.bodies.keys() - {name for name in robot.bodies if name.startswith("geom")}
        mass = np.array(list(masses.values()))
        ids = [robot.bodies[name] for name in masses]
        energies = []
        for _ in range(400):
            scene.advance()
            rows = [scene.place(body) for body in ids]
            heights = scene.positions[rows][:, 2]
            speeds = np.linalg.norm(scene.linear_velocities[rows], axis=1)
            energies.append((mass @ (0.5 * speeds**2), 9.81 * (mass @ heights)))
        # Springs rest at the start, so that there is the height alone, which the turns of parts take a share of.
        whole = sum(energies[0])
        most = max(sum(energy) for energy in energies)
        # The engine may err by a twentieth where joints meet their limits; a robot that flies apart gains many times that.
        assert most < 1.05 * whole, (most, whole)
        assert max(moving for moving, _ in energies) > 0.3 * whole, "it falls"
        heights = [scene.positions[scene.place(robot.bodies[name])][2] for name in ("torso", "pelvis", "foot")]
        assert all(-0.2 < height < 1.6 for height in heights), heights
