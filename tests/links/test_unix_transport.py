"""The transport of one host keeps what every transport promises."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest

from aiorts.links import Transport
from aiorts.links.unix import UnixTransport
from aiorts.testing import TRANSPORT_CHECKS, check_transport


@pytest.fixture(autouse=True)
def _own_runtime_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nobody else's kernels; its path is short, as those of sockets have to be."""
    with tempfile.TemporaryDirectory(prefix="aio") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


def unix() -> tuple[Transport, Transport]:
    return UnixTransport(), UnixTransport()


@pytest.mark.parametrize("name", TRANSPORT_CHECKS)
def test_unix_sockets_keep_every_promise(name: str) -> None:
    check_transport(unix, only=[name])
