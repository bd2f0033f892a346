"""Characters walk, climb and jump; vehicles roll, steer and stop."""

import math

import numpy as np
import pytest

import rhumb


def refused(events):
    return [event.text for event in events if event.kind == "command refused"]


def floor(scene):
    scene.add_body(rhumb.Shape.cuboid(50, 0.5, 50), (0, -0.5, 0), "fixed")


def person(scene):
    return scene.add_body(rhumb.Shape.capsule(0.6, 0.3), (0, 0.92, 0), "kinematic")


def position(scene, body):
    return scene.positions[scene.place(body)]


def test_a_character_walks_over_a_step_and_stands(scene):
    floor(scene)
    scene.add_body(rhumb.Shape.cuboid(1, 0.1, 2), (3, 0.1, 0), "fixed")
    body = person(scene)
    scene.set_character(body, rhumb.Character(step=(0.3, 0.1)))
    scene.set_velocity(body, (2, 0, 0))
    scene.advance(ticks=80)
    assert position(scene, body)[:2] == pytest.approx((2.67, 1.12), abs=0.35)
    assert position(scene, body)[1] == pytest.approx(1.12, abs=0.08)
    scene.set_velocity(body, (0, 0, 0))
    scene.advance(ticks=10)
    stood = position(scene, body)
    scene.advance(ticks=60)
    assert np.allclose(position(scene, body), stood, atol=0.05)
    events = scene.events()
    assert refused(events) == []
    # On the floor, and again on the step.
    assert {event.body for event in events if event.kind == "reached ground"} == {body}


def test_a_character_without_a_step_stops_before_one(scene):
    floor(scene)
    scene.add_body(rhumb.Shape.cuboid(1, 0.1, 2), (3, 0.1, 0), "fixed")
    body = person(scene)
    scene.set_character(body, rhumb.Character(mass=0, snap=0, offset=0.02, up=(0, 1, 0)))
    scene.set_velocity(body, (2, 0, 0))
    scene.advance(ticks=80)
    assert position(scene, body)[0] < 1.8
    assert refused(scene.events()) == []


def test_a_character_jumps_from_the_ground_and_in_the_air_if_it_may(scene):
    floor(scene)
    body = person(scene)
    scene.set_character(body, rhumb.Character())
    scene.advance(ticks=10)
    scene.events()
    scene.jump(body, 5)
    scene.advance(ticks=30)
    assert position(scene, body)[1] == pytest.approx(0.92 + 1.25, abs=0.1)
    assert [event.kind for event in scene.events() if event.body == body] == ["left ground"]
    scene.jump(body, 5)
    scene.advance(ticks=20)
    assert position(scene, body)[1] < 2.0
    scene.jump(body, 5, anywhere=True)
    scene.advance(ticks=20)
    assert position(scene, body)[1] > 2.0
    scene.clear_locomotion(body)
    scene.advance()
    high = position(scene, body)[1]
    scene.advance(ticks=60)
    assert position(scene, body)[1] == pytest.approx(high, abs=0.05)


def test_a_vehicle_of_four_wheels_drives_forward_and_stops(scene):
    floor(scene)
    car = scene.add_body(rhumb.Shape.cuboid(0.8, 0.2, 1.6), (0, 0.7, 0), mass=1000)
    scene.set_vehicle(car, [rhumb.Wheel((x, -0.1, z), 0.3) for z in (-1.2, 1.2) for x in (-0.8, 0.8)])
    scene.advance(ticks=60)
    assert position(scene, car)[1] == pytest.approx(0.65, abs=0.08)
    front, rear, brake = rhumb.WheelInput(), rhumb.WheelInput(force=1000), rhumb.WheelInput(brake=3000)
    scene.set_wheels(car, [front, front, rear, rear])
    scene.advance(ticks=120)
    # Two kilonewtons give a ton 2 m/s².
    assert position(scene, car) == pytest.approx((0, 0.65, -4), abs=0.5)
    scene.set_wheels(car, [brake] * 4)
    scene.advance(ticks=120)
    stopped = position(scene, car)
    scene.advance(ticks=60)
    assert np.allclose(position(scene, car), stopped, atol=0.1)
    assert refused(scene.events()) == []


