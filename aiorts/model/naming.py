"""The name of a new instance when none is given: reads the pattern and makes names; it does not reserve them.

A pattern is text with fields: {type} the type's name in lower case, {number} the lowest number that makes a name nobody
has, {kernel}, {host} and {pid}. Nothing else in it means anything: no environment variable is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.names import ALLOWED, check_name

FIELDS: Final = ("type", "number", "kernel", "host", "pid")
_FIELD: Final = re.compile(r"\{([^{}]*)\}")
_REFUSED: Final = re.compile(r"[^A-Za-z0-9_-]")


@dataclass(frozen=True, slots=True)
class NamePolicy:
    """How instances without a name are named; put in force by `Kernel.naming`.

    Args:
        pattern: fields in braces and the characters of names; {number} must be in it once. "{type}{number}" gives
            "pid0", "pid1".
        scope: whose names count as taken: "kernel", or "process": those of all open kernels of this process, as in
            OpenRTM, where a name says which instance it is in every log of the process.
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
        """Whether it is the one that every kernel has from the beginning."""
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
