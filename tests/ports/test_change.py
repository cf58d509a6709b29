"""`Connector.change`: options change while connected; nothing is lost, and a change is whole or is refused."""

from __future__ import annotations

import asyncio
import logging
import random
import threading
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts import (
    Component,
    Connector,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    Supervision,
    ThreadContext,
)
from aiorts.errors import ClosedError, StateError, ThreadError, WiringError, WriteTimeout
from aiorts.events import ConnectorChanged
from aiorts.kernel.ports.connector import transport_of, unread_of
from aiorts.testing import simulated
from aiorts.types import TimedLong
from ports.parts import Sink, Source, data, long


def counts(connector: Connector) -> tuple[int, int, int, dict[str, int]]:
    """Written, delivered, buffered, dropped."""
    ledger = connector.statistics
    assert ledger.balanced
    return ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)


async def connected(kernel: Kernel, **options: Any) -> tuple[Source, Sink, Connector]:
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    return source, sink, await kernel.connect(source.out, sink.inp, **options)


def write(source: Source, *numbers: int) -> list[bool | None]:
    """What each write returned; None where it would block."""
    results: list[bool | None] = []
    for number in numbers:
        try:
            results.append(source.out.write_nowait(long(number)))
        except WouldBlock:
            results.append(None)
    return results


async def waiting(source: Source, *numbers: int) -> list[asyncio.Task[bool]]:
    """Writers that wait for room, in this order."""
    tasks = [asyncio.create_task(source.out.write(long(number))) for number in numbers]
    await asyncio.sleep(0)
    return tasks


async def ended(tasks: list[asyncio.Task[bool]]) -> list[bool]:
    """Which of them have ended."""
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return [task.done() and task.result() for task in tasks]


def test_a_connector_has_these_public_names_and_no_other() -> None:
    """A name that users complete is kept for good."""
    names = {name for name in dir(Connector) if not name.startswith("_")}
    assert names == {"name", "profile", "statistics", "timing", "closed", "out", "in_", "close", "change", "parked"}


# -- length ------------------------------------------------------------------------------------------------------------


@simulated
async def test_a_smaller_length_keeps_what_is_unread_and_overwrites_one_for_one() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=5)
        write(source, 1, 2, 3, 4, 5)
        wire.change(length=2)
        assert counts(wire) == (5, 0, 5, {})
        assert write(source, 6) == [True]
        assert counts(wire) == (6, 0, 5, {"overwritten": 1})
        assert data([sink.inp.read_nowait() for _ in range(4)]) == [2, 3, 4, 5]
        assert write(source, 7, 8) == [True, True]  # room for one
        assert data(sink.inp.drain()) == [7, 8]
        assert counts(wire) == (8, 6, 0, {"overwritten": 2})


@simulated
async def test_a_smaller_length_rejects_until_there_is_room_by_it() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=4, full="reject")
        write(source, 1, 2, 3, 4)
        wire.change(length=2)
        assert write(source, 5) == [False]
        sink.inp.read_nowait()
        sink.inp.read_nowait()
        assert write(source, 6) == [False]
        sink.inp.read_nowait()
        assert write(source, 7, 8) == [True, False]
        assert data(sink.inp.drain()) == [4, 7]


@simulated
async def test_a_smaller_length_has_writers_wait_until_fewer_than_it_are_unread() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=4, full="block", timeout=None)
        write(source, 1, 2, 3, 4)
        tasks = await waiting(source, 5, 6)
        wire.change(length=2)
        got = []
        for expected in ([False, False], [False, False], [True, False], [True, True]):
            got.append(sink.inp.read_nowait())
            assert await ended(tasks) == expected
        assert data(got + sink.inp.drain()) == [1, 2, 3, 4, 5, 6]


@simulated
async def test_a_larger_length_lets_waiting_writers_in_at_once_as_far_as_there_is_room() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        write(source, 1)
        tasks = await waiting(source, 2, 3, 4)
        wire.change(length=3)
        assert counts(wire) == (3, 0, 3, {})
        assert await ended(tasks) == [True, True, False]
        assert write(source, 9) == [None]
        assert sink.inp.read_nowait().data == 1
        assert await ended(tasks) == [True, True, True]
        assert data(sink.inp.drain()) == [2, 3, 4]


