"""Components as Unix filters, run as real processes: pipes, exit statuses, every line taken or reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.row(123)

PAPERS = (
    "flexifilter -i TimedFloatSeq:2 -i TimedString -i TimedLong -o TimedStringSeq:4 -o TimedFloat "
    "-m 2>0:2,0:1>0.1>0:3,0:1>1 --check"
)


def aiorts(*arguments: str, stdin: str = "", timeout: float = 60) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments], input=stdin, capture_output=True, text=True, timeout=timeout
    )


def lines(text: str) -> list[object]:
    return [json.loads(line)["data"] for line in text.splitlines()]


def test_three_filters_in_a_pipe_print_five_lines() -> None:
    command = f"{sys.executable} -m aiorts"
    pipe = (
        f"{command} flexiconst -p TimedDouble -c 6.2 -r 50 --count 5"
        f" | {command} flexifilter -i TimedDouble -o TimedLong -m '0>1000>0'"
        f" | {command} flexidump -p TimedLong"
    )
    done = subprocess.run(["bash", "-o", "pipefail", "-c", pipe], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    found = done.stdout.splitlines()
    assert len(found) == 5
    assert all(line.endswith(": 6200") for line in found)


def test_the_command_of_the_paper_prints_its_map_and_ends() -> None:
    done = aiorts(*PAPERS.split())
    assert (done.returncode, done.stderr) == (0, "")
    assert "input0:1  x 0.1   output0:3" in done.stdout


@pytest.mark.fault("F07")
@pytest.mark.parametrize("check", [[], ["--check"]])
def test_a_mistake_in_typed_text_is_one_error_with_the_place_marked(check: list[str]) -> None:
    done = aiorts("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>garbage", *check)
    assert (done.returncode, done.stdout) == (2, "")
    error, quoted, mark = done.stderr.splitlines()
    assert error.startswith("aiorts: E-CONFIG: ")
    assert quoted.index("garbage") == mark.index("^")


@pytest.mark.fault("F08")
@pytest.mark.parametrize(("kind", "constant", "data"), [("TimedLong", "0", 0), ("TimedBoolean", "False", False)])
def test_a_constant_that_is_false_is_sent_like_any_other(kind: str, constant: str, data: object) -> None:
    done = aiorts("flexiconst", "-p", kind, "-c", constant, "--count", "1")
    assert done.returncode == 0
    assert lines(done.stdout) == [data]


@pytest.mark.fault("F08")
def test_a_constant_is_never_code(tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    done = aiorts("flexiconst", "-p", "TimedLong", "-c", f"__import__('os').mkdir({str(canary)!r})", "--count", "1")
    assert done.returncode == 2
    assert "expected a literal" in done.stderr
    assert not canary.exists()


def test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1() -> None:
    done = aiorts("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1000>0", stdin="1\nx\n2\n")
    assert lines(done.stdout) == [1000, 2000]
    assert done.returncode == 1
    assert done.stderr.startswith("aiorts: E-LINE: standard input, line 2: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_hundred_thousand_lines_go_through_and_none_is_lost() -> None:
    stdin = "".join(f'{{"data": {number}}}\n' for number in range(100_000))
    done = aiorts("flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1>0", stdin=stdin)
    assert done.returncode == 0
    assert lines(done.stdout) == list(range(100_000))


def test_a_component_that_fails_ends_the_filter_with_status_1() -> None:
    done = aiorts("flexifilter", "-i", "TimedDouble", "-o", "TimedShort", "-m", "0>1>0", stdin="1\n99999\n2\n")
    assert done.returncode == 1
    assert lines(done.stdout) == [1]
    assert "E-" in done.stderr


@pytest.mark.parametrize("name", ["flexifilter", "flexidump"])
def test_after_count_samples_it_ends(name: str) -> None:
    options = ["-p", "TimedLong"] if name == "flexidump" else ["-i", "TimedLong", "-o", "TimedLong"]
    done = aiorts(name, *options, "--count", "2", stdin="1\n2\n3\n4\n")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 2


@pytest.mark.fault("F11")
def test_a_reader_that_goes_away_ends_it_quietly() -> None:
    command = f"{sys.executable} -m aiorts flexiconst -p TimedDouble -c 0 --continuous | head -1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert (len(done.stdout.splitlines()), done.stderr) == (1, "")


@pytest.mark.fault("F12")
@pytest.mark.parametrize("redirection", ["</dev/null", "<&-"])
def test_without_input_it_ends_at_once(redirection: str) -> None:
    command = f"{sys.executable} -m aiorts flexidump -p TimedLong {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


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
    assert process.stderr is not None
    assert "reading JSON lines for input0 (TimedLong)" in process.stderr.readline()
    os.write(leader, b"5\n\x04")
    out, err = process.communicate(timeout=30)
    os.close(leader)
    assert (out, err, process.returncode) == ("5\n", "", 0)


def test_help_and_unknown_names() -> None:
    done = aiorts("flexidump", "--help")
    assert done.returncode == 0
    assert "--rate-limit" in done.stdout
    done = aiorts("flexidmp")
    assert done.returncode == 2
    assert "did you mean 'flexidump'?" in done.stderr
    done = aiorts("flexidump", "--colour")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
