"""Where boxes stood is there again after a restart of the server, and files of others are safe."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from aiorts.layout import Place, Places
from aiorts_studio.watching.places import PlaceFiles, state_folder
from control_parts import controlled
from studio_page import Seen, paging
from studio_parts import site

pytestmark = pytest.mark.row(120)
HERE = Places({"a": Place(28.0, 48.0, 0.0), "b": Place(300.5, 48.0, 164.0)}, {"b"})


def files_in(tmp_path: Path, said: list[str]) -> PlaceFiles:
    return PlaceFiles(tmp_path / "state", tmp_path / "system.layout.json", said.append)


def place(page: Seen, name: str) -> tuple[float, float]:
    return page.box(name)["x"], page.box(name)["y"]


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_box_that_was_moved_stands_there_after_a_restart_of_the_server(tmp_path: Path) -> None:
    said: list[str] = []
    async with controlled("robot"):
        async with site(places=files_in(tmp_path, said)) as client, paging(client) as page:
            await page.whole("counter0", "reader0")
            first = place(page, "counter0")
            await page.say("move", id=page.box("counter0")["id"], x=1_000, y=first[1])
            await page.until(lambda: place(page, "counter0") != first)
            before = {name: place(page, name) for name in ("counter0", "reader0")}
        document = json.loads((tmp_path / "system.layout.json").read_text())
        assert document["by_hand"] == ["counter0"]
        assert document["boxes"].keys() == before.keys()
        async with site(places=files_in(tmp_path, said)) as client, paging(client) as page:
            await page.whole("counter0", "reader0")
            assert {name: place(page, name) for name in before} == before
            await page.say("tidy")
            await page.until(lambda: place(page, "counter0") == first)
        assert json.loads((tmp_path / "system.layout.json").read_text())["by_hand"] == []
    assert said == []


@pytest.mark.slow
@pytest.mark.anyio
async def test_automatic_places_are_kept_in_the_state_folder_alone(tmp_path: Path) -> None:
    async with controlled("robot"), site(places=files_in(tmp_path, [])) as client, paging(client) as page:
        await page.whole("counter0", "reader0")
        await page.until(lambda: list((tmp_path / "state").glob("*.layout.json")))
    assert not (tmp_path / "system.layout.json").exists()
    (kept,) = (tmp_path / "state").iterdir()
    assert json.loads(kept.read_text())["boxes"].keys() == {"counter0", "reader0"}
    assert stat.S_IMODE((tmp_path / "state").stat().st_mode) == 0o700


def test_each_kernel_has_its_own_and_the_file_beside_goes_before(tmp_path: Path) -> None:
    said: list[str] = []
    files = files_in(tmp_path, said)
    files.write("host/one:/a/system.toml", HERE, is_of_user=False)
    assert files.read("host/one:/a/system.toml") == HERE
    assert files.read("host/one:/b/system.toml") == Places()
    other = Places({"a": Place(5.0, 6.0, 0.0)}, {"a"})
    files.write("host/one:/b/system.toml", other, is_of_user=True)
    assert files.read("host/one:/a/system.toml") == Places(
        {"a": Place(5.0, 6.0, 0.0), "b": Place(300.5, 48.0, 164.0)}, {"a", "b"}
    )
    assert said == []


BROKEN = (
    "", "{", "[]", '{"schema": 2, "boxes": {}}', '{"schema": 1}', '{"schema": 1, "boxes": {"a": [1]}}',
    '{"schema": 1, "boxes": {"a": [1, 1, NaN]}}', '{"schema": 1, "boxes": {"a": [1, 1, 1e9]}}', "[" * 100_000,
    '{"schema": 1, "boxes": {"a": [true, 1, 1]}}', '{"schema": 1, "boxes": {}, "by_hand": 1}', " " * (1 << 20) + "{}",
)  # fmt: skip


@pytest.mark.parametrize("text", BROKEN, ids=range(len(BROKEN)))
def test_a_file_that_is_broken_is_kept_under_another_name_and_reported(tmp_path: Path, text: str) -> None:
    said: list[str] = []
    files, beside = files_in(tmp_path, said), tmp_path / "system.layout.json"
    beside.write_text(text)
    assert files.read("host/one") == Places()
    (line,) = said
    assert line.startswith(f"{beside}: ")
    assert "system.layout.json.broken" in line
    files.write("host/one", HERE, is_of_user=True)
    assert (tmp_path / "system.layout.json.broken").read_text() == text
    assert files.read("host/one") == HERE


def test_a_file_that_cannot_be_written_is_reported_once(tmp_path: Path) -> None:
    said: list[str] = []
    files = PlaceFiles(None, tmp_path / "nowhere" / "system.layout.json", said.append)
    for _ in range(2):
        files.write("host/one", HERE, is_of_user=True)
    (line,) = said
    assert "cannot be written" in line
    assert files.read("host/one") == Places()


def test_the_state_folder_is_that_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "aiorts" / "layouts"
    monkeypatch.setenv("XDG_STATE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "aiorts" / "layouts"


def test_of_very_many_kernels_the_oldest_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts_studio.watching.places._MOST", 3)
    files = PlaceFiles(tmp_path, None, lambda _: None)
    for number in range(5):
        files.write(f"host/k{number}", HERE, is_of_user=False)
        (newest,) = tmp_path.glob(f"k{number}-*")
        os.utime(newest, (number, number))
    files.write("host/k5", HERE, is_of_user=False)
    assert [files.read(f"host/k{number}") == HERE for number in range(6)] == [False] * 3 + [True] * 3
