"""The public face: what `__all__` says is what there is, and importing it is light and changes nothing."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import tomllib

import pytest
from test_layers import PUBLIC, ROOT


@pytest.mark.parametrize("module", PUBLIC)
def test_every_exported_name_exists(module: str) -> None:
    loaded = importlib.import_module(module)
    assert loaded.__all__
    assert [name for name in loaded.__all__ if not hasattr(loaded, name)] == []
    assert len(set(loaded.__all__)) == len(loaded.__all__)


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
    assert {name for name in names if not name.startswith("_")} - set(loaded.__all__) == set()


@pytest.mark.parametrize("module", ["aiorts", "aiorts.types", "aiorts.errors"])
def test_import_is_light(module: str) -> None:
    code = (
        f"import sys, {module}; print(*sorted({{'numpy', 'uvloop', 'zenoh', 'msgpack', 'click'}} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & {"numpy", "uvloop", "zenoh"} == set()


def test_version_is_the_one_of_the_package() -> None:
    aiorts = importlib.import_module("aiorts")
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert aiorts.__version__ == tomllib.load(file)["project"]["version"]


def test_package_is_marked_as_typed() -> None:
    assert (ROOT / "aiorts" / "py.typed").is_file()
    assert (ROOT / "plugins" / "aiorts_flexi" / "py.typed").is_file()
    assert (ROOT / "plugins" / "aiorts_log" / "py.typed").is_file()
