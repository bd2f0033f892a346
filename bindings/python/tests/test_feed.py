"""Scenes whose engine is in the program: what is fed, seen and asked for."""

import subprocess
import sys

import numpy as np
import pytest

import rhumb

BALL = rhumb.Shape.ball(0.5)


def falling(owner, ids, ticks, follower):
    """Feeds balls that fall, and returns the greatest error of a follower."""
    height = np.linspace(50, 100, len(ids), dtype=np.float32)
    position = np.zeros((len(ids), 3), dtype=np.float32)
    worst = 0
    for tick in range(1, ticks + 1):
        speed = -9.81 * tick / 60
        position[:, 1] = height - 9.81 * tick * (tick + 1) / 2 / 3600
        fed = owner.feed(ids, position, linear=(0, speed, 0))
        while follower.poll()[0] < fed:
            follower.idle(0.001)
        places = [follower.place(body) for body in ids]
        worst = max(worst, float(np.abs(follower.positions[places] - position).max()))
    return worst


def test_a_follower_sees_what_is_fed_within_its_tolerance():
    server = rhumb.LocalServer()
    with server.connect(feed="fed").join("fed", substeps=1) as owner:
        ids = owner.add_bodies(BALL, np.zeros((100, 3)))
        owner.feed(ids, (0, 0, 0))
        with server.connect().join("fed", tolerance=0.01) as follower:
            before = follower.statistics["updates"]
            assert falling(owner, ids, 120, follower) <= 0.0101
            assert follower.statistics["updates"] - before < 300


def test_velocities_are_derived_where_the_engine_has_none():
    with rhumb.local(fed=True, ticks_per_second=60) as scene:
        ball = scene.add_body(BALL)
        for tick in range(1, 4):
            assert scene.feed(ball, (tick / 60, 0, 0)) == tick
        scene.poll()
        assert np.allclose(scene.linear_velocities[scene.place(ball)], (1, 0, 0), atol=0.1)


def test_what_is_wrong_is_named_and_nothing_is_fed():
    with rhumb.local(fed=True) as scene:
        ids = scene.add_bodies(BALL, np.zeros((3, 3)))
        scene.feed(ids, (0, 0, 0), tick=5)
        wrong = [
            (lambda: scene.feed(ids, np.zeros((2, 3))), r"position is an array of shape \[2, 3\]"),
            (lambda: scene.feed(ids, (0, np.nan, 0)), "position"),
            (lambda: scene.feed(ids, (0, 0, 0), tick=5), "must be later than"),
            (lambda: scene.feed(ids, (0, 0, 0), tick=4), "must be later than"),
            (lambda: scene.feed(ids, (0, 0, 0), tick=606), "600 ticks later at most"),
            (lambda: scene.feed([*ids, ids[0]], (0, 0, 0)), "two states"),
            (lambda: scene.feed(77, (0, 0, 0)), "not in the scene: add it first"),
            (lambda: scene.feed(ids, (0, 2e5, 0)), "100000"),
            (lambda: scene.feed(ids, (0, 0, 0), linear=(5000, 0, 0)), "1000"),
            (lambda: scene.advance(), "feed the states of the next tick"),
        ]
        for call, said in wrong:
            with pytest.raises(rhumb.InvalidError, match=said):
                call()
        assert scene.feed(ids, (0, 0, 0)) == 6


def test_one_that_does_not_own_the_scene_feeds_nothing():
    with rhumb.local() as scene:
        with pytest.raises(rhumb.InvalidError, match="does not feed its scene"):
            scene.feed([], np.zeros((0, 3)))
        assert scene.requests() == []
    server = rhumb.LocalServer()
    one = server.connect(feed="fed")
    with pytest.raises(rhumb.InvalidError, match="another client feeds the scene fed"):
        server.connect(feed="fed")
    with pytest.raises(rhumb.InvalidError, match="for feeding the scene fed"):
        one.join("other")


