"""Each test has a folder of its own for sockets."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest

import aiorts.observe.profiling  # noqa: F401 - late in two threads at once, pytest's rewriting may fail (CPython 3.11)


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The folder that takes the place of XDG_RUNTIME_DIR; its path is short, as those of sockets have to be."""
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield folder
