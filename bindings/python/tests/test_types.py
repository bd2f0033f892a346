"""The stubs and a program that uses them are strictly typed."""

import importlib.util
import pathlib
import shutil
import subprocess
import sys

import pytest

import rhumb

HERE = pathlib.Path(__file__).parent


@pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", "import mypy"], capture_output=True).returncode != 0,
    reason="mypy is not installed",
)
def test_mypy_finds_nothing_in_the_package_and_in_an_example(tmp_path):
    package = tmp_path / "rhumb"
    shutil.copytree(pathlib.Path(rhumb.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    if importlib.util.find_spec("gymnasium") is None:
        (package / "learning.py").unlink()
    shutil.copy(HERE.parent / "examples" / "five_tasks.py", tmp_path)
    command = [sys.executable, "-m", "mypy", "--strict", "--python-version", "3.10", "rhumb", "five_tasks.py"]
    checked = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr
