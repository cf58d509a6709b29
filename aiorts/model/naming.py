"""Names of new instances for which none is given: reads the pattern and makes names; it does not reserve them.

The number of a name is the lowest that is free for its stem. Ten thousand "event0", "event1", ... must not be
counted through for each new name, and a number that became free is used again. So all numbers below `_Stem.top` are in
use or stand in a heap of those that were given up.

A pattern is text with fields: {type} the type's name in lower case, {number} the lowest number that makes a free
name, {kernel}, {host} and {pid}. Nothing else in a pattern has a meaning: no environment variable is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from heapq import heappop, heappush
from typing import Final

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.names import ALLOWED, check_name

FIELDS: Final = ("type", "number", "kernel", "host", "pid")
_FIELD: Final = re.compile(r"\{([^{}]*)\}")
_REFUSED: Final = re.compile(r"[^A-Za-z0-9_-]")


@dataclass(frozen=True, slots=True)
class NamePolicy:
    """The rule that names instances without a name; put in force by `Kernel.naming`.

    Args:
        pattern: fields in braces and the characters of names; {number} must be in it once. "{type}{number}" gives
            "pid0", "pid1".
        scope: the names that count as taken: those of the "kernel", or of all open kernels of the "process", as in
            OpenRTM, where a name identifies its instance in every log of the process.
        first: the lowest number.

    Raises:
        ConfigurationError: names the part of the pattern that is wrong.
    """

    pattern: str = "{type}{number}"
    scope: str = "kernel"
    first: int = 0

    def __post_init__(self) -> None:
        fields = _FIELD.findall(self.pattern)
        for name in fields:
            if name not in FIELDS:
                raise ConfigurationError(
                    f"pattern {self.pattern!r}: no field {{{name}}}; there are {', '.join(FIELDS)}"
                )
        if fields.count("number") != 1:
            raise ConfigurationError(f"pattern {self.pattern!r}: expected {{number}} once")
        text = _FIELD.sub("", self.pattern)
        if wrong := _REFUSED.findall(text):
            hint = "; environment variables are not read" if "$" in wrong else ""
            raise ConfigurationError(
                f"pattern {self.pattern!r}: {wrong[0]!r} cannot be in a name{hint}; allowed: {ALLOWED}"
            )
        if self.scope not in ("kernel", "process"):
            raise ConfigurationError(f'scope = {self.scope!r}: expected "kernel" or "process"')
        if isinstance(self.first, bool) or not isinstance(self.first, int) or self.first < 0:
            raise ConfigurationError(f"first = {self.first!r}: expected a whole number from 0 on")

    @property
    def plain(self) -> bool:
        """Whether this is the policy that every kernel has from the beginning."""
        return (self.pattern, self.scope, self.first) == ("{type}{number}", "kernel", 0)

    def lowest(self, values: Mapping[str, object], taken: Callable[[str], bool]) -> str:
        """The name with the lowest number that is free; `values` are those of all fields but {number}.

        Raises:
            InvalidNameError: the name would be too long.
        """
        texts = {key: _REFUSED.sub("-", str(value)) for key, value in values.items()}
        before, after = (_FIELD.sub(lambda match: texts[match[1]], part) for part in self.pattern.split("{number}", 1))
        number = self.first
        while taken(name := f"{before}{number}{after}"):
            number += 1
        return check_name(name, "component")


class _Stem:
    """The numbers of one stem that are in use, and those that were given up."""

    __slots__ = ("first", "free", "heap", "top")

    def __init__(self, first: int) -> None:
        self.first = self.top = first
        self.free: set[int] = set()
        """Numbers below `top` that were given up; a name given in full may use some of them again."""
        self.heap: list[int] = []
        """The numbers of `free`, lowest first, and some numbers that have come into use since."""


class Numbering:
    """The lowest free number of each stem, in about constant time.

    `taken` says whether a name is in use; call `free` with each name that is given up.
    """

    __slots__ = ("_stems", "_taken")

    def __init__(self, taken: Callable[[str], bool]) -> None:
        self._taken = taken
        self._stems: dict[str, _Stem] = {}

    def lowest(self, stem: str, first: int = 0) -> str:
        """`stem` with the lowest number, from `first` on, that makes a free name."""
        numbers = self._stems.get(stem)
        if numbers is None:
            numbers = self._stems[stem] = _Stem(first)
        heap, free = numbers.heap, numbers.free
        while heap:
            name = f"{stem}{heap[0]}"
            if heap[0] in free and not self._taken(name):
                return name
            free.discard(heappop(heap))
        while self._taken(name := f"{stem}{numbers.top}"):
            numbers.top += 1
        return name

    def free(self, name: str) -> None:
        """Give a name up: its number may be used again."""
        digits = len(name) - len(name.rstrip("0123456789"))
        # "n10" is number 10 of "n" and number 0 of "n1".
        for count in range(1, digits + 1):
            text = name[-count:]
            if text[0] == "0" and count > 1:
                continue
            stem = name[:-count]
            numbers = self._stems.get(stem)
            if numbers is not None:
                self._give_up(stem, numbers, int(text))

    def _give_up(self, stem: str, numbers: _Stem, number: int) -> None:
        free = numbers.free
        if not numbers.first <= number < numbers.top or number in free:
            return
        if number < numbers.top - 1:
            heappush(numbers.heap, number)
            free.add(number)
            return
        numbers.top -= 1
        while numbers.top - 1 in free and not self._taken(f"{stem}{numbers.top - 1}"):
            numbers.top -= 1
            free.discard(numbers.top)
        if numbers.top == numbers.first:
            del self._stems[stem]
