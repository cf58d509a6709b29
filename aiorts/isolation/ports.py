"""The ports of a component in another kernel, as that kernel reports them; its failure there fails it here, too."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from aiorts.errors import DeclarationError, UnknownTypeError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.far import RemoteInPort, RemoteOutPort
from aiorts.model.names import Path

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.ports import Port


def described(component: Component) -> list[list[Any]]:
    """The data ports of a component as plain values, each with its path: a composite shows ports of its members.

    Their kernel knows no limit of connectors from now on: it is kept where they are connected, without those of tools.
    """
    from aiorts.types import full_name

    rows: list[list[Any]] = []
    for name, port in component.ports.items():
        if isinstance(port, InPort | OutPort):
            length = port.length if isinstance(port, InPort) else None
            shape = None if port.shape is None else list(port.shape)
            what = [port.direction, full_name(port.type), port.unit, shape, port.doc, length, port.max_connectors]
            rows.append([name, *what, port.path])
            port.max_connectors = None
    return rows


def follow(component: Component, rows: Iterable[list[Any]], kernel: str, host: str = "") -> None:
    """Give a component the ports that these rows describe, and no others; an equal port stays, with its connectors.

    Args:
        kernel, host: the kernel and host of these ports.

    Raises:
        DeclarationError: a type of a port is not known here.
    """
    from aiorts.types import find_type

    wanted = {row[0]: row[1:] for row in rows}
    for name, port in list(component.ports.items()):
        if isinstance(port, RemoteInPort | RemoteOutPort) and not _is_alike(port, wanted.get(name)):
            component.remove_port(name)
    for name, (direction, kind, unit, shape, doc, length, most, _) in wanted.items():
        if name in component.ports:
            continue
        try:
            cls = find_type(kind)
        except UnknownTypeError as error:
            where = f"{component.name}.{name}"
            raise DeclarationError(f"{where}: {error}; import the module that defines it here, too") from None
        alike: dict[str, Any] = {"unit": unit, "shape": None if shape is None else tuple(shape), "doc": doc}
        alike["max_connectors"] = most
        there = RemoteInPort(cls, length=length, **alike) if direction == "in" else RemoteOutPort(cls, **alike)
        component.add_port(name, there)
    for name, port in component.ports.items():
        if isinstance(port, RemoteInPort | RemoteOutPort):
            port.elsewhere = replace(Path.parse(wanted[name][-1]), kernel=kernel, host=host)


def fail(component: Component, error: Exception) -> None:
    """Let a component that has failed in the other kernel fail here, too, wherever it is a member."""
    members = cell(component).members
    if not members:
        cell(component).last_error = error
        component.log.error("%s", error)
    for member in members:
        member.context.runner.life.task_failed(member, error)


def _is_alike(port: Port[Any], row: list[Any] | None) -> bool:
    from aiorts.types import full_name

    if row is None:
        return False
    shape = None if port.shape is None else list(port.shape)
    return row[:4] == [port.direction, full_name(port.type), port.unit, shape]
