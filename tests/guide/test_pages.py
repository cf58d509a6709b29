"""The guide as a reader uses it: every page is found, every link leads somewhere, every block does what it shows."""

from __future__ import annotations

import os
import re
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from aiorts.cli.app import aiorts as root
from aiorts.guide import Page, blocks, pages
from aiorts.guide.contents import FOLDER
from aiorts.sessions import entries
from guide_blocks import anchors, links, run_page

ELSEWHERE = {
    "releases": 2,
    "component": 1,
    "deploy": 1,
    "fastapi": 2,
    "openrtm-files": 1,
    "plugin": 1,
    "recording": 1,
    "ros-bag": 1,
}
"""Pages with blocks that are not run here, and how many: they need another machine, an administrator or a network."""
NEEDS = {"fastapi": "fastapi", "recording": "matplotlib"}
"""Pages whose blocks import what the extra `dev` alone has."""
NAMES = [pytest.param(page, id=page.name) for page in pages()]


def test_the_contents_are_the_files_that_are_there() -> None:
    listed = [page.path for page in pages()]
    assert sorted(listed) == sorted(FOLDER.rglob("*.md"))
    assert len({page.name for page in pages()}) == len(listed)


def test_no_page_has_the_name_of_a_command() -> None:
    context = click.Context(root)
    assert not {page.name for page in pages()} & {name.lower() for name in root.list_commands(context)}


@pytest.mark.parametrize("page", NAMES)
def test_a_page_begins_with_its_title_and_its_links_lead_somewhere(page: Page) -> None:
    text = page.text
    assert re.match(r"# \S.*\n\n\S", text), "a page begins with its title, and a sentence below"
    wrong = []
    for link in links(text):
        target, _, fragment = link.partition("#")
        path = (page.path.parent / target).resolve() if target else page.path
        if not path.is_file() or not path.is_relative_to(FOLDER):
            wrong.append(f"{link}: no page or picture of the guide")
        elif fragment and fragment not in anchors(path.read_text(encoding="utf-8")):
            wrong.append(f"{link}: the page has no such heading")
    assert wrong == []


def test_the_page_of_the_web_application_installs_all_that_it_uses() -> None:
    text = next(page.text for page in pages() if page.name == "fastapi")
    (installed,) = re.findall(r"^pip install (.*)$", text, re.MULTILINE)
    used = set(re.findall(r"^(?:from |import |\$ |(?:\$ )?python -m )(\w+)", text, re.MULTILINE)) - {"python", "app"}
    assert used - sys.stdlib_module_names - {"aiorts"} == set(installed.split())


@pytest.fixture
def sockets(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A folder of its own for the sockets of what a page runs; what is left running is ended."""
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield
        for entry in entries():
            os.kill(entry.pid, signal.SIGKILL)
        for path in Path(folder).glob("aiorts/studio/*.sock"):
            os.kill(int(path.stem), signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("page", NAMES)
def test_every_block_runs_as_pasted_and_prints_what_is_shown(page: Page, tmp_path: Path, sockets: None) -> None:
    if page.name in NEEDS:
        pytest.importorskip(NEEDS[page.name])
    run_page(page.text, tmp_path)
    assert len([block for block in blocks(page.text) if "elsewhere" in block.marks]) == ELSEWHERE.get(page.name, 0)
