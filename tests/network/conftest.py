"""The engine's own threads and descriptors live as long as the process: they are made before a test counts."""

from __future__ import annotations

import pytest

from aiorts.testing import check_transport


@pytest.fixture(scope="session", autouse=True)
def _engine_is_there() -> None:
    pytest.importorskip("zenoh")
    from network.network_parts import loopback

    check_transport(loopback, only=["answers_questions"])
