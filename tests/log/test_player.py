"""The player: what it hands over when, on which clock, and what others can make of it meanwhile."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel, ScaledClock
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedLong, TimedOctetSeq
from aiorts_log import DamagedError, RecordingError, RecordingReader
from aiorts_log.playing.read_ahead import ReadAhead, Reading
from aiorts_log.playing.schedule import Pace
from play_parts import BEGIN, MS, Played, S, foreign, recorded, steady


@pytest.mark.slow
@simulated
async def test_samples_of_all_ports_leave_in_the_order_and_at_the_distances_of_their_log_times(tmp_path: Path) -> None:
    steady(tmp_path / "a.mcap", 1000)
    async with Kernel() as kernel:
        played = Played(kernel, tmp_path / "a.mcap")
        await played.player.play()
    assert played.values == list(range(1000))
    assert [port for _, port, _ in played.samples[:3]] == ["a", "b", "a"]
    assert played.moments == [i * 10 * MS for i in range(1000)]


@simulated
async def test_samples_of_one_moment_keep_the_order_in_which_they_were_recorded(tmp_path: Path) -> None:
    samples = [("abc"[i % 3], BEGIN, TimedLong(0, i)) for i in range(100)]
    recorded(tmp_path / "a.mcap", samples, chunk=100)
    async with Kernel() as kernel:
        played = Played(kernel, tmp_path / "a.mcap")
        await played.player.play()
    assert played.values == list(range(100))
    assert set(played.moments) == {0}


@pytest.mark.slow
@pytest.mark.fault("D21")
@simulated
async def test_in_hours_of_virtual_time_nothing_drifts(tmp_path: Path) -> None:
    step = 997_000_001
    recorded(tmp_path / "a.mcap", [("a", BEGIN + i * step, TimedLong(0, i)) for i in range(10_000)])
    async with Kernel() as kernel:
        played = Played(kernel, tmp_path / "a.mcap")
        await played.player.play()
    assert played.moments == [i * step for i in range(10_000)]  # 2.8 hours, to the nanosecond


class TestStamps:
    @simulated
    async def test_they_are_shifted_by_one_offset_to_the_time_of_the_clock(self, tmp_path: Path) -> None:
        samples = [("a", BEGIN + i * S, TimedLong(BEGIN + i * S - 5, i)) for i in range(3)]
        recorded(tmp_path / "a.mcap", samples)
        async with Kernel() as kernel:
            await kernel.sleep(1000.0)
            played = Played(kernel, tmp_path / "a.mcap")
            await played.player.play()
        assert played.stamps == [1000 * S, 1001 * S, 1002 * S]

    @simulated
    async def test_absolute_ones_stay_as_they_were_recorded(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", absolute=True)
            await played.player.play()
        assert played.stamps == [BEGIN + i * 10 * MS for i in range(10)]

    @simulated
    async def test_of_types_without_a_stamp_nothing_is_shifted_and_one_that_was_never_set_stays_unset(
        self, tmp_path: Path
    ) -> None:
        samples: list[tuple[str, int, Any]] = [("a", BEGIN, 1.5), ("b", BEGIN + S, TimedLong(0, 7))]
        recorded(tmp_path / "a.mcap", [*samples, ("b", BEGIN + 2 * S, TimedLong(BEGIN, 8))])
        async with Kernel() as kernel:
            await kernel.sleep(10.0)
            played = Played(kernel, tmp_path / "a.mcap")
            await played.player.play()
        assert [record for _, _, record in played.samples] == [1.5, TimedLong(0, 7), TimedLong(12 * S, 8)]

    @simulated
    async def test_they_go_on_evenly_over_pauses_jumps_gaps_and_passes(self, tmp_path: Path) -> None:
        steps = [0, 1, 2, 103, 104]
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * S, TimedLong(BEGIN + i * S, i)) for i in steps])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", Pace(max_gap=10 * S), passes=2)
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(1.5)
            played.player.pause()
            await kernel.sleep(60.0)
            played.player.resume()
            await kernel.sleep(0.6)
            played.player.seek(BEGIN + 103 * S)
            await task
        begin = played.samples[0][0]
        assert played.values == [0, 1, 2, 103, 104, *steps]
        assert [tm - played.stamps[0] for tm in played.stamps] == [moment - begin for moment, _, _ in played.samples]

    @simulated
    async def test_one_that_would_be_before_all_time_is_brought_back_and_told(self, tmp_path: Path) -> None:
        recorded(
            tmp_path / "a.mcap", [("a", BEGIN, TimedLong(BEGIN, 0)), ("a", BEGIN + 1, TimedLong(BEGIN - 3600 * S, 1))]
        )
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            await played.player.play()
        assert played.stamps == [0, 0]
        assert any("1 stamps" in text for text in played.told)


class TestWhilePlaying:
    @simulated
    async def test_a_pause_ends_a_wait_at_once_and_leaves_what_was_left_of_it(self, tmp_path: Path) -> None:
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * 10 * S, TimedLong(0, i)) for i in range(3)])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(4.0)
            played.player.pause()
            await kernel.sleep(3600.0)
            assert played.values == [0]
            assert played.player.position == BEGIN + 4 * S
            played.player.resume()
            await task
        assert played.moments == [0, 3610 * S, 3620 * S]

    @simulated
    async def test_steps_send_as_many_samples_as_are_asked_for(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 600, 1000)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", paused=True)
            task = asyncio.create_task(played.player.play())
            for expected in (0, 3, 4, 500):
                played.player.step(expected - len(played.samples))
                await kernel.sleep(1.0)
                assert played.values == list(range(expected))
            played.player.resume()
            await task
        assert played.values == list(range(600))

    @simulated
    async def test_who_is_stepped_has_the_stamps_of_the_clock_and_none_goes_back(self, tmp_path: Path) -> None:
        samples = [("ab"[i % 2], BEGIN + i // 2 * 7 * S, TimedLong(BEGIN + i // 2 * 7 * S, i)) for i in range(20)]
        recorded(tmp_path / "a.mcap", samples)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", paused=True)
            task = asyncio.create_task(played.player.play())
            began = kernel.clock.time_ns()
            for count in (1, 3, 2, 5):
                await kernel.sleep(2.0)
                played.player.step(count)
            await kernel.sleep(2.0)
            stamps = [sample.tm - began for _, _, sample in played.samples]
            assert stamps == [2 * S] + [4 * S] * 3 + [6 * S] * 2 + [8 * S] * 5
            played.player.resume()
            await task
        assert [sample.tm - began for _, _, sample in played.samples[11:14]] == [10 * S, 17 * S, 17 * S]

    @simulated
    async def test_who_resumes_while_a_step_is_held_up_loses_no_time(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 4)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", paused=True, pace=Pace(rate=10.0))
            take = played.player._send

            async def slow(port: str, sample: Any) -> None:
                if not sample.data:
                    await kernel.sleep(0.02)
                await take(port, sample)

            played.player._send = slow
            task = asyncio.create_task(played.player.play())
            played.player.step(1)
            await kernel.sleep(0.01)
            played.player.resume()
            await task
        assert [moment // MS for moment in played.moments] == [0, 90, 190, 290]

    @simulated
    async def test_what_a_reader_holds_up_when_it_is_paused_goes_and_nothing_behind_it(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            take = played.player._send

            async def slow(port: str, sample: Any) -> None:
                await kernel.sleep(1.0)
                await take(port, sample)

            played.player._send = slow
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(0.5)
            played.player.pause()
            played.player.step(1)  # one more than that
            await kernel.sleep(100.0)
            assert played.values == [0, 1]
            played.player.step(2)
            await kernel.sleep(0.5)
            played.player.resume()
            played.player.pause()
            await kernel.sleep(100.0)
            assert played.values == [0, 1, 2]
            played.player.resume()
            await task
        assert played.values == list(range(10))

    @simulated
    async def test_a_jump_forth_or_back_plays_from_there(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(0.055)
            played.player.seek(BEGIN + 9 * S)
            await kernel.sleep(0.095)
            played.player.seek(BEGIN)
            await kernel.sleep(0.095)
            played.player.seek(BEGIN + 10 * S - 20 * MS)
            await task
        assert played.values == [*range(6), *range(900, 910), *range(10), 998, 999]

    @simulated
    async def test_a_jump_in_the_midst_of_what_was_read_already(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            take = played.player._send

            async def moving(port: str, sample: Any) -> None:
                await take(port, sample)
                if sample.data in (5, 905):
                    played.player.seek(BEGIN + (9 * S if sample.data == 5 else 9990 * MS))

            played.player._send = moving
            await played.player.play()
        assert played.values == [*range(6), *range(900, 906), 999]
        assert played.moments == [*(i * 10 * MS for i in range(6)), *((5 + i) * 10 * MS for i in range(6)), 100 * MS]

    @simulated
    async def test_a_jump_while_it_is_paused_moves_it_and_sends_nothing(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", paused=True)
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(1.0)
            played.player.seek(BEGIN + 9 * S)
            await kernel.sleep(1.0)
            assert played.samples == []
            assert played.player.position == BEGIN + 9 * S
            played.player.step()
            await kernel.sleep(1.0)
            assert played.values == [900]
            played.player.resume()
            await task
        assert played.values == list(range(900, 1000))

    @simulated
    async def test_at_the_end_a_paused_one_can_still_go_back(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 3)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", paused=True)
            task = asyncio.create_task(played.player.play())
            played.player.step(10)
            await kernel.sleep(1.0)
            assert not task.done()
            played.player.seek(BEGIN)
            played.player.resume()
            await task
        assert played.values == [0, 1, 2, 0, 1, 2]

    @simulated
    async def test_another_speed_holds_at_once(self, tmp_path: Path) -> None:
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * 100 * S, TimedLong(0, i)) for i in range(3)])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(50.0)
            played.player.change(Pace(10.0))
            await task
        assert played.moments == [0, 55 * S, 65 * S]

    @simulated
    async def test_what_a_reader_holds_up_is_late_and_in_order_and_nothing_is_left_out(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 500)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            take = played.player._send

            async def slow(port: str, record: Any) -> None:
                if record.data == 100:
                    await kernel.sleep(2.0)
                await take(port, record)

            played.player._send = slow
            await played.player.play()
        assert played.values == list(range(500))
        assert played.moments[99:102] == [990 * MS, 3000 * MS, 3000 * MS]
        assert played.moments[-1] == 4990 * MS  # it has caught up

    @simulated
    async def test_cancelled_it_lets_its_file_go(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 1000)
        before = len(os.listdir("/dev/fd"))
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(0.5)
            played.player.pause()
            task.cancel()
            played.player.resume()  # who wakes it in the same moment must not keep it alive
            await asyncio.wait([task])
            assert task.cancelled()
        assert len(os.listdir("/dev/fd")) == before


class TestPasses:
    @simulated
    async def test_steps_go_on_from_the_end_of_a_pass_to_the_next(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 3)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", passes=2, paused=True)
            task = asyncio.create_task(played.player.play())
            played.player.step(5)
            await kernel.sleep(1.0)
            assert played.values == [0, 1, 2, 0, 1]
            played.player.resume()
            await task
        assert played.values == [0, 1, 2] * 2

    @pytest.mark.slow
    @simulated
    async def test_so_often_as_asked_each_as_far_behind_the_last_as_its_last_two_samples_were_apart(
        self, tmp_path: Path
    ) -> None:
        steady(tmp_path / "a.mcap", 300)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", passes=3)
            await played.player.play()
        assert played.values == [*range(300)] * 3
        assert played.moments == [i * 10 * MS for i in range(900)]

    @simulated
    async def test_a_range_is_what_is_repeated_and_a_position_is_where_the_first_pass_begins(
        self, tmp_path: Path
    ) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel() as kernel:
            chosen: dict[str, Any] = {"start": BEGIN + 200 * MS, "end": BEGIN + 300 * MS, "position": BEGIN + 250 * MS}
            played = Played(kernel, tmp_path / "a.mcap", passes=2, **chosen)
            await played.player.play()
        assert played.values == [*range(25, 30), *range(20, 30)]

    @pytest.mark.slow(
        kept_by="log/test_schedule.py::TestPasses::test_one_moment_alone_is_not_repeated_without_end_in_no_time"
    )
    @simulated
    async def test_without_end_and_as_fast_as_possible_time_goes_on_all_the_same(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", Pace(float("inf")), passes=0)
            task = asyncio.create_task(played.player.play())
            await kernel.sleep(1.0)
            task.cancel()
            await asyncio.wait([task])
        assert 1000 <= len(played.samples) <= 20_000

    @simulated
    async def test_of_nothing_there_is_one_pass(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", passes=0, start=BEGIN + S)
            await played.player.play()
        assert played.samples == []


@pytest.mark.fault("D14")
class TestTimesThatAreNone:
    @simulated
    async def test_of_a_gap_of_a_year_an_hour_is_waited_for_and_that_is_told(self, tmp_path: Path) -> None:
        year = 365 * 24 * 3600 * S
        times = [BEGIN, BEGIN + S, BEGIN + year, BEGIN + year + S]
        recorded(tmp_path / "a.mcap", [("a", time, TimedLong(time, i)) for i, time in enumerate(times)])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", Pace(max_gap=3600 * S))
            await played.player.play()
        assert played.moments == [0, S, 3601 * S, 3602 * S]
        assert len(played.told) == 1
        assert "no sample for 3.1536e+07 s" in played.told[0]
        assert played.player.gaps == 1

    @simulated
    async def test_a_recording_whose_clock_was_set_back_is_played_in_the_order_of_its_numbers(
        self, tmp_path: Path
    ) -> None:
        hour = 3600 * S
        times = [BEGIN + i * S - (hour if i >= 50 else 0) for i in range(100)]
        foreign(tmp_path / "a.mcap", times)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            await played.player.play()
        assert played.values == list(range(100))
        # The second in which it was set back is not known; all others are.
        assert played.moments == [i * S if i < 50 else (i - 1) * S for i in range(100)]
        assert [text for text in played.told if "set back by 3599 s" in text] == played.told
        assert len(played.told) == 1

    @simulated
    async def test_one_that_was_only_written_out_of_order_is_played_in_the_order_of_its_times(
        self, tmp_path: Path
    ) -> None:
        times = [BEGIN + i * S for i in (0, 2, 1, 3, 5, 4)]
        foreign(tmp_path / "a.mcap", times, numbered=False)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            await played.player.play()
        assert played.values == [0, 2, 1, 3, 5, 4]
        assert played.moments == [i * S for i in range(6)]
        assert played.told == []


class TestDamage:
    @pytest.mark.slow
    @simulated
    async def test_everything_whole_in_front_of_it_is_played(self, tmp_path: Path) -> None:
        path = steady(tmp_path / "a.mcap", 1000, chunk=2000)
        with RecordingReader(path) as reader:
            place = reader.pieces[-1].offset
        raw = bytearray(path.read_bytes())
        raw[place + 200] ^= 1
        path.write_bytes(raw)
        async with Kernel() as kernel:
            played = Played(kernel, path)
            with pytest.raises(DamagedError):
                await played.player.play()
        assert played.values == list(range(len(played.values)))
        assert len(played.values) > 900

    @pytest.mark.slow
    @simulated
    async def test_of_one_that_was_torn_off_everything_whole_is_played(self, tmp_path: Path) -> None:
        path = steady(tmp_path / "a.mcap", 1000, chunk=2000)
        with RecordingReader(path) as reader:
            place = reader.pieces[-1].offset
        path.write_bytes(path.read_bytes()[: place + 100])
        async with Kernel() as kernel:
            played = Played(kernel, path)
            await played.player.play()
        assert "not closed" in played.player.fault
        assert played.values == list(range(len(played.values)))
        assert len(played.values) > 900

    @simulated
    async def test_a_file_that_became_another_one_is_refused(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 10)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            recorded(tmp_path / "b.mcap", [("a", BEGIN, TimedLong(0, 1)), ("b", BEGIN, TimedLong(0, 1))])
            os.replace(tmp_path / "b.mcap", tmp_path / "a.mcap")
            with pytest.raises(RecordingError, match="port 'a' has changed"):
                await played.player.play()


class TestOnARealClock:
    @pytest.mark.slow
    @pytest.mark.anyio
    async def test_it_is_never_early_and_a_thread_reads_and_goes(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 2000, MS)
        threads = threading.active_count()
        reading: set[bool] = set()
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", Pace(20.0))
            take = played.player._send

            async def looking(port: str, sample: Any) -> None:
                await take(port, sample)
                if sample.data % 500 == 0:
                    reading.add(any(thread.name.startswith("aiorts replay") for thread in threading.enumerate()))

            played.player._send = looking
            began = kernel.clock.monotonic_ns()
            await played.player.play()
        assert played.values == list(range(2000))
        assert all(moment - began >= i * MS // 20 for i, (moment, _, _) in enumerate(played.samples))
        assert reading == {True}
        await _until(lambda: threading.active_count() == threads)

    @pytest.mark.anyio
    async def test_a_scaled_clock_is_kept(self, tmp_path: Path) -> None:
        steady(tmp_path / "a.mcap", 100)
        async with Kernel(clock=ScaledClock(50.0)) as kernel:
            played = Played(kernel, tmp_path / "a.mcap", Pace(0.5))
            began = kernel.clock.monotonic_ns()
            await played.player.play()
        assert played.samples[-1][0] - began >= 1980 * MS  # in time of the clock; 40 ms of real time
        assert played.values == list(range(100))

    @pytest.mark.slow(kept_by="log/test_schedule.py::test_time_until_the_first_sample_is_there_is_not_played")
    @pytest.mark.anyio
    async def test_time_that_it_takes_to_open_a_file_or_to_find_a_place_is_not_played(self, tmp_path: Path) -> None:
        class Slow(RecordingReader):
            def samples(self, **chosen: Any) -> Any:
                time.sleep(0.3)
                return super().samples(**chosen)

        steady(tmp_path / "a.mcap", 9, 50 * MS)
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", opened=Slow, absolute=True)
            task = asyncio.ensure_future(played.player.play())
            await _until(lambda: played.values == [0])
            played.player.seek(BEGIN + 250 * MS)
            await task
        # 0 may be late and 1 on time, if somebody else has the processor; nobody is early.
        assert played.values[-4:] == [5, 6, 7, 8]
        assert played.moments[-1] - played.moments[-4] > 100 * MS

    @pytest.mark.anyio
    async def test_who_asks_for_something_does_not_wait_for_the_next_sample(self, tmp_path: Path) -> None:
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * 1000 * S, TimedLong(0, i)) for i in range(4)])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap")
            task = asyncio.ensure_future(played.player.play())
            await _until(lambda: played.values == [0])
            played.player.seek(BEGIN + 2000 * S)
            played.player.change(Pace(500.0))
            played.player.pause()
            await _until(lambda: played.player.paused)
            played.player.step(1)
            await _until(lambda: played.values == [0, 2])
            played.player.change(Pace(float("inf")))
            played.player.resume()
            await asyncio.wait_for(task, 5.0)
        assert played.values == [0, 2, 3]

    @pytest.mark.slow(kept_by="TestOnARealClock::test_a_scaled_clock_is_kept")
    @pytest.mark.anyio
    async def test_a_slow_disk_keeps_neither_the_loop_nor_who_ends_it(self, tmp_path: Path) -> None:
        class Slow(RecordingReader):
            def samples(self, **chosen: Any) -> Any:
                for sample in super().samples(**chosen):
                    if sample.sequence == 100 or sample.sequence >= 256:
                        time.sleep(0.3)
                    yield sample

        recorded(tmp_path / "a.mcap", [("a", BEGIN + i, TimedLong(0, i)) for i in range(1000)])
        async with Kernel() as kernel:
            played = Played(kernel, tmp_path / "a.mcap", opened=Slow)
            task = asyncio.ensure_future(played.player.play())
            longest, before = 0.0, time.monotonic()
            while len(played.samples) < 256:
                await asyncio.sleep(0.001)
                longest, before = max(longest, time.monotonic() - before), time.monotonic()
            assert longest < 0.25
            task.cancel()
            await asyncio.wait([task])
            assert time.monotonic() - before < 10.0  # it had a whole block of waits in front of it, 77 s

    @pytest.mark.slow
    @pytest.mark.anyio
    async def test_large_samples_are_read_one_block_ahead_and_not_all(self, tmp_path: Path) -> None:
        large = TimedOctetSeq(1, bytes(2**20))
        recorded(tmp_path / "a.mcap", [("a", BEGIN + i * S, large) for i in range(20)], chunk=2**20)
        taken = 0

        class Counting(RecordingReader):
            def samples(self, **chosen: Any) -> Any:
                nonlocal taken
                for sample in super().samples(**chosen):
                    taken += 1
                    yield sample

        ahead = ReadAhead(Reading(lambda: Counting(tmp_path / "a.mcap"), {"a": ("a", TimedOctetSeq)}), in_place=False)
        await ahead.open()
        await ahead.begin(None)
        for number in range(1, 4):
            assert len((await ahead.block()).samples) == 1
            await asyncio.sleep(0.05)
            assert taken == number + 1
        await ahead.close()


async def _until(condition: Any) -> None:
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("it did not happen within 5 s")


@pytest.mark.fault("D12")
@simulated
async def test_nothing_is_imported_for_a_file(tmp_path: Path) -> None:
    steady(tmp_path / "a.mcap", 10)
    async with Kernel() as kernel:
        played = Played(kernel, tmp_path / "a.mcap")
        before = set(sys.modules)
        await played.player.play()
        assert set(sys.modules) == before
    assert TimedDouble in [type(record) for _, _, record in played.samples]
