"""The file that a recording is written into: locked against other recorders, and extended by whole pieces only.

A piece that cannot be written whole is cut off again, so the file is valid at every moment.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from time import sleep
from typing import Final, Literal, TypeAlias

from aiorts_log.errors import RecordingError

try:
    import fcntl
except ImportError:  # not POSIX: only the exclusive creation protects the file
    fcntl = None  # type: ignore[assignment]

Existing: TypeAlias = Literal["refuse", "append", "overwrite"]
# Linux takes at most 1,024 buffers in one writev (IOV_MAX).
_MOST_PARTS: Final = 512
_PAUSES: Final = (0.001, 0.01, 0.05, 0.0)
"""Seconds between attempts to lock a file: `held_by` in another process locks the file for a moment."""
GIB: Final = 2**30


def part_path(path: Path, number: int) -> Path:
    """The file with that number of a recording in several files: run.mcap, run.1.mcap, run.2.mcap."""
    return path if not number else path.with_name(f"{path.stem}.{number}{path.suffix}")


def next_part(path: Path, number: int, existing: Existing) -> int:
    """The next number whose file does not exist yet, or the next number when files are overwritten."""
    number += 1
    while existing != "overwrite" and os.path.lexists(part_path(path, number)):
        number += 1
    return number


def least_free(path: Path, requested: int | None) -> int:
    """Bytes to leave free on the disk: as requested, else 1 GiB, or 5 % of the disk where that is less."""
    if requested is not None or not hasattr(os, "statvfs"):
        return requested or 0
    found = os.statvfs(path.parent)
    return min(GIB, found.f_blocks * found.f_frsize // 20)


def held_by(path: Path) -> str:
    """The process that records into a file, such as "process 4242 (aiorts flexilogger ...)"; "" when there is none."""
    if fcntl is None:
        return ""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return ""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(os.fstat(file))
    except OSError:
        return ""
    finally:
        os.close(file)
    return ""


def _holder(file: os.stat_result) -> str:
    """The process that has locked a file, by the system's list of locks; it may run in another container."""
    wanted = f"{os.major(file.st_dev):02x}:{os.minor(file.st_dev):02x}:{file.st_ino}"
    with contextlib.suppress(OSError):
        for line in Path("/proc/locks").read_text(encoding="ascii", errors="replace").splitlines():
            parts = line.split()
            if len(parts) > 5 and "->" not in parts and parts[1] == "FLOCK" and parts[5] == wanted:
                return _process(parts[4])
    return "another recorder"


def _process(number: str) -> str:
    if number == str(os.getpid()):
        return f"this process ({number})"
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{number}/cmdline").read_bytes().split(b"\0")
        command = " ".join(ascii(word.decode(errors="replace"))[1:-1] for word in words[:8] if word)
        return f"process {number} ({command[:120]})" if command else f"process {number}"
    return f"process {number}"


class LockedFile:
    """A file opened for writing, and locked.

    Args:
        existing: what to do when the file exists: "refuse", "append" or "overwrite".
        min_free: bytes of the disk to leave free.

    Raises:
        RecordingError: it exists, is no regular file, another recorder writes it, or it cannot be opened.
    """

    def __init__(self, path: Path, existing: Existing = "refuse", min_free: int | None = None) -> None:
        self.path = path
        self._is_new = existing == "refuse"
        # O_NOFOLLOW: in a shared folder a link could lead the recording over another file of the user.
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
        flags |= getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        if existing == "refuse":
            flags |= os.O_EXCL
        try:
            self._file = os.open(path, flags, 0o600)
        except FileExistsError:
            raise RecordingError(
                f"{path}: exists already; --append continues it, --overwrite replaces it, or name another file"
            ) from None
        except (OSError, ValueError) as error:
            raise RecordingError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
        try:
            self._own()
            self._min_free = least_free(path.absolute(), min_free)
            if existing == "overwrite":
                os.ftruncate(self._file, 0)
            self.size = os.lseek(self._file, 0, os.SEEK_END)
        except BaseException:
            os.close(self._file)
            raise

    def _own(self) -> None:
        if not stat.S_ISREG(os.fstat(self._file).st_mode):
            raise RecordingError(f"{self.path}: is no regular file; a recording needs one")
        if fcntl is None:
            return
        for pause in _PAUSES:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                sleep(pause)
            else:
                return
        holder = held_by(self.path) or "another recorder"
        raise RecordingError(f"{self.path}: {holder} writes it; name another file")

    @property
    def descriptor(self) -> int:
        """The descriptor of the open file, to read what the file has already."""
        return self._file

    @property
    def displaced(self) -> str:
        """The present state of its name: "deleted or renamed", "replaced by another file"; "" while unchanged."""
        try:
            ours = os.fstat(self._file)
            named = os.lstat(self.path)
        except FileNotFoundError:
            return "deleted or renamed"
        except OSError:  # closed by another thread, or the folder cannot be read
            return ""
        return "" if os.path.samestat(ours, named) else "replaced by another file"

    def append(self, parts: Sequence[bytes]) -> int:
        """Write all parts at the end; returns the number of bytes.

        Raises:
            OSError: they could not be written whole; none of them is in the file.
        """
        self._check_room(sum(map(len, parts)))
        before = self.size
        try:
            self._write(parts)
        except OSError:
            self.size = before
            self.cut(before)
            raise
        return self.size - before

    def _write(self, parts: Sequence[bytes]) -> None:
        for first in range(0, len(parts), _MOST_PARTS):
            left = [memoryview(part) for part in parts[first : first + _MOST_PARTS]]
            while left:
                written = self.put(left)
                self.size += written
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if left and written:
                    left[0] = left[0][written:]

    def put(self, parts: list[memoryview]) -> int:
        """Write the parts by one system call; return the number of bytes written."""
        return os.writev(self._file, parts) if hasattr(os, "writev") else os.write(self._file, parts[0])

    def _check_room(self, size: int) -> None:
        if not self._min_free:
            return
        found = os.statvfs(self._file)
        free = found.f_bavail * found.f_frsize
        if free - size < self._min_free:
            raise OSError(28, f"{free >> 20} MiB are free; {self._min_free >> 20} MiB are to stay so (--min-free)")

    def cut(self, size: int) -> None:
        """Drop everything behind `size`, as far as the disk allows it."""
        with contextlib.suppress(OSError):
            os.lseek(self._file, size, os.SEEK_SET)
            self.size = size
            os.ftruncate(self._file, size)

    def sync(self) -> None:
        """Wait until everything is on the disk. OSError when it may not be there, and will never be."""
        os.fsync(self._file)

    def use_reserve(self) -> None:
        """Use the reserved space from now on: an index needs little of it."""
        self._min_free = 0

    def give_up(self) -> None:
        """Close the file, and delete it if this object made it and it is empty."""
        if self._is_new and not self.size and not self.displaced:
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        self.close()

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)
