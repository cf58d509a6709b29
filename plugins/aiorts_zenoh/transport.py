"""Carries links between kernels of several hosts. See `aiorts.links.Transport`."""

from __future__ import annotations

import asyncio
import socket
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any, Final

from aiorts.errors import DeniedError, LinkError
from aiorts.links import (
    Allowed,
    BaseChannel,
    BaseTransport,
    Caller,
    Channel,
    ChannelEvents,
    KernelFace,
    LinkOffer,
    Peer,
    Turn,
    turn_of,
)
from aiorts_zenoh.clocks import ClockOffset
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.envelope import FRAME, PIECE, TAKEN, Whole, frame_of, message, read
from aiorts_zenoh.gate import Gate
from aiorts_zenoh.keys import BY_READER, BY_WRITER, ClientKeys, Keys, asked
from aiorts_zenoh.presence import AnyName, Presence, Trust, this_machine
from aiorts_zenoh.sending import Budgets, Receiver, Sender
from aiorts_zenoh.sessions import Sessions

_LOOK_AGAIN: Final = 0.5
"""Seconds until the other end is asked again how far it has come."""
_ASK_AGAIN: Final = 0.05
"""Seconds until a question that found no kernel is asked again: the kernel may not be known everywhere yet."""
_ASKED: Final = 1_000
"""The most questions that are being answered, and the most answers that are kept."""
_KEPT: Final = 65_536
"""The most bytes of an answer that is kept, for a question that comes twice."""
_CLOCK: Final = "clock"
"""The question for the time of the other kernel."""
_COMPARED: Final = 1.0
"""Seconds between two questions for the time."""
_UNKNOWN: Final = 1 << 62
"""The possible error of another machine's time before the first answer, in ns."""
_CLOSES: Final = 3.0
_SHORT: Final = 4_096
"""The most bytes of a message that is always read quickly, whatever is in it."""
_MARGIN: Final = 1.0
"""Seconds that the engine keeps a question longer than the caller waits."""
_GIVEN: Final = 10 << 16
"""Bytes of questions and answers that the engine surely has room for: its queue has 16 times 64 KiB."""
_DECLARED: Final = 32
"""The most links with one other kernel whose keys are declared to the engine: the first ones.

The engine finds the way of a message with such a key at once. It compares any other key with each declared one of the
same two kernels, 32 in some 15 us. But a declaration takes longer the more there are: some ms with 3,000.
"""


