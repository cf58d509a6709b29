"""What in-ports and out-ports have in common: the declaration, the binding, the way to the kernel."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from contextlib import nullcontext
from types import coroutine
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, TypeVar

from aiorts.errors import ClosedError
from aiorts.kernel.port_types import port_type
from aiorts.model.profile import PortProfile

if TYPE_CHECKING:
    from aiorts.kernel.blocking import PortLock
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.host import PortHost

__all__ = ("NOTHING", "OFF", "UNLOCKED", "UNSUSPENDED", "Port", "Turns", "give_turn")

T = TypeVar("T")

UNSUSPENDED: Final = 255
"""Awaited reads and writes that may follow one another without giving the loop a turn."""

UNLOCKED: Final = nullcontext()

OFF: Final[deque[Any]] = deque(maxlen=0)
"""What a port has for a queue while its fast path is off: there is never anything in it."""

NOTHING: Final[Any] = object()
"""In the place of an in-port's sample read last, while a cycle of an event context has read none."""


class Turns:
    """What is left of a component's share of uninterrupted awaited reads and writes."""

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = UNSUSPENDED


@coroutine
def give_turn() -> Generator[None, None, None]:
    """Let everything else that is ready run once; asyncio's `sleep(0)` without its wrapper."""
    yield


class Port(Generic[T]):
    """What in-ports and out-ports have in common. Unbound it is a declaration, bound it belongs to a component.

    Args:
        type: the record (or dataclass, or scalar type) that travels.
        unit: unit of the data, such as "m/s"; unequal units are refused at connect.
        shape: shape of the data, such as (3,), -1 for any length; checked at every write.
        doc: one line for tools.
        name: the port's name where it is not the attribute's.
        max_connectors: connectors the port takes at the most; None is unlimited.
    """

    __slots__ = (
        "_connectors",
        "_fast",
        "_host",
        "_lock",
        "_turns",
        "_type",
        "doc",
        "max_connectors",
        "name",
        "shape",
        "type",
        "unit",
    )

    direction: ClassVar[str] = ""

    def __init__(
        self,
        type: type[T],  # noqa: A002 - the word users expect
        *,
        unit: str | None = None,
        shape: tuple[int, ...] | None = None,
        doc: str = "",
        name: str | None = None,
        max_connectors: int | None = None,
    ) -> None:
        self.type = type
        self.unit = unit
        self.shape = shape
        self.doc = doc
        self.name = name or ""
        self.max_connectors = max_connectors
        self._host: PortHost | None = None
        self._connectors: tuple[Connector, ...] = ()
        self._fast: deque[T] = OFF
        self._lock: PortLock | None = None
        self._turns = Turns()

    def _attach(self, host: PortHost, name: str) -> None:
        self._host = host
        self.name = name
        self._type = port_type(self.type)
        self._turns = host.turns

    @property
    def path(self) -> str:
        """`component.port`, or the bare name of a declaration."""
        return self.name if self._host is None else f"{self._host.name}.{self.name}"

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The live connectors of this port, in order of connection."""
        return self._connectors

    @property
    def profile(self) -> PortProfile:
        """What this port is, frozen."""
        from aiorts.types import type_name

        return PortProfile(
            self.name,
            self.direction,
            type_name(self.type),
            self.unit,
            self.shape,
            self.doc,
            tuple(connector.name for connector in self._connectors),
        )

    def __repr__(self) -> str:
        extras = "".join(f" {word}={value!r}" for word, value in (("unit", self.unit), ("shape", self.shape)) if value)
        count = "unbound" if self._host is None else f"{len(self._connectors)} connectors"
        return f"<{self.__class__.__name__} {self.path or '?'} {self.type.__name__}{extras} {count}>"

    def _repr_html_(self) -> str:
        from aiorts.kernel.html import port_html

        return port_html(self)

    def _bound(self) -> PortHost:
        host = self._host
        if host is None:
            raise ClosedError(
                f"{self.name or self.__class__.__name__}: this port belongs to no component; "
                "was super().__init__() called in the component's __init__?"
            )
        if host.debug:
            host.check_port_thread(self.path)
        return host

    def _removed(self) -> bool:
        """Whether this live port was taken away, or its component was."""
        host = self._host
        return host is not None and not (host.alive and host.ports.get(self.name) is self)

    def _raise_if_removed(self) -> None:
        if self._removed():
            raise ClosedError(f"{self.path}: the port is closed: it or its component was removed")

    def _on_loop(self, callback: Callable[[], None]) -> None:
        """Run `callback` on the kernel's loop: now if this is its thread, soon otherwise."""
        host = self._host
        if host is None or host.on_loop_thread():
            callback()
        else:
            host.loop.call_soon_threadsafe(callback)

    def _refresh(self) -> None:
        """The connectors are others now, or what they are asked to do."""
        raise NotImplementedError

    def _choose_path(self) -> None:
        """Decide whether the fast path is on."""
        raise NotImplementedError
