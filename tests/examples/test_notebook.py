"""The notebook runs from its first cell to its last, with and without Jupyter, and fails when its system is wrong."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from aiorts.testing import simulate

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "notebook"
NOTEBOOK = FOLDER / "heading.ipynb"
JUPYTER = [name for name in ("nbclient", "ipykernel") if importlib.util.find_spec(name) is None]


def runner() -> ModuleType:
    spec = importlib.util.spec_from_file_location("notebook_run", FOLDER / "run.py")
    assert spec is not None and spec.loader is not None  # noqa: PT018 - one thing
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_changed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, old: str = "", new: str = "") -> list[Any]:
    """Run the notebook in virtual time with a text replaced; the values of its code cells."""
    monkeypatch.chdir(FOLDER)
    notebook = tmp_path / "changed.ipynb"
    text = NOTEBOOK.read_text("utf-8")
    assert old in text
    notebook.write_text(text.replace(old, new) if old else text, "utf-8")
    values: list[Any] = simulate(lambda _clock: runner().run_notebook(notebook))
    return values


def test_it_is_a_notebook_of_format_4_without_stored_outputs() -> None:
    notebook = json.loads(NOTEBOOK.read_text("utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = notebook["cells"]
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert {cell["cell_type"] for cell in cells} == {"markdown", "code"}
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells if "outputs" in cell)
    assert all(set(cell) >= {"id", "metadata", "source"} for cell in cells)


def test_its_cells_build_run_and_change_a_system(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    values = [repr(value) for value in run_changed(monkeypatch, tmp_path) if value is not None]
    assert values[0] == "(1216, 15)"
    wrong, repaired, degrees = (float(re.findall(r"last (\S+)", v)[0]) for v in values if v.startswith("error"))
    assert wrong > 0.1
    assert abs(repaired) < 1e-6
    assert abs(degrees) < 1e-4
    assert "headings right" in values[-2]
    assert values[-1] == "<Kernel notebook closed 0 components 0 contexts 0 connectors>"


@pytest.mark.slow
def test_its_kernel_shows_itself_as_a_table(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kernel = "await kernel.aclose()"
    values = run_changed(monkeypatch, tmp_path, kernel, f"html = kernel._repr_html_(); {kernel}; kernel = html")
    assert "<td>difference0.output</td><td>degrees0.radians</td>" in values[-1]
    assert "<td>odometry0</td><td>odometry</td><td>work: active</td>" in values[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("configure(base=235.0)", "configure(base=234.9)", AssertionError),  # the check cell finds a wrong heading
        ("await kernel.disconnect(shows)", "pass", AssertionError),  # and a connection that is left
        ("kernel.create(scope)", "kernel.create(scop)", NameError),
    ],
)
def test_it_fails_when_a_cell_does(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, old: str, new: str, error: type[BaseException]
) -> None:
    with pytest.raises(error):
        run_changed(monkeypatch, tmp_path, old, new)


@pytest.mark.skipif(bool(JUPYTER), reason=f"not installed: {', '.join(JUPYTER)}")
def test_jupyter_runs_it(tmp_path: Path) -> None:
    # A copy of the folders: nothing is written into the sources.
    for name in ("notebook", "roomba"):
        shutil.copytree(ROOT / "examples" / name, tmp_path / name)
    done = subprocess.run(
        [sys.executable, "-c", "from nbclient.cli import main; main()", "--inplace", "notebook/heading.ipynb"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    cells = json.loads((tmp_path / "notebook" / "heading.ipynb").read_text("utf-8"))["cells"]
    shown = [set(output.get("data", ())) for cell in cells for output in cell.get("outputs", ())]
    assert sum("image/svg+xml" in one for one in shown) == 3
    assert sum("text/html" in one for one in shown) == 5
    assert not [output for cell in cells for output in cell.get("outputs", ()) if output["output_type"] == "error"]
