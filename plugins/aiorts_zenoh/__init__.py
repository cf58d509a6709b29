"""Kernels of other hosts over Zenoh: links between machines, who is there, commands for other machines, and security.

`engine` is all that knows the engine, and `network` is the service `zenoh`, which switches the rest on:

- links: `transport`, with `envelope` (what a message looks like), `sending` (how much may be under way) and `clocks`;
- who is there: `presence`, with `names` (who owns a name), `gate` and `limits` (who is cut off) and `neighbours`;
- commands: `serving` is a kernel's end of a session, `gateway` that of `aiorts at`; `carried` and `stream` carry it;
- `keys` says what lies where, and `security` who may send what. SPEC.md has all of it for other programs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late

if TYPE_CHECKING:
    from aiorts_zenoh.network import Network, NetworkSettings
    from aiorts_zenoh.transport import ZenohTransport

__all__ = ("Network", "NetworkSettings", "ZenohTransport")

late()
