"""`aiorts run --print` and `--json`: what a system sends, and how its run ended."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import folder_of, here, limited


@pytest.mark.parametrize("how", [("--simulate",), ()])
def test_each_sample_of_the_named_ports_is_a_line(tmp_path: Path, how: tuple[str, ...]) -> None:
    system = folder_of(tmp_path) / "system.toml"
    system.write_text(system.read_text().replace("rate = 100.0", "rate = 1000.0").replace("params.count = 1000000", ""))
    done = here(tmp_path, "run", "system.toml", "--print", "count*.out", *how, "--set", "counter.count=40")
    assert (done.returncode, done.stderr) == (0, "")
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert lines == [{"port": "counter.out", "type": "TimedLong", "tm": 0, "data": n} for n in range(40)]


@pytest.mark.slow(kept_by="test_each_sample_of_the_named_ports_is_a_line")
def test_a_port_of_a_component_in_a_process_of_its_own_is_printed(tmp_path: Path) -> None:
    """The way to it had no name: "path '.1': component name '': is empty"."""
    system = folder_of(tmp_path) / "system.toml"
    text = system.read_text().replace('type = "parts.py:Counter"', 'type = "parts.py:Counter"\nisolation = "process"')
    system.write_text(text.replace("params.count = 1000000", ""))
    done = here(tmp_path, "run", "system.toml", "--print", "counter.out", "--set", "counter.count=5")
    assert done.returncode == 0, done.stderr
    assert [json.loads(line)["data"] for line in done.stdout.splitlines() if line.startswith("{")] == [*range(5)]


def test_json_says_why_a_system_could_not_be_made(tmp_path: Path) -> None:
    folder_of(tmp_path)
    (tmp_path / "parts.py").write_text(
        (tmp_path / "parts.py").read_text()
        + "\nclass Broken(Sink):\n    def on_initialize(self):\n        raise RuntimeError('no camera')\n"
    )
    system = tmp_path / "system.toml"
    system.write_text(system.read_text().replace('"parts.py:Sink"', '"parts.py:Broken"'))
    done = here(tmp_path, "run", "system.toml", "--json", "--simulate")
    document = json.loads(done.stdout)
    assert (done.returncode, document["status"]) == (1, 1)
    assert "no camera" in document["error"]["text"]


def test_a_port_that_is_not_there_is_refused_with_the_nearest(tmp_path: Path) -> None:
    folder_of(tmp_path)
    done = here(tmp_path, "run", "system.toml", "--print", "counter.ouf")
    assert done.returncode == 2
    assert "--print: no out-port is called 'counter.ouf'; did you mean 'counter.out'?" in done.stderr


@pytest.mark.slow
def test_a_reader_that_goes_ends_the_run(tmp_path: Path) -> None:
    system = folder_of(tmp_path) / "system.toml"
    system.write_text(system.read_text().replace('type = "parts.py:Sink"', 'type = "parts.py:Quiet"'))
    with (tmp_path / "parts.py").open("a") as parts:
        parts.write("\nclass Quiet(Sink):\n    def on_activated(self): pass\n    def on_deactivated(self): pass\n")
    command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--print", "counter.out"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        with limited(run):
            assert json.loads(run.stdout.readline())["data"] == 0
            run.stdout.close()
            assert run.wait() == 141


def test_json_is_one_document_of_what_ran_and_how_it_ended(tmp_path: Path) -> None:
    folder_of(tmp_path)
    words = ("run", "system.toml", "--json", "--simulate", "--set", "counter.count=9")
    done = here(tmp_path, *words, "--set", "sink.limit=5")
    document = json.loads(done.stdout)
    assert (done.returncode, document["status"], document["errors"]) == (3, 3, {"sink": "ValueError: too much"})
    assert document["profile"]["connectors"]["counter.out-sink.numbers"]["ledger"]["written"] == 9
    assert "ready" in done.stderr
    good = json.loads(here(tmp_path, *words).stdout)
    assert (good["status"], good["errors"]) == (0, {})
    none = here(tmp_path, "run", "none.toml", "--json")
    assert json.loads(none.stdout)["error"]["code"] == "E-SYSTEM"
    assert none.returncode == 2
