"""Misuse in Python: each is an exception of its kind, and none does harm."""

import os
import signal
import threading

import numpy as np
import pytest

import rhumb


def test_connecting_to_what_is_not_there_or_not_trusted(server):
    with pytest.raises(rhumb.ConnectError):
        rhumb.connect("no port", fingerprint=server.fingerprint)
    with pytest.raises(rhumb.InvalidError):
        rhumb.connect(server.address, fingerprint="17")
    with pytest.raises(rhumb.InvalidError):
        rhumb.connect(server.address)
    with pytest.raises(rhumb.InvalidError):
        rhumb.connect(server.address, fingerprint=server.fingerprint, roots="roots.pem")
    with pytest.raises(rhumb.ConnectError):
        rhumb.connect(server.address, roots="/there/is/no/such/file.pem")
    other = ("b" if server.fingerprint[0] == "a" else "a") + server.fingerprint[1:]
    with pytest.raises(ConnectionError, match="certificate"):
        rhumb.connect(server.address, fingerprint=other)
    for timeout in (-1, float("nan"), float("inf"), 1e300):
        with pytest.raises(ValueError):
            server.connect(timeout=timeout)
    with pytest.raises(TypeError):
        rhumb.connect(None, fingerprint=server.fingerprint)
    # A Unix socket has no certificate, and asks for no trust.
    with pytest.raises(rhumb.ConnectError):
        rhumb.connect("unix:/there/is/no/such/socket")
    for trust in ({"fingerprint": server.fingerprint}, {"roots": "roots.pem"}):
        with pytest.raises(rhumb.InvalidError, match="left out for a Unix socket"):
            rhumb.connect("unix:/there/is/no/such/socket", **trust)


def test_joining_what_cannot_be_joined(server):
    connection = server.connect()
    for options in (
        {"coordinates": "polar"},
        {"condition": "perhaps"},
        {"stepping": "backwards"},
        {"tolerance": float("nan")},
        {"gravity": (0, 0)},
        {"ticks_per_second": 0},
        {"resume_within": -1},
        {"refusals": "never"},
        {"lead_ticks": float("nan")},
        {"delay_ticks": -1},
    ):
        with pytest.raises(rhumb.InvalidError):
            connection.join("wrong", **options)
    for name in ("", "a name with blanks"):
        with pytest.raises(rhumb.InvalidError):
            connection.join(name)
    assert not connection.closed
    connection.join("right").close()
    with server.connect(token="no\ntoken") as connection:
        with pytest.raises(rhumb.InvalidError):
            connection.join("right")
        assert not connection.closed
    connection = server.connect()
    with pytest.raises(PermissionError):
        connection.join("nowhere", condition="join")
    assert connection.closed
    with pytest.raises(rhumb.ClosedError):
        connection.join("again")
    with server.connect() as unused:
        pass
    unused.close()
    with pytest.raises(rhumb.ClosedError):
        unused.join("late")


CALLS = [
    lambda scene: scene.add_body(rhumb.Shape.ball(1)),
    lambda scene: scene.add_bodies(rhumb.Shape.ball(1), [(0, 0, 0)]),
    lambda scene: scene.remove(1),
    lambda scene: scene.set_pose(1, (0, 0, 0)),
    lambda scene: scene.set_velocity(1, (0, 0, 0)),
    lambda scene: scene.apply_force(1, (0, 0, 0)),
    lambda scene: scene.apply_torque(1, (0, 0, 0)),
    lambda scene: scene.apply_impulse(1, (0, 0, 0)),
    lambda scene: scene.apply_torque_impulse(1, (0, 0, 0)),
    lambda scene: scene.set_gravity((0, 0, 0)),
    lambda scene: scene.sleep(1),
    lambda scene: scene.wake(1),
    lambda scene: scene.report_events(1),
    lambda scene: scene.set_character(1, rhumb.Character()),
    lambda scene: scene.set_vehicle(1, [rhumb.Wheel((0, 0, 0), 0.3)]),
    lambda scene: scene.clear_locomotion(1),
    lambda scene: scene.jump(1, 1),
    lambda scene: scene.set_wheels(1, [rhumb.WheelInput()]),
    lambda scene: scene.remove_unused_shapes(),
    lambda scene: scene.flush(),
    lambda scene: scene.advance(),
    lambda scene: scene.wait(),
    lambda scene: scene.poll(),
    lambda scene: scene.idle(0),
    lambda scene: scene.time,
    lambda scene: scene.bodies,
    lambda scene: scene.positions,
    lambda scene: scene.rotations,
    lambda scene: scene.linear_velocities,
    lambda scene: scene.angular_velocities,
    lambda scene: scene.resting,
    lambda scene: scene.changed,
    lambda scene: scene.removed,
    lambda scene: scene.place(1),
    lambda scene: scene.places([1]),
    lambda scene: 1 in scene,
    lambda scene: scene.error_bound(1),
    lambda scene: scene.error_bounds,
    lambda scene: scene.tick_error_bound(1, 1),
    lambda scene: scene.contacts(),
    lambda scene: scene.set_lead_ticks(1),
    lambda scene: scene.cell_grid,
    lambda scene: scene.take_cells({}),
    lambda scene: scene.take_cells_around((0, 0, 0), []),
    lambda scene: scene.cells,
    lambda scene: scene.denied_cells,
    lambda scene: scene.events(),
    lambda scene: scene.query([rhumb.Query.ray((0, 0, 0), (0, 1, 0))]),
    lambda scene: scene.statistics,
    lambda scene: scene.delete(),
    lambda scene: len(scene),
]


