"""The public face: what `__all__` says is what there is, and importing it is light and changes nothing."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import tomllib

import pytest
from test_layers import PUBLIC, ROOT, module_of, sources


@pytest.mark.parametrize("module", PUBLIC)
def test_every_exported_name_exists(module: str) -> None:
    loaded = importlib.import_module(module)
    assert loaded.__all__
    assert [name for name in loaded.__all__ if not hasattr(loaded, name)] == []
    assert len(set(loaded.__all__)) == len(loaded.__all__)


def test_no_name_that_is_imported_late_is_that_of_a_submodule() -> None:
    """Importing `package.name` puts the module in the place of the face's `name`, whoever does it first."""
    clashes = []
    for face in sources("aiorts", "plugins"):
        if face.name == "__init__.py":
            beside = {path.stem for path in face.parent.iterdir()}
            tree = ast.parse(face.read_text(encoding="utf-8"))
            calls = {ast.unparse(node.func).strip("_") for node in ast.walk(tree) if isinstance(node, ast.Call)}
            late = [node for node in tree.body if isinstance(node, ast.If) and "late" in calls]
            names = {
                alias.asname or alias.name
                for node in late
                for part in node.body
                if isinstance(part, ast.ImportFrom) and part.module != module_of(face)
                for alias in part.names
            }
            clashes += [f"{face.parent}: {name}" for name in names & beside]
    assert clashes == []


@pytest.mark.parametrize("module", ["aiorts", "aiorts.types", "aiorts.wire", "aiorts.testing"])
def test_every_public_name_that_is_imported_is_exported(module: str) -> None:
    loaded = importlib.import_module(module)
    assert loaded.__file__ is not None
    with open(loaded.__file__, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    names = {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "aiorts"
        for alias in node.names
    }
    assert {name for name in names if not name.startswith(("_", "*"))} - set(loaded.__all__) <= {"TYPE_CHECKING"}


_HEAVY = {"numpy", "uvloop", "zenoh", "msgpack", "click", "json", "pathlib", "tomllib", "typing_extensions", "decimal"}


@pytest.mark.slow(kept_by="cli/test_run.py::test_help_and_version_are_fast_and_load_no_system")
@pytest.mark.parametrize(
    ("program", "allowed"),
    [
        ("import aiorts", set()),
        ("import aiorts.errors", set()),
        ("import aiorts.types", set()),
        ("from aiorts import Kernel, Component, InPort, OutPort, EventContext, PeriodicContext", set()),
        ("from aiorts.cli.app import run_command; run_command(['--help'])", {"click"}),
    ],
)
def test_import_is_light(program: str, allowed: set[str]) -> None:
    heavy = _HEAVY | ({"asyncio", "importlib.metadata"} if allowed else set())
    code = f"import sys; {program}; print('loaded', *sorted({heavy!r} & sys.modules.keys()))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=100
    )
    assert set(done.stdout.splitlines()[-1].split()[1:]) == allowed


def test_version_is_the_one_of_the_package() -> None:
    aiorts = importlib.import_module("aiorts")
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert aiorts.__version__ == tomllib.load(file)["project"]["version"]


def test_package_is_marked_as_typed() -> None:
    assert (ROOT / "aiorts" / "py.typed").is_file()
    assert (ROOT / "plugins" / "aiorts_flexi" / "py.typed").is_file()
    assert (ROOT / "plugins" / "aiorts_log" / "py.typed").is_file()
