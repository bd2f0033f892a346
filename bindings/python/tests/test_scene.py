"""The promises of a scene: bodies, commands, arrays, events, queries."""

import gc
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

import rhumb


def ball_on_floor(scene):
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    return scene.add_body(rhumb.Shape.ball(0.5), (0, 2, 0))


def test_a_ball_falls_on_the_floor_and_rests_there_within_its_bound(scene):
    ball = ball_on_floor(scene)
    assert scene.advance() == 1
    assert scene.advance(ticks=179) == 180
    at = scene.positions[scene.place(ball)]
    assert np.allclose(at, (0, 0.5, 0), atol=0.05)
    assert scene.error_bound(ball) == pytest.approx(0.05)
    assert scene.time == (180, 0.0)
    assert len(scene) == 2


def test_arrays_have_one_order_and_their_types(scene):
    bodies = scene.add_bodies(rhumb.Shape.ball(0.5), [(x * 2, 0, 0) for x in range(5)], mass=2.0)
    scene.set_gravity((0, 0, 0))
    scene.set_velocity(bodies, [(x, 1, 0) for x in range(5)], (0, 2, 0))
    # A copy begins to move once it would be off by more than the tolerance.
    scene.advance(ticks=10)
    assert scene.bodies.dtype == np.uint64 and scene.bodies.shape == (5,)
    assert scene.positions.dtype == np.float32 and scene.positions.shape == (5, 3)
    assert scene.rotations.shape == (5, 4) and scene.resting.dtype == np.bool_
    places = scene.places(bodies)
    assert np.array_equal(scene.bodies[places], bodies)
    assert np.allclose(scene.linear_velocities[places], [(x, 1, 0) for x in range(5)], atol=0.1)
    assert np.allclose(scene.angular_velocities, (0, 2, 0), atol=0.1)
    assert set(scene.changed) <= set(range(5)) and len(scene.changed) >= 4
    assert scene.error_bound(bodies).shape == (5,)
    # A row of one is a row, and the integers of Python and of NumPy may stand beside each other.
    assert scene.error_bound(bodies[:1]).shape == scene.error_bound([int(bodies[0])]).shape == (1,)
    assert scene.error_bound([int(bodies[0]), bodies[1]]).shape == (2,)
    assert isinstance(scene.error_bound(bodies[0]), float) and isinstance(scene.error_bound(int(bodies[0])), float)
    scene.remove(bodies[:2])
    scene.advance()
    assert len(scene) == 3 and set(scene.removed) == set(bodies[:2])
    assert bodies[0] not in scene and bodies[2] in scene
    # Functions of NumPy add axes as they do to any array, and their rows have places too.
    assert np.expand_dims(scene.positions, 0).shape == np.stack([scene.positions]).shape == (1, 3, 3)
    assert np.atleast_2d(scene.error_bounds).shape == (1, 3) and scene.positions[:, None].shape == (3, 1, 3)
    assert type(scene.positions[0]) is np.ndarray and scene.positions[0][None].shape == (1, 3)


