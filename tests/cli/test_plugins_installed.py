"""Broken plugins that are really installed: each is named with its distribution and file, and nothing else suffers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from campaign import CAMPAIGN
from plugin_dists import COMPONENT, install

pytestmark = pytest.mark.fault("F05")
# Text of the module, and what the check says of it.
NINE = {
    "missing": ("import no_such_module\n", "ModuleNotFoundError: No module named 'no_such_module'"),
    "syntax": ("x = 1\ndef broken(:\n", "SyntaxError"),
    "exits": ("raise SystemExit(3)\n", "SystemExit: 3"),
    "hangs": ("while True: pass\n", "still being imported after 3 s"),
    "crashes": ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n", "ended the interpreter by SIGSEGV"),
    "prints": ("print('hello')\n" + COMPONENT, "writes to standard output or error"),
    "patches": (
        "import json, aiorts\njson.dumps = lambda x: ''\naiorts.Component.on_execute = print\n" + COMPONENT,
        "changes json.dumps; changes aiorts.kernel.component.Component.on_execute",
    ),
    "old": ("AIORTS_API = 0\n" + COMPONENT, "written for version 0 of the plugin interface"),
    "twice": (COMPONENT, "the name is offered 2 times, also by good_part:Good (package good-part 1.0)"),
}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    for name, (text, _) in NINE.items():
        offered = "Good" if name == "twice" else name.capitalize()
        entries = {f"components/{offered}": f"bad_{name}:Good"}
        if name in ("missing", "exits", "old", "twice"):
            entries[f"commands/bad-{name}"] = f"bad_{name}:Good"
        install(folder, f"bad-{name}", {f"bad_{name}": text}, entries)
    install(folder, "good-part", {"good_part": COMPONENT}, {"components/Good": "good_part:Good"})
    install(folder, "fine-part", {"fine_part": COMPONENT}, {"components/Fine": "fine_part:Good"})
    return folder


def aiorts(site: Path, *arguments: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH", ""))))
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=40,
        env={**os.environ, "PYTHONPATH": path},
    )


@pytest.mark.slow(kept_by="extensions/test_loading.py::test_a_broken_plugin_is_named_and_the_others_work")
def test_each_of_nine_is_named_with_its_distribution_and_file_and_all_others_are_in_order(site: Path) -> None:
    done = aiorts(site, "plugins", "--check", "--limit", "3", "--json")
    assert done.returncode == 1
    found = {one["target"]: one for one in json.loads(done.stdout)["extensions"] if one["kind"] == "components"}
    for name, (_, expected) in NINE.items():
        bad = found[f"bad_{name}:Good"]
        assert expected in bad["verdict"], name
        assert bad["source"] == f"package bad-{name} 1.0"
        assert bad["file"] == str(site / f"bad_{name}.py")
    assert found["fine_part:Good"]["verdict"] == "ok"
    assert found["aiorts_flexi.add:FlexiAdd"]["verdict"] == "ok"
    assert "component 'Good' is offered twice, by " in done.stderr


@pytest.mark.slow(kept_by="cli/test_plugins.py::test_what_is_installed_is_listed_and_nothing_imported")
def test_the_list_and_the_table_need_no_import(site: Path) -> None:
    done = aiorts(site, "plugins")
    assert "hello" not in done.stdout
    for name in NINE:
        assert f"package bad-{name} 1.0" in done.stdout
    # One name that two offer is the only thing that can be wrong without looking.
    assert done.returncode == 1
    assert all("offered twice" in line for line in done.stderr.splitlines())


@pytest.mark.slow(kept_by="test_help_takes_half_a_second_at_the_most")
def test_help_is_fast_beside_all_of_them(site: Path) -> None:
    for _ in range(3):
        began = _seconds_of_children()
        done = aiorts(site, "--help")
        # Of the processor, 0.1 s: what the clock says, the long version promises.
        assert _seconds_of_children() - began <= 0.5
        assert (done.returncode, done.stderr) == (0, "")
        assert "fine" in done.stdout
        assert "bad-exits" in done.stdout


def _seconds_of_children() -> float:
    times = os.times()
    return times.children_user + times.children_system


@pytest.mark.campaign
@pytest.mark.skipif(not CAMPAIGN, reason="a long one; AIORTS_CAMPAIGN=1")
def test_help_takes_half_a_second_at_the_most(site: Path) -> None:
    took = []
    for _ in range(100):
        began = time.perf_counter()
        assert aiorts(site, "--help").returncode == 0
        took.append(time.perf_counter() - began)
    assert sorted(took)[94] <= 0.5


@pytest.mark.slow(kept_by="test_help_takes_half_a_second_at_the_most")
def test_a_component_beside_them_runs(site: Path) -> None:
    done = aiorts(site, "fine", "--for", "0.1")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow(
    kept_by="cli/test_plugins_commands.py::test_a_command_that_fails_is_one_line_and_its_traceback_is_there_on_demand"
)
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("bad-missing", "command 'bad-missing' of package bad-missing 1.0 (bad_missing:Good) cannot be loaded: "),
        ("bad-exits", "SystemExit: 3"),
        ("bad-old", "written for version 0"),
        ("bad-twice", "expected a click.Command, got type"),
        ("good", "`aiorts good` is offered twice, by bad_twice:Good (package bad-twice 1.0) and good_part:Good"),
    ],
)
def test_a_broken_command_is_one_line(site: Path, name: str, expected: str) -> None:
    done = aiorts(site, name)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("aiorts: E-PLUGIN: ")
    assert done.stderr.count("\n") == 1
    assert expected in done.stderr or "..." in done.stderr


@pytest.mark.slow(
    kept_by="extensions/test_loading.py::test_an_import_that_never_ends_is_left_behind_and_the_loop_goes_on"
)
def test_the_check_ends_what_an_import_has_started(tmp_path: Path) -> None:
    """A child of the import holds its streams open; neither it nor its parent outlive the check."""
    pid = tmp_path / "pid"
    text = (
        "import os, pathlib, time\n"
        "if os.fork() == 0:\n"
        f"    pathlib.Path({str(pid)!r}).write_text(str(os.getpid()))\n"
        "    time.sleep(600)\n"
        "    os._exit(0)\n"
        f"while not (p := pathlib.Path({str(pid)!r})).exists() or not p.read_text(): time.sleep(0.01)\n" + COMPONENT
    )
    install(tmp_path / "site", "forks", {"forks": text}, {"components/Forks": "forks:Good"})
    began = time.monotonic()
    done = aiorts(tmp_path / "site", "plugins", "--check", "--limit", "60", "--json")
    assert time.monotonic() - began < 45
    verdicts = {one["name"]: one["verdict"] for one in json.loads(done.stdout)["extensions"]}
    assert verdicts["Forks"] == "ok"
    stat = Path(f"/proc/{pid.read_text()}/stat")
    deadline = time.monotonic() + 5
    while stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z" and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z"
