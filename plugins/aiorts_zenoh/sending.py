"""Bounds how much is under way to another kernel. It knows no engine and no loop.

For each neighbour and priority the engine keeps a queue of 16 batches of 64 KiB. A message that finds the queue full
blocks its sender, or is lost. So that neither happens to a sample, no more than one queue is under way to a neighbour,
over all channels together; the rest waits here, within a bound, and a link hears when it has to wait. Samples and
control each have a queue of the engine, and a count of what is under way: control never waits for samples.

What is under way costs at most ROOM, the 16 batches. `cost` is the most that a message takes up: when nothing of
the queue is written to the network, as for a neighbour that stands still. One case goes beyond it: a frame of up to
1 MiB, which is 17 batches, goes in one message where next to nothing is under way. The connection is idle then, and its
own buffers take more than the one batch too many, though no process reads: 4 MB on the loopback of Linux.

No message is express. An express message has a batch of its own, so 17 small ones would not fit any more; and where
nothing waits, it is not sent sooner than another.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from typing import Final

from aiorts_zenoh.envelope import BATCH, FRAME, LONG, LOOK, PIECE, PIECES, Block, alone, cost, message, pieces, size_of

ROOM: Final = 16 * BATCH
"""The most that may be under way to one kernel, by its cost."""
_ROOM_FOR_ANY: Final = ROOM - cost(LONG + 100)
"""The most that may be under way for a further message of up to LONG bytes to be sent."""
_IDLE: Final = BATCH
"""The most that may be under way for a frame of up to ALONE bytes to be sent in one message.

As much as the other end of one channel may have taken without saying so.
"""
ALONE: Final = 1_050_000
_TOLD: Final = BATCH
"""The cost after which a receiver says how far it has come, without being asked."""
_SOME: Final = 4 * BATCH
"""The cost, over all channels to one kernel, after which this kernel says how far it has come."""
_ASKED: Final = 64
"""The most channels at which another kernel is asked at the same time how far it has come."""
_FEW: Final = 4_096
"""The most bytes of a short frame."""
_LAST: Final = 64
"""The most bytes of a frame that may be the last one of a link."""
_FULL: Final = 1 << 20
"""Bytes that wait at one channel beyond which it takes no more."""


class Budget:
    """The cost of what is under way to one kernel, over all of its channels: of samples, or of control."""

    def __init__(self) -> None:
        self.used = 0
        self.senders: dict[Sender, None] = {}
        # A plain dict finds its first item the slower, the more items were taken from its front.
        self.unasked: OrderedDict[Sender, None] = OrderedDict()
        """Senders that have sent a message since the other kernel was asked last how far it has come."""
        self.asked: dict[Sender, None] = {}
        """Senders whose question how far the other kernel has come is not answered yet."""
        self.telling: dict[Sender, None] = {}
        """Senders for which the other kernel will soon report by itself: few, since each has much under way."""
        self.waiting: OrderedDict[Sender, None] = OrderedDict()
        """Senders with messages that wait, in turn; few of thousands of channels have any."""
        self.refusing: dict[Sender, None] = {}
        """Senders that have refused a frame, and have not been told since that there is room."""
        self.untold: OrderedDict[Receiver, None] = OrderedDict()
        """Receivers of messages that the other kernel does not know to have come."""
        self.untold_cost = 0

    @property
    def has_room(self) -> bool:
        """Whether more may be sent."""
        return self.used <= _ROOM_FOR_ANY

    def takes(self, size: int) -> bool:
        """Whether a frame of so many bytes may be sent in one message."""
        return self.used <= _ROOM_FOR_ANY if size <= PIECES else self._takes_long(size)

    def _takes_long(self, size: int) -> bool:
        return self.used + cost(size + 100) <= ROOM or (size <= ALONE and self.used <= _IDLE)

    def look(self) -> None:
        """Ask how far the other kernel has come, unless it will soon say so by itself.

        Where there are thousands of channels, it is asked at some; when it has answered there, at the next.
        """
        if not self.telling:
            self.look_at_some()

    def look_again(self) -> None:
        """Ask again: a question or an answer may be lost. Channels where the other kernel was not asked come first."""
        for sender in tuple(self.asked):
            sender.forget_look()
        for sender in tuple(self.telling):
            sender.look()
        self.look_at_some()

    def look_at_some(self) -> None:
        """Ask at up to 64 channels at the same time, first where it was not asked for longest."""
        while self.unasked and len(self.asked) < _ASKED:
            next(iter(self.unasked)).look()

    def pump(self) -> None:
        """Send the messages that there is room for at all channels, one at each in turn."""
        waiting = self.waiting
        while waiting and self.has_room:
            sender = next(iter(waiting))
            sender.send_next()
            if sender in waiting:
                waiting.move_to_end(sender)

    def tell(self) -> None:
        """Report how far this kernel has come, the longest unreported channel first, while much is unreported in all.

        With thousands of channels, each has too little under way to be reported by itself.
        """
        while self.untold_cost > _SOME:
            next(iter(self.untold)).say()

    def tell_room(self) -> None:
        """Tell the senders that have refused a frame, and would take it now, that there is room."""
        for sender in tuple(self.refusing):
            if sender.room_made():
                sender.on_room()


class Budgets:
    """The budgets of one kernel, one for each queue of the engine."""

    def __init__(self) -> None:
        self.samples = Budget()
        """Frames of writers' ends."""
        self.control = Budget()
        """Frames of readers' ends: acknowledgements, questions for samples, their end."""
        self.both = self.samples, self.control

    @property
    def count(self) -> int:
        """The number of channels to the kernel."""
        return sum(len(budget.senders) for budget in self.both)

    def pump(self) -> None:
        """Send as much as there is room for; without room, ask how far the other kernel is; tell of new room."""
        for budget in self.both:
            budget.pump()
            if not budget.has_room:
                budget.look()
            budget.tell_room()

    def look_again(self) -> None:
        """Ask the other kernel again where no frame may be sent."""
        for budget in self.both:
            if not budget.has_room:
                budget.look_again()


