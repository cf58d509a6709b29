"""Finds the await that is missing: a coroutine that a component made and did not await did nothing."""

from __future__ import annotations

import contextlib
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Final

from aiorts.kernel.component import Component
from aiorts.kernel.loop.origins import place

_NEVER_AWAITED: Final = re.compile(r"coroutine '(.+)' was never awaited")
_FRAMES: Final = 20


@contextlib.contextmanager
def unawaited_told(tell: Callable[[str, Component | None], bool]) -> Iterator[None]:
    """Inside the `with`, report each coroutine that was never awaited in a line with hook, line number and remedy.

    Args:
        tell: gets the line, and the component whose method made the coroutine, if that is known; if it returns False,
            Python warns as usual.
    """
    before = warnings.showwarning

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        found = _NEVER_AWAITED.search(str(message))
        if found is None or not issubclass(category, RuntimeWarning) or not tell(*_told(found[1], filename, lineno)):
            before(message, category, filename, lineno, file, line)

    warnings.showwarning = show
    try:
        yield
    finally:
        if warnings.showwarning is show:
            warnings.showwarning = before


def _told(what: str, filename: str, lineno: int) -> tuple[str, Component | None]:
    owner, method = _running_at(filename, lineno)
    where = "" if owner is None else f"{owner.name}.{method}: "
    instead = "use write_nowait, or async def and await" if what.endswith(".write") else "use async def and await"
    return f"{where}{place(filename, lineno)}: {what} was never awaited and did nothing; {instead}", owner


def _running_at(filename: str, lineno: int) -> tuple[Component | None, str]:
    """Component and method that run this line now, as far as they are known."""
    for frame, line in islice(traceback.walk_stack(sys._getframe(1)), _FRAMES):
        if frame.f_code.co_filename == filename and line == lineno:
            owner = frame.f_locals.get("self")
            return (owner if isinstance(owner, Component) else None), frame.f_code.co_name
    return None, ""
