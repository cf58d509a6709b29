"""Small tables for notebooks with the content of `repr`. Everything is escaped; nothing is loaded from anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from aiorts.kernel.component import Component
from aiorts.services import ServicePort

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import Port


def kernel_html(kernel: Microkernel) -> str:
    """The tables of components with their states, and of connectors with their ledgers."""
    components = [
        (name, type(c).__name__, ", ".join(f"{k}: {v}" for k, v in c.states.items()) or "in no context")
        for name, c in kernel.components.items()
    ]
    connectors = []
    for connector in kernel.connectors.values():
        ledger, options = connector.statistics, connector.profile
        connectors.append(
            (
                connector.out.path,
                connector.in_.path,
                f"{options.subscription}/{options.push}",
                ledger.written,
                ledger.arrived,
                ", ".join(f"{count} {reason}" for reason, count in ledger.dropped.items()) or "0",
                ledger.buffered,
            )
        )
    return _table(f"Kernel {kernel.name}", ("component", "type", "state"), components) + _table(
        "Connectors", ("from", "to", "subscription", "written", "delivered", "dropped", "buffered"), connectors
    )


def html_of(thing: Component | Port[Any]) -> str:
    """The table of a component or a port."""
    return _component_html(thing) if isinstance(thing, Component) else _port_html(thing)


def _component_html(component: Component) -> str:
    ports = [
        (name, port.direction, port.profile.type, port.unit or "", len(port.connectors))
        for name, port in component.ports.items()
    ]
    params = [(name, p.value, p.unit, str(p.spec.constraint)) for name, p in component.params.items()]
    title = f"{type(component).__name__} {component.name}"
    return _table(title, ("port", "direction", "type", "unit", "connectors"), ports) + _table(
        "Parameters", ("name", "value", "unit", "allowed"), params
    )


def _port_html(port: Port[Any]) -> str:
    if isinstance(port, ServicePort):
        ends = [(end.path, end.polarity, end.spec.name, ", ".join(end.profile.bound_to)) for end in port.interfaces]
        return _table(f"service port {port.path}", ("interface", "polarity", "type", "bound to"), ends)
    rows = [(connector.out.path, connector.in_.path, connector.statistics.written) for connector in port.connectors]
    return _table(f"{port.direction}-port {port.path}: {port.type.__name__}", ("from", "to", "written"), rows)


def _table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    columns = "".join(f"<th>{escape(name)}</th>" for name in head)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{columns}</tr></thead><tbody>{body}</tbody></table>"
