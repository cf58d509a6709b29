"""A folder for the sockets of one test: its kernels meet no others.

A `conftest.py` that imports the fixture gives one to each test of its folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from tempfile import TemporaryDirectory

import pytest


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The folder that takes the place of XDG_RUNTIME_DIR and holds that of XDG_STATE_HOME; its path is short, as those
    of sockets have to be.
    """
    with TemporaryDirectory(prefix="al") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        monkeypatch.setenv("XDG_STATE_HOME", f"{folder}/state")
        yield folder
