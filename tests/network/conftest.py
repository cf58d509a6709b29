"""Two hosts with a network between them.

The engine's own threads and descriptors live as long as the process: they are made before a test counts.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from aiorts.testing import check_transport
from network.host_parts import two_hosts


@pytest.fixture(scope="session", autouse=True)
def _engine_is_there() -> None:
    pytest.importorskip("zenoh")
    from network.network_parts import loopback

    check_transport(loopback, only=["answers_questions"])


@pytest.fixture
def hosts() -> Iterator[tuple[list[str], list[str]]]:
    """What runs a command on each of two hosts with a network between them: 10.77.0.1 and 10.77.0.2."""
    with two_hosts() as made:
        yield made