def test_every_call_after_close_is_an_error(scene):
    scene.advance()
    scene.close()
    scene.close()
    assert scene.closed
    for call in CALLS:
        with pytest.raises(rhumb.ClosedError):
            call(scene)


def test_wrong_numbers_and_sizes(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5))
    other = scene.add_body(rhumb.Shape.ball(0.5), (5, 0, 0))
    for wrong in (
        lambda: scene.add_body(rhumb.Shape.ball(-1)),
        lambda: scene.add_body(rhumb.Shape.ball(1), (0, float("nan"), 0)),
        lambda: scene.add_body(rhumb.Shape.ball(1), (0, 1)),
        lambda: scene.add_body(rhumb.Shape.ball(1), (0, 1, 2), "liquid"),
        lambda: scene.add_body(rhumb.Shape.ball(1), rotation=(0, 0, 0)),
        lambda: scene.add_body(rhumb.Shape.ball(1), locked_axes=64),
        lambda: scene.add_body(rhumb.Shape.ball(1), tolerance_exponent=4),
        lambda: scene.add_bodies(rhumb.Shape.ball(1), (0, 1, 2)),
        lambda: scene.add_bodies(rhumb.Shape.ball(1), np.zeros((4, 2))),
        lambda: scene.add_bodies(rhumb.Shape.ball(1), np.zeros((4, 3)), linear_velocities=np.zeros((5, 3))),
        lambda: scene.apply_impulse([ball, other], np.zeros((3, 3))),
        lambda: scene.apply_impulse([ball, 0], (0, 1, 0)),
        lambda: scene.apply_impulse([[ball]], (0, 1, 0)),
        lambda: scene.set_gravity(9.81),
        lambda: scene.set_gravity((0, float("inf"), 0)),
        lambda: scene.remove(0),
        lambda: scene.remove(2**63),
        lambda: scene.remove(1.5),
        lambda: scene.remove(float(ball)),
        lambda: scene.remove([ball, 1.5]),
        lambda: scene.remove(np.array([ball, other], dtype=float)),
        lambda: scene.remove(True),
        lambda: scene.set_gravity(np.zeros(1)),
        lambda: scene.advance(ticks=0),
        lambda: scene.idle(-1),
        lambda: scene.places([ball, 77]),
        lambda: scene.error_bound(77),
        lambda: scene.query([]),
        lambda: scene.query([rhumb.Query.ray((0, 0, 0), (0, 1, 0), hits=65)]),
        lambda: rhumb.Query.overlap(rhumb.Shape.half_space((0, 1, 0)), (0, 0, 0)),
        lambda: rhumb.Shape.hull([(0, 0), (1, 1)]),
        lambda: rhumb.Shape.mesh([(0, 0, 0)], [(0, 1, 2)]),
        *(lambda place=place: rhumb.Shape.mesh(np.eye(3), [(0, 1, place)]) for place in (1.5, -1, 2**32 + 2)),
        lambda: rhumb.Shape.heights([1, 2, 3]),
    ):
        with pytest.raises(rhumb.InvalidError) as raised:
            wrong()
        assert str(raised.value)
    for wrong in (
        lambda: scene.add_body("ball"),
        lambda: scene.add_body(rhumb.Shape.ball(1), colour="red"),
        lambda: scene.add_body(None),
        lambda: rhumb.Shape.ball(None),
        lambda: scene.apply_impulse(ball, None),
        lambda: scene.query([None]),
        lambda: scene.remove("ball"),
        lambda: scene.remove(-1),
        lambda: rhumb.Scene(),
    ):
        with pytest.raises((TypeError, ValueError, OverflowError)):
            wrong()
    # After all these errors the scene continues, and nothing of them was queued.
    scene.advance()
    assert set(scene.bodies) == {ball, other}
    assert [event for event in scene.events() if event.kind == "command refused"] == []


