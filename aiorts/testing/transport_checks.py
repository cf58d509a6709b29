"""The conformance suite of transports: the promises on which ends of links rely; checked with two simulated kernels.

A channel may lose, double and reorder frames, so a check sends missing frames again. No other fault is accepted.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from aiorts.errors import LinkError, LinkTimeout
from aiorts.links import Caller, LinkOffer, Peer
from aiorts.model.names import Path
from aiorts.model.profile import ConnectorProfile
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.simulation import simulate

if TYPE_CHECKING:
    from aiorts.links import Channel, Transport
    from aiorts.model.links import Buffer

_WAIT_SECONDS: Final = 2.0
_AGAIN_SECONDS: Final = 0.1
_QUIET_SECONDS: Final = 0.05
"""Seconds for which a check waits to see that nothing happens."""
_SLOW_SECONDS: Final = 0.05
"""Seconds allowed for sending a frame: it takes microseconds, and a busy machine may hold up one of three."""
_CLOSE_SECONDS: Final = 5.0
_ENDLESS: Final = 1_024
"""Frames of 64 KiB in one step of the loop: far more than a transport may keep."""

_Frame = tuple[bytes, tuple[bytes, ...]]


class _Case(NamedTuple):
    make_pair: Callable[[], tuple[Transport, Transport]]
    simulated: bool


_SUITE: Suite[_Case] = Suite()


def check_transport(
    make_pair: Callable[[], tuple[Transport, Transport]],
    *,
    simulated: bool = False,
    only: Iterable[str] | None = None,
    skip: Iterable[str] = (),
) -> None:
    """Hold a transport to what the ends of links rely on; `TRANSPORT_CHECKS` lists the promises.

    Args:
        make_pair: makes two transports that are not open yet, for kernels named "one" and "two" that can reach each
            other and no further kernel. It is called once for each check.
        simulated: play in virtual time; only for transports without sockets and threads.
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, what was expected, what happened.
    """
    _SUITE.run(getattr(make_pair, "__name__", "transport"), _Case(make_pair, simulated), only, skip)


class _Face:
    """A stand-in for a kernel, with the part that a transport uses."""

    def __init__(self, name: str, epoch: int) -> None:
        self.name, self.epoch, self.host = name, epoch, "here"
        self.tasks: list[asyncio.Task[Any]] = []

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        self.tasks.append(asyncio.get_running_loop().create_task(coroutine, name=name))
        return self.tasks[-1]

    def report(self, text: str) -> None:
        """Ignore a report."""


class _Events:
    """The end of a link: records its events, in order."""

    def __init__(self) -> None:
        self.frames: list[_Frame] = []
        self.states: list[tuple[bool, str]] = []
        self.rooms = 0
        self.is_sending = False
        self.is_closed = False
        self.faults: list[str] = []

    def _called(self, what: str) -> None:
        if self.is_sending:
            self.faults.append(f"{what} inside send")
        if self.is_closed:
            self.faults.append(f"{what} after close")

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        self._called("on_frames")
        for head, parts in frames:
            if not all(memoryview(one).readonly for one in (head, *parts)):
                self.faults.append("a buffer that can be written to")
            self.frames.append((bytes(head), tuple(bytes(part) for part in parts)))

    def on_room(self) -> None:
        self._called("on_room")
        self.rooms += 1

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        self._called("on_clock")

    def on_state(self, up: bool, why: str) -> None:
        self._called("on_state")
        self.states.append((up, why))

    @property
    def ends(self) -> list[str]:
        """The reasons for which the channel went down."""
        return [why for up, why in self.states if not up]


class _End:
    """One end of a channel."""

    def __init__(self, channel: Channel, events: _Events, others: Sequence[_Events]) -> None:
        self.channel, self.events, self._others = channel, events, others

    def send(self, head: bytes, parts: Sequence[memoryview] = ()) -> bool:
        """Send a frame; an event that is called meanwhile, at any end, is a fault."""
        for one in self._others:
            one.is_sending = True
        taken = self.channel.send(head, parts)
        for one in self._others:
            one.is_sending = False
        return taken

    def close(self) -> None:
        self.channel.close()
        self.events.is_closed = True


class _Pair:
    """Two open transports that have found each other."""

    def __init__(self, one: Transport, two: Transport) -> None:
        self.one, self.two = one, two
        self.faces = _Face("one", 11), _Face("two", 22)
        self.told: tuple[list[tuple[Peer, bool]], list[tuple[Peer, bool]]] = ([], [])
        self.ends: list[_Events] = []

    async def open(self) -> None:
        for transport, face, told in zip((self.one, self.two), self.faces, self.told, strict=True):
            await asyncio.wait_for(transport.open(face), _WAIT_SECONDS)
            transport.presence(lambda peer, up, told=told: told.append((peer, up)))  # type: ignore[misc]
        await _until(lambda: all(self.told), "presence of the other at both kernels")

    @property
    def peer_of_two(self) -> Peer:
        """The kernel "two", as "one" knows it."""
        return self.told[0][0][0]

    @property
    def peer_of_one(self) -> Peer:
        """The kernel "one", as "two" knows it."""
        return self.told[1][0][0]

    async def channel(self, number: int = 1, *, back: bool = False) -> tuple[_End, _End]:
        """The writer's end and the reader's end of a channel from one to two, or back."""
        writer, reader = ("two", "one") if back else ("one", "two")
        offer = LinkOffer(
            protocol=(1, 1),
            link=f"link{number}",
            writer=Path("source0", "out", writer),
            reader=Path("sink0", "inp", reader),
            writer_epoch=11,
            reader_epoch=22,
            number=number,
            schema=bytes(16),
            type_text="TimedLong",
            unit=None,
            shape=None,
            profile=ConnectorProfile(f"link{number}"),
            window=256,
            window_bytes=8 << 20,
        )
        ends = []
        for transport in (self.two, self.one) if back else (self.one, self.two):
            self.ends.append(events := _Events())
            channel = await asyncio.wait_for(transport.channel(offer, events), _WAIT_SECONDS)
            ends.append(_End(channel, events, self.ends))
        return ends[0], ends[1]

    async def close(self) -> None:
        for transport in (self.one, self.two):
            await _closed(transport)


async def _until(met: Callable[[], bool], expected: str, step: Callable[[], object] | None = None) -> None:
    """Wait until `met()` is true; `step` is called at once and every 0.1 s."""
    loop = asyncio.get_running_loop()
    end, again = loop.time() + _WAIT_SECONDS, loop.time()
    while not met():
        if step is not None and loop.time() >= again:
            step()
            again = loop.time() + _AGAIN_SECONDS
        expect(loop.time() < end, f"{expected} within {_WAIT_SECONDS:g} s", "it was not so")
        await asyncio.sleep(0.001)


async def _closed(transport: Transport) -> None:
    try:
        async with asyncio.timeout(_CLOSE_SECONDS):
            await transport.close()
    except TimeoutError:
        expect(False, f"close to end within {_CLOSE_SECONDS:g} s", "it did not")


def _played(check: Callable[[_Pair], Coroutine[Any, Any, None]]) -> Callable[[_Case], None]:
    """Add a check that runs with an open pair; faults that any end of a channel has noted fail it."""

    def run(case: _Case) -> None:
        async def main() -> None:
            pair = _Pair(*case.make_pair())
            try:
                await pair.open()
                await check(pair)
                faults = [fault for events in pair.ends for fault in events.faults]
                expect(not faults, "events in steps of the loop's own, while open, with read-only buffers", str(faults))
            except BaseException:
                # This finding counts, not an error of closing after it; but nothing may be left behind.
                await asyncio.wait((asyncio.ensure_future(pair.close()),), timeout=0.5)
                raise
            await pair.close()

        if case.simulated:
            simulate(main())
        else:
            asyncio.run(main())

    run.__name__, run.__doc__ = check.__name__, check.__doc__
    return _SUITE.check(run)


@_played
async def finds_the_other_kernel(pair: _Pair) -> None:
    """`presence` tells of each kernel once, with name and epoch, and of its end once; when undone it tells nothing."""
    undone: list[tuple[Peer, bool]] = []
    pair.one.presence(lambda peer, up: undone.append((peer, up)))()
    late: list[tuple[Peer, bool]] = []
    pair.one.presence(lambda peer, up: late.append((peer, up)))
    before = len(undone)
    await _until(lambda: bool(late), "presence for who asks later")
    await asyncio.sleep(_QUIET_SECONDS)
    for told, name, epoch in zip((*pair.told, late), ("two", "one", "two"), (22, 11, 22), strict=True):
        got = [(peer.kernel, peer.epoch, up) for peer, up in told]
        expect(got == [(name, epoch, True)], f"{name} of epoch {epoch} once", got)
    await _closed(pair.two)
    await _until(lambda: len(pair.told[0]) > 1, "presence of the end of a kernel")
    expect(pair.told[0][1:] == [(pair.peer_of_two, False)], "the end once", pair.told[0][1:])
    expect(len(undone) == before, "nothing when it was undone", undone[before:])


@_played
async def carries_frames_whole(pair: _Pair) -> None:
    """Heads of any length, alone and with buffers beside them, arrive byte for byte."""
    writer, reader = await pair.channel()
    block, sent = bytes(range(256)) * 64, list[_Frame]()
    for head, parts in (
        (b"a", ()),
        (block * 6, ()),
        (b"b", (block,)),
        (b"c" * 64, (block, b"", block * 64)),
        (b"d", (b"e",) * 100),
    ):
        for near, far in ((writer, reader), (reader, writer)):
            frame = head, parts
            views = [memoryview(part) for part in parts]
            await _until(
                lambda far=far, frame=frame: frame in far.events.frames,  # type: ignore[misc]
                f"a frame of {len(head)} bytes with {len(parts)} parts",
                lambda near=near, head=head, views=views: near.send(head, views),  # type: ignore[misc]
            )
            sent.append(frame)
    strange = [one for end in (writer, reader) for one in end.events.frames if one not in sent]
    expect(not strange, "the frames that were sent", f"{len(strange)} others")
    ends = [why for end in (writer, reader) for why in end.events.ends]
    expect(not ends, "a channel that stays up", str(ends))


@_played
async def takes_arrays_as_they_are(pair: _Pair) -> None:
    """A buffer of several dimensions or of other items than bytes travels as its bytes."""
    import numpy as np

    writer, reader = await pair.channel()
    array = np.arange(6_000.0).reshape(60, 100)
    wanted = b"array", (array.tobytes(),)
    await _until(
        lambda: wanted in reader.events.frames, "the bytes of an array", lambda: writer.send(b"array", [array.data])
    )


@_played
async def keeps_channels_apart(pair: _Pair) -> None:
    """Channels of other numbers, and one of the same number back, get their own frames alone."""
    channels = [await pair.channel(1), await pair.channel(2), await pair.channel(1, back=True)]
    ends = [end for channel in channels for end in channel]
    marks = [bytes([number]) for number in range(len(ends))]

    def send() -> None:
        for end, mark in zip(ends, marks, strict=True):
            end.send(mark)

    await _until(lambda: all(end.events.frames for end in ends), "a frame at each of six ends", send)
    for place, end in enumerate(ends):
        strange = [head for head, _ in end.events.frames if head != marks[place ^ 1]]
        expect(not strange, f"frames of end {place ^ 1} alone", strange)


@_played
async def never_blocks(pair: _Pair) -> None:
    """`send` returns at once, refuses when too much waits, and `on_room` says when it takes frames again."""
    writer, reader = await pair.channel()
    took = []
    for _ in range(3):
        began = time.perf_counter()
        writer.send(b"frame")
        took.append(time.perf_counter() - began)
    expect(min(took) < _SLOW_SECONDS, f"send to return within {_SLOW_SECONDS:g} s", f"{min(took):g} s")
    sent = 0
    while sent < _ENDLESS and writer.send(bytes(65_536)):
        sent += 1
    expect(sent < _ENDLESS, "send to refuse when too much waits", f"{sent} frames of 64 KiB taken")
    expect(writer.events.rooms == 0, "on_room later", "it was called inside send")
    await _until(lambda: writer.events.rooms > 0, "on_room")
    await _until(
        lambda: any(head == b"again" for head, _ in reader.events.frames),
        "a frame after on_room",
        lambda: writer.send(b"again"),
    )


@_played
async def is_silent_when_closed(pair: _Pair) -> None:
    """Nothing is called at a closed end of a channel; other channels go on, also a newer one of the same number."""
    writer, reader = await pair.channel(1)
    other_writer, other_reader = await pair.channel(2)
    await _until(lambda: bool(reader.events.frames), "a frame", lambda: writer.send(b"frame"))
    while writer.send(bytes(65_536)):
        pass
    writer.send(b"under way")
    reader.close()
    writer.close()
    await asyncio.sleep(_QUIET_SECONDS)
    await _until(lambda: bool(other_reader.events.frames), "another channel's frame", lambda: other_writer.send(b"x"))
    newer_writer, newer_reader = await pair.channel(2)
    other_reader.close()
    other_writer.close()
    await _until(lambda: bool(newer_reader.events.frames), "a newer channel's frame", lambda: newer_writer.send(b"y"))


@_played
async def answers_questions(pair: _Pair) -> None:
    """Each question gets its own answer, the handler knows who asks, and one that is unknown, refused or fails is a
    LinkError."""
    callers: list[Caller] = []

    async def echo(body: bytes, caller: Caller) -> bytes:
        callers.append(caller)
        await asyncio.sleep(0.001 * (body[0] % 3))
        return body * 2

    async def refuse(body: bytes, caller: Caller) -> bytes:
        raise LinkError("not on a Sunday")

    async def fail(body: bytes, caller: Caller) -> bytes:
        raise ValueError("a fault of the handler")

    pair.two.answer("echo", echo)
    pair.two.answer("refuse", refuse)
    pair.two.answer("fail", fail)
    bodies = [bytes([number]) * 100 for number in range(100)]
    asked = [pair.one.ask(pair.peer_of_two, "echo", body, within=_WAIT_SECONDS) for body in bodies]
    answers = await asyncio.gather(*asked)
    expect(answers == [body * 2 for body in bodies], "each its own answer", "another one")
    who = {(caller.peer.kernel, caller.peer.epoch) if caller.peer is not None else None for caller in callers}
    expect(who == {("one", 11)}, "one as the caller", who)
    expect(all(caller.identity for caller in callers), "an identity of the caller", "none")
    for what, text in (("refuse", "Sunday"), ("fail", ""), ("no such question", "")):
        said = await _refusal(pair, what)
        expect(text in said, f"the reason {text!r}", said)


async def _refusal(pair: _Pair, what: str) -> str:
    """The reason why a question was not answered."""
    try:
        await pair.one.ask(pair.peer_of_two, what, b"?", within=_WAIT_SECONDS)
    except LinkTimeout:
        expect(False, f"{what!r} refused at once", "a time-out")
    except LinkError as error:
        return str(error)
    expect(False, f"LinkError for {what!r}", "an answer")
    return ""


@_played
async def answers_beside_samples(pair: _Pair) -> None:
    """Questions are answered in either direction while channels are full."""

    async def echo(body: bytes, caller: Caller) -> bytes:
        return body

    for transport in (pair.one, pair.two):
        transport.answer("echo", echo)
    for end in await pair.channel():
        sent = 0
        while sent < _ENDLESS and end.send(bytes(65_536)):
            sent += 1
    ways = (pair.one, pair.peer_of_two), (pair.two, pair.peer_of_one)
    try:
        asked = [transport.ask(peer, "echo", b"beside", within=_WAIT_SECONDS) for transport, peer in ways]
        answers = await asyncio.gather(*asked)
    except LinkError as error:
        expect(False, "an answer", f"{type(error).__name__}: {error}")
    else:
        expect(answers == [b"beside"] * 2, "an answer each", answers)


@_played
async def keeps_to_its_time(pair: _Pair) -> None:
    """A question without an answer ends in LinkTimeout when its time is over, and its late answer is ignored."""
    held = asyncio.Event()

    async def hold(body: bytes, caller: Caller) -> bytes:
        await held.wait()
        return body

    pair.two.answer("hold", hold)
    loop = asyncio.get_running_loop()
    began = loop.time()
    try:
        await pair.one.ask(pair.peer_of_two, "hold", b"early", within=0.05)
    except LinkTimeout:
        took = loop.time() - began
        expect(0.04 <= took <= 1.0, "LinkTimeout after 0.05 s", f"after {took:g} s")
    else:
        expect(False, "LinkTimeout", "an answer")
    held.set()
    answer = await pair.one.ask(pair.peer_of_two, "hold", b"late", within=_WAIT_SECONDS)
    expect(answer == b"late", "the answer of the second question", answer)


@_played
async def tells_of_the_end(pair: _Pair) -> None:
    """When the other kernel ends, each channel is told once, and sending, asking and opening fail at once."""
    writer, _reader = await pair.channel()
    peer = pair.peer_of_two
    await _closed(pair.two)
    writer.send(b"too early to know")  # it may find out here, but has to say so later
    await _until(lambda: bool(writer.events.ends), "on_state(False, why)")
    expect(bool(writer.events.ends[0]), "a reason", "none")
    expect(not writer.send(b"gone"), "send to take nothing any more", "True")
    try:
        await pair.one.ask(peer, "anything", b"", within=_WAIT_SECONDS)
    except LinkTimeout:
        expect(False, "LinkError at once", "a time-out")
    except LinkError:
        pass
    else:
        expect(False, "LinkError", "an answer")
    try:
        await pair.channel(2)
    except LinkError:
        pass
    else:
        expect(False, "LinkError for a channel to a kernel that has ended", "a channel")
    await asyncio.sleep(_QUIET_SECONDS)
    expect(len(writer.events.ends) == 1, "one on_state(False, why)", len(writer.events.ends))


@_played
async def fails_what_is_not_answered(pair: _Pair) -> None:
    """When the other kernel ends, what it was asked and has not answered ends in LinkError, long before its time."""
    asked = asyncio.Event()

    async def never(body: bytes, caller: Caller) -> bytes:
        asked.set()
        await asyncio.Event().wait()
        return body

    pair.two.answer("never", never)
    questions = [
        asyncio.ensure_future(pair.one.ask(pair.peer_of_two, "never", b"", within=2 * _WAIT_SECONDS)) for _ in range(3)
    ]
    await _until(asked.is_set, "a question to arrive")
    await _closed(pair.two)
    await asyncio.wait(questions, timeout=_WAIT_SECONDS)
    for question in questions:
        if not question.done():
            question.cancel()
            expect(False, "LinkError when the other kernel has ended", "nothing")
        error = question.exception()
        expect(isinstance(error, LinkError) and not isinstance(error, LinkTimeout), "LinkError", repr(error))
    for task in pair.faces[1].tasks:
        task.cancel()


@_played
async def ends_in_time(pair: _Pair) -> None:
    """Closed within 5 s with channels full and questions open, which end in LinkError; no task or thread is left."""
    threads, own = set(threading.enumerate()), asyncio.current_task()
    writer, _reader = await pair.channel()

    async def never(body: bytes, caller: Caller) -> bytes:
        await asyncio.Event().wait()
        return body

    pair.two.answer("never", never)
    asked = asyncio.ensure_future(pair.one.ask(pair.peer_of_two, "never", b"", within=600.0))
    asked.add_done_callback(lambda task: task.cancelled() or task.exception())
    await _until(lambda: bool(pair.faces[1].tasks), "the question to arrive")
    sent = 0
    while sent < _ENDLESS and writer.send(bytes(65_536)):
        sent += 1
    await pair.close()
    await asyncio.wait((asked,), timeout=_WAIT_SECONDS)
    expect(asked.done() and isinstance(asked.exception(), LinkError), "LinkError for the open question", asked)
    for task in pair.faces[1].tasks:
        task.cancel()
    await asyncio.wait(pair.faces[1].tasks, timeout=_WAIT_SECONDS)
    left = [task.get_name() for task in asyncio.all_tasks() if task is not own]
    expect(not left, "no task left", ", ".join(left))
    others = set(threading.enumerate()) - threads
    for one in others:
        one.join(_WAIT_SECONDS)  # one that has done its work needs a moment to end
    left = [one.name for one in others if one.is_alive()]
    expect(not left, "no thread left", ", ".join(left))


TRANSPORT_CHECKS: Mapping[str, str] = _SUITE.promises
"""The promises that `check_transport` demands: name of the check -> promise."""
