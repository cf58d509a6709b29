"""`aiorts run --print PORT`: prints the samples of out-ports of a system as JSON lines.

No component is added to the system. Where standard output is not read for long, the writers wait.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts import InPort, KernelService, OutPort, exits
from aiorts.errors import ConfigurationError
from aiorts.kernel.loop.line_stream import LineStream, OutputError
from aiorts.spelling import suggestion
from aiorts.wire.lines import LineWriter

if TYPE_CHECKING:
    from aiorts import Connector, Kernel
    from aiorts.kernel.loop.deadlines import StopBudget

_MOST: Final = 1000
"""Samples that may wait to be printed, of all ports together; and as many at each port."""


class Printing(KernelService):
    """The service that prints the samples of the out-ports that `wanted` names.

    The samples of each port are in order. Samples of several ports are in the order in which they were sent, as long as
    standard output keeps up.
    """

    name = "print"
    wanted: tuple[str, ...] = ()
    """Names COMPONENT.PORT, with * and ?."""
    _over = False
    _task: asyncio.Task[None] | None = None

    @classmethod
    def prepare(cls, ports: tuple[str, ...], kernel: Kernel) -> None:
        """Attach this service to the kernel, to print these out-ports."""
        kernel.service(cls).wanted = ports

    async def starting(self) -> None:
        self._taps: list[tuple[Connector, Callable[[InPort[Any]], None]]] = []
        self._waiting: deque[str] = deque()
        self._some, self._stream = asyncio.Event(), LineStream()
        outs = {
            f"{name}.{port.name}": port
            for name, component in self.kernel.components.items()
            for port in component.ports.values()
            if isinstance(port, OutPort)
        }
        chosen: dict[str, OutPort[Any]] = {}
        for glob in self.wanted:
            found = {path: port for path, port in outs.items() if fnmatchcase(path, glob)}
            if not found:
                raise ConfigurationError(f"--print: no out-port is called {glob!r}; {suggestion(glob, outs)}")
            chosen |= found
        for path, out in chosen.items():
            take = partial(self._take, LineWriter(path, out.type))
            self._taps.append((self.kernel.connections.tap(self, out, take, length=_MOST, full="block"), take))
        self._task = asyncio.get_running_loop().create_task(self._print(), name="--print")

    def _take(self, writer: LineWriter, port: InPort[Any]) -> None:
        while port.is_new and len(self._waiting) < _MOST:
            self._waiting.append(writer.line(port.read_nowait()))
        self._some.set()

    async def _print(self) -> None:
        try:
            while not self._over:
                await self._some.wait()
                self._some.clear()
                while self._waiting:
                    lines = list(self._waiting)
                    self._waiting.clear()
                    await self._stream.write(lines)
                    for tapped, take in self._taps:
                        take(tapped.in_)
        except BrokenPipeError:
            self.kernel.request_stop(exits.BROKEN_PIPE)
        except OutputError:
            self.kernel.request_stop(exits.FAILED)
        finally:
            for tapped, _ in self._taps:
                tapped.close()

    async def ending(self, budget: StopBudget) -> None:
        if self._task is None:
            return
        self._over = True
        self._some.set()
        await asyncio.wait({self._task}, timeout=budget.left)
        if self._task.done() and not self._task.cancelled():
            self._task.result()  # raises a fault of the task as the service's
        self._task.cancel()
