"""Event contexts: who runs, in which order, and how often."""

from __future__ import annotations

import asyncio
import tracemalloc

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from contexts.parts import Diary, Doer, Reader, Sender, Ticker


@pytest.mark.row(28)
def test_members_with_a_cause_run_in_order_of_addition_and_the_others_not_at_all() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[tuple[object, ...]] = []

        class Noting(Reader):
            async def on_execute(self) -> None:
                diary.append((self.name,))
                await super().on_execute()

        async with Kernel() as kernel:
            readers = [await kernel.add(Noting(name)) for name in ("a", "b", "c")]
            senders = [await kernel.add(Sender(f"to_{reader.name}")) for reader in readers]
            for sender, reader in zip(senders, readers, strict=True):
                await kernel.connect(sender.output, reader.input)
            context = await kernel.start(EventContext(), *readers, activate=True)
            senders[2].send(1)
            senders[0].send(1, 2, 3)
            await asyncio.sleep(0.1)
            assert diary == [("a",), ("c",)]
            assert [reader.runs for reader in readers] == [[[1, 2, 3]], [], [[1]]]
            assert context.statistics.cycles == 1

    simulate(main)


@pytest.mark.row(28)
def test_unread_data_runs_a_member_again_when_it_took_some_and_not_when_it_took_none() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            taker, idler = await kernel.add(Reader("taker", share=2)), await kernel.add(Reader("idler", share=0))
            sender = await kernel.add(Sender("sender"))
            await kernel.connect(sender.output, taker.input)
            await kernel.connect(sender.output, idler.input)
            await kernel.start(EventContext(), taker, idler, activate=True)
            sender.send(1, 2, 3, 4, 5)
            await asyncio.sleep(0.1)
            assert taker.runs == [[1, 2], [3, 4], [5]]
            assert idler.runs == [[]]
            sender.send(6)  # more data asks again
            await asyncio.sleep(0.1)
            assert idler.runs == [[], []]

    simulate(main)


@pytest.mark.row(28)
def test_data_that_comes_while_its_reader_runs_is_neither_lost_nor_a_reason_for_an_empty_run() -> None:
    class Slow(Reader):
        async def on_execute(self) -> None:
            await super().on_execute()
            await self.sleep(1.0)
            await super().on_execute()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            slow, sender = await kernel.add(Slow("slow")), await kernel.add(Sender("sender"))
            await kernel.connect(sender.output, slow.input)
            context = await kernel.start(EventContext(), slow, activate=True)
            sender.send(1)
            await asyncio.sleep(0.5)
            sender.send(2)  # is taken by the second read of the same run
            await asyncio.sleep(5.0)
            assert slow.runs == [[1], [2]]
            assert context.statistics.cycles == 1
            sender.send(3)
            await asyncio.sleep(1.0)
            sender.send(4)  # comes after the last read
            await asyncio.sleep(5.0)
            assert [taken for run in slow.runs[2:] for taken in run] == [3, 4]

    simulate(main)


@pytest.mark.row(28)
def test_a_hook_that_waits_for_data_in_a_loop_of_its_own_gets_it() -> None:
    class Waiting(Component):
        input = InPort(TimedLong)
        got: int = 0

        async def on_execute(self) -> None:
            for _ in range(3):
                self.got += (await self.input.read()).data

    async def main(clock: SimulatedClock) -> int:
        async with Kernel() as kernel:
            waiting, sender = await kernel.add(Waiting("waiting")), await kernel.add(Sender("sender"))
            await kernel.connect(sender.output, waiting.input)
            await kernel.start(EventContext(), waiting, activate=True)
            for value in (1, 10, 100):
                sender.send(value)
                await asyncio.sleep(0.1)
            return waiting.got

    assert simulate(main) == 111


@pytest.mark.slow(kept_by="test_triggers_during_a_run_lead_to_one_more_run")
@pytest.mark.row(28)
@pytest.mark.fault("C11")
def test_a_hundred_thousand_triggers_are_one_cause_and_cost_no_memory() -> None:
    async def main(clock: SimulatedClock) -> tuple[int, int]:
        async with Kernel() as kernel:
            tickers = [await kernel.add(Ticker(f"t{number}")) for number in range(3)]
            context = await kernel.start(EventContext(), *tickers, activate=True)
            tracemalloc.start()
            try:
                for _ in range(100_000):
                    context.trigger()
                grown = tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()
            await asyncio.sleep(0.1)
            assert [len(ticker.begun) for ticker in tickers] == [1, 1, 1]
            return grown, context.statistics.cycles

    grown, cycles = simulate(main)
    assert grown <= 1 << 20
    assert cycles == 1


