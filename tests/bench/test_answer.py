"""`aiorts bench push` answers which policy suits a pair of rates, and explains the ages that it saw."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from aiorts.errors import SLOW_READER
from aiorts_bench import cli
from aiorts_bench.harness.case import Ledger, Reading
from aiorts_bench.harness.report import Row, row_of
from aiorts_bench.push import answer, load
from aiorts_bench.push.load import Load

FLUSH, NEW, NEWEST = Load("flush"), Load("new", "all"), Load("new", "new", length=None)
PERIODIC = Load("periodic", "new", push_rate=200.0)


def measured(
    one: Load, producer: float, consumer: float | None, age: float, *, full: str = "overwrite", written: int = 0
) -> tuple[Load, Row]:
    """A row whose every age is `age` ms, of a load at these rates; a reader that is slower dropped the rest."""
    one = Load(
        one.subscription, one.push, full, length=one.length, push_rate=one.push_rate, producer_rate=producer,
        consumer_rate=consumer,
    )  # fmt: skip
    written = written or int(producer)
    taken = written if consumer is None else min(written, int(consumer))
    ledger = Ledger(written, taken, 0, taken, {"overwritten": written - taken} if full == "overwrite" else {})
    values = {"rate": float(taken), "offered": float(written), "cpu": 1.0}
    reading = Reading(values, taken, {"latency": [1e6 * age], "age": [1e6 * age]}, ledger)
    return one, row_of("asyncio", load.case("x", one, {}), {"x": [reading]})


def test_slow_reader_is_told_to_take_the_newest_and_where_the_age_comes_from() -> None:
    rows = [
        measured(FLUSH, 40, 20, 199.8),
        measured(NEW, 40, 20, 199.9),
        measured(NEWEST, 40, 20, 3.1),
        measured(PERIODIC, 40, 20, 200.1),
    ]
    explained, last = answer.lines(rows)
    assert explained.startswith("40 Hz -> 20 Hz: age = length / rate, ")
    assert "8 / 40 Hz = 200 ms (the newest 8 are kept; measured: flush 200 ms, new/all 200 ms" in explained
    assert "1 / 40 Hz = 25 ms at most (the newest value is kept; measured: new/new 3.1 ms)" in explained
    assert last == (
        '40 Hz -> 20 Hz: take new/new (subscription="new", push="new"), whose values are 3.1 ms old (median; up to '
        "25 ms, as their phases fall) instead of 200 ms with flush; with one read a cycle the reader takes 20 of 40 "
        "messages a second, and 20 are dropped; one that drains takes all, the oldest 50 ms old (computed); "
        f"{SLOW_READER}."
    )


def test_a_buffer_that_keeps_the_oldest_is_as_old_as_its_length_by_the_readers_rate() -> None:
    rows = [
        measured(FLUSH, 1000, 100, 79.9, full="reject"),
        measured(FLUSH, 1000, 100, 89.9, full="block", written=100),
        measured(PERIODIC, 1000, 100, 36.9),
    ]
    explained, last = answer.lines(rows)
    assert (
        "8 / 100 Hz = 80 ms (the oldest 8 are kept; measured: flush reject 79.9 ms, flush block 89.9 ms)" in explained
    )
    assert "8 / 200 Hz = 40 ms (the newest 8 are kept; measured: periodic/new at 200 Hz overwrite 36.9 ms)" in explained
    assert 'take periodic/new at 200 Hz overwrite (subscription="periodic", push="new", push_rate=200)' in last
    assert "and 900 are dropped or held up by block; " in last
    assert "; one that drains takes all with length=11 or more, the oldest 10 ms old (computed); " in last


def test_an_age_that_has_another_cause_is_not_explained_by_length_and_rate() -> None:
    (last,) = answer.lines([measured(FLUSH, 1000, 100, 500.0)])
    assert "500 ms old (median);" in last


def test_a_buffer_of_one_is_not_chosen_by_the_luck_of_a_median() -> None:
    """Both keep one value: new/new says what is meant, however the phases of the timers fell."""
    one = Load("flush", length=1)
    *_, last = answer.lines([measured(one, 40, 20, 2.0), measured(NEWEST, 40, 20, 24.9)])
    assert 'take new/new (subscription="new", push="new")' in last


def test_a_phase_that_is_kept_is_no_typical_value_and_who_drains_loses_nothing() -> None:
    periodic = Load("periodic", "new", push_rate=5.0)
    rows = [measured(FLUSH, 10, 5, 799.0), measured(NEWEST, 10, 5, 99.9), measured(periodic, 10, 5, 0.4)]
    *_, last = answer.lines(rows)
    assert 'take new/new (subscription="new", push="new"), whose values are 99.9 ms old (median; up to 100 ms, ' in last
    assert (
        "with one read a cycle the reader takes 5 of 10 messages a second, and 5 are dropped; one that drains" in last
    )
    assert "; one that drains takes all, the oldest 200 ms old (computed); " in last


@pytest.mark.parametrize(("consumer", "age"), [(None, 0.1), (40.0, 27.8)])
def test_reader_that_keeps_up_is_told_to_take_flush(consumer: float | None, age: float) -> None:
    rows = [
        measured(FLUSH, 20, consumer, age),
        measured(NEWEST, 20, consumer, age * 0.9),
        measured(PERIODIC, 20, consumer, age + 5),
    ]
    (last,) = answer.lines(rows)
    assert 'take flush (subscription="flush"), whose values are' in last
    assert last.endswith("nothing is dropped, for the reader keeps up.")
    assert ("up to 50 ms" in last) is (consumer is not None)
    assert ("instead of 5.1 ms with periodic/new at 200 Hz" in last) is (consumer is None)


def test_each_pair_of_rates_has_its_sentence_at_the_end() -> None:
    rows = [
        measured(one, rate, 20, 8000 / rate if one is FLUSH else 1.0) for rate in (40, 80) for one in (FLUSH, NEWEST)
    ]
    lines = answer.lines(rows)
    assert [line.partition(":")[0] for line in lines] == ["40 Hz -> 20 Hz", "80 Hz -> 20 Hz"] * 2
    assert all("take new/new" in line for line in lines[2:])


@pytest.mark.slow(kept_by="test_slow_reader_is_told_to_take_the_newest_and_where_the_age_comes_from")
@pytest.mark.parametrize(("producer", "consumer"), [(40, 20), (1000, 100)])
def test_bench_push_ends_with_the_answer(producer: int, consumer: int) -> None:
    words = [
        "push",
        f"--producer-rate={producer}",
        f"--consumer-rate={consumer}",
        "--subscription=flush,new",
        "--quick",
    ]
    result = CliRunner().invoke(cli.bench, words)
    assert result.exit_code == 0, result.output
    last = result.stdout.splitlines()[-1]
    assert last.startswith(
        f'{producer} Hz -> {consumer} Hz: take new/new (subscription="new", push="new"), whose values'
    )
    assert f"the reader takes {consumer} of {producer} messages a second" in last
    assert f"8 / {producer} Hz = {8000 // producer} ms" in result.stdout


def test_plot_draws_age_in_ms_beside_rate() -> None:
    from aiorts_bench.harness import chart

    (_, row), (_, other) = measured(FLUSH, 40, 20, 200.0), measured(NEWEST, 40, 20, 25.0)
    drawn = chart.groups([row, other])
    assert [(one.name, one.unit) for one in drawn] == [("rate", "1/s"), ("age p50", "ms"), ("age p99", "ms")]
    svg = chart.rows(list(drawn)[1], drawn[list(drawn)[1]], ["asyncio"])
    assert "200 ms" in svg
    assert "25 ms" in svg
