"""Refusals of the server raise at the next advance or poll."""

import pickle
import re

import numpy as np
import pytest

import rhumb


def test_a_refusal_raises_at_the_next_advance_and_the_one_after_goes_on(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 5, 0))
    number = scene.remove(77)
    scene.remove_joint(9)
    with pytest.raises(rhumb.RefusedError, match="no body 77") as raised:
        scene.advance()
    error = raised.value
    assert (error.number, error.body, error.reason) == (number, 77, "unknown body")
    assert "no body 77" in error.text and f"command {number}" in str(error)
    assert [refusal.reason for refusal in error.refusals] == ["unknown body", "unknown joint"]
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.refusals) == (str(error), error.refusals)
    # The tick is done, its view is there, and the next one continues.
    assert scene.time == (1, 0.0) and ball in scene
    assert scene.advance() == 2
    assert scene.positions[scene.place(ball)][1] < 5
    kinds = [event.kind for event in scene.events()]
    assert kinds.count("command refused") == 2


def test_an_advance_of_many_ticks_does_all_of_them_and_raises_once(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 50, 0))
    scene.remove(77)
    with pytest.raises(rhumb.RefusedError, match="no body 77") as raised:
        scene.advance(ticks=10)
    assert len(raised.value.refusals) == 1 and raised.value.left_out == 0
    assert scene.time == (10, 0.0)
    # Refusals of different ticks come together: at depth 1, the answers of the last tick come with the next one.
    for number in range(1_500):
        scene.remove_joint(number)
    with pytest.raises(rhumb.RefusedError) as raised:
        scene.advance(ticks=20, depth=1)
    assert (len(raised.value.refusals), raised.value.left_out) == (1_024, 476)
    assert scene.advance(ticks=5) == 35
    assert ball in scene


def test_a_refused_body_raises_with_its_id_and_is_nowhere(scene):
    scene.advance()
    # As many bodies as are swept, and one more.
    swept = scene.add_bodies(rhumb.Shape.ball(0.1), [(3 * i, 50, 0) for i in range(65)], swept=True)
    with pytest.raises(rhumb.RefusedError) as raised:
        scene.advance()
    assert raised.value.body == swept[64] and raised.value.reason == "too many swept"
    assert "64" in raised.value.text
    assert swept[64] not in scene
    with pytest.raises(IndexError, match="None is the place of no body"):
        scene.positions[scene.place(int(swept[64]))]
    with pytest.raises(rhumb.NotInViewError, match=f"body {swept[64]} is not in the view"):
        scene.error_bound(int(swept[64]))
    with pytest.raises(rhumb.NotInViewError):
        scene.places(swept)
    assert len(scene.places(swept[:64])) == 64


def test_a_free_running_scene_raises_at_a_poll(server):
    with server.connect().join("polled-refusals", stepping="free running") as scene:
        scene.remove(77)
        scene.flush()
        with pytest.raises(rhumb.RefusedError, match="no body 77"):
            while True:
                scene.idle(0.01)
                scene.poll()
        scene.poll()


def test_a_denied_authority_raises_too(server):
    with server.connect().join("authority-refusals") as scene:
        ball = scene.add_body(rhumb.Shape.ball(0.5))
        scene.advance()
        scene.take_authority(ball)
        with pytest.raises(rhumb.RefusedError, match="not kinematic") as raised:
            while True:
                scene.advance()
        assert (raised.value.number, raised.value.body, raised.value.reason) == (None, ball, "not kinematic")
        with pytest.raises(rhumb.InvalidError, match="257"):
            scene.take_authority(np.arange(1, 258, dtype=np.uint64))


