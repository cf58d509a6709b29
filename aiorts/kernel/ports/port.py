"""The common base of in-ports and out-ports: the declaration, the binding, the way to the kernel."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from types import coroutine
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, Protocol, TypeVar

from aiorts.errors import ClosedError, DeclarationError, WiringError
from aiorts.kernel.ports.port_types import port_type
from aiorts.model.profile import PortProfile

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import PortHost
    from aiorts.model.names import Path

T = TypeVar("T")
C = TypeVar("C", covariant=True)
P = TypeVar("P", bound="Port[Any]")
D = TypeVar("D", bound="PortDeclaration")

UNSUSPENDED: Final = 255
"""How many awaited reads and writes may follow one another before the loop gets a turn."""

UNLOCKED: Final = nullcontext()

OFF: Final[deque[Any]] = deque(maxlen=0)
"""The queue of a port while its fast path is off: always empty."""

NOTHING: Final[Any] = object()
"""Stands for "no sample", such as an in-port's last read sample while a cycle of an event context has read none."""


class Turns:
    """A component's remaining share of uninterrupted awaited reads and writes."""

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = UNSUSPENDED


@coroutine
def give_turn() -> Generator[None, None, None]:
    """Let everything else that is ready run once; asyncio's `sleep(0)` without its wrapper."""
    yield


class PortDeclaration:
    """A port as a class body declares it: it knows how a component gets the live port."""

    __slots__ = ()

    name: str
    """The port's name; "" where it is the attribute's."""
    elsewhere: Path | None = None
    """The port's path in the kernel where its component runs, if that is another kernel; else None."""

    def check_declared(self, cls: type[Any], attribute: str) -> None:
        """Raise DeclarationError when this class, or one derived from it, cannot have such a port."""

    def declared_profile(self, attribute: str, ports: Mapping[str, PortProfile]) -> PortProfile:
        """The profile of the declared port; `ports` are the profiles of the declarations before this one."""
        raise NotImplementedError

    def add_to(self: D, component: Any, host: PortHost, name: str) -> D:
        """Make the live port and put it into `host.ports`. WiringError: `host` has a port of that name already."""
        raise NotImplementedError

    @property
    def connecting(self) -> Connecting | None:
        """The maker of connectors for ports of this kind; None: they are data ports."""
        return None


if TYPE_CHECKING:

    class End(Protocol[C]):
        """A port, or an interface of a port, that can be connected; `C` is the class of its connectors."""

        @property
        def connecting(self) -> Connecting | None: ...

        @property
        def connectors(self) -> tuple[C, ...]: ...


class Connecting(Protocol):
    """The maker of connectors for ports that are no data ports."""

    def plan(self, kernel: Any, ports: Sequence[Any], options: Mapping[str, Any], /) -> Sequence[tuple[str, Any]]: ...

    """Check all connectors to be made; return a path and a plan for each: the plan's `make(name)` makes it."""

    def renewed(self, kernel: Any, profile: Any, /) -> Any:
        """The plan by which an earlier connector is made again from its profile."""

    def end(self, connector: Any, /) -> None:
        """Take the connector out of force."""