def test_a_body_that_is_not_in_the_view_has_no_place_that_indexes(scene):
    bodies = scene.add_bodies(rhumb.Shape.ball(0.5), [(3 * i, 5, 0) for i in range(4)])
    scene.advance()
    gone, never = int(bodies[1]), 12_345
    scene.remove(gone)
    scene.advance()
    coming = scene.add_body(rhumb.Shape.ball(0.5), (0, 9, 0))
    for body in (gone, coming):
        assert scene.place(body) is None
    positions = scene.positions
    for array in (
        *(positions, scene.rotations, scene.bodies, scene.resting, scene.error_bounds),
        *(positions[:, 1], positions[:], positions * 2, positions - positions[0], -positions, positions.copy()),
        *(np.round(positions, 2), np.linalg.norm(positions, axis=1), np.stack([positions] * 2, axis=1)),
    ):
        with pytest.raises(IndexError, match="None is the place of no body"):
            array[scene.place(gone)]
    for rest in (1, slice(None), slice(0, 2), ...):
        with pytest.raises(IndexError, match="None is the place of no body"):
            positions[scene.place(gone), rest]
    for place in (False, np.False_, np.array(True), slice(True, None), slice(None, True)):
        with pytest.raises(IndexError, match="is the place of no body"):
            positions[place]
    for place in (None, True, np.True_, [0, True], np.array([True, False])):
        for taken in (lambda: np.take(positions, place, axis=0), lambda: positions.take(place, axis=0)):
            with pytest.raises(IndexError, match="is the place of no body"):
                taken()
    for changed in (lambda: np.delete(positions, True, axis=0), lambda: np.insert(positions, True, 0, axis=0)):
        with pytest.raises(IndexError, match="is the place of no body"):
            changed()
    with pytest.raises(IndexError, match="is the place of no body"):
        positions.item(True)
    assert np.array_equal(np.take(positions, [1, 0], axis=0), positions[[1, 0]])
    assert positions.take(1, axis=0).shape == (3,) and positions.item(2, 0) == positions[2][0]
    assert positions[np.array([True, False, True])].shape == (2, 3)
    with pytest.raises(IndexError, match="False is the place of no body"):
        positions[gone in scene]
    for body in (gone, never, coming):
        assert body not in scene
        calls = (lambda body: scene.places([bodies[0], body]), scene.error_bound)
        for call in (*calls, *([scene.place] if body == never else [])):
            with pytest.raises(rhumb.NotInViewError, match=f"^body {body} is not in the view: .*ask first") as raised:
                call(body)
            assert isinstance(raised.value, KeyError) and isinstance(raised.value, rhumb.InvalidError)
            again = pickle.loads(pickle.dumps(raised.value))
            assert str(again) == str(raised.value)
    scene.advance()
    assert scene.bodies[scene.place(coming)] == coming
    for body in bodies[[0, 2, 3]]:
        assert scene.bodies[scene.place(body)] == body


def test_an_array_is_read_only_the_same_when_read_again_and_keeps_its_frame(scene):
    ball = ball_on_floor(scene)
    scene.advance()
    first = scene.positions
    assert first is scene.positions
    assert not first.flags.writeable
    with pytest.raises(ValueError):
        first[0, 0] = 1
    row, kept = first[scene.place(ball)], first.copy()
    for _ in range(60):
        scene.advance()
        assert scene.positions is not first
    assert np.array_equal(first, kept)
    assert row[1] == pytest.approx(2.0, abs=0.01)
    assert scene.positions[scene.place(ball)][1] < 1.5


def test_a_loop_uses_two_arrays_again_and_again(scene):
    ball_on_floor(scene)
    scene.advance()
    seen = set()
    for _ in range(20):
        scene.advance()
        seen.add(scene.positions.__array_interface__["data"][0])
    assert len(seen) <= 2


def test_arrays_outlive_their_scene(server):
    with server.connect().join("outlive", condition="create") as scene:
        ball_on_floor(scene)
        scene.advance()
        positions, part = scene.positions, scene.rotations[:1]
    del scene
    gc.collect()
    assert positions.shape == (2, 3) and np.isfinite(positions).all()
    assert np.allclose(part, (0, 0, 0, 1))


