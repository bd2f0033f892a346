"""Scenes are saved, restored and forked, and run alike to the bit."""

import pickle

import numpy as np
import pytest

import rhumb


def pile(scene):
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    places = [(0.1 * (number % 3), 0.6 + 0.7 * number, 0) for number in range(20)]
    return scene.add_bodies(rhumb.Shape.cuboid(0.3, 0.3, 0.3), places)


def poses(scene):
    order = np.argsort(scene.bodies)
    return np.array(scene.bodies)[order], scene.positions[order].copy(), scene.rotations[order].copy()


def advance_alike(scenes, ticks, act=lambda scene, tick: None):
    for tick in range(ticks):
        for scene in scenes:
            act(scene, tick)
            scene.advance()
    first, *others = map(poses, scenes)
    for other in others:
        for one, another in zip(first, other):
            np.testing.assert_array_equal(one, another)
    return first


@pytest.mark.parametrize("stepping", ["lockstep", "free running"])
def test_a_scene_with_sockets_is_saved_and_served_anew(stepping):
    with rhumb.serve(tolerance=0.001, quiet=True, stepping=stepping) as scene:
        pile(scene)
        if stepping == "lockstep":
            for _ in range(50):
                scene.advance()
        saved = scene.save()
        assert stepping != "lockstep" or saved.tick == 50
    with rhumb.serve(checkpoint=saved, tolerance=0.001, quiet=True, condition="join") as served:
        with rhumb.connect(served.address).join("main") as member:
            assert len(served.bodies) == len(member.bodies) == 21
            if stepping == "lockstep":
                assert served.time[0] == 50
                assert served.save() == saved
                advance_alike([served, rhumb.restore(saved, tolerance=0.001)], 100)
                assert served.save().tick == 150
            with pytest.raises(rhumb.DeniedError, match="of this process alone"):
                member.save()


def test_forks_run_as_the_scene_that_was_saved():
    with rhumb.local(tolerance=0.001) as scene:
        bodies = pile(scene)
        for _ in range(50):
            scene.advance()
        scene.set_velocity(bodies[3], (2, 1, 0))
        saved = scene.save()
        assert saved.tick == 50 and repr(saved) == "<rhumb.Checkpoint of tick 50>"
        copies = saved, rhumb.Checkpoint(bytes(saved)), pickle.loads(pickle.dumps(saved))
        assert len(set(copies)) == 1
        forks = [rhumb.restore(each, tolerance=0.001) for each in copies]

        def act(each, tick):
            if tick == 20:
                each.apply_impulse(bodies[5], (0, 3000, 0))

        for fork in forks:
            assert fork.time[0] == 50 and set(fork.bodies) == set(scene.bodies)
        ids, positions, _ = advance_alike([*forks, rhumb.restore(saved, tolerance=0.001)], 200, act)
        for _ in range(200):
            act(scene, scene.time[0] - 50)
            scene.advance()
        own = poses(scene)
        np.testing.assert_array_equal(ids, own[0])
        np.testing.assert_allclose(positions, own[1], atol=0.002)
        assert [each.save() for each in forks] == [scene.save()] * 3, "the engines are equal to the bit"


def test_a_server_has_a_scene_and_its_forks_side_by_side():
    for own_thread in (False, True):
        server = rhumb.LocalServer(own_thread=own_thread)
        scene = server.connect().join("one")
        pile(scene)
        saved = scene.save()
        assert saved.tick == 0
        server.restore("two", saved)
        two = server.connect().join("two", condition="join")
        assert len(two.bodies) == 21
        new = two.add_body(rhumb.Shape.ball(0.2), (5, 1, 0))
        assert new not in scene.bodies
        two.advance()
        assert (len(two.bodies), scene.advance()) == (22, 1)
        with pytest.raises(rhumb.DeniedError, match='already has a scene "two"'):
            server.restore("two", saved)


def test_what_is_no_checkpoint_or_cannot_be_one_is_refused_by_name():
    with rhumb.local() as scene:
        scene.advance()
        data = bytearray(bytes(scene.save()))
        data[len(data) // 2] ^= 4
        for wrong in (bytes(data), b"", b"{}"):
            with pytest.raises(rhumb.InvalidError, match="damaged"):
                rhumb.Checkpoint(wrong)
        with pytest.raises(rhumb.InvalidError, match="a b"):
            rhumb.restore(scene.save(), "a b")
        with pytest.raises(rhumb.InvalidError, match="gravity, stepping: .* of its checkpoint"):
            rhumb.restore(scene.save(), gravity=(0, -1, 0), stepping="lockstep", tolerance=0.01)
        with pytest.raises(TypeError):
            rhumb.restore(bytes(scene.save()))
    with pytest.raises(rhumb.ClosedError):
        scene.save()
