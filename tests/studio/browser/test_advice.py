"""What the page advises, in the words of the terminal and with the names that it is about; how an end looks."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from aiorts.errors import SLOW_READER_BURSTS, SLOW_READER_CURES
from browser_parts import Opened, Served, kernel, opened, served
from control_parts import WAIT, until

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.slow, pytest.mark.row(120)]
PARTS = Path(__file__).parent / "parts"
INACTIVE = """([state, message]) => Promise.all([import('/store.js'), import('/advice.js')]).then(([store, advice]) => {
    const edge = [...store.edges.value.values()].find(({ name }) => name === 'wave.out-slow.in');
    const known = store.boxes.value, box = known.get(edge.to[0]), figures = store.boxFigures.value;
    store.boxes.value = new Map([...known, [box.id, { ...box, error: message && { message } }]]);
    store.boxFigures.value = new Map([...figures, [box.id, { state, said: '' }]]);
    const { helps, cures } = advice.adviceOf(edge, 'inactive');
    [store.boxes.value, store.boxFigures.value] = [known, figures];
    return [helps, ...cures.map(({ line }) => line)];
})"""
"""What is advised on samples for a reader that is in this state now."""


@pytest.fixture(scope="module")
def site(chromium: Browser) -> Iterator[Served]:
    with kernel("lossy", PARTS / "lossy.toml"), served("lossy") as found:
        yield found


@pytest.fixture
def page(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(5)
        found.settle()
        yield found
        assert found.complaints == []


def test_what_helps_a_slow_reader_is_ranked_names_it_and_is_copied(page: Opened) -> None:
    page.choose_edge("wave.out-slow.in")
    aside = page.page.locator("aside")
    aside.get_by_text("slow, in the context calm, takes fewer than come").wait_for()
    aside.get_by_text(SLOW_READER_BURSTS).wait_for()
    listed = aside.locator("ol.cures li").all_inner_texts()
    assert len(listed) == len(SLOW_READER_CURES)
    for text, (says, line) in zip(listed, SLOW_READER_CURES, strict=True):
        assert says in text
        assert line in text
    aside.get_by_role("button", name='full = "block"').click()
    assert page.page.evaluate("navigator.clipboard.readText()") == 'full = "block"'


def test_advice_goes_by_the_state_of_the_reader(page: Opened) -> None:
    page.wait_for("() => store.edges.value.size > 0")
    assert page.page.evaluate(INACTIVE, ["error", "boom"]) == [
        "slow is in error: boom. Reset it:",
        "aiorts reset slow",
    ]
    assert page.page.evaluate(INACTIVE, ["inactive", ""])[1:] == ["aiorts activate slow"]
    assert page.page.evaluate(INACTIVE, ["active", ""]) == ["slow is active now: these came while it was not."]


def test_a_component_in_error_has_the_command_that_resets_it(page: Opened) -> None:
    page.choose("fails")
    commands = page.page.get_by_role("region", name="As commands")
    commands.get_by_text("aiorts reset fails").wait_for()
    page.choose("slow")
    commands.get_by_text("aiorts cat slow").wait_for()
    assert commands.get_by_text("aiorts reset").count() == 0


def test_a_component_says_how_long_its_hook_takes(page: Opened) -> None:
    page.choose("slow")
    takes = page.page.get_by_role("region", name="How long it takes")
    takes.get_by_text("on_execute").wait_for()
    assert re.search(r"on_execute [\d.]+ ms", takes.inner_text())


def test_how_long_a_kernel_is_silent_is_one_count_everywhere(chromium: Browser) -> None:
    with kernel("halting", PARTS / "lossy.toml") as process, served("halting") as own, opened(chromium, own) as page:
        page.wait_for_boxes(5)
        page.settle()
        process.send_signal(signal.SIGSTOP)
        page.page.locator("nav").get_by_text("no answer for 5 s").wait_for()
        counts = "() => [...document.querySelectorAll('nav .beside, .troubles .bad, .frame-said')]"
        said = page.page.evaluate(f"{counts}.map(one => one.textContent.match(/no answer for \\d+ s/)?.[0])")
        assert len(said := [one for one in said if one]) >= 2
        assert set(said) <= {"no answer for 5 s", "no answer for 6 s"}
        assert page.page.locator("nav .badge.is-active").count() == 0
        page.wait_for("() => [...store.figures.value.values()].every(({ rate }) => rate === null)")


@pytest.mark.parametrize(("number", "said", "kind"), [(signal.SIGTERM, "has ended", "over"), (9, "killed", "partly")])
def test_an_end_in_order_looks_otherwise_than_a_crash(chromium: Browser, number: int, said: str, kind: str) -> None:
    with kernel("alone", "examples/pid/system.toml") as process, served("alone") as own, opened(chromium, own) as page:
        page.wait_for_boxes(2)
        page.settle()
        frames = {one["name"] for one in page.things("frames")}
        process.send_signal(number)
        process.wait(WAIT)
        page.page.locator(f"header .live.{kind}").get_by_text(f"alone {'was ' * (number == 9)}{said}").wait_for()
        assert {one["name"] for one in page.things("frames")} == frames
        assert page.page.locator("main .box").count() == 2
        until(lambda: page.page.locator("nav .badge.is-active").count() == 0)