def test_more_bodies_make_larger_arrays(scene):
    scene.set_gravity((0, 0, 0))
    for count in (1, 3, 300):
        before = len(scene)
        grid = [(x % 20 * 2, x // 20 * 2, before) for x in range(count)]
        scene.add_bodies(rhumb.Shape.ball(0.25), grid)
        scene.advance()
        assert scene.positions.shape == (before + count, 3)


def test_events_say_what_became_of_commands(scene):
    ball = ball_on_floor(scene)
    scene.report_events(ball, contacts=True, sleep=True)
    removal = scene.remove(12_345)
    with pytest.raises(rhumb.RefusedError):
        scene.advance()
    scene.advance(ticks=59)
    events = {event.kind: event for event in scene.events()}
    assert events["body placed"].body == ball
    refused = events["command refused"]
    assert refused.number == removal and "no body" in refused.text
    contact = events["contact began"]
    assert ball in (contact.body, contact.other) and 30 < contact.tick <= 60
    assert abs(contact.normal[1]) == pytest.approx(1, abs=1e-3)
    assert scene.events() == []


def test_queries_find_bodies(scene):
    ball = ball_on_floor(scene)
    scene.advance()
    up = rhumb.Query.ray((0, 10, 0), (0, -20, 0), hits=4)
    near = rhumb.Query.overlap(rhumb.Shape.ball(1), (0, 2, 0))
    cast = rhumb.Query.shape_cast(rhumb.Shape.cuboid(0.1, 0.1, 0.1), (5, 5, 5), (0, -10, 0))
    tick, [first, second, third, fourth] = scene.query([up, near, cast, up.among(dynamic=False)])
    assert tick == 1
    assert [hit.body for hit in first][0] == ball and first[0].distance == pytest.approx(7.5, abs=0.01)
    assert first[0].normal == pytest.approx((0, 1, 0), abs=1e-3)
    assert [hit.body for hit in second] == [ball]
    assert third[0].distance == pytest.approx(4.9, abs=0.01)
    assert ball not in [hit.body for hit in fourth] and len(fourth) == 1


def test_every_shape_can_be_added(scene):
    corner = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    for x, shape in enumerate(
        [
            rhumb.Shape.rounded_cuboid(0.5, 0.5, 0.5, 0.1),
            rhumb.Shape.capsule(0.5, 0.25),
            rhumb.Shape.cylinder(0.5, 0.25),
            rhumb.Shape.cone(0.5, 0.25),
            rhumb.Shape.hull(corner),
        ]
    ):
        scene.add_body(shape, (x * 3, 5, 0), material=(0.5, 0.1, 500), damping=(0.1, 0.1), swept=True)
    scene.add_body(rhumb.Shape.half_space((0, 1, 0)), kind="fixed", groups=(1, 1))
    scene.add_body(rhumb.Shape.mesh(corner[:3], [(0, 1, 2)]), (0, -9, 0), "fixed", tolerance_exponent=1)
    scene.add_body(rhumb.Shape.heights(np.zeros((3, 4)), 2, 2), (50, -9, 0), "fixed", sensor=True)
    scene.advance()
    assert len(scene) == 8
    assert [event for event in scene.events() if event.kind == "command refused"] == []


def test_shapes_that_no_body_has_any_more_are_removed(server):
    with server.connect().join("shapes", condition="create") as scene:
        ground = scene.add_body(rhumb.Shape.heights(np.zeros((3, 4)), 2, 2), kind="fixed")
        scene.add_body(rhumb.Shape.ball(0.5), (2, 5, 2))
        scene.advance()
        assert scene.remove_unused_shapes() == 0
        scene.remove(ground)
        assert scene.remove_unused_shapes() == 1
        scene.advance()
        assert scene.remove_unused_shapes() == 0
        # The shape is sent again with the body.
        again = scene.add_body(rhumb.Shape.heights(np.zeros((3, 4)), 2, 2), kind="fixed")
        scene.advance()
        assert again in scene
        assert [event for event in scene.events() if event.kind == "command refused"] == []


def test_coordinates_are_those_of_the_application(server):
    with server.connect().join("axes", condition="create", coordinates="unreal") as scene:
        ball = scene.add_body(rhumb.Shape.ball(50), (100, 200, 300))
        scene.advance(ticks=60)
        x, y, z = scene.positions[scene.place(ball)]
        assert (x, y) == pytest.approx((100, 200), abs=0.1)
        # A second of free fall, in centimetres, and the tolerance of 5 cm.
        assert z == pytest.approx(300 - 490 - 8, abs=6)
        assert scene.error_bound(ball) == pytest.approx(5, abs=1e-4)


def test_a_free_running_scene_is_polled(server):
    with server.connect().join("free", condition="create", stepping="free running") as scene:
        ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 50, 0))
        tick, fraction = scene.poll()
        while tick < 20:
            scene.idle(0.02)
            tick, fraction = scene.poll()
        assert 0 <= fraction < 1
        assert scene.positions[scene.place(ball)][1] < 50
        assert scene.statistics["received_bytes"] > 0
        # Without a delay, the newest moment is a guess.
        assert scene.error_bound(ball) == math.inf
        assert math.isfinite(scene.tick_error_bound(ball, scene.statistics["complete_tick"]))


