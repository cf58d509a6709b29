"""The result of `Kernel.connect` for three ports or more: their connectors as one handle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence


class AnyConnector(Protocol):
    """A connector of any kind."""

    @property
    def name(self) -> str: ...

    @property
    def closed(self) -> bool: ...


C = TypeVar("C", bound=AnyConnector)


class _Owner(Protocol):
    """The connectors of the kernel (`Connections`)."""

    def end_whole(self, connection: Connection[Any]) -> None: ...


class Connection(tuple[C, ...]):
    """The connectors of one `Kernel.connect`, in the order in which they were made: a tuple that is ended as one.

    A connector that ends alone, as when its port is removed, leaves the others in force. A connector that supervision
    makes after a restart is in `Kernel.connectors`, by the same name, and not in here.
    """

    _owner: _Owner

    @property
    def connectors(self) -> tuple[C, ...]:
        """The connectors, those that have ended among them."""
        return tuple(self)

    @property
    def closed(self) -> bool:
        """Whether all connectors have ended."""
        return all(each.closed for each in self)

    def close(self) -> None:
        """End the connectors that have not ended yet, as `Kernel.disconnect` does, on the kernel's loop. Idempotent.

        Raises:
            ThreadError: called in another thread than the loop's; nothing was ended.
        """
        if not self.closed:
            self._owner.end_whole(self)

    def __repr__(self) -> str:
        ended = sum(each.closed for each in self)
        names = ", ".join(each.name for each in self)
        mark = " closed" if ended == len(self) else f" {ended} closed" if ended else ""
        return f"<Connection {names}{mark}>"


def joined(made: Sequence[Any], owner: _Owner) -> Connection[Any]:
    """These connectors as one handle."""
    connection: Connection[Any] = Connection(made)
    connection._owner = owner
    return connection