class Sender:
    """The sending part of one end of a channel.

    Args:
        put: gives a message to the engine.
        epoch: the epoch of the link; goes with each message.
        now: ns since 1970.
        on_room: called when there is room after a frame was refused.
    """

    def __init__(
        self,
        budget: Budget,
        put: Callable[[bytes], None],
        epoch: int,
        now: Callable[[], int],
        on_room: Callable[[], None],
    ) -> None:
        self._budget, self._put, self._epoch, self._now = budget, put, epoch, now
        self.on_room = on_room
        self._queue: deque[tuple[int, Sequence[Block], int]] = deque()
        """Messages that wait: kind, blocks and their size."""
        self._last: Sequence[Block] | None = None
        """The last frame, where it waits or was refused, and is short."""
        self._waits = 0
        self._sent = self._taken = 0
        self._looked = 0
        """The cost that was sent when the other end was asked last how far it has come."""
        budget.senders[self] = None

    def send_alone(self, frame: bytes) -> bool:
        """Send a short frame while none waits, faster than `send`; False: nothing was sent, and `send` decides."""
        if self._queue or self._budget.used > _ROOM_FOR_ANY or len(frame) > _FEW:
            return False
        self._give(alone(self._epoch, self._sent, self._now(), frame))
        return True

    def send(self, blocks: Sequence[bytes | memoryview]) -> bool:
        """Send a frame, or keep it until there is room; False: too much waits."""
        size, budget = size_of(blocks), self._budget
        if not self._queue and budget.takes(size):
            self._give(self._message(FRAME, blocks))
            return True
        self._last = blocks if size <= _LAST else None
        if self._waits >= _FULL:
            budget.refusing[self] = None
            return False
        self._queue.append((FRAME, blocks, size))
        budget.waiting[self] = None
        self._waits += size
        while budget.has_room and self.send_next():
            pass
        if self._queue:
            budget.look()
        return True

    def send_next(self) -> bool:
        """Send one message that waits; False: none waits."""
        queue = self._queue
        if not queue:
            return False
        kind, _, size = queue[0]
        if kind == FRAME and not self._budget.takes(size):
            self._cut()
        kind, blocks, size = queue.popleft()
        self._waits -= size
        if not queue:
            self._budget.waiting.pop(self, None)
        self._give(self._message(kind, blocks))
        return True

    def _cut(self) -> None:
        """Cut the first frame that waits into pieces.

        Other channels may have a little under way that has come long ago: a receiver says nothing of so little by
        itself. They ask now, so that the next frame can go in one message.
        """
        self._budget.look_at_some()
        _, blocks, whole = self._queue.popleft()
        found = [(PIECE, piece, size_of(piece)) for piece in pieces(blocks)]
        self._queue.extendleft(reversed(found))
        self._waits += sum(size for _, _, size in found) - whole

    def _message(self, kind: int, blocks: Sequence[Block]) -> bytes:
        return message(kind, self._epoch, self._sent, self._now(), blocks)

    def _give(self, data: bytes) -> None:
        self._put(data)
        costs = cost(len(data))
        self._sent += costs
        budget = self._budget
        budget.used += costs
        budget.unasked[self] = None
        if self._sent - self._taken >= _TOLD:
            budget.telling[self] = None

    def look(self) -> None:
        """Ask how far the other end has come, unless nothing was sent since it was asked last."""
        self._budget.unasked.pop(self, None)
        if self._sent > max(self._taken, self._looked):
            self._budget.asked[self] = None
            self._looked = self._sent
            self._put(message(LOOK, self._epoch, self._sent, self._now()))

    def forget_look(self) -> None:
        """Forget a question without an answer, so that it is asked again."""
        self._looked = 0
        del self._budget.asked[self]
        self._budget.unasked[self] = None

    def came(self, taken: int) -> None:
        """Handle the other end's report that messages of this total cost were taken or are lost."""
        if self._taken < taken <= self._sent:
            budget = self._budget
            budget.used -= taken - self._taken
            self._taken = taken
            if taken >= self._looked:
                budget.asked.pop(self, None)
            if self._sent - taken < _TOLD:
                budget.telling.pop(self, None)

    def room_made(self) -> bool:
        """Whether a frame was refused and would be taken now; True once, then False until the next is refused."""
        refusing = self._budget.refusing
        if self not in refusing or self._waits >= _FULL // 2:
            return False
        del refusing[self]
        return True

    def close(self) -> None:
        """Stop sending.

        A short frame that waits as the last one, or was refused, goes out at once, whatever is under way: it says that
        the link has ended, which is said once.
        """
        budget = self._budget
        if self._queue and self._last is not None:
            self._put(message(FRAME, self._epoch, self._sent, self._now(), self._last))
        if self in budget.senders:
            del budget.senders[self]
            budget.used -= self._sent - self._taken
        for some in (budget.waiting, budget.refusing, budget.unasked, budget.asked, budget.telling):
            some.pop(self, None)
        self._queue.clear()


class Receiver:
    """The receiving part of one end of a channel: how far it has come.

    Args:
        tell: tells the other end the cost of all that has come.
    """

    def __init__(self, budget: Budget, tell: Callable[[int], None]) -> None:
        self._budget, self._tell = budget, tell
        self._taken = self._told = 0

    def took(self, first: int, size: int) -> None:
        """Count a message of `size` bytes; tell the sender how far this end is, if much is unreported."""
        taken = first + cost(size)
        if taken <= self._taken:
            return
        budget = self._budget
        budget.untold_cost += taken - self._taken
        self._taken = taken
        if taken - self._told >= _TOLD:
            self.say()
        else:
            budget.untold[self] = None
            if budget.untold_cost > _SOME:
                budget.tell()

    def asked(self, first: int) -> None:
        """Answer the other end's question; `first`: the cost of all that it has sent."""
        if first > self._taken:
            self._budget.untold_cost += first - self._taken
            self._taken = first
        self.say()

    def say(self) -> None:
        """Tell the other end now how far this end has come."""
        self.close()
        self._tell(self._taken)

    def close(self) -> None:
        """Never report the messages that have come until now."""
        self._budget.untold.pop(self, None)
        self._budget.untold_cost -= self._taken - self._told
        self._told = self._taken
