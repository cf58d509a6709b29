"""A log file to which lines are appended: one process at a time has it, and a full disk does not stop the run.

Each line is one system call, so no line is lost with the process, however it ends.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Final

from aiorts.errors import ConfigurationError

_LOCKS: Final = Path("/proc/locks")


class LogFile:
    """An open log file.

    Args:
        complain: called once each time that lines begin to be lost.
        lost: makes the line with the number of lost lines, when there is room again.

    Raises:
        ConfigurationError: the file cannot be opened, or another process has it.
    """

    def __init__(self, path: Path, complain: Callable[[str], None], lost: Callable[[int], str]) -> None:
        self.path = path
        self._complain = complain
        self._lost_line = lost
        self._lost = 0
        self._torn = False
        self._descriptor = -1
        try:
            # Non-blocking: a pipe without a reader would block here without end.
            self._descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666)
            os.set_blocking(self._descriptor, True)
            self._take()
        except ConfigurationError:
            self.close()
            raise
        except (OSError, ValueError) as error:
            self.close()
            raise ConfigurationError(f"--log-file {path}: {_why(path, error)}") from None

    def _take(self) -> None:
        """Lock the file for this process; a terminal, a pipe or /dev/null is shared."""
        if not stat.S_ISREG(os.fstat(self._descriptor).st_mode):
            return
        try:
            import fcntl
        except ImportError:  # not POSIX: two processes may write to it
            return
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = holder_of(os.fstat(self._descriptor))
            who = "another process" if holder is None else f"process {holder}"
            raise ConfigurationError(
                f"--log-file {self.path}: {who} writes to it; name another file, or end that process"
            ) from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL):  # a file system without locks
                raise

    def write(self, line: str) -> None:
        """Append a line, given without its newline; never raises."""
        text = f"{line}\n"
        if self._lost:
            text = f"{chr(10) if self._torn else ''}{self._lost_line(self._lost)}\n{text}"
        data = text.encode("utf-8", "backslashreplace")
        try:
            written = os.write(self._descriptor, data)
            if written < len(data):
                self._torn = True
                written += os.write(self._descriptor, data[written:])
            why = "" if written == len(data) else "no room"
        except OSError as error:
            why = error.strerror or str(error)
        if not why:
            self._lost, self._torn = 0, False
            return
        self._lost += 1
        if self._lost == 1:
            self._complain(f"--log-file {self.path}: {why}; lines are lost until there is room, the run goes on")

    def close(self) -> None:
        """Close the file; idempotent."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            try:
                os.close(descriptor)
            except OSError as error:
                self._complain(f"--log-file {self.path}: {error.strerror or error}; its last lines may be lost")


def holder_of(status: os.stat_result) -> int | None:
    """The number of the process that has locked the file; None when the system does not tell."""
    try:
        lines = _LOCKS.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return None
    for line in lines:
        fields = line.split()
        # 1: FLOCK  ADVISORY  WRITE 4711 08:01:1234 0 EOF; "->" after the number marks a waiting process. Not all file
        # systems give the device that stat gives, so the inode decides.
        if len(fields) > 5 and fields[1] == "FLOCK" and fields[5].rpartition(":")[2] == str(status.st_ino):
            return int(fields[4]) or None
    return None


def _why(path: Path, error: OSError | ValueError) -> str:
    if isinstance(error, ValueError):
        return f"{error}; name another file"
    if error.errno == errno.ENOENT:
        return f"there is no folder {str(path.parent)!r}; make it, or name another"
    if error.errno == errno.ENXIO:
        return "a pipe without a reader; start its reader first"
    if error.errno == errno.EISDIR:
        return "is a folder; name a file"
    return f"{error.strerror or error}; name a file that can be written"