@pytest.mark.fault("C11")
def test_triggers_during_a_run_lead_to_one_more_run() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 1.0))
            context = await kernel.start(EventContext(), ticker, activate=True)
            context.trigger(ticker)
            await asyncio.sleep(0.5)
            for _ in range(1000):
                context.trigger(ticker)
            await asyncio.sleep(5.0)
            assert len(ticker.begun) == 2

    simulate(main)


@pytest.mark.row(28)
def test_a_trigger_for_an_inactive_member_is_no_cause_now_and_none_later() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker"))
            context = await kernel.start(EventContext(), ticker)
            context.trigger()
            await asyncio.sleep(0.1)
            await context.activate()
            await asyncio.sleep(0.1)
            assert ticker.begun == []
            assert context.statistics.cycles == 0
            context.trigger()
            await asyncio.sleep(0.1)
            assert len(ticker.begun) == 1

    simulate(main)


@pytest.mark.row(28)
def test_activation_alone_runs_nothing_and_data_from_before_it_is_dropped() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            reader, sender = await kernel.add(Reader("reader")), await kernel.add(Sender("sender"))
            connector = await kernel.connect(sender.output, reader.input)
            context = await kernel.start(EventContext(), reader)
            sender.send(1)
            await context.activate()
            await asyncio.sleep(0.1)
            assert reader.runs == []
            assert connector.statistics.dropped == {"inactive": 1}
            sender.send(2)
            await asyncio.sleep(0.1)
            assert reader.runs == [[2]]

    simulate(main)


@pytest.mark.row(12, 28)
def test_the_passes_hold_for_the_members_that_take_part() -> None:
    async def main(clock: SimulatedClock) -> list[tuple[object, ...]]:
        diary: list[tuple[object, ...]] = []
        async with Kernel() as kernel:
            members = [await kernel.add(Diary(name, diary)) for name in ("a", "b", "c")]
            context = await kernel.start(EventContext(), *members, activate=True)
            diary.clear()
            context.trigger(members[2], members[0])
            await asyncio.sleep(0.1)
            return list(diary)

    assert simulate(main) == [("a", "execute"), ("c", "execute"), ("a", "update"), ("c", "update")]


def test_a_member_in_error_is_told_once() -> None:
    class Failing(Component):
        told: int = 0

        async def on_execute(self) -> None:
            raise ValueError("no")

        async def on_error(self, error: BaseException) -> None:
            self.told += 1

    async def main(clock: SimulatedClock) -> int:
        async with Kernel() as kernel:
            failing = await kernel.add(Failing("failing"))
            context = await kernel.start(EventContext(), failing, activate=True)
            context.trigger()
            await asyncio.sleep(1.0)
            return failing.told

    assert simulate(main) == 1


class Echo(Component):
    """Sends on what it gets, plus one."""

    input = InPort(TimedLong)
    output = OutPort(TimedLong)

    async def on_execute(self) -> None:
        sample = self.input.read_nowait()
        await self.output.write(TimedLong(sample.tm, (sample.data + 1) % 1000))


@pytest.mark.slow(kept_by="test_after_each_cycle_with_work_left_the_loop_gets_a_turn")
@pytest.mark.row(28)
@pytest.mark.anyio
@pytest.mark.parametrize("contexts", [1, 2])
@pytest.mark.fault("B11")
async def test_a_feedback_loop_of_event_contexts_does_not_starve_the_others(contexts: int) -> None:
    async with Kernel() as kernel:
        echoes = [await kernel.add(Echo(name)) for name in ("ping", "pong")]
        other, sender = await kernel.add(Ticker("other")), await kernel.add(Sender("sender"))
        await kernel.connect(echoes[0].output, echoes[1].input)
        await kernel.connect(echoes[1].output, echoes[0].input)
        await kernel.connect(sender.output, echoes[0].input)
        await kernel.start(PeriodicContext(100.0), other, activate=True)
        made = [await kernel.start(EventContext(), *echoes[n::contexts], activate=True) for n in range(contexts)]
        sender.send(0)
        await asyncio.sleep(0.3)
        assert min(context.statistics.cycles for context in made) > 100
        assert len(other.begun) >= 15


