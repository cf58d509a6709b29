"""What a process writes is passed on within bounds, and what is not is counted to the byte."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.processes.output import BYTES, LAST, LINES, LONGEST, Output


def test_lines_arrive_whole_however_they_were_cut() -> None:
    output = Output()
    found = [line for part in (b"a\nb", b"", b"c\n\nd") for line in output.feed("stdout", part, 0.0)]
    assert found == [("stdout", "a"), ("stdout", "bc"), ("stdout", "")]
    assert list(output.end()) == [("stdout", "d")]
    assert output.last_lines == ["a", "bc", "", "d"]


def test_streams_do_not_mix_their_lines() -> None:
    output = Output()
    found = [*output.feed("stdout", b"one ", 0.0), *output.feed("stderr", b"two\n", 0.0)]
    found += output.feed("stdout", b"three\n", 0.0)
    assert found == [("stderr", "two"), ("stdout", "one three")]


def test_what_is_beyond_the_lines_of_a_second_is_counted_and_said_when_it_is_over() -> None:
    output = Output()
    data = b"".join(b"line %d\n" % number for number in range(LINES + 50))
    found = list(output.feed("stdout", data, 10.0))
    assert [line for _, line in found] == [f"line {number}" for number in range(LINES)]
    left_out = len(data) - sum(len(line) + 1 for _, line in found)
    assert output.due == 11.0
    assert list(output.due_at(10.9)) == []
    assert list(output.due_at(11.0)) == [("stderr", f"... 50 lines ({left_out} bytes) left out")]
    assert output.due is None
    assert list(output.feed("stdout", b"again\n", 11.0)) == [("stdout", "again")]


def test_the_last_lines_are_kept_even_where_they_are_left_out() -> None:
    output = Output()
    list(output.feed("stdout", b"x\n" * 10_000, 0.0))
    list(output.feed("stderr", b"Traceback\n  boom\n", 0.0))
    assert output.last_lines == ["x"] * (LAST - 2) + ["Traceback", "  boom"]


def test_a_line_without_an_end_takes_no_memory() -> None:
    output = Output()
    for _ in range(1000):
        assert list(output.feed("stdout", b"z" * 65536, 0.0)) == []
    found = list(output.end())
    assert found == [("stdout", "z" * LONGEST), ("stderr", f"... 0 lines ({65_536_000 - LONGEST} bytes) left out")]


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.sampled_from(["stdout", "stderr"]), st.integers(0, 9000), st.integers(0, 9000)), max_size=12)
)
def test_every_byte_is_passed_on_or_counted(parts: list[tuple[str, int, int]]) -> None:
    output, found, fed = Output(), [], 0
    for moment, (stream, before, after) in enumerate(parts):
        data = b"a" * before + b"\n" + b"bc\n" * (after // 30) + b"d" * after
        fed += len(data)
        found += output.feed(stream, data, moment / 8)
    ends = sum(part != b"" for part in output._parts.values())  # lines without a newline of their own
    found += output.end()
    said = [line.split() for _, line in found if line.startswith("...")]
    lines = [line for _, line in found if not line.startswith("...")]
    assert fed + ends == sum(len(line) + 1 for line in lines) + sum(int(words[3].strip("(")) for words in said)
    assert all(len(line) <= LONGEST for line in lines)


def test_bytes_of_a_second_are_bounded_too() -> None:
    output = Output()
    found = list(output.feed("stdout", (b"y" * 3999 + b"\n") * 100, 0.0))
    assert BYTES <= sum(len(line) + 1 for _, line in found) < BYTES + 4000
