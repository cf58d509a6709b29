"""Decides which viewers may connect: those on this machine, from pages that the user trusts.

Any page of a browser may open a WebSocket to this machine. The header Origin names the page; Host has the name by which
it came, which is not this machine's when the page's own name leads here (DNS rebinding).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from ipaddress import ip_address
from typing import Final
from urllib.parse import urlsplit

ORIGINS: Final = ("https://app.foxglove.dev",)
"""Pages that may connect, in addition to those of this machine."""
VIEWERS: Final = 32
"""The most viewers at a time."""


def refusal(hosts: Sequence[str], origins: Sequence[str], allowed: Collection[str]) -> str:
    """The reason why a viewer with these headers may not connect; "" where it may.

    Args:
        hosts: the values of all headers `Host`.
        origins: the values of all headers `Origin`; programs that are no browser send none.
        allowed: origins in addition to those of this machine.
    """
    if len(hosts) != 1 or not is_local(f"//{hosts[0]}"):
        return f"Host {_shown(hosts)}: expected localhost or 127.0.0.1"
    if origins and (len(origins) != 1 or not (origins[0] in allowed or is_local(origins[0]))):
        return f"Origin {_shown(origins)}: not allowed; if you trust it: aiorts foxglove --origin {_shown(origins)}"
    return ""


def is_local(url: str) -> bool:
    """Whether a URL leads to this machine, by the name localhost or an address."""
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname or "", parts.port
    except ValueError:
        return False
    if parts.scheme not in ("", "http", "https") or parts.username is not None or parts.path.strip("/"):
        return False
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def _shown(values: Sequence[str]) -> str:
    return ", ".join(value[:100] for value in values[:3]) or "none"