class ZenohTransport(BaseTransport["_ZenohChannel"]):
    """Carries links to kernels that a Zenoh session reaches.

    Args:
        host: the name by which others know this machine.
        domain: kernels of different domains do not see each other.
        engine: settings of the engine by their keys; `aiorts_zenoh.network` makes them.
        machine: a number that tells machines apart; by default that of this one.
        now: the clock of the stamps, in ns since 1970.
        rename: whether the kernel takes another name here where a kernel of this host has its own.

    Raises:
        MissingExtra: the engine is not installed.
        PluginError: the engine is of a version that is not known here.
    """

    def __init__(
        self,
        host: str,
        domain: str = "default",
        engine: Mapping[str, Any] | None = None,
        machine: int | None = None,
        now: Callable[[], int] = time.time_ns,
        *,
        rename: bool = False,
    ) -> None:
        super().__init__()
        self.host, self.domain, self._renames = host, domain, rename
        self._machine = this_machine() if machine is None else machine
        self._settings, self.engine = dict(engine or {}), Engine()
        self.answer(_CLOCK, self._tell_time)
        self._now = now
        self._clocks: dict[Peer, ClockOffset] = {}
        """The clocks of the peers whose links end here."""
        self._comparing: asyncio.TimerHandle | None = None
        self._named: Counter[str] = Counter()
        """The peers, as host/kernel; the engine's threads look into it."""
        self._bad: set[Peer] = set()
        """Peers that have sent bytes that are no message; each is reported once."""
        self._gate: Gate
        self._answers: OrderedDict[tuple[str, bytes, int], asyncio.Future[tuple[bool, bytes]]] = OrderedDict()
        """The answers to the last questions, by the caller and its number: a question that comes twice is answered
        once."""
        self._answering = 0
        """Questions that are being answered."""
        self._news = asyncio.Event()
        """Set, and replaced by a new one, when there is another kernel."""
        self._ways: dict[Peer, _Way] = {}
        self._looking: asyncio.TimerHandle | None = None
        self._closed = False
        self._inbox: Inbox | None = None
        self.beside: list[Callable[[Engine, Keys], None]] = []
        """Further declarations, besides links, before others see this kernel; called in a thread."""
        self.anew: list[Callable[[Engine, Keys], None]] = []
        """Declarations that are repeated where this kernel takes another name; called in a thread."""
        self._ends: list[Callable[[], None]] = []
        """Functions that end the declarations under the name of this kernel."""
        self.known_as = ""
        """The name of this kernel here, where it is not its own."""
        self.last: list[Callable[[], None]] = []
        """Called before the session ends, in a thread; each may wait a moment."""
        self.sessions_denied = ""
        """The reason why this kernel may not ask others for operations; "" where it may."""
        self.trust: Trust = AnyName()
        """The rules of which kernels may be there, and which may tell of others."""
        self.allowed = Allowed()
        """The rights of other kernels to ports of this kernel."""
        self.keys: Keys
        self._sessions: Sessions
        self._presence: Presence | None = None

    async def open(self, kernel: KernelFace) -> None:
        """Open the session, and say that this kernel is there.

        Raises:
            LinkError: the engine refuses.
        """
        self.begin(kernel)
        own = Peer(self.host, kernel.name, kernel.epoch)
        self.keys = Keys(self.domain, own, time.time_ns(), self._machine)
        self._sessions = Sessions(self.engine, ClientKeys(self.domain, kernel.name))
        self._inbox = Inbox(self.loop)
        self.engine.gate = self._gate = Gate(lambda name: name in self._named, self._say)
        connects, listens = (bool(self._settings.get(f"{what}/endpoints")) for what in ("connect", "listen"))
        self._presence = Presence(
            self.engine,
            self.keys,
            kernel,
            self._present,
            connects=connects,
            listens=listens,
            trust=self.trust,
            renamed=self._renamed if self._renames else None,
        )
        try:
            await in_thread(self._declare)
        except BaseException:
            await self.close()
            raise
        self._presence.claim()

    def _declare(self) -> None:
        engine, keys = self.engine, self.keys
        assert self._inbox is not None  # noqa: S101 - both were made just before
        assert self._presence is not None  # noqa: S101
        engine.open(self._settings, self._inbox)
        # A kernel that sees the token may ask at once: so the token comes last.
        self._declare_links(keys)
        if not self.sessions_denied:
            self._sessions.declare()
        for declare in self.beside:
            declare(engine, keys)
        self._presence.declare()

    def _declare_links(self, keys: Keys) -> None:
        self._ends = [self.engine.subscribe(key, self._arrived) for key in keys.frames]
        self._ends.append(self.engine.answer(keys.questions, self._was_asked))

    def _renamed(self, keys: Keys) -> None:
        """Take another name: other kernels have not seen it yet, and do not see the former one any more."""
        for end in self._ends:
            end()  # messages there are for the kernel that has the name
        self.keys, self.known_as = keys, keys.own.kernel
        self._declare_links(keys)
        for declare in self.anew:
            declare(self.engine, keys)

    async def close(self) -> None:
        """End the session, and all links and questions. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self.end_all()
        for task in self._answers.values():
            task.cancel()
        if self._looking is not None:
            self._looking.cancel()
        if self._comparing is not None:
            self._comparing.cancel()
        if self._presence is not None:
            self._presence.close()
        if self._inbox is not None:
            self._inbox.close()
        try:
            async with asyncio.timeout(_CLOSES):
                await in_thread(self._end)
        except TimeoutError:
            self.kernel.report(f"zenoh: the session has not ended within {_CLOSES:g} s")

    def _end(self) -> None:
        for finish in self.last:
            finish()
        self.engine.close()

    # -- other kernels ---------------------------------------------------------------------------------------------

    @property
    def own(self) -> Peer:
        """This kernel, which may have another name here."""
        return self.keys.own

    @property
    def left_out(self) -> int:
        """Messages that found no room, as too many waited for the loop: the ends of their links send them again."""
        return 0 if self._inbox is None else self._inbox.dropped

    @property
    def standing(self) -> str:
        """The standing of this kernel with its name: claims, owns, withdrawn or refused."""
        return "" if self._presence is None else self._presence.standing.value

    @property
    def cut_off(self) -> Collection[str]:
        """The peers that were beyond a limit, and are not heard for a while."""
        return () if self._inbox is None else self._gate.cut_off

    def deny(self, name: str) -> None:
        """Take kernels of this name, which is not admitted any more, as gone."""
        if self._presence is not None:
            self._presence.forget(name)

    def _say(self, text: str) -> None:
        """Log a warning; from any thread."""
        if self._inbox is not None:
            self._inbox.put(self.kernel.report, text)

    def _present(self, peer: Peer, up: bool) -> None:
        name = f"{peer.host}/{peer.kernel}"
        if up:
            self._ways[peer] = _Way()
            self._named[name] += 1
            self._have_looked()
            return self.found(peer)
        del self._ways[peer]
        self._named[name] -= 1
        if not self._named[name]:
            del self._named[name]
        self._bad.discard(peer)
        self._clocks.pop(peer, None)
        self.lost(peer, "is gone")
        return self._sessions.end(peer)

    def presence(self, tell: Callable[[Peer, bool], None]) -> Callable[[], None]:
        remove = super().presence(tell)
        self._have_looked()
        return remove

    def _have_looked(self) -> None:
        """Wake the answers that wait until the kernel that asks is known, and let them look again."""
        self._news.set()
        self._news = asyncio.Event()

    # -- channels --------------------------------------------------------------------------------------------------

    async def channel(self, offer: LinkOffer, events: ChannelEvents) -> Channel:
        """The channel of an offer, which both ends have agreed on.

        Raises:
            LinkError: the other kernel is gone.
        """
        own, (peer, writes) = self.own, self.far_end(offer)
        ends = (own, peer) if writes else (peer, own)
        # The reader has chosen the number: a link with another kernel may have the same number.
        mine, theirs = (BY_WRITER, BY_READER) if writes else (BY_READER, BY_WRITER)
        at, of = (self.keys.link(*ends, str(offer.number), sender) for sender in (mine, theirs))
        self.drop(of)
        budgets = self._ways[peer].budgets
        declared = budgets.count < _DECLARED
        priority = _priority(offer) if writes else "INTERACTIVE_HIGH"
        channel = _ZenohChannel(
            [self.engine.publisher(at, one, declared=declared) for one in (priority, "INTERACTIVE_HIGH")],
            budgets,
            peer,
            writes,
            offer.writer_epoch & 0xFFFFFFFF,
            events,
            partial(self._closed_at, of, peer),
            self.engine.expect(of) if declared else None,
        )
        self.keep(of, channel)
        if self._looking is None:
            self._looking = self.loop.call_later(_LOOK_AGAIN, self._look_again)
        if not writes:
            self.loop.call_soon(self._compares, channel)
        return channel

    def _closed_at(self, key: str, peer: Peer) -> None:
        self.forget(key)
        if not self._closed:
            self.loop.call_soon(self._pump, peer)  # the room of what it had under way is free for others

    def _arrived(self, key: str, data: bytes) -> None:
        channel = self.channels.get(key)
        if self._closed:
            return
        began = time.thread_time_ns() if len(data) > _SHORT else 0  # a look at the clock takes a microsecond
        try:
            if channel is None:
                read(data)
            elif channel.arrived(data):
                self._pump(channel.peer)
        except ValueError as error:
            self._gate.was_bad(key)
            if channel is not None and channel.peer not in self._bad:
                self._bad.add(channel.peer)
                self.kernel.report(f"zenoh: {channel.peer.kernel} sent what is no message: {error}")
        finally:
            if began:
                size = len(data)
                if channel is not None:
                    size, channel.came = max(size, channel.came), 0
                self._gate.took(key, size, time.thread_time_ns() - began)

    def _pump(self, peer: Peer) -> None:
        if (way := self._ways.get(peer)) is not None:
            way.budgets.pump()

    def _look_again(self) -> None:
        """Ask again how far other kernels are: frames that wait for room must not wait for an answer that was lost."""
        self._looking = self.loop.call_later(_LOOK_AGAIN, self._look_again) if self.channels else None
        for way in self._ways.values():
            way.budgets.look_again()

    # -- clocks ----------------------------------------------------------------------------------------------------

    def _compares(self, channel: _ZenohChannel) -> None:
        """Compare the clocks of this end and the writer's from now on."""
        if not channel.is_open:
            return
        clock = self._clocks.get(channel.peer)
        if clock is None or (offset := clock.at(self._now())) is None:
            channel.events.on_clock(0, _UNKNOWN)
            self._clocks[channel.peer] = ClockOffset()
            self.kernel.run_in_background(self._compare(channel.peer), "aiorts clock")
        else:
            channel.events.on_clock(*offset)
        if self._comparing is None:
            self._comparing = self.loop.call_later(_COMPARED, self._compare_all)

    def _compare_all(self) -> None:
        self._comparing = self.loop.call_later(_COMPARED, self._compare_all) if self.channels else None
        for peer in {channel.peer for channel in self.channels.values()} & self._clocks.keys():
            self.kernel.run_in_background(self._compare(peer), "aiorts clock")

    async def _compare(self, peer: Peer) -> None:
        asked = self._now()
        try:
            answer = await self.ask(peer, _CLOCK, b"", within=_COMPARED)
        except LinkError:
            return
        clock, now = self._clocks.get(peer), self._now()
        if clock is None or len(answer) != 8:
            return
        clock.add(asked, int.from_bytes(answer, "little", signed=True), now)
        if (offset := clock.at(now)) is not None:
            for channel in tuple(self.channels.values()):
                if channel.peer == peer and channel.is_open:
                    channel.events.on_clock(*offset)

    async def _tell_time(self, _: bytes, caller: Caller) -> bytes:
        return self._now().to_bytes(8, "little", signed=True)

    # -- questions -------------------------------------------------------------------------------------------------

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        """The answer of another kernel.

        Raises:
            LinkTimeout: there was none within so many seconds.
            LinkError: the kernel is gone, or refuses to answer.
        """
        until = self.loop.time() + within
        key, own = self.keys.question(peer, what), self.own

        def begin(number: int) -> None:
            epoch, beside = own.epoch.to_bytes(8, "little"), number.to_bytes(8, "little")
            beside = epoch + beside + f"{own.host}/{own.kernel}".encode()

            def answered(good: bool | None, data: bytes) -> None:
                if good is not None:
                    if peer in self._ways:
                        self._ways[peer].given = 0
                    self.settle(peer, number, good, data)
                elif (left := until - self.loop.time()) > _ASK_AGAIN:
                    # No kernel has answered: the kernel that will answer may not be known here yet.
                    self.loop.call_later(_ASK_AGAIN, again, left)

            def give(left: float) -> None:
                if self.is_awaited(number):  # else an old offer would come after the new one, and count
                    self.engine.ask(key, body, beside, left + _MARGIN, answered)

            def again(left: float) -> None:
                if self.is_awaited(number) and not self._closed:
                    self._give(peer, len(body), partial(give, left))

            again(within)

        return await self.asked(peer, within, begin)

    async def session(self, peer: Peer) -> socket.socket:
        """A connection for a session with another kernel: this kernel operates it if permitted, else looks.

        Raises:
            DeniedError: its own certificate lets this kernel do neither.
        """
        if self.sessions_denied:
            raise DeniedError(f"{peer.host}/{peer.kernel}: {self.sessions_denied}")
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setblocking(False)
        reader, writer = await asyncio.open_unix_connection(sock=theirs)
        self.kernel.run_in_background(self._sessions.carry(peer, reader, writer), "aiorts session")
        return ours

    def _was_asked(self, key: str, body: bytes, beside: bytes, query: Any) -> None:
        if self._closed:
            return
        if self._answering >= _ASKED:  # refused here and now, it costs no task
            self.engine.reply(query, b"too many questions at the same time", good=False)
            return
        self._answering += 1
        self.kernel.run_in_background(self._answer(key, body, beside, query), "aiorts answer").add_done_callback(
            self._answered
        )

    def _answered(self, _: object) -> None:
        self._answering -= 1

    async def _answer(self, key: str, body: bytes, beside: bytes, query: Any) -> None:
        name, what = asked(key)
        who, number = beside[:8] + beside[16:], int.from_bytes(beside[8:16], "little")
        asking = name, who, number  # the name is in the key, where it cannot be another's
        if (peer := self._who(name, who)) is not None:
            self._ways[peer].given = 0
        found = self._answers.get(asking)
        if found is None:
            found = self._answers[asking] = asyncio.ensure_future(self._answer_of(name, what, body, who))
            if len(self._answers) > _ASKED:
                self._forget_answers()
        good, data = await asyncio.shield(found)
        self._give(self._who(name, who), len(data), partial(self.engine.reply, query, data, good=good))
        if len(data) > _KEPT and self._answers.get(asking) is found:
            self._answers[asking] = late = self.loop.create_future()
            late.set_result((False, b"it was answered, and the answer was too long to be kept"))

    async def _answer_of(self, name: str, what: str, body: bytes, who: bytes) -> tuple[bool, bytes]:
        try:
            async with asyncio.timeout(_MARGIN):
                while (peer := self._who(name, who)) is None or not self.is_watched:
                    await self._news.wait()  # the kernel's token is on its way, or no callback for peers is there yet
        except TimeoutError:
            return False, b"who asks is not known here"
        return await self.answer_to(what, body, Caller(peer, f"kernel {peer.host}/{peer.kernel}", self.allowed))

    def _give(self, peer: Peer | None, size: int, work: Callable[[], None]) -> None:
        """Give a question or answer to the engine, at once where the engine has room for it."""
        way = None if peer is None else self._ways.get(peer)
        if way is None or (not way.turn.locked() and way.takes(size)):
            work()
        else:
            self.kernel.run_in_background(self._give_in_turn(way, size, work), "aiorts question")

    async def _give_in_turn(self, way: _Way, size: int, work: Callable[[], None]) -> None:
        async with way.turn:
            if self._closed:
                return
            if way.takes(size):  # the other kernel was heard meanwhile
                work()
            else:
                await in_thread(work)

    def _forget_answers(self) -> None:
        """Forget the oldest answers that were given; answers not given yet are looked at again after all later ones."""
        for key in tuple(islice(self._answers, _ASKED // 2)):
            if self._answers[key].done():
                del self._answers[key]
            else:
                self._answers.move_to_end(key)

    def _who(self, name: str, who: bytes) -> Peer | None:
        """The kernel that asks: its name is in the key, where it cannot be another's."""
        host, _, kernel = who[8:].decode(errors="replace").partition("/")
        peer = Peer(host, kernel, int.from_bytes(who[:8], "little"))
        return peer if kernel == name and peer in self._ways else None


class _Way:
    """The way to one kernel. A question or answer for which the engine has no room waits in a thread, not on the
    loop."""

    def __init__(self) -> None:
        self.budgets = Budgets()
        self.turn = asyncio.Lock()
        """Held while a question or answer waits; all others to this kernel wait for the lock."""
        self.given = 0
        """Bytes that the engine was given since anything was heard of the kernel."""

    def takes(self, size: int) -> bool:
        """Whether the engine surely has room for so many bytes more."""
        self.given += size
        return self.given <= _GIVEN


def _priority(offer: LinkOffer) -> str:
    """The priority of a link's samples: where only the newest counts, they wait for those of other links."""
    return "DATA_LOW" if offer.profile.push == "new" else "DATA"


class _ZenohChannel(BaseChannel):
    """One end of a link."""

    def __init__(
        self,
        publishers: Sequence[Any],
        budgets: Budgets,
        peer: Peer,
        writes: bool,
        epoch: int,
        events: ChannelEvents,
        closed: Callable[[], object],
        ignore: Callable[[], None] | None,
    ) -> None:
        super().__init__(peer, events, closed)
        self._epoch, self._ignore = epoch, ignore
        self._publisher, self._urgent = publishers
        mine, theirs = budgets.both if writes else reversed(budgets.both)
        self.sender = Sender(mine, self._publisher.put, epoch, time.time_ns, events.on_room)
        self._receiver, self._whole = Receiver(theirs, self._tell), Whole()
        self._writes = writes
        self.came = 0
        """Bytes of the long frame that the last message completed."""

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        if not self.is_open:
            return False
        is_urgent = self._writes and turn_of(head) is Turn.CONTROL
        if not parts and not is_urgent and self.sender.send_alone(head):
            return True
        if is_urgent:
            # This message is not in the queue of the samples, and may overtake them: its cost does not count there.
            self._urgent.put(message(FRAME, self._epoch, 0, time.time_ns(), (head,)))
            return True
        if not parts:
            return self.sender.send((head,))
        flat = [part.cast("B") if part.format != "B" or part.ndim != 1 else part for part in parts]
        return self.sender.send([head, *flat])

    def arrived(self, data: bytes) -> bool:
        """Handle a message; return whether others may be sent now. ValueError: the bytes are no message."""
        if (found := frame_of(data, self._epoch)) is not None:
            self.events.on_frames(((found[1], ()),))
            if self.is_open:
                self._receiver.took(found[0], len(data))  # last: it may put a message, which no frame waits for
            return False
        kind, epoch, first, _, blocks = read(data)
        if epoch != self._epoch:
            return False
        if kind <= PIECE:
            frame = blocks if kind == FRAME else self._whole.add(blocks)
            if frame:
                if kind == PIECE:
                    self.came = sum(map(len, frame))
                self.events.on_frames(((frame[0], frame[1:]),))
            if self.is_open:
                self._receiver.took(first, len(data))  # as above
            return False
        if kind == TAKEN:
            self.sender.came(first)
            return True
        self._receiver.asked(first)
        return False

    def _tell(self, taken: int) -> None:
        self._urgent.put(message(TAKEN, self._epoch, taken, time.time_ns()))

    def close(self) -> None:
        if not self.is_open:
            return
        super().close()
        self.sender.close()
        self._receiver.close()
        if self._ignore is not None:
            self._ignore()
        for publisher in (self._publisher, self._urgent):
            publisher.undeclare()
