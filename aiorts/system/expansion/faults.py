"""The faults that stop an expansion, and the bounds of its size."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from aiorts.errors import SystemFileError
from aiorts.system.text.origins import Origin, Source
from aiorts.system.text.reading import Mistake, spelled
from aiorts.system.text.toml import LARGEST

_DEEPEST: Final = 32
"""The most levels of lists and tables in one value, the same as in a file."""
_MOST: Final = 200
"""The most mistakes that are named at once."""


class Fault(SystemFileError):
    """A mistake, and the key in a file that the mistake is about."""

    def __init__(self, origin: Origin, what: str, *, of_key: bool = False) -> None:
        super().__init__(what)
        self.origin, self.what, self.of_key = origin, what, of_key


class Excess(Fault):
    """Too much of something, such as files or text: expansion stops."""


class Typed(Fault):
    """A fault of the command line, in no file."""

    def __init__(self, where: str, what: str) -> None:
        super().__init__(Origin(Source(Path(), ""), ()), what)
        self.where = where


class Budget:
    """The size by which the expanded system may still grow; every character of a text and every value counts."""

    def __init__(self) -> None:
        self._left = LARGEST

    def spend(self, count: int, origin: Origin) -> None:
        """Subtract `count`; raise an Excess at `origin` if more is spent than was left."""
        self._left -= count
        if self._left < 0:
            what = f"the whole system, with all that is included and repeated, has more than {LARGEST} characters"
            raise Excess(origin, f"{what}; repeat or include less", of_key=True)


def weight(value: Any, origin: Origin, depth: int = 0) -> int:
    """The size of a value: at most the number of characters by which a file writes it."""
    if isinstance(value, str):
        return len(value) + 1
    if isinstance(value, list | dict):
        if depth >= _DEEPEST:
            raise Fault(origin, f"nested deeper than {_DEEPEST} levels; variables hold lists that hold lists")
        items = value.values() if isinstance(value, dict) else value
        inner = sum(weight(item, origin, depth + 1) for item in items)
        return inner + 1 + (sum(len(key) for key in value) if isinstance(value, dict) else 0)
    return 1


class Mistakes:
    """Collects the mistakes of an expansion, which goes on after each, so that all mistakes are named at once."""

    def __init__(self) -> None:
        self.found: list[Mistake] = []

    @contextmanager
    def kept(self, kind: type[Fault] = Fault) -> Iterator[None]:
        """Collect a fault that the body raises, and go on; an Excess is raised on, unless `kind` is Excess."""
        try:
            yield
        except Fault as fault:
            if isinstance(fault, Excess) and kind is not Excess:
                raise
            self.say(fault)
            if len(self.found) >= _MOST and kind is not Excess:
                raise Excess(fault.origin, "") from None

    def say(self, fault: Fault) -> None:
        if isinstance(fault, Typed):
            self.typed(fault.where, fault.what)
        elif len(self.found) < _MOST:
            key = fault.origin.key
            self.found.append(Mistake(key, spelled(key) or "file", fault.what, fault.of_key, fault.origin))

    def typed(self, where: str, what: str) -> None:
        """Collect a mistake of the command line."""
        self.found.append(Mistake((), where, what))
