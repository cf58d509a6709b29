"""The engine: one Zenoh session, its callbacks handed over to the loop. Nothing else here imports `zenoh`.

The engine calls callbacks in threads of its own. A callback copies what came, puts it into a bounded queue and wakes
the loop, unless it was woken already. It never calls the engine, which may never return there (zenoh #1092, #2744).
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import json
import re
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

from aiorts.errors import LinkError, MissingExtra, PluginError
from aiorts_zenoh.gate import Gate

T = TypeVar("T")

LOWEST, HIGHEST = (1, 9), (1, 11)
"""Versions of the engine: from the first of these on, and before the second."""
_ITEMS: Final = 100_000
_BYTES: Final = 64 << 20
"""The most that waits for the loop: so many items, and so many bytes in items that are not short."""
_SHORT: Final = 512
"""The most bytes of a short message. Only the number of short messages is bounded, not their bytes."""
_PLACE: Final = re.compile(r" at /\S+\.rs:\d+\.?")
"""The place in the engine's own sources that its error names."""
_ATTEMPT: Final = 1_000
"""Milliseconds of one attempt of a client to connect; nothing can end an attempt sooner."""
_UNREACHED: Final = "Unable to connect"
_EMPTY: Final = 0.3
"""Seconds without a token after which the engine's answer that there is none counts."""
_AGAIN: Final = 0.05
_LEAVES: Final = 4.0
"""The most seconds that the interpreter's end waits for threads inside the engine."""
_AT_ONCE: Final = 256
"""Items that are handled before the loop has its turn."""
_MANY: Final = 16
"""After so many items at once the next item does not wake the loop: the loop looks again after a pause."""
_PAUSE: Final = 0.001
_LONG_PAUSE: Final = 0.004
"""Seconds of the first pause and of the longest. While as many items come again, each pause is twice the last.

A loop that is woken at each message of a flood fights for the interpreter with the thread that brings the messages.
"""


