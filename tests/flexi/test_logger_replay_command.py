"""`aiorts flexilogger -o`: what it prints, its exit status, and that a replay keeps its time beside a bare timer."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import aiorts
from aiorts.cli.app import run_command
from aiorts.system import check, parse_options
from aiorts.types import TimedDouble
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import RecordingReader
from campaign import CAMPAIGN
from play_parts import BEGIN, MS, foreign, recorded, steady
from replay_timing import measure_replay

COMMAND = [sys.executable, "-P", "-c", "import sys; from aiorts.cli import main; sys.exit(main())"]


def command(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, list[dict[str, Any]], list[str]]:
    """Exit status, the lines of standard output as data, those of standard error."""
    capfd.readouterr()
    status = run_command(["flexilogger", "-o", *map(str, arguments)])
    said = capfd.readouterr()
    return status, [json.loads(line) for line in said.out.splitlines()], said.err.splitlines()


def test_a_recorded_name_with_dots_is_told_in_the_form_that_its_replay_has(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", [("lidar.scan", BEGIN, TimedDouble(BEGIN, 1.0))])
    system = tmp_path / "system.toml"
    system.write_text(
        "schema = 1\n"
        '[components.play]\ntype = "FlexiLogger"\noptions = ["-o", "-l", "run.mcap"]\n'
        '[components.show]\ntype = "FlexiDump"\noptions = ["-p", "TimedDouble"]\n'
        '[[connections]]\nfrom = "play.lidar.scan"\nto = "show.input0"\n'
        '[contexts.all]\nkind = "event"\nmembers = ["play", "show"]\n'
    )
    (one,) = [one for one in check(system) if one.severity == "error"]
    assert (one.remedy, one.mended) == ("did you mean 'play.lidar_scan'?", '"play.lidar_scan"')
    system.write_text(system.read_text().replace("lidar.scan", "lidar_scan"))
    assert [one for one in check(system) if one.severity == "error"] == []


@pytest.mark.slow(kept_by="test_options_choose_what_is_played")
@pytest.mark.row(115)
def test_in_a_pipe_it_prints_what_was_recorded_and_both_ends_are_content(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", [("a", BEGIN + i * MS, TimedDouble(BEGIN + i * MS, i / 2)) for i in range(300)])
    with subprocess.Popen(
        [*COMMAND, "flexilogger", "-o", "-a", "-l", "run.mcap"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
    ) as player:
        shown = subprocess.run(
            [*COMMAND, "flexidump", "-p", "TimedDouble"],
            stdin=player.stdout,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert player.stderr is not None
        assert (player.wait(60), player.stderr.read()) == (0, b"")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert shown.stdout.splitlines() == [f"input0 TimedDouble 1700000000.{i:03d}000000: {i / 2}" for i in range(300)]


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(116)
@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--speed", "max"], [*range(100)]),
        (["--speed", "max", "--loop", "3"], [*range(100)] * 3),
        (["--speed", "max", "--loop", "--count", "250"], [*range(100), *range(100), *range(50)]),
        (["--speed", "1000", "--start", "+0.2", "--end", "+0.25"], [*range(20, 25)]),
        (["-g", "1e6", "--start", "1700000000.9"], [*range(90, 100)]),
        (["--speed", "max", "--ports", "a", "--end", "+0.05"], [0, 2, 4]),
        (["--speed", "max", "--skip", "a", "--end", "+0.05"], [1, 3]),
    ],
)
def test_options_choose_what_is_played(
    arguments: list[str], expected: list[int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = steady(tmp_path / "a.mcap", 100)
    status, out, err = command(capfd, "-l", path, *arguments)
    assert (status, err) == (0, [])
    # A filter writes what it finds by port; in a port nothing changes its place.
    for part in (0, 1):
        assert [line["data"] for line in out if line["data"] % 2 == part] == [n for n in expected if n % 2 == part]


@pytest.mark.parametrize(
    ("options", "params"),
    [
        ("-o --speed max", {"mode": "replay", "speed": None}),
        ("-o --speed=2 --loop", {"mode": "replay", "speed": "2", "loop": "0"}),
        ("--loop 3 -o", {"mode": "replay", "loop": "3"}),
        ("--loop=3 --remap a=b --remap c=d", {"loop": "3", "remap": ("a=b", "c=d")}),
        ("--loop -a", {"loop": "0", "absolute": True}),
    ],
)
def test_in_a_system_file_the_same_options_say_the_same(options: str, params: dict[str, Any]) -> None:
    assert parse_options(FlexiLogger, options.split()) == params


@pytest.mark.slow(kept_by="flexi/test_replaying.py::TestPorts::test_chosen_left_out_and_renamed")
def test_ports_have_the_names_that_they_are_given(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = steady(tmp_path / "a.mcap", 2)
    status, out, _ = command(capfd, "-l", path, "--speed", "max", "--remap", "a=x", "--remap", "b=y", "-a")
    assert (status, [line["port"] for line in out]) == (0, ["x", "y"])
    assert out[0] == {"port": "x", "type": "TimedDouble", "tm": BEGIN, "data": 0.0}


@pytest.mark.fault("D15")
@pytest.mark.parametrize("option", ["-g", "--speed", "--max-gap"])
@pytest.mark.parametrize("value", ["0", "-1", "1e19", "nan", "inf", "fast", ""])
def test_a_rate_that_makes_no_sense_is_status_2_and_one_line(
    option: str, value: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = steady(tmp_path / "a.mcap", 2)
    status, out, err = command(capfd, "-l", path, option, value)
    assert (status, out, len(err)) == (2, [], 1), err
    assert "--" in err[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-l", "nix.mcap"], "nix.mcap: cannot be read: No such file"),
        (["-l", "{path}", "--start", "soon"], "(--start): expected +SECONDS"),
        (["-l", "{path}", "--ports", "c"], "has no port 'c'; there are 'a', 'b'"),
        (["-l", "{path}", "--remap", "a"], "expected OLD=NEW"),
        (["-l", "{path}", "--loop", "x"], "--loop 'x': must be an int"),
        (["-l", "{path}", "-o", "--loop=-1"], "--loop '-1': must be >= 0"),
        (["--loop=-1"], "--loop '-1': must be >= 0"),
        (["-l", "{path}", "--loop=-x", "-o"], "--loop '-x': must be an int"),
    ],
)
def test_what_was_typed_wrong_is_status_2(
    arguments: list[str], message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = steady(tmp_path / "a.mcap", 2)
    status, out, err = command(capfd, *(argument.format(path=path) for argument in arguments))
    assert (status, out) == (2, [])
    assert message in err[0]


@pytest.mark.slow(
    kept_by="flexi/test_replaying.py::TestPorts::test_a_type_that_is_not_known_here_is_refused_by_its_port_and_never_imported"
)
@pytest.mark.fault("D12")
def test_a_type_that_is_not_known_here_is_named_with_what_to_do(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = foreign(tmp_path / "a.mcap", [BEGIN, BEGIN + MS], type_name="antigravity.Thing")
    status, out, err = command(capfd, "-l", path)
    assert (status, out, len(err)) == (2, [], 1)
    assert "port 'b'" in err[0]
    assert err[0].endswith("--skip b")
    assert "antigravity" not in sys.modules
    status, out, _ = command(capfd, "-l", path, "--skip", "b")
    assert (status, [line["data"] for line in out]) == (0, [0, 1])


@pytest.mark.slow(
    kept_by="flexi/test_replaying.py::TestEnd::test_of_one_that_breaks_off_or_is_damaged_everything_whole_is_played_and_then_that_is_told"
)
@pytest.mark.parametrize("strict", [False, True])
def test_a_recording_that_breaks_off_is_played_and_told_and_with_strict_a_failure(
    strict: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = steady(tmp_path / "a.mcap", 1000, chunk=2000)
    with RecordingReader(path) as reader:
        place = reader.pieces[-1].offset
    path.write_bytes(path.read_bytes()[: place + 100])
    status, out, err = command(capfd, "-l", path, "--speed", "max", *(["--strict"] if strict else []))
    assert (status, len(err)) == (3 if strict else 1, 1), err
    assert "was not closed" in err[0]
    assert len(out) > 900


@pytest.mark.slow(kept_by="log/test_schedule.py::test_each_sample_is_due_at_its_distance_from_the_first_over_the_speed")
@pytest.mark.fault("D21")
@pytest.mark.parametrize("loop", ["uvloop", "asyncio"])
def test_the_time_between_samples_is_kept_as_a_bare_timer_keeps_it(loop: str) -> None:
    """In a campaign at the figure itself where the machine allows it; in the suite with room for other work on it."""
    rounds, least, factor = (7, 5.0, 1.5) if CAMPAIGN else (1, 50.0, 10.0)
    found = aiorts.run(lambda: measure_replay(rounds=rounds, count=200 if CAMPAIGN else 60), loop=loop)
    assert found.replay.p99 <= max(least, factor * found.bare.p99), found
