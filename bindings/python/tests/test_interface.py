"""The stubs say what the native module has, and the other way round."""

import ast
import inspect
import pathlib

import rhumb
from rhumb import _native


def stubs():
    path = pathlib.Path(rhumb.__file__).with_name("_native.pyi")
    return ast.parse(path.read_text())


def members(node):
    names = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    return names - {"__init__"}


def test_the_stubs_name_every_class_and_method():
    classes = {node.name: members(node) for node in stubs().body if isinstance(node, ast.ClassDef)}
    # A type of a dictionary is not a class of the module.
    assert classes.pop("_Statistics") == classes.pop("_Upstream") == set()
    native = {name: value for name, value in vars(_native).items() if inspect.isclass(value)}
    assert set(classes) == set(native)
    for name, value in native.items():
        own = {member for member in vars(value) if not member.startswith("__")}
        special = ("__len__", "__contains__", "__enter__", "__exit__", "__bytes__", "__hash__")
        own |= {member for member in special if vars(value).get(member) is not None}
        assert classes[name] == own, name
    functions = {node.name for node in stubs().body if isinstance(node, ast.FunctionDef)}
    assert functions == {"connect", "file_settings", "local", "serve"} | {
        "advance_scenes",
        "numbers_of_scenes",
        "resting_of_scenes",
    }


def test_the_stubs_have_the_parameters_of_every_method():
    for node in stubs().body:
        if not isinstance(node, ast.ClassDef) or node.name in ("_Statistics", "_Upstream"):
            continue
        for method in node.body:
            native = inspect.getattr_static(getattr(_native, node.name), getattr(method, "name", ""), None)
            if not isinstance(method, ast.FunctionDef) or method.name.startswith("__") or method.decorator_list:
                continue
            expected = [argument.arg for argument in method.args.args + method.args.kwonlyargs]
            found = list(inspect.signature(native).parameters)
            assert found == expected, f"{node.name}.{method.name}"


def test_the_version_is_that_of_the_package():
    assert rhumb.__version__.count(".") == 2
    assert set(rhumb.__all__) <= set(dir(rhumb))
