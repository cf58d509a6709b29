"""A bar for long work, with the time that is left: on a terminal's standard error, and nowhere else."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TypeAlias

__all__ = ("Step", "progress")

Step: TypeAlias = Callable[[int], None]
"""Called with the amount of work done since the last call."""


@contextlib.contextmanager
def progress(label: str, total: int) -> Iterator[Step]:
    """Show a bar for `total` units of work while the block runs; nothing where standard error is no terminal."""
    if total <= 0 or sys.stderr is None or not sys.stderr.isatty():
        yield lambda done: None
        return
    import click  # late: a library that asks for no bar needs none

    with click.progressbar(length=total, label=label, file=sys.stderr) as bar:
        least, waiting = max(1, total // 200), 0

        def step(done: int) -> None:
            nonlocal waiting
            waiting += done
            if waiting >= least:  # to draw it takes longer than most steps do
                bar.update(waiting)
                waiting = 0

        yield step
        bar.update(waiting)
