"""What the tests of FlexiLogger share: a recorder in a kernel with a port of our own for each of its in-ports."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aiorts import Component, Context, EventContext, InPort, Kernel, LifecycleState, OutPort
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import RecordingReader


async def recorder(kernel: Kernel, path: Path, *types: str, **params: Any) -> FlexiLogger:
    """A recorder of these types, in no context yet."""
    params = {"min_free": 0.0, **params}
    return await kernel.create(FlexiLogger, inputs=types or ("TimedLong",), logfile=str(path), **params)


async def feeders(kernel: Kernel, logger: FlexiLogger, **options: Any) -> dict[str, OutPort[Any]]:
    """An out-port of ours for each of its in-ports, by that one's name."""
    options = {"length": 100_000, **options}
    user = await kernel.create(Component)
    ports: dict[str, OutPort[Any]] = {}
    for name, port in logger.ports.items():
        if isinstance(port, InPort):
            ports[name] = user.add_port(name, OutPort(port.type))
            await kernel.connect(ports[name], port, **options)
    return ports


async def active(kernel: Kernel, logger: FlexiLogger, context: Context | None = None) -> Context:
    """It is active in that context, by default an event context."""
    return await kernel.start(context or EventContext(), logger, activate=True)


async def until(condition: Callable[[], object], seconds: float = 10.0) -> None:
    """Wait in real time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came true"
        await asyncio.sleep(0.002)


async def until_error(logger: FlexiLogger) -> BaseException:
    """Wait until it is in error; what put it there."""
    await until(lambda: logger.state is LifecycleState.ERROR)
    assert logger.last_error is not None
    return logger.last_error


def metadata(path: Path) -> tuple[Any, ...]:
    """What a recording says of the system, once for each segment."""
    with RecordingReader(path) as reader:
        return reader.metadata


def ending(path: Path) -> Any:
    """What a recording says at its end; it was closed."""
    with RecordingReader(path) as reader:
        assert reader.clean
        return reader.endings[-1]


async def closed(logger: FlexiLogger) -> None:
    """Deactivate it, and wait until its file was let go, however slow the disk is."""
    await logger.contexts[0].deactivate(logger)
    await logger.wait_closed()
