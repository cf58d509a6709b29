"""The folder with the sockets of running kernels: it belongs to one user, and each kernel has an entry in it.

An entry is a socket, named by a hash of the kernel's address, and a small file next to it that names the kernel. The
folder is refused when it is a link, belongs to another user, or gives others access. An entry without a listener was
left by a process that is gone: the next reader removes it. The variable AIORTS_FOLDERS names further folders of that
kind, with ":" between them. A process that carries sessions to other hosts has one socket in such a folder for all
their kernels; the file next to it lists them (`Carrier`).
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import socket
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from aiorts.errors import ConfigurationError, ControlError
from aiorts.late import dataclass

LONGEST_PATH: Final = 107
"""Bytes of the longest socket path that the system takes."""
FURTHER: Final = "AIORTS_FOLDERS"
CLOSING_SECONDS: Final = 0.1
"""Seconds in which a killed process closes its sockets, one after the other."""
_PRIVATE: Final = 0o700
_LARGEST_FILE: Final = 16 << 20
_SUFFIXES: Final = (".json", ".part", ".sock")


@dataclass(frozen=True, slots=True)
class Entry:
    """A kernel that can be reached, as its file says."""

    address: str
    """"host/kernel"."""
    pid: int
    epoch: str
    """16 hexadecimal digits, new each time that a kernel opens its socket."""
    path: str
    """The path of the socket."""
    carried: bool = False
    """Whether the socket carries sessions with several kernels; a hello on it names its kernel."""

    @property
    def name(self) -> str:
        """The part of the address after the host."""
        return self.address.rpartition("/")[2]


def is_supported() -> bool:
    """Whether this system has Unix sockets, and users who own them."""
    return hasattr(socket, "AF_UNIX") and hasattr(os, "geteuid")


def place() -> Path:
    """The folder's path, whether or not it exists. ControlError: this system has no Unix sockets."""
    if not is_supported():
        raise ControlError("this system has no Unix sockets: what runs on it cannot be reached from other terminals")
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_absolute():
        return Path(runtime, "aiorts")
    return Path(tempfile.gettempdir(), f"aiorts-{os.geteuid()}")


def private_folder() -> Path:
    """The folder for sockets of this user's kernels, made if it does not exist.

    Raises:
        ControlError: the folder cannot be made, is a link, belongs to another user, or is open to others.
    """
    folder = place()
    try:
        folder.mkdir(mode=_PRIVATE)
    except FileExistsError:
        pass
    except OSError as error:
        raise ControlError(f"{folder}: cannot be made: {error.strerror}") from None
    check(folder)
    return folder


def check(folder: Path) -> None:
    """Check a folder: ControlError unless only this user has access, FileNotFoundError when it does not exist."""
    found = folder.lstat()
    why = ""
    if stat.S_ISLNK(found.st_mode):
        why = "is a link"
    elif not stat.S_ISDIR(found.st_mode):
        why = "is no folder"
    elif found.st_uid != os.geteuid():
        why = f"belongs to another user ({found.st_uid})"
    elif stat.S_IMODE(found.st_mode) != _PRIVATE:
        why = f"lets others in (mode {stat.S_IMODE(found.st_mode):04o}, expected 0700)"
    if why:
        raise ControlError(f"{folder}: {why}; it is not used. Remove it, or set XDG_RUNTIME_DIR to a folder of yours")


def entries() -> tuple[Entry, ...]:
    """The kernels that have an entry, sorted by address; some may be gone (`discard`). Incomplete entries are removed.

    Raises:
        ControlError: the folder is not safe.
    """
    further = [Path(one) for one in os.environ.get(FURTHER, "").split(os.pathsep) if one]
    every = [entry for folder in (place(), *further) for entry in _entries(folder)]
    return tuple(sorted(every, key=lambda one: one.address))


def _entries(folder: Path) -> list[Entry]:
    try:
        check(folder)
        files = {file.with_suffix(".json") for file in folder.iterdir() if file.suffix in _SUFFIXES}
    except FileNotFoundError:
        return []
    found = {file: _read(file) for file in files}
    if None in found.values():
        with contextlib.suppress(OSError, ControlError), _locked(folder, (0.0,)):
            for file, of in found.items():
                if of is None and _read(file) is None and _is_dead(str(file.with_suffix(".sock"))):
                    _remove(str(file.with_suffix(".sock")))
    return [entry for of in found.values() for entry in of or ()]


def entry_at(path: str) -> Entry:
    """The entry of the kernel at a socket. Unless the file next to it lists exactly one kernel, hello names it."""
    found = _read(Path(path).with_suffix(".json")) or ()
    return found[0] if len(found) == 1 else Entry(path, 0, "", path)


def discard(entry: Entry) -> None:
    """Remove an entry that no process listens at."""
    with contextlib.suppress(OSError, ControlError), _locked(Path(entry.path).parent):
        if _is_dead(entry.path):
            _remove(entry.path)


def is_served(entry: Entry) -> bool:
    """Whether the kernel of an entry, and no other, still listens; checked twice, as a killed kernel closes late."""
    if not is_listed(entry):
        return False
    time.sleep(CLOSING_SECONDS)
    return is_listed(entry)


