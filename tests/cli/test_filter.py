"""Components as Unix filters, run as real processes: pipes, exit statuses, every line taken or reported."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.console.report import LONGEST
from aiorts_flexi.mapping.grammar import LONGEST_MAP
from run_parts import here, limited

pytestmark = pytest.mark.row(123)

PAPERS = (
    "flexifilter -i TimedFloatSeq:2 -i TimedString -i TimedLong -o TimedStringSeq:4 -o TimedFloat "
    "-m 2>0:2,0:1>0.1>0:3,0:1>1 --check"
)


def aiorts(*arguments: str, stdin: str = "", timeout: float = 40) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments], input=stdin, capture_output=True, text=True, timeout=timeout
    )


def lines(text: str) -> list[object]:
    return [json.loads(line)["data"] for line in text.splitlines()]


@pytest.mark.slow(kept_by="test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1")
def test_three_filters_in_a_pipe_print_five_lines() -> None:
    command = f"{sys.executable} -m aiorts"
    pipe = (
        f"{command} flexiconst -p TimedDouble -c 6.2 -r 50 --count 5"
        f" | {command} flexifilter -i TimedDouble -o TimedLong -m '0>1000>0'"
        f" | {command} flexidump -p TimedLong"
    )
    done = subprocess.run(["bash", "-o", "pipefail", "-c", pipe], capture_output=True, text=True, timeout=40)
    assert (done.returncode, done.stderr) == (0, "")
    found = done.stdout.splitlines()
    assert len(found) == 5
    assert all(line.endswith(": 6200") for line in found)


def test_the_command_of_the_paper_prints_its_map_and_ends() -> None:
    done = here(*PAPERS.split())
    assert (done.returncode, done.stderr) == (0, "")
    assert "input0:1  x 0.1   output0:3" in done.stdout


@pytest.mark.fault("F06")
@pytest.mark.fault("F07")
@pytest.mark.parametrize(
    ("options", "place"),
    [
        *((["-i", "TimedFoo"], 0), (["-i", "TimedLong:3"], 9), (["-i", "TimedLongSeq"], 12)),
        *(
            (["-i", "TimedLongSeq:0"], 13),
            (["-i", ":"], 0),
            (["-i", "a:b:c"], 0),
            (["-i", f"TimedLongSeq:{10**9}"], 13),
        ),
        *((["-m", "garbage"], 0), (["-m", "-1>0"], 0), (["-m", "0:1>>0"], 4), (["-m", "0>0>0>0"], 5)),
        *((["-m", "0>0,0>0"], 4), (["-m", "0:1>0"], 0), (["-m", "0>1.2.3>0"], 5), (["-m", "0>inf>0"], 2)),
        (["-m", "0>0," * 1_000_000], LONGEST_MAP),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_bad_port_or_map_is_one_error_with_a_mark_under_it(
    options: list[str], place: int, capsys: pytest.CaptureFixture[str]
) -> None:
    usual = {"-i": "TimedLong", "-o": "TimedLong", options[0]: options[1]}
    assert run_command(["flexifilter", *itertools.chain(*usual.items()), "--check"]) == 2
    out, err = capsys.readouterr()
    error, quoted, mark = err.splitlines()
    assert out == ""
    assert error.startswith("aiorts: E-CONFIG: ")
    assert len(error) <= LONGEST
    at = mark.index("^")
    assert quoted[at : at + 1] == options[1][place : place + 1]
    assert quoted.strip().removeprefix("...").removesuffix("...") in options[1]  # long text is cut round the place


@pytest.mark.parametrize("text", ["0>1e3>0", "0 > 0", "0>1000-5>0", "0>1+0.5>0", "0>1-5e3>0"])
def test_good_maps_are_tables(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["flexifilter", "-i", "TimedLong", "-o", "TimedDouble", "-m", text, "--check"]) == 0
    heading, row = capsys.readouterr().out.splitlines()
    assert heading.split() == ["from", "factor", "to", "value"]
    factor = {"0>1e3>0": "x 1000.0", "0>1000-5>0": "x 1000 - 5", "0>1+0.5>0": "x 1 + 0.5", "0>1-5e3>0": "x 1 - 5000.0"}
    assert row.split() == ["input0", *factor.get(text, "").split(), "output0", "i32", "->", "f64"]


@pytest.mark.fault("F07")
@pytest.mark.parametrize("check", [[], ["--check"]])
def test_a_mistake_in_typed_text_is_one_error_with_the_place_marked(check: list[str]) -> None:
    done = here("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>garbage", *check)
    assert (done.returncode, done.stdout) == (2, "")
    error, quoted, mark = done.stderr.splitlines()
    assert error.startswith("aiorts: E-CONFIG: ")
    assert quoted.index("garbage") == mark.index("^")


@pytest.mark.fault("F08")
@pytest.mark.parametrize(("kind", "constant", "data"), [("TimedLong", "0", 0), ("TimedBoolean", "False", False)])
def test_a_constant_that_is_false_is_sent_like_any_other(kind: str, constant: str, data: object) -> None:
    done = here("flexiconst", "-p", kind, "-c", constant, "--count", "1")
    assert done.returncode == 0
    assert lines(done.stdout) == [data]


@pytest.mark.fault("F08")
def test_a_constant_is_never_code(tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    done = here("flexiconst", "-p", "TimedLong", "-c", f"__import__('os').mkdir({str(canary)!r})", "--count", "1")
    assert done.returncode == 2
    assert "expected a literal" in done.stderr
    assert not canary.exists()


def test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1() -> None:
    done = here("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1000>0", stdin="1\nx\n2\n")
    assert lines(done.stdout) == [1000, 2000]
    assert done.returncode == 1
    assert done.stderr.startswith("aiorts: E-LINE: standard input, line 2: ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow(kept_by="test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1")
def test_a_hundred_thousand_lines_go_through_and_none_is_lost() -> None:
    stdin = "".join(f'{{"data": {number}}}\n' for number in range(100_000))
    done = aiorts("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1>0", stdin=stdin)
    assert done.returncode == 0
    assert lines(done.stdout) == list(range(100_000))


def test_a_component_that_fails_ends_the_filter_with_status_3() -> None:
    sums = [{"port": f"input{number % 2}", "data": data} for number, data in enumerate([1, 32767, -9])]
    done = here("flexiadd", "-p", "TimedShort:2", stdin="\n".join(map(json.dumps, sums)))
    assert done.returncode == 3
    assert lines(done.stdout) == [1]  # 1 + 32767 is more than a TimedShort holds
    assert "E-CONVERT" in done.stderr


@pytest.mark.parametrize("name", ["flexifilter", "flexidump"])
def test_after_count_samples_it_ends(name: str) -> None:
    options = ["-p", "TimedLong"] if name == "flexidump" else ["-i", "TimedLong", "-o", "TimedLong"]
    done = here(name, *options, "--count", "2", stdin="1\n2\n3\n4\n")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 2


def test_at_the_end_of_input_what_is_left_is_processed_and_components_are_deactivated() -> None:
    done = here("flexidump", "-p", "TimedLong", "--rate-limit", "0.001", "--debug", stdin="1\n2\n3\n")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 1
    assert "2 samples were not shown" in done.stderr  # which it says when it is deactivated


@pytest.mark.slow(kept_by="test_at_the_end_of_input_what_is_left_is_processed_and_components_are_deactivated")
def test_a_terminal_is_told_what_is_awaited() -> None:
    leader, follower = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "flexidump", "-p", "TimedLong", "--format", "values"],
        stdin=follower,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(follower)
    with limited(process):
        assert process.stderr is not None
        assert "reading JSON lines for input0 (TimedLong)" in process.stderr.readline()
        os.write(leader, b"5\n\x04")
        out, err = process.communicate(timeout=30)
    os.close(leader)
    assert (out, err, process.returncode) == ("5\n", "", 0)


def test_help_and_unknown_names() -> None:
    done = here("flexidump", "--help")
    assert done.returncode == 0
    assert "--rate-limit" in done.stdout
    done = here("flexidmp")
    assert done.returncode == 2
    assert "did you mean 'flexidump'?" in done.stderr
    done = here("flexidump", "--colour")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