class Port(PortDeclaration, Generic[T]):
    """The common base of in-ports and out-ports: a declaration while unbound, a component's live port once bound.

    Args:
        type: the record (or dataclass, or scalar type) that travels.
        unit: unit of the data, such as "m/s"; unequal units are refused at connect.
        shape: shape of the data, such as (3,), -1 for any length; checked at every write.
        doc: one line for tools.
        name: the port's name where it is not the attribute's.
        max_connectors: connectors that the port takes at most; None is unlimited.
    """

    __slots__ = (
        "_connectors",
        "_fast",
        "_host",
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
    is_far: ClassVar[bool] = False
    """Whether the port is a stand-in for a port of another kernel."""

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
        self._turns = Turns()

    def check_declared(self, cls: type[Any], attribute: str) -> None:
        if isinstance(self.type, str):
            raise DeclarationError(
                f"{cls.__qualname__}.{attribute}: {self.type!r:.60} is text; give the class itself, without quotes: "
                f"{type(self).__name__}({self.type:.60})"
            )
        from aiorts.types.samples import check_port_type
        from aiorts.types.structure import UnresolvedName, sole_unit

        try:
            check_port_type(self.type)
        except UnresolvedName:
            return  # maybe defined further down in its module: then the name is known when the port is made
        except DeclarationError as error:
            raise DeclarationError(f"{cls.__qualname__}.{attribute}: {error}") from None
        if self.unit and (own := sole_unit(self.type)) not in ("", self.unit):
            raise DeclarationError(
                f"{cls.__qualname__}.{attribute}: unit = {self.unit!r}: {self.type.__name__} has {own!r}; "
                "leave the port's unit out, or take another type"
            )

    def declared_profile(self, attribute: str, ports: Mapping[str, PortProfile]) -> PortProfile:
        return replace(self.profile, name=self.name or attribute)

    def bind(self: P, host: PortHost, name: str) -> P:
        """Make a live port of `host` from this declaration."""
        raise DeclarationError(f"{host.name}.{name}: expected InPort, OutPort, Provided or Required, got {self!r}")

    def add_to(self: P, component: Any, host: PortHost, name: str) -> P:
        if name in host.ports:
            raise WiringError(f"{host.name}.{name}: there is a port of that name already")
        bound = host.ports[name] = self.bind(host, name)
        return bound

    def _attach(self, host: PortHost, name: str) -> None:
        self._host = host
        self.name = name
        try:
            self._type = port_type(self.type)
        except DeclarationError as error:
            raise DeclarationError(f"{host.name}.{name}: {error}") from None
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
        """A frozen description of this port."""
        from aiorts.types import type_name

        return PortProfile(
            self.name,
            self.direction,
            type_name(self.type),
            self.unit,
            self.shape,
            self.doc,
            tuple(connector.name for connector in self.connectors),
        )

    def __repr__(self) -> str:
        extras = "".join(f" {word}={value!r}" for word, value in (("unit", self.unit), ("shape", self.shape)) if value)
        count = "unbound" if self._host is None else f"{len(self._connectors)} connectors"
        return f"<{self.__class__.__name__} {self.path or '?'} {self.type.__name__}{extras} {count}>"

    def _repr_html_(self) -> str | None:
        kernel = None if self._host is None else self._host.kernel
        return None if kernel is None else kernel.html_of(self)

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

    def _wake_waiter(self) -> None:
        """Wake all tasks and threads that wait at this port: each checks again."""

    def _make_locked(self) -> None:
        """Add a lock: from now on more than one thread uses this port."""

    def _give_up_blocking(self) -> None:
        """End calls that block at this port or at its far ends: the component's thread is to end."""
        for connector in self._connectors:
            connector.in_._wake_waiter()
        self._wake_waiter()

    def _vacate(self, leaving: bool = True) -> None:
        """Note that the component is about to leave the kernel or, with `leaving=False`, that it stays after all."""

    def _unanswerable(self) -> Iterator[str]:
        """The names of this port's calls that a component in a thread, without an event loop, cannot answer."""
        return iter(())

    def _removed(self) -> bool:
        """Whether this live port, or its component, was removed."""
        host = self._host
        return host is not None and not (host.alive and host.ports.get(self.name) is self)

    def _raise_if_removed(self) -> None:
        if self._removed():
            raise ClosedError(f"{self.path}: the port is closed: it or its component was removed")

    def _on_loop(self, callback: Callable[[], object]) -> None:
        """Run `callback` on the kernel's loop: now if this is its thread, soon otherwise."""
        host = self._host
        if host is None or host.on_loop_thread():
            callback()
        else:
            host.loop.call_soon_threadsafe(callback)

    def _refresh(self) -> None:
        """Note that the connectors or their options have changed."""
        raise NotImplementedError


# -- functions for the rooms that run components: no methods that a user's editor offers
# ---------------------------------


def host_of(port: Port[Any]) -> PortHost | None:
    """The owner of a live port; None for a declaration."""
    return port._host


def move_to(port: Port[Any], host: PortHost) -> None:
    """Give a port another owner: ports of new code go to the old component's host."""
    port._host, port._turns = host, host.turns
    port._refresh()


def is_removed(port: Port[Any]) -> bool:
    """Whether this live port, or its component, was removed."""
    return port._removed()


def refresh(port: Port[Any]) -> None:
    """Choose the port's fast path again: something that it relies on has changed."""
    port._refresh()


def wake_waiter(port: Port[Any]) -> None:
    """Wake all that wait at the port: it was removed."""
    port._wake_waiter()


def vacate(port: Port[Any], leaving: bool = True) -> None:
    """Note that the port's component is about to leave the kernel or, with `leaving=False`, that it stays after all."""
    port._vacate(leaving)


def lock_all(port: Port[Any]) -> None:
    """Lock a port, or the in-ports that it writes to: from now on more than one thread uses them."""
    port._make_locked()
    for connector in port._connectors:
        connector.in_._make_locked()


def give_up_blocking(port: Port[Any]) -> None:
    """End calls that block at the port or at its far ends: the component's thread is to end."""
    port._give_up_blocking()


def unanswerable(ports: Iterable[Port[Any]]) -> tuple[str, ...]:
    """The names of these ports' calls that a component in a thread, without an event loop, cannot answer."""
    return tuple(name for port in ports for name in port._unanswerable())


def check_room(port: Port[Any], more: int, limit: int | None, far: int = 0) -> None:
    """Raise WiringError where a port takes no more connectors.

    Args:
        more: how many connectors are to be added.
        limit: how many connectors the port takes at most; None is any number.
        far: how many connectors of other kernels the port has, not counted in `port.connectors`.
    """
    has = len(port.connectors) + far
    if limit is not None and has + more > limit:
        raise WiringError(
            f"{port.path}: takes {limit} connectors at the most, has {has}, {more} more asked for; disconnect one or "
            "raise max_connectors"
        )
