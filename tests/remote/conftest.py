"""Kernels of a test meet no others: each test has a run-time folder of its own."""

from __future__ import annotations

from collections.abc import Iterator
from tempfile import TemporaryDirectory

import pytest


@pytest.fixture(autouse=True)
def _runtime_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with TemporaryDirectory(prefix="al") as folder:  # a short path: sockets have room for about a hundred letters
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield
