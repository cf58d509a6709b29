"""The common part of both sides of a link: a connector, the end of the protocol, and the channel of the moment."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, Protocol, TypeVar

from aiorts.kernel.loop.guarded import KernelLog

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.links.transport import Channel
    from aiorts.model.links import ReaderEnd, WriterEnd

report: Final = partial(KernelLog().warning, "W-LINK: %s")
"""Logs a warning of the links."""
_NEVER: Final = 2**63
E = TypeVar("E", bound="WriterEnd | ReaderEnd")


class Owner(Protocol):
    """The owner of a side: it hears what ends the side's channel."""

    def lost(self, why: str) -> None:
        """Handle a channel that went down."""
        ...

    def silent(self) -> None:
        """Handle a channel that was given up: no acknowledgement has come on it."""
        ...

    def left(self) -> None:
        """Handle the news that the connector was disconnected at its other end."""
        ...


class Wakening:
    """A timer that calls back at the time asked for last, or earlier: `callback` asks again for what is due later."""

    __slots__ = ("_kernel", "_timer", "_wakened", "due_ns")

    def __init__(self, kernel: Microkernel, callback: Callable[[], None]) -> None:
        self._kernel, self._wakened = kernel, callback
        self._timer: Cancellable | None = None
        self.due_ns = _NEVER
        """The time of the next call back; in the far future: there is none."""

    def at(self, when_ns: int | None) -> None:
        """Call back at this time of the kernel's clock, or earlier; None: no call is needed."""
        # A timer that is due earlier stays: another timer for each sample costs more than a call for nothing.
        if when_ns is None or self.due_ns <= when_ns:
            return
        self.cancel()
        self.due_ns = when_ns
        self._timer = self._kernel.call_at(when_ns, self._wake)

    def cancel(self) -> None:
        """Call back no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer, self.due_ns = None, _NEVER

    def _wake(self) -> None:
        self._timer, self.due_ns = None, _NEVER
        self._wakened()


class LinkSide(Generic[E]):
    """One side of a link in its kernel. See `ChannelEvents` for what the transport calls."""

    def __init__(self, kernel: Microkernel, connector: Connector, end: E, owner: Owner) -> None:
        self.connector = connector
        self.end: E = end
        self.why = "not connected yet"
        """The reason why the link is not up; "" while it is."""
        self._kernel, self._owner = kernel, owner
        self._now: Callable[[], int] = kernel.clock.monotonic_ns
        self._channel: Channel | None = None
        self._wakening = Wakening(kernel, self._wake)
        self._ended = False

    def on_state(self, up: bool, why: str) -> None:
        if not up and self._channel is not None:
            self._down(why)
            self._owner.lost(why)

    def drop(self, why: str) -> None:
        """Give up the channel, if there is one; another channel will follow."""
        if self._channel is not None:
            self._channel.close()
            self._down(why)

    def _down(self, why: str) -> None:
        self._channel, self.why = None, why
        self.end.channel_down(self._now())

    def _wake(self) -> None:
        self._poll(self._now())

    def _poll(self, now: int) -> None:
        channel = self._channel
        if channel is not None:
            self._wakening.at(self.end.poll(now, channel.send))
