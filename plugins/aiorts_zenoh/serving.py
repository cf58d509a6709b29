"""A kernel's end of sessions with clients of other hosts, in a thread and loop of its own.

So a kernel whose loop is busy holds up no session.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.control import Control, Right
from aiorts.errors import AiortsError, ClosedError, ControlError, DeniedError, NoAnswerError
from aiorts.sessions import ClientSession, answer_in, framed, packed
from aiorts_zenoh.carried import Carried
from aiorts_zenoh.engine import Engine, Inbox
from aiorts_zenoh.envelope import END, FRAME, LOOK, read
from aiorts_zenoh.envelope import message as message_of
from aiorts_zenoh.keys import CTL, HELLO, INFO, Keys, session_in

if TYPE_CHECKING:
    import socket

_ANSWERS: Final = 8 << 20
"""The most bytes of an answer to a call without a session."""
_ANSWER_SECONDS: Final = 30.0
_SESSIONS: Final = {INFO: 192, CTL: 256}
"""The most sessions of all clients, by the branch of the newest: the rest of 256 is for clients that operate."""
_OF_ONE: Final = {INFO: 24, CTL: 128}
"""The most sessions of one client's name: a few more than the kernel admits, so that it can tell these the reason."""
_REMEMBERED: Final = 256
"""The most names and texts that are remembered, to report each once."""
_KEPT: Final = 4_096
_STARTS: Final = 5.0
_LAST_WORDS: Final = 1.5