@pytest.mark.parametrize("options", [{"dataflow": "pull"}, {"subscription": "new"}], ids=["pull", "push new"])
@simulated
async def test_a_length_that_chooses_nothing_is_in_the_profile_and_warned_of(
    options: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, **options)
        write(source, 1, 2)
        wire.change(length=4)
        assert wire.profile.length == 4
        assert "W-OPTION: source.out-sink.inp: length chooses nothing where " in caplog.text
        write(source, 3)
        assert data(sink.inp.drain()) == [3]
        assert counts(wire) == (3, 1, 0, {"superseded": 2})


# -- full --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("full", ["overwrite", "reject"])
@simulated
async def test_from_block_writers_that_wait_are_let_in_first_in_order_also_beyond_the_length(full: Any) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=2, full="block", timeout=None)
        write(source, 1, 2)
        tasks = await waiting(source, 3, 4, 5)
        wire.change(full=full, length=1)
        assert counts(wire) == (5, 0, 5, {})
        assert await ended(tasks) == [True, True, True]
        assert (wire.profile.full, wire.profile.length) == (full, 1)
        assert write(source, 6) == [full == "overwrite"]
        assert data(sink.inp.drain()) == ([2, 3, 4, 5, 6] if full == "overwrite" else [1, 2, 3, 4, 5])


@simulated
async def test_to_block_a_full_buffer_has_writers_wait() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=2)
        write(source, 1, 2, 3)
        wire.change(full="block")
        assert write(source, 4) == [None]
        (task,) = await waiting(source, 5)
        assert data([sink.inp.read_nowait()]) == [2]
        await task
        with pytest.raises(WriteTimeout):
            await source.out.write(long(6))
        assert data(sink.inp.drain()) == [3, 5]
        assert counts(wire) == (5, 3, 0, {"overwritten": 1, "timeout": 1})


@simulated
async def test_a_write_that_waits_for_two_readers_goes_on_when_both_have_changed() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        other = await kernel.add(Sink("other"))
        second = await kernel.connect(source.out, other.inp, length=1, full="block", timeout=None)
        write(source, 1)
        tasks = await waiting(source, 2)
        wire.change(full="overwrite")
        assert await ended(tasks) == [False]
        second.change(full="reject")
        assert await ended(tasks) == [True]
        assert data(sink.inp.drain()) == data(other.inp.drain()) == [1, 2]


# -- several connectors, listeners, skip -------------------------------------------------------------------------------


@simulated
async def test_with_several_writers_the_order_of_arrival_stays() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=3, full="block", timeout=None)
        other = await kernel.add(Source("other"))
        second = await kernel.connect(other.out, sink.inp, length=3)
        write(source, 1)
        write(other, 2)
        write(source, 3)
        write(other, 4)
        write(source, 5)
        await waiting(source, 6, 7)
        wire.change(full="overwrite", length=1)
        second.change(length=1)
        write(other, 8)  # takes the place of 2
        write(source, 9)  # takes the place of 1
        assert data([sink.inp.read_nowait() for _ in range(4)]) == [3, 4, 5, 6]
        write(other, 10)
        assert data(sink.inp.drain()) == [7, 9, 10]
        assert counts(wire) == (6, 5, 0, {"overwritten": 1})
        assert counts(second) == (4, 2, 0, {"overwritten": 2})


@simulated
async def test_overwriting_many_unread_samples_costs_no_look_at_each_of_them() -> None:
    """As many tokens are dead as there are samples: no write clears them away one by one."""
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1000)
        await kernel.connect((await kernel.add(Source("other"))).out, sink.inp)
        write(source, *range(1000))
        wire.change(length=1)
        write(source, *range(1000, 2500))
        assert transport_of(wire).dead <= 1000
        assert data(sink.inp.drain()) == list(range(1500, 2500))


@simulated
async def test_a_connector_with_listeners_changes_like_any_other() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        heard: list[tuple[str, int]] = []
        kernel.listen(wire, lambda event: heard.append((event.kind, event.sample.data)), "buffer_write")
        write(source, 1)
        await waiting(source, 2, 3)
        wire.change(full="overwrite")
        write(source, 4)
        assert data(sink.inp.drain()) == [2, 3, 4]
        await asyncio.sleep(0)
        assert heard == [("buffer_write", number) for number in (1, 2, 3, 4)]


