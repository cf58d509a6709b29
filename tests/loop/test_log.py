"""A component's log: fields on every record, repeats folded, output limited, and every line accounted for."""

# ruff: noqa: G004 - templates that differ each time are what these tests are about

from __future__ import annotations

import io
import logging
import re
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.kernel.loop.log import BYTES_PER_SECOND, LOGGER_NAME, ComponentLog, LogFields

if TYPE_CHECKING:
    from collections.abc import Iterator

SECOND = 1_000_000_000


class Memory(logging.Handler):
    """Keeps what was emitted."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)

    @property
    def lines(self) -> list[str]:
        return [record.getMessage() for record in self.records]


class Bench:
    """A log with its own logger, its own time and a component whose place the test sets."""

    def __init__(self, name: str = "pid0", level: int = logging.DEBUG) -> None:
        self.now = 0
        self.fields = LogFields("kernel0", name, "on_execute", 1)
        self.asked = 0
        self.out = Memory()
        self.logger = logging.Logger("bench", level)
        self.logger.addHandler(self.out)
        self.log = ComponentLog(self.place, lambda: self.now, logger=self.logger)

    def place(self) -> LogFields:
        self.asked += 1
        return self.fields


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("level", ["debug", "info", "warning", "error", "critical"])
def test_line_has_level_text_place_and_source_of_the_caller(bench: Bench, level: str) -> None:
    bench.fields = LogFields("kernel0", "pid0", "on_activated", 7)
    getattr(bench.log, level)("gain %s of %d", 2.5, 3)
    (record,) = bench.out.records
    assert record.levelname == level.upper()
    assert record.getMessage() == "gain 2.5 of 3"
    assert (record.kernel, record.component, record.hook, record.tick) == ("kernel0", "pid0", "on_activated", 7)  # type: ignore[attr-defined]
    assert (record.filename, record.funcName) == (
        "test_log.py",
        test_line_has_level_text_place_and_source_of_the_caller.__name__,
    )


def test_log_takes_any_level_and_the_options_of_the_standard_library(bench: Bench) -> None:
    def helper() -> None:
        bench.log.log(25, "here", stacklevel=2, stack_info=True, extra={"joint": 3, "component": "liar"})

    helper()
    (record,) = bench.out.records
    assert record.levelno == 25
    assert record.funcName == test_log_takes_any_level_and_the_options_of_the_standard_library.__name__
    assert record.joint == 3  # type: ignore[attr-defined]
    assert record.component == "pid0"  # type: ignore[attr-defined]
    assert record.stack_info is not None


def test_exception_carries_the_traceback(bench: Bench) -> None:
    try:
        raise ValueError("broken")
    except ValueError as error:
        bench.log.exception("failed")
        bench.log.error("given", exc_info=error)
    assert [record.levelno for record in bench.out.records] == [logging.ERROR, logging.ERROR]
    for record in bench.out.records:
        assert record.exc_info is not None
        assert str(record.exc_info[1]) == "broken"


def test_line_of_a_disabled_level_asks_for_nothing_and_leaves_no_trace() -> None:
    bench = Bench(level=logging.WARNING)
    assert not bench.log.isEnabledFor(logging.INFO)
    assert bench.log.isEnabledFor(logging.WARNING)
    bench.log.info("quiet")
    bench.log.debug("quiet")
    bench.log.log(5, "quiet")
    bench.log.flush()
    assert bench.asked == 0
    assert bench.out.records == []


def test_disabled_level_costs_less_than_a_microsecond() -> None:
    bench = Bench(level=logging.WARNING)

    def cost() -> float:
        start = time.perf_counter_ns()
        for _ in range(10_000):
            bench.log.debug("sample %s", 1.0)
        return (time.perf_counter_ns() - start) / 10_000

    assert min(cost() for _ in range(10)) < 1_000


def test_same_line_within_a_second_is_counted_and_told_with_the_next(bench: Bench) -> None:
    for tick in range(5):
        bench.now = tick * SECOND // 10
        bench.log.warning("late by %d", tick)
    bench.now = SECOND
    bench.log.warning("late by %d", 9)
    assert bench.out.lines == ["late by 0", "late by 9 (4 more like this before)"]
    assert [record.repeated for record in bench.out.records] == [0, 4]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ([0.5], "execute at 0.5"),
        ([0.5, 0.75], "execute at 0.75 (the last of 2 more like this)"),
        ([0.25], "execute at 0.25 (repeated 1 time)"),
        ([0.25, OSError("0.5")], "execute at 0.25 (2 more like this)"),
    ],
)
def test_only_lines_of_one_text_are_called_repeated(bench: Bench, values: list[object], told: str) -> None:
    for value in (0.25, *values):
        bench.log.warning("execute at %s", value)
    bench.log.flush()
    assert bench.out.lines == ["execute at 0.25", told]


def test_the_same_text_again_is_repeated_with_the_next_line(bench: Bench) -> None:
    for now in (0, 1, 2, SECOND):
        bench.now = now
        bench.log.warning("late by %d", 3)
    assert bench.out.lines == ["late by 3", "late by 3 (repeated 2 times)"]


def test_a_folded_line_runs_no_code_of_the_user(bench: Bench) -> None:
    told: list[int] = []

    class Asked:
        def __str__(self) -> str:
            told.append(1)
            return "asked"

    bench.log.warning("%s", Asked())
    first = len(told)
    bench.log.warning("%s", Asked())
    assert len(told) == first


def test_a_line_of_another_level_or_template_is_not_a_repeat(bench: Bench) -> None:
    bench.log.info("a")
    bench.log.warning("a")
    bench.log.info("b")
    assert bench.out.lines == ["a", "a", "b"]


def test_two_components_do_not_fold_each_others_lines() -> None:
    one, two = Bench("one"), Bench("two")
    one.log.info("a")
    two.log.info("a")
    assert one.out.lines == two.out.lines == ["a"]


def test_repeats_of_a_line_that_fell_silent_are_told_with_any_later_line(bench: Bench) -> None:
    for _ in range(4):
        bench.log.warning("late by %d", 3)
    bench.now = 2 * SECOND
    bench.log.info("all well")
    assert bench.out.lines == ["late by 3", "late by 3 (repeated 3 times)", "all well"]
    assert bench.out.records[1].levelno == logging.WARNING


def test_flush_tells_what_is_pending_once(bench: Bench) -> None:
    bench.log.warning("100 % full")
    bench.log.warning("100 % full")
    bench.log.flush()
    bench.log.flush()
    assert bench.out.lines == ["100 % full", "100 % full (repeated 1 time)"]


def test_what_is_pending_is_told_with_the_text_of_the_line_it_repeats(bench: Bench) -> None:
    for _ in range(3):
        bench.log.error("b.on_activated failed: %s", OSError("100 % full"))
        bench.log.info("%(joint)s at %(angle).1f", {"joint": "elbow", "angle": 1.5})
        bench.log.warning("very %s", "x" * 1000)
    bench.log.flush()
    assert bench.out.lines[3:] == [
        "b.on_activated failed: 100 % full (2 more like this)",
        "elbow at 1.5 (2 more like this)",
        f"very {'x' * 195} (repeated 2 times)",
    ]


def test_message_that_is_no_text_is_folded_by_its_text(bench: Bench) -> None:
    for _ in range(3):
        bench.log.error({"a": [1]})
    bench.now = SECOND
    bench.log.error({"a": [1]})
    assert bench.out.lines == ["{'a': [1]}", "{'a': [1]} (repeated 2 times)"]


def test_template_with_named_fields_keeps_working_when_it_was_repeated(bench: Bench) -> None:
    for now in (0, 1, SECOND):
        bench.now = now
        bench.log.info("%(joint)s at %(angle).1f", {"joint": "elbow", "angle": 1.5})
    assert bench.out.lines == ["elbow at 1.5", "elbow at 1.5 (1 more like this before)"]


def test_template_that_does_not_fit_its_arguments_does_not_raise(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    stream = logging.StreamHandler(io.StringIO())
    bench.logger.handlers[:] = [stream]
    bench.log.info("%d and %d", "x")
    assert "Logging error" in capsys.readouterr().err


@pytest.mark.slow(kept_by="test_tracebacks_and_long_lines_count_as_output")
@pytest.mark.fault("A21")
def test_a_million_lines_in_a_second_stay_under_a_megabyte_and_are_all_accounted_for() -> None:
    bench, text = Bench(), io.StringIO()
    stream = logging.StreamHandler(text)
    stream.setFormatter(
        logging.Formatter("%(asctime)s %(levelname)s %(kernel)s/%(component)s %(hook)s %(tick)d: %(message)s")
    )
    bench.logger.handlers[:] = [stream]
    count = 100_000
    for number in range(count):
        bench.now = number * SECOND // count
        bench.log.info(f"line {number}")
    assert 0 < len(text.getvalue().encode()) <= BYTES_PER_SECOND
    bench.now = SECOND
    bench.log.info("next second")
    lines = text.getvalue().splitlines()
    (told,) = re.findall(r"log output over 200 kB/s: (\d+) lines dropped", text.getvalue())
    assert len(lines) - 2 + int(told) == count


@pytest.mark.slow
@pytest.mark.fault("A21")
def test_a_flooding_component_takes_nothing_from_another() -> None:
    loud, quiet = Bench("loud"), Bench("quiet")
    for number in range(20_000):
        loud.log.info(f"{number}")
        if number % 1_000 == 0:
            quiet.log.info(f"{number}")
    assert len(loud.out.records) < 3_000
    assert quiet.out.lines == [str(number) for number in range(0, 20_000, 1_000)]


@pytest.mark.fault("A21")
def test_tracebacks_and_long_lines_count_as_output(bench: Bench) -> None:
    def deep(level: int) -> None:
        if level == 0:
            raise ValueError("x" * 1_000)
        deep(level - 1)

    out = io.StringIO()
    bench.logger.handlers[:] = [logging.StreamHandler(out)]
    for number in range(1_000):
        try:
            deep(20)
        except ValueError:
            bench.log.exception(f"{number}")
    bench.log.info("y" * 5_000_000)
    assert 10_000 < len(out.getvalue()) < 1_000_000
    assert "yyyy" not in out.getvalue()


def test_dropped_lines_are_told_once_each_second_and_at_flush(bench: Bench) -> None:
    for second in range(3):
        bench.now = second * SECOND
        for number in range(5):
            bench.log.info(f"{second} {number} {'z' * 60_000}")
    bench.log.flush()
    told = [line for line in bench.out.lines if "dropped" in line]
    assert told == ["log output over 200 kB/s: 2 lines dropped"] * 3
    assert [record.levelno for record in bench.out.records if "dropped" in record.getMessage()] == [logging.WARNING] * 3


@pytest.mark.slow(kept_by="first")
@given(
    st.lists(
        st.tuples(
            st.integers(0, 2 * SECOND),
            st.sampled_from([10, 20, 40]),
            st.sampled_from(["a", "b", "c" * 70_000, "d" * 300_000]) | st.text(max_size=3),
        ),
        max_size=400,
    )
)
def test_no_line_is_ever_lost_without_a_count(calls: list[tuple[int, int, str]]) -> None:
    bench = Bench()
    for pause, level, text in calls:
        bench.now += pause // 4
        bench.log.log(level, text)
    bench.log.flush()
    lines = repeated = dropped = 0
    for record in bench.out.records:
        count = getattr(record, "dropped", 0)
        dropped += count
        repeated += record.repeated  # type: ignore[attr-defined]
        lines += 0 if count or record.args else 1  # only lines that tell a count have arguments here
    assert lines + repeated + dropped == len(calls)


@pytest.mark.slow
def test_many_templates_take_bounded_memory(bench: Bench) -> None:
    for number in range(5_000):
        bench.log.info(f"{number}")
        bench.log.info(f"{number}")
    assert len(bench.log._keys) <= 256


def test_lines_from_several_threads_are_all_accounted_for(bench: Bench) -> None:
    def shout() -> None:
        for number in range(500):
            bench.log.info("same %d", number)

    threads = [threading.Thread(target=shout) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    bench.log.flush()
    first, last = bench.out.lines
    assert first == "same 0"
    assert last.startswith("same ")
    assert last.endswith(" (the last of 1999 more like this)")


@pytest.fixture
def standard_logger() -> Iterator[Memory]:
    out, logger = Memory(), logging.getLogger(LOGGER_NAME)
    logger.addHandler(out)
    yield out
    logger.removeHandler(out)


def test_without_a_logger_of_its_own_it_uses_the_standard_one(standard_logger: Memory) -> None:
    ComponentLog(lambda: LogFields("k", "c"), lambda: 0).warning("hello")
    assert [(record.name, record.getMessage()) for record in standard_logger.records] == [("aiorts.component", "hello")]


@pytest.mark.slow
def test_importing_configures_no_logging() -> None:
    code = (
        "import logging; before = (logging.root.level, list(logging.root.handlers), logging.getLoggerClass())\n"
        "import aiorts, aiorts.kernel.loop.log\n"
        "assert before == (logging.root.level, list(logging.root.handlers), logging.getLoggerClass())\n"
        "mine = [logger for name, logger in logging.root.manager.loggerDict.items() if name.startswith('aiorts')]\n"
        "assert not any(getattr(logger, 'handlers', ()) or getattr(logger, 'level', 0) for logger in mine), mine\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
