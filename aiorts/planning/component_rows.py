"""Rows for the declared keys of a component: how a plan reads each from a running kernel, and where it is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from aiorts.kernel.service import KernelService
from aiorts.model.declared import options_of
from aiorts.model.wanted.entries import ComponentEntry, said_keys
from aiorts.planning.planning import Planning
from aiorts.supervision import Supervising

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel

_NO_LIMITS: Final[Mapping[str, Any]] = MappingProxyType({})
Store = Callable[["Microkernel", bool], dict[str, Any] | None]
"""The values of a key by the names of components; if there are none yet: made if the flag is set, else None."""


class Row(NamedTuple):
    """How a key is read from a component, and where it is kept.

    Attributes:
        read: of a kernel and a component, the value.
        store: where the value lasts without the instance; None: the key says how the instance is made.
    """

    read: Callable[[Microkernel, Component], Any]
    store: Store | None = None


def _kept(key: str, store: Store) -> Row:
    """A row whose value is kept by the name of the component."""
    usual = options_of(ComponentEntry)[key].default
    return Row(lambda kernel, component: (store(kernel, False) or {}).get(component.name, usual), store)


def _in_service(kind: type[KernelService], attribute: str) -> Store:
    """The store of a service; the service is attached if its store has to be made."""
    return lambda kernel, made: getattr(kernel.service(kind) if made else kernel.attached(kind), attribute, None)


def _on_link_lost(kernel: Microkernel, _made: bool) -> dict[str, Any]:
    return kernel.registry.on_link_lost


def _supervision(kernel: Microkernel, component: Component) -> Any:
    supervising = kernel.attached(Supervising)
    there = None if supervising is None else supervising.supervised.get(component.name)
    return None if there is None else there.policy


def _limits(_kernel: Microkernel, component: Component) -> Any:
    """The limits of a component's own process; None where it has none."""
    from aiorts.isolation import RemoteComponent  # late: few systems have one

    return component.limits if isinstance(component, RemoteComponent) else None


ROWS: Final[Mapping[str, Row]] = MappingProxyType(
    {
        "supervision": Row(_supervision),
        "start": _kept("start", _in_service(Supervising, "rules")),
        "exclusive": _kept("exclusive", _in_service(Planning, "exclusive")),
        "on_link_lost": _kept("on_link_lost", _on_link_lost),
        "isolation": Row(lambda *there: "" if _limits(*there) is None else "process"),
        "limits": Row(lambda *there: _limits(*there) or _NO_LIMITS),
    }
)
"""The rows by key, one for each declared key of a component."""


def stores(kernel: Microkernel) -> Iterator[dict[str, Any]]:
    """The stores of a kernel that have values by the names of components."""
    found = (row.store(kernel, True) for row in ROWS.values() if row.store is not None)
    return (store for store in found if store is not None)


def put_in_force(kernel: Microkernel, entry: ComponentEntry) -> None:
    """Keep the values of an entry that last without its instance; default values are not kept."""
    said = said_keys(entry)
    for key, row in ROWS.items():
        store = None if row.store is None else row.store(kernel, key in said)
        if store is None:
            continue
        if key in said:
            store[entry.name] = said[key]
        else:
            store.pop(entry.name, None)
