"""Kernels of other hosts over Zenoh: the transport of links between machines, and the service that switches it on.

`keys` says what is where, `envelope` what a message looks like, `sending` how much may be under way; none of them knows
the engine. `engine` is all that does, `transport` puts them together, and `network` is the service `zenoh`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts_zenoh.network import Network, NetworkSettings
    from aiorts_zenoh.transport import ZenohTransport

__all__ = ("Network", "NetworkSettings", "ZenohTransport")

_late(
    globals(),
    {"aiorts_zenoh.network": "Network NetworkSettings", "aiorts_zenoh.transport": "ZenohTransport"},
)
