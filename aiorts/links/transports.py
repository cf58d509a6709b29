"""Transports by name: aiorts' own, and those that plugins offer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.errors import PluginError

if TYPE_CHECKING:
    from aiorts.kernel.extensions.catalogue import Catalogue
    from aiorts.links.transport import Transport

_NEEDED = ("open", "close", "presence", "channel", "ask", "answer")


def find_transport(name: str, plugins: Catalogue) -> Transport:
    """A new transport of that name: "unix", or one that a plugin offers, which is imported now.

    Raises:
        PluginError: no plugin offers it, it cannot be loaded or made, or it is no transport.
    """
    if name == "unix":
        from aiorts.links.unix import UnixTransport  # late: it is chosen by its name

        return UnixTransport()
    offered = plugins.find("transports", name)
    kind = offered.load()
    try:
        made: Transport = kind()
    except Exception as error:  # a plugin's border: what its constructor does is reported as the plugin's
        raise PluginError(f"transport {name!r}: cannot be made: {type(error).__name__}: {error}") from error
    if missing := [method for method in _NEEDED if not callable(getattr(made, method, None))]:
        raise PluginError(f"transport {name!r}: {type(made).__name__} has no method {missing[0]}")
    return made