def test_requests_of_followers_come_to_the_owner():
    server = rhumb.LocalServer()
    with server.connect(feed="fed").join("fed", coordinates="z-up") as owner:
        ball = owner.add_body(BALL)
        owner.feed(ball, (0, 0, 0))
        with server.connect().join("fed", coordinates="z-up", refusals="events") as follower:
            follower.poll()
            follower.apply_impulse(ball, (1, 2, 3))
            wanted = follower.add_body(BALL, (4, 5, 6))
            follower.set_gravity((0, 0, -3))
            follower.poll()
            push, body, gravity = owner.requests()
            assert (push.kind, push.body, push.vector) == ("apply impulse", ball, (1, 2, 3))
            assert (body.kind, body.body, body.position) == ("add body", wanted, (4, 5, 6))
            assert gravity.vector == (0, 0, -3) and gravity.client is None
            assert repr(gravity) == f'Request("set gravity", number={gravity.number})'
            owner.accept(body)
            owner.refuse(gravity)
            owner.feed([ball, wanted], [(0, 0, 0), (7, 8, 9)])
            follower.poll()
            assert np.allclose(follower.positions[follower.place(wanted)], (7, 8, 9), atol=0.05)
            refused = [event for event in follower.events() if event.kind == "command refused"]
            assert [event.number for event in refused] == [gravity.number]


def test_a_request_has_one_answer_and_one_that_the_scene_refuses_is_an_error_of_the_owner():
    server = rhumb.LocalServer()
    with server.connect(feed="fed").join("fed") as owner:
        follower = server.connect().join("fed")
        kept = follower.add_body(BALL, (4, 5, 6))
        unborn = follower.add_body(BALL, (7, 8, 9))
        follower.poll()
        first, second = owner.requests()
        owner.accept(first)
        for answer in (owner.accept, owner.refuse):
            with pytest.raises(rhumb.InvalidError, match="answer each once"):
                answer(first)
        owner.feed(kept, (4, 5, 6))
        follower.poll()
        assert follower.place(kept) is not None
        follower.close()
        owner.accept(second)
        with pytest.raises(rhumb.RefusedError):
            owner.feed(kept, (4, 5, 5))
        with pytest.raises(rhumb.InvalidError, match="not in the scene"):
            owner.feed([kept, unborn], (4, 5, 4))
        assert owner.feed(kept, (4, 5, 4)) == 3
        with pytest.raises(rhumb.Error, match="save it there"):
            owner.save()
    other = rhumb.LocalServer()
    with other.connect().join("there"):
        with pytest.raises(rhumb.Error, match="join with the condition to create it"):
            other.connect(feed="there").join("there", condition="join")


FOLLOWER = """
import sys, rhumb
with rhumb.connect(sys.argv[1]).join("main") as scene:
    scene.idle(0.2)
    scene.poll()
    print(*scene.positions[0])
"""


def test_another_process_follows_a_served_scene():
    with rhumb.serve(fed=True, quiet=True) as scene:
        ball = scene.add_body(BALL)
        for tick in range(1, 30):
            scene.feed(ball, (tick, 2, 3))
        command = [sys.executable, "-c", FOLLOWER, scene.address]
        said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        assert np.allclose([float(part) for part in said.stdout.split()], (29, 2, 3), atol=0.05)
        assert rhumb.view(scene, browser=False).startswith("http://127.0.0.1:")


def test_members_of_an_edge_follow_a_fed_scene_and_ask_its_owner(edge):
    with rhumb.serve("fed", fed=True, substeps=1, quiet=True) as owner:
        ids = owner.add_bodies(BALL, np.zeros((20, 3)))
        owner.feed(ids, (0, 0, 0))
        with edge(owner.address).connect().join("fed", tolerance=0.01, condition="join") as follower:
            assert falling(owner, ids, 60, follower) <= 0.0101
            follower.apply_impulse(ids[3], (1, 2, 3))
            asked = []
            while not asked:
                follower.idle(0.001)
                asked = owner.requests()
            assert [(one.kind, one.body, one.vector) for one in asked] == [("apply impulse", ids[3], (1, 2, 3))]
