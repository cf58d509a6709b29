"""Starts children and reports their end, in the process that wants them: the loop's side of the helper process.

It starts nothing itself but the helper, waits for no other process, and changes nothing of the process that it is in.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from aiorts.errors import ClosedError, ProcessError
from aiorts.late import dataclass
from aiorts.processes.tree import kill_trees, started
from aiorts.processes.values import Ending, Limits

_STARTING: Final = 10.0
"""Seconds within which the helper answers: it takes 0.05 on an idle machine."""
_AT_ONCE: Final = 65536
_NO_LIMITS: Final = Limits()


@dataclass(slots=True)
class _Report:
    """The receiver of the reports of one child."""

    name: str
    on_line: Callable[[str, str], None]
    begun: asyncio.Future[Child]


class Child:
    """One process that a launcher has started.

    Attributes:
        pid: its number; it is the leader of a session of its own.
        ended: how it ended, once it has.
        granted: what keeps each limit that was asked for.
        denied: the limits that nothing keeps, and why; to be said once.
    """

    def __init__(
        self,
        launcher: Launcher,
        number: int,
        pid: int,
        began: int,
        granted: Mapping[str, str],
        denied: Mapping[str, str],
    ) -> None:
        self.pid = pid
        self.ended: asyncio.Future[Ending] = asyncio.get_running_loop().create_future()
        self.granted, self.denied = granted, denied
        self._launcher, self._number, self._began = launcher, number, began

    def kill(self) -> None:
        """Kill it and its descendants, at once; `ended` says when. Nothing happens when it has ended."""
        if not self.ended.done():
            self._launcher._request({"kill": self._number})

    def _lose(self) -> None:
        """Report the process as lost: the helper, which waited for its end, is gone."""
        if started(self.pid) == self._began:
            kill_trees([self.pid])
        self._end(Ending(None, None))

    def _end(self, ending: Ending) -> None:
        if not self.ended.done():
            self.ended.set_result(ending)


class Launcher:
    """Starts children below one helper process, which is started with the first.

    Whatever ends this process, its children and all their descendants end within a second. Where there is no /proc, as
    on macOS, descendants that began a session of their own stay.

    Raises:
        ProcessError: this system starts no processes in this way.
    """

    def __init__(self) -> None:
        if not hasattr(os, "posix_spawn") or not hasattr(socket, "send_fds"):
            raise ProcessError(f"components have no process of their own on {sys.platform}; use Linux, or no isolation")
        self._helper: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None
        self._outgoing: deque[tuple[bytes, list[int]]] = deque()
        self._incoming = b""
        self._numbers = 0
        self._reports: dict[int, _Report] = {}
        self._children: dict[int, Child] = {}
        self._ended = asyncio.Event()
        self._closed = False

    async def start(
        self,
        arguments: Sequence[str],
        *,
        descriptor: int,
        name: str,
        on_line: Callable[[str, str], None],
        limits: Limits = _NO_LIMITS,
    ) -> Child:
        """A process that runs `sys.executable -P *arguments`, in the environment and folder of this one.

        Args:
            arguments: its program, which calls `prepare` first.
            descriptor: what it inherits as `DESCRIPTOR`; this process keeps its own, and closes it.
            name: for errors.
            on_line: called with "stdout" or "stderr" and a line, never from within `start`.
            limits: what it may use. It calls `limit_memory` itself.

        Raises:
            ProcessError: it cannot be started, or `limits.processes` cannot be kept.
            ClosedError: the launcher is closed.
        """
        if self._closed:
            raise ClosedError(f"{name}: no process is started any more: the launcher is closed")
        if self._control is None:
            self._begin()
        self._numbers += 1
        number = self._numbers
        begun: asyncio.Future[Child] = asyncio.get_running_loop().create_future()
        self._reports[number] = _Report(name, on_line, begun)
        bounds = {"memory": limits.memory, "cpu": limits.cpu, "processes": limits.processes}
        command = {"start": [sys.executable, "-P", *arguments], "environment": dict(os.environ), "folder": _folder()}
        try:
            self._request({"number": number, "limits": bounds, **command}, os.dup(descriptor))
            async with asyncio.timeout(_STARTING):
                return await begun
        except TimeoutError:
            self._abandon(number)
            raise ProcessError(f"{name}: the helper process has not answered within {_STARTING:g} s") from None
        except BaseException:
            self._abandon(number)
            raise

    async def close(self, within: float = 5.0) -> None:
        """Kill all children and their descendants, and the helper when they have ended; idempotent.

        Each `ended` is set when this returns, which is within so many seconds. A helper that is not done then, since
        descendants go on starting others, ends by itself when none is left.
        """
        self._closed = True
        if self._control is not None:
            with contextlib.suppress(OSError):
                self._control.shutdown(socket.SHUT_WR)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(within):
                    await self._ended.wait()
        helper, self._helper, is_over = self._helper, None, self._control is None
        self._lose()
        if helper is not None and is_over:
            _kill_unless_ended(helper)
        elif helper is not None:
            # A helper that is killed leaves the processes that it has not killed yet. One that was stopped goes on.
            helper.send_signal(signal.SIGCONT)
            threading.Thread(target=helper.wait, name="aiorts-helper", daemon=True).start()

    # The helper.

    def _begin(self) -> None:
        """Start the helper process. ProcessError: it cannot be."""
        ours, its = socket.socketpair()
        if self._helper is not None:  # it was killed
            _kill_unless_ended(self._helper)
        try:
            number, pid = str(its.fileno()), str(os.getpid())
            self._helper = subprocess.Popen(  # noqa: S603 - this interpreter, with a module of ours
                [sys.executable, "-P", "-m", "aiorts.processes.helper", number, pid],
                pass_fds=(its.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is not for it
            )
        except OSError as error:
            ours.close()
            raise ProcessError(f"the helper process cannot be started: {error}") from None
        finally:
            its.close()
        ours.setblocking(False)
        self._control, self._incoming = ours, b""
        self._ended.clear()
        asyncio.get_running_loop().add_reader(ours, self._read)

    def _request(self, request: dict[str, Any], *descriptors: int) -> None:
        """Send a request and give the descriptors away; nothing is sent when the helper is gone."""
        self._outgoing.append((json.dumps(request).encode() + b"\n", [*descriptors]))
        self._write()

    def _write(self) -> None:
        control = self._control
        if control is None:
            self._discard()
            return
        loop = asyncio.get_running_loop()
        try:
            while self._outgoing:
                data, descriptors = self._outgoing[0]
                sent = socket.send_fds(control, [data], descriptors) if descriptors else control.send(data)
                for one in descriptors:
                    os.close(one)
                self._outgoing[0] = (data[sent:], [])
                if sent == len(data):
                    self._outgoing.popleft()
            loop.remove_writer(control)
        except BlockingIOError:
            loop.add_writer(control, self._write)
        except OSError:  # `_read` is notified of it, too
            self._discard()

    def _discard(self) -> None:
        for _, descriptors in self._outgoing:
            for one in descriptors:
                os.close(one)
        self._outgoing.clear()

    def _read(self) -> None:
        while self._read_once():
            pass  # to the last byte: uvloop calls a reader once at a socket with an error, whatever is to be read

    def _read_once(self) -> bool:
        """Read and handle reports that have arrived; False: there are no more."""
        data = b""
        try:
            if self._control is not None:
                data = self._control.recv(_AT_ONCE)
        except BlockingIOError:
            return False
        except OSError:  # as if it had closed it
            pass
        *lines, self._incoming = (self._incoming + data).split(b"\n")
        for line in lines:
            self._take(json.loads(line))
        if not data:
            self._lose()
        return bool(data)

    def _take(self, report: dict[str, Any]) -> None:
        number = report.pop("number")
        where = self._reports[number]
        if "line" in report:
            asyncio.get_running_loop().call_soon(where.on_line, report["stream"], report["line"])
        elif "pid" in report:
            child = self._children[number] = Child(self, number, **report)
            if where.begun.cancelled():
                child.kill()
            else:
                where.begun.set_result(child)
        elif "refused" in report:
            del self._reports[number]
            if not where.begun.cancelled():
                where.begun.set_exception(ProcessError(f"{where.name}: {report['refused']}"))
        else:
            del self._reports[number]
            report["last_lines"] = tuple(report["last_lines"])
            self._children.pop(number)._end(Ending(**report))

    def _abandon(self, number: int) -> None:
        """Kill a process whose caller of `start` does not wait any more."""
        if child := self._children.get(number):
            child.kill()
        elif report := self._reports.get(number):
            report.begun.cancel()

    def _lose(self) -> None:
        """Report all children as lost: the helper has closed its end, or is no longer waited for."""
        control, self._control = self._control, None
        if control is None:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(control)
        loop.remove_writer(control)
        control.close()
        self._discard()
        for child in self._children.values():
            child._lose()
        for report in self._reports.values():
            if not report.begun.done():
                report.begun.set_exception(ProcessError(f"{report.name}: the helper process has ended"))
        self._children.clear()
        self._reports.clear()
        self._ended.set()


def _kill_unless_ended(helper: subprocess.Popen[bytes]) -> None:
    """Kill the helper unless it ends soon: it has closed its socket, or is stuck."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        helper.wait(0.1)
        return
    helper.kill()
    helper.wait()


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return "/"