def test_a_second_request_for_authority_waits_for_the_answer_to_the_first(server):
    with server.connect().join("authority-twice") as scene:
        lift = scene.add_body(rhumb.Shape.ball(0.5), kind="kinematic")
        scene.advance()
        scene.take_authority(lift)
        with pytest.raises(rhumb.InvalidError, match="unanswered: wait for the event"):
            scene.take_authority(lift)
        while "authority granted" not in [event.kind for event in scene.events()]:
            scene.idle(0.001)
        for numbers, words in (
            (dict(position=(0, 2e5, 0)), ("position", "200000 m", "100000 m")),
            (dict(position=(0, float("nan"), 0)), ("position", "NaN", "100000 m")),
            (dict(position=(0, 0, 0), rotation=(0, 0, 0, 2)), ("length 2", "unit length")),
            (dict(position=(0, 0, 0), linear=(0, 1e6, 0)), ("velocity", "1000000 m/s")),
        ):
            with pytest.raises(rhumb.InvalidError) as raised:
                scene.publish(lift, **numbers)
            for word in (f"state of body {lift}", *words):
                assert word in str(raised.value), str(raised.value)
        scene.take_authority([])


def test_the_advice_of_a_refusal_names_no_call_that_python_lacks(scene):
    floor = scene.add_body(rhumb.Shape.cuboid(1, 1, 1), (0, 0, 0), "fixed")
    scene.apply_impulse(floor, (0, 1, 0))
    with pytest.raises(rhumb.RefusedError, match="cannot be pushed.*dynamic.*kinematic") as raised:
        scene.advance()
    for word in re.findall(r"\w+_\w+", raised.value.text):
        assert hasattr(rhumb.Scene, word), word


def test_a_program_that_reads_events_may_ask_for_quiet(server):
    with server.connect().join("quiet-refusals", refusals="events") as scene:
        number = scene.remove(77)
        scene.advance()
        [refused] = [event for event in scene.events() if event.kind == "command refused"]
        assert (refused.number, refused.body) == (number, 77)


@pytest.mark.parametrize(
    "wrong, words",
    [
        (lambda scene: scene.add_body(rhumb.Shape.ball(-1)), ("radius", "-1 m", "0.001 to 10000 m")),
        (lambda scene: scene.add_body(rhumb.Shape.cuboid(1, 0, 1)), ("along y", "0 m", "0.001 to 10000 m")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), (0, 2e5, 0)), ("position", "200000 m", "100000 m")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), (0, float("nan"), 0)), ("position", "NaN", "100000 m")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), rotation=(0, 0, 0, 2)), ("length 2", "unit length")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), mass=0), ("mass", "0 kg", "0.001 to 1000000 kg")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), mass=1, moments=(1e-9, 1, 1)), ("moment", "1e-9", "1e-6 to 1e8")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), moments=(1, 1, 1)), ("moments", "mass")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), damping=(0, -1)), ("angular damping", "-1", "0 to 1000")),
        (lambda scene: scene.add_body(rhumb.Shape.mesh(np.eye(3), [(0, 1, 2)])), ("volume", "fixed")),
        (lambda scene: rhumb.Shape.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), ("3", "4 to")),
        (lambda scene: rhumb.Shape.mesh(np.eye(3), [(0, 1, 3)]), ("point of a triangle is 3", "0 to 2")),
        (lambda scene: rhumb.Shape.heights(np.zeros((1, 5))), ("rows", "1", "2 to")),
        (lambda scene: rhumb.Shape.heights(np.zeros((3, 3)), 0.0), ("spacing", "0 m", "0.001")),
        (lambda scene: scene.add_joint(1, rhumb.Joint("revolute", 1, 2, limits={3: (0, 9)})), ("limit", "9 rad", "6.28")),
        (lambda scene: scene.add_joint(1, rhumb.Joint("rope", 1, 2, length=0)), ("length of a rope", "0 m")),
        (lambda scene: scene.add_joint(1, rhumb.Joint("fixed", 1, 1)), ("itself",)),
        (lambda scene: rhumb.Joint("revolute", 1, 2, limits={7: (0, 1)}), ("axis", "7", "0 to 5")),
        (lambda scene: rhumb.Joint("revolute", 1, 2, limits={4: (0, 1)}), ("limits", "axis 4", "free")),
        (lambda scene: scene.add_joint(1, rhumb.Joint("revolute", 1, 2, motors={1: (0, 1, 0, 1, None)})), ("motors", "axis 1", "free")),
        (lambda scene: rhumb.connect("localhost"), ("trust", "fingerprint", "PEM")),
        (lambda scene: scene.set_gravity((0, -1e4, 0)), ("gravity", "-10000", "1000 m/s²")),
        (lambda scene: scene.take_authority(1, tolerance=0), ("tolerance of 0 m", "0.001 m to 10 m")),
        (lambda scene: scene.set_lead_ticks(-1), ("-1", "0 to 3600")),
        (lambda scene: scene.advance(depth=65), ("depth", "65", "0 to 64")),
        (lambda scene: scene.query([rhumb.Query.ray((0, 1, 0), (0, 0, 0))]), ("ray is zero", "projection")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), mass=1, moments=(1, 1, 3)), ("3", "0 to 2", "sum")),
        (lambda scene: scene.idle(-1), ("-1", "0 to 1e19")),
        (lambda scene: scene.advance(ticks=0), ("ticks", "0", "1")),
        (lambda scene: scene.query([rhumb.Query.ray((0, 0, 0), (0, 1, 0), hits=65)]), ("65", "1 to 64")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), tolerance_exponent=4), ("4", "-3 to 3")),
        (lambda scene: scene.add_body(rhumb.Shape.ball(1), locked_axes=64), ("64", "63")),
    ],
)
def test_an_error_names_the_value_and_its_range(scene, wrong, words):
    with pytest.raises(rhumb.InvalidError) as raised:
        wrong(scene)
    for word in words:
        assert word in str(raised.value), str(raised.value)


