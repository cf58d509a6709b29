"""Writes files whole or not at all: under another name next to the target, renamed when they are complete.

An interruption, such as Ctrl-C, leaves neither half a file nor a changed one.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from aiorts_log.errors import RecordingError, UnwrittenError


def check_target(target: Path, sources: Iterable[Path], overwrite: bool) -> None:
    """Refuse a target that cannot be written, before any work is done.

    Raises:
        RecordingError: the target is a source, exists and is not to be replaced, is no file, or has no folder.
    """
    for source in sources:
        with contextlib.suppress(OSError):
            if target.samefile(source):
                raise RecordingError(f"{target}: is the recording that is read; name another file")
    if target.is_symlink() or target.exists():
        if not overwrite:
            raise RecordingError(f"{target}: exists already; --overwrite replaces it, or name another file")
        if not target.is_file():
            raise RecordingError(f"{target}: is no regular file and is not replaced; name another file")
    if not target.absolute().parent.is_dir():
        raise RecordingError(f"{target}: there is no folder {target.parent}; make it first")


@contextlib.contextmanager
def whole_file(target: Path, sources: Iterable[Path] = (), overwrite: bool = False) -> Iterator[Path]:
    """Give the name to write to, and rename that file to `target` when the block ends without an error.

    Raises:
        RecordingError: as `check_target`; or it could not be written.
    """
    check_target(target, sources, overwrite)
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with contextlib.suppress(FileNotFoundError):
            part.unlink()
        yield part
        if overwrite:
            sync(part)  # the old file is given up: the new one has to be on the disk
        _rename(part, target, overwrite)
    except OSError as error:
        raise UnwrittenError(f"{target}: cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


@contextlib.contextmanager
def whole_folder(target: Path, sources: Iterable[Path] = ()) -> Iterator[Path]:
    """Give the name of a folder to fill, and rename it to `target` as `whole_file` does; no folder is ever replaced."""
    if target.is_symlink() or target.exists():
        raise RecordingError(f"{target}: exists already, and a folder is not replaced; name another one")
    check_target(target, sources, overwrite=False)
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        part.mkdir()
        yield part
        part.rename(target)
    except OSError as error:
        raise UnwrittenError(f"{target}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def sync(path: Path) -> None:
    """Wait until what is in a file or folder is on the disk. OSError when it may not be."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _rename(part: Path, target: Path, overwrite: bool) -> None:
    if overwrite:
        part.replace(target)
        return
    try:
        os.link(part, target)  # refused when something exists by now, which a rename would replace
    except FileExistsError:
        raise RecordingError(f"{target}: exists by now; --overwrite replaces it, or name another file") from None
    except OSError:
        part.rename(target)  # a file system without links
