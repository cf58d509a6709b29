"""Interfaces that pass from one instance to another: bound ends stay bound, and are answered by the newest code.

An interface stays where its port, its name and its methods are the same. A call that has not begun is answered by the
new code; a call that runs already (of a concurrent interface) ends with the old code.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import DeclarationError
from aiorts.kernel.execution.cell import cell
from aiorts.model.interface import differences
from aiorts.services.service_ends import Provided
from aiorts.services.service_port import ServiceEnd, ServicePort

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.ports import Port
    from aiorts.services.service_wiring import Link

_WORDS: Final = (
    *("provider", "concurrent", "always", "failure", "cancel_timeout"),
    *("timeout", "many", "doc", "max_connectors"),
)
Ends = dict[str, ServiceEnd[Any]]


class ServiceHeritage:
    """The service ports of an instance that takes the place of another."""

    def __init__(self, old: Component) -> None:
        self._old = old
        self._stay: dict[ServiceEnd[Any], ServiceEnd[Any]] = {}
        """The interface made for the new code -> the live one that stays in its place."""
        self._said: dict[ServiceEnd[Any], dict[str, Any]] = {}
        self._before: dict[ServicePort, Ends] = {}
        self._after: dict[ServicePort, Ends] = {}
        self._gone_ports: list[ServicePort] = []

    def bind(self, component: Component, name: str, declared: ServiceEnd[Any], *, mine: bool) -> ServiceEnd[Any]:
        """The live interface of the old instance if it is the same, else a new one; nothing is announced."""
        fresh = declared.add_to(component, cell(component), name)
        port = cell(self._old).ports.get(name)
        live = port._ends.get(fresh.instance) if isinstance(port, ServicePort) else None
        if not mine or live is None or live.polarity != fresh.polarity or not _same_interface(live, fresh):
            return fresh
        self._stay[fresh] = live
        return live

    def wanted(self, ports: dict[str, Port[Any]], live: Mapping[str, Port[Any]]) -> None:
        """Put the live service ports in the place of those that were made for the new code."""
        self._gone_ports = [port for name, port in live.items() if isinstance(port, ServicePort) and name not in ports]
        for name, made in ports.items():
            there = live.get(name)
            if isinstance(made, ServicePort) and isinstance(there, ServicePort):
                self._before[there] = there._ends
                # An interface that was added at run time is there already: it stays as it is.
                self._after[there] = {instance: self._stay.get(end, end) for instance, end in made._ends.items()}
                ports[name] = there

    def put(self, component: Component) -> None:
        """Put the interfaces of the new code, or again of the old code, in force: bound ends are answered by it.

        Raises:
            DeclarationError: the code does not provide what it declares.
        """
        new = component is not self._old
        for port, ends in (self._after if new else self._before).items():
            others = self._before[port] if new else self._after[port]
            port._component, port._ends = component, ends
            for end in ends.values():
                end._port, end._vacant = port, False
            for end in others.values():
                if ends.get(end.instance) is not end:
                    end._vacant = True
        for gone in self._gone_ports:
            for end in gone.interfaces:
                end._vacant = new
        if any(isinstance(end, Provided) and not end.concurrent for end in _ends(component)):
            if cell(component).threaded:
                cell(component).entry_lock.shared = True
            else:
                cell(component).entry_lock.share(cell(component).members)
        for fresh, live in self._stay.items():
            if new:
                self._said[live] = _words(live)
            for word, value in (_words(fresh) if new else self._said.get(live, {})).items():
                setattr(live, word, value)
        for port in self._before:
            for end in port.interfaces:
                if isinstance(end, Provided):
                    end._answers = None
                    for link in end._links:
                        _rebind(link, component)

    def gone(self) -> list[ServiceEnd[Any]]:
        """The interfaces that the old code had and the new code lacks, at ports that both have."""
        return [
            end
            for port, ends in self._before.items()
            for instance, end in ends.items()
            if self._after[port].get(instance) is not end
        ]


def _same_interface(one: ServiceEnd[Any], other: ServiceEnd[Any]) -> bool:
    if one.interface is other.interface:
        return True
    mine, others = one.spec, other.spec
    same_name = mine.name == others.name
    return same_name and not differences(mine.methods, others.methods) and not differences(others.methods, mine.methods)


def _ends(component: Component) -> Iterator[ServiceEnd[Any]]:
    for port in component.ports.values():
        if isinstance(port, ServicePort):
            yield from port.interfaces


def _words(end: ServiceEnd[Any]) -> dict[str, Any]:
    return {word: getattr(end, word) for word in _WORDS if hasattr(end, word)}


def _rebind(link: Link, component: Component) -> None:
    functions = link.provided._functions()
    missing = link.answers.keys() - functions.keys()
    if missing:
        raise DeclarationError(f"{link.provided.path}: does not answer {', '.join(sorted(missing))}")
    link.component = component
    for name, answer in link.answers.items():
        answer.function = functions[name]
        answer.plain = not inspect.iscoroutinefunction(functions[name])
        answer.visit.component = component
    for call in link.calls:
        if not (call.runs or call.over):
            call.component = component