@pytest.mark.parametrize(
    "coordinates, unit, up, ahead, right, turns_right",
    [
        ("rhumb", 1, (0, 1, 0), (0, 0, -1), (1, 0, 0), False),
        ("unity", 1, (0, 1, 0), (0, 0, 1), (1, 0, 0), True),
        ("unreal", 100, (0, 0, 1), (1, 0, 0), (0, 1, 0), True),
        ("z-up", 1, (0, 0, 1), (0, 1, 0), (1, 0, 0), False),
    ],
)
def test_a_vehicle_drives_forward_and_a_positive_steering_is_a_positive_turn(
    server, coordinates, unit, up, ahead, right, turns_right
):
    up, ahead, right = (unit * np.array(axis, dtype=float) for axis in (up, ahead, right))

    def box(along_right, along_up, along_ahead):
        return rhumb.Shape.cuboid(*(np.abs(along_right * right + along_up * up + along_ahead * ahead)))

    with server.connect().join(f"car-{coordinates}", condition="create", coordinates=coordinates) as scene:
        scene.add_body(box(50, 0.5, 50), -0.5 * up, "fixed")
        car = scene.add_body(box(0.8, 0.2, 1.6), 0.7 * up, mass=1000)
        places = [z * ahead + x * right - 0.1 * up for z in (1.2, -1.2) for x in (-0.8, 0.8)]
        scene.set_vehicle(car, [rhumb.Wheel(place, 0.3 * unit) for place in places])
        scene.advance(ticks=30)
        front, rear = rhumb.WheelInput(steering=0.1), rhumb.WheelInput(force=1000 * unit)
        scene.set_wheels(car, [front, front, rear, rear])
        scene.advance(ticks=90)
        at = position(scene, car) / unit**2
        assert at @ up == pytest.approx(0.65, abs=0.1)
        assert at @ ahead == pytest.approx(2.25, abs=0.6)
        assert (at @ right > 0.05) == turns_right and (at @ right < -0.05) != turns_right
        assert refused(scene.events()) == []
        # Beside the car, a character of the default settings stands in these units.
        body = scene.add_body(rhumb.Shape.capsule(0.6 * unit, 0.3 * unit), 5 * right + 0.92 * up, "kinematic")
        scene.set_character(body, rhumb.Character())
        scene.set_velocity(body, ahead)
        scene.advance(ticks=60)
        assert position(scene, body) / unit**2 @ ahead == pytest.approx(1, abs=0.1)
        assert position(scene, body) / unit**2 @ up == pytest.approx(0.92, abs=0.08)
        assert refused(scene.events()) == []


def test_wrong_characters_wheels_and_inputs_are_errors(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 2, 0))
    wheel = rhumb.Wheel((0, 0, 0), 0.3)
    nan = float("nan")
    for wrong in (
        *(
            lambda settings=settings: scene.set_character(ball, rhumb.Character(**settings))
            for settings in (
                {"up": (0, 0, 0)},
                {"offset": 0},
                {"climb_angle": 2},
                {"slide_angle": -1},
                {"mass": nan},
                {"step": (0.3, 0)},
                {"snap": -1},
            )
        ),
        *(
            lambda settings=settings: scene.set_vehicle(ball, [rhumb.Wheel((0, 0, 0), 0.3, **settings)])
            for settings in (
                {"direction": (0, 0, 0)},
                {"axle": (nan, 0, 0)},
                {"rest_length": -1},
                {"travel": nan},
                {"stiffness": -1},
                {"compression": -1},
                {"relaxation": -1},
                {"force_max": -1},
                {"friction_slip": 101},
                {"side_friction": -1},
            )
        ),
        lambda: rhumb.Character(up=(0, 1)),
        lambda: rhumb.Wheel((0, 0), 0.3),
        lambda: scene.set_vehicle(ball, [rhumb.Wheel((0, 0, 0), 0)]),
        lambda: scene.set_vehicle(ball, []),
        lambda: scene.set_vehicle(ball, [wheel] * 17),
        lambda: scene.set_wheels(ball, []),
        lambda: scene.set_wheels(ball, [rhumb.WheelInput(steering=4)]),
        lambda: scene.set_wheels(ball, [rhumb.WheelInput(brake=-1)]),
        lambda: scene.set_wheels(0, [rhumb.WheelInput()]),
        lambda: scene.jump(ball, math.inf),
        lambda: scene.clear_locomotion(0),
    ):
        with pytest.raises(rhumb.InvalidError) as raised:
            wrong()
        assert str(raised.value)
    for wrong in (
        lambda: scene.set_character(ball, None),
        lambda: scene.set_character(ball, wheel),
        lambda: scene.set_vehicle(ball, wheel),
        lambda: scene.set_vehicle(ball, [None]),
        lambda: scene.set_wheels(ball, [0.5]),
        lambda: rhumb.Character(speed=1),
    ):
        with pytest.raises(TypeError):
            wrong()
    # The server refuses what it alone can know: the ball is dynamic, and has no wheels.
    numbers = [
        scene.set_character(ball, rhumb.Character()),
        scene.jump(ball, 1),
        scene.set_wheels(ball, [rhumb.WheelInput()]),
    ]
    with pytest.raises(rhumb.RefusedError, match="not kinematic") as raised:
        scene.advance()
    assert [refusal.number for refusal in raised.value.refusals] == numbers
    assert [refusal.body for refusal in raised.value.refusals] == [ball] * 3


def test_settings_are_shown(scene):
    assert "step=(0.3, 0.1)" in repr(rhumb.Character(step=(0.3, 0.1)))
    assert repr(rhumb.Wheel((1, 2, 3), 0.3)).startswith("Wheel")
    assert "force=5" in repr(rhumb.WheelInput(force=5))
