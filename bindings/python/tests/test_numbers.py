"""Numbers that no argument can have: refused at once, by name and limits."""

import re

import numpy as np
import pytest

import rhumb

BEYOND = 10**400
MASKED = np.ma.masked_array([[0.0, 50.0, 0.0]], mask=[[0, 1, 0]])
NUMBERS = [
    (lambda scene: scene.add_bodies(rhumb.Shape.ball(1), MASKED), "positions is .*without masked entries"),
    (lambda scene: scene.set_gravity(MASKED[0]), "gravity is .*without masked entries"),
    (lambda scene: scene.remove(np.ma.masked_array([1, 2], mask=[0, 1])), "body is .*without masked entries"),
    (lambda scene: scene.add_bodies(rhumb.Shape.ball(1), [[0, 3j, 0]]), "positions is .*real, and not complex"),
    (lambda scene: scene.set_gravity(np.array([0, 1 + 0j, 0])), "gravity is .*real, and not complex"),
    (lambda scene: scene.publish([1, 1], (0, 0, 0)), "body 1 is given twice"),
    (lambda scene: rhumb.Shape.ball(BEYOND), "radius is 1000.*must be finite"),
    (lambda scene: rhumb.Shape.ball(1e39), "radius is 1e.39, and must be finite"),
    (lambda scene: rhumb.Shape.ball(-1), "radius of a ball is -1 m, and must be 0.001 to"),
    (lambda scene: rhumb.Shape.capsule(0, 1), "half height .* is 0 m"),
    (lambda scene: rhumb.Shape.half_space((0, 0, 2)), "has the length 2"),
    (lambda scene: rhumb.Shape.hull([(0, 0, BEYOND)] * 4), "points is .*must be finite"),
    (lambda scene: rhumb.Shape.hull([("a", 0, 0)] * 4), "points is .*'a'.*must be finite"),
    (lambda scene: rhumb.Shape.heights([[0, 1], [0, BEYOND]]), "heights is .*must be finite"),
    (lambda scene: rhumb.Query.ray((0, 0, 0), (0, 1, 0), hits=0), "hits is 0, and must be 1 to 64"),
    (lambda scene: rhumb.Query.ray((0, 0, 0), (0, 1, 0), hits=-1), "hits is -1, and must be 1 to 64"),
    (lambda scene: rhumb.Query.projection((0, 0, 0), -1), "distance of a projection is -1 m"),
    (lambda scene: rhumb.Query.ray((0, 0, 0), (0, 1, 0)).among(groups=2**32), "groups is 4294967296"),
    (lambda scene: rhumb.Character(mass=-1), "mass of a character is -1 kg"),
    (lambda scene: rhumb.Character(step=(1, BEYOND)), "step is"),
    (lambda scene: rhumb.Wheel((0, 0, 0), -1), "radius of a wheel is -1 m"),
    (lambda scene: rhumb.WheelInput(float("nan")), "steering of a wheel is NaN"),
    (lambda scene: rhumb.Joint("revolute", 1, 2, limits={3: (0, BEYOND)}), "limits is .*by axes 0 to 5"),
    (lambda scene: rhumb.Joint("revolute", 1, 2, motors={-1: (0, 0, 0, 0, None)}), "motors is .*by axes 0 to 5"),
    (lambda scene: rhumb.Joint("generic", 1, 2, locked_axes=300), "locked_axes is 300.*0 to 63"),
    (lambda scene: rhumb.Joint("fixed", 1, 2, breaks_at=(BEYOND, 1)), "breaks_at is"),
    (lambda scene: rhumb.Joint("rope", 1, 2, length=-1), "is -1 m, and must be"),
    (lambda scene: rhumb.Joint("fixed", 10**30, 2), "body is 1000.*whole numbers"),
    (lambda scene: rhumb.connect("a:1", fingerprint="a" * 64, timeout=BEYOND), "timeout is 1000"),
    (lambda scene: scene.advance(-1), "ticks is -1, and must be 1 to"),
    (lambda scene: scene.advance(1, -1), "depth is -1, and must be 0 to"),
    (lambda scene: scene.wait(2**40), "depth is 1099511627776, and must be 0 to"),
    (lambda scene: scene.idle(BEYOND), "duration is 1000"),
    (lambda scene: scene.tick_error_bound(1, -1), "tick is -1, and must be 0 to"),
    (lambda scene: scene.set_lead_ticks(BEYOND), "ticks is 1000"),
    (lambda scene: scene.remove_joint(-1), "id is -1, and must be 0 to 65535"),
    (lambda scene: scene.take_authority(1, BEYOND), "tolerance is 1000"),
    (lambda scene: scene.jump(1, BEYOND), "speed is 1000"),
    (lambda scene: scene.report_events(1, force=BEYOND), "force is 1000"),
    (lambda scene: scene.remove(10**30), "body is 1000.*whole numbers"),
    (lambda scene: scene.contacts(4711), "body 4711 is not in the view"),
    (lambda scene: scene.set_gravity((0, 0, BEYOND)), "gravity is .*must be finite"),
    (lambda scene: scene.set_gravity((0, 0, 1e39)), "gravity is 1e39, and must be finite, and from -3.4e38"),
    (lambda scene: scene.add_bodies(rhumb.Shape.ball(1), np.array([[0, -2e300, 0]])), "positions is -2e300, and must be finite"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), mass=BEYOND), "mass is 1000"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), moments=(1, 2)), "moments is 2 numbers, and must be 3"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), groups=(-1, 1)), "groups is .*32 bits"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), tolerance_exponent=999), "tolerance_exponent is 999.*-3 to 3"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), locked_axes=-1), "locked_axes is -1.*0 to 63"),
    (lambda scene: scene.add_body(rhumb.Shape.ball(1), sleep=(BEYOND, 1, 1)), "sleep is .*must be"),
]


