"""A type that a plugin declares is known to every command of recordings; nothing else that a file names is imported."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from aiorts import Catalogue
from aiorts.cli.app import run_command
from aiorts.kernel.extensions import finders
from aiorts.types.registry import _by_full_name, _by_short_name
from aiorts_log import RecordingError, RecordingOptions, RecordingReader, RecordingWriter
from aiorts_log.analysis.series import read_series
from plugin_dists import project

TEXT = """
from aiorts.types import record
@record
class {0}:
    tm: int = 0
    level: float = 0.0
    low: bool = False
"""
"""Of a module with a record."""


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path = list(sys.path)
    yield
    sys.path[:] = path
    finders.offer_from(None)
    for name in [name for name in sys.modules if name.startswith("declared_")]:
        del sys.modules[name]


def recorded(path: Path, module: str, name: str, count: int = 5) -> Path:
    """A recording of a type of that module, made by a process that knows it; forgotten here afterwards."""
    home: Any = ModuleType(module)
    sys.modules[module] = home
    exec(TEXT.format(name), vars(home))
    cls = getattr(home, name)
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("tank", cls)
        for number in range(count):
            assert writer.write(port, cls(number, number / 4, number > 2), 1000 + number)
    del sys.modules[module], _by_full_name[f"{module}.{name}"], _by_short_name[name]
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    capsys.readouterr()
    status = run_command(["log", *map(str, arguments)])
    said = capsys.readouterr()
    assert (status, said.err) == (0, "")
    return said.out


@pytest.mark.slow
@pytest.mark.row(64)
def test_every_command_knows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "run.mcap", "declared_a", "TankA")
    project(tmp_path / "plugin", "plug", {"declared_a": TEXT.format("TankA")}, {"types/TankA": "declared_a:TankA"})
    finders.offer_from(Catalogue([tmp_path / "plugin"]))
    assert "no type" not in run(capsys, "info", "--check", path)
    lines = [json.loads(line) for line in run(capsys, "cat", path).splitlines()]
    assert lines[3] == {"port": "tank", "type": "TankA", "tm": 3, "data": {"level": 0.75, "low": True}}
    for ending in ("csv", "txt", "jsonl"):
        other, back = tmp_path / f"run.{ending}", tmp_path / f"{ending}.mcap"
        run(capsys, "convert", path, other)
        table = ["--port", "tank", "--type", "declared_a.TankA"] if ending == "csv" else []
        run(capsys, "convert", other, back, *table)
        assert run(capsys, "diff", path, back).startswith("equal: 5 samples of 1 port")
        if not table:
            assert run(capsys, "diff", path, other).startswith("equal: 5 samples of 1 port")
    run(capsys, "cut", path, tmp_path / "cut.mcap", "--start", "+0", "--end", "+0.000000003")
    run(capsys, "merge", path, tmp_path / "cut.mcap", tmp_path / "both.mcap", "--join")
    run(capsys, "salvage", tmp_path / "both.mcap", tmp_path / "whole.mcap")
    with RecordingReader(tmp_path / "whole.mcap") as reader:
        (curve,) = read_series(reader, ["tank.level"], None, None, lambda _: None)
        assert list(curve[0].values) == [0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 1.0]
        assert [one.level for _, _, one in reader.records()] == [0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("way", ["FILE.py", "MODULE"])
@pytest.mark.parametrize("command", ["info", "cat", "convert", "cut", "merge", "diff", "salvage"])
def test_every_command_imports_a_module_of_types_that_it_is_told(
    command: str, way: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"declared_{command}_{way[:4]}".lower().rstrip(".")
    module = name if way == "MODULE" else f"aiorts_system.{tmp_path.name}.{name}"
    path = recorded(tmp_path / "run.mcap", module, "TankB")
    (tmp_path / f"{name}.py").write_text(TEXT.format("TankB"))
    monkeypatch.chdir(tmp_path)
    rest = {
        "info": [path],
        "cat": [path],
        "convert": [path, "new.csv"],
        "cut": [path, "new.mcap"],
        "merge": [path, path, "new.mcap", "--join"],
        "diff": [path, path],
        "salvage": [path, "new.mcap"],
    }[command]
    out = run(capsys, command, "--type-mod", f"{name}.py" if way == "FILE.py" else name, *rest)
    assert "no type" not in out
    with RecordingReader(path) as reader:
        assert reader.ports["tank"].type.__module__ == module
    del _by_full_name[f"{module}.TankB"], _by_short_name["TankB"]
    sys.modules.pop(module, None)


@pytest.mark.slow
@pytest.mark.fault("D12")
def test_what_no_plugin_declares_is_not_imported_whatever_else_it_offers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = {"types/TankD": "declared_c:TankD", "types/all": "declared_d", "components/Tank": "declared_e:Tank"}
    text = f"open({str(tmp_path / 'imported')!r}, 'w')\n{TEXT.format('TankC')}"
    project(tmp_path / "plugin", "plug", dict.fromkeys(("declared_c", "declared_d", "declared_e"), text), entries)
    finders.offer_from(Catalogue([tmp_path / "plugin"]))
    for module in ("declared_c", "declared_d", "declared_e"):
        path = recorded(tmp_path / f"{module}.mcap", module, "TankC")
        assert f"no type '{module}.TankC' is known here" in run(capsys, "info", path)
        assert '"level": 0.25' in run(capsys, "cat", path)  # as plain data
        with RecordingReader(path) as reader, pytest.raises(RecordingError, match="no type"):
            _ = reader.ports["tank"].decode
    assert not (tmp_path / "imported").exists()


def test_a_declared_type_that_is_broken_says_why_and_its_samples_are_plain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path / "run.mcap", "declared_f", "TankF")
    project(tmp_path / "plugin", "plug", {"declared_f": "import no_such"}, {"types/TankF": "declared_f:TankF"})
    finders.offer_from(Catalogue([tmp_path / "plugin"]))
    out = run(capsys, "info", path)
    assert "type 'declared_f.TankF': type 'TankF' of folder" in out
    assert "No module named 'no_such'" in out
    assert '"level": 0.25' in run(capsys, "cat", path)


def test_a_type_that_changed_since_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "run.mcap", "declared_g", "TankG")
    text = TEXT.format("TankG") + "    more: int = 0\n"
    project(tmp_path / "plugin", "plug", {"declared_g": text}, {"types/TankG": "declared_g:TankG"})
    finders.offer_from(Catalogue([tmp_path / "plugin"]))
    assert "was another type when it was recorded: its fields differ" in run(capsys, "info", path)


def test_a_type_of_a_file_is_told_with_folder_and_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "run.mcap", "aiorts_system.robot.tank", "TankH")
    assert "--type-mod robot/tank.py, with the way to that folder in front" in run(capsys, "info", path)


def test_one_class_by_path_and_as_a_module_is_told_with_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_path = recorded(tmp_path / "path.mcap", "aiorts_system.robot.declared_one", "Tank")
    as_module = recorded(tmp_path / "module.mcap", "declared_one", "Tank")
    other = recorded(tmp_path / "other.mcap", "declared_other", "Tank")
    told = "; both may be one class, of robot/declared_one.py: record it by path in both, or as a module in both"
    for left, right in ((by_path, as_module), (as_module, by_path)):
        assert run_command(["log", "diff", str(left), str(right)]) == 1
        assert capsys.readouterr().out.splitlines()[1].endswith(told)
    assert run_command(["log", "diff", str(by_path), str(other)]) == 1
    assert "one class" not in capsys.readouterr().out
    with RecordingReader(as_module) as reader:
        assert "(--type-mod declared_one, not declared_one.py)" in reader.ports["tank"].unknown
    with RecordingReader(by_path) as reader:
        assert "--type-mod robot/declared_one.py" in reader.ports["tank"].unknown
