"""The files that a client may have the kernel open: one question, asked of each path that a client gives.

The program, the system file and clients with the right `code` name any file. The call of any other client runs with a
`FileAccess`, also what it has done between two cycles. Hooks run without one: a component names what it likes.
"""

from __future__ import annotations

import contextvars
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, TypeVar

from aiorts.errors import DeniedError
from aiorts.late import dataclass
from aiorts.model.configuration.sets import same
from aiorts.model.values import leaves

if TYPE_CHECKING:
    from pathlib import Path

    from aiorts.model.configuration.sets import ConfigurationState

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class FileAccess:
    """The files that a client may name: those below one folder.

    Attributes:
        folder: without `..` and symbolic links; None: there is no such file.
    """

    folder: Path | None

    def check(self, where: str, path: str | os.PathLike[str]) -> None:
        """Raise DeniedError unless the path, its symbolic links and `..` followed, lies below the folder."""
        if self.folder is None:
            raise DeniedError(
                f"{where}: names a file, which needs the right 'code': this run has no folder for the files of other "
                "clients (aiorts run --files DIR)"
            )
        try:
            real = os.path.realpath(os.fsdecode(path))
        except ValueError as error:
            raise DeniedError(f"{where}: is no path: {error}") from None
        if os.path.commonpath((real, self.folder)) != str(self.folder):
            raise DeniedError(
                f"{where}: names a file outside of {self.folder}, which needs the right 'code'; give the whole path of "
                "one below that folder"
            )


_access: Final[contextvars.ContextVar[FileAccess | None]] = contextvars.ContextVar("aiorts file access", default=None)
"""The files that the client of the call under way may name; None: no client's call, or one that names any file."""


@contextmanager
def acting(access: FileAccess | None) -> Iterator[None]:
    """Run the block on behalf of a client that may name these files; None: on behalf of the kernel."""
    token = _access.set(access)
    try:
        yield
    finally:
        _access.reset(token)


def carried(change: Callable[[], T]) -> Callable[[], T]:
    """The change as a function that runs on behalf of the caller's client, wherever it is called."""
    access = _access.get()
    if access is None:
        return change

    def change_for_client() -> T:
        with acting(access):
            return change()

    return change_for_client


def own_context() -> contextvars.Context | None:
    """The context variables for a task that acts for the kernel; None: the caller acts for the kernel itself."""
    if _access.get() is None:
        return None
    context = contextvars.copy_context()
    context.run(_access.set, None)
    return context


def check_file(where: str, path: str | os.PathLike[str]) -> None:
    """Raise DeniedError when the client whose call runs may not name this file."""
    access = _access.get()
    if access is not None:
        access.check(where, path)


def check_files(owner: str, new: ConfigurationState, before: ConfigurationState | None) -> None:
    """Raise DeniedError when a configuration names a file that the client whose call runs may not name.

    Args:
        before: the former configuration, whose files `new` may name again; None: the component is new, and files
            that it writes by default are checked, too.
    """
    access = _access.get()
    if access is None:
        return
    for name, spec in new.specs.items():
        if not (kind := spec.names_file):
            continue
        if before is None:
            known = [spec.default] if kind == "read" else []
        else:
            known = [values[name] for values in before.sets.values() if name in values]
        for values in new.sets.values():
            if name not in values or any(same(values[name], one) for one in known):
                continue
            for path in leaves(values[name]):
                if isinstance(path, str | os.PathLike) and path != "":
                    access.check(f"{owner}.{name}", path)