@pytest.mark.parametrize("place", range(len(NUMBERS)))
def test_a_wrong_number_is_refused_at_once_with_its_name_and_limits(scene, place):
    call, expected = NUMBERS[place]
    with pytest.raises(rhumb.InvalidError, match=expected):
        call(scene)


TRUTHS = [
    ("ticks", lambda scene: scene.advance(True)),
    ("ticks", lambda scene: scene.advance(np.True_)),
    ("depth", lambda scene: scene.advance(1, False)),
    ("depth", lambda scene: scene.wait(True)),
    ("duration", lambda scene: scene.idle(False)),
    ("tick", lambda scene: scene.tick_error_bound(1, True)),
    ("ticks", lambda scene: scene.set_lead_ticks(True)),
    ("cells", lambda scene: scene.take_cells({(0, 0, 0): True})),
    ("cells", lambda scene: scene.take_cells({(0, True, 0): 0.1})),
    ("bands", lambda scene: scene.take_cells_around((0, 0, 0), [(5, True)])),
    ("id", lambda scene: scene.remove_joint(True)),
    ("body", lambda scene: scene.remove(True)),
    ("body", lambda scene: scene.remove([1, True])),
    ("body", lambda scene: scene.places(np.array([True]))),
    ("body", lambda scene: True in scene),
    ("tolerance", lambda scene: scene.take_authority(1, True)),
    ("speed", lambda scene: scene.jump(1, True)),
    ("force", lambda scene: scene.report_events(1, force=True)),
    ("gravity", lambda scene: scene.set_gravity((0, True, 0))),
    ("gravity", lambda scene: scene.set_gravity(np.array([True, False, True]))),
    ("force", lambda scene: scene.apply_force(1, [0, np.True_, 0])),
    ("positions", lambda scene: scene.add_bodies(rhumb.Shape.ball(1), [(0, 0, 0), (0, False, 0)])),
    ("position", lambda scene: scene.add_body(rhumb.Shape.ball(1), np.array([0, True, 0], dtype=object))),
    ("mass", lambda scene: scene.add_body(rhumb.Shape.ball(1), mass=True)),
    ("material", lambda scene: scene.add_body(rhumb.Shape.ball(1), material=(True, 0, 1))),
    ("groups", lambda scene: scene.add_body(rhumb.Shape.ball(1), groups=(True, 1))),
    ("locked_axes", lambda scene: scene.add_body(rhumb.Shape.ball(1), locked_axes=True)),
    ("tolerance_exponent", lambda scene: scene.add_body(rhumb.Shape.ball(1), tolerance_exponent=True)),
    ("sleep", lambda scene: scene.add_body(rhumb.Shape.ball(1), sleep=(True, 1, 1))),
    ("sleep", lambda scene: scene.add_body(rhumb.Shape.ball(1), sleep=False)),
    ("radius", lambda scene: rhumb.Shape.ball(True)),
    ("heights", lambda scene: rhumb.Shape.heights([[0, True], [0, 0]])),
    ("triangles", lambda scene: rhumb.Shape.mesh(np.eye(3), [(0, True, 2)])),
    ("hits", lambda scene: rhumb.Query.ray((0, 0, 0), (0, 1, 0), hits=True)),
    ("groups", lambda scene: rhumb.Query.ray((0, 0, 0), (0, 1, 0)).among(groups=True)),
    ("limits", lambda scene: rhumb.Joint("revolute", 1, 2, limits={3: (False, 1)})),
    ("limits", lambda scene: rhumb.Joint("revolute", 1, 2, limits={True: (0, 1)})),
    ("motors", lambda scene: rhumb.Joint("revolute", 1, 2, motors={3: (0, True, 0, 1, None)})),
    ("breaks_at", lambda scene: rhumb.Joint("fixed", 1, 2, breaks_at=(True, 1))),
    ("length", lambda scene: rhumb.Joint("rope", 1, 2, length=True)),
    ("mass", lambda scene: rhumb.Character(mass=True)),
    ("step", lambda scene: rhumb.Character(step=(True, 1))),
    ("radius", lambda scene: rhumb.Wheel((0, 0, 0), True)),
    ("timeout", lambda scene: rhumb.connect("a:1", fingerprint="a" * 64, timeout=True)),
    ("density", lambda scene: scene.load("none.urdf", density=True)),
    ("group", lambda scene: scene.load("none.urdf", group=True)),
    ("tolerance", lambda scene: rhumb.local(tolerance=True)),
    ("substeps", lambda scene: rhumb.local(substeps=True)),
    ("resume_within", lambda scene: rhumb.local(resume_within=True)),
]