def test_no_answer_of_a_scene_indexes_all_bodies(scene):
    scene.add_bodies(rhumb.Shape.ball(0.5), [(3 * i, 5, 0) for i in range(4)])
    scene.advance()
    for call in (scene.place, scene.places, scene.error_bound, lambda body: scene.tick_error_bound(body, 1)):
        for wrong in (77, None, True, -1, 1.0, [77]):
            with pytest.raises((rhumb.InvalidError, TypeError)):
                call(wrong)


def test_contacts_are_those_of_now(scene):
    floor = scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 0.6, 0), material=(0.5, 0.0, 1000.0))
    scene.report_events(ball, contacts=True)
    scene.advance()
    assert scene.contacts() == []
    scene.advance(ticks=60)
    [contact] = scene.contacts(ball)
    assert (contact.body, contact.other) == (ball, floor) and contact.normal[1] == pytest.approx(1, abs=1e-3)
    [same] = scene.contacts(floor)
    assert same.other == ball and same.normal[1] == pytest.approx(-1, abs=1e-3)
    scene.set_pose(ball, (0, 5, 0))
    scene.advance(ticks=2)
    assert scene.contacts(ball) == []


@pytest.mark.parametrize("sleep", [None, "never"])
def test_contacts_of_a_late_member_are_those_of_now(sleep):
    server = rhumb.LocalServer()
    first = server.connect().join("late")
    first.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    box = first.add_body(rhumb.Shape.cuboid(0.5, 0.5, 0.5), (0, 0.5, 0), sleep=sleep)
    first.report_events(box, contacts=True)
    first.advance(ticks=90)
    late = server.connect().join("late")
    late.poll()
    [contact] = late.contacts(box)
    assert contact.normal[1] == pytest.approx(1, abs=1e-3)
    first.report_events(box)
    first.advance()
    late.poll()
    assert first.contacts(box) == late.contacts(box) == []
    first.report_events(box, contacts=True)
    first.advance()
    late.poll()
    assert len(first.contacts(box)) == len(late.contacts(box)) == 1
    first.remove(box)
    first.advance()
    late.poll()
    assert first.contacts() == late.contacts() == []
