"""The helper process: starts children, keeps what they write within bounds, reports their end, and kills what is left.

It belongs to one process, whose end it notices by the end-of-file of its socket and, where the system has them, by a
pidfd, which copies of the socket in forked processes do not hold up. It runs no user's code and never waits for
anything but its descriptors. Requests and reports are JSON, one a line.

All children are started by its one thread, and it adopts the descendants of those that have ended. Adopting is
process-wide: an application that did it in itself, `aiorts run` too, would get the orphans of whatever its components
start, and would have to wait for processes that it does not know. And when it is killed, nobody would be left to kill
the descendants of a child that is stopped or holds the interpreter's lock.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time
from functools import partial

from aiorts.late import TYPE_CHECKING
from aiorts.processes import groups
from aiorts.processes.output import Output
from aiorts.processes.tree import HAS_PROC, adopt_orphans, children, first_in_line, kill, kill_trees, started

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_AT_ONCE = 65536
"""Bytes that are read at once: what a pipe holds."""
_DRAIN = 64
"""How many more times the pipe of an ended process is read, into which others may still write."""
_BACKLOG = 1 << 20
"""Bytes of lines that wait for a parent whose loop does not turn; further ones are left out."""
_ENDING = 30.0
"""Seconds after which what cannot be killed, such as a process of another user, is left. Where this process has no
priority over others, those that start others without end have most of the processor: 5 s were not always enough."""
_ABOVE = 10
"""Own descriptors are not below: a child's are 0 to 4, and the order in which those are set does not matter then."""
_STREAMS = ("stdout", "stderr")


class _Child:
    """One process that was started."""

    def __init__(self, number: int, pid: int, group: groups.Group | None) -> None:
        self.number, self.pid, self.group = number, pid, group
        self.output = Output()
        self.pipes: dict[str, int] = {}
        self.killed = False


