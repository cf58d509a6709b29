"""Small text files, read with a limit and written whole: whoever looks finds the old text or the new, never a part."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

from aiorts.errors import ConfigurationError

__all__ = ("read_text", "replace_text")


def read_text(path: Path, largest: int) -> str:
    """The text of a regular file of at most `largest` bytes of UTF-8; ConfigurationError otherwise."""
    try:
        with open(path, "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ConfigurationError(f"{path}: is not a regular file")
            octets = file.read(largest + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(octets) > largest:
        raise ConfigurationError(f"{path}: larger than {largest} bytes")
    try:
        return octets.decode()
    except UnicodeDecodeError as error:
        line = octets.count(b"\n", 0, error.start) + 1
        raise ConfigurationError(f"{path}, line {line}: not UTF-8: {error.reason}") from None


def replace_text(path: Path, text: str) -> None:
    """Put `text` in the place of the file: it is on the disk before its name is.

    Raises:
        ConfigurationError: it could not be written; what was there is as it was.
    """
    # A link stays a link: what it names is replaced.
    target = Path(os.path.realpath(path))
    draft = target.with_name(f".{target.name}.{os.getpid()}.{os.urandom(6).hex()}")
    try:
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            with open(descriptor, "wb") as file:
                with contextlib.suppress(OSError):
                    os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
                file.write(text.encode())
                file.flush()
                os.fsync(file.fileno())
            os.replace(draft, target)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink()
            raise
        _sync_folder(target.parent)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror or error}") from error


def _sync_folder(folder: Path) -> None:
    """The new name survives a power cut; not every file system has that to offer."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
