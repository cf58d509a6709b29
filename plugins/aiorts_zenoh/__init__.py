"""Kernels of other hosts over Zenoh: links between machines, presence, commands for other machines, and security.

`engine` alone knows the engine, and `network` is the service `zenoh`, which switches all else on:

- links: `transport`, with `envelope` (the layout of messages), `sending` (how much may be under way) and `clocks`;
- presence: `presence`, with `names` (the owner of a name), `gate` and `limits` (cutting off) and `neighbours`;
- commands: `serving` is a kernel's end of a session, `gateway` that of `aiorts at`; `carried` and `stream` carry it;
- `keys` has the keys of messages and tokens, `security` the rules of who sends what. SPEC.md tells other programs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late

if TYPE_CHECKING:
    from aiorts_zenoh.network import Network, NetworkSettings
    from aiorts_zenoh.transport import ZenohTransport

__all__ = ("Network", "NetworkSettings", "ZenohTransport")

late()
