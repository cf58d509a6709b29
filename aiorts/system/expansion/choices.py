"""The choices that a command line makes for a system file, except parameters."""

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
