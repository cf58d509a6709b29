"""`Location` of a profile: where boxes stand, in the layout file beside the system file, and back."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.layout import Place, places_of
from openrtm_parts import canonical, component, configuration, context, profile

Out = pytest.CaptureFixture[str]


def at(x: str, y: str) -> str:
    words = f'rtsExt:x="{x}" rtsExt:y="{y}" rtsExt:height="60" rtsExt:width="90" rtsExt:direction="down"'
    return f"        <rtsExt:Location {words}/>\n"


def of(*places: tuple[str, str]) -> str:
    parts = (
        component(f"C{number}", configuration("default") + context() + at(*place))
        for number, place in enumerate(places)
    )
    return profile("".join(parts))


def imported(folder: Path, text: str, *words: str) -> None:
    (folder / "old.xml").write_text(text, encoding="utf-8")
    assert run_command(["import", str(folder / "old.xml"), "-o", str(folder / "s.toml"), *words]) == 0


def exported(folder: Path, *words: str) -> str:
    assert run_command(["export", str(folder / "s.toml"), "-o", str(folder / "new.xml"), "--force", *words]) == 0
    return (folder / "new.xml").read_text(encoding="utf-8")


def test_places_are_read_and_come_back_as_they_were(tmp_path: Path) -> None:
    text = of(("120", "40"), ("300", "-7"))
    imported(tmp_path, text)
    places = places_of((tmp_path / "s.layout.json").read_bytes())
    assert places.boxes == {"C0": Place(120.0, 48.0, -8.0), "C1": Place(300.0, 48.0, -55.0)}
    assert canonical(exported(tmp_path)) == canonical(text)


def test_a_box_that_was_moved_is_elsewhere_in_the_profile_and_nothing_else_changes(tmp_path: Path) -> None:
    text = of(("120", "40"), ("300", "80"))
    imported(tmp_path, text)
    layout = tmp_path / "s.layout.json"
    document = json.loads(layout.read_text())
    document["boxes"]["C1"] = [333.3, 20.2, 100.0]
    layout.write_text(json.dumps(document))
    new = exported(tmp_path)
    assert at("333", "120") in new
    assert canonical(new.replace(at("333", "120"), at("300", "80"))) == canonical(text)


@pytest.mark.parametrize("place", [("0", "0"), ("x", "y"), ("", ""), ("nan", "1"), ("1e9", "1")])
def test_a_profile_that_places_nothing_makes_no_layout_file(tmp_path: Path, place: tuple[str, str]) -> None:
    text = of(place)
    imported(tmp_path, text)
    assert not (tmp_path / "s.layout.json").exists()
    assert canonical(exported(tmp_path)) == canonical(text)


def test_a_layout_file_that_is_there_stays_unless_it_is_to_be_overwritten(tmp_path: Path, capsys: Out) -> None:
    layout = tmp_path / "s.layout.json"
    layout.write_text("mine")
    imported(tmp_path, of(("120", "40")))
    assert layout.read_text() == "mine"
    assert f"{layout} is there already and stays; --force overwrites it" in capsys.readouterr().err
    exported(tmp_path)
    assert f"note: {layout}: expected places as JSON; not used" in capsys.readouterr().err
    imported(tmp_path, of(("120", "40")), "--force")
    assert places_of(layout.read_bytes()).boxes.keys() == {"C0"}


def test_a_new_profile_has_the_places_of_the_layout_file(tmp_path: Path) -> None:
    text = 'schema = 1\n[components.a]\ntype = "FlexiConst"\nparams.output0 = "TimedLong:1"\n'
    (tmp_path / "s.toml").write_text(text)
    (tmp_path / "s.layout.json").write_text('{"schema": 1, "boxes": {"a": [10, 20, 30]}}')
    assert 'rtsExt:x="10" rtsExt:y="50"' in exported(tmp_path)
