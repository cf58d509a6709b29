"""One process that runs a component: started, asked, watched, ended."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, LinkError, LinkTimeout, ProcessError
from aiorts.isolation import messages
from aiorts.links import Links
from aiorts.processes import DESCRIPTOR

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.links import Peer, UnixTransport
    from aiorts.processes import Child, Ending, Launcher, Limits

_COMES_UP: Final = 10.0
"""Seconds in which a process must make its kernel and its component, with the import of heavy modules."""
_ANSWERS: Final = 7.0
"""Seconds in which a process must answer: a hook that runs there meanwhile has 5 s, and 2 s beyond."""
_LOOK: Final = 0.5
"""Seconds between two checks whether the process answers."""
_PATIENT: Final = 3_600.0
"""Seconds for the answer to such a check; it comes between two hooks."""
_BUSY_BEYOND: Final = 2.0
"""Seconds beyond its deadline that a hook may hold its process."""
_ENDS: Final = 1.2
"""Seconds that a process has to end by itself: with the request to end, less than the 2 s of the hook that waits."""
_KILLED: Final = 0.25
"""Seconds for which the end of a process that was killed is waited for."""


class Process:
    """A process with a kernel of its own for one component.

    Args:
        name: the component's.
        starts: how many processes may come up at the same time.
        ended: called once, if the process ends unasked, with how it ended and its last lines.
        line: called with a level of the log and a line that it logged or wrote to standard error.
        printed: called with a line that it wrote to standard output.
        counted: called with the statistics of its contexts, as plain values, about twice a second.
        holder: names the other processes that use up the time of the end, and says how; "" if none does.
    """

    def __init__(
        self,
        kernel: Microkernel,
        launcher: Launcher,
        transport: UnixTransport,
        name: str,
        limits: Limits,
        *,
        starts: asyncio.Semaphore,
        ended: Callable[[str, tuple[str, ...]], None],
        line: Callable[[int, str], None],
        printed: Callable[[str], None],
        counted: Callable[[list[Any]], None],
        holder: Callable[[], str],
    ) -> None:
        self._kernel, self._launcher, self._transport = kernel, launcher, transport
        self.name, self._limits = name, limits
        self._starts, self._ended, self._line = starts, ended, line
        self._printed, self._counted, self._holder = printed, counted, holder
        self._links = kernel.service(Links)
        self.kernel = f"{self._links.reached_as}-{name}"
        """The name of the process's kernel."""
        self._child: Child | None = None
        self._peer: Peer | None = None
        self._looking: asyncio.Task[None] | None = None
        self._busy_since: float | None = None
        self.deadline: float | None = None
        """Seconds that a hook may take in the process."""
        self._ending = False
        self._killed = ""
        """The reason why this kernel has killed the process; "": it has not."""
        self._delay = ""
        """How the process has delayed its own end."""

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._child is not None and not self._child.ended.done()

    @property
    def pid(self) -> int | None:
        """The number of the process; None before its start."""
        return None if self._child is None else self._child.pid

    @property
    def busy(self) -> float:
        """Seconds for which the process has not answered, since it answers only between two hooks; 0 while it
        answers."""
        return 0.0 if self._busy_since is None else self._kernel.loop.time() - self._busy_since

    @property
    def delay(self) -> str:
        """How the process keeps others waiting, or did at its end; "" if it does not."""
        return f"a hook has held it for {busy:.1f} s" if (busy := self.busy) else self._delay

    async def start(self, text: str, params: dict[str, Any]) -> None:
        """Start the process, and make the component there.

        Raises:
            ProcessError: it cannot be started, or has not come up in time.
            AiortsError: what refused the component.
        """
        async with self._starts:
            await self._start(text, params)

    async def _start(self, text: str, params: dict[str, Any]) -> None:
        ours, theirs = socket.socketpair()
        self._ending, self._peer, self._killed, self._delay = False, None, "", ""
        try:
            first = messages.First(
                self.kernel,
                self.name,
                sys.path,
                [str(folder) for folder in self._kernel.plugins.folders],
                "uvloop" if type(self._kernel.loop).__module__.startswith("uvloop") else "asyncio",
                logging.getLogger("aiorts").getEffectiveLevel(),
                self._limits.memory,
                self._child is not None,  # started again, to be active again soon
                self._transport.program.hex(),
            )
            first.send(ours)
            arguments = ("-m", "aiorts", "kernel", "--fd", str(DESCRIPTOR))
            self._child = await self._launcher.start(
                arguments, descriptor=theirs.fileno(), name=self.name, on_line=self._wrote, limits=self._limits
            )
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        for limit, why in self._child.denied.items():
            self._line(logging.WARNING, f"limits.{limit} is not kept: {why}")
        self._links.reach.carried.add(self.kernel)
        connection = self._transport.take(ours)
        self._child.ended.add_done_callback(self._over)
        try:
            async with asyncio.timeout(_COMES_UP):
                await asyncio.wait((connection.greeted, self._child.ended), return_when=asyncio.FIRST_COMPLETED)
                self._peer = connection.peer
                await self.ask("create", within=_COMES_UP, type=text, name=self.name, params=params)
        except TimeoutError:
            raise await self._not_up(f"has not come up within {_COMES_UP:g} s") from None
        except ProcessError as error:
            raise await self._not_up(str(error).removeprefix(f"{self.name}: ")) from None
        except BaseException:
            await self.end()
            raise
        self._looking = self._links.run(self._look(), f"aiorts process {self.name}")

    async def _not_up(self, why: str) -> ProcessError:
        """End the process, which did not come up; the error that says so."""
        child = self._child
        assert child is not None  # noqa: S101 - it was started
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LOOK):
                await asyncio.shield(child.ended)
                why = f"its process ended: {child.ended.result().text}"
        await self.end()
        lines = (
            "".join(f"\n  {text_of(line)}" for line in child.ended.result().last_lines) if child.ended.done() else ""
        )
        return ProcessError(f"{self.name}: {why}{lines}")

    async def ask(self, operation: str, within: float = _ANSWERS, **arguments: Any) -> Any:
        """The result of an operation in the process.

        Raises:
            ProcessError: the process is gone, or does not answer in time.
            AiortsError: what refused it.
        """
        if self._peer is None or not self.runs:
            raise ProcessError(f"{self.name}: its process has ended")
        body = messages.request(operation, arguments)
        try:
            answer = await self._transport.ask(self._peer, messages.OPERATE, body, within=within)
        except LinkTimeout:
            raise ProcessError(f"{self.name}: {operation}: its process has not answered within {within:g} s") from None
        except LinkError as error:
            raise ProcessError(f"{self.name}: {operation}: {error}") from None
        return messages.value_of(answer)

    async def end(self) -> None:
        """End the process in order, or kill it, where a hook holds it or it does not end."""
        self._ending = True
        if self._looking is not None:
            self._looking.cancel()
        child = self._child
        if child is None:
            return
        self._delay = self.delay
        try:
            if not self._delay and self._peer is not None and self.runs:
                with contextlib.suppress(AiortsError):
                    await self.ask("end", within=_LOOK)
                await asyncio.wait((child.ended,), timeout=_ENDS)
                if self.runs:
                    self._delay = f"it had not ended {_ENDS:g} s after it was asked to"
        finally:
            why = self._delay or "the kernel did not wait for its end"
            if not self._delay and (others := self._holder()):
                why = f"{why}: others used up the time ({others})"
            if self._peer is not None and self.runs and not child.ended.done():
                self._line(logging.WARNING, f"killed: {why}; its on_finalize may not have run")
            child.kill()  # also where the wait for it was cancelled
        await asyncio.wait((child.ended,), timeout=_KILLED)

    def _over(self, ended: asyncio.Future[Ending]) -> None:
        if self._looking is not None:
            self._looking.cancel()
        self._busy_since = None
        if not self._ending and self._looking is not None and not ended.cancelled():
            ending = ended.result()
            self._ended(self._killed or ending.text, ending.last_lines)

    async def _look(self) -> None:
        """See whether it answers; kill it when a hook holds it beyond its deadline, or nothing can reach it."""
        lost = False
        while True:
            await asyncio.sleep(_LOOK)
            asked = self._kernel.loop.time()
            # One question waits until it is answered, between two hooks; meanwhile the present hook holds the process.
            ping = asyncio.ensure_future(self.ask("ping", within=_PATIENT))
            try:
                while not (await asyncio.wait((ping,), timeout=_LOOK))[0]:
                    self._busy_since = self._busy_since or asked
                    if self.deadline is not None and self.busy > self.deadline + _BUSY_BEYOND:
                        return self._kill(f"a hook has held it for {self.busy:.1f} s")
                self._counted(ping.result())
                self._busy_since = None
            except ProcessError:
                self._busy_since = self._busy_since or asked
                if lost:
                    return self._kill("it has closed its connection with this kernel and goes on")
                lost = self._peer not in self._links.peers  # else it ends: its end says how
            finally:
                ping.cancel()

    def _kill(self, why: str) -> None:
        self._killed = f"killed: {why}"
        self._line(logging.ERROR, self._killed)
        if self._child is not None:
            self._child.kill()

    def _wrote(self, stream: str, line: str) -> None:
        if stream == "stdout":
            self._printed(line)
        elif line.startswith(messages.MARK):
            level, _, text = line[1:].partition(" ")
            self._line(int(level) if level.isdecimal() else logging.INFO, text)
        else:
            self._line(logging.WARNING, line)


def text_of(line: str) -> str:
    """A line of a process, without the mark that makes it a record of the log."""
    return line[1:].partition(" ")[2] if line.startswith(messages.MARK) else line
