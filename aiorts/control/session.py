"""One client's session as the kernel's loop sees it: the calls that run, and what is to end with the session."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Iterable, Mapping
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from aiorts.control.operation import Right
from aiorts.errors import AbsentError, AiortsError, ControlError, TransitionTimeout, format_error
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.model.plain import plain
from aiorts.sessions import WAITING

if TYPE_CHECKING:
    from aiorts.control.operation import Operation
    from aiorts.control.operators import Operators
    from aiorts.kernel.microkernel import Microkernel

LOG = KernelLog("aiorts.control")


class Session:
    """What one client does in a kernel. Everything here is called on the kernel's loop.

    Args:
        kernel: the one it is with.
        right: what it may do.
        who: the client, for the log.
        send: takes a message for the client, from any thread, with a function that is called once it is on its way.
        has_room: whether it takes more than it holds already.
        operators: who operates the kernel's components.
        carried: whether another carrier has let the client in, such as one of another host.
    """

    def __init__(
        self,
        kernel: Microkernel,
        right: Right,
        who: str,
        send: Callable[[Mapping[str, Any], Callable[[], None]], None],
        has_room: Callable[[], bool] = lambda: True,
        operators: Operators | None = None,
        *,
        carried: bool = False,
    ) -> None:
        self.kernel = kernel
        self.carried = carried
        self.right = right
        self.who = who
        self.ended = self._lost = False
        self._send = send
        self._has_room = has_room
        self._operators = operators
        self._running: dict[int, Callable[[], object]] = {}
        """By the call's number: what cancels it."""
        self._changing: dict[int, tuple[str, ...]] = {}
        """By the call's number: the components that it changes, as far as that is known before it has ended."""
        self._streams: dict[int, Stream] = {}
        self._kept: dict[int, Callable[[], object]] = {}
        self._keys = 0

    def keep(self, end: Callable[[], object]) -> Callable[[], None]:
        """Call `end` when the session ends, or at once if it has, unless what is returned is called before."""
        if self.ended:
            end()
            return nothing
        self._keys += 1
        key = self._keys
        self._kept[key] = end

        def forget() -> None:
            self._kept.pop(key, None)

        return forget

    def finish(self) -> None:
        """The kernel ends: tell the client that its streams have ended, and end."""
        for stream in tuple(self._streams.values()):
            stream.finish()
        self.end()

    def end(self, *, lost: bool = False) -> None:
        """The client has gone, or the kernel ends: undo what lasts as long as the session. Idempotent.

        Args:
            lost: whether the client has gone without having said so.
        """
        if self.ended:
            return
        self.ended, self._lost = True, lost
        if self._operators is not None:
            self._operators.ended(self, self.who, chain.from_iterable(self._changing.values()), lost=lost)
        self._changing.clear()
        for cancel in (*reversed(self._running.values()), *reversed(self._kept.values())):
            try:
                cancel()
            except Exception as error:
                LOG.error("%s: could not end what it began: %s", self.who, format_error(error), exc_info=error)
        self._running.clear()
        self._kept.clear()

    def operates(self, components: Iterable[str]) -> None:
        """It has changed these, and is their operator now; one that was lost meanwhile is so of these, too."""
        if self._operators is None:
            return
        if not self.ended:
            self._operators.changed(self, components)
        elif self._lost:
            self._operators.ended(self, self.who, components, lost=True)

    # -- calls -----------------------------------------------------------------------------------------------------

    def begin(self, number: int, operation: Operation, arguments: Any, credit: int | None = None) -> None:
        """Carry out a call, and send its answer; of a stream, as many items as there is `credit` for, or all."""
        if self.ended:
            return
        stream = Stream(self, number, credit) if operation.streams else None
        try:
            value = operation.run(self, arguments) if stream is None else operation.run(self, arguments, stream)
            if not inspect.isawaitable(value):
                self._succeed(number, operation, arguments, value, stream)
                return
        except Exception as error:  # noqa: BLE001 - the border round what a client asked for
            self._fail(number, operation, arguments, error, stream)
            return
        task = kernel_task(self.kernel.loop, _result(value), f"aiorts control {operation.name}")
        self._running[number] = task.cancel
        if operation.changes is not None:
            self._changing[number] = tuple(operation.changes(arguments, None))
        task.add_done_callback(partial(self._ended, number, operation, arguments, value, stream))

    def _ended(
        self,
        number: int,
        operation: Operation,
        arguments: Any,
        value: Any,
        stream: Stream | None,
        task: asyncio.Task[Any],
    ) -> None:
        self._running.pop(number, None)
        changing = self._changing.pop(number, ())
        if task.cancelled():
            self.operates(changing)  # what has begun goes on
            if inspect.iscoroutine(value):
                value.close()  # cancelled before it began
            if stream is not None:
                stream.close()
            self._audit(operation, arguments, "cancelled")
            kind, why = (AbsentError, "its kernel has ended") if self.kernel.closed else (ControlError, "was cancelled")
            self._send(_error(number, kind(f"{operation.name}: {why}")), nothing)
        elif (error := task.exception()) is not None:
            if isinstance(error, TransitionTimeout):
                self.operates(changing)
            if self.kernel.closed:  # whatever it says is so because what it is about has ended
                error = AbsentError(f"{operation.name}: its kernel has ended: {format_error(error)}")
            self._fail(number, operation, arguments, error, stream)
        else:
            self._succeed(number, operation, arguments, task.result(), stream)

    def cancel(self, number: int) -> None:
        """The client wants no more of a call: end it."""
        if (stream := self._streams.get(number)) is not None:
            stream.finish()
        elif (cancel := self._running.get(number)) is not None:
            cancel()

    def credit(self, number: int, count: int) -> None:
        """The client takes so many items more of a stream. In the thread of the socket."""
        if (stream := self._streams.get(number)) is not None:
            stream.add_credit(count)

    def _succeed(self, number: int, operation: Operation, arguments: Any, value: Any, stream: Stream | None) -> None:
        self._audit(operation, arguments, "done")
        if operation.changes is not None and not self.ended:
            self.operates(operation.changes(arguments, value))
        self._send({"id": number, "ok": value}, nothing)
        if stream is not None:
            stream.begun()
            if self.ended:
                stream.close()
            elif not stream.ended:
                self._running[number] = stream.close
                self._streams[number] = stream

    def _fail(
        self, number: int, operation: Operation, arguments: Any, error: BaseException, stream: Stream | None
    ) -> None:
        if stream is not None:
            stream.close()
        if not isinstance(error, AiortsError):
            LOG.error("%s: %s failed: %s", self.who, operation.name, format_error(error), exc_info=error)
            error = ControlError(f"{operation.name}: {format_error(error)}")
        self._audit(operation, arguments, f"refused {error.code}: {error}")
        self._send(_error(number, error), nothing)

    def _audit(self, operation: Operation, arguments: Any, outcome: str) -> None:
        """One line for each call that changes something: who, what, outcome."""
        if operation.right is not Right.VIEW:
            given = {name: value for name, value in plain(arguments).items() if value not in (None, [], {}, "")}
            said = ", ".join(f"{name}={value!r:.100}" for name, value in given.items())
            self.audit(f"{operation.name}({said})", outcome)

    def audit(self, what: str, outcome: str) -> None:
        """The line of one call: always these fields in this order, whatever stands in them."""
        fields = (self.who, self.kernel.address, what, f"{outcome:.300}")
        LOG.info("who=%s kernel=%s what=%s outcome=%s", *map(_quoted, fields))

    def finished(self, number: int) -> None:
        """A stream has ended."""
        self._running.pop(number, None)
        self._streams.pop(number, None)


