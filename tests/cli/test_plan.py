"""`aiorts plan OLD NEW`: the steps in order, and a status that scripts go by."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aiorts.cli.app import run_command

SYSTEM = """schema = 1
[components.const]
type = "FlexiConst"
params = { outputs = ["TimedDouble"], constants = ["1"] }
[components.dump]
type = "FlexiDump"
params.inputs = ["TimedDouble"]
[[connections]]
from = "const.output"
to = "dump.input0"
[contexts.work]
kind = "event"
members = ["const", "dump"]
"""
MORE = """[components.other]
type = "FlexiDump"
params.inputs = ["TimedDouble"]
[[connections]]
from = "const.output"
to = "other.input0"
length = 3
[contexts.slow]
kind = "periodic"
rate = 1.0
members = ["other"]
"""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.toml"
    path.write_text(SYSTEM)
    return path


def test_the_same_system_is_no_plan(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (new := old.with_name("new.toml")).write_text(SYSTEM.replace('kind = "event"', 'kind = "event"\nactivate = true'))
    assert run_command(["plan", str(old), str(new)]) == 0
    assert capsys.readouterr() == ("", "")


def test_steps_are_printed_in_order_with_status_1(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (new := old.with_name("new.toml")).write_text(SYSTEM.replace('["1"]', '["2"]') + MORE)
    assert run_command(["plan", str(old), str(new)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "+ create other (FlexiDump)",
        "+ start context slow (periodic, 1.0 Hz)",
        "~ configure const: params.constants ['1'] -> ['2']",
        "+ connect const.output -> other.input0 (length 3)",
        "~ move slow: +other",
    ]
    assert run_command(["plan", "--json", str(new), str(old)]) == 1
    said = json.loads(capsys.readouterr().out)
    assert [step["step"] for step in said["steps"]] == [
        *("Disconnect", "Configure", "Move", "StopContext", "Remove"),
    ]
    assert said["refused"] == []


def test_what_is_set_is_of_the_new_one(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["plan", str(old), str(old), "--set", "dump.rate_limit=2"]) == 1
    assert capsys.readouterr().out == "~ configure dump: params.rate_limit default -> 2.0\n"


def test_what_cannot_be_done_and_what_is_wrong_is_status_2(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (new := old.with_name("new.toml")).write_text(SYSTEM + '[clock]\nkind = "simulated"\n')
    assert run_command(["plan", str(old), str(new)]) == 2
    assert "the clock of a system that runs cannot be changed" in capsys.readouterr().err
    assert run_command(["plan", "--json", str(old), str(new)]) == 2
    assert len(json.loads(capsys.readouterr().out)["refused"]) == 1
    new.write_text(SYSTEM.replace("FlexiDump", "FlexiDmp"))
    assert run_command(["plan", str(old), str(new)]) == 2
    assert "new.toml:6:8: components.dump.type" in capsys.readouterr().err


def test_what_cannot_run_at_all_is_no_plan(old: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (new := old.with_name("new.toml")).write_text(SYSTEM.replace('"dump.input0"', '"dump.input7"'))
    assert run_command(["plan", str(old), str(new)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert "new.toml:10:6: connections[1].to: " in said.err
    assert "input7" in said.err
