"""Describes command-line options as data: flags, and the parameters that they set.

`aiorts` builds its commands from these tables. The first flags, short and long, are those of the original components.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Final

from aiorts.late import dataclass

KINDS: Final = ("text", "number", "flag", "repeat")


@dataclass(frozen=True, slots=True)
class Option:
    """A command-line option.

    Attributes:
        flags: the flags as they are typed, "-i", "--inputport".
        param: the parameter that it sets; "" when the command line itself handles the option, as `help` describes.
        kind: "text" and "number" take one value, "repeat" collects the values of all its uses into a tuple, a "flag"
            takes
            none and sets `value`.
        help: one line for users.
        required: whether the component cannot be created without it.
        action: for a flag without parameter: a class method of the component that takes the parameters by name and
            gives
            the text to print, instead of a run.
        bare: the value when the option is given without a value; "" when it needs one.
        unless: the flag of another option that makes this one not required; "" for none.
        words: words for values that the parameter's own text cannot express.
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