class Stream:
    """What an operation sends bit by bit, to a client that may be slower than it.

    Attributes:
        ended: whether nothing is sent any more.
    """

    def __init__(self, session: Session, number: int, credit: int | None = None) -> None:
        self.session = session
        self.ended = False
        self._credit = credit
        """How many items the client takes in all, counted by the thread of the socket; None: it does not say."""
        self._number = number
        self._made = 0
        self._gone = 0
        """Of those made, how many are on their way: counted by the thread of the socket alone."""
        self._missed = 0
        self._early: list[Mapping[str, Any]] | None = []
        """Messages that came before the operation has said that it began."""
        self._closers: list[Callable[[], object]] = []
        self._finish: Callable[[], object] = nothing

    @property
    def has_room(self) -> bool:
        """Whether an item that is sent now is not dropped."""
        taken = self._credit is None or self._made < self._credit
        return taken and self._made - self._gone < WAITING and self.session._has_room()

    def add_credit(self, count: int) -> None:
        """The client takes so many items more, where it says how many it takes."""
        if self._credit is not None:
            self._credit += count

    def on_close(self, closer: Callable[[], object]) -> None:
        """Call `closer` once when the stream ends, whoever ends it."""
        self._closers.append(closer)

    def on_finish(self, flush: Callable[[], object]) -> None:
        """Call `flush` before the stream ends in order: it may send what still waits."""
        self._finish = flush

    def send(self, item: Any) -> bool:
        """Send an item; False when it was dropped, since `WAITING` items wait or the client takes none: the next that
        goes says how many."""
        if self.ended:
            return False
        if not self.has_room:
            self._missed += 1
            return False
        missed, self._missed = self._missed, 0
        self._made += 1
        self._pass({"id": self._number, "item": item, "missed": missed})
        return True

    def miss(self, count: int) -> None:
        """Count items that were lost before they could be sent."""
        self._missed += count

    def begun(self) -> None:
        """The operation has said that it began: what came before goes out."""
        early, self._early = self._early or (), None
        for message in early:
            self._pass(message)

    def finish(self, result: Any = None) -> None:
        """Tell the client that there are no more items."""
        if not self.ended:
            self._finish()
            self.close()
            self._pass({"id": self._number, "end": result, "missed": self._missed})

    def close(self) -> None:
        """End it without a word; idempotent."""
        if self.ended:
            return
        self.ended = True
        self.session.finished(self._number)
        for closer in reversed(self._closers):
            closer()
        self._closers.clear()

    def _pass(self, message: Mapping[str, Any]) -> None:
        if self._early is not None:
            self._early.append(message)
        else:
            self.session._send(message, self._count if "item" in message else nothing)

    def _count(self) -> None:
        self._gone += 1


async def _result(value: Awaitable[Any]) -> Any:
    return await value


def _quoted(text: str) -> str:
    """On one line, between quotes that stand nowhere in it."""
    line = "".join(one if one.isprintable() else " " for one in text)
    return '"' + line.replace('"', "'") + '"'


def _error(number: int, error: AiortsError) -> dict[str, Any]:
    return {"id": number, "error": {"code": error.code, "text": str(error)}}


def nothing() -> None:
    """Of a message that nobody counts."""
