"""A component that runs alone, by `aiorts run` or as a filter: its context, and the standard streams at its ports."""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts import Catalogue, Component, Context, EventContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.errors import ConfigurationError, DeclarationError, PluginError, WiringError
from aiorts.events import StateChanged
from aiorts.kernel.extensions.arguments import arguments_of, needs_rate, settings_faults, settings_of
from aiorts.kernel.ports.connector import unread_at
from aiorts.system import ended_in_error
from aiorts.types import full_name, type_name

if TYPE_CHECKING:
    from aiorts.cli.runtime.ends import Ends
    from aiorts.sessions import Stream
    from aiorts.system import FrameInput, LiveInput, StandardInput

DEFAULT_RATE: Final = 10.0
"""Hz of a component without in-ports that says nothing else."""
LOSSLESS: Final[Mapping[str, Any]] = {"length": 1000, "full": "block", "timeout": None}
"""How a component alone is connected with standard input and standard output."""
_LONGEST: Final = 1_000_000


def check_rate(rate: float | None) -> None:
    """Raise ConfigurationError unless `--rate` is a rate, or was not given."""
    if rate is not None:
        try:
            PeriodicContext(rate=rate)
        except ConfigurationError as error:
            raise ConfigurationError(f"--rate: {error}") from None


def context_for(component: Component, catalogue: Catalogue, rate: float | None) -> Context:
    """The context that its class asks for in `alone`; else one for its data, or a periodic one where none can come.

    Args:
        rate: Hz, which win over what the class says; None is no wish.

    Raises:
        DeclarationError: `alone` is no table of a context.
    """
    table: Any = type(component).alone
    where = f"{type(component).__name__}.alone"
    if not isinstance(table, Mapping):
        raise DeclarationError(f'{where} = {table!r:.80}: expected a table, such as {{"rate": 50.0}}')
    if not table:
        if rate is None and takes_data(component):
            return EventContext()
        return PeriodicContext(rate=rate or DEFAULT_RATE)
    options = {"kind": "periodic", **table}
    try:
        cls: type[Any] = catalogue.find("contexts", str(options.pop("kind"))).load_class(Context)
    except PluginError as error:
        raise DeclarationError(f"{where}: {error}") from error
    if rate is not None and "rate" not in arguments_of(cls):
        return PeriodicContext(rate=rate)
    if rate is not None or (needs_rate(cls) and "rate" not in options):
        options["rate"] = rate or DEFAULT_RATE
    for key, what, _ in settings_faults(cls, options, ("kind",)):
        raise DeclarationError(f"{where}: {what if what.startswith(key) else f'{key}: {what}'}")
    context: Context = settings_of(cls, options)
    return context


def takes_data(component: Component) -> bool:
    """Whether it has an in-port."""
    return any(isinstance(port, InPort) for port in component.ports.values())


def outs_of(component: Component) -> dict[str, type]:
    """The type of each out-port, by the port's name."""
    return {port.name: port.type for port in component.ports.values() if isinstance(port, OutPort)}


async def connect_output(kernel: Kernel, component: Component, sink: Component) -> None:
    """Connect its out-ports with the in-ports of the same names of what writes to standard output."""
    await kernel.add(sink)
    for name in outs_of(component):
        await kernel.connect(component.ports[name], sink.ports[name], **LOSSLESS)


def input_is_given() -> bool:
    """Whether standard input is a pipe or a file; a terminal, a socket, or a device such as /dev/null feeds nobody."""
    try:
        mode = os.fstat(sys.stdin.fileno()).st_mode
    except (AttributeError, ValueError, OSError):
        return False  # started without
    return stat.S_ISFIFO(mode) or stat.S_ISREG(mode)


async def connect_input(kernel: Kernel, component: Component, ends: Ends, **how: Any) -> StandardInput | FrameInput:
    """What reads standard input, connected with the in-ports of the component; to be started last, with `end_with`.

    Args:
        how: `count` and `optional`, see `Incoming` and `StandardInput`.
    """
    ins = {port.name: port.type for port in component.ports.values() if isinstance(port, InPort)}
    outs = outs_of(component)
    ordered = bool(getattr(component, "in_line_order", False))

    def held_up() -> bool:
        return any(unread_at(component.ports[name]) for name in outs)

    source = await kernel.add(ends.source(ins, ordered=ordered, held_up=held_up, **how))
    # One that takes what it can pair leaves the rest, and must not keep us from reading what that waits for.
    ways = LOSSLESS if ordered or len(ins) == 1 else {**LOSSLESS, "length": _LONGEST}
    for name in ins:
        await kernel.connect(source.ports[name], component.ports[name], **ways)
    if (skip_bad := getattr(component, "skip_bad", None)) is not None:
        skip_bad(source.refused)
    return source


async def connect_live(
    kernel: Kernel, component: Component, ends: Ends, stream: Stream, *, count: int | None
) -> LiveInput:
    """What takes the samples of another process, connected with the only in-port of the component; as `connect_input`.

    Raises:
        WiringError: there are several in-ports, or the samples are of another type.
    """
    ins = {port.name: port.type for port in component.ports.values() if isinstance(port, InPort)}
    if len(ins) != 1:
        raise WiringError(f"--connect: {component.name} has the in-ports {', '.join(ins)}; it is for a single one")
    ((name, cls),) = ins.items()
    if stream.began["full_type"] != full_name(cls):
        raise WiringError(
            f"--connect: {stream.began['port']} sends {stream.began['type']}, {component.name}.{name} takes "
            f"{type_name(cls)}; put a flexifilter between them"
        )
    source = await kernel.add(ends.live(ins, stream, count=count))
    await kernel.connect(source.ports[name], component.ports[name], **LOSSLESS)
    return source


def end_with(kernel: Kernel, component: Component, source: Component | None) -> None:
    """Have the run end when something is in error, or the component has finished, though more could be read."""
    ending: list[asyncio.Task[None]] = []

    async def leave(source: Component) -> None:
        source.finish()
        for port in list(source.ports.values()):
            for connector in list(port.connectors):  # what was read and nobody takes any more
                await kernel.disconnect(connector)

    def check_end(_event: object = None) -> None:
        if ended_in_error(kernel):
            kernel.request_stop()
        elif source is not None and component.has_finished and not ending:
            ending.append(asyncio.ensure_future(leave(source)))

    kernel.bus.subscribe(StateChanged, check_end)
    check_end()
