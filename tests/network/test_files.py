"""A client of another host names files below the folder of the run alone, whatever way the path comes in."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from file_parts import PLACES, SECRET, WAYS, made
from network.test_other_hosts import WAIT, Far

pytestmark = pytest.mark.slow(
    kept_by="control/test_files.py::test_who_operates_names_files_below_the_folder_of_the_run"
)

TESTS = Path(__file__).parents[1]
SYSTEM = """
schema = 1
[components.log]
type = "FlexiLogger"
params = { logfile = "own.mcap", inputs = ["TimedDouble"] }
[components.keeper]
type = "parts.py:Keeper"
[contexts.loop]
members = ["keeper"]
kind = "event"
"""


class FarFiles(Far):
    """A run with a logger, and with a component that is called with paths."""

    system = SYSTEM
    parts = (TESTS / "file_parts.py").read_text()


@pytest.fixture(params=[True, False], ids=["files", "no files"])
def filing(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[FarFiles, bool]]:
    allowed = made(tmp_path)
    options = ("--files", str(allowed)) if request.param else ()
    run = FarFiles(tmp_path, "--allow-control", *options)
    until = time.monotonic() + WAIT
    try:
        while "keeper" not in run.do("ls")[1]:
            assert time.monotonic() < until, run.log.read_text()
        yield run, request.param
    finally:
        run.close()


@pytest.mark.row(91)
def test_no_way_leads_out_of_the_folder(filing: tuple[FarFiles, bool], tmp_path: Path) -> None:
    run, files = filing
    refused = [place for place, (_, allowed) in PLACES.items() if not (allowed and files)]
    program = [sys.executable, str(Path(__file__).with_name("naming_program.py")), "robot", str(tmp_path), *refused]
    with run.start(stdin=subprocess.PIPE) as at:
        try:
            output, errors = at.communicate(f"PYTHONPATH={TESTS} exec {shlex.join(program)}\n", timeout=3 * WAIT)
        except BaseException:
            at.kill()
            raise
    assert at.returncode == 0, errors
    codes = json.loads(output)
    assert len(codes) == len(WAYS) * len(refused)
    for asked, code in codes.items():
        assert code == ("E-APPLY" if asked.startswith(("apply", "change")) else "E-DENIED"), asked
    assert (tmp_path / "secret.txt").read_text() == SECRET
    assert "new" not in run.do("ls")[1].split()


@pytest.mark.row(91)
def test_the_commands_of_the_attack_are_refused_and_those_below_the_folder_done(
    filing: tuple[FarFiles, bool], tmp_path: Path
) -> None:
    run, files = filing
    more = "existing=overwrite", "text=true", 'inputs=["TimedDouble"]'
    status, _, said = run.do("comp", "create", "FlexiLogger", f"logfile={tmp_path / 'secret.txt'}", *more)
    assert (status, "E-DENIED" in said) == (4, True), said
    status, _, said = run.do("conf", "log", f"logfile={tmp_path / 'secret.txt'}")
    assert (status, "E-DENIED" in said) == (4, True), said
    status, _, said = run.do("comp", "create", "FlexiLogger", f"logfile={tmp_path / 'secret.txt'}", "mode=replay")
    assert (status, "E-DENIED" in said, SECRET[:4] in said) == (4, True, False), said
    status, _, said = run.do("conf", "log", f"logfile={tmp_path / 'allowed' / 'new.txt'}")
    assert status == (0 if files else 4), said
    assert (tmp_path / "secret.txt").read_text() == SECRET
