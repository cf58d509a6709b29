"""Connectors whose ends are in two kernels, and what carries them: the seam for transports of plugins."""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.links.calls import FarProvider
    from aiorts.links.connecting import Links, LinksSettings
    from aiorts.links.ledgers import LinkLedger
    from aiorts.links.reaching import find_transport
    from aiorts.links.transport import (
        BaseChannel,
        BaseTransport,
        Caller,
        Channel,
        ChannelEvents,
        KernelFace,
        LinkOffer,
        Peer,
        Transport,
        answer_of,
        checked_peer,
    )
    from aiorts.links.unix import UnixTransport
    from aiorts.model.links import RIGHTS, Allowed, Turn, turn_of

__all__ = (
    "RIGHTS",
    "Allowed",
    "BaseChannel",
    "BaseTransport",
    "Caller",
    "Channel",
    "ChannelEvents",
    "FarProvider",
    "KernelFace",
    "LinkLedger",
    "LinkOffer",
    "Links",
    "LinksSettings",
    "Peer",
    "Transport",
    "Turn",
    "UnixTransport",
    "answer_of",
    "checked_peer",
    "find_transport",
    "turn_of",
)

late()
