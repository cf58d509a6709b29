"""A transport whose samples wait at the writer and move at each period of `push_rate` on the kernel's clock.

Periods are counted from the connection, or from a change of `push_rate`: the n-th is over at `start + n / push_rate`,
so they do not drift. No timer runs while nothing waits. The writer never waits; with full = block a sample that finds
no room at the reader stays at the writer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from operator import methodcaller
from typing import TYPE_CHECKING, Any

from aiorts.kernel.ports.connector import Connector
from aiorts.kernel.ports.receiver import Receiver
from aiorts.kernel.ports.transport import Transport
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Choice, Push, choose

if TYPE_CHECKING:
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.model.profile import ConnectorProfile


# Enum members as globals: on CPython 3.11 a look-up in the Enum class costs eight times as much.
_ALL = Push.ALL


class PeriodicTransport(Transport):
    """A transport with a backlog at the writer, worked off at each period of `push_rate`. See `Transport`."""

    __slots__ = (
        "backlog",
        "call_at",
        "denominator",
        "first",
        "now_ns",
        "numerator",
        "sent",
        "spared",
        "start_ns",
        "timer",
        "timer_requested",
    )

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        super().__init__(connector, receiver, kernel)
        self.backlog: deque[Any] = deque()
        self.first = 1
        """The number of the oldest sample in the backlog, counted from the connection."""
        self.sent = False
        """Whether the last period sent a sample."""
        self.spared = 0
        """The number of the sample that is sent even against the push policy; 0: none."""
        self.timer_requested = False
        """Whether a timer was requested that the loop has not set yet."""
        self.call_at = kernel.call_at
        self.now_ns: Callable[[], int] = kernel.clock.monotonic_ns
        self.begin_periods(connector.profile)
        self.timer: Any = None

    def take_over(self, old: Transport, receiver: Receiver) -> None:
        super().take_over(old, receiver)
        for name in PeriodicTransport.__slots__:
            setattr(self, name, getattr(old, name))

    def change(self, profile: ConnectorProfile) -> None:
        before = self.connector.profile.push_rate
        super().change(profile)
        if profile.push_rate != before:
            self.begin_periods(profile)
            if self.timer is not None:
                self.timer.cancel()
                self.timer = None
                self.set_timer()

    def carry_on(self, old: Transport) -> None:
        if isinstance(old, PeriodicTransport):
            self.backlog, self.first, self.spared = old.backlog, old.first, old.spared
            old.backlog = deque()
        super().carry_on(old)
        if self.backlog:
            self.timer_requested = True
            self.set_timer()

    def leave_off(self) -> Iterable[Any]:
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None
        yield from super().leave_off()
        yield from self.backlog
        self.backlog.clear()

    def begin_periods(self, profile: ConnectorProfile) -> None:
        """Count periods from now on."""
        assert profile.push_rate is not None  # noqa: S101 - options were checked
        self.numerator, self.denominator = profile.push_rate.as_integer_ratio()
        self.start_ns = self.now_ns()

    @property
    def wakes(self) -> bool:
        return False  # the period does, on the loop

    @property
    def direct(self) -> bool:
        return False

    @property
    def buffered(self) -> int:
        return len(self.queue) + len(self.backlog)

    def must_wait(self) -> bool:
        return False

    def offer(self, sample: Any) -> bool:
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.offer(sample)
            if self.closed:
                return True
            self.written += 1
            if not self.receiver.open:
                self.drop("inactive")
                self.miss(sample)
                return True
            if len(self.backlog) >= self.connector.profile.out_length:
                if self.connector.profile.full is FullPolicy.REJECT:
                    self.drop("rejected")
                    self.miss(sample)
                    return False
                self.leave("overwritten")
            if not self.backlog:
                self.first = self.written - self.offered
            self.lay_by(sample)
            asked, self.timer_requested = self.timer_requested, True
        if self.timer is None and not asked:
            self.on_loop(_set_timer)
        return True

    def lay_by(self, sample: Any) -> None:
        """Take a sample into the backlog, which has room; the caller holds the lock."""
        self.backlog.append(sample)

    def leave(self, reason: str | None = None) -> Any:
        """Remove and return the oldest sample of the backlog; with a `reason`, count it as dropped."""
        self.first += 1
        sample = self.backlog.popleft()
        if reason is not None:
            self.drop_these(reason, (sample,))
        return sample

    def put_last(self, sample: Any) -> None:
        if not self.backlog:
            super().put_last(sample)
            return
        self.written += 1
        self.offered += 1
        self.lay_by(sample)
        self.spare_newest()

    def spare_newest(self) -> None:
        if self.backlog:
            self.spared = self.first + len(self.backlog) - 1

    def newest_here(self) -> Any:
        return self.backlog[-1] if self.backlog else super().newest_here()

    def lose(self, sample: Any) -> None:
        if not self.backlog:
            super().lose(sample)

    def set_timer(self) -> None:
        """Set the timer for the end of the present period."""
        if self.timer is not None or self.closed:
            return
        elapsed = self.now_ns() - self.start_ns
        period = elapsed * self.numerator // (1_000_000_000 * self.denominator) + 1
        deadline = self.start_ns + -(-period * 1_000_000_000 * self.denominator // self.numerator)
        self.timer = self.call_at(deadline, partial(self.on_loop, methodcaller("end_period")))

    def end_period(self) -> None:
        """Send at the end of a period; with the option `measure`, also measure how long sending took."""
        if self.times is None:
            self.work_off()
            return
        began_ns, self.sent = self.now_ns(), False
        self.work_off()
        if self.sent:
            with self.guard():
                self.times.add(began_ns, self.now_ns())

    def work_off(self) -> None:
        """Send the samples of the backlog that the push policy chooses, and drop those that it leaves out."""
        with self.guard():
            self.timer = None
            if self.push is _ALL and self.takes_all():
                self._move_all()
                return
            choices = choose(self.push, self.connector.profile.skip, self.first, len(self.backlog))
            for number, choice in enumerate(choices, self.first):
                if choice is not Choice.SEND and number != self.spared:
                    self.lose(self.leave(choice.value))
                elif self.connector.profile.full is FullPolicy.BLOCK and len(self.queue) >= self.length:
                    break
                else:
                    self.store_bounded(self.leave())
            more = self.timer_requested = bool(self.backlog)
        if more:
            self.set_timer()

    def takes_all(self) -> bool:
        """Whether the reader has room for the whole backlog and there is nothing to stamp or to put in order."""
        fits = len(self.queue) + len(self.backlog) <= self.length
        return fits and self.connector.profile.stamp is None and self.receiver.tokens is None

    def _move_all(self) -> None:
        backlog = self.backlog
        self.timer_requested = False
        if backlog:
            self.sent = True
            self.queue.extend(backlog)
            backlog.clear()
            self.receiver.arrived(self, 0)

    def push_in(self, sample: Any, *, displaced: int = 0) -> None:
        self.sent = True
        self.queue.append(sample)
        self.receiver.arrived(self, displaced)

    def discard_all(self, reason: str) -> None:
        super().discard_all(reason)
        if self.backlog:
            self.drop(reason, len(self.backlog))
            self.backlog.clear()

    def close(self) -> None:
        super().close()
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None


def _set_timer(transport: Any) -> None:
    """Set a requested timer, on the loop, unless other options have made the transport another kind meanwhile."""
    if isinstance(transport, PeriodicTransport):
        transport.set_timer()
