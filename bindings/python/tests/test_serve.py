"""Scenes of this process that other processes join and browsers show."""

import inspect
import ipaddress
import json
import subprocess
import sys
import textwrap
import time
import urllib.error
import urllib.request
import webbrowser

import numpy as np
import pytest

import rhumb


def read(url):
    with urllib.request.urlopen(url, timeout=30) as answer:
        return answer.read()


def python(program, *arguments):
    command = [sys.executable, "-c", textwrap.dedent(program), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.fixture
def served():
    with rhumb.serve("shared", quiet=True) as scene:
        yield scene


def test_another_process_joins_by_the_address_alone(served):
    program = """
        import sys, rhumb
        with rhumb.connect(sys.argv[1]).join("shared", condition="join") as scene:
            scene.add_body(rhumb.Shape.ball(0.5), (0, 10, 0))
            print(scene.advance())
    """
    ended = python(program, served.address)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "1\n", "")
    served.advance()
    assert len(served) == 1 and served.error_bound(served.bodies[0]) <= np.float32(0.05)


@pytest.mark.parametrize(("options", "up"), [({}, 1), ({"coordinates": "z-up"}, 2)])
def test_what_it_prints_is_what_another_process_runs(capsys, options, up):
    with rhumb.serve("printed", **options) as scene:
        at = [0.0, 0.0, 0.0]
        at[up] = 5.0
        ball = scene.add_body(rhumb.Shape.ball(0.5), at, "fixed")
        scene.advance()
        line = capsys.readouterr().out
        call, words = line.strip().split(") ", 1)
        assert words == "joins this scene" and scene.address in call
        with eval(call + ")", {"rhumb": rhumb}) as other:
            other.advance()
            assert other.address is None and other.positions[other.place(ball)][up] == 5.0
    with rhumb.serve(quiet=True):
        assert capsys.readouterr().out == ""


def test_the_options_are_those_of_join_and_wrong_ones_are_errors():
    joined = inspect.signature(rhumb.Connection.join).parameters
    own = inspect.signature(rhumb.serve).parameters
    rest = [(each.name, each.kind, each.default) for each in joined.values() if each.name not in ("self", "scene")]
    mine = ("scene", "listen", "open_to_network", "quiet", "checkpoint", "fed")
    assert [(each.name, each.kind, each.default) for each in own.values() if each.name not in mine] == rest
    for listen in ("nowhere", "127.0.0.1", "0.0.0.0:0"):
        with pytest.raises(rhumb.InvalidError, match="listen is"):
            rhumb.serve(listen=listen)
    with pytest.raises(rhumb.InvalidError, match="open_to_network"):
        rhumb.serve(listen="0.0.0.0:0")
    with pytest.raises(rhumb.InvalidError, match="stepping"):
        rhumb.serve(stepping="slow")
    with pytest.raises(TypeError, match="tolerence"):
        rhumb.serve(tolerence=0.01)


@pytest.mark.parametrize("listen", ["0.0.0.0:0", "[::]:0"])
def test_a_server_at_all_addresses_names_one_that_others_reach(listen):
    with rhumb.serve("open", listen=listen, open_to_network=True, quiet=True) as scene:
        host, _ = scene.address.split("#")[0].rsplit(":", 1)
        assert not ipaddress.ip_address(host.strip("[]")).is_unspecified
        rhumb.connect(scene.address).join("open").close()


def test_an_address_that_is_in_use_is_named(served):
    address, fingerprint = served.address.split("#")
    assert len(fingerprint) == 64
    with pytest.raises(rhumb.ConnectError, match=address):
        rhumb.serve(listen=address)


def test_the_server_ends_with_its_scene_and_so_do_its_members():
    scene = rhumb.serve("ends", quiet=True)
    other = rhumb.connect(scene.address).join("ends", resume_within=0)
    address = scene.page()
    assert read(address)
    scene.close()
    with pytest.raises(rhumb.EndedError):
        other.advance()
    with pytest.raises(urllib.error.URLError):
        read(address)
    with pytest.raises(rhumb.ClosedError):
        scene.page()


