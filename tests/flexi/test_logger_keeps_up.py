"""FlexiLogger beside a faster writer: what it loses is its failure, `check` sees it coming, and one period has room."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from aiorts.errors import SLOW_READER
from aiorts.system import check
from log_parts import read
from run_parts import here

SYSTEM = """
schema = 1
[components.wheel]
type = "FlexiConst"
options = ["-p", "TimedLong", "-c", "1", "-r", "1000", "--count", "1500"]
[components.log]
type = "FlexiLogger"
options = ["-p", "TimedLong", "-l", "run.mcap", "--min-free", "0"]
[[connections]]
from = "wheel.output"
to = "log.input0"
{connection}
[contexts.fast]
kind = "periodic"
rate = 1000.0
members = ["wheel"]
[contexts.slow]
{context}
members = ["log"]
"""
TWICE = 'kind = "periodic"\nrate = 2.0'


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("connection", "context", "keeps_up"),
    [
        ("", TWICE, True),
        ("length = 8", TWICE, False),
        ("length = 499", TWICE, False),
        ("length = 501", TWICE, True),
        ('length = 8\nsubscription = "new"\npush = "all"', TWICE, False),
        ('length = 8\nfull = "reject"', TWICE, False),
        ('length = 8\nfull = "block"\ntimeout = inf', TWICE, True),
        ("length = 8", 'kind = "event"', True),
        ("", 'kind = "periodic"\nrate = 0.5', False),
    ],
)
def test_what_a_recorder_loses_is_its_failure_and_check_sees_it_coming(
    connection: str, context: str, keeps_up: bool, tmp_path: Path
) -> None:
    path = tmp_path / "system.toml"
    path.write_text(SYSTEM.format(connection=connection, context=context))
    found = [one for one in check(path) if one.severity != "note"]
    done = here(tmp_path, "run", "system.toml", "--simulate")
    stored = len(read(tmp_path / "run.mcap"))
    if keeps_up:
        assert (found, done.returncode, done.stderr, stored) == ([], 0, "", 1500)
        return
    (one,) = found
    assert (one.code, one.severity, one.where) == ("W-DROPPED", "warning", "connections[1]")
    assert one.remedy.endswith(SLOW_READER)
    assert done.returncode == 1
    assert f"run.mcap: is not complete: {1500 - stored} samples that were sent are not in it" in done.stderr
    advised = re.search(r"length = (\d+)", one.remedy)
    assert advised is not None
    (tmp_path / "run.mcap").unlink()
    better = re.sub(r"length = \d+", "", connection) + f"\nlength = {advised[1]}"
    path.write_text(SYSTEM.format(connection=better, context=context))
    done = here(tmp_path, "run", "system.toml", "--simulate")
    assert (done.returncode, done.stderr, len(read(tmp_path / "run.mcap"))) == (0, "", 1500)


def test_a_reader_that_takes_the_newest_alone_is_not_warned_of(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(
        "from aiorts import Component, InPort\n"
        "from aiorts.types import TimedLong\n"
        "class Newest(Component):\n"
        "    input0 = InPort(TimedLong)\n"
    )
    path = tmp_path / "system.toml"
    options = 'options = ["-p", "TimedLong", "-l", "run.mcap", "--min-free", "0"]'
    text = SYSTEM.format(connection="", context=TWICE)
    path.write_text(text.replace('type = "FlexiLogger"', 'type = "parts.py:Newest"').replace(options, ""))
    assert check(path) == ()
