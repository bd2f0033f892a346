"""Scenes in the process of the interpreter: one call, no other program."""

import inspect
import pathlib
import re
import select
import subprocess
import sys
import textwrap
import threading

import numpy as np
import pytest

import rhumb

HERE = pathlib.Path(__file__).parent


def with_ball(scene):
    scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
    return scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))


def test_a_ball_falls_in_the_process_and_every_bound_holds():
    with rhumb.local() as scene:
        ball = with_ball(scene)
        for tick in range(1, 181):
            assert scene.advance() == tick
            assert scene.error_bound(ball) <= np.float32(0.05)
        assert scene.positions[scene.place(ball)] == pytest.approx((0, 0.5, 0), abs=0.06)


def test_two_scenes_of_one_name_are_on_servers_of_their_own():
    with rhumb.local("drop") as one, rhumb.local("drop") as other:
        with_ball(one)
        one.advance()
        assert other.advance() == 1 and len(one.bodies) == 2 and len(other.bodies) == 0


def test_the_options_are_those_of_join():
    joined = inspect.signature(rhumb.Connection.join).parameters
    local = inspect.signature(rhumb.local).parameters
    rest = [(each.name, each.kind, each.default) for each in joined.values() if each.name not in ("self", "scene")]
    assert [(each.name, each.kind, each.default) for each in local.values() if each.name not in ("scene", "fed")] == rest
    with rhumb.local(coordinates="z-up", gravity=(0, 0, -2), ticks_per_second=30) as scene:
        ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 0, 10))
        for _ in range(30):
            scene.advance()
        assert scene.positions[scene.place(ball)] == pytest.approx((0, 0, 9), abs=0.1)


def test_wrong_options_are_the_errors_of_join():
    with pytest.raises(rhumb.InvalidError, match="stepping"):
        rhumb.local(stepping="slow")
    with pytest.raises(rhumb.InvalidError):
        rhumb.local("")
    with pytest.raises(rhumb.DeniedError):
        rhumb.local(condition="join")
    with pytest.raises(TypeError, match="tolerence"):
        rhumb.local(tolerence=0.01)
    with pytest.raises(rhumb.InvalidError, match="timeout"):
        rhumb.LocalServer().connect(timeout=-1)


@pytest.mark.parametrize("own_thread", [False, True])
def test_two_members_of_one_server_see_the_same_bodies(own_thread):
    server = rhumb.LocalServer(own_thread=own_thread)
    assert repr(server) == f"LocalServer(own_thread={own_thread})"
    connection = server.connect(timeout=30)
    assert repr(connection) == "<rhumb.Connection to this process>"
    with connection.join("shared") as one, server.connect(timeout=30).join("shared", coordinates="z-up") as other:
        ball = with_ball(one)
        assert one.advance(60) == 60
        # The scene is at tick 60: the other member is shown what has arrived of it, and steps it no further.
        while other.advance() < 60:
            pass
        seen = other.positions[other.place(ball)]
        assert one.positions[one.place(ball)][1] == pytest.approx(seen[2], abs=0.1)


@pytest.mark.parametrize("own_thread", [False, True])
def test_two_threads_with_a_member_each_take_turns_and_both_end(own_thread):
    server = rhumb.LocalServer(own_thread=own_thread)
    reached, failures = {}, []

    def run(name, scene):
        try:
            with_ball(scene)
            ticks = [scene.advance() for _ in range(200)]
            assert all(later >= earlier for earlier, later in zip(ticks, ticks[1:]))
            reached[name] = ticks[-1]
        except BaseException as error:
            failures.append(error)

    members = [server.connect(timeout=60).join("shared") for _ in range(2)]
    threads = [threading.Thread(target=run, args=each) for each in enumerate(members)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert not failures and not any(thread.is_alive() for thread in threads)
    assert reached == {0: 200, 1: 200}
    for scene in members:
        scene.close()


def test_other_threads_of_the_interpreter_run_while_a_scene_steps():
    """A step of 1,200 touching boxes takes long; a thread that only counts must get on within it."""
    with rhumb.local() as scene:
        scene.add_body(rhumb.Shape.cuboid(50, 0.5, 50), (0, -0.5, 0), "fixed")
        grid = np.mgrid[-10:10, 0:3, -10:10].reshape(3, -1).T
        scene.add_bodies(rhumb.Shape.cuboid(0.5, 0.5, 0.5), grid + (0, 0.5, 0))
        scene.advance()
        counted, inside, stop = [0], threading.Event(), threading.Event()

        def count():
            inside.wait()
            while not stop.is_set():
                counted[0] += 1
                # Gives the interpreter's lock back.
                select.select([], [], [], 0)

        thread = threading.Thread(target=count)
        thread.start()
        before = sys.getswitchinterval()
        # Without its release, the lock would pass to the other thread after this time only: never.
        sys.setswitchinterval(1000)
        try:
            inside.set()
            for _ in range(20):
                scene.advance()
            seen = counted[0]
        finally:
            sys.setswitchinterval(before)
            stop.set()
            thread.join()
        assert seen > 0


def test_a_free_running_scene_moves_on_between_calls_on_a_thread_of_its_own():
    server = rhumb.LocalServer(own_thread=True)
    with server.connect().join("clock", stepping="free running") as scene:
        first, _ = scene.poll()
        while scene.poll()[0] < first + 10:
            scene.idle(0.01)


def test_a_connection_and_a_server_may_go_before_the_scene():
    server = rhumb.LocalServer()
    with server.connect() as unused:
        assert not unused.closed
    scene = server.connect().join("left")
    del server, unused
    assert scene.advance() == 1
    scene.close()
    with pytest.raises(rhumb.ClosedError):
        scene.advance()


def test_an_interpreter_that_leaves_scenes_open_ends():
    program = """
        import rhumb
        server = rhumb.LocalServer(own_thread=True)
        kept = [rhumb.local(), server.connect().join("left"), server.connect()]
        print(kept[0].advance())
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "1\n", "")


def test_the_first_example_needs_no_argument():
    example = HERE.parent / "examples" / "drop.py"
    ended = subprocess.run([sys.executable, example], capture_output=True, text=True, timeout=60)
    lines = ended.stdout.splitlines()
    assert len(lines) == 180 and lines[-1].startswith("tick 180: 0.000 0.5"), ended.stderr


def test_the_program_of_the_readme_runs():
    text = (HERE.parent / "README.md").read_text()
    [program] = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    lines = ended.stdout.splitlines()
    assert len(lines) == 180 and lines[-1].startswith("180 [0."), ended.stderr
