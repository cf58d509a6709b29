"""Writers that wait for room in a connector with full = block: in a queue, from which who makes room moves them.

A writer in a thread waits on the receiver's lock, every other one on a future.
"""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.kernel.ports.port import OFF
from aiorts.late import dataclass
from aiorts.model.policy import Push

if TYPE_CHECKING:
    from collections.abc import Collection

    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.model.timing import ConnectorTimes

# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_SKIP: Final = Push.SKIP
_OF_TRANSPORT: Final[tuple[str, ...]] = ()
"""The slots of the attributes below are those of `Transport`."""


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room: the reader that makes room moves it.

    A writer in a thread has no future and waits on the receiver's lock.
    """

    connector: Connector
    sample: Any
    future: asyncio.Future[None] | None
    done: bool = False


class Queueing:
    """How writers wait for room: a base of `Transport`, which has the rest."""

    __slots__ = _OF_TRANSPORT

    admits_plainly: ClassVar[bool] = True
    """Whether who waits for room may be moved in without a call for each."""

    if TYPE_CHECKING:
        connector: Connector
        receiver: Receiver
        queue: deque[Any]
        waiting: deque[Waiting] | None
        written: int
        length: int
        push: Push
        times: ConnectorTimes | None

        def guard(self) -> AbstractContextManager[Any]: ...
        def must_wait(self) -> bool: ...
        def admits_next(self) -> bool: ...
        def offer(self, sample: Any) -> bool: ...
        def push_in(self, sample: Any, *, displaced: bool = False) -> None: ...
        def stamp_in(self, sample: Any) -> Any: ...
        def drop_these(self, reason: str, samples: Collection[Any]) -> None: ...
        def lose(self, sample: Any) -> None: ...

    def wait_for_room(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting | None:
        """Queue up for room; None when there is room after all (across threads) and the sample was taken."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.wait_for_room(sample, future)
            if self.must_wait():
                return self.queue_up(sample, future)
            self.offer(sample)
            return None

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        """Queue up for room that there is known not to be; across threads the caller holds the lock."""
        entry = Waiting(self.connector, sample, future)
        if self.waiting is None:
            self.waiting = deque()
        self.waiting.append(entry)
        self.connector.in_._fast = OFF
        return entry

    def moved(self, entry: Waiting) -> bool:
        """Whether the sample of a waiting thread is in; called in that thread."""
        return entry.done

    def give_up(self, entry: Waiting) -> bool:
        """Stop waiting; False when the sample was moved in the meantime."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.give_up(entry)
            waiting = self.waiting
            if entry.done or not waiting or entry not in waiting:
                return False
            waiting.remove(entry)
            if not waiting:
                self.connector.in_._fast = self.receiver.direct
            return True

    def admit_waiting(self) -> None:
        """Move in who waits, as far as there is room. A sample has its number when it comes in, not when it queued up:
        one that gave up in the meantime was never written."""
        waiting = self.waiting
        if not waiting:
            return
        receiver, queue = self.receiver, self.queue
        plain = (
            self.admits_plainly
            and self.times is None
            and self.connector.profile.stamp is None
            and self.push is not _SKIP
            and receiver.lock is None
        )
        while plain and waiting and len(queue) < self.length:
            # Written out: the writer and the reader of a full buffer do this once for each sample.
            entry = waiting.popleft()
            self.written += 1
            queue.append(entry.sample)
            receiver.arrived(self, False)  # type: ignore[arg-type] # it is a Transport
            entry.done = True
            if entry.future is not None and not entry.future.done():
                entry.future.set_result(None)
        if not plain:
            self._admit_each(waiting)
        if not waiting:
            self.connector.in_._fast = receiver.direct
        receiver.room_made()

    def _admit_each(self, waiting: deque[Waiting]) -> None:
        """Move in who waits, as far as there is room; those that the push policy leaves out need none."""
        while waiting:
            sent = self.admits_next()
            if sent and len(self.queue) >= self.length:
                break
            entry = waiting.popleft()
            self.written += 1
            if sent:
                self.push_in(self.stamp_in(entry.sample))
            else:
                self.drop_these("skipped", (entry.sample,))
                self.lose(entry.sample)
            self.resolve(entry)

    def resolve(self, entry: Waiting) -> None:
        """Let the writer go on; the caller holds the lock and calls `room_made`."""
        entry.done = True
        if entry.future is None:
            return  # a thread: woken by `room_made` of whoever called
        if self.receiver.lock is None:
            _set_done(entry.future)
        else:
            entry.future.get_loop().call_soon_threadsafe(_set_done, entry.future)


def _set_done(future: asyncio.Future[None]) -> None:
    """Wake the writer, unless it has given up."""
    if not future.done():
        future.set_result(None)