class Helper:
    """The helper of the process `parent`, at the other end of `control`."""

    def __init__(self, control: socket.socket, parent: int) -> None:
        self._control = control
        self._children: dict[int, _Child] = {}
        self._old_groups: list[groups.Group] = []
        self._requests, self._outgoing = b"", bytearray()
        self._descriptors: list[int] = []
        self._closing = False
        self._killed_for_memory = groups.killed_for_memory()
        self._poll = select.poll()
        self._ready: dict[int, Callable[[], object]] = {}
        control.setblocking(False)
        self._watch(control.fileno(), self._exchange)
        self._null = os.open(os.devnull, os.O_RDWR)
        # A child sees the end-of-file of this pipe when its last writer is gone, and this process is the only writer.
        self._liveness, self._held = os.pipe()
        self._woken, wake = os.pipe()
        os.set_blocking(self._woken, False)
        os.set_blocking(wake, False)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        self._watch(self._woken, self._reap)
        if hasattr(os, "pidfd_open"):
            with contextlib.suppress(OSError):  # it has gone, or the system has none: the socket reports it
                self._watch(os.pidfd_open(parent), self._close)
        if os.getppid() != parent:
            self._close()

    def run(self) -> None:
        """Work until the parent closes the socket or ends; then kill what is left."""
        while not self._closing:
            for descriptor, _ in self._poll.poll(self._milliseconds()):
                if ready := self._ready.get(descriptor):  # else unwatched in this round
                    ready()
            now = time.monotonic()
            for child in self._children.values():
                if child.output.due is not None:
                    self._pass_on(child, child.output.due_at(now))
        self._end()

    def _milliseconds(self) -> float | None:
        due = [child.output.due for child in self._children.values() if child.output.due is not None]
        return max(0.0, min(due) - time.monotonic()) * 1000 + 1 if due else None

    def _watch(self, descriptor: int, ready: Callable[[], object]) -> None:
        self._ready[descriptor] = ready
        self._poll.register(descriptor, select.POLLIN)

    def _unwatch(self, descriptor: int) -> None:
        self._poll.unregister(descriptor)
        del self._ready[descriptor]
        os.close(descriptor)

    def _close(self) -> None:
        self._closing = True

    # Requests and reports.

    def _exchange(self) -> None:
        self._flush()
        try:
            data, descriptors, _, _ = socket.recv_fds(self._control, _AT_ONCE, 16)
        except BlockingIOError:
            return
        except OSError:
            data, descriptors = b"", []
        for descriptor in descriptors:
            os.set_inheritable(descriptor, False)  # what is received is inherited otherwise, by whatever starts next
        self._descriptors += descriptors
        if not data:
            self._close()
        *lines, self._requests = (self._requests + data).split(b"\n")
        for line in lines:
            request = json.loads(line)
            if "kill" in request:
                self._kill(request["kill"])
            elif self._descriptors:
                self._start(request, self._descriptors.pop(0))
            else:  # the system drops what there is no room for
                self._report(request["number"], refused="the helper process has no descriptors left")

    def _report(self, number: int, **report: Any) -> None:
        self._outgoing += json.dumps({"number": number, **report}).encode() + b"\n"
        self._flush()

    def _flush(self) -> None:
        try:
            while self._outgoing:
                del self._outgoing[: self._control.send(self._outgoing)]
        except BlockingIOError:
            pass
        except OSError:
            self._outgoing.clear()
            self._close()
        self._poll.modify(self._control.fileno(), select.POLLIN | (select.POLLOUT if self._outgoing else 0))

    # Starting.

    def _start(self, request: dict[str, Any], descriptor: int) -> None:
        granted: dict[str, str] = {}
        denied: dict[str, str] = {}
        number, limits = request["number"], request["limits"]
        group = None
        pipes: list[int] = []
        try:
            group = self._group(number, limits, granted, denied)
            pipes = [*os.pipe(), *os.pipe()]
            pid = self._spawn(request, descriptor, pipes[1], pipes[3])
            if group is not None:
                self._put(pid, group, limits, granted, denied)
        except (OSError, groups.Refused) as error:
            for one in pipes[::2]:
                os.close(one)
            if group is not None:
                group.remove()
            self._report(number, refused=str(error))
            return
        finally:
            for one in (descriptor, *pipes[1::2]):
                os.close(one)
        child = self._children[pid] = _Child(number, pid, group)
        if limits["memory"] is not None:
            if HAS_PROC:
                granted["memory"] = "RLIMIT_AS, by the process itself after its imports"
            else:
                denied["memory"] = f"{sys.platform} keeps no RLIMIT_AS"
        if limits["cpu"] is not None and "cpu" not in granted:
            _be_nice(pid, limits["cpu"], granted, denied)
        for stream, pipe in zip(_STREAMS, pipes[::2], strict=True):
            os.set_blocking(pipe, False)
            child.pipes[stream] = pipe
            self._watch(pipe, partial(self._read, child, stream))
        self._report(number, pid=pid, began=started(pid), granted=granted, denied=denied)

    def _group(
        self, number: int, limits: dict[str, Any], granted: dict[str, str], denied: dict[str, str]
    ) -> groups.Group | None:
        """The group that keeps the limits which need one, and by which all in it are killed at once; None: there is
        none here. Refused: there is none, and nothing else keeps a limit."""
        bounds = {}
        if limits["cpu"] is not None:
            bounds["cpu"] = groups.cpu_bound(limits["cpu"])
        if limits["processes"] is not None:
            bounds["processes"] = groups.processes_bound(limits["processes"])
        try:
            parent = groups.own_group()
            prefix = "aiorts-"
            groups.remove_old(parent, prefix)
            group = groups.Group(parent, f"{prefix}{os.getpid()}-{number}", [*bounds.values()])
        except (OSError, groups.Refused) as error:
            if "processes" in bounds:
                raise groups.Refused(f"limits.processes = {limits['processes']}: {error}") from None
            if "cpu" in bounds:
                denied["cpu"] = str(error)
            return None
        granted.update({limit: f"cgroup v2, {file} = {value}" for limit, (_, file, value) in bounds.items()})
        return group

    def _put(
        self, pid: int, group: groups.Group, limits: dict[str, Any], granted: dict[str, str], denied: dict[str, str]
    ) -> None:
        try:
            group.add(pid)
        except groups.Refused as error:
            if limits["processes"] is not None:
                kill(pid)
                raise
            granted.clear()
            if limits["cpu"] is not None:
                denied["cpu"] = str(error)

    def _spawn(self, request: dict[str, Any], descriptor: int, stdout: int, stderr: int) -> int:
        if os.path.isdir(request["folder"]):
            os.chdir(request["folder"])
        given = {0: self._null, 1: stdout, 2: stderr, 3: descriptor, 4: self._liveness}
        return os.posix_spawn(
            request["start"][0],
            request["start"],
            request["environment"] | {"AIORTS_HELPER": str(os.getpid())},
            file_actions=[(os.POSIX_SPAWN_DUP2, own, its) for its, own in given.items()],
            setsid=True,
            setsigmask=(),
            setsigdef=(signal.SIGPIPE, signal.SIGXFSZ, signal.SIGINT),  # Python ignores two; a shell's "&" the third
        )

    # Output.

    def _read(self, child: _Child, stream: str) -> bool:
        """Read once; return whether there may be more."""
        pipe = child.pipes[stream]
        try:
            data = os.read(pipe, _AT_ONCE)
        except BlockingIOError:
            return False
        self._pass_on(child, child.output.feed(stream, data, time.monotonic()))
        if not data:
            self._unwatch(child.pipes.pop(stream))
        return bool(data)

    def _pass_on(self, child: _Child, lines: Any) -> None:
        for stream, line in lines:
            if len(self._outgoing) > _BACKLOG:
                child.output.leave_out(1, len(line) + 1)
            else:
                self._report(child.number, stream=stream, line=line)

    # Ends.

    def _kill(self, number: int) -> None:
        for child in self._children.values():
            if child.number == number:
                child.killed = True
                self._kill_child(child)

    def _kill_child(self, child: _Child) -> None:
        """Kill a child and all that descend from it; what has lost its parent comes here: `_reap` kills it."""
        if child.group is not None:
            child.group.kill()
        with first_in_line():
            kill_trees([child.pid])

    def _reap(self) -> bool:
        """Collect processes that have ended, and kill those that lost their parent; return whether a child is left."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._woken, _AT_ONCE)
        left = True
        while left:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                left = False
                break
            if not pid:
                break
            if child := self._children.pop(pid, None):
                self._ended(child, os.waitstatus_to_exitcode(status))
        if orphans := [orphan for orphan in children(os.getpid()) if orphan not in self._children]:
            with first_in_line():
                kill_trees(orphans)
        self._old_groups = [group for group in self._old_groups if not group.remove()]
        return left

    def _ended(self, child: _Child, code: int) -> None:
        if not HAS_PROC:  # what is left of its group
            kill_trees([child.pid])
        if child.group is not None:
            child.group.kill()
            self._old_groups.append(child.group)
        for stream in tuple(child.pipes):
            for _ in range(_DRAIN):
                if stream not in child.pipes or not self._read(child, stream):
                    break
        for pipe in child.pipes.values():
            self._unwatch(pipe)
        self._pass_on(child, child.output.end())
        before, self._killed_for_memory = self._killed_for_memory, groups.killed_for_memory()
        self._report(
            child.number,
            status=code if code >= 0 else None,
            signal=-code if code < 0 else None,
            out_of_memory=code == -signal.SIGKILL and not child.killed and self._killed_for_memory > before,
            last_lines=child.output.last_lines,
        )

    def _end(self) -> None:
        """Kill all children, until none is left to wait for."""
        for child in self._children.values():
            child.killed = True
            self._kill_child(child)
        until = time.monotonic() + _ENDING
        while self._reap() and time.monotonic() < until:
            select.select([self._woken], [], [], 0.02)
        for group in self._old_groups:
            group.remove()
        self._control.settimeout(1.0)
        with contextlib.suppress(OSError):  # nobody reads
            self._control.sendall(self._outgoing)


def _be_nice(pid: int, share: float, granted: dict[str, str], denied: dict[str, str]) -> None:
    """Give a process about this share of a processor that others want, too: each step of nice is a factor of 1.25."""
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    while share < 0.9 and nice < 19:  # to the nearest step
        share, nice = share * 1.25, nice + 1
    try:
        os.setpriority(os.PRIO_PROCESS, pid, nice)
    except OSError as error:
        denied["cpu"] = f"{denied['cpu']}; nor nice {nice}: {error.strerror}"
        return
    granted["cpu"] = f"nice {nice}: no bound, it yields to others ({denied.pop('cpu')})"


def main() -> None:
    """Be the helper: arguments are the number of the socket and the process it belongs to."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD):
        # At these signals the parent ends in order, and this process with it. Children would inherit ignored signals.
        signal.signal(number, lambda *_: None)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the thread that started this one may have blocked SIGCHLD
    adopt_orphans()
    control = socket.socket(fileno=int(sys.argv[1]))
    control.set_inheritable(False)
    while os.open(os.devnull, os.O_RDWR) < _ABOVE:
        pass
    Helper(control, int(sys.argv[2])).run()
    os._exit(0)  # there is nothing to finalize, and the parent waits


if __name__ == "__main__":
    main()