def test_a_hinge_keeps_its_limits_and_its_motor_turns_it(scene):
    anchor = scene.add_body(rhumb.Shape.cuboid(0.2, 0.2, 0.2), (0, 5, 0), "fixed")
    arm = scene.add_body(rhumb.Shape.cuboid(0.2, 1, 0.2), (0, 4, 0))

    def hinge(velocity):
        motor = (0, velocity, 0, 10, None)
        return rhumb.Joint("revolute", anchor, arm, second_anchor=(0, 1, 0), limits={3: (-0.5, 1)}, motors={3: motor})

    def angle():
        x, _, _, w = scene.rotations[scene.place(arm)]
        return 2 * math.atan2(x, w)

    scene.add_joint(1, hinge(2))
    scene.advance(ticks=120)
    # The joint is a little soft, and the copy within its tolerance.
    assert angle() == pytest.approx(1, abs=0.2)
    scene.change_joint(1, hinge(-2))
    scene.advance(ticks=120)
    assert angle() == pytest.approx(-0.5, abs=0.2)
    assert [event.kind for event in scene.events() if "refused" in event.kind] == []
    scene.remove_joint(1)
    before = scene.positions[scene.place(arm)][1]
    scene.advance(ticks=60)
    assert scene.positions[scene.place(arm)][1] < before - 3


def test_a_hinge_turns_by_three_quarters_of_a_turn_and_no_further(scene):
    post = scene.add_body(rhumb.Shape.ball(0.1), (0, 5, 0), "fixed")
    arm = scene.add_body(rhumb.Shape.ball(0.1), (0, 5, 1), gravity_scale=0.0)
    joint = dict(second_anchor=(0, 0, -1), limits={3: (0, 1.5 * math.pi)})
    turned = []
    for number, speed in ((1, 2.0), (1, -2.0)):
        motor = {3: (0.0, speed, 0.0, 100.0, None)}
        hinge = rhumb.Joint("revolute", post, arm, motors=motor, **joint)
        (scene.add_joint if speed > 0 else scene.change_joint)(number, hinge)
        for _ in range(600):
            scene.advance()
            _, y, z = scene.positions[scene.place(arm)] - scene.positions[scene.place(post)]
            turned.append(math.degrees(math.atan2(-y, z)) % 360)
    # It passes half a turn, stops at three quarters, and comes back the same way.
    assert any(170 < angle < 190 for angle in turned[:600]) and turned[599] == pytest.approx(270, abs=3)
    assert any(170 < angle < 190 for angle in turned[600:])
    assert min(turned[-1], 360 - turned[-1]) == pytest.approx(0, abs=3)
    # Nothing distinguishes more than a whole turn from its remainder.
    with pytest.raises(rhumb.InvalidError, match="counts no turns"):
        scene.add_joint(2, rhumb.Joint("revolute", post, arm, limits={3: (-5, 5)}))


def test_a_joint_has_limits_of_its_free_axes_only(scene):
    bodies = scene.add_bodies(rhumb.Shape.ball(0.5), [(0, 0, 0), (2, 0, 0)])
    for arguments in [
        {"kind": "revolute", "limits": {0: (0, 1)}},
        {"kind": "fixed", "limits": {3: (0, 1)}},
        {"kind": "generic", "limits": {6: (0, 1)}},
        {"kind": "hinge"},
        {"kind": "generic", "locked_axes": 64},
    ]:
        kind = arguments.pop("kind")
        with pytest.raises(rhumb.InvalidError):
            rhumb.Joint(kind, *bodies, **arguments)
    # The scene checks the rest.
    with pytest.raises(rhumb.InvalidError):
        scene.add_joint(1, rhumb.Joint("revolute", *bodies, limits={3: (1, 0)}))
    rope = rhumb.Joint("rope", *bodies, length=2.5)
    scene.add_joint(1, rope)
    scene.add_joint(1, rope)
    with pytest.raises(rhumb.RefusedError, match="joint 1 is taken"):
        scene.advance()
    assert "command refused" in [event.kind for event in scene.events()]


def test_a_compound_rests_on_its_parts(scene):
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    ball = rhumb.Shape.ball(0.25)
    table = rhumb.Shape.compound([(rhumb.Shape.cuboid(1, 0.1, 1), (0, 0.5, 0))] + [
        (ball, (x, -0.25, z), (0, 0, 0, 1)) for x in (-0.8, 0.8) for z in (-0.8, 0.8)
    ])
    body = scene.add_body(table, (0, 2, 0))
    scene.advance(ticks=240)
    assert scene.positions[scene.place(body)][1] == pytest.approx(0.5, abs=0.06)
    with pytest.raises(rhumb.InvalidError):
        rhumb.Shape.compound([(table, (0, 0, 0))])
    with pytest.raises(TypeError):
        rhumb.Shape.compound([ball])


