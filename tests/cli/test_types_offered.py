"""`aiorts types` lists what plugins declare; `plugins --check` refuses what recordings would not find."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from aiorts import Catalogue, Extension
from aiorts.cli.app import run_command
from aiorts.cli.commands.plugin_kinds import fault_of
from aiorts.cli.console.completion import type_names
from aiorts.kernel.extensions import finders
from plugin_dists import project

TEXT = "from aiorts.types import record\n@record\nclass {0}:\n    tm: int = 0\n    level: float | None = None\n"


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path = list(sys.path)
    yield
    sys.path[:] = path
    finders.offer_from(None)
    for name in [name for name in sys.modules if name.startswith("offered_")]:
        del sys.modules[name]


def types(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(["types", *arguments])
    said = capsys.readouterr()
    return status, said.out, said.err


@pytest.mark.row(64)
def test_a_declared_type_is_listed_by_name_and_by_module_and_one_that_does_not_fit_is_not_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for letter in "ab":
        entries = {f"types/Basin{letter}": f"offered_{letter}:Basin{letter}"}
        project(tmp_path / letter, f"plug-{letter}", {f"offered_{letter}": TEXT.format(f"Basin{letter}")}, entries)
    finders.offer_from(Catalogue([tmp_path]))
    assert [item.value for item in type_names(None, None, "Basin")] == ["Basina", "Basinb"]  # type: ignore[arg-type]
    assert types(capsys, "basinA") == (0, "Basina  user  tm: stamp, level: optional[f64]\n", "")
    assert "offered_b" not in sys.modules
    assert types(capsys, "offered_b.*")[1] == "Basinb  user  tm: stamp, level: optional[f64]\n"


def test_a_record_that_is_only_a_field_of_a_declared_one_is_found_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TEXT.format("Spring").replace("    level", "    depth: float = 0.0\n    level") + TEXT.format(
        "Stream"
    ).replace("float | None = None", "Spring = Spring()").removeprefix("from aiorts.types import record\n")
    project(tmp_path / "n", "plug-n", {"offered_n": text}, {"types/Stream": "offered_n:Stream"})
    finders.offer_from(Catalogue([tmp_path]))
    assert types(capsys, "Sprin") == (0, "Spring  user  tm: stamp, depth: f64, level: optional[f64]\n", "")
    assert run_command(["inspect", "Spring"]) == 0
    assert "depth" in capsys.readouterr().out
    assert run_command(["inspect", "spring"]) == 6
    assert "did you mean Spring" in capsys.readouterr().err


def test_a_nested_record_is_inspected_without_types_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = TEXT.format("Brook") + TEXT.format("River").replace("float | None = None", "Brook = Brook()")
    project(tmp_path / "m", "plug-m", {"offered_m": text}, {"types/River": "offered_m:River"})
    finders.offer_from(Catalogue([tmp_path]))
    assert run_command(["inspect", "Brook"]) == 0
    assert "offered_m.Brook" in capsys.readouterr().out


def test_a_broken_one_is_a_line_and_hides_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project(tmp_path / "c", "plug-c", {"offered_c": TEXT.format("Basinc")}, {"types/Basinc": "offered_c:Basinc"})
    project(tmp_path / "d", "plug-d", {"offered_d": "import no_such"}, {"types/Basind": "offered_d:Basind"})
    finders.offer_from(Catalogue([tmp_path]))
    status, out, err = types(capsys, "basin[cd]")
    assert (status, out) == (0, "Basinc  user  tm: stamp, level: optional[f64]\n")
    assert "offered_d.Basind" in err
    assert "No module named 'no_such'" in err
    assert err.count("\n") == 1
    status, out, err = types(capsys, "Basind")
    assert (status, out) == (6, "")
    assert "No module named 'no_such'" in err


@pytest.mark.parametrize(
    ("entry", "target", "fault"),
    [
        ("Basine", "offered_e:Basine", ""),
        ("Basine", "offered_e", "names a module; name each of its classes, as MODULE:CLASS"),
        ("Basine", "offered_f:Basine", "recordings name the type by its own module; write offered_e:Basine"),
        ("Other", "offered_e:Basine", "the type is called Basine"),
        ("Number", "offered_e:Number", "cannot be the type of a port"),
        ("Mode", "offered_g:Mode", "Mode is an enum, and no record type: name the record that has a field of it"),
    ],
)
def test_the_check_refuses_what_recordings_would_not_find(entry: str, target: str, fault: str, tmp_path: Path) -> None:
    files = {
        "offered_e": TEXT.format("Basine") + "Number = 5\n",
        "offered_f": "from offered_e import Basine\n",
        "offered_g": "from enum import Enum\nclass Mode(Enum):\n    AUTO = 1\n",
    }
    project(tmp_path, "plug-e", files, {f"types/{entry}": target})
    extension: Extension = Catalogue([tmp_path]).find("types", entry)
    found = fault_of(extension, extension.load())
    assert fault in found
    assert bool(found) == bool(fault)
