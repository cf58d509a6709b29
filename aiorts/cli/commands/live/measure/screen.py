"""The whole terminal during a `with` block: the alternate screen, and keys as they are pressed.

The terminal is restored on every way out: at the end, with an error, Ctrl-C, SIGTERM, SIGHUP, and during a stop with
Ctrl-Z. The module uses the codes that all terminals of today share, since `curses` is not everywhere.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
from collections.abc import Sequence
from types import FrameType, TracebackType
from typing import Any, Final, Self

_ENTER: Final = "\x1b[?1049h\x1b[?25l\x1b[?7l"
"""The alternate screen, no cursor, long lines are cut."""
_LEAVE: Final = "\x1b[?7h\x1b[?25h\x1b[?1049l"
_KEYS: Final = {
    b"\x1b[A": "up",
    b"\x1bOA": "up",
    b"\x1b[B": "down",
    b"\x1bOB": "down",
    b"\x1b[5~": "page up",
    b"\x1b[6~": "page down",
    b"\x1b[H": "home",
    b"\x1bOH": "home",
    b"\x1b[1~": "home",
    b"\x1b[F": "end",
    b"\x1bOF": "end",
    b"\x1b[4~": "end",
    b"\r": "enter",
    b"\n": "enter",
    b"\x7f": "back",
    b"\x08": "back",
    b"\x1b": "escape",
    b"\x04": "q",
}


class Ended(BaseException):  # no Exception: an `except Exception` on the way must not catch it
    """A signal ends the process."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def usable() -> bool:
    """Whether standard input and output are a terminal that `Screen` can use."""
    try:
        import termios  # noqa: F401
    except ImportError:
        return False
    ends = (sys.stdin, sys.stdout)
    return all(end is not None and end.isatty() for end in ends) and os.environ.get("TERM", "") not in ("", "dumb")


class Screen:
    """The terminal during a `with` block; see the module."""

    def __init__(self) -> None:
        self._in, self._out = sys.stdin.fileno(), sys.stdout.fileno()
        self._mode: list[Any] | None = None
        self._signals: dict[int, Any] = {}
        self._wake_out, self._wake_in = os.pipe()
        os.set_blocking(self._wake_in, False)
        os.set_blocking(self._wake_out, False)
        self._shown = False

    def __enter__(self) -> Self:
        import termios

        sys.stdout.flush()
        try:
            self._mode = termios.tcgetattr(self._in)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._handle(number, _end)
            self._handle(signal.SIGWINCH, self._wake)
            self._handle(signal.SIGTSTP, self._stop)
            self._show()
        except BaseException:
            self._restore()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def size(self) -> tuple[int, int]:
        """The numbers of columns and lines."""
        try:
            found = os.get_terminal_size(self._out)
        except OSError:
            return 80, 24
        return found.columns or 80, found.lines or 24

    def draw(self, lines: Sequence[str]) -> None:
        """Show these lines on the terminal and nothing else.

        Raises:
            OSError: the terminal has gone.
        """
        text = "\x1b[K\r\n".join(lines)
        self._write(f"\x1b[H{text}\x1b[K\x1b[J")

    def wait(self, client: int, seconds: float) -> bool:
        """Wait for a key, a change of size, or data at the descriptor `client`; returns whether it has data."""
        ready = select.select([client, self._in, self._wake_out], [], [], max(0.0, seconds))[0]
        if self._wake_out in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake_out, 4096)
        return client in ready

    def pressed(self) -> list[str]:
        """The keys that were pressed since the last call: characters, or names such as "up".

        Raises:
            Ended: the terminal has gone.
        """
        if not select.select([self._in], [], [], 0)[0]:
            return []
        try:
            data = os.read(self._in, 1024)
        except OSError:
            raise Ended(signal.SIGHUP) from None
        if not data:
            raise Ended(signal.SIGHUP)
        return keys_in(data)

    def _handle(self, number: int, handler: Any) -> None:
        self._signals[number] = signal.signal(number, handler)

    def _show(self) -> None:
        import tty

        self._shown = True
        tty.setcbreak(self._in)
        self._write(_ENTER)

    def _hide(self) -> None:
        import termios

        if self._shown:
            self._shown = False
            with contextlib.suppress(OSError, termios.error):
                termios.tcflow(self._out, termios.TCOON)  # Ctrl-S may have stopped output
                self._write(_LEAVE)
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(self._in, termios.TCSANOW, self._mode or [])

    def _restore(self) -> None:
        for number in self._signals:
            signal.signal(number, signal.SIG_IGN)  # no signal may interrupt the restoring
        self._hide()
        for number, before in self._signals.items():
            signal.signal(number, before)
        self._signals.clear()
        os.close(self._wake_in)
        os.close(self._wake_out)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        """Stop at Ctrl-Z, with the terminal restored for the shell until the process goes on."""
        self._hide()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._show()
        self._wake(number, frame)

    def _wake(self, number: int, frame: FrameType | None) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_in, b"\0")

    def _write(self, text: str) -> None:
        data = memoryview(text.encode(sys.stdout.encoding or "utf-8", "backslashreplace"))
        while data:
            data = data[os.write(self._out, data) :]


def keys_in(data: bytes) -> list[str]:
    """The keys in bytes from a terminal; other escape sequences and unprintable characters are left out."""
    found: list[str] = []
    while data:
        name = next((one for one in sorted(_KEYS, key=len, reverse=True) if data.startswith(one)), None)
        if name is not None and not (name == b"\x1b" and data[1:2] in (b"[", b"O")):
            found.append(_KEYS[name])
            data = data[len(name) :]
        elif data.startswith(b"\x1b"):
            end = next((place for place, one in enumerate(data[2:], 3) if 0x40 <= one <= 0x7E), len(data))
            data = data[end:]
        else:
            length = 1 if data[0] < 0x80 else 2 if data[0] < 0xE0 else 3 if data[0] < 0xF0 else 4
            text = data[:length].decode("utf-8", "ignore")
            found += [text] if text.isprintable() and text else []
            data = data[length:]
    return found


def _end(number: int, frame: FrameType | None) -> None:
    raise Ended(number)
