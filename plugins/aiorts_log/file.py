"""The file that a recording is written into: had alone, extended by whole pieces only, and told of every failure.

What cannot be appended whole is cut off again: the file is valid up to there at every moment.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, TypeAlias

from aiorts_log.errors import RecordingError

try:
    import fcntl
except ImportError:  # not POSIX: the exclusive creation is what there is
    fcntl = None  # type: ignore[assignment]

__all__ = ("Existing", "LogFile", "held_by", "least_free", "next_part", "part_path")

Existing: TypeAlias = Literal["refuse", "append", "overwrite"]
_MOST_PARTS: Final = 512
GIB: Final = 2**30


def part_path(path: Path, number: int) -> Path:
    """The file of that number of a recording in several: run.mcap, run.1.mcap, run.2.mcap."""
    return path if not number else path.with_name(f"{path.stem}.{number}{path.suffix}")


def next_part(path: Path, number: int, existing: Existing) -> int:
    """The number of the file after that one: of one that is not there yet, unless it may be replaced."""
    number += 1
    while existing != "overwrite" and os.path.lexists(part_path(path, number)):
        number += 1
    return number


def least_free(path: Path, asked: int | None) -> int:
    """Octets to leave free on the disk: what was asked for, or 1 GiB, or 5 % of a disk where that is less."""
    if asked is not None or not hasattr(os, "statvfs"):
        return asked or 0
    found = os.statvfs(path.parent)
    return min(GIB, found.f_blocks * found.f_frsize // 20)


def held_by(path: Path) -> str:
    """Who has a file for recording: "process 4242 (aiorts flexilogger ...)" as far as that is known; "" for nobody."""
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
    """The process that has locked a file, of the system's list of locks; it may be of another container."""
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
        said = " ".join(ascii(word.decode(errors="replace"))[1:-1] for word in words[:8] if word)
        return f"process {number} ({said[:120]})" if said else f"process {number}"
    return f"process {number}"


class LogFile:
    """A file opened for writing, and locked.

    Args:
        existing: what is to happen when the file is there: "refuse", "append" or "overwrite".
        min_free: octets of the disk that are to stay free.

    Raises:
        RecordingError: it exists, is no regular file, another recorder has it, or it cannot be opened.
    """

    def __init__(self, path: Path, existing: Existing = "refuse", min_free: int | None = None) -> None:
        self.path = path
        self._is_new = existing == "refuse"
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
        flags |= getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        if existing == "refuse":
            flags |= os.O_EXCL
        try:
            self._file = os.open(path, flags, 0o600)
        except FileExistsError:
            raise RecordingError(
                f"{path}: is there already; --append continues it, --overwrite replaces it, or name another file"
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
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = held_by(self.path) or "another recorder"
            raise RecordingError(f"{self.path}: {who} writes it; name another file") from None

    @property
    def descriptor(self) -> int:
        """The open file, to read what is there already."""
        return self._file

    @property
    def displaced(self) -> str:
        """What became of its name: "deleted or renamed", "replaced by another file"; "" as long as it has it."""
        try:
            ours = os.fstat(self._file)
            named = os.lstat(self.path)
        except FileNotFoundError:
            return "deleted or renamed"
        except OSError:  # closed meanwhile, or the folder tells nothing
            return ""
        return "" if os.path.samestat(ours, named) else "replaced by another file"

    def append(self, parts: Sequence[bytes]) -> int:
        """Write all of it behind what is there; returns how many octets that were.

        Raises:
            OSError: it could not be written whole; nothing of it is left.
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
        """One call of the system: returns how many octets it took."""
        return os.writev(self._file, parts) if hasattr(os, "writev") else os.write(self._file, parts[0])

    def _check_room(self, octets: int) -> None:
        if not self._min_free:
            return
        found = os.statvfs(self._file)
        free = found.f_bavail * found.f_frsize
        if free - octets < self._min_free:
            raise OSError(28, f"{free >> 20} MiB are free; {self._min_free >> 20} MiB are to stay so (--min-free)")

    def cut(self, size: int) -> None:
        """Drop whatever lies behind `size`, as far as the disk allows it."""
        with contextlib.suppress(OSError):
            os.lseek(self._file, size, os.SEEK_SET)
            self.size = size
            os.ftruncate(self._file, size)

    def sync(self) -> None:
        """Wait until it is on the disk. OSError when it may not be: it never will be then."""
        os.fsync(self._file)

    def use_reserve(self) -> None:
        """Write from now on also where it should have stayed free: an index needs little."""
        self._min_free = 0

    def give_up(self) -> None:
        """Let it go; one that was made and has nothing in it is there no more."""
        if self._is_new and not self.size and not self.displaced:
            with contextlib.suppress(OSError):
                os.unlink(self.path)
        self.close()

    def close(self) -> None:
        """Let it go; again it does nothing."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)
