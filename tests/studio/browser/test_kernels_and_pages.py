"""Kernels that stop, end and come back while a page is open; pages that are many, and a browser that is killed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser_parts import Opened, Served, browser, kernel, opened, served
from control_parts import until

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow
PARTS = Path(__file__).parent / "parts"
SAYS_WITHIN = 6.0
"""Seconds: 3 s of silence, and as much again for a machine that other tests keep busy."""
STATE = "name => [...store.kernels.value.values()].find((one) => one.name === name)?.state"


@pytest.fixture(scope="module")
def site(chromium: Browser) -> Iterator[Served]:
    with kernel("steady", "examples/pid/system.toml"), served("--edit") as found:
        yield found


@pytest.fixture
def page(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(2)
        found.settle()
        yield found
        assert found.complaints == []


def is_live(page: Opened, name: str) -> bool:
    """Whether figures of the kernel go on coming."""
    page.wait_for(f"name => ({STATE})(name) === 'live'", name)
    before = page.page.evaluate("() => JSON.stringify(store.at.value)")
    page.page.wait_for_timeout(800)
    return before != page.page.evaluate("() => JSON.stringify(store.at.value)")


def test_a_stopped_kernel_is_grey_and_says_so_and_the_rest_stays_live(page: Opened) -> None:
    with kernel("halting", PARTS / "lossy.toml") as process:
        page.wait_for_boxes(7)
        process.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        page.wait_for(f"name => ({STATE})(name) === 'silent'", "halting")
        assert time.monotonic() - began < SAYS_WITHIN
        tree = page.page.locator("[role=treeitem]", has_text="halting").first
        assert "no answer for" in tree.inner_text()
        page.page.locator(".box.silent").first.wait_for()
        assert is_live(page, "steady")
        page.choose("wave")  # what cannot be asked does not block the panel
        page.page.locator("aside").get_by_text("halting: no answer").wait_for()
        page.choose("pid0")
        page.page.locator("aside").get_by_text("0.0 to 10").or_(
            page.page.locator("aside").get_by_text("0 to 10")
        ).first.wait_for()
        process.send_signal(signal.SIGCONT)
        page.wait_for(f"name => ({STATE})(name) === 'live'", "halting")
        until(lambda: page.page.locator(".box.silent").count() == 0)


def test_a_killed_kernel_is_said_and_picked_up_again_without_a_reload(page: Opened) -> None:
    mark = page.page.evaluate("window.mark = Math.random()")
    with kernel("coming", PARTS / "lossy.toml") as process:
        page.wait_for_boxes(7)
        numbers = {box["name"]: box["id"] for box in page.things("boxes")}
        process.kill()
        began = time.monotonic()
        page.wait_for(f"name => ({STATE})(name) !== 'live'", "coming")
        assert time.monotonic() - began < SAYS_WITHIN
        process.wait()
    with kernel("coming", PARTS / "lossy.toml"):
        page.wait_for(f"name => ({STATE})(name) === 'live'", "coming")
        assert is_live(page, "steady")
        assert page.page.evaluate("window.mark") == mark
        assert {box["name"]: box["id"] for box in page.things("boxes")} == numbers


def test_a_port_added_while_the_page_is_open_appears_and_nothing_else_moves(page: Opened, site: Served) -> None:
    places = {box["name"]: (box["x"], box["y"]) for box in page.things("boxes")}
    began = time.monotonic()
    site.call("steady", "create", type="FlexiDump", name="dump0", params={"inputs": ["TimedDouble"]})
    page.page.locator(".box", has_text="dump0").locator("[data-port=input0]").wait_for()
    assert time.monotonic() - began < 2.0
    assert {box["name"]: (box["x"], box["y"]) for box in page.things("boxes") if box["name"] in places} == places
    site.call("steady", "remove", component="dump0")
    until(lambda: page.names() == places.keys())


def test_two_pages_see_the_same_and_one_that_is_closed_leaves_the_other(
    chromium: Browser, site: Served, page: Opened
) -> None:
    with opened(chromium, site, theme="dark") as other:
        other.wait_for_boxes(2)
        assert other.things("boxes") == page.things("boxes")
        other.choose("pid0")
        assert page.page.locator("aside h2").inner_text() != "pid0"
    assert is_live(page, "steady")


def test_a_browser_that_is_killed_leaves_nothing_in_the_server(site: Served) -> None:
    descriptors = Path(f"/proc/{site.process.pid}/fd")

    def visited() -> None:
        with browser() as started, opened(started, site) as found:
            found.wait_for_boxes(2)
            found.show("Log")
            found.settle()
            main = next(
                int(one.name)
                for one in Path("/proc").iterdir()
                if one.name.isdecimal() and is_browser(one, str(os.getpid()))
            )
            os.kill(main, signal.SIGKILL)

    def gone() -> int:
        return len(list(descriptors.iterdir()))

    page_free = gone()
    for _ in range(3):
        with pytest.raises(Exception, match=r"closed|crash|disconnected"):
            visited()
    until(lambda: gone() <= page_free)


def is_browser(process: Path, parent: str) -> bool:
    """Whether it is the main process of Chromium, a grandchild of this one."""
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
        above = (process / "stat").read_text().rpartition(")")[2].split()[1]
        return (
            b"--type=" not in b" ".join(words)
            and b"chrom" in words[0]
            and Path(f"/proc/{above}/stat").read_text().rpartition(")")[2].split()[1] == parent
        )
    except OSError:
        return False
