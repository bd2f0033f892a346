"""help() says what the stubs say, and suffices for the first programs."""

import ast
import builtins
import importlib.util
import inspect
import pathlib
import pydoc
import re
import subprocess
import sys

import numpy as np
import pytest

import rhumb
from rhumb import _native

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "examples"))
import five_tasks  # noqa: E402


def stubs():
    return ast.parse(pathlib.Path(rhumb.__file__).with_name("_native.pyi").read_text())


def documented():
    """Each class, function, method and property of the module with its documentation in the stubs."""
    for node in stubs().body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, getattr(_native, node.name), ast.get_docstring(node)
        if not isinstance(node, ast.ClassDef) or not hasattr(_native, node.name):
            continue
        owner = getattr(_native, node.name)
        yield node.name, owner, ast.get_docstring(node)
        for member in node.body:
            if isinstance(member, ast.FunctionDef) and not member.name.startswith("__"):
                native = inspect.getattr_static(owner, member.name)
                if isinstance(native, staticmethod):
                    native = getattr(owner, member.name)
                yield f"{node.name}.{member.name}", native, ast.get_docstring(member)


def test_everything_has_a_documentation_which_is_that_of_the_stubs():
    count = 0
    for name, native, text in documented():
        assert text, f"{name} has none in the stubs"
        found = inspect.getdoc(native)
        assert found == text, f"{name}: run bindings/python/write_docs.py"
        count += 1
    assert count > 100


def test_help_names_the_words_of_every_option():
    text = pydoc.render_doc(rhumb.Connection.join, renderer=pydoc.plaintext)
    for word in ("lockstep", "free running", "create or join", "z-up", "unreal", "raise", "events"):
        assert f'"{word}"' in text
    text = pydoc.render_doc(rhumb, renderer=pydoc.plaintext)
    for word in ('"kinematic"', '"revolute"', "RefusedError", '"contact began"', "friction, restitution"):
        assert word in text
    assert "**keywords" not in text


PAGE = HERE.parents[2] / "docs" / "book" / "src" / "five-tasks.md"


def snippets():
    """Each program of the page of five tasks, with the engine that it is for."""
    text = PAGE.read_text()
    return re.findall(r"^(\w+):\n\n```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.skipif(not PAGE.exists(), reason="the package alone has no book")
def test_each_program_of_the_page_runs_as_it_stands():
    programs = snippets()
    assert len(programs) == 15
    for engine, program in programs:
        if importlib.util.find_spec(engine.lower()) is None:
            continue
        ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
        assert ended.returncode == 0 and ended.stdout.strip(), f"{engine}: {program}\n{ended.stderr}"


@pytest.mark.skipif(not PAGE.exists(), reason="the package alone has no book")
def test_each_program_of_the_page_imports_what_it_names():
    for engine, program in snippets():
        names = [node for node in ast.walk(ast.parse(program)) if isinstance(node, ast.Name)]
        made = {node.id for node in names if isinstance(node.ctx, ast.Store)} | set(dir(builtins))
        for node in ast.walk(ast.parse(program)):
            if isinstance(node, ast.Import):
                made |= {alias.asname or alias.name for alias in node.names}
        assert {node.id for node in names} <= made, f"{engine}: {program}"


def test_an_error_names_the_words_of_an_option(scene):
    for call, words in (
        (lambda: scene.add_body(rhumb.Shape.ball(1), kind="static"), ("'static'", '"fixed"', '"kinematic"')),
        (lambda: rhumb.Joint("hinge", 1, 2), ('"hinge"', '"revolute"', '"prismatic"')),
    ):
        with pytest.raises(rhumb.InvalidError) as raised:
            call()
        text = str(raised.value).replace('"static"', "'static'")
        for word in words:
            assert word in text, text


def test_the_five_tasks_of_the_example(server):
    def result_of(task):
        with five_tasks.join(server.address, server.fingerprint, task.__name__) as scene:
            result = task(scene)
            scene.delete()
            return result

    assert result_of(five_tasks.falling_ball) == pytest.approx(0.5, abs=0.06)
    boxes = result_of(five_tasks.thousand_boxes)
    assert boxes.shape == (1000, 3) and np.isfinite(boxes).all() and boxes[:, 2].min() > 0
    assert result_of(five_tasks.ray)[1] == pytest.approx(10, abs=0.01)
    assert result_of(five_tasks.hinge_with_motor) == pytest.approx(1.0, abs=0.1)
    [contact] = result_of(five_tasks.contacts_now)
    assert contact.normal == pytest.approx((0, 0, 1), abs=1e-3) and contact.force > 0


def test_what_is_printed_says_what_it_is(scene):
    ball = scene.add_body(rhumb.Shape.ball(0.5), (0, 5, 0))
    scene.report_events(ball, contacts=True)
    scene.advance()
    printed = {
        rhumb.Shape.ball(0.5): "Shape.ball(0.5)",
        rhumb.Shape.cuboid(1, 2, 3): "Shape.cuboid(1, 2, 3)",
        rhumb.Shape.mesh(np.eye(3), [(0, 1, 2)]): "Shape.mesh(<3 points>, <1 triangles>)",
        rhumb.Shape.compound([(rhumb.Shape.ball(1), (0, 0, 0))]): "Shape.compound(<Shape.ball(1)>)",
        rhumb.Query.ray((0, 1, 0), (0, -2, 0)): "Query.ray((0, 1, 0), (0, -2, 0), hits=1)",
        rhumb.Joint("revolute", 1, 2, limits={3: (-1, 1)}): "Joint(\"revolute\", 1, 2, limits={3: (-1, 1)})",
        rhumb.WheelInput(0.5, 2): "WheelInput(steering=0.5, force=2, brake=0)",
        scene: '<rhumb.Scene "test-what-is-printed-says-what-it-is", tick 1, 1 bodies>',
    }
    for value, text in printed.items():
        assert repr(value) == text
    placed = next(event for event in scene.events() if event.kind == "body placed")
    assert repr(placed) == f"Event(\"body placed\", tick={placed.tick}, body={ball})"
    assert "up=(0, 1, 0)" in repr(rhumb.Character(up=(0, 1, 0))) and "snap" not in repr(rhumb.Character())
    scene.close()
    assert repr(scene).endswith("closed>")