class Inbox:
    """Items that callbacks have brought and the loop has not handled yet; an item too many is dropped and counted."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._items: deque[tuple[Callable[..., None], tuple[Any, ...], int]] = deque()
        self._lock = threading.Lock()
        self._came = self._left = 0
        """Bytes ever put in and taken out, without those of short messages; each count is changed by one side alone."""
        self._due = False
        """Whether the loop will look for items by itself."""
        self._closed = False
        self._pause = 0.0
        self.dropped = 0
        """Items that were dropped."""

    def put(self, handle: Callable[..., None], *arguments: Any, size: int = 0) -> None:
        """Let the loop call `handle`; from any thread, without waiting.

        Short messages take no lock: a lock would be half of their cost in the engine's thread.
        """
        items = self._items
        if self._closed or ((size > _SHORT or len(items) >= _ITEMS) and not self._has_room(size)):
            return
        items.append((handle, arguments, size))
        if not self._due:
            self._due = True
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._handle)

    def _has_room(self, size: int) -> bool:
        """Whether there is room for an item of so many bytes; they are counted as put in, or the item as dropped."""
        with self._lock:
            if len(self._items) >= _ITEMS or (size > _SHORT and self._came - self._left + size > _BYTES):
                self.dropped += 1
                return False
            self._came += size if size > _SHORT else 0
            return True

    @property
    def is_over(self) -> bool:
        """Whether the loop that handles all has ended."""
        return self._loop.is_closed()

    def close(self) -> None:
        """Handle no more items."""
        with self._lock:
            self._closed = True
            self._items.clear()

    def _handle(self) -> None:
        items = self._items
        for done in range(_AT_ONCE):
            if self._closed or (not items and self._is_done(done)):
                return
            handle, arguments, size = items.popleft()
            if size > _SHORT:
                self._left += size
            try:
                handle(*arguments)
            except BaseException:
                self._loop.call_soon(self._handle)  # the items behind it are handled all the same
                raise
        self._loop.call_soon(self._handle)

    def _is_done(self, done: int) -> bool:
        """Whether the loop may turn to other things; after many items it looks again by itself."""
        if done >= _MANY:
            self._pause = min(2 * self._pause, _LONG_PAUSE) or _PAUSE
            self._loop.call_later(self._pause, self._handle)
            self._due = True  # two threads may both have woken the loop: the other call has made it False then
            return True
        self._pause = 0.0
        self._due = False  # before the look: an item that comes in between is seen, or wakes the loop
        self._due = bool(self._items)
        return not self._due


class _Undeclared(NamedTuple):
    """A publisher at a key that is not declared to the engine."""

    put: Callable[[bytes], None]

    def undeclare(self) -> None:
        """Do nothing: the key is not declared."""


class Engine:
    """A session. To open, declare and close may wait for the network: do that in a thread, not on the loop."""

    def __init__(self) -> None:
        try:
            import zenoh  # type: ignore[import-not-found, unused-ignore] # an extra
        except ImportError:
            raise MissingExtra("links to other hosts", "eclipse-zenoh", "zenoh") from None
        _check_version()
        self._zenoh: Any = zenoh
        self._inbox: Inbox
        self._session: Any = None
        self._kept: list[Any] = []
        self._tokens: dict[str, Any] = {}
        self._announcing = threading.Lock()
        self._closed = False
        self._is_client = False
        self.gate: Gate | None = None
        """Decides which messages, questions and tokens are taken; None: all are."""

    def open(self, settings: Mapping[str, Any], inbox: Inbox) -> None:
        """Open the session. LinkError: the engine refuses, for example as a port is in use, or was closed meanwhile.

        A client waits here until it is connected, without a limit where the time to connect is -1.

        Args:
            inbox: hands the items of callbacks over to the loop.
        """
        self._inbox = inbox
        self._is_client = settings.get("mode") == "client"
        waits = self._is_client and settings.get("connect/timeout_ms") == -1
        config = self._zenoh.Config()
        for key, value in {**settings, **({"connect/timeout_ms": _ATTEMPT} if waits else {})}.items():
            config.insert_json5(key, json.dumps(value))
        while self._session is None and not self._is_over:
            try:
                self._session = self._zenoh.open(config)
            except self._zenoh.ZError as error:
                if not waits or _UNREACHED not in str(error):
                    raise LinkError(f"zenoh: {_PLACE.sub('', str(error))}") from None
        if self._is_over:  # while it was opened
            if self._session is not None:
                self._session.close()
            raise LinkError("this kernel ends")
        _open.add(self)

    @property
    def _is_over(self) -> bool:
        """Whether it was closed, or its loop has ended; the interpreter's end waits for the thread that opens it."""
        return self._closed or self._inbox.is_over

    def close(self) -> None:
        """End the session, and with it all that it has declared."""
        self._closed = True
        _open.discard(self)
        if self._session is not None:
            self.announce()
            self._session.close()

    def subscribe(
        self, key: str, arrived: Callable[[str, bytes], None], inbox: Inbox | None = None
    ) -> Callable[[], None]:
        """Call `arrived` with key and bytes of each message, by `inbox` or the general one; return what ends this."""
        put = (inbox or self._inbox).put

        def came(sample: Any) -> None:
            where = str(sample.key_expr)
            if self.gate is None or self.gate.message(where):
                data = sample.payload.to_bytes()
                put(arrived, where, data, size=len(data))

        self._kept.append(subscriber := self._session.declare_subscriber(key, self._direct(came)))
        return lambda: subscriber.undeclare()

    def answer(
        self, key: str, asked: Callable[[str, bytes, bytes, Any], None], inbox: Inbox | None = None
    ) -> Callable[[], None]:
        """Call `asked` with key, body, attachment and `reply`'s query for each question; return what ends this."""
        put = (inbox or self._inbox).put

        def came(query: Any) -> None:
            where = str(query.key_expr)
            beside = b"" if query.attachment is None else query.attachment.to_bytes()
            if self.gate is not None and not self.gate.question(where, beside):
                query.drop()
                return
            body = b"" if query.payload is None else query.payload.to_bytes()
            put(asked, where, body, beside, query, size=len(body) + len(beside))

        self._kept.append(queryable := self._session.declare_queryable(key, self._direct(came), complete=True))
        return lambda: queryable.undeclare()

    def presence(
        self, key: str, present: Callable[[str, bool], None], inbox: Inbox | None = None
    ) -> Callable[[], None]:
        """Call `present` for each token that is there, comes or goes; return what ends this."""
        put = (inbox or self._inbox).put

        def came(sample: Any) -> None:
            token, up = str(sample.key_expr), sample.kind == self._zenoh.SampleKind.PUT
            if self.gate is None or self.gate.token(token, up=up):
                put(present, token, up)

        liveliness = self._session.liveliness()
        self._kept.append(subscriber := liveliness.declare_subscriber(key, self._direct(came), history=True))
        return lambda: subscriber.undeclare()

    def neighbours(self, changed: Callable[[str, str, str, bool], None]) -> None:
        """Call `changed` with the name in the certificate and the addresses of both ends of each connection."""
        put = self._inbox.put

        def came(event: Any) -> None:
            link, up = event.link, event.kind == self._zenoh.SampleKind.PUT
            put(changed, link.auth_identifier or "", str(link.src), str(link.dst), up)

        self._kept.append(self._session.info.declare_link_events_listener(self._direct(came), history=True))

    def announce(self, *tokens: str) -> None:
        """Declare these tokens of this kernel, and end all its others."""
        with self._announcing:
            tokens = () if self._closed else tokens
            for gone in self._tokens.keys() - set(tokens):
                self._tokens.pop(gone).undeclare()
            for token in tokens:
                if token not in self._tokens:
                    self._tokens[token] = self._session.liveliness().declare_token(token)

    def hold(self, token: str) -> Any:
        """Declare a token, such as that of a client's session; `release` of the returned object ends it."""
        return self._session.liveliness().declare_token(token)

    def release(self, held: Any) -> None:
        """End a token that `hold` has declared."""
        if not self._closed:
            held.undeclare()

    def ask_all(
        self, key: str, within: float, answered: Callable[[str, bytes], None], over: Callable[[], None]
    ) -> None:
        """Ask all kernels: call `answered` with key and bytes of each answer, and `over` after the last."""
        put = self._inbox.put

        def came(reply: Any) -> None:
            if reply.ok is not None:
                data = reply.ok.payload.to_bytes()
                put(answered, str(reply.ok.key_expr), data, size=len(data))

        zenoh = self._zenoh
        self._session.get(
            key,
            zenoh.handlers.Callback(came, lambda: put(over), indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,  # else no answer comes before the last
            timeout=within,
            express=True,
        )

    def present(self, key: str, within: float) -> list[str]:
        """The tokens that are there.

        The question is repeated until all have answered and there is a token; a peer, whose neighbours may not know
        yet what is behind them, also waits until two answers are the same. It ends after at most `within`
        seconds, and after `_EMPTY` where all have answered and there is no token.
        """
        began, found = time.monotonic(), set[str]()
        while (left := began + within - time.monotonic()) > 0:
            replies = list(self._session.liveliness().get(key, timeout=left))
            before, now = found, {str(one.ok.key_expr) for one in replies if one.ok is not None}
            found = found | now
            whole = all(one.ok is not None for one in replies)
            if whole and (now if self._is_client else now and now == before):
                break
            if whole and not found and time.monotonic() - began > _EMPTY:
                break
            time.sleep(_AGAIN)
        return sorted(found)

    @property
    def is_heard(self) -> bool:
        """Whether any other kernel or router is reached."""
        info = self._session.info
        return bool(info.peers_zid() or info.routers_zid())

    def publisher(self, key: str, priority: str, *, declared: bool) -> Any:
        """A publisher of bytes at a key; `priority` is the name of a priority of the engine; `declared`: see `expect`.

        `sending` bounds what is under way, so that the engine's queue is never full.
        """
        zenoh = self._zenoh
        how = {"congestion_control": zenoh.CongestionControl.DROP, "priority": getattr(zenoh.Priority, priority)}
        if declared:
            return self._session.declare_publisher(key, **how)
        return _Undeclared(partial(self._session.put, zenoh.KeyExpr(key), **how))

    def expect(self, key: str) -> Callable[[], None]:
        """Declare a key at which messages come to the engine, until the returned function is called.

        For each message with a key that is not declared, the engine has to look up its subscribers.
        """
        known = self._session.declare_keyexpr(key)
        return lambda: self._session.undeclare(known)

    def ask(self, key: str, body: bytes, beside: bytes, within: float, answered: Callable[..., None]) -> None:
        """Ask: call `answered` with True and the answer, or False and a refusal; with None at the end of all."""
        put = self._inbox.put

        def came(reply: Any) -> None:
            good = reply.ok is not None
            data = (reply.ok if good else reply.err).payload.to_bytes()
            put(answered, good, data, size=len(data))

        handler = self._zenoh.handlers.Callback(came, lambda: put(answered, None, b""), indirect=False)
        self._session.get(
            key,
            handler,
            payload=body,
            attachment=beside,
            timeout=within,
            priority=self._zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def put(self, key: str, data: bytes, *, urgent: bool = True) -> None:
        """Put bytes at a key at once, where a `publisher` would not be worth while."""
        zenoh = self._zenoh
        self._session.put(
            key,
            data,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH if urgent else zenoh.Priority.DATA,
            express=True,
        )

    def reply(self, query: Any, data: bytes, *, good: bool, key: str | None = None) -> None:
        """Answer or refuse a question; the answer has a key of its own where the question goes to several kernels."""
        with contextlib.suppress(self._zenoh.ZError):  # the caller is gone
            if good:
                query.reply(key or query.key_expr, data, express=True)
            else:
                query.reply_err(data)
        query.drop()

    def _direct(self, callback: Callable[[Any], None]) -> Any:
        """A callback that runs in the engine's own thread: a further thread would only pass the call on."""
        return self._zenoh.handlers.Callback(callback, indirect=False)


async def in_thread(work: Callable[[], T]) -> T:
    """Return the result of work that a thread of its own does, since it may wait for the network; no cancel stops it.

    The thread ends with the work. Threads of a pool would stay; one that was interrupted at its start would never end.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def settle(give: Callable[[Any], None], what: Any) -> None:
        if not done.done():
            give(what)

    def run() -> None:
        told: tuple[Callable[[Any], None], Any]
        try:
            told = done.set_result, work()
        except BaseException as error:  # noqa: BLE001 - the waiting task hears of any error; also of a panic of the engine
            told = done.set_exception, error
        _inside.discard(thread)
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(settle, *told)

    thread = threading.Thread(target=run, name="aiorts zenoh")
    _inside.add(thread)
    thread.start()
    return await done


_inside: Final[set[threading.Thread]] = set()
"""Threads that may be inside the engine: one still in it after the interpreter's end aborts the process."""
_open: Final[weakref.WeakSet[Engine]] = weakref.WeakSet()
"""Sessions that are not closed yet: a callback of the engine after the interpreter's end aborts the process, too."""


@atexit.register
def _leave() -> None:
    """Wait for the threads, since a second SIGINT ends the interpreter's own wait; close the sessions still open."""
    until = time.monotonic() + _LEAVES
    for thread in tuple(_inside):
        while thread.is_alive() and (left := until - time.monotonic()) > 0:
            with contextlib.suppress(KeyboardInterrupt):
                thread.join(left)
    for engine in tuple(_open):
        with contextlib.suppress(Exception):  # there is no caller any more
            engine.close()


def _check_version() -> None:
    from importlib.metadata import version

    found = version("eclipse-zenoh")
    parts = tuple(int(part) for part in found.split(".")[:2] if part.isdecimal())
    if not LOWEST <= parts < HIGHEST:
        low, high = (".".join(map(str, one)) for one in (LOWEST, HIGHEST))
        raise PluginError(f"eclipse-zenoh {found}: aiorts takes versions from {low} to before {high}")
