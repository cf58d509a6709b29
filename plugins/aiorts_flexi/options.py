"""Command-line options as data: which flag sets which parameter; it parses nothing and knows no command line.

`aiorts` builds its commands from these tables. What stands there first, short and long, is what the originals had.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

__all__ = ("KINDS", "TYPE_MODULES", "VERBOSITY", "Option")

KINDS: Final = ("text", "number", "flag", "repeat")


@dataclass(frozen=True, slots=True)
class Option:
    """One option.

    flags: as they are typed, "-i", "--inputport".
    param: the parameter it sets; "" is for the command line itself, which does what `help` says.
    kind: "text" and "number" take one value, "repeat" collects the values of all its uses into a tuple, a "flag" takes
        none and sets `value`.
    help: one line for people.
    required: whether the component is nothing without it.
    action: for a flag without parameter: a class method of the component that takes the parameters by name and gives
        the text to print; nothing is run then.
    bare: what it stands for without a value; "" is that it has to have one.
    unless: the flag of another option with which it is not required; "" is that `required` says it all.
    words: words that stand for a value of the parameter, which has no text for it.
    """

    flags: tuple[str, ...]
    param: str
    kind: str
    help: str
    value: object = True
    required: bool = False
    action: str = ""
    bare: str = ""
    unless: str = ""
    words: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in KINDS or not self.flags:
            raise ValueError(f"{self.flags}: expected flags and a kind of {', '.join(KINDS)}, got {self.kind!r}")


VERBOSITY: Final = Option(("-v", "--verbosity"), "verbosity", "number", "how much is logged: 0, 1 ports, 2 values")
TYPE_MODULES: Final = Option(("--type-mod",), "", "text", "modules that define record types, separated by commas")