@simulated
async def test_who_waits_and_is_skipped_needs_no_room() -> None:
    async with Kernel() as kernel:
        options = {"subscription": "new", "push": "skip", "skip": 1, "full": "block", "length": 1, "timeout": None}
        source, sink, wire = await connected(kernel, **options)
        write(source, 1, 2, 3)
        tasks = await waiting(source, 4, 5, 6)
        wire.change(full="reject")
        assert await ended(tasks) == [True, True, True]
        assert data(sink.inp.drain()) == [2, 4, 6]
        assert counts(wire) == (6, 3, 0, {"skipped": 3})


@simulated
async def test_expired_samples_make_room_before_a_change() -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=2, full="block", timeout=None, lifespan=1.0)
        write(source, 1, 2)
        await kernel.sleep(2.0)
        write(source, 3)
        wire.change(full="overwrite", length=1)
        assert counts(wire) == (3, 0, 1, {"expired": 2})
        assert data(sink.inp.drain()) == [3]


# -- periodic ----------------------------------------------------------------------------------------------------------

PERIODIC = {"subscription": "periodic", "push": "fifo", "push_rate": 10, "length": 100, "out_length": 100}


@simulated
async def test_another_push_rate_begins_a_period_and_keeps_the_backlog(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, **PERIODIC)
        write(source, *range(9))
        await kernel.sleep(0.25)
        assert unread_of(wire) == 2
        wire.change(push_rate=4)
        assert wire.profile.push_rate == 4
        times = []
        for _ in range(4):
            await kernel.sleep(0.2499)
            before = unread_of(wire)
            await kernel.sleep(0.0001)
            times.append((before, unread_of(wire)))
        assert times == [(2, 3), (3, 4), (4, 5), (5, 6)]
        assert counts(wire) == (9, 0, 9, {})


@simulated
async def test_periods_are_counted_from_the_change_while_nothing_waits() -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, **PERIODIC)
        await kernel.sleep(0.05)
        wire.change(push_rate=2)
        await kernel.sleep(0.7)
        write(source, 1)
        await kernel.sleep(0.29)
        assert unread_of(wire) == 0
        await kernel.sleep(0.02)
        assert unread_of(wire) == 1


@simulated
async def test_the_same_push_rate_begins_no_period() -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, **PERIODIC)
        write(source, 1)
        for _ in range(3):
            await kernel.sleep(0.04)
            wire.change(push_rate=10, length=50)
        assert unread_of(wire) == 1


@simulated
async def test_a_backlog_that_waits_for_room_goes_by_the_new_options() -> None:
    async with Kernel() as kernel:
        options = PERIODIC | {"push": "all", "length": 2, "full": "block"}
        source, sink, wire = await connected(kernel, **options)
        write(source, 1, 2, 3, 4, 5)
        await kernel.sleep(0.11)
        assert unread_of(wire) == 2
        wire.change(length=4)
        assert unread_of(wire) == 2  # until the period is over
        await kernel.sleep(0.1)
        assert unread_of(wire) == 4
        wire.change(full="overwrite")
        await kernel.sleep(0.1)
        assert data(sink.inp.drain()) == [2, 3, 4, 5]


# -- threads -----------------------------------------------------------------------------------------------------------


class Blocked(Component):
    """Writes its numbers in its thread, waiting for room."""

    out = OutPort(TimedLong)
    count = 2_000

    def on_activated(self) -> None:
        self.written = 0

    def on_execute(self) -> None:
        for _ in range(50):
            if self.written == self.count:
                self.finish()
                return
            assert self.out.write_blocking(long(self.written), 30.0) is True
            self.written += 1


@pytest.mark.slow(kept_by="test_a_sample_of_a_foreign_thread_that_waits_for_room_comes_in_by_a_change")
@pytest.mark.parametrize("fulls", [("block",), ("block", "overwrite")], ids=["block", "both"])
async def test_a_writer_in_a_thread_loses_nothing_by_a_change(fulls: tuple[str, ...], anyio_backend: Any) -> None:
    """In whatever moment of its write the options change."""
    chosen = random.Random(7)
    async with Kernel() as kernel:
        writer, sink = await kernel.create(Blocked), await kernel.create(Sink)
        wire = await kernel.connect(writer.out, sink.inp, full="block", length=2)
        await kernel.start(ThreadContext(1000.0), writer, activate=True)
        read: list[int] = []
        async with asyncio.timeout(60):
            while wire.statistics.written < writer.count or wire.statistics.buffered:
                wire.change(length=chosen.randint(1, 4), full=chosen.choice(fulls))
                read += data(sink.inp.drain() if chosen.random() < 0.5 else [])
                await asyncio.sleep(0)
        ledger = wire.statistics
        assert (ledger.written, ledger.delivered) == (2_000, len(read))
        assert set(ledger.dropped) <= ({"overwritten"} if "overwrite" in fulls else set())
        assert read == sorted(set(read))
        assert len(read) + sum(ledger.dropped.values()) == 2_000


