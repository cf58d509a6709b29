"""Each screen of the page, in both themes, by what can be computed of it; pictures of all of them are kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import browser_checks as checks
from browser_parts import THEMES, Opened, kernel, opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from browser_parts import Served

pytestmark = pytest.mark.slow
PARTS = Path(__file__).parent / "parts"
COMPONENTS = {"imu", "odometry", "metres", "turn_rate", "show", "checker", "wave", "slow", "fails", "door", "loud"}


@pytest.fixture(scope="module")
def site(chromium: Browser) -> Iterator[Served]:
    """A server that shows two kernels."""
    with (
        kernel("roomba", "examples/roomba/system.toml", "--set", "imu.speed=0.06"),
        kernel("lossy", PARTS / "lossy.toml"),
        served("--edit") as found,
    ):
        yield found


@pytest.fixture(scope="module", params=THEMES)
def whole(request: pytest.FixtureRequest, chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site, theme=request.param) as found:
        found.wait_for_boxes(len(COMPONENTS))
        found.settle()
        yield found


@pytest.fixture
def page(whole: Opened) -> Opened:
    """The page of a theme with nothing selected, all of it in view, and no complaint in its console so far."""
    assert whole.complaints == []
    whole.page.keyboard.press("Escape")
    whole.fit()
    return whole


def shot(page: Opened, pictures: Path, name: str) -> None:
    theme = page.page.evaluate("document.documentElement.dataset.theme")
    (pictures / f"{name}-{theme}.png").write_bytes(page.page.screenshot())  # with a path it would start threads


def test_the_whole_system_is_seen_at_a_glance(page: Opened, pictures: Path) -> None:
    assert page.names() == COMPONENTS
    assert checks.at_a_glance(page) == []
    assert checks.small_targets(page) == []
    shot(page, pictures, "whole")


def test_what_is_selected_is_shown_in_full(page: Opened, pictures: Path) -> None:
    page.choose("metres")
    aside = page.page.locator("aside")
    aside.get_by_text("entries in[:pin] >").wait_for()  # what a parameter is for
    words = aside.inner_text()
    for part in (
        "active",
        "Maps pins of input0",
        "output0 → checker.pose",
        "flush, 64 long, block",
        "rounding",
        "aiorts conf",
    ):
        assert part in words, part
    assert checks.at_a_glance(page) == []
    assert checks.small_targets(page) == []
    assert checks.cut_without_tip(page) == []
    shot(page, pictures, "component")
    page.choose_edge("wave.out-slow.in")
    aside.get_by_text("written = delivered + wait + lost").wait_for()
    words = aside.inner_text()
    for part in ("Why samples are lost", "overwritten", "length helps only bursts", " of 4", "aiorts con --both-ends"):
        assert part in words, part
    assert checks.at_a_glance(page) == []
    assert checks.small_targets(page) == []
    shot(page, pictures, "connector")


@pytest.mark.parametrize("tab", ["Log", "Events", "Plots"])
def test_each_panel_below_is_legible(page: Opened, site: Served, pictures: Path, tab: str) -> None:
    page.show(tab)
    if tab == "Events":  # those of the last minute are shown
        theme = page.page.evaluate("document.documentElement.dataset.theme")
        site.call("lossy", "configure", component="wave", values={"": {"label": f"Seen in {theme}"}})
    if tab == "Plots":
        page.choose("wave")
        page.page.get_by_role("button", name="Plot wave.out").click()
        page.page.locator(".values td").get_by_text("3.00", exact=True).first.wait_for()
    else:
        page.page.locator(".log .line").first.wait_for()
    assert checks.at_a_glance(page) == []
    assert checks.small_targets(page) == []
    shot(page, pictures, tab.lower())


def test_the_keys_are_listed_and_close_again(page: Opened, pictures: Path) -> None:
    page.page.keyboard.press("?")
    dialog = page.page.get_by_role("dialog", name="Keys")
    dialog.wait_for()
    assert checks.at_a_glance(page) == []
    shot(page, pictures, "keys")
    page.page.keyboard.press("Escape")
    dialog.wait_for(state="hidden")


def test_a_screen_reader_finds_as_many_things_as_there_are(page: Opened) -> None:
    page.page.wait_for_timeout(1500)
    assert checks.unspoken(page) == []


def test_axe_finds_nothing_serious(page: Opened) -> None:
    if not checks.AXE.is_file():
        pytest.skip("NOT RUN: axe-core is not there; npm ci in .ci/page fetches it")
    page.choose("metres")
    page.show("Log")
    page.page.wait_for_timeout(1000)
    assert checks.axe_findings(page) == []


@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080), (3840, 2160)], ids=str)
def test_small_and_large_screens_are_legible(
    chromium: Browser, site: Served, pictures: Path, size: tuple[int, int]
) -> None:
    with opened(chromium, site, size=size) as page:
        page.wait_for_boxes(len(COMPONENTS))
        page.settle()
        for tab in ("Log", "Plots"):
            page.show(tab)
            page.page.wait_for_timeout(300)
            assert checks.at_a_glance(page) == []
            assert checks.small_targets(page) == []
            assert page.page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "it scrolls sideways"
        (pictures / f"{size[0]}.png").write_bytes(page.page.screenshot())


@pytest.mark.parametrize("theme", THEMES)
def test_contexts_and_kernels_are_shown_in_full(chromium: Browser, site: Served, pictures: Path, theme: str) -> None:
    with opened(chromium, site, theme=theme) as page:
        page.wait_for_boxes(len(COMPONENTS))
        tree = page.page.get_by_role("tree")
        tree.get_by_text("fast", exact=True).click()
        aside = page.page.locator("aside")
        aside.get_by_text("late, 99 of 100").wait_for()
        assert checks.at_a_glance(page) + checks.small_targets(page) == []
        shot(page, pictures, "context")
        tree.get_by_text("lossy", exact=True).click()
        aside.get_by_text("aiorts stop lossy").wait_for()
        assert checks.at_a_glance(page) + checks.small_targets(page) == []
        shot(page, pictures, "kernel")


@pytest.mark.parametrize("theme", THEMES)
def test_a_code_is_asked_for_and_lets_the_page_in(chromium: Browser, site: Served, pictures: Path, theme: str) -> None:
    with served() as own, opened(chromium, own, theme=theme, signed_in=False) as page:
        field = page.page.get_by_label("Code")
        field.wait_for()
        assert checks.small_texts(page) + checks.pale_texts(page) + checks.small_targets(page) == []
        if checks.AXE.is_file():
            assert checks.axe_findings(page) == []
        shot(page, pictures, "sign-in")
        field.fill("not the code that was printed")
        field.press("Enter")
        page.page.locator(".problem", has_text=" ").wait_for()
        field.fill(own.code)
        field.press("Enter")
        page.wait_for_boxes(len(COMPONENTS))


def test_the_picture_of_the_readme(chromium: Browser, pictures: Path) -> None:
    """The robot's recording with a panel that is too slow for it: copy it to aiorts/guide/pages/howto/studio.png."""
    with (
        kernel("robot", "examples/roomba/system.toml", "--set", "imu.speed=0.4"),
        served("--edit", "robot") as site,
        opened(chromium, site, theme="dark", size=(1440, 900)) as page,
    ):
        site.call(
            "robot", "create", type="FlexiDump", name="panel", params={"inputs": ["TimedPose2D"], "names": ["pose"]}
        )
        site.call(
            "robot", "connect", ports=["metres.output0", "panel.pose"], options={"length": 2, "full": "overwrite"}
        )
        site.call(
            "robot",
            "start_context",
            kind="periodic",
            name="slow",
            options={"rate": 2.0},
            members=["panel"],
            activate=True,
        )
        page.wait_for_boxes(7)
        page.wait_for("() => [...store.figures.value.values()].some((row) => row.dropped > 20)")
        page.page.get_by_role("button", name="Tidy").click()
        page.choose_edge("metres.output0-panel.pose")
        page.page.locator("aside").get_by_text("length helps only bursts").wait_for()
        reasons = page.page.get_by_role("region", name="Why samples are lost").locator("p b").all_inner_texts()
        assert reasons[0].endswith("overwritten"), reasons  # a few came before the panel was active: they come last
        page.fit()
        page.page.locator(".toast:not(.shown)").wait_for(state="attached")
        assert checks.at_a_glance(page) == []
        (pictures / "studio.png").write_bytes(page.page.screenshot())
