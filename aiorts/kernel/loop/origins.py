"""Finds the line of the user's own code that an exception came from, for messages without a traceback.

An exception is the application's own, so that nothing here may fail however it behaves.
"""

from __future__ import annotations

import contextlib
import os
from functools import lru_cache
from typing import Final

from aiorts.errors import AiortsError, format_error
from aiorts.kernel.loop.exceptions import trace_of

_OWN: Final = os.path.abspath(f"{__file__}/../../..") + os.sep
_DELIVERED: Final = os.path.join(os.path.dirname(_OWN[:-1]), "plugins", "aiorts_")
"""The beginning of the paths of aiorts' own plugins, when it runs from its sources."""
_STANDARD: Final = os.path.dirname(os.path.abspath(os.__file__)) + os.sep
_INSTALLED: Final = (f"{os.sep}site-packages{os.sep}", f"{os.sep}dist-packages{os.sep}")
_TYPED: Final = ("<stdin", "<ipython", "<python-input", "<console")
"""How names of what is typed at a prompt begin."""
_FRAMES: Final = 5_000


def is_own(file: str) -> bool:
    """Whether the file is one of aiorts itself."""
    return file.startswith(_OWN)


@lru_cache(maxsize=512)
def is_foreign(file: str) -> bool:
    """Whether a line of the file means nothing to the user: aiorts, the standard library, packages, generated code."""
    if file.startswith("<"):
        return not file.startswith(_TYPED)
    return file.startswith((_OWN, _STANDARD)) or is_installed(file)


def is_installed(file: str) -> bool:
    """Whether the file is one of an installed package, or of a plugin that comes with aiorts."""
    return file.startswith(_DELIVERED) or any(part in file for part in _INSTALLED)


def origin_of(error: BaseException, *, installed: bool = False) -> str:
    """`file:line` of the user's innermost frame that the exception came through, "" without one.

    Where a record's `__post_init__` refuses it, the line that makes the record comes first: `a.py:9, raised in b.py:3`.

    Args:
        installed: where there is none, take the innermost frame in the file of the first installed package, which is
            the component's own; what such a package refuses by an error of aiorts explains itself.
    """
    try:
        return _origin(error, installed=installed and not issubclass(type(error), AiortsError))
    except BaseException:  # noqa: BLE001 - the border of an exception that is a user's own
        return ""


def located(error: BaseException) -> str:
    """`Class: text (file:line)` of what a component's code raised."""
    return f"{format_error(error)}{in_brackets(origin_of(error, installed=True))}"


def in_brackets(origin: str) -> str:
    """The origin as it stands behind a text."""
    return f" ({origin})" if origin else ""


def _origin(error: BaseException, *, installed: bool) -> str:
    users: tuple[str, int] | None = None
    maker: tuple[str, int] | None = None
    packages: tuple[str, int] | None = None
    trace, left = trace_of(error), _FRAMES
    while trace is not None and left:
        file = trace.tb_frame.f_code.co_filename
        if not is_foreign(file):
            if trace.tb_frame.f_code.co_name == "__post_init__" and maker is None:
                maker = users
            users = file, trace.tb_lineno
        elif is_installed(file) and (packages is None or packages[0] == file):
            packages = file, trace.tb_lineno
        trace, left = trace.tb_next, left - 1
    found = users or (packages if installed else None)
    raised = "" if found is None else place(*found)
    return raised if maker is None else f"{place(*maker)}, raised in {raised}"


def place(file: str, line: int | None) -> str:
    """`file:line`, the one form of a place in Python; the file as named from the current folder, if it lies in it."""
    with contextlib.suppress(OSError):  # the folder was deleted
        file = file.removeprefix(os.path.join(os.getcwd(), ""))
    return file if line is None else f"{file}:{line}"
