"""The notebook runs to its end, and is committed without outputs."""

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
for needed in ("ipykernel", "matplotlib"):
    pytest.importorskip(needed)

NOTEBOOK = Path(__file__).parent.parent / "examples" / "frontier.ipynb"


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def test_the_notebook_is_committed_without_outputs():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert outputs(notebook) == []
    assert all(cell.execution_count is None for cell in notebook.cells if cell.cell_type == "code")


def test_the_notebook_plots_fewer_bytes_for_each_coarser_tolerance(server, monkeypatch):
    monkeypatch.setenv("RHUMB_ADDRESS", server.address)
    monkeypatch.setenv("RHUMB_FINGERPRINT", server.fingerprint)
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    resources = {"metadata": {"path": os.fspath(NOTEBOOK.parent)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    # Not what a library says on standard error, such as Matplotlib when it builds its cache of fonts.
    streams = [output for output in outputs(notebook) if output.output_type == "stream"]
    printed = "".join(output.text for output in streams if output.name == "stdout")
    rows = [[float(number) for number in line.split()] for line in printed.splitlines()[1:]]
    assert [row[0] for row in rows] == [0.005, 0.01, 0.02, 0.05, 0.1, 0.2]
    kbits = [row[1] for row in rows]
    assert kbits == sorted(kbits, reverse=True) and kbits[-1] < 0.7 * kbits[0]
    for tolerance, _, median, high, greatest in rows:
        # The first run stands for the truth within a millimetre; four digits were printed.
        assert 0 < median <= high <= greatest <= tolerance + 0.001 + 0.0001
    pictures = [output for output in outputs(notebook) if "image/png" in output.get("data", {})]
    assert len(pictures) == 1