class Serving:
    """Lets clients of other hosts look into a kernel and, if it is allowed, operate it.

    The rights of a client follow from the key: under `info` it looks, under `ctl` it operates; it never brings code.

    Args:
        control: lets the clients in.
        operate: whether `ctl` is there at all.
        report: takes a text for the log, from any thread.
        admits: whether a client of this name may look, or operate.
    """

    def __init__(
        self, control: Control, *, operate: bool, report: Callable[[str], None], admits: Callable[[str, bool], bool]
    ) -> None:
        self._control, self._report, self._admits = control, report, admits
        self._branches = {INFO: Right.VIEW} | ({CTL: Right.OPERATE} if operate else {})
        self._sessions: dict[tuple[str, str, str], Carried] = {}
        """The sessions by branch, caller and name of the session."""
        self._there: set[tuple[str, str, str]] = set()
        """Sessions whose clients are there, as their tokens say."""
        self._ended: dict[tuple[str, str, str], None] = {}
        """The last sessions that have ended."""
        self._bad: set[str] = set()
        """Callers that have sent bytes that are no message; each is reported once."""
        self._refused: set[str] = set()
        """Refusals of sessions; each is reported once."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        self._ends: list[Callable[[], None]] = []
        """Functions that end the declarations under the name of the kernel."""
        self._engine: Engine
        self._keys: Keys
        self._loop: asyncio.AbstractEventLoop
        self._inbox: Inbox
        self._stop: asyncio.Event
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="aiorts zenoh control")

    def declare(self, engine: Engine, keys: Keys) -> None:
        """Serve clients from now on. The call may wait for the network."""
        self._engine = engine
        self._thread.start()
        if not self._ready.wait(_STARTS):
            raise ControlError("the thread that serves other hosts has not begun")
        if self._closed:  # closed before the thread was there
            self.close()
            raise ControlError("this kernel ends")
        self.declare_as(engine, keys)

    def declare_as(self, engine: Engine, keys: Keys) -> None:
        """Serve the clients that know this kernel by these keys."""
        for end in self._ends:
            end()
        self._keys, self._ends = keys, []
        for branch in self._branches:
            self._ends += [
                engine.subscribe(keys.sessions(branch), partial(self._arrived, branch), self._inbox),
                engine.presence(keys.session_tokens(branch), partial(self._present, branch), self._inbox),
                engine.answer(keys.calls(branch), partial(self._asked, branch), self._inbox),
            ]

    def deny(self, caller: str) -> None:
        """End the sessions of a client that is not admitted any more; from any thread."""
        if self._ready.is_set() and not self._closed:
            self._loop.call_soon_threadsafe(self._end_of, caller)

    def _end_of(self, caller: str) -> None:
        for name, carried in tuple(self._sessions.items()):
            if name[1] == caller:
                carried.cut_off()

    def finish(self) -> None:
        """Wait, for a moment, until the kernel has ended all sessions and their clients have its last messages."""
        until = time.monotonic() + _LAST_WORDS
        while self._sessions and time.monotonic() < until:
            time.sleep(0.005)

    def close(self) -> None:
        """End all sessions. The kernel has told their clients that it ends."""
        self._closed = True
        if self._ready.is_set():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(_STARTS)

    def _serve(self) -> None:
        with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:  # whatever loop the program has
            runner.run(self._main())

    async def _main(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._inbox, self._stop = Inbox(self._loop), asyncio.Event()
        self._ready.set()
        await self._stop.wait()
        self._inbox.close()
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # -- sessions --------------------------------------------------------------------------------------------------

    def _arrived(self, branch: str, key: str, data: bytes) -> None:
        try:
            message = read(data)
        except ValueError as error:
            if self._engine.gate is not None:
                self._engine.gate.was_bad(key)
            if (caller := session_in(key)[0]) not in self._bad and len(self._bad) < _REMEMBERED:
                self._bad.add(caller)
                self._report(f"zenoh: {caller} sent what is no message: {error}")
            return
        name = branch, *session_in(key)
        carried = self._sessions.get(name)
        if carried is None:
            # A session whose first message was lost begins with a question how much has come. A session that has ended
            # does not begin again: a program that has recorded its messages may put them again.
            begins = message.kind == FRAME and not message.first
            if name in self._ended or not (begins or (message.kind == LOOK and name in self._there)):
                return
            of_caller = sum(one[1] == name[1] for one in self._sessions)
            if len(self._sessions) >= _SESSIONS[branch] or of_caller >= _OF_ONE[branch]:
                no_more = message_of(END, message.epoch, 0, time.time_ns())
                self._engine.put(self._keys.session(*name), no_more, urgent=branch == CTL)
                return
            carried = self._sessions[name] = self._begin(name, message.epoch)
        carried.arrived(message)

    def _begin(self, name: tuple[str, str, str], number: int) -> Carried:
        carried = Carried(partial(self._engine.put, self._keys.session(*name), urgent=name[0] == CTL), number)
        self._run(self._carry(name, carried))
        return carried

    async def _carry(self, name: tuple[str, str, str], carried: Carried) -> None:
        try:
            await carried.run(*await self._let_in(*name[:2]))
        except (AiortsError, OSError) as error:
            if (text := f"zenoh: {name[1]}: {error}") not in self._refused and len(self._refused) < _REMEMBERED:
                self._refused.add(text)
                self._report(text)
            await carried.refuse(framed(_said(error)))
        finally:
            del self._sessions[name]
            self._ended[name] = None
            if len(self._ended) > _KEPT:
                del self._ended[next(iter(self._ended))]

    async def _let_in(self, branch: str, caller: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_unix_connection(sock=self._admitted(branch, caller))

    def _admitted(self, branch: str, caller: str) -> socket.socket:
        """The client's end of a connection with the kernel."""
        self._check(branch, caller)
        return self._control.admit(self._branches[branch], f"{caller}, another host")

    def _check(self, branch: str, caller: str) -> None:
        if not self._admits(caller, branch == CTL):
            raise DeniedError(f"{caller!r} was revoked, or has no role in this kernel")

    def _present(self, branch: str, token: str, up: bool) -> None:
        name = branch, *session_in(token)
        if up and len(self._there) < _KEPT:
            self._there.add(name)
        elif not up:
            self._there.discard(name)
            if (carried := self._sessions.get(name)) is not None:
                carried.peer_gone()

    def _run(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- calls without a session -----------------------------------------------------------------------------------

    def _asked(self, branch: str, key: str, body: bytes, beside: bytes, query: Any) -> None:
        *_, caller, operation = key.split("/")
        reply = partial(self._reply, query, self._keys.call(branch, caller, operation))
        try:
            if operation == HELLO:
                self._check(branch, caller)
                reply({"ok": {**self._control.hello, "right": self._branches[branch].value}})
                return
            hello = self._control.hello
            session = ClientSession(str(hello.get("address", "")), str(hello.get("epoch", "")), longest=_ANSWERS)
            _, call = session.begin(operation, answer_in(body) if body else {})
            connected = self._admitted(branch, caller)  # refused here and now, it costs no task and no descriptor
        except (AiortsError, OSError) as error:
            reply(_said(error))
            return
        self._run(self._answer(connected, session, operation, call, reply))

    def _reply(self, query: Any, key: str, answer: dict[Any, Any]) -> None:
        self._engine.reply(query, packed(answer), good=True, key=key)

    async def _answer(
        self,
        connected: socket.socket,
        session: ClientSession,
        operation: str,
        call: bytes,
        reply: Callable[[dict[Any, Any]], None],
    ) -> None:
        try:
            reply({"ok": await self._call(connected, session, operation, call)})
        except (AiortsError, OSError) as error:
            reply(_said(error))

    async def _call(self, connected: socket.socket, session: ClientSession, operation: str, call: bytes) -> Any:
        """The result of one call, in a session of its own. AiortsError: the kernel refuses it."""
        reader, writer = await asyncio.open_unix_connection(sock=connected)
        try:
            writer.write(session.greeting("a call") + call)
            async with asyncio.timeout(_ANSWER_SECONDS):
                while data := await reader.read(1 << 16):
                    for answered in session.receive(data):
                        return answered.take().result()
                    session.check()
            raise ClosedError("the kernel ends")
        except TimeoutError:
            raise NoAnswerError(f"{operation}: no answer within {_ANSWER_SECONDS:g} s") from None
        finally:
            writer.close()


def _said(error: AiortsError | OSError) -> dict[str, Any]:
    """The answer that reports an error; OSError: no descriptor is left."""
    code = error.code if isinstance(error, AiortsError) else ControlError.code
    return {"error": {"code": code, "text": str(error)}}
