"""Texts that would be markup are shown as they are, in every view; no text of others becomes an element."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from browser_parts import Opened, Served, kernel, opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow
PARTS = Path(__file__).parent / "parts"
MARKUP = "<img src=x onerror=window.hit=1>"


@pytest.fixture(scope="module")
def site() -> Iterator[Served]:
    with kernel("lossy", PARTS / "lossy.toml"), served("--edit") as found:
        yield found


@pytest.fixture(scope="module")
def page(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(3)
        found.settle()
        yield found


def look(page: Opened, selector: str, *, times: int = 1) -> None:
    """The text is there as a text, at least so often, and nothing came of it."""
    page.page.locator(selector).get_by_text(MARKUP).nth(times - 1).wait_for()
    assert page.page.evaluate("window.hit") is None
    assert page.page.locator("img[src=x]").count() == 0
    assert page.complaints == []


def test_in_what_is_selected(page: Opened) -> None:
    page.choose("wave")
    look(page, "aside", times=7)  # doc, units of a port and a parameter, their docs, a value, a choice, a line


def test_in_the_last_error_of_a_component(page: Opened) -> None:
    page.choose("fails")
    look(page, "aside .failure")
    page.page.keyboard.press("Escape")
    look(page, "aside .troubles")


def test_in_the_log_and_the_events(page: Opened, site: Served) -> None:
    page.show("Log")
    look(page, ".log")
    page.show("Events")
    site.call("lossy", "configure", component="wave", values={"": {"gain": 2.5}})
    page.wait_for("() => document.querySelector('.log .line')")
    look(page, "aside")


def test_in_plots_and_their_values(page: Opened) -> None:
    page.choose("wave")
    for port in ("pose", "words"):
        page.page.get_by_role("button", name=f"Plot wave.{port}").click()
    look(page, ".values", times=2)  # the unit of a field, and a value that is a text


def test_in_tips_and_what_is_said_aloud(page: Opened) -> None:
    page.choose("wave")
    page.page.locator(".port-of[data-port=pose]").hover()
    look(page, ".tip")
    page.page.locator(f"aside .value:has([data-full='{MARKUP}'])").click()  # copies the command that sets it
    look(page, ".toast")
    assert MARKUP in str(page.page.locator(".port-of[data-port=pose]").get_attribute("aria-label"))


def test_in_the_search_and_in_the_address(page: Opened) -> None:
    page.page.locator("#search").fill(MARKUP)
    look(page, "nav")
    page.page.locator("#search").fill("")
    page.page.goto(f"{page.page.url.partition('#')[0]}#/box/lossy/{MARKUP}")
    page.page.reload()
    page.wait_for_boxes(3)
    page.page.get_by_text("Needs a look").wait_for()  # it leads nowhere, and says nothing
    assert page.page.evaluate("window.hit") is None
