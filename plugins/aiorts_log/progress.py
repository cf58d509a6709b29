"""A bar for long work: on a terminal's standard error alone, nothing anywhere else."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

import click

__all__ = ("Step", "progress")

Step = Callable[[int], None]
"""Called with how much was done since the last call."""


@contextlib.contextmanager
def progress(label: str, total: int) -> Iterator[Step]:
    """What to call now and then with how much of `total` was done since."""
    if total <= 0 or sys.stderr is None or not sys.stderr.isatty():
        yield lambda done: None
        return
    with click.progressbar(length=total, label=label, file=sys.stderr) as bar:
        yield bar.update
