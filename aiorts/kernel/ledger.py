"""What a connector counts: only samples written and drops by reason; what was delivered follows from them.

Of the samples that go the short way each is counted once for all direct connectors of an out-port, and each that a
full buffer displaces in one number: both are put in their place when somebody asks.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Push

if TYPE_CHECKING:
    from aiorts.kernel.out_port import OutPort

__all__ = ("Ledger",)

_NEW: Final = Push.NEW
_DISPLACED: Final = {FullPolicy.OVERWRITE: "overwritten", FullPolicy.REJECT: "rejected"}
_NOTHING: Final[Mapping[str, int]] = MappingProxyType({})


class Ledger:
    """The counts of one connector."""

    __slots__ = ("_displaced", "_dropped", "_full", "_listening", "_push", "_shared", "_written", "out")

    _full: FullPolicy
    _push: Push
    _listening: Any
    """Who listens (`listening.py`); not even set where nobody ever did."""

    def __init__(self, out: OutPort[Any]) -> None:
        self.out = out
        self._written = 0
        """Samples written, without those that the out-port counts for all of its direct connectors."""
        self._shared = False
        """Whether the out-port's count goes for this connector too."""
        self._displaced = 0
        """Samples that a full buffer displaced or refused and `_dropped` does not have yet."""
        self._dropped: Mapping[str, int] = _NOTHING

    def _total(self) -> int:
        return self._written + self.out._sent if self._shared else self._written

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        """Written, buffered, and dropped by reason, from any thread, without a lock and without counting anything.

        For a look into a process that is stuck; torn when the connector is being used at this moment. `statistics` is
        exact.
        """
        dropped = dict(self._dropped)
        if displaced := self._displaced:
            reason = "superseded" if self._push is _NEW else _DISPLACED[self._full]
            dropped[reason] = dropped.get(reason, 0) + displaced
        return self._total(), self._buffered, dropped

    @property
    def _buffered(self) -> int:
        raise NotImplementedError

    def share(self, shared: bool, sent: int) -> None:
        """From now on the out-port counts for this connector, or no longer: it has counted `sent`."""
        if shared is not self._shared:
            self._shared = shared
            self._written += -sent if shared else sent

    def _count_displaced(self) -> None:
        if displaced := self._displaced:
            reason = "superseded" if self._push is _NEW else _DISPLACED[self._full]
            self._displaced = 0
            self._note_drop(reason, displaced)

    def _drop(self, reason: str, count: int = 1) -> None:
        self._count_displaced()
        self._note_drop(reason, count)

    def _note_drop(self, reason: str, count: int) -> None:
        dropped = self._dropped
        if not isinstance(dropped, dict):
            dropped = self._dropped = {}
        dropped[reason] = dropped.get(reason, 0) + count
