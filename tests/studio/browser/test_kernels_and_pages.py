"""Kernels that stop, end and come back while a page is open; pages that are many, and a browser that is killed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser_parts import CHROMIUM, FLAGS, Opened, Served, kernel, opened, served
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


def numbers_of(page: Opened, name: str) -> dict[str, int]:
    """The components of a kernel, and their ids."""
    address = next(one["address"] for one in page.things("kernels") if one["name"] == name)
    return {box["name"]: box["id"] for box in page.things("boxes") if box["kernel"] == address}


def places_of(page: Opened, *names: str) -> dict[str, tuple[float, float]]:
    return {box["name"]: (box["x"], box["y"]) for box in page.things("boxes") if box["name"] in names}


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
        page.wait_for(f"name => ({STATE})(name) === 'live'", "coming")
        until(lambda: len(numbers_of(page, "coming")) == 5)
        numbers = numbers_of(page, "coming")
        process.kill()
        began = time.monotonic()
        page.wait_for(f"name => ({STATE})(name) !== 'live'", "coming")
        assert time.monotonic() - began < SAYS_WITHIN
        process.wait()
    with kernel("coming", PARTS / "lossy.toml"):
        page.wait_for(f"name => ({STATE})(name) === 'live'", "coming")
        assert is_live(page, "steady")
        assert page.page.evaluate("window.mark") == mark
        until(lambda: numbers_of(page, "coming") == numbers)


def test_a_port_added_while_the_page_is_open_appears_and_the_others_stay(page: Opened, site: Served) -> None:
    before, places = page.names(), places_of(page, "pid0", "plant0")
    began = time.monotonic()
    site.call("steady", "create", type="FlexiDump", name="dump0", params={"inputs": ["TimedDouble"]})
    page.wait_for("() => [...store.boxes.value.values()].some((box) => box.name === 'dump0' && box.ports.length === 1)")
    assert time.monotonic() - began < 2.0
    assert places_of(page, "pid0", "plant0") == places
    site.call("steady", "remove", components=["dump0"])
    until(lambda: page.names() == before)


def test_two_pages_see_the_same_and_one_that_is_closed_leaves_the_other(
    chromium: Browser, site: Served, page: Opened
) -> None:
    with opened(chromium, site, theme="dark") as other:
        other.wait_for_boxes(2)
        assert other.things("boxes") == page.things("boxes")
        other.choose("pid0")
        assert page.page.locator("aside h2").inner_text() != "pid0"
    assert is_live(page, "steady")


def killed_while_it_looks(started: Browser, site: Served, number: int) -> None:
    with opened(started, site) as found:
        found.wait_for_boxes(2)
        found.settle()
        os.kill(number, signal.SIGKILL)
        found.page.evaluate("1")


def test_a_browser_that_is_killed_leaves_nothing_in_the_server(chromium: Browser, site: Served) -> None:
    from playwright.sync_api import Error  # late: only the extra dev has it

    descriptors = Path(f"/proc/{site.process.pid}/fd")

    def opens() -> int:
        return len(list(descriptors.iterdir()))

    before = opens()
    for _ in range(3):
        started = chromium.browser_type.launch(executable_path=CHROMIUM, args=FLAGS)
        processes = started.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        number = next(one["id"] for one in processes if one["type"] == "browser")
        with pytest.raises(Error, match="closed"):
            killed_while_it_looks(started, site, number)
        until(lambda: opens() <= before)