async def test_a_sample_of_a_foreign_thread_that_waits_for_room_comes_in_by_a_change(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, full="block", length=1, timeout=None)
        thread = threading.Thread(target=lambda: [source.out.write_from_thread(long(number)) for number in range(5)])
        thread.start()
        thread.join(10)
        async with asyncio.timeout(10):
            while not source.out.thread_writes.written:
                await asyncio.sleep(0.001)
        wire.change(full="reject", length=5)
        async with asyncio.timeout(10):
            while source.out.thread_writes.waiting:
                await asyncio.sleep(0.001)
        assert data(sink.inp.drain()) == [0, 1, 2, 3, 4]


# -- what follows ------------------------------------------------------------------------------------------------------


@simulated
async def test_profile_events_and_changes_follow() -> None:
    async with Kernel() as kernel:
        _, _, wire = await connected(kernel)
        seen: list[ConnectorChanged] = []
        kernel.bus.subscribe(ConnectorChanged, seen.append)
        before = wire.profile
        stream = kernel.changes()
        await anext(stream)
        wire.change(length=3, full="reject")
        wire.change(length=3)  # is so already
        (event,) = seen
        assert (event.before, event.connector) == (before, wire.profile)
        assert (wire.profile.length, wire.profile.full) == (3, "reject")
        assert "length=3 full=reject" in repr(wire)
        change: Any = await anext(stream)
        (part,) = [part for part in change.parts if part.section == "connectors"]
        assert part.now.options.length == 3
        stream.close()
        assert kernel.profile().connectors[wire.name].options == wire.profile


class Failing(Component):
    """Fails in its first cycle, and once more in a new instance."""

    out = OutPort(TimedLong)
    failed = False

    def on_execute(self) -> None:
        if not Failing.failed:
            Failing.failed = True
            raise ValueError("told to")


@simulated
async def test_a_restart_connects_with_what_was_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Failing, "failed", False)
    async with Kernel() as kernel:
        writer, sink = await kernel.create(Failing), await kernel.add(Sink("sink"))
        wire = await kernel.connect(writer.out, sink.inp, subscription="periodic", push_rate=5, name="wire")
        kernel.supervise(writer, Supervision("restart"))
        wire.change(length=3, full="reject", push_rate=20)
        await kernel.start(PeriodicContext(100.0), writer, activate=True)
        await kernel.sleep(5.0)
        assert Failing.failed
        assert wire.closed
        now = kernel.connectors["wire"].profile
        assert (now.length, now.full, now.push_rate) == (3, "reject", 20)


@simulated
async def test_who_chose_what_is_lost_is_told_of_no_losses(caplog: pytest.LogCaptureFixture) -> None:
    def lines() -> list[str]:
        said = [r.getMessage().partition(": ")[2] for r in caplog.records if r.levelno >= logging.WARNING]
        caplog.clear()
        return said

    async with Kernel() as kernel:
        source, _, wire = await connected(kernel)
        write(source, *range(9))
        await kernel.sleep(0.0)
        assert [line[:17] for line in lines()] == ["1 sample lost so f"[:17]]
        write(source, 1, 2)
        wire.change(length=2)
        assert lines() == ["2 samples more lost"]  # before the change
        write(source, *range(20))
        await kernel.sleep(60.0)
        assert lines() == []
        assert counts(wire) == (31, 0, 8, {"overwritten": 23})


@simulated
async def test_a_loss_in_the_moment_of_a_change_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel)
        write(source, *range(10))
        wire.change(full="overwrite")  # what is so already, and now chosen
        write(source, *range(10))
        await kernel.sleep(60.0)
        said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
        assert [line.partition(": ")[2][:22] for line in said] == ["12 samples lost so far"]
        source.out.connectors[0].change(length=1)
        wire.close()
        assert len(caplog.records) == len(said)


# -- what is refused ---------------------------------------------------------------------------------------------------

REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "nothing": ({}, {}, "there is nothing to change; push_rate, length and full can be changed while connected"),
    "another option": ({}, {"timeout": 2.0}, "change: timeout: push_rate, length and full can be changed"),
    "misspelt": ({}, {"lenght": 2}, "change: lenght: did you mean 'length'? push_rate, length and full can"),
    "an alias": ({}, {"buffer.length": 2}, "change: buffer.length: "),
    "length": ({}, {"length": 1_000_001}, "length = 1000001: expected a whole number from "),
    "a text": ({}, {"length": "many"}, "length = 'many': expected a whole number from "),
    "to a rendezvous": ({}, {"length": 0}, "length = 0: whether a write waits until the reader has taken the sample"),
    "from a rendezvous": ({"length": 0}, {"length": 3}, "length = 3: whether a write waits until the reader has taken"),
    "full of a rendezvous": ({"length": 0}, {"full": "reject"}, "full = 'reject' does not go with length = 0: a write"),
    "full": (
        {},
        {"full": "overwrit"},
        "full = 'overwrit': expected overwrite, reject, block; did you mean 'over",
    ),
    "push_rate of flush": ({}, {"push_rate": 5}, "push_rate: the subscription is flush; only a periodic connector has"),
    "push_rate of pull": ({"dataflow": "pull"}, {"push_rate": 5}, "push_rate: the reader pulls; only a periodic"),
    "push_rate": (PERIODIC, {"push_rate": 0}, "push_rate = 0: expected a number from 0.001 to 1e+06"),
    "one of two": ({"length": 5}, {"length": 2, "full": "never"}, "full = 'never': expected "),
    "one of three": (PERIODIC, {"push_rate": 3, "length": 2, "full": 1}, "full = 1: expected "),
}


@pytest.mark.parametrize(("options", "change", "text"), REFUSED.values(), ids=REFUSED)
@simulated
async def test_a_bad_change_is_refused_with_its_key_and_changes_nothing(
    options: dict[str, Any], change: dict[str, Any], text: str
) -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, **options)
        write(source, *(() if options == {"length": 0} else (1, 2)))
        before = wire.profile, counts(wire)
        seen: list[ConnectorChanged] = []
        kernel.bus.subscribe(ConnectorChanged, seen.append)
        with pytest.raises(WiringError) as caught:
            wire.change(**change)
        assert str(caught.value).startswith("source.out -> sink.inp: ")
        assert text in str(caught.value)
        assert (wire.profile, counts(wire)) == before
        assert seen == []


@simulated
async def test_a_connector_that_was_disconnected_is_not_changed() -> None:
    async with Kernel() as kernel:
        _, _, wire = await connected(kernel)
        wire.close()
        with pytest.raises(ClosedError, match=r"source\.out-sink\.inp: change: this connector was disconnected"):
            wire.change(length=2)
    with pytest.raises(ClosedError):
        wire.change(length=2)


@simulated
async def test_another_thread_may_not_change_it() -> None:
    async with Kernel() as kernel:
        _, _, wire = await connected(kernel)
        caught: list[BaseException] = []

        def change() -> None:
            try:
                wire.change(length=2)
            except ThreadError as error:
                caught.append(error)

        thread = threading.Thread(target=change)
        thread.start()
        thread.join(10)
        assert "ask on the kernel's loop" in str(caught[0])
        assert wire.profile.length == 8


class Once(Component):
    """Writes 99 in its thread."""

    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        self.out.write_nowait(long(99))
        self.finish()


@pytest.mark.slow(kept_by="first")
async def test_a_real_time_thread_overwrites_the_oldest_of_more_than_the_length(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        writer, sink = await kernel.create(Once), await kernel.create(Sink)
        wire = await kernel.connect(writer.out, sink.inp, length=4)
        for number in (1, 2, 3):
            writer.out.write_nowait(long(number))
        wire.change(length=1)
        await kernel.start(RealtimeContext(100.0), writer, activate=True)
        async with asyncio.timeout(10):
            while wire.statistics.written < 4:
                await asyncio.sleep(0.001)
        assert counts(wire) == (4, 0, 3, {"overwritten": 1})
        assert data(sink.inp.drain()) == [2, 3, 99]


@pytest.mark.slow(kept_by="first")
async def test_a_real_time_thread_keeps_its_options(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=4)
        write(source, 1, 2, 3)
        wire.change(length=1)
        context = await kernel.start(RealtimeContext(50), sink)
        before = wire.profile
        with pytest.raises(StateError, match=r"a real-time thread is at .* take that component out of its context"):
            wire.change(length=2)
        assert wire.profile is before
        await kernel.stop(context)
        wire.change(length=2)
        assert wire.profile.length == 2
