"""One client's session on the kernel's loop: its running calls, and the functions that end work with the session."""

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
    """The work of one client in a kernel. Methods are called on the kernel's loop, unless they say otherwise.

    Args:
        kernel: the kernel of the session.
        right: the right of the session.
        who: the client, for the log.
        send: takes a message for the client, from any thread, with a function that is called once it is sent.
        has_room: whether more messages can wait for the client.
        operators: the operators of the kernel's components.
        carried: whether another carrier has admitted the client, such as one of another host.
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
        """The function that cancels a call, by the call's number."""
        self._changing: dict[int, tuple[str, ...]] = {}
        """The components that a running call changes, by the call's number, as far as known before its end."""
        self._streams: dict[int, Stream] = {}
        self._kept: dict[int, Callable[[], object]] = {}
        self._keys = 0

    def keep(self, end: Callable[[], object]) -> Callable[[], None]:
        """Call `end` when the session ends, or at once if it has ended; the returned function revokes the request."""
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
        """Tell the client that its streams have ended, and end the session: the kernel closes."""
        for stream in tuple(self._streams.values()):
            stream.finish()
        self.end()

    def end(self, *, lost: bool = False) -> None:
        """End the session and undo all that lasts only as long: the client has gone, or the kernel closes. Idempotent.

        Args:
            lost: whether the client has gone without a "bye".
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
        """Note that the session has changed components and operates them; if it is lost by now, they react."""
        if self._operators is None:
            return
        if not self.ended:
            self._operators.changed(self, components)
        elif self._lost:
            self._operators.ended(self, self.who, components, lost=True)

    # -- calls -----------------------------------------------------------------------------------------------------

    def begin(self, number: int, operation: Operation, arguments: Any, credit: int | None = None) -> None:
        """Carry out a call and send its answer; a stream sends as many items as `credit` allows, or all."""
        if self.ended:
            return
        stream = Stream(self, number, credit) if operation.streams else None
        try:
            value = operation.run(self, arguments) if stream is None else operation.run(self, arguments, stream)
            if not inspect.isawaitable(value):
                self._succeed(number, operation, arguments, value, stream)
                return
        except Exception as error:  # noqa: BLE001 - a client's request must not harm the kernel
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
            self.operates(changing)  # a change that has begun goes on
            if inspect.iscoroutine(value):
                value.close()  # the task was cancelled before it began
            if stream is not None:
                stream.close()
            self._audit(operation, arguments, "cancelled")
            kind, why = (AbsentError, "its kernel has ended") if self.kernel.closed else (ControlError, "was cancelled")
            self._send(_error(number, kind(f"{operation.name}: {why}")), nothing)
        elif (error := task.exception()) is not None:
            if isinstance(error, TransitionTimeout):
                self.operates(changing)
            if self.kernel.closed:  # any error is now due to the end of the kernel
                error = AbsentError(f"{operation.name}: its kernel has ended: {format_error(error)}")
            self._fail(number, operation, arguments, error, stream)
        else:
            self._succeed(number, operation, arguments, task.result(), stream)

    def cancel(self, number: int) -> None:
        """End a call that the client has cancelled."""
        if (stream := self._streams.get(number)) is not None:
            stream.finish()
        elif (cancel := self._running.get(number)) is not None:
            cancel()

    def credit(self, number: int, count: int) -> None:
        """Add credit to a stream: the client takes `count` more items. In the thread of the socket."""
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
        """Log each call that may change something: who, what, outcome."""
        if operation.right is not Right.VIEW:
            given = {name: value for name, value in plain(arguments).items() if value not in (None, [], {}, "")}
            said = ", ".join(f"{name}={value!r:.100}" for name, value in given.items())
            self.audit(f"{operation.name}({said})", outcome)

    def audit(self, what: str, outcome: str) -> None:
        """Log the line of one call: always these fields in this order, each in quotes."""
        fields = (self.who, self.kernel.address, what, f"{outcome:.300}")
        LOG.info("who=%s kernel=%s what=%s outcome=%s", *map(_quoted, fields))

    def finished(self, number: int) -> None:
        """Forget a stream that has ended."""
        self._running.pop(number, None)
        self._streams.pop(number, None)


class Stream:
    """The items of an operation that streams, for a client that may be slower than the operation.

    Attributes:
        ended: whether nothing is sent any more.
    """

    def __init__(self, session: Session, number: int, credit: int | None = None) -> None:
        self.session = session
        self.ended = False
        self._credit = credit
        """The total number of items that the client takes, counted by the thread of the socket; None: no limit."""
        self._number = number
        self._made = 0
        self._gone = 0
        """Items that the socket has taken, counted by the thread of the socket alone."""
        self._missed = 0
        self._early: list[Mapping[str, Any]] | None = []
        """Messages from before the operation's first answer; None after it."""
        self._closers: list[Callable[[], object]] = []
        self._finish: Callable[[], object] = nothing

    @property
    def has_room(self) -> bool:
        """Whether an item would be sent now, not dropped."""
        taken = self._credit is None or self._made < self._credit
        return taken and self._made - self._gone < WAITING and self.session._has_room()

    def add_credit(self, count: int) -> None:
        """Add `count` items to the credit, where the client gives one."""
        if self._credit is not None:
            self._credit += count

    def on_close(self, closer: Callable[[], object]) -> None:
        """Call `closer` once when the stream ends, from either end."""
        self._closers.append(closer)

    def on_finish(self, flush: Callable[[], object]) -> None:
        """Call `flush` before the stream ends in order: it may send the last items."""
        self._finish = flush

    def send(self, item: Any) -> bool:
        """Send an item; returns False when it was dropped: `WAITING` items wait, or the client has no room or credit
        left. The next item carries the number of dropped ones."""
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
        """Send the messages that came before the operation's first answer."""
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
        """End the stream without a message; idempotent."""
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
    """The text on one line in double quotes; quotes within become single ones."""
    line = "".join(one if one.isprintable() else " " for one in text)
    return '"' + line.replace('"', "'") + '"'


def _error(number: int, error: AiortsError) -> dict[str, Any]:
    return {"id": number, "error": {"code": error.code, "text": str(error)}}


def nothing() -> None:
    """Do nothing: the `sent` function of messages that are not counted."""
