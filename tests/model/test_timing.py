"""Spans of a publisher's sends: what is said of them, and that only the last count."""

from __future__ import annotations

import itertools
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import WiringError
from aiorts.model.options import connector_profile
from aiorts.model.timing import ConnectorTimes, Spans

pytestmark = pytest.mark.row(61)


def measure(**options: object) -> int:
    return connector_profile("a.out -> b.in", options, "", ("a.out", "b.in"))[0].measure


def test_nothing_is_measured_unless_asked_for() -> None:
    assert measure() == 0
    assert ConnectorTimes(3).timing.exec == Spans()
    assert ConnectorTimes(3).timing.period == Spans()


@given(st.lists(st.tuples(st.integers(0, 10**9), st.integers(0, 10**6)), max_size=30), st.integers(1, 10))
def test_the_last_sends_are_described_as_statistics_does(gaps: list[tuple[int, int]], length: int) -> None:
    times, began, starts, execs = ConnectorTimes(length), 0, [], []
    for gap, took in gaps:
        began += gap
        times.add(began, began + took)
        starts.append(began)
        execs.append(took)
    periods = [later - earlier for earlier, later in itertools.pairwise(starts)]
    for spans, expected in ((times.timing.exec, execs[-length:]), (times.timing.period, periods[-length:])):
        assert spans.count == len(expected)
        if expected:
            assert (spans.min_ns, spans.max_ns) == (min(expected), max(expected))
            assert spans.mean_ns == pytest.approx(statistics.fmean(expected))
            assert spans.stdev_ns == pytest.approx(statistics.pstdev(expected), abs=1e-3)


@pytest.mark.parametrize(
    ("options", "sends"),
    [
        ({"measure": 5}, 5),
        ({"measurement.exec_time": "enable"}, 1000),
        ({"dataport.measurement.period_time": "enable", "dataport.measurement.period_count": "20"}, 20),
        ({"measurement.exec_time": "disable", "measurement.exec_count": "20"}, 0),
        ({"dataport.outport.measurement.exec_time": "enable"}, 1000),
        ({"measure": 0, "measurement.exec_time": "enable"}, 0),
    ],
)
def test_our_key_and_those_of_openrtm(options: dict[str, object], sends: int) -> None:
    assert measure(**options) == sends


@pytest.mark.parametrize("bad", [-1, 1.5, "often", True, 10**9])
def test_a_bad_count_is_refused_naming_the_range(bad: object) -> None:
    with pytest.raises(WiringError, match=r"measure = .*: expected a whole number from 0 to 1000000"):
        measure(measure=bad)


def test_a_bad_switch_is_refused() -> None:
    with pytest.raises(WiringError, match=r"measurement.exec_time = 'perhaps'"):
        measure(**{"measurement.exec_time": "perhaps"})
