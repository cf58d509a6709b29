"""The choices of a command line for a system file besides its parameters."""

from __future__ import annotations

from typing import Final

from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Choices:
    """Variables as "name=value", and replacements of ports as "a.out=b.out"."""

    variables: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()


AS_WRITTEN: Final = Choices()
"""No choices: the file is read as it stands."""
