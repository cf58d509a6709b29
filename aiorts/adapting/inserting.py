"""Connects ports through a FlexiFilter where two do not fit: made, connected, run before the reader; or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

from aiorts.adapting.proposing import FILTER, Between, between, filter_name, plain_between
from aiorts.errors import ConfigurationError, StateError, WiringError
from aiorts.kernel.connection import joined
from aiorts.kernel.execution.cell import flattened
from aiorts.kernel.loop.tasks import current_task, kernel_task, owner_of, see_through
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.wiring import pair_faults
from aiorts.model.options import how_to_adapt
from aiorts.model.wanted.steps import Places
from aiorts.planning import switch, tops

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

_OF_THE_WHOLE: Final = ("name", "stamp")
"""Options that only the connector to the reader has."""


async def connect_adapted(kernel: Microkernel, ports: Sequence[Any], options: Mapping[str, Any]) -> Any:
    """Connect ports through filters, all or none; return the connectors to the readers as `Kernel.connect` does.

    Raises:
        WiringError: two ports do not fit even with a FlexiFilter, it is not plain which value goes where, or the reader
            is in no context.
        PluginError: no plugin offers a FlexiFilter.
        StateError: the reader's context cannot run one, or a component's hook calls this.
    """
    options = dict(options)
    adapt = how_to_adapt("connect", options.pop("adapt"))
    if not adapt:
        return await kernel.connect(*ports, **options)
    if options.get("convert"):
        raise WiringError("connect: adapt: convert makes them fit already; take one of the two away")
    ends = [kernel.registry.port(one) if isinstance(one, str) else one for one in ports]
    outs = [one for one in ends if isinstance(one, OutPort)]
    ins = [one for one in ends if isinstance(one, InPort)]
    pairs = [(out, in_) for out in outs for in_ in ins]
    if len(outs) + len(ins) != len(ends) or not any(next(pair_faults(*pair), "") for pair in pairs):
        return await kernel.connect(*ports, **options)
    if owner_of(current_task()) is not None or any(one.runner.inside() for one in kernel.contexts.values()):
        raise StateError("connect: adapt: called by a hook, or a task, of a component, which it would wait for")
    found = [_found(*pair, adapt) for pair in pairs]
    task = kernel_task(kernel.loop, _connect(kernel, pairs, found, options), "aiorts connect with adapt")
    made = await see_through(task)
    return joined(made, kernel.connections) if len(ports) > 2 else made[0]


def first_half(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the connector to the filter."""
    return {word: value for word, value in options.items() if word not in _OF_THE_WHOLE}


def numbered(options: Mapping[str, Any], number: int) -> Mapping[str, Any]:
    """The options of the connector to a reader, of which there are several: their names are NAME, NAME-2 ..."""
    name = options.get("name")
    return {**options, "name": f"{name}-{number}"} if name and number > 1 else options


def inserted(kernel: Microkernel, connector: Any, ports: Sequence[str]) -> tuple[Connector, str] | None:
    """The filter inserted when these ports were connected: the connector to it, and its text; None: no filter."""
    out: Any = getattr(connector, "out", None)
    if out is None or any(kernel.registry.port(path) is out for path in ports):
        return None
    name = out.path.partition(".")[0]
    (first,) = kernel.components[name].ports["input0"].connectors
    found = between(first.out, connector.in_)
    return first, f"{name}: {found.said if found is not None else FILTER}"


def _found(out: OutPort[Any], in_: InPort[Any], adapt: bool | Literal["text"]) -> Between | None:
    """The filter to put between two ports; None where they fit."""
    fault = next(pair_faults(out, in_), "")
    if fault and (found := plain_between(out, in_, adapt)) is not None:
        return found
    if fault:
        raise WiringError(fault)
    return None


async def _connect(
    kernel: Microkernel,
    pairs: Sequence[tuple[OutPort[Any], InPort[Any]]],
    found: Sequence[Between | None],
    options: Mapping[str, Any],
) -> list[Connector]:
    made: list[Connector] = []
    filters: list[Component] = []
    try:
        for number, ((out, in_), one) in enumerate(zip(pairs, found, strict=True), 1):
            given = numbered(options, number)
            if one is None:
                made += kernel.connections.make((out, in_), given)
                continue
            home = _home(kernel, in_)
            new = await _filter(kernel, one, out, in_)
            filters.append(new)
            kernel.connections.make((out, new.ports["input0"]), first_half(options))
            made += kernel.connections.make((new.ports["output0"], in_), given)
            line = [other.name for other in tops(home)]
            line.insert(_place(kernel, home, in_), new.name)
            await switch(kernel, Places({home.name: tuple(line)}), partial(_is, new))
    except BaseException:
        for connector in made:
            if not connector.closed:
                kernel.connections.end(connector)
        for new in filters:
            await kernel.registry.remove(new)
        raise
    return made


def _is(new: Component, _context: str, joining: Component) -> bool:
    return joining is new


def _reader(kernel: Microkernel, in_: InPort[Any]) -> Component:
    return kernel.components[in_.path.partition(".")[0]]


def _home(kernel: Microkernel, in_: InPort[Any]) -> Context:
    reader = _reader(kernel, in_)
    if not reader.contexts:
        raise WiringError(
            f"{in_.path}: adapt: {reader.name} is in no context, where its {FILTER} could run; start it in one first"
        )
    return reader.contexts[0]


def _place(kernel: Microkernel, home: Context, in_: InPort[Any]) -> int:
    """The place before the reader, or before the composite that it runs with."""
    reader = _reader(kernel, in_)
    return next(number for number, one in enumerate(tops(home)) if reader in flattened((one,)))


async def _filter(kernel: Microkernel, found: Between, out: OutPort[Any], in_: InPort[Any]) -> Component:
    params = {"inputs": (found.source,), "outputs": (found.target,), "map": found.entries}
    try:
        return await kernel.create(FILTER, filter_name(out.path, in_.path, kernel.components), **params)
    except ConfigurationError as error:  # it does not know one of the types
        raise WiringError(next(pair_faults(out, in_))) from error
