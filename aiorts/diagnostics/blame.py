"""Judges what made a context late, from stack samples and the kernel's times of hooks. Pure.

The first of these is blamed: a garbage collection that took half of the delay; a process that did not run for half of
the delay; the code that was sampled longest; a hook with a long time in the kernel's statistics. Else the cause is
unknown. A sampled hook has the line that ran, a hook from the statistics the line at which it begins.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from aiorts.kernel.loop.origins import is_foreign, is_own
from aiorts.late import dataclass
from aiorts.model.blame import Blame

_UVLOOP: Final = f"{os.sep}uvloop{os.sep}"
_LOOP_FILES: Final = tuple(
    os.path.join("asyncio", name) for name in ("base_events.py", "events.py", "runners.py", "unix_events.py")
)


class Line(NamedTuple):
    """The place of a frame: a line, the function around it, and the line where that function begins."""

    file: str
    line: int
    function: str
    first: int = 0


class Glance(NamedTuple):
    """A sample of what ran at one moment of a delay."""

    at_ns: int
    ran: Blame | None
    """The code that ran, or in which the context waits; None for none."""
    waits: Blame | None = None
    """The context's own hook that waited."""
    absent_ns: int = 0
    """Nanoseconds before the sample in which no thread ran although one should have."""
    took: Entry | None = None
    """The statistics of what ran, as of that moment."""


class Entry(NamedTuple):
    """A hook in the kernel's statistics."""

    blame: Blame
    last_ns: int
    """The duration of its last run, or of the run that matters."""
    runs: int
    own: bool = False
    """Whether it is a hook of the late context."""
    max_ns: int = 0
    key: int = 0
    """Equal for all entries of one component in one context."""


@dataclass(frozen=True, slots=True)
class Pause:
    """One garbage collection."""

    began_ns: int
    ended_ns: int
    generation: int


def choose_line(lines: Sequence[Line], hook: Line | None) -> Line | None:
    """The user's innermost line among `lines` (innermost first), within the hook's frames if there is one.

    A line in the folder of the hook's own file is the user's, wherever it is installed.
    """
    home = None if hook is None else os.path.dirname(hook.file)
    if hook is not None:
        for index, line in enumerate(lines):
            if (line.file, line.first) == (hook.file, hook.first):
                lines = lines[: index + 1]
                break
    for line in lines:
        if os.path.dirname(line.file) == home or not is_foreign(line.file):
            return line
    if hook is not None:
        return hook
    return next((line for line in lines if not is_own(line.file)), None)


def cut_at_loop(lines: Sequence[Line], base: int) -> Sequence[Line]:
    """The frames that the event loop called (innermost first); `base` is the number of frames beneath a task's."""
    called = lines[: max(0, len(lines) - base)] if base else lines
    for index, line in enumerate(called):
        if line.file.endswith(_LOOP_FILES) or os.path.basename(line.file) == "selectors.py" or _UVLOOP in line.file:
            return called[:index]
    return called


def judge(
    since_ns: int,
    now_ns: int,
    glances: Sequence[Glance],
    pauses: Iterable[Pause],
    books: Sequence[Entry],
    absent_ns: int = 0,
) -> Blame:
    """The cause of a cycle that was due at `since_ns` and not begun until `now_ns`.

    `books` are the kernel's times of the hooks that ran in between, as far as known; `absent_ns` is the part of the
    delay in which no thread used the processor, 0 where that is unknown.
    """
    late = max(1, now_ns - since_ns)
    collected = [pause for pause in pauses if 2 * _overlap(pause, since_ns, now_ns) >= late]
    if collected:
        longest = max(collected, key=lambda pause: pause.ended_ns - pause.began_ns)
        return Blame("gc", held_ns=longest.ended_ns - longest.began_ns, generation=longest.generation)
    away = sum(glance.absent_ns for glance in glances)
    seen = _seen_longest(since_ns, now_ns, glances, books)
    # If the processor was taken away, the hook that ran then is blamed unless that explains nearly all of the delay.
    if 2 * away >= late and (seen is None or 4 * away >= 3 * late):
        return Blame("machine", held_ns=away)
    if seen is not None:
        return seen
    long = [entry for entry in books if 2 * entry.last_ns >= late]
    if long:
        worst = max(long, key=lambda entry: (entry.own, entry.last_ns))
        return replace(worst.blame, held_ns=worst.last_ns)
    if 2 * absent_ns >= late:
        return Blame("machine", held_ns=absent_ns)
    return Blame("unknown", held_ns=late)


def _overlap(pause: Pause, since_ns: int, now_ns: int) -> int:
    return min(pause.ended_ns, now_ns) - max(pause.began_ns, since_ns)


def _seen_longest(since_ns: int, now_ns: int, glances: Sequence[Glance], books: Sequence[Entry]) -> Blame | None:
    """The code that was sampled for the longest part of the delay; a sample counts from the one before to the next."""
    late = now_ns - since_ns
    weights: dict[Blame, int] = {}
    for index, glance in enumerate(glances):
        until = glances[index + 1].at_ns if index + 1 < len(glances) else now_ns
        blame, lasted = _held(glance, books)
        if lasted is not None and 2 * lasted < late and len(glances) == 1:
            # The sampled code ran only briefly; the context itself waited all the time.
            blame = glance.waits
        if blame is not None:
            since = since_ns if index == 0 else glance.at_ns
            weights[blame] = weights.get(blame, 0) + max(0, until - since)
    if not weights:
        return None
    worst = max(weights, key=lambda blame: weights[blame])
    return worst if worst.held_ns else replace(worst, held_ns=max(1, weights[worst]))


def _held(glance: Glance, books: Sequence[Entry]) -> tuple[Blame | None, int | None]:
    """The code that a sample blames, and how long it took if it has ended since."""
    if glance.ran is None:
        return glance.waits, None
    if glance.took is not None:
        for entry in books:
            # The kernel has the time of the last run only: with more than one since, it is not that of the sampled run.
            if (entry.key, entry.blame.hook, entry.runs - 1) == (glance.took.key, glance.ran.hook, glance.took.runs):
                return replace(glance.ran, held_ns=entry.last_ns), entry.last_ns
    return glance.ran, None
