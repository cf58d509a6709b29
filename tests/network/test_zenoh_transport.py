"""The transport between hosts keeps what every transport promises; two sessions over the loopback of one machine."""

from __future__ import annotations

import pytest

from aiorts.testing import TRANSPORT_CHECKS, check_transport

pytest.importorskip("zenoh")

from network.network_parts import loopback


@pytest.mark.parametrize("name", TRANSPORT_CHECKS)
def test_it_keeps_every_promise(name: str) -> None:
    check_transport(loopback, only=[name])