def test_numbers_of_joints_and_bodies_that_no_scene_can_have(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5))
    last, beyond = 2**20, 2**20 + 1
    fixed = rhumb.Joint("fixed", ball, last)
    for wrong in (
        *(lambda id=id: scene.add_joint(id, fixed) for id in (65_536, 2**32 - 1)),
        lambda: scene.change_joint(65_536, fixed),
        lambda: scene.remove_joint(65_536),
        lambda: scene.add_joint(1, rhumb.Joint("fixed", ball, beyond)),
        lambda: scene.remove(beyond),
        lambda: scene.remove([ball, beyond]),
        lambda: scene.apply_impulse(7 << 33 | beyond, (0, 1, 0)),
        lambda: scene.take_authority(beyond),
        lambda: scene.query([rhumb.Query.ray((0, 0, 0), (0, 1, 0)).among(excluding=beyond)]),
    ):
        with pytest.raises(rhumb.InvalidError, match="no scene has"):
            wrong()
    # The server knows the last numbers that a scene can have no more than others, and continues.
    refused = [scene.remove(last), scene.remove_joint(65_535)]
    with pytest.raises(rhumb.RefusedError):
        scene.advance()
    assert set(scene.bodies) == {ball}
    assert [event.number for event in scene.events() if event.kind == "command refused"] == refused


def inside_of(scene, call):
    """Runs a call in another thread; returns it, and where its result comes, once that thread is inside the call."""
    while True:
        result = []

        def run():
            while True:
                try:
                    result.append(call())
                except rhumb.BusyError:
                    # This thread may be the one that is refused, while the other one looks whether it is inside.
                    continue
                except rhumb.Error as error:
                    result.append(error)
                return

        thread = threading.Thread(target=run)
        thread.start()
        while thread.is_alive():
            try:
                scene.flush()
            except rhumb.BusyError:
                return thread, result
        thread.join()


def test_a_second_thread_is_refused_at_once_and_does_no_harm(scene):
    thread, result = inside_of(scene, lambda: scene.idle(1))
    for call in [*CALLS, lambda scene: scene.close()]:
        with pytest.raises(rhumb.BusyError):
            call(scene)
    assert thread.is_alive(), "the interpreter runs while a call waits"
    thread.join()
    assert result == [None]
    assert scene.advance() == 1


def test_a_server_that_is_gone_in_the_middle_of_a_call(own_server):
    scene = own_server.connect(timeout=1).join("gone")
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 2, 0))
    scene.advance()
    # The server stands still, so that the call waits; then it is gone.
    os.kill(own_server.process.pid, signal.SIGSTOP)
    thread, result = inside_of(scene, scene.advance)
    os.kill(own_server.process.pid, signal.SIGKILL)
    thread.join()
    assert isinstance(result[0], (rhumb.Timeout, rhumb.EndedError)), result
    # The copies are there still.
    assert scene.positions[scene.place(ball)][1] == pytest.approx(2, abs=0.01)
    scene.close()
    with pytest.raises((rhumb.ConnectError, rhumb.Timeout)):
        own_server.connect(timeout=0.25)


def test_a_deleted_scene_is_gone(scene):
    scene.delete()
    with pytest.raises(rhumb.SceneGoneError):
        scene.advance()
    scene.close()


def test_exceptions_are_of_pythons_own_kinds_too():
    assert issubclass(rhumb.InvalidError, ValueError)
    assert issubclass(rhumb.Timeout, TimeoutError)
    assert issubclass(rhumb.EndedError, ConnectionError)
    own = [value for value in vars(rhumb.errors).values() if getattr(value, "__module__", "") == "rhumb.errors"]
    assert all(issubclass(value, (rhumb.Error, rhumb.Refusal)) for value in own)
