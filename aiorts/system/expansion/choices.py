"""What a command line says of a system file besides its parameters."""

from __future__ import annotations

from typing import Final

from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Choices:
    """Variables as "name=value", and ports that others take the place of as "a.out=b.out"."""

    variables: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()


AS_WRITTEN: Final = Choices()
"""Nothing is chosen: the file is read as it stands."""
