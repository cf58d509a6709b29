"""A browser for each module; without Chromium or playwright the tests here are skipped, and say so."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser_parts import CHROMIUM, browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module", autouse=True)
def runtime() -> Iterator[str]:
    """The folder of sockets and of the state of a module: its kernels and servers go on from test to test."""
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        patch.setenv("XDG_STATE_HOME", f"{folder}/state")
        yield folder


@pytest.fixture(scope="module")
def chromium(runtime: str) -> Iterator[Browser]:
    """Headless Chromium."""
    if CHROMIUM is None:
        pytest.skip("NOT RUN: there is no chromium on this machine")
    if find_spec("playwright") is None:
        pytest.skip("NOT RUN: playwright, of the extra dev, is not installed")
    with browser() as started:
        yield started


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the screenshots of this run are."""
    return tmp_path_factory.mktemp("pictures")