def is_listed(entry: Entry) -> bool:
    """Whether the kernel of an entry listens, checked once: for a kernel that is ending, this may be wrong."""
    if not entry.path:
        return False
    said = {(one.address, one.epoch) for one in _read(Path(entry.path).with_suffix(".json")) or ()}
    return (entry.address, entry.epoch) in said and not _is_dead(entry.path)


def _read(file: Path) -> tuple[Entry, ...] | None:
    """The kernels that a file lists for the socket next to it, one or several; None: it is missing or malformed."""
    path = str(file.with_suffix(".sock"))
    try:
        with file.open("rb") as opened:
            data = json.loads(opened.read(_LARGEST_FILE))
        pid = int(data["pid"])
        if "carried" in data:
            return tuple(Entry(str(one), pid, str(epoch), path, carried=True) for one, epoch in data["carried"])
        return (Entry(str(data["address"]), pid, str(data["epoch"]), path),)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _is_dead(path: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(path)
        except OSError as error:
            return error.errno in (errno.ECONNREFUSED, errno.ENOENT)
    return False


def _remove(path: str) -> None:
    for suffix in _SUFFIXES:
        with contextlib.suppress(OSError):
            os.unlink(Path(path).with_suffix(suffix))


@contextlib.contextmanager
def _locked(folder: Path, waits: tuple[float, ...] = (0.001, 0.01, 0.1, 0.5, 0.5, 0.0)) -> Iterator[None]:
    """Lock the folder: one process at a time adds or removes entries. ControlError: another one keeps the lock."""
    try:
        import fcntl  # late: not every system has it
    except ImportError:
        yield  # without a lock: of two kernels that start at once with one name, one may take the other's entry
        return
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        for wait in waits:
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if not wait:
                    raise ControlError(f"{folder}: another process holds it; has one of yours been stopped?") from None
                time.sleep(wait)
        yield
    finally:
        os.close(opened)


class Claim:
    """An entry of this process: a listening socket under an address, until the entry is withdrawn and closed.

    Args:
        folder: the folder of the entry; the user's own by default.

    Raises:
        ControlError: the folder is not safe, the address is taken (the text names the owner), or the path of the socket
            is too long.
        OSError: the socket cannot be made.
    """

    def __init__(self, address: str, epoch: str, folder: Path | None = None) -> None:
        if folder is None:
            folder = private_folder()
        name = hashlib.sha256(address.encode()).hexdigest()[:16]
        path = _socket_path(folder, name)
        file = folder / f"{name}.json"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with _locked(folder):
                if os.path.lexists(path) and not _is_dead(path):
                    holder = _read(file)
                    who = f"process {holder[0].pid}" if holder else "another process"
                    raise TakenError(f"{address}: is held by {who}; give another --name, or end that process")
                _remove(path)
                try:
                    listener.bind(path)
                    listener.listen(128)
                    _write(file, {"address": address, "pid": os.getpid(), "started": _started(), "epoch": epoch})
                except BaseException:
                    _remove(path)
                    raise
        except BaseException:
            listener.close()
            raise
        self.entry = Entry(address, os.getpid(), epoch, path)
        self.listener = listener
        self._pid = os.getpid()

    def withdraw(self) -> None:
        """Remove the entry; a child that was forked leaves it alone."""
        if os.getpid() == self._pid:
            _remove(self.entry.path)


class Carrier:
    """The entries of the kernels to which one socket of this process carries sessions.

    Args:
        folder: a folder for this carrier alone, of this user alone.

    Raises:
        ControlError: the path of the socket is too long.
    """

    def __init__(self, folder: Path) -> None:
        self.path = _socket_path(folder, "carrier")
        """The path of the socket, which the owner of the carrier opens."""

    def write(self, kernels: Iterable[tuple[str, str]]) -> None:
        """Replace the list of kernels that can be reached, by address and epoch. The socket has to listen already."""
        _write(Path(self.path).with_suffix(".json"), {"pid": os.getpid(), "carried": list(kernels)})


def remove_left(prefix: str) -> None:
    """Remove this user's temporary folders of that prefix that killed carriers have left."""
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with contextlib.suppress(OSError, ControlError):
            check(folder)
            path = _socket_path(folder, "carrier")
            if Path(path).with_suffix(".json").exists() and _is_dead(path):
                _remove(path)
                folder.rmdir()


def _socket_path(folder: Path, name: str) -> str:
    path = str(folder / f"{name}.sock")
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ControlError(f"{path}: longer than {LONGEST_PATH} bytes; set XDG_RUNTIME_DIR to a shorter path")
    return path


class TakenError(ControlError, ConfigurationError):
    """Another process has this address, which has to be unique."""


def _write(file: Path, data: dict[str, object]) -> None:
    """Write the file as a whole: a reader sees all of it or nothing."""
    part = file.with_suffix(".part")
    part.write_text(json.dumps(data), encoding="utf-8")
    os.replace(part, file)


def _started() -> int:
    """The start time of this process, in ticks since the machine started; 0 where the system does not tell."""
    try:
        after_name = Path("/proc/self/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2]
        return int(after_name.split()[19])
    except (OSError, ValueError, IndexError):
        return 0
