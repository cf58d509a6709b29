"""Groups of cgroup v2: bounds for one process and its descendants, where an administrator delegated them.

Only an attempt shows whether a group can be made; each group is removed again. All work is on small files, and
never waits.
"""

from __future__ import annotations

import os

from aiorts.late import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_PERIOD = 100_000
"""Microseconds in which a share of a processor is counted: the kernel's default."""


class Refused(Exception):
    """There is no such group; the text is the reason."""


class Group:
    """One group below that of this process.

    Raises:
        Refused: no such group can be made.
    """

    def __init__(self, parent: str, name: str, bounds: Sequence[tuple[str, str, str]]) -> None:
        self.path = f"{parent}/{name}"
        try:
            wanted = {controller for controller, _, _ in bounds}
            if missing := sorted(wanted - set(_read(f"{parent}/cgroup.controllers").split())):
                raise Refused(f"cgroup v2 at {parent} has no controller {', '.join(missing)}")
            if wanted - set(_read(f"{parent}/cgroup.subtree_control").split()):
                _write(f"{parent}/cgroup.subtree_control", " ".join(f"+{one}" for one in sorted(wanted)))
            os.mkdir(self.path)
        except OSError as error:
            raise Refused(f"cgroup v2 at {parent} is not delegated: {error.strerror}") from None
        try:
            for _, file, value in bounds:
                _write(f"{self.path}/{file}", value)
        except OSError as error:
            self.remove()
            raise Refused(f"cgroup v2 at {parent} refuses: {error.strerror}") from None

    def add(self, pid: int) -> None:
        """Put a process, and all that it will start, into the group. Refused: that is not possible."""
        try:
            _write(f"{self.path}/cgroup.procs", str(pid))
        except OSError as error:
            raise Refused(f"{self.path} takes no process: {error.strerror}") from None

    def kill(self) -> None:
        """Kill all processes of the group at once, if the kernel supports that (Linux 5.14)."""
        try:
            _write(f"{self.path}/cgroup.kill", "1")
        except OSError:
            return

    def remove(self) -> bool:
        """Remove the group; return whether it is gone: while a process runs in it, it stays."""
        try:
            os.rmdir(self.path)
        except FileNotFoundError:
            return True
        except OSError:
            return False
        return True


def own_group(proc: str = "/proc/self") -> str:
    """The folder of this process's group. Refused: there is no cgroup v2 here."""
    try:
        path = next(line[3:] for line in _read(f"{proc}/cgroup").splitlines() if line.startswith("0::"))
        mounts = [line.split() for line in _read(f"{proc}/mountinfo").splitlines() if " - cgroup2 " in line]
        return mounts[0][4] + path.rstrip("/")
    except (OSError, StopIteration, IndexError):
        raise Refused("this system has no cgroup v2") from None


def cpu_bound(share: float) -> tuple[str, str, str]:
    """Controller, file and value for a share of one processor."""
    return "cpu", "cpu.max", f"{max(1000, round(share * _PERIOD))} {_PERIOD}"


def processes_bound(count: int) -> tuple[str, str, str]:
    """Controller, file and value for a number of processes."""
    return "pids", "pids.max", str(count)


def remove_old(parent: str, prefix: str) -> None:
    """Remove the empty groups of helper processes that were killed."""
    for name in os.listdir(parent):
        pid = name.removeprefix(prefix).partition("-")[0]
        if name.startswith(prefix) and not os.path.exists(f"/proc/{pid}"):
            try:
                os.rmdir(f"{parent}/{name}")
            except OSError:
                continue


def killed_for_memory(files: Sequence[str] | None = None) -> int:
    """The number of processes that the system has killed for memory, by the nearest counter; 0 without a counter."""
    if files is None:
        try:
            files = (f"{own_group()}/memory.events", "/proc/vmstat")
        except Refused:
            files = ("/proc/vmstat",)
    for path in files:
        try:
            text = _read(path)
        except OSError:
            continue
        for line in text.splitlines():
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    return 0


def _read(path: str) -> str:
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.read()


def _write(path: str, text: str) -> None:
    with open(path, "w", encoding="ascii") as file:
        file.write(text)