@pytest.mark.row(28)
def test_after_each_cycle_with_work_left_the_loop_gets_a_turn() -> None:
    async def main(clock: SimulatedClock) -> None:
        turns: list[int] = []

        async def note() -> None:
            turns.append(turn)
            if len(turns) < 10:
                context.trigger()

        async with Kernel() as kernel:
            doer = await kernel.add(Doer("doer", execute=note))
            context = await kernel.start(EventContext(), doer, activate=True)
            turn = 0
            context.trigger()
            while len(turns) < 10:
                turn += 1
                await asyncio.sleep(0)
            assert len(set(turns)) == 10

    simulate(main)


@pytest.mark.row(28)
def test_a_port_added_at_run_time_wakes_its_member() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker, sender = await kernel.add(Ticker("ticker")), await kernel.add(Sender("sender"))
            context = await kernel.start(EventContext(), ticker, activate=True)
            port = ticker.add_port("late", InPort(TimedLong))
            await kernel.connect(sender.output, port)
            sender.send(1)
            await asyncio.sleep(0.1)
            assert len(ticker.begun) == 1
            await context.remove(ticker)
            sender.send(2)
            await asyncio.sleep(0.1)
            assert len(ticker.begun) == 1
            assert receiver_of(port).callback is None

    simulate(main)


@pytest.mark.row(28)
def test_latest_is_still_there_in_a_cycle_without_new_data() -> None:
    class Asking(Component):
        inp = InPort(TimedLong)
        seen: list[int | None]

        async def on_execute(self) -> None:
            latest = self.inp.latest
            self.seen.append(None if latest is None else latest.data)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            asking, source = await kernel.add(Asking("asking")), await kernel.add(Sender("sender"))
            asking.seen = []
            await kernel.connect(source.output, asking.inp)
            context = await kernel.start(EventContext(), asking, activate=True)
            for _ in range(2):
                source.send(5)
                await asyncio.sleep(0.01)
                for _ in range(2):
                    context.trigger()
                    await asyncio.sleep(0.01)
            assert asking.seen == [5] * 6

    simulate(main)


@pytest.mark.row(28)
def test_a_trigger_for_all_is_for_those_who_are_active_when_the_cycle_begins() -> None:
    async def main(clock: SimulatedClock) -> None:
        runs: list[str] = []

        class Noting(Component):
            async def on_execute(self) -> None:
                runs.append(self.name)

        class Listening(Noting):
            input = InPort(TimedLong)

        async with Kernel() as kernel:
            for kinds in ((Noting, Noting, Noting), (Noting, Listening, Listening)):
                a, b, c = [await kernel.create(kind) for kind in kinds]
                context = await kernel.start(EventContext(), a, b, c, activate=True)
                await context.deactivate(c)
                runs.clear()
                context.trigger()
                context.trigger(b)
                await context.deactivate(a)  # takes effect before the cycle that was asked for
                await asyncio.sleep(0.01)
                assert (runs, context.ticks) == ([b.name], 1)
                await context.deactivate()
                context.trigger()
                await asyncio.sleep(0.01)
                await context.activate()  # nobody could run: the trigger did not wait
                await asyncio.sleep(0.01)
                assert (runs, context.ticks) == ([b.name], 1)
                context.trigger()
                await asyncio.sleep(0.01)
                assert (runs, context.ticks) == ([b.name, a.name, b.name, c.name], 2)
                await context.stop()

    simulate(main)


@pytest.mark.row(28)
def test_what_was_read_between_cycles_is_no_reason_to_run_again_after_a_trigger_for_all() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            idler, sender = await kernel.add(Reader("idler", share=0)), await kernel.add(Sender("sender"))
            await kernel.connect(sender.output, idler.input)
            context = await kernel.start(EventContext(), idler, activate=True)
            sender.send(1, 2)
            await asyncio.sleep(0.01)
            assert (idler.input.read_nowait().data, context.ticks) == (1, 1)
            context.trigger()
            await asyncio.sleep(0.01)
            assert (idler.runs, context.ticks) == ([[], []], 2)

    simulate(main)
