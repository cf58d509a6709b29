"""The rule that two ports are connected once, unless the later connection says otherwise. Pure.

A file is read by it, checked by it, and made the system that is wanted by it.
"""

from __future__ import annotations

from aiorts.errors import WiringError


class Joined:
    """The pairs of ports that connections have joined, and the number of the connection of each."""

    def __init__(self) -> None:
        self._pairs: dict[frozenset[str], int] = {}

    def fault(self, one: str, other: str, number: int, *, allowed: bool) -> WiringError | None:
        """Join two ports by the connection of this number; why they must not be, or None.

        Args:
            allowed: whether its options say that there may be a second (`allow_duplicate`).
        """
        pair = frozenset((one, other))
        first = self._pairs.get(pair)
        if first is None:
            self._pairs[pair] = number
            return None
        if allowed:
            return None
        return WiringError(f"{one} and {other} are connected already, by connections[{first}]; take one of them away")
