"""Rates between two statistics, and how late cycles were, beside plain formulas."""

from __future__ import annotations

import statistics
from array import array
from math import ceil
from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError
from aiorts.model.lateness import KEPT, Lateness
from aiorts.model.profile import ConnectorStatistics, ContextStatistics, ThreadWriteStatistics

S = 1_000_000_000


def ledger(written: int, at_ns: int) -> ConnectorStatistics:
    return ConnectorStatistics(written, 0, 0, MappingProxyType({}), at_ns=at_ns)


@pytest.mark.row(60)
def test_a_rate_is_what_was_counted_by_the_time_between() -> None:
    assert ledger(30, 3 * S).rate_since(ledger(10, S)) == 10.0
    assert ledger(10, 3 * S).rate_since(ledger(10, S)) == 0.0
    assert ContextStatistics(7, at_ns=2 * S).rate_since(ContextStatistics(1, at_ns=S)) == 6.0
    none: MappingProxyType[str, int] = MappingProxyType({})
    later = ThreadWriteStatistics(5, 4, 1, none, 0, at_ns=2 * S)
    assert later.rate_since(ThreadWriteStatistics(0, 0, 0, none, 0, at_ns=S)) == 5.0


@pytest.mark.row(60)
def test_statistics_of_no_earlier_moment_have_no_rate() -> None:
    with pytest.raises(ConfigurationError, match=r"are 2 s later; write later\.rate_since\(earlier\)"):
        ledger(10, S).rate_since(ledger(30, 3 * S))
    with pytest.raises(ConfigurationError, match="both statistics are of one moment"):
        ledger(10, S).rate_since(ledger(10, S))
    with pytest.raises(ConfigurationError, match="written was 20 more in the earlier statistics"):
        ledger(10, 3 * S).rate_since(ledger(30, S))
    with pytest.raises(ConfigurationError, match="ContextStatistics: expected earlier ConnectorStatistics"):
        ledger(10, 3 * S).rate_since(ContextStatistics(1, at_ns=S))  # type: ignore[arg-type]


def test_statistics_with_equal_counts_are_equal() -> None:
    assert ledger(10, S) == ledger(10, 2 * S) != ledger(11, S)


@pytest.mark.slow
@pytest.mark.row(33)
@given(st.lists(st.lists(st.integers(0, 10**12), max_size=40), max_size=60))
def test_lateness_is_that_of_all_cycles_and_percentiles_are_exact_over_the_last(batches: list[list[int]]) -> None:
    late, cycles = Lateness(), [cycle for batch in batches for cycle in batch]
    for batch in batches[:-1]:
        late.add(array("q", batch))
    late = late.with_these(array("q", batches[-1] if batches else []))
    last = sorted(cycles[-KEPT:]) or [0]
    assert late.percentiles(50, 99) == (last[ceil(len(last) * 0.5) - 1], last[ceil(len(last) * 99 / 100) - 1])
    assert (late.total_ns, late.max_ns) == (sum(cycles), max(cycles, default=0))
    assert late.stdev_ns == pytest.approx(statistics.pstdev(cycles) if cycles else 0.0, rel=1e-9, abs=1e-6)
    assert sum(late.histogram.values()) == len(cycles)
    for below, count in late.histogram.items():
        assert count == sum(below // 2 <= cycle < below for cycle in cycles)


@pytest.mark.row(33)
def test_more_cycles_than_are_kept_leave_the_percentiles_of_the_last() -> None:
    late = Lateness()
    for _ in range(3):
        late.add(array("q", [10**9] * 300))
    late.add(array("q", range(KEPT)))
    assert late.percentiles(50, 99) == (499, 989)
    assert late.max_ns == 10**9
