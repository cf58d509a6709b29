"""Log lines of a real-time thread: the record is made there and handed over to the loop, where handlers do I/O."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from aiorts.kernel.loop.guarded import guarded, line_of


class HandedLogger(logging.Logger):
    """`real`, with its handlers run by `on_loop`: on the kernel's loop, at once when that is the caller's thread."""

    def __init__(self, real: logging.Logger, on_loop: Callable[[Callable[[], object]], None]) -> None:
        super().__init__(real.name)
        self.real = real
        self._on_loop = on_loop

    def isEnabledFor(self, level: int) -> bool:  # noqa: N802 - the name of the base class
        return self.real.isEnabledFor(level)

    def handle(self, record: logging.LogRecord) -> None:
        # Rendered now, as a QueueHandler does: what the arguments are later is not what was meant.
        with suppress(TypeError, ValueError, KeyError):  # the handler reports a bad template, as for every logger
            record.msg, record.args = record.getMessage(), None
        what = f"could not log {line_of(record.msg, ())!r}"
        self._on_loop(partial(guarded, what, self.real.handle, record))
