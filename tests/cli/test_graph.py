"""`aiorts graph`: where the drawing goes, and in which form."""

from __future__ import annotations

import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest

from aiorts.cli.app import run_command
from aiorts.layout import Place, Places, text_of_places

ROOT = Path(__file__).parents[2]
ROOMBA = str(ROOT / "examples" / "roomba" / "system.toml")
Out = pytest.CaptureFixture[str]


@pytest.mark.row(113)
@pytest.mark.parametrize(
    ("form", "begin"), [("mermaid", "flowchart LR\n"), ("dot", "digraph system {\n"), ("svg", "<?xml")]
)
def test_a_form_is_chosen_and_printed(capsys: Out, form: str, begin: str) -> None:
    assert run_command(["graph", ROOMBA, "--format", form]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith(begin)
    assert printed.err == ""


def test_the_end_of_the_file_name_says_the_form(tmp_path: Path, capsys: Out) -> None:
    for name, begin in (("x.svg", "<?xml"), ("x.dot", "digraph"), ("x.gv", "digraph"), ("x.mmd", "flowchart")):
        assert run_command(["graph", ROOMBA, "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_text(encoding="utf-8").startswith(begin)
    ElementTree.parse(tmp_path / "x.svg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.dot", "x.gv", "x.mmd", "x.svg"]
    assert capsys.readouterr().out == ""


@pytest.mark.slow
@pytest.mark.fault("F15")
def test_a_file_that_cannot_be_written_is_one_line_and_what_was_there_stays(tmp_path: Path, capsys: Out) -> None:
    for target in (tmp_path / "no" / "x.svg", tmp_path):
        assert run_command(["graph", ROOMBA, "-o", str(target)]) == 2
        printed = capsys.readouterr()
        assert printed.err.startswith(f"aiorts: E-CONFIG: -o {target}: cannot be written: ")
        assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_system_with_mistakes_of_its_parts_is_drawn_all_the_same_and_they_are_told(
    tmp_path: Path, capsys: Out
) -> None:
    text = '[contexts.loop]\nkind = "event"\nmembers = ["a"]\n'
    (tmp_path / "s.toml").write_text(f'schema = 1\n[components.a]\ntype = "FlexiDmp"\n{text}')
    assert run_command(["graph", str(tmp_path / "s.toml")]) == run_command(["check", str(tmp_path / "s.toml")]) == 2
    printed = capsys.readouterr()
    assert "<b>a</b>" in printed.out
    assert printed.err.startswith(f"aiorts: E-PLUGIN: {tmp_path / 's.toml'}:3:8: components.a.type: ")
    assert "did you mean FlexiDump" in printed.err
    assert "^^^" in printed.err
    assert run_command(["graph", str(tmp_path / "s.toml"), "-o", str(tmp_path / "s.svg")]) == 2
    assert (tmp_path / "s.svg").exists()
    (tmp_path / "s.toml").write_text("schema = 1\n[component.a]\n")
    assert run_command(["graph", str(tmp_path / "s.toml")]) == 2


def test_the_layout_file_beside_a_system_places_its_boxes(tmp_path: Path, capsys: Out) -> None:
    folder = shutil.copytree(Path(ROOMBA).parent, tmp_path / "roomba")
    system, beside = str(folder / "system.toml"), folder / "system.layout.json"
    assert run_command(["graph", system, "--format", "svg"]) == 0
    usual = capsys.readouterr().out
    beside.write_text(text_of_places("here", Places({"turn_rate": Place(900.0, 60.0, 0.0)})), encoding="utf-8")
    assert run_command(["graph", system, "--format", "svg"]) == 0
    placed = capsys.readouterr()
    assert placed.out != usual
    assert placed.err == ""
    beside.write_text("{}", encoding="utf-8")
    assert run_command(["graph", system, "--format", "svg"]) == 0
    broken = capsys.readouterr()
    assert broken.out == usual
    assert "system.layout.json: expected schema = 1; not used" in broken.err
    assert beside.read_text(encoding="utf-8") == "{}"
