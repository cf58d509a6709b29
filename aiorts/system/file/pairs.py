"""The rule that two ports are connected once, unless the later connection has `allow_duplicate`. Pure.

The parser of system files (`system/file/parse.py`) and the maker of `Wanted` (`system/wanting.py`) use it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.errors import WiringError

if TYPE_CHECKING:
    from aiorts.model.options import PortLimits


class ConnectedPairs:
    """The pairs of ports that are joined, and the number of each pair's connection."""

    def __init__(self) -> None:
        self._pairs: dict[frozenset[str], int] = {}

    def fault(self, one: str, other: str, number: int, limits: PortLimits | None) -> WiringError | None:
        """Join two ports by the connection of this number; returns why they must not be joined, or None.

        Args:
            limits: the options of the connection that concern ports; None if they are wrong.
        """
        pair = frozenset((one, other))
        first = self._pairs.get(pair)
        if first is None:
            self._pairs[pair] = number
            return None
        if limits is not None and limits.allow_duplicate:
            return None
        return WiringError(f"{one} and {other} are connected already, by connections[{first}]; take one of them away")
