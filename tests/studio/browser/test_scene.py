"""The scene of the page, as a user sees and walks it: a connector that loses samples, a kernel that stops, a code."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from browser_parts import ROOT, WAIT_MS, Opened, ended, kernel, opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

    from browser_parts import Served

pytestmark = pytest.mark.slow
SYSTEM = """
schema = 1
[[include]]
file = "system.toml"
[components.panel]
type = "FlexiDump"
params.inputs = ["TimedPose2D"]
params.names = ["late"]
[[connections]]
from = "metres.output0"
to = "panel.late"
length = 2
full = "overwrite"
[contexts.panel]
kind = "periodic"
rate = 0.5
members = ["panel"]
"""
"""The Roomba, and a reader that is too slow for it."""
LOSSY = "metres.output0-panel.late"
FOCUSED = "document.activeElement.getAttribute('aria-label')"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = shutil.copytree(ROOT / "examples/roomba", tmp_path_factory.mktemp("system") / "roomba")
    path = folder / "slow.toml"
    path.write_text(SYSTEM, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def site(chromium: Browser, system: Path) -> Iterator[Served]:
    with kernel("slow", system, "--set", "imu.speed=0.1"), served() as found:
        yield found


@pytest.fixture
def page(chromium: Browser, site: Served) -> Iterator[Opened]:
    with opened(chromium, site) as found:
        found.wait_for_boxes(7)
        found.settle()
        yield found
        assert found.complaints == []


def focused(page: Page) -> str:
    return str(page.evaluate(FOCUSED)).partition(",")[0]


def places(page: Opened) -> dict[str, Any]:
    return {box["name"]: (box["x"], box["y"]) for box in page.things("boxes")}


# -- what loses samples is seen ----------------------------------------------------------------------------------------


def test_a_connector_that_loses_samples_says_so_and_why(page: Opened) -> None:
    edge = page.page.locator(".world .edge-of.lossy")
    edge.wait_for(state="attached")
    assert edge.count() == 1
    assert "metres.output0 to panel.late" in (edge.get_attribute("aria-label") or "")
    assert "drops samples" in (edge.get_attribute("aria-label") or "")
    page.page.wait_for_function("() => /\\d+ overwritten/.test(document.querySelector('.label.lossy').textContent)")
    page.page.locator("header .fact.bad").click()  # it leads there
    assert focused(page.page) == "metres.output0 to panel.late"


def test_a_connector_that_loses_samples_has_its_colour_in_the_far_view(page: Opened) -> None:
    page.page.locator(".world .edge-of.lossy").wait_for(state="attached")
    count = """() => {
      const { scene } = studio, { x, y } = scene.view;
      scene.setView({ x, y, k: 0.4 });
      scene.drawNow();
      const words = getComputedStyle(scene.host).getPropertyValue('--lossy').match(/\\w\\w/g);
      const colour = words.map((one) => parseInt(one, 16));
      const { data } = scene.canvas.getContext('2d').getImageData(0, 0, scene.canvas.width, scene.canvas.height);
      let found = 0;
      for (let at = 0; at < data.length; at += 4)
        if (colour.every((one, i) => Math.abs(data[at + i] - one) < 12)) found++;
      return found; }"""
    assert page.page.evaluate(count) > 20
    assert page.page.locator(".world .edge-of").count() == 0


# -- by keyboard -------------------------------------------------------------------------------------------------------


def test_arrows_walk_along_edges_and_the_address_leads_back(page: Opened) -> None:
    keys = page.page.keyboard
    page.choose("imu")
    page.page.evaluate("document.querySelector('.box.chosen').focus()")
    keys.press("ArrowRight")
    first = focused(page.page)
    keys.press("ArrowDown")
    assert {first, focused(page.page)} <= {"odometry", "turn_rate", "checker"}
    page.choose("odometry")
    page.page.evaluate("document.querySelector('.box.chosen').focus()")
    keys.press("ArrowRight")
    assert focused(page.page) == "metres"
    keys.press("Shift+ArrowRight")
    assert focused(page.page).startswith("metres.output0 to ")
    keys.press("ArrowLeft")
    assert focused(page.page) == "metres"
    keys.press("ArrowLeft")
    assert focused(page.page) == "odometry"
    keys.press("c")
    assert page.page.evaluate("navigator.clipboard.readText()") == "aiorts cat odometry"
    page.page.reload()
    page.page.locator(".box.chosen[aria-label^='odometry,']").wait_for()
    keys.press("Escape")
    page.page.wait_for_function("() => location.hash === '' && !document.querySelector('.chosen')")


def test_a_selection_of_a_name_that_is_not_there_selects_nothing(chromium: Browser, site: Served) -> None:
    with opened(chromium, site, address="#/box/slow/nothing") as found:
        found.wait_for_boxes(7)
        assert found.page.locator(".chosen").count() == 0
        assert found.complaints == []


# -- what stops, and what comes back -----------------------------------------------------------------------------------


def test_a_kernel_that_is_stopped_is_grey_and_is_live_again(chromium: Browser) -> None:
    with (
        kernel("still", "examples/pid/system.toml") as process,
        served("still") as site,
        opened(chromium, site) as found,
    ):
        found.wait_for_boxes(2)
        os.kill(process.pid, signal.SIGSTOP)
        title = found.page.locator(".title.kernel.silent")
        title.wait_for()
        found.page.wait_for_function(
            "() => /no answer for [2-9] s/.test(document.querySelector('.title.kernel').textContent)"
        )
        assert found.page.locator(".box.silent").count() == 2
        assert "its kernel does not answer" in (found.page.locator(".box").first.get_attribute("aria-label") or "")
        os.kill(process.pid, signal.SIGCONT)
        title.wait_for(state="detached")
        assert found.page.locator(".box.silent").count() == 0


def test_a_kernel_that_comes_back_stands_where_it_stood(chromium: Browser) -> None:
    with served("again") as site, opened(chromium, site) as found:
        found.page.get_by_text("Nothing runs yet").wait_for()
        with kernel("again", "examples/pid/system.toml"):
            found.wait_for_boxes(2)
            found.settle()
            before = places(found)
            found.choose("pid0")
        found.wait_for("() => [...store.kernels.value.values()].every(one => one.state !== 'live')")
        with kernel("again", "examples/pid/system.toml"):
            found.wait_for("() => [...store.kernels.value.values()].some(one => one.state === 'live')")
            found.page.locator(".box.is-active.chosen").wait_for()
            assert places(found) == before


def test_a_page_says_that_its_server_has_ended(chromium: Browser) -> None:
    with kernel("alone", "examples/pid/system.toml"), served("alone") as site, opened(chromium, site) as found:
        found.wait_for_boxes(2)
        with ended(site.process):
            pass
        found.page.get_by_role("alert").get_by_text("aiorts studio does not answer any more").wait_for()
        assert found.page.locator("main .box").count() == 2  # what was last known stays


# -- signing in --------------------------------------------------------------------------------------------------------


@pytest.fixture
def stranger(chromium: Browser) -> Iterator[Page]:
    """A page that knows no token."""
    context = chromium.new_context()
    context.set_default_timeout(WAIT_MS)
    yield context.new_page()
    context.close()


def test_a_code_in_the_address_signs_in_and_goes_from_there(stranger: Page) -> None:
    with kernel("coded", "examples/pid/system.toml"), served() as own:
        stranger.goto(f"{own.origin}/#{own.code}")
        stranger.locator(".box").first.wait_for()
        assert own.code not in stranger.url


def test_a_wrong_code_is_refused_in_words(stranger: Page) -> None:
    with kernel("coded", "examples/pid/system.toml"), served() as own:
        stranger.goto(own.origin)
        stranger.get_by_label("Code").fill("wrong")
        stranger.get_by_role("button", name="Sign in").click()
        stranger.get_by_role("alert").get_by_text("the code is wrong").wait_for()
        stranger.get_by_label("Code").fill(own.code)
        stranger.keyboard.press("Enter")
        stranger.locator(".box").first.wait_for()


# -- by hand -----------------------------------------------------------------------------------------------------------


def test_a_frame_folds_into_one_box_and_unfolds(page: Opened) -> None:
    page.page.get_by_role("button", name="Fold work").click()
    page.page.locator(".box.folded").wait_for()
    assert {"work", "imu", "show", "panel"} == page.names()
    page.page.get_by_role("button", name="Unfold work").click()
    page.wait_for_boxes(7)


def test_infrastructure_can_be_hidden(page: Opened) -> None:
    shown = page.page.locator(".box")
    infrastructure = [box["name"] for box in page.things("boxes") if box["infrastructure"]]
    assert infrastructure
    page.page.get_by_role("button", name="Hide infrastructure").click()
    page.page.wait_for_function(
        "count => document.querySelectorAll('.box').length === count", arg=7 - len(infrastructure)
    )
    page.page.get_by_role("button", name="Hide infrastructure").click()
    page.page.wait_for_function("() => document.querySelectorAll('.box').length === 7")
    assert shown.count() == 7


@pytest.mark.parametrize("size", [(1280, 800), (3840, 2160)])
def test_all_is_in_view_at_first(chromium: Browser, site: Served, size: tuple[int, int]) -> None:
    with opened(chromium, site, size=size, theme="dark") as found:
        found.wait_for_boxes(7)
        found.settle()
        outside = """() => {
          const around = document.querySelector('main').getBoundingClientRect();
          return [...document.querySelectorAll('.box')].map((one) => one.getBoundingClientRect()).filter((box) =>
            box.left < around.left || box.top < around.top || box.right > around.right || box.bottom > around.bottom);
        }"""
        assert found.page.evaluate(outside) == []