@pytest.mark.parametrize("place", range(len(TRUTHS)))
def test_a_truth_value_is_no_number(scene, place):
    name, call = TRUTHS[place]
    with pytest.raises(rhumb.InvalidError, match=f"{name} is .*(True|False).*no truth value"):
        call(scene)


def own_list():
    """A list that has itself."""
    own = []
    own.append(own)
    return own


def test_a_list_that_has_itself_is_refused_like_any_other_wrong_value(scene):
    own = own_list()
    by_key = {}
    by_key[3] = by_key
    ball = rhumb.Shape.ball(1)
    for call, error, expected in (
        (lambda: scene.set_gravity(own), rhumb.InvalidError, "gravity is [[...]], and must be finite"),
        (lambda: scene.advance(own), TypeError, "argument 'ticks'"),
        (lambda: scene.remove(own), rhumb.InvalidError, "body is [[...]], and must be whole numbers"),
        (lambda: scene.add_bodies(ball, own), rhumb.InvalidError, "positions is [[...]], and must be finite"),
        (lambda: scene.add_body(ball, sleep=own), rhumb.InvalidError, "sleep is [[...]], and must be"),
        (lambda: scene.add_body(ball, groups=own), TypeError, "argument 'groups'"),
        (lambda: rhumb.Joint("revolute", 1, 2, limits=by_key), TypeError, "argument 'limits'"),
        (lambda: rhumb.Shape.hull([own] * 3), rhumb.InvalidError, "points is [[[...]], "),
    ):
        with pytest.raises(error, match="^" + re.escape(expected)):
            call()


def test_rows_of_different_lengths_are_no_ids(scene):
    with pytest.raises(rhumb.InvalidError, match="^body is .* whole numbers$"):
        scene.remove([[1, 2], [3]])


class Foreign:
    """An array of another library: NumPy can read it, and its dtype is of its own."""

    def __init__(self, values, dtype):
        self.values, self.dtype = values, dtype

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.values, dtype)


class Kind:
    def __init__(self, kind):
        self.kind = kind


def test_an_array_of_another_library_is_read_by_its_numbers(scene):
    for dtype in ("float32", object(), None, Kind(7), Kind("f"), Kind("O")):
        ball = scene.add_body(rhumb.Shape.ball(1), Foreign([1.0, 2.0, 3.0], dtype))
        scene.advance()
        assert scene.positions[scene.place(ball)].tolist() == pytest.approx([1, 2, 3], abs=0.1)
        scene.remove(ball)


def test_wrong_options_of_a_new_scene_are_named_with_their_limits(server):
    connection = server.connect()
    for options, expected in (
        ({"ticks_per_second": -1}, "ticks_per_second is -1, and must be 1 to 1000"),
        ({"substeps": 2**40}, "substeps is 1099511627776, and must be 1 to 16"),
        ({"publish_interval": -1}, "publish_interval is -1, and must be at least 1"),
        ({"delay_ticks": BEYOND}, "delay_ticks is 1000"),
        ({"tolerance": BEYOND}, "tolerance is 1000"),
        ({"resume_within": BEYOND}, "resume_within is 1000"),
    ):
        with pytest.raises(rhumb.InvalidError, match=expected):
            connection.join("numbers", **options)


def test_a_length_that_some_unit_allows_is_refused_where_its_unit_is_known(server):
    far = rhumb.Shape.ball(50_000)
    with server.connect().join("metres") as scene:
        with pytest.raises(rhumb.InvalidError, match="radius of a ball is 50000 m"):
            scene.add_body(far)
    with server.connect().join("centimetres", coordinates="unreal") as scene:
        scene.add_body(far)


def test_an_argument_of_another_type_is_named(scene):
    for name, call in (
        ("radius", lambda: rhumb.Shape.ball("x")),
        ("mass", lambda: scene.add_body(rhumb.Shape.ball(1), mass="x")),
        ("gravity_scale", lambda: scene.add_body(rhumb.Shape.ball(1), gravity_scale=None)),
        ("sensor", lambda: scene.add_body(rhumb.Shape.ball(1), sensor="x")),
        ("ticks", lambda: scene.advance(1.5)),
    ):
        with pytest.raises(TypeError, match=f"argument '{name}'"):
            call()
