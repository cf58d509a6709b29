"""The run of a single component, by `aiorts run` or as a filter: its context, and the standard streams at its ports."""

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
"""Hz of a component without in-ports that declares no rate."""
LOSSLESS: Final[Mapping[str, Any]] = {"length": 1000, "full": "block", "timeout": None}
"""The options by which a component alone is connected with standard input and output."""
_LONGEST: Final = 1_000_000


def check_rate(rate: float | None) -> None:
    """Raise ConfigurationError unless `--rate` is a valid rate or was not given."""
    if rate is not None:
        try:
            PeriodicContext(rate=rate)
        except ConfigurationError as error:
            raise ConfigurationError(f"--rate: {error}") from None


def context_for(component: Component, catalogue: Catalogue, rate: float | None) -> Context:
    """Make the context that the class declares in `alone`; else an event context, or without in-ports a periodic one.

    Args:
        rate: Hz, which take precedence over the class; None: not given.

    Raises:
        DeclarationError: `alone` is no valid table of a context.
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
    """Whether the component has an in-port."""
    return any(isinstance(port, InPort) for port in component.ports.values())


def outs_of(component: Component) -> dict[str, type]:
    """The type of each out-port, by the port's name."""
    return {port.name: port.type for port in component.ports.values() if isinstance(port, OutPort)}


async def connect_output(kernel: Kernel, component: Component, sink: Component) -> None:
    """Connect the component's out-ports with the in-ports of the same names of the sink of standard output."""
    await kernel.add(sink)
    for name in outs_of(component):
        await kernel.connect(component.ports[name], sink.ports[name], **LOSSLESS)


def input_is_given() -> bool:
    """Whether standard input is a pipe or a file; a terminal, a socket, or a device such as /dev/null is not read."""
    try:
        mode = os.fstat(sys.stdin.fileno()).st_mode
    except (AttributeError, ValueError, OSError):
        return False  # started without standard input
    return stat.S_ISFIFO(mode) or stat.S_ISREG(mode)


async def connect_input(kernel: Kernel, component: Component, ends: Ends, **how: Any) -> StandardInput | FrameInput:
    """Add the reader of standard input and connect it with the in-ports; the caller starts it last, with `end_with`.

    Args:
        how: `count` and `optional`, see `Incoming` and `StandardInput`.
    """
    ins = {port.name: port.type for port in component.ports.values() if isinstance(port, InPort)}
    outs = outs_of(component)
    ordered = bool(getattr(component, "in_line_order", False))

    def held_up() -> bool:
        return any(unread_at(component.ports[name]) for name in outs)

    source = await kernel.add(ends.source(ins, ordered=ordered, held_up=held_up, **how))
    # A component that pairs samples leaves unpaired ones unread; they must not stop the samples that it waits for.
    ways = LOSSLESS if ordered or len(ins) == 1 else {**LOSSLESS, "length": _LONGEST}
    for name in ins:
        await kernel.connect(source.ports[name], component.ports[name], **ways)
    if (skip_bad := getattr(component, "skip_bad", None)) is not None:
        skip_bad(source.refused)
    return source


async def connect_live(
    kernel: Kernel, component: Component, ends: Ends, stream: Stream, *, count: int | None
) -> LiveInput:
    """Add the source of another process's samples and connect it with the only in-port; as `connect_input`.

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
    """End the run when a component is in error, or this one has finished although more could be read."""
    ending: list[asyncio.Task[None]] = []

    async def leave(source: Component) -> None:
        source.finish()
        for port in list(source.ports.values()):
            for connector in list(port.connectors):  # drops what the component takes no more
                await kernel.disconnect(connector)

    def check_end(_event: object = None) -> None:
        if ended_in_error(kernel):
            kernel.request_stop()
        elif source is not None and component.has_finished and not ending:
            ending.append(asyncio.ensure_future(leave(source)))

    kernel.bus.subscribe(StateChanged, check_end)
    check_end()
