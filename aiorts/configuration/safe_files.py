"""Reads small text files with a limit, and replaces them whole: a reader gets the old text or the new, never a part."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

from aiorts.errors import ConfigurationError


def read_text(path: Path, largest: int) -> str:
    """The text of a regular file of at most `largest` bytes of UTF-8; ConfigurationError otherwise."""
    try:
        # Opening a pipe without a writer would block a thread, which the interpreter's exit would then wait for.
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ConfigurationError(f"{path}: is not a regular file; give the name of one")
            raw = file.read(largest + 1)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(raw) > largest:
        raise ConfigurationError(f"{path}: larger than {largest} bytes")
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigurationError(f"{path}:{line}: not UTF-8: {error.reason}") from None


def replace_text(path: Path, text: str, *, overwrite: bool = True) -> None:
    """Replace the file by `text`, which is on the disk before it gets the name.

    Raises:
        ConfigurationError: it could not be written, or there is a file and `overwrite` is false; the old file is
            unchanged.
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
            if overwrite:
                os.replace(draft, target)
            else:
                _name(draft, target)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink()
            raise
        _sync_folder(target.parent)
    except FileExistsError:
        raise ConfigurationError(
            f"{path}: is there already; say that it is to be overwritten, or name another"
        ) from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror or error}") from error


def _name(draft: Path, target: Path) -> None:
    """Give a file a name that no other has; FileExistsError otherwise."""
    try:
        os.link(draft, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if target.exists():
            raise FileExistsError(target) from None
        os.replace(draft, target)
    else:
        draft.unlink()


def _sync_folder(folder: Path) -> None:
    """Make the new name survive a power cut, where the file system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
