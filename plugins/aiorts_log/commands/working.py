"""The base of commands that write files: a signal ends them in order, a failed write is one line and exit status 1."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, Final, TypeAlias

import click

from aiorts import exits
from aiorts_log.errors import UnwrittenError

Handler: TypeAlias = Callable[[int, FrameType | None], None]
_SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")


class WritingCommand(click.Command):
    """A command that leaves no half-written file, however it ends."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; returns the exit status."""
        try:
            with signals_to(_end):
                return super().invoke(ctx)
        except UnwrittenError as error:
            click.echo(f"aiorts: {error.code}: {error}", err=True)
            return exits.FAILED


@contextlib.contextmanager
def signals_to(handler: Handler) -> Iterator[None]:
    """Let signals that end a process call `handler` in this block instead."""
    before = {}
    for number in (signal.Signals[name] for name in _SIGNALS if name in signal.Signals.__members__):
        if signal.getsignal(number) is not signal.SIG_IGN:  # ignored, as in the background of a shell script
            with contextlib.suppress(ValueError):  # not the main thread, which has the signals
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, was in before.items():
            signal.signal(number, was)


def _end(number: int, frame: FrameType | None) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(exits.of_signal(number))
