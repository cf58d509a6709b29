"""Change the systems of several kernels to those of files, all or none.

Each kernel changes its own system, whole or not at all, and waits. When all have changed, all are asked to keep the
change; a kernel that is not asked undoes its change by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from aiorts.errors import AiortsError, ClosedError, NoAnswerError
from aiorts.late import dataclass
from aiorts.sessions.client import Client
from aiorts.sessions.target import Running

Parts = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a change of several kernels.

    Attributes:
        kept: the steps of each kernel that has its wanted system now.
        failed: the kernel that did not change, or did not answer; "" where all changed.
        why: the text of its error.
        unsure: the kernels whose outcome is not known; each keeps its change or takes it back, whole.
    """

    kept: Mapping[str, Sequence[Mapping[str, Any]]]
    failed: str = ""
    why: str = ""
    unsure: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The outcome in one line."""
        if not self.failed:
            return "done"
        said = f"{self.failed}: {self.why.removeprefix(f'{self.failed}: ')}"
        unsure = f"; of {', '.join(self.unsure)} it is not known, aiorts plan says" if self.unsure else ""
        if not self.kept:
            return f"taken back: {said}{unsure}"
        steps = "; ".join(f"{name} ({len(steps)} steps)" for name, steps in self.kept.items())
        return f"partly applied: kept in {steps}; {said}{unsure}"


def change_all(wanted: Sequence[tuple[Running, Parts]], timeout: float) -> Outcome:
    """Change all kernels in order; when one fails, the earlier changes are taken back, the last first."""
    changed: list[tuple[Running, Sequence[Mapping[str, Any]]]] = []
    for one, parts in wanted:
        try:
            changed.append((one, one.client.call("change", timeout, wanted=parts)["steps"]))
        except AiortsError as error:
            unsure = (one.name,) if isinstance(error, ClosedError | NoAnswerError) else ()
            unsure += tuple(other.name for other, steps in reversed(changed) if not _taken_back(other.client, steps))
            return Outcome({}, one.name, str(error), unsure)
    kept: dict[str, Sequence[Mapping[str, Any]]] = {}
    failed, why, unsure = "", "", ()
    for place, (one, steps) in enumerate(changed):
        try:
            said = one.client.call("decide", timeout, keep=True) if steps else {"done": True}
        except AiortsError as error:
            failed, why, unsure = one.name, str(error), (*unsure, one.name)
        else:
            if said["done"]:
                kept[one.name] = steps
                continue
            failed, why = one.name, str(said["rolled_back"])
        if not any(kept.values()):  # no change is kept yet, so the remaining ones can be taken back
            rest = [other.name for other, its in reversed(changed[place + 1 :]) if not _taken_back(other.client, its)]
            return Outcome({}, failed, why, (*unsure, *rest))
    return Outcome(kept, failed, why, unsure)


def _taken_back(client: Client, steps: Sequence[Mapping[str, Any]]) -> bool:
    """Take a change back; returns whether the kernel confirmed it, or had nothing to change."""
    with suppress(AiortsError):
        return not steps or not client.call("decide", keep=False)["done"]
    return False
