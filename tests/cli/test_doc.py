"""`aiorts doc` writes a page about a component from what it declares; nothing of a docstring is taken for markup."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

from aiorts.cli.app import run_command

HOSTILE = '<script src="http://x/y.js">|</script> *a* [b](http://c) & `x|y`'
FILE = f"""
from typing import Protocol
from aiorts import EventPort, Param, Provided, StateMachineComponent
from aiorts.statechart import Chart, On, State
from aiorts.types import TimedBoolean, TimedDouble
raise_if_run = 1
class Braking(Protocol):
    async def stop(self, force: float) -> bool:
        '''Stops at once.'''
        ...
class Door(StateMachineComponent):
    '''A door: {HOSTILE}

    1. Its second paragraph.
    '''
    button = EventPort(TimedBoolean, doc={HOSTILE!r})
    brake = Provided[Braking]()
    gain = Param(1.5, ge=0.0, unit="m", doc={HOSTILE!r})
    chart = Chart(State("closed", On("button", to="open"), initial=True), State("open"))
    def on_initialize(self) -> None: raise SystemExit
    async def stop(self, force: float) -> bool: return True
"""


@pytest.fixture
def door(tmp_path: Path) -> Path:
    (tmp_path / "door.py").write_text(FILE)
    return tmp_path / "door.py"


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loaded: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loaded += [name for name, _ in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.row(118)
@pytest.mark.parametrize("form", ["{}", "{}:Door"])
def test_a_page_has_all_that_a_component_declares(form: str, door: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["doc", form.format(door)]) == 0
    page = capsys.readouterr().out
    for part in (
        "# Door\n",
        "button",
        "## Services",
        "async stop(force: float)",
        "Stops at once.",
        "| closed | button | open |",
    ):
        assert part in page
    assert "| gain | float | 1.5 | m | " in page
    assert "<script" not in page
    assert "[b](" not in page
    assert "*a*" not in page.replace("\\*", "")
    assert "\n1\\. Its second" in page
    assert str(door.parent) not in page


def test_html_is_one_file_that_loads_nothing(door: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = door.with_name("door.html")
    assert run_command(["doc", str(door), "-o", str(output)]) == 0
    parser = Tags()
    parser.feed(output.read_text())
    assert "script" not in parser.tags
    assert "link" not in parser.tags
    assert parser.loaded == []
    assert parser.text.count(HOSTILE) == 3
    assert "Goes to" in parser.text


@pytest.mark.parametrize("ending", ["md", "html"])
def test_a_page_of_a_system_has_its_drawing_and_its_types(
    ending: str, door: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = door.with_name("house.toml"), door.with_name(f"house.{ending}")
    file.write_text(
        'schema = 1\n[components.front]\ntype = "door.py:Door"\n[components.back]\ntype = "door.py:Door"\n'
        '[contexts.all]\nkind = "event"\nmembers = ["front", "back"]\n'
    )
    assert run_command(["doc", str(file), "-o", str(output)]) == 0
    page = output.read_text()
    assert page.count("Stops at once.") == 1  # a type is described once
    assert ("<svg" if ending == "html" else "```mermaid\nflowchart") in page
    assert str(door.parent) not in page
    parser = Tags()
    parser.feed(page)
    assert parser.loaded == []
    for part in ("front", "back", "door.py:Door", "house.toml"):
        assert part in page


@pytest.mark.slow(kept_by="test_a_page_of_a_system_has_its_drawing_and_its_types")
def test_a_type_of_a_plugin_that_lies_beside_the_system_is_described(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["new", "paged", "--in", "command:TimedDouble", "--folder", str(tmp_path)]) == 0
    assert run_command(["doc", str(tmp_path / "paged" / "system.toml")]) == 0
    assert "| command | in | TimedDouble |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("none.py", "cannot be read"),
        ("TimedDouble", "no component"),
        ("NoSuchThing", "NoSuchThing"),
        ("e.py", "no Python"),
    ],
)
def test_what_is_no_component_is_refused(
    name: str, cause: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "e.py").write_text("class (")
    monkeypatch.chdir(tmp_path)
    assert run_command(["doc", name]) == (6 if name == "NoSuchThing" else 2)
    assert cause in capsys.readouterr().err


def test_a_file_that_is_there_is_replaced_with_force_alone(door: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = door.with_name("door.md")
    output.write_text("mine")
    assert run_command(["doc", str(door), "-o", str(output)]) == 2
    assert f"-o {output}: is there already; --force overwrites it" in capsys.readouterr().err
    assert output.read_text() == "mine"
    assert run_command(["doc", str(door), "-o", str(output), "--force"]) == 0
    assert output.read_text().startswith("# ")