def test_a_shape_from_a_corner_lies_and_tips_as_its_points_say(scene):
    scene.add_body(rhumb.Shape.cuboid(20, 0.5, 20), (0, -0.5, 0), "fixed")
    scene.add_body(rhumb.Shape.cuboid(1, 1, 1), (-0.7, 1, 0.5), "fixed")
    cube = rhumb.Shape.hull([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    half = rhumb.Shape.cuboid(0.5, 0.5, 0.5)
    angle = rhumb.Shape.compound([(half, (0.5, 0.5, 0.5)), (half, (0.5, 1.5, 0.5))])
    assert np.allclose(cube.centre, (0.5, 0.5, 0.5)) and np.allclose(angle.centre, (0.5, 1, 0.5))
    moved, centre = cube.centred()
    assert np.allclose(centre, (0.5, 0.5, 0.5)) and moved.centre == (0, 0, 0)
    bodies = [scene.add_body(shape, (0, 2, 10 * z)) for z, shape in enumerate((cube, angle))]
    scene.advance()
    assert np.allclose(scene.positions[scene.places(bodies)][0], (0, 2, 0), atol=0.06)
    scene.advance(ticks=239)
    assert scene.positions[scene.place(bodies[0])][1] < 1.5
    turn = (0, 0, math.sqrt(0.5), math.sqrt(0.5))
    scene.set_gravity((0, 0, 0))
    scene.set_pose(bodies, [(5, 5, 5), (9, 9, 9)], turn)
    scene.set_velocity(bodies, (0, 0, 0), (0, 0, 0))
    scene.advance(ticks=2)
    places = scene.places(bodies)
    assert np.allclose(scene.positions[places], [(5, 5, 5), (9, 9, 9)], atol=0.06)
    _, hits = scene.query([rhumb.Query.ray((4.5, 10, 5.5), (0, -20, 0))])
    assert hits[0][0].body == bodies[0] and hits[0][0].point[1] == pytest.approx(6, abs=0.06)


def test_a_hull_keeps_the_corners_of_many_points(scene):
    rng = np.random.default_rng(0)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    box = rhumb.Shape.hull(np.concatenate([rng.uniform(-1, 1, (5000, 3)), corners]))
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    body = scene.add_body(box, (0, 1.1, 0))
    scene.advance(ticks=120)
    assert scene.positions[scene.place(body)][1] == pytest.approx(1, abs=0.06)
    ball = rng.normal(size=(2000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    with pytest.raises(rhumb.errors.InvalidError, match="corners is 2000, and must be 4 to 255: .*compound"):
        rhumb.Shape.hull(ball)


def test_a_client_with_authority_moves_its_body_and_pushes_others(scene):
    ball_on_floor(scene)
    box = scene.add_body(rhumb.Shape.cuboid(0.5, 0.5, 0.5), (3, 0.5, 3))
    avatar = scene.add_body(rhumb.Shape.capsule(0.6, 0.3), (0, 0.9, 3), "kinematic")
    scene.advance()
    scene.take_authority(avatar)
    assert scene.publish([avatar], [(0, 0.9, 3)]) is None
    kinds = []
    while "authority granted" not in kinds:
        scene.idle(0.001)
        kinds += [event.kind for event in scene.events()]
    for frame in range(1, 181):
        published = scene.publish(avatar, (frame / 60, 0.9, 3), linear=(1, 0, 0))
        assert published == scene.advance()
    assert scene.positions[scene.place(avatar)][0] == pytest.approx(3, abs=0.05 + 0.02)
    assert scene.positions[scene.place(box)][0] > 3.5
    with pytest.raises(rhumb.InvalidError):
        scene.publish(box, (0, 0, 0))
    with pytest.raises(rhumb.InvalidError):
        scene.publish(avatar, (math.nan, 0, 0))
    with pytest.raises(rhumb.InvalidError):
        scene.take_authority(avatar, tolerance=0)
    scene.take_authority([])


# A program that moves a body by authority until it is killed.
PUBLISHER = """
import sys
import rhumb
scene = rhumb.connect(sys.argv[1], fingerprint=sys.argv[2]).join("killed", stepping="free running")
lift = scene.add_body(rhumb.Shape.ball(0.5), (0, 9, 0), "kinematic")
scene.take_authority(lift)
while True:
    scene.poll()
    scene.publish(lift, (0, 9, 0), linear=(0, -1, 0))
    scene.idle(0.005)
    if any(event.kind == "authority granted" for event in scene.events()):
        print(int(lift), flush=True)
"""


def test_followers_learn_that_a_publisher_was_killed(server):
    with server.connect().join("killed", stepping="free running", tolerance=0.05) as scene:
        command = [sys.executable, "-c", PUBLISHER, server.address, server.fingerprint]
        publisher = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        lift = int(publisher.stdout.readline())
        while lift not in scene or not math.isfinite(scene.error_bound(lift)):
            scene.poll()
            scene.idle(0.005)
        publisher.kill()
        publisher.communicate()
        silent = []
        while not silent:
            scene.idle(0.005)
            scene.poll()
            silent = [event for event in scene.events() if event.kind == "publisher silent"]
        assert [event.body for event in silent] == [lift]
        assert silent[0].tick <= scene.time[0]
        assert scene.error_bound(lift) == math.inf


def test_slow_fast_and_spinning_bodies_move_on(server):
    with server.connect().join("motion", condition="create", gravity=(0, 0, 0), tolerance=0.005) as scene:
        slow = scene.add_body(rhumb.Shape.ball(0.1), linear_velocity=(0.05, 0, 0))
        fast = scene.add_body(rhumb.Shape.ball(0.1), (0, 9, 0), linear_velocity=(600, 0, 0), angular_velocity=(0, 100, 0))
        disc = rhumb.Shape.cuboid(0.3, 0.01, 0.3)
        disc = scene.add_body(disc, (0, -9, 0), angular_velocity=(0, 20, 0.5))
        scene.advance(ticks=60)
        assert scene.positions[scene.place(fast)][0] == pytest.approx(600, abs=0.1)
        assert scene.angular_velocities[scene.place(fast)][1] > 99
        scene.advance(ticks=540)
        assert scene.positions[scene.place(slow)][0] == pytest.approx(0.5, abs=0.02)
        x, _, z, _ = scene.rotations[scene.place(disc)]
        assert 1 - 2 * (x * x + z * z) > math.cos(math.radians(5))


def test_a_body_sleeps_by_its_own_rule_and_not_by_the_scenes(server):
    with server.connect().join("sleep", condition="create", gravity=(0, 0, 0), sleep=(0.5, 100, 0.2)) as scene:
        rules = [None, "never", "settled", (0.1, 1, 0.2), (0.5, 1, 0.2)]
        bodies = [
            scene.add_body(rhumb.Shape.ball(0.1), (0, 3 * row, 0), linear_velocity=(0.3, 0, 0), sleep=rule)
            for row, rule in enumerate(rules)
        ]
        scene.advance(ticks=60)
        resting = [bool(scene.resting[scene.place(body)]) for body in bodies]
        assert resting == [True, False, False, False, True]


def test_gyroscopic_forces_and_edges_are_choices(server):
    with server.connect().join("choices", condition="create", gravity=(0, 0, 0), tolerance=0.005) as scene:
        brick = rhumb.Shape.cuboid(0.1, 0.3, 0.5)
        plain, steady = [
            scene.add_body(brick, (x, 0, 0), angular_velocity=(3, 5, -2), gyroscopic=gyroscopic)
            for x, gyroscopic in ((0, True), (5, False))
        ]
        scene.add_body(rhumb.Shape.heights(np.zeros((3, 4)), edges="plain"), (0, -9, 0), "fixed")
        scene.add_body(rhumb.Shape.mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], edges="smooth"), kind="fixed")
        scene.advance(ticks=60)
        spins = [scene.angular_velocities[scene.place(body)] for body in (plain, steady)]
        assert not np.allclose(spins[0], (3, 5, -2), atol=1)
        assert np.allclose(spins[1], (3, 5, -2), atol=0.05)
    with pytest.raises(rhumb.errors.InvalidError, match="plain"):
        rhumb.Shape.heights(np.zeros((3, 4)), edges="round")


@pytest.mark.parametrize("rule", ["always", 0.1, (0.1, 1), (0.1, 1, -1), (0.1, 1000, 1), (float("nan"), 1, 1)])
def test_a_wrong_rule_of_sleep_is_an_error(server, rule):
    with server.connect() as connection:
        with pytest.raises((rhumb.errors.InvalidError, TypeError)):
            connection.join("wrong sleep", sleep=rule)
