"""The version of the protocol that two kernels speak with each other: the highest that both speak.

A later version may add fields at the end of messages: a kernel that does not know them reads the others.
"""

from __future__ import annotations

from typing import Final

from aiorts.errors import WiringError

SPOKEN: Final = (1, 1)
"""The lowest and the highest version that this kernel speaks."""


def agreed(peer: str, theirs: tuple[int, int]) -> int:
    """The version to speak with a kernel that speaks these.

    Raises:
        WiringError: there is no such version.
    """
    highest = min(theirs[1], SPOKEN[1])
    if highest < max(theirs[0], SPOKEN[0]):
        raise WiringError(f"versions of links differ: {peer} speaks {_range(theirs)}, this speaks {_range(SPOKEN)}")
    return highest


def _range(versions: tuple[int, int]) -> str:
    low, high = versions
    return str(low) if low == high else f"{low}-{high}"