def test_a_fingerprint_of_another_server_is_refused(served):
    address, fingerprint = served.address.split("#")
    with rhumb.connect(address, fingerprint=fingerprint), rhumb.connect(served.address, fingerprint=fingerprint):
        pass
    with pytest.raises(rhumb.ConnectError):
        rhumb.connect(f"{address}#{'0' * 64}")
    with pytest.raises(rhumb.InvalidError, match="differ"):
        rhumb.connect(served.address, fingerprint="0" * 64)
    with pytest.raises(rhumb.InvalidError, match="64 hexadecimal"):
        rhumb.connect(f"{address}#12")


def local():
    return rhumb.local("shown/here")


def served_here():
    return rhumb.serve("shown/here", quiet=True)


def of_a_server():
    return rhumb.LocalServer(own_thread=True).connect().join("shown/here")


@pytest.mark.parametrize("made", [local, served_here, of_a_server])
def test_the_page_of_a_scene_opens_names_it_and_ends_with_it(made, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    with made() as scene:
        try:
            address = rhumb.view(scene)
        except rhumb.DeniedError as missing:
            pytest.skip(str(missing))
        assert opened == [address] and address == scene.page() == rhumb.view(scene, browser=False)
        page, query = address.split("?")
        assert query == "scene=shown/here" and page.startswith("http://127.0.0.1:")
        assert b"<script" in read(address)
        scenes = json.loads(read(page + "connect.json"))["scenes"]
        assert scenes == [{"name": "shown/here"}]
    with pytest.raises(urllib.error.URLError):
        read(address)


def test_a_page_shows_what_was_queued_before_it():
    with rhumb.serve("queued", stepping="free running", quiet=True) as scene:
        scene.add_body(rhumb.Shape.ball(0.5), (0, 9, 0), "fixed")
        try:
            rhumb.view(scene, browser=False)
        except rhumb.DeniedError as missing:
            pytest.skip(str(missing))
        with rhumb.connect(scene.address).join("queued") as other:
            ends = time.monotonic() + 20
            while not len(other):
                assert time.monotonic() < ends, "the body is not there"
                other.idle(0.02)
                other.poll()


def test_the_page_of_a_server_elsewhere_is_not_known_here(served):
    with rhumb.connect(served.address).join("shared") as other, pytest.raises(rhumb.DeniedError) as denied:
        rhumb.view(other)
    # A served scene has no such flag; it has the page itself.
    assert "known to that scene alone" in str(denied.value) and "rhumb-server" in str(denied.value)


def test_an_interpreter_that_leaves_a_served_scene_and_its_page_open_ends():
    program = """
        import rhumb
        kept = [rhumb.serve(quiet=True), rhumb.local()]
        for scene in kept:
            scene.advance()
            try:
                scene.page()
            except rhumb.DeniedError:
                pass
        print("left")
    """
    ended = python(program)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "left\n", "")


def run_module(*arguments):
    command = [sys.executable, "-m", "rhumb", "--no-browser", "--seconds", "1", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_a_ball_falls_from_one_command():
    ended = run_module()
    if "this build has no page" in ended.stderr:
        pytest.skip(ended.stderr)
    address, *lines = ended.stdout.splitlines()
    assert address.startswith("http://127.0.0.1:"), ended.stderr
    heights = [float(line.split(" is ")[1].split()[0]) for line in lines]
    assert len(heights) >= 2 and heights[-1] < heights[0] < 10.01


def test_a_file_is_shown_from_one_command_and_a_wrong_one_is_an_error(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text("<robot name='r'><link name='world'><visual/></link></robot>")
    ended = run_module(str(path))
    if "this build has no page" in ended.stderr:
        pytest.skip(ended.stderr)
    assert "visual" in ended.stdout and "http://127.0.0.1:" in ended.stdout, ended.stderr
    ended = run_module(str(tmp_path / "nothing.urdf"))
    assert ended.returncode == 1 and ended.stderr.startswith("error: ") and "no such file" in ended.stderr


def test_a_checkpoint_with_what_it_cannot_go_with_is_refused_by_both_names():
    with rhumb.local() as scene:
        saved = scene.save()
    for options, said in (({"fed": True}, "fed is True.*checkpoint"), ({"condition": "create"}, "condition is 'create'.*checkpoint")):
        with pytest.raises(rhumb.InvalidError, match=said):
            rhumb.serve(checkpoint=saved, quiet=True, **options)
